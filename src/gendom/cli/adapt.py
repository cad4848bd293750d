"""`gendom adapt`: learn an object's parameters from what actions have reached."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gendom.arguments import require
from gendom.cli.arguments import Engine, Json, TaskName
from gendom.cli.known_object import KnownObject, executed
from gendom.cli.outputs import check_places, write_result
from gendom.files import to_json
from gendom.materials.estimate import Estimate
from gendom.materials.estimate_file import LEVEL
from gendom.materials.posterior import Posterior
from gendom.materials.unknowns import UNKNOWNS
from gendom.policies.adaptation import Adapted, adapt, executions_from
from gendom.policies.belief import believed
from gendom.tasks import find_task
from gendom.tasks.world import Simulation


@dataclass(frozen=True, kw_only=True)
class Command(KnownObject):
    """Update an estimate by executed actions and what they reached.

    Damping and Young's modulus change as far as they explain what was reached; the rest of the miss
    is expected to repeat for similar actions. gendom act --polish --params uses both. To add a
    further execution, pass the written file as --params. Of a task without goals the share that was
    reached is kept, and gendom act weighs by it which objects are likely.

    For example: gendom adapt rope-casting --params estimate.json --action 0.17 --reached 0.35 0.08
    --out adapted.json
    """

    task: TaskName
    action: tuple[float, ...] = ()
    """The executed action, as gendom act printed it [SI]."""
    reached: tuple[float, ...] = ()
    """What it reached, in the form of a goal [SI]; of cloths the share that lies spread."""
    engine: Engine = "thin"
    out: Path | None = None
    """JSON file to write: the updated estimate, with all executions."""
    json: Json = False

    def run(self) -> int:
        fix = "give an estimate's file"
        require(self.params is not None, "is missing", where="--params", fix=fix)
        check_places((self.out, ".json"))
        task = find_task(self.task)()
        held = self.held(task)
        for name in ("action", "reached"):
            require(getattr(self, name), "is missing", where=f"--{name}", fix="give both")
        new = executions_from([{"action": self.action, "reached": self.reached}], "flags")
        executions = [*executed(held, task), *new]
        belief = believed(held, task)
        before = held.about.get("before_executions")
        if before is not None:  # all executions are learnt from at once, from where it began
            belief = replace(belief, posterior=Posterior.from_dict(before, ()))
        adapted = adapt(task, belief, executions, world=Simulation(engine=self.engine))
        # with all executions, and what was known of the object before any
        every = {task.name: [e.to_dict() for e in executions]}
        about = {
            "executions": {**(held.about.get("executions") or {}), **every},
            "before_executions": before or belief.posterior.to_dict(),
        }
        result = held.updated(adapted.belief, about).record
        print(to_json(result) if self.json else _text(belief, adapted))
        write_result(self.out, result, json=self.json)
        return 0


def _text(before: Estimate, adapted: Adapted) -> str:
    """For people."""
    rows = []
    for name in adapted.belief.names:
        u, said = UNKNOWNS[name], []
        for b in (before, adapted.belief):
            low, high = b.posterior.interval(name, LEVEL)
            value = u.value(float(b.mean[b.names.index(name)]))
            said.append(f"{value:.4g} [{low:.4g}, {high:.4g}]")
        rows.append(f"  {name:<18} {'  ->  '.join(said)}{'' if u.unit == '1' else f' {u.unit}'}")
    left = ", ".join(f"{1e3 * np.linalg.norm(r):.1f}" for r in adapted.residuals)
    last = f"not explained [mm]: {left}" if left else "gendom act weighs by what was enough"
    return "\n".join(["parameters, with 90 % intervals, before and after", *rows, f"  {last}"])
