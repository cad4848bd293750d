"""`gendom adapt`: learn an object's parameters from what actions have reached."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import tyro

from gendom.cli.arguments import TaskName, read_params
from gendom.cli.known_object import KnownObject
from gendom.cli.outputs import tell_written
from gendom.errors import ParameterError
from gendom.files import check_file, read_json, to_json, write_json
from gendom.materials import QUANTITIES, to_columns
from gendom.tasks import find_task

if TYPE_CHECKING:
    from gendom.policies.adaptation import Adapted, Execution
    from gendom.policies.belief import Belief


@dataclass(frozen=True, kw_only=True)
class Command(KnownObject):
    """Update an estimate by executed actions and what they reached.

    Damping and Young's modulus change as far as they explain what was reached; the rest of the miss
    is expected to repeat for similar actions. gendom act --polish --params uses both. To add a
    further execution, pass the written file as --params.

    For example: gendom adapt rope-casting --params estimate.json --action 0.17 --reached 0.35 0.08
    --out adapted.json
    """

    task: tyro.conf.Positional[TaskName]
    """The task."""
    action: tuple[float, ...] = ()
    """The executed action, as gendom act printed it [SI]."""
    reached: tuple[float, ...] = ()
    """What it reached, in the form of a goal [SI]."""
    executions: Path | None = None
    """JSON file with a list of executions: {"action": [...], "reached": [...]} each."""
    engine: Literal["thin", "mpm"] = "thin"
    """Of the simulator that explains what was reached: ropes as rods and cloths as shells, or
    particles on a grid."""
    out: Path | None = None
    """JSON file to write: the updated estimate, with all executions."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        from gendom.policies.adaptation import adapt
        from gendom.policies.belief import Belief
        from gendom.policies.estimates import updated
        from gendom.tasks.world import Simulation

        if self.params is None:
            raise ParameterError("is missing", where="--params", fix="give an estimate's file")
        if self.out is not None:
            check_file(self.out, ".json")
        task = find_task(self.task)()
        record = read_params(self.params, force=self.force)
        held = self.held(task)
        executions = [*held.executed(task), *self._new()]
        if not executions:
            raise ParameterError(
                "no execution to learn from", fix="give --action and --reached, or --executions"
            )
        before = record.get("before_executions")
        belief = held.belief(task)
        if before is not None:  # all executions are learnt from at once, from where it began
            belief = Belief.from_dict(belief.item, before)
        adapted = adapt(task, belief, executions, world=Simulation(engine=self.engine))
        result = updated(record, task.name, belief, adapted, executions)
        print(to_json(result) if self.json else _text(belief, adapted))
        if self.out is not None:
            write_json(self.out, result)
            tell_written(self.out, json=self.json)
        return 0

    def _new(self) -> list[Execution]:
        from gendom.policies.adaptation import executions_from

        found = []
        if self.executions is not None:
            rows = read_json(self.executions).get("executions")
            if not isinstance(rows, list):
                raise ParameterError(
                    "holds no list of executions",
                    where=str(self.executions),
                    fix='write {"executions": [{"action": [...], "reached": [...]}]}',
                )
            found += executions_from(rows, str(self.executions))
        if bool(self.action) != bool(self.reached):
            missing = "--reached" if self.action else "--action"
            raise ParameterError("is missing", where=missing, fix="give both")
        if self.action:
            found += executions_from([{"action": self.action, "reached": self.reached}], "flags")
        return found


def _text(before: Belief, adapted: Adapted) -> str:
    """For people."""
    rows = []
    for name in adapted.belief.names:
        column = QUANTITIES[name].column
        unit = "" if QUANTITIES[name].unit == "1" else f" {QUANTITIES[name].unit}"
        said = []
        for b in (before, adapted.belief):
            low, high = b.interval(name)
            said.append(f"{to_columns(b.most_likely)[column]:.4g} [{low:.4g}, {high:.4g}]")
        rows.append(f"  {column:<18} {said[0]}  ->  {said[1]}{unit}")
    left = ", ".join(f"{1e3 * np.linalg.norm(r):.1f}" for r in adapted.residuals)
    title = "parameters, with 90 % intervals, before and after"
    return "\n".join([title, *rows, f"  not explained [mm]: {left}"])
