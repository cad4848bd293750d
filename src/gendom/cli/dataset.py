"""`gendom dataset`: simulate demonstrations."""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gendom.arguments import require
from gendom.cli.arguments import Engine, Json, Seed, TaskName, Where
from gendom.errors import printable
from gendom.files import check_folder, to_json
from gendom.progress import bar

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True, kw_only=True)
class Command(Where):
    """Simulate demonstrations of a task with random objects and actions, to train a policy on.

    If it is interrupted, run it again: it continues where it stopped. A larger size extends a set.

    For example: gendom dataset rope-casting --size 1000 --out casts
    """

    task: TaskName
    size: int
    """Number of demonstrations."""
    out: Path
    """Folder for the set: dataset.json and shards of Parquet."""
    seed: Seed = 0
    device: str = "cpu"
    """cpu, cuda, cuda:0 and so on; several (cuda:0,cuda:1) or all GPUs share the work."""
    cluster: str | None = None
    """A Ray cluster that shares the work: local, auto or ray://HOST:PORT (docs/cluster.md)."""
    engine: Engine = "thin"
    policy: Path | None = None
    """Act as this policy for goals that objects reach, with some noise, as one would in a
    laboratory; by default actions are random."""
    range: tuple[tuple[str, float, float], ...] = ()
    """Parameter, lowest and highest value of drawn objects, in SI units, in place
    of the task's own; for an object of the task's own size. E.g. --range E_over_rho 200 4300."""
    json: Json = False

    def run(self) -> int:
        from gendom.datasets.demonstrations import generate
        from gendom.tasks import find_task
        from gendom.tasks.demonstrator import Demonstrator
        from gendom.tasks.world import Simulation

        began = time.monotonic()
        check_folder(self.out)
        kind = find_task(self.task)
        ranges = {**kind().ranges, **{name: (low, high) for name, low, high in self.range}}
        dtype = "float32" if self.engine == "thin" else None
        simulation = Simulation(engine=self.engine, dtype=dtype, interleaved=True)
        world, items = self.world_and_items(simulation)
        acts = None
        if self.policy is not None:
            require(self.cluster is None, "cannot share --policy", where="--cluster")
            from gendom.policies import Policy
            from gendom.policies.evaluation import choose

            acts = functools.partial(choose, Policy.read(self.policy))
        source = Demonstrator(task=kind(ranges=ranges), world=world, items=items, acts=acts)
        require(self.size >= 1, f"is {self.size}", where="--size", fix="give 1 or more")
        with bar(self.task, self.size, "demo", even=True) as show:
            table = generate(
                source, self.size, self.out, seed=self.seed, device=self.device,
                cluster=self.cluster, progress=show,
            )  # fmt: skip
        summary = {"path": self.out, "task": self.task, "seed": self.seed, **summarize(table)}
        summary["seconds"] = time.monotonic() - began
        print(to_json(summary) if self.json else summary_text(summary))
        return 0


def summarize(table: pa.Table) -> dict[str, Any]:
    """How many demonstrations a set holds, how many failed, and the goals they reached."""
    # `to_numpy` would import pandas
    ok, goals = np.array(table["ok"].to_pylist()), {}
    for name in table.column_names:
        if name.startswith("goal_") and ok.any():
            values = np.array(table[name].to_pylist(), dtype=float)[ok]
            low, median, high = np.percentile(values, [0, 50, 100])
            goals[name] = {"min": low, "median": median, "max": high}
    return {"size": len(table), "failed": int((~ok).sum()), "goals": goals}


def summary_text(summary: dict[str, Any]) -> str:
    """The same for people."""
    failed = f", {summary['failed']} of them failed" if summary["failed"] else ""
    path, size = printable(summary["path"]), summary["size"]
    lines = [f"{path}: {size} demonstrations of {summary['task']}{failed}"]
    for name, g in summary["goals"].items():
        ends = f"{g['min']:.4g} to {g['max']:.4g} m, median {g['median']:.4g} m"
        lines.append(f"  {name:<7} {ends}")
    lines += [f"  seed    {summary['seed']}", f"  took    {summary['seconds']:.3g} s"]
    return "\n".join(lines)
