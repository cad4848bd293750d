"""Policies that see both parameters, one or none, on goals of random ropes: the paper's ablation.

Errors are in the paper's unit, in which a rope is 0.5 long. `Simulated` is shared with
`generalization`.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.runs import Chart, Result, Runs, Table, TrainingJob, polished
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.policies.demonstrations import Demonstrations
from gendom.policies.evaluation import choose, judge
from gendom.tasks import Task, find_task
from gendom.tasks.cases import Cases, draw_cases
from gendom.tasks.demonstrator import Demonstrator
from gendom.tasks.task import ROPE
from gendom.tasks.world import Simulation

Array = NDArray[np.float64]

LENGTH = 0.5
"""Of a rope in the paper's unit."""

METRIC = 9.81 * ROPE.length / (12.0 * LENGTH)
"""E / density of our rope [m^2/s^2] by the paper's E, see `gendom.tasks.rope_reaching`."""

RANGES = {"E_over_rho": (500.0, 10500.0), "nu": (0.2, 0.4)}

ARCHITECTURES = {"inverse": "paper", "distal": "smooth", "refined": "smooth"}
"""Of networks by row: the paper's for its method, ours for ours. ``refined``: distal, then refined
in the simulator."""

SEEN: dict[str, tuple[str, ...]] = {
    "both": ("bending_ratio", "nu"),
    "E": ("bending_ratio",),
    "nu": ("nu",),
    "none": (),
}
"""Parameters that policies see, by row."""

PAPER = {
    "rope-reaching": {"both": 0.024, "E": 0.034, "nu": 0.062, "none": 0.062},
    "rope-casting": {"both": 0.065, "E": 0.067, "nu": 0.077, "none": 0.076},
}
"""Mean errors in the paper, over 30 goals."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Numbers of simulations and trainings."""

    task: str = "rope-reaching"
    engine: str = "thin"
    """``thin``: rods. ``mpm``: the paper's engine."""
    demonstrations: int
    epochs: int
    goals: tuple[int, ...] = (30, 200)
    """Means are taken over the first so many."""
    rows: tuple[str, ...] = tuple(ARCHITECTURES)
    """Ways to train, each with every set of parameters."""
    seeds: int
    """Trainings of each row."""
    curve: tuple[int, ...] = (100, 300, 1000, 3000, 10_000)
    """Demonstrations, fewer than all, that the ablation also trains on."""
    steps: int = 3000
    """Of the optimiser in each training, at least, and in each round of refining."""
    refine: int
    """Rounds in the simulator, of rows that are refined."""
    damping: float = 0.001
    """Of all ropes [s]; of the MPM none, whose grid damps about as much."""


SCALES = {
    "small": Settings(demonstrations=2_000, epochs=60, seeds=1, refine=2),
    "full": Settings(demonstrations=40_000, epochs=150, seeds=3, refine=4),
}


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """The table, and the error by the number of demonstrations."""
    settings = replace(SCALES[flags.scale], task=flags.task, engine=flags.engine)
    if flags.rows:
        settings = replace(settings, rows=tuple(flags.rows), curve=())
    figures = ablation(runs, settings)
    shown: list[Table | Chart] = [
        table_of("Errors, a rope being 0.5 long", figures["rows"], PAPER[flags.task])
    ]
    if fewer := figures["by_demonstrations"]:
        shown += [table_of("By demonstrations", fewer, {}), curves_of(figures)]
    about = {"task": flags.task, "engine": flags.engine}
    return Result(name=f"ablation-{flags.task}", figures={**about, **figures}, shown=shown)


def ablation(runs: Runs, settings: Settings) -> dict[str, Any]:
    """Policies that see both parameters, one or none: their errors for goals of random ropes.

    Returns:
        JSON: rows with mean and standard deviation of the error for each number of goals, and
        the same of policies that see both, by the number of demonstrations.
    """
    made = Simulated("ablation", runs, settings, RANGES)
    data = made.demonstrations()
    policies = made.policies(
        {
            f"{method}, {row}": made.job(data, method, seen)
            for method in settings.rows
            for row, seen in SEEN.items()
        }
    )
    fewer = made.policies(
        {
            f"{method}, {count}": made.job(data.first(count), method, SEEN["both"])
            for method in ("inverse", "distal")
            for count in settings.curve
            if count < len(data)
        }
    )
    cases = made.cases(seed=runs.seed)
    rows = made.rows(policies, cases)
    if "refined" in settings.rows:
        rows["polished, both"] = made.polished_row(cases, policies["refined, both"][0])
    return {
        "rows": rows,
        "by_demonstrations": made.rows(fewer, cases),
        "demonstrations": len(data),
    }


