"""`gendom run`: from lift to adapted action in a cell."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.cli import act, adapt, estimate
from gendom.cli.arguments import TaskName
from gendom.cli.execute import described, move, read_plan
from gendom.cli.outputs import columns
from gendom.cli.perceive import Command as Perceive
from gendom.cli.record import known_in, lift_in
from gendom.datasets import Fault
from gendom.errors import DeviceError
from gendom.files import check_folder, to_json, write_json
from gendom.hardware.cell import Cell
from gendom.hardware.execution import last_time, read_action
from gendom.hardware.observing import reached
from gendom.perception import PerceptionSettings, perceive, read_cameras
from gendom.reading import read_json
from gendom.robot import predefined_lift
from gendom.tasks import Task, find_task

_log = logging.getLogger(__name__)

POLISHING = 30.0
"""Time limit of polishing an action [s]: the arm can wait, and a busy computer is no reason to
miss."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """Lift an object in a cell, estimate its parameters, act, see what was reached and adapt.

    Steps: lift, perceive, estimate with its verdict, then for each execution act, execute, observe
    and adapt. Each leaves a file or a folder in --out; started again, it skips what is finished and
    goes on, and does again what depends on anything that has changed. Before each motion it asks.
    The action that missed least is kept as best.json.

    For example: gendom run rope-reaching --goal 0.45 --cell cell.toml --object rope.toml --out run
    """

    task: TaskName
    """Its name."""
    goal: tuple[float, ...] = ()
    """As gendom act takes it; none for cloths."""
    cell: Path
    """cell.toml, see gendom cell."""
    out: Path
    """Folder for all files."""
    object: Path | None = None
    """TOML file with the object's kind, sizes, mass and colour (docs/own-object.md); its stiffness
    is not looked at. With a simulated robot, what the cell names."""
    grasp: tuple[float, float, float] | None = None
    """Where the fingers take the lying object in metres; by default 0.33 m ahead, on the table."""
    executions: int = 2
    """How often the task is done; from the second time on with what was learnt."""
    yes: bool = False
    """Do not ask, and move slowly (gendom execute --yes)."""
    force: bool = False
    """As for gendom act."""

    def run(self) -> int:
        check_folder(self.out)
        cell, task = Cell.read(self.cell), find_task(self.task)()
        fix = "give 1 or more"
        require(self.executions >= 1, f"is {self.executions}", where="--executions", fix=fix)
        if killed := last_time(self.out / "executions"):
            _log.warning("%s", killed)
        known = known_in(cell, self.object)
        what = f"is a {known.kind}, {task.name} takes a {task.kind}"
        require(known.kind == task.kind, what, where=known.name, fix="name another task")
        what, fix = f"has {len(self.goal)} numbers", f"give {len(task.goals)}"
        require(len(self.goal) == len(task.goals), what, where="--goal", fix=fix)
        steps = _Steps(self.out)
        given = [self.cell, *filter(None, [self.object])]
        lift = steps.do("lift", "lift", given, lambda to: lift_in(
            cell, known, to, motion=predefined_lift(known.kind), grasp=self.grasp, yes=self.yes,
            logs=self.out / "executions"), settings=[self.grasp])  # fmt: skip
        by = PerceptionSettings(colour=known.colour)
        seen = steps.do("perceive", "lift.npz", [lift], lambda to: Perceive(
            folder=lift, out=to, arm=cell.arm, perception=by).run())  # fmt: skip
        params = steps.do("estimate", "estimate.json", [seen], lambda to: estimate.Command(
            recording=seen, out=to.parent).run())  # fmt: skip
        if not read_json(params)["verdict"]["usable"] and not self.force:
            _log.error("nothing is done with an unusable estimate; lift again, or --force")
            return estimate.NOT_USABLE
        rows, misses = [], []
        for k in range(1, self.executions + 1):
            params, miss, row = self._execution(steps, k, cell, task, known, params)
            misses.append(miss)
            said = f"{1e3 * miss:.1f} mm" if task.goals else f"{miss:.3f}"
            rows.append((f"execution {k}", *row, said))
        print(columns(("", "goal", "predicted", "reached", "miss"), rows))
        best = int(np.argmin(misses)) + 1
        if best < self.executions:
            _log.warning("execution %d missed least, and is kept: later ones did not help", best)
        write_json(self.out / "best.json", read_json(self.out / f"action-{best}.json"))
        return 0

    def _execution(
        self, steps: _Steps, k: int, cell: Cell, task: Task, known: Any, params: Path
    ) -> tuple[Path, float, list[str]]:
        """Act, execute, observe, adapt; returns the estimate after it, by how much it missed, and a
        row of the table."""
        plan = steps.do(f"act {k}", f"action-{k}.json", [params, self.cell], lambda to: act.Command(
            task=self.task, goal=self.goal, params=params, cell=self.cell, polish=k > 1,
            seconds=POLISHING, out=to, force=self.force).run(), settings=[self.goal])  # fmt: skip

        def executed(to: Path) -> None:
            action = read_action(plan, cell.model)
            what = f"execution {k} of {task.name}"
            record = to, described(cell, known, what, task.name)
            logs = self.out / "executions"
            move(cell, action, what, read_plan(plan), logs, record=record, yes=self.yes)

        shown = steps.do(f"execute {k}", f"seen-{k}", [plan], executed, settings=[self.yes])
        found = steps.do(f"observe {k}", f"reached-{k}.json", [shown],
                         lambda to: _observe(task, known, cell, shown, to))  # fmt: skip
        better = steps.do(f"adapt {k}", f"adapted-{k}.json", [params, found], lambda to: (
            adapt.Command(task=self.task, params=params, **read_json(found)["executions"][0],
                          out=to, force=self.force).run()))  # fmt: skip
        predicted = read_json(plan).get("predicted", {}).get("reached", {})
        values = read_json(found)["outcome"]
        miss = task.error(known, np.array(self.goal), values)
        learnt = [[of.get(name, np.nan) for name in _learnt(task)] for of in (predicted, values)]
        return better, miss, [", ".join(f"{x:.4f}" for x in row) for row in (self.goal, *learnt)]


def _learnt(task: Task) -> list[str]:
    """Names of what `gendom adapt` learns from."""
    return [quantity.name for quantity in task.goals or task.outcomes[:1]]


def _observe(task: Task, known: Any, cell: Cell, shown: Path, to: Path) -> None:
    """Write what an execution reached, as gendom adapt takes it."""
    action = read_action(shown / "action.json", cell.model)
    recorded = read_cameras(shown, arm=cell.model)

    def warn(fault: Fault) -> None:  # a stand hides a part of a rope, and a cast is high up
        if fault.where not in ("object.length", "table"):
            _log.info("%s", fault)

    seen = perceive(recorded, PerceptionSettings(colour=known.colour), on_warning=warn)
    values = reached(task, known, action, seen.recording, float(recorded.robot.time[0]))
    row = {"action": [*action.action.values()], "reached": [values[n] for n in _learnt(task)]}
    write_json(to, {"executions": [row], "outcome": values, "goal": action.goal})
    print(f"reached {', '.join(f'{n} {v:.4f}' for n, v in values.items())}")


class _Steps:
    """Steps whose results are files or folders, and what each was made from (run.json)."""

    def __init__(self, folder: Path):
        self.folder, self.path = folder, folder / "run.json"
        self.done: dict[str, Any] = read_json(self.path) if self.path.exists() else {}

    def do(
        self, name: str, makes: str, needs: Sequence[Path], work: Callable[[Path], Any],
        *, settings: Sequence[Any] = (),
    ) -> Path:  # fmt: skip
        """Do a step, unless it was finished from the same inputs (files, folders and settings); the
        path of what it makes, which ``work`` is called with. A folder of an earlier try is kept
        under another name."""
        to = self.folder / makes
        inputs = _digest([*(_content(path) for path in needs), to_json(list(settings))])
        if self.done.get(name) == inputs and to.exists():
            _log.info("%s: finished before", name)
            return to
        if to.is_dir():
            count = len(list(self.folder.glob(f"{makes}.before-*")))
            to.rename(self.folder / f"{makes}.before-{count + 1}")
        _log.info("%s", name)
        work(to)
        fix = "see above"
        require(to.exists(), f"{name} made no {makes}", fix=fix, error=DeviceError)
        self.done[name] = inputs
        write_json(self.path, self.done)
        return to


def _content(path: Path) -> str:
    """Digest of a file, or of all files of a folder with their names."""
    if path.is_file():
        return hashlib.sha256(path.read_bytes()).hexdigest()
    files = sorted(p for p in path.rglob("*") if p.is_file())
    return _digest([text for p in files for text in (str(p.relative_to(path)), _content(p))])


def _digest(texts: Sequence[str]) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()
