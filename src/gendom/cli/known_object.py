"""The object that an action is for, from an estimate's file and flags."""

import math
from dataclasses import dataclass, fields
from pathlib import Path

from gendom.arguments import require
from gendom.cli.arguments import refuse_sizes
from gendom.errors import GendomError
from gendom.materials import KINDS, PARAMETERS
from gendom.materials.estimate import Estimate
from gendom.materials.estimate_file import HIDDEN
from gendom.policies.adaptation import Execution, executions_from
from gendom.tasks import Task


@dataclass(frozen=True, kw_only=True)
class KnownObject:
    """Flags that describe an object."""

    params: Path | None = None
    """File written by gendom estimate or gendom adapt."""
    E: float | None = None
    """Young's modulus [Pa]."""
    nu: float | None = None
    """Poisson's ratio [-]."""
    density: float | None = None
    """Mass density [kg/m^3]."""
    damping: float | None = None
    """Damping time: viscous stress over elastic stress per strain rate [s]."""
    friction: float | None = None
    """Coefficient of friction [-]."""
    length: float | None = None
    """A rope's length [m]."""
    diameter: float | None = None
    """A rope's diameter [m]."""
    side: float | None = None
    """A cloth's side [m]."""
    thickness: float | None = None
    """A cloth's thickness [m]."""
    force: bool = False
    """Accept an estimate that is not usable, goals and objects outside of the policy's training
    range (it then uses the nearest numbers in range), and motions that the arm cannot do, with a
    warning."""

    def held(self, task: Task, *, needs: tuple[str, ...] = ()) -> Estimate:
        """What the file and the flags say.

        Args:
            task: What is done.
            needs: Parameters that must be known; damping and friction may be assumed.

        Raises:
            GendomError: The file cannot be used, or something that is needed is missing.
        """
        numbers = {f.name for f in fields(KnownObject)} - {"params", "force"}
        given = {n: v for n, v in vars(self).items() if n in numbers and v is not None}
        refuse_sizes(task.kind, given)
        found = Estimate(kind=task.kind, known={})
        where = None if self.params is None else str(self.params)
        if self.params is not None:
            found = Estimate.load(self.params, even_unusable=self.force)
            what = f"describes a {found.kind}, the task needs a {task.kind}"
            fix = f"give the estimate of a {task.kind}"
            require(found.kind == task.kind, what, where=where, fix=fix, error=GendomError)
        for name, value in given.items():
            require(math.isfinite(value), f"is {value}", where=f"--{name}", fix="give a number")
        found = found.with_known(given)
        columns = [n for n in KINDS[task.kind].sizes if n != "side" or "width" not in found.known]
        # not every recording determines damping and friction
        # nor Poisson's ratio, which hardly shows in what slender and thin things do
        columns += [c for n in needs if n not in (*HIDDEN, "nu") and (c := PARAMETERS[n].column)]
        missing = [name for name in columns if found.value(name) is None]
        both = [n for n in ("E", "density") if found.value(n) is None] or ["E", "density"]
        every = [n for name in missing for n in (both if name == "E_over_rho" else [name])]
        units = {"density": "kg/m^3", "E": "Pa"}
        asked = (f"--{name} [{units.get(name, 'm')}]" for name in dict.fromkeys(every))
        fix = f"give {', '.join(asked)}"
        fix += ", or --params with an estimate" if self.params is None else ""
        what = "the object is not fully described"
        require(not missing, what, where=where, fix=fix, error=GendomError)
        return found


def executed(found: Estimate, task: Task) -> list[Execution]:
    """Earlier executions of a task, as ``gendom adapt`` writes them into an estimate."""
    every = found.about.get("executions") or {}
    rows = every.get(task.name, []) if isinstance(every, dict) else every
    require(isinstance(rows, list), "are no list", where="executions", fix="estimate again")
    return executions_from(rows, "executions")