class Simulated:
    """Demonstrations, policies and errors of a table in our simulator.

    Args:
        table: Its name, part of the names of files.
        runs: Keeps everything.
        settings: How much.
        ranges: Of the ropes' parameters, in the paper's unit.
    """

    def __init__(
        self,
        table: str,
        runs: Runs,
        settings: Settings,
        ranges: Mapping[str, tuple[float, float]],
    ):
        damping = settings.damping if settings.engine == "thin" else 0.0
        rope = replace(ROPE, material=replace(ROPE.material, damping=damping))
        # the paper's ropes are straight
        straight = {"bow": 0.0} if settings.task == "rope-reaching" else {}
        kind = find_task(settings.task)
        self.runs, self.settings = runs, settings
        self.task: Task = kind(item=rope, ranges=metric(ranges), **straight)
        self.world = simulation(runs, settings)
        self.name = f"{table}-{self.task.name}-{settings.engine}"

    def demonstrations(self, label: str = "", task: Task | None = None) -> Demonstrations:
        """Simulated ones, of the table's task unless another is given."""
        source = Demonstrator(task=task or self.task, world=self.world)
        return self.runs.demonstrations(self.name + label, source, self.settings.demonstrations)

    def cases(self, **options: Any) -> Cases:
        """As many objects and goals as are asked for; options as `draw_cases`."""
        task, count = options.pop("task", self.task), max(self.settings.goals)
        return draw_cases(task, count, simulation=self.world, **options)

    def job(
        self,
        data: Demonstrations,
        row: str,
        seen: tuple[str, ...],
        architecture: str | None = None,
    ) -> TrainingJob:
        """A policy of a row, one of `ARCHITECTURES`, that sees some parameters."""
        from gendom.policies.fitting import Training

        training = Training(
            method="distal" if row == "refined" else row,
            conditioned_on=seen,
            architecture=architecture or ARCHITECTURES[row],
            epochs=self.settings.epochs,
            refine=self.settings.refine if row == "refined" else 0,
            refine_steps=self.settings.steps,
        )
        world = self.runs.training_world(self.settings.engine)
        return TrainingJob.of_steps(data, training, self.settings.steps, world=world)

    def policies(self, jobs: Mapping[str, TrainingJob]) -> dict[str, list[Policy]]:
        """Of each row, one policy a seed."""
        seeds = range(self.runs.seed, self.runs.seed + self.settings.seeds)
        every = {
            f"{row}-{seed}": replace(job, training=replace(job.training, seed=seed))
            for row, job in jobs.items()
            for seed in seeds
        }
        made = self.runs.policies(every, prefix=f"{self.name}-")
        return {row: [made[f"{row}-{seed}"] for seed in seeds] for row in jobs}

    def rows(self, policies: Mapping[str, Sequence[Policy]], cases: Cases) -> dict[str, Any]:
        """Errors by row, all trainings together."""
        return {
            row: self._figures([self._errors(cases, choose(policy, cases)) for policy in seeds])
            for row, seeds in policies.items()
        }

    def polished_row(self, cases: Cases, policy: Policy) -> dict[str, Any]:
        """Errors of a policy's actions, polished for the true parameters."""
        beliefs = [Estimate.of(item) for item in cases.items]
        action = polished(cases, beliefs, choose(policy, cases), self.world)
        return self._figures([self._errors(cases, action)])

    def _errors(self, cases: Cases, action: Array) -> Array:
        """[W] in the paper's unit."""
        found = judge(cases, action, world=self.world)
        return LENGTH * found.error / found.size

    def _figures(self, errors: Sequence[Array]) -> dict[str, Any]:
        """Over the first goals, all trainings together: mean, standard deviation, the mean's 95 %
        interval (normal, goals independent), and the means of the trainings."""
        found = {}
        for count in self.settings.goals:
            some = np.array([e[:count] for e in errors])
            flat = some[np.isfinite(some)]
            half = 1.96 * float(flat.std()) / math.sqrt(max(count, 1))
            mean = float(flat.mean())
            found[str(count)] = {
                "mean": mean,
                "std": float(flat.std()),
                "median": float(np.median(flat)),
                "interval_95": [mean - half, mean + half],
                "by_seed": [float(np.nanmean(e)) for e in some],
                "failed": int((~np.isfinite(some)).sum()),
            }
        return found


def simulation(runs: Runs, settings: Settings) -> Simulation:
    """Where the table is made."""
    return Simulation(engine=settings.engine, device=runs.device)


def metric(ranges: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Ranges of parameters with E / density in place of the paper's E."""
    low, high = ranges["E_over_rho"]
    return {**ranges, "E_over_rho": (METRIC * low, METRIC * high)}


def table_of(title: str, rows: Mapping[str, Any], paper: Mapping[str, float]) -> Table:
    """Mean and standard deviation for each number of goals.

    Args:
        title: Of the table.
        rows: As `ablation` returns them.
        paper: Means in the paper by a part of the row's name.
    """
    counts = next(iter(rows.values()))
    return Table(
        title=title,
        head=(*(["paper"] if paper else []), *(f"{count} goals" for count in counts)),
        rows={
            name: (
                *([_paper_text(name, paper)] if paper else []),
                *(f"{f['mean']:.4f} +- {f['std']:.4f}" for f in figures.values()),
            )
            for name, figures in rows.items()
        },
    )


def _paper_text(name: str, paper: Mapping[str, float]) -> str:
    """The paper's number for a row: its method is the inverse one."""
    rows = (
        f"{v:.3f}" for key, v in paper.items() if name in (f"inverse, {key}", f"{key}, inverse")
    )
    return next(rows, "")


def curves_of(result: Mapping[str, Any]) -> Chart:
    """The error by the number of demonstrations, of policies that see both parameters, over the
    largest number of goals."""
    lines: dict[str, tuple[list[float], list[float]]] = {}
    whole = {
        f"{row.partition(', ')[0]}, {result['demonstrations']}": figures
        for row, figures in result["rows"].items()
        if row.endswith(", both") and not row.startswith("polished")
    }
    for row, figures in {**result["by_demonstrations"], **whole}.items():
        method, count = row.split(", ")
        x, y = lines.setdefault(method, ([], []))
        x.append(float(count))
        y.append(list(figures.values())[-1]["mean"])
    return Chart(
        title="Error by the number of demonstrations",
        x="demonstrations",
        y="mean error, a rope being 0.5 long",
        log=True,
        lines=lines,
    )
