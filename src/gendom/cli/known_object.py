"""The object that an action is for, from an estimate's file and flags."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gendom.cli.arguments import read_params
from gendom.errors import GendomError
from gendom.materials import ASSUMED, KINDS, PARAMETERS, Item

if TYPE_CHECKING:
    from gendom.policies.adaptation import Execution
    from gendom.policies.belief import Belief
    from gendom.tasks import Task

# What is missing -> the flags that give it.
_FLAGS = {
    "bending_ratio": "--E and --density",
    "nu": "--nu",
    "density": "--density",
    "damping": "--damping",
    "friction": "--friction",
    "length": "--length",
    "diameter": "--diameter",
    "side": "--side",
    "thickness": "--thickness",
}


@dataclass(frozen=True, kw_only=True)
class ObjectInfo:
    """What is known of an object."""

    columns: Mapping[str, float]
    """In SI units by column name, as far as it is known."""
    posterior: Mapping[str, Any] | None
    """Of the estimate, as `gendom.estimation` writes it; None where nothing is uncertain."""
    flags: frozenset[str]
    """Names of columns that flags gave."""
    executions: Mapping[str, Any]
    """Earlier executions by task, as ``gendom adapt`` writes them."""

    @property
    def assumed(self) -> dict[str, float]:
        """What had to be assumed, by column name."""
        return {name: value for name, value in ASSUMED.items() if name not in self.columns}

    def item(self, task: Task) -> Item:
        """The object."""
        from gendom.policies.estimates import item_of

        return item_of(self.columns, task)

    def belief(self, task: Task) -> Belief:
        """The object, and how uncertain what counts for the task is."""
        from gendom.policies.belief import Belief

        given = [n for n, p in PARAMETERS.items() if p.column in self.flags]
        return Belief.for_task(task, self.item(task), self.posterior, known=given)

    def executed(self, task: Task) -> list[Execution]:
        """Earlier executions of a task."""
        from gendom.policies.adaptation import executions_from

        return executions_from(self.executions.get(task.name, ()), "executions")


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

    def held(self, task: Task, *, needs: tuple[str, ...] = ()) -> ObjectInfo:
        """What the file and the flags say.

        Args:
            task: What is done.
            needs: Parameters that must be known; damping and friction may be assumed.

        Raises:
            GendomError: The file cannot be used, or something that is needed is missing.
        """
        from gendom.policies.estimates import read_estimate

        columns: dict[str, float] = {}
        posterior, executions = None, {}
        if self.params is not None:
            params = read_params(self.params, force=self.force)
            columns, posterior = read_estimate(params, str(self.params), task.kind)
            executions = params.get("executions") or {}
        flags = {
            "E": self.E,
            "nu": self.nu,
            "density": self.density,
            "damping": self.damping,
            "friction": self.friction,
            "length": self.length,
            "diameter": self.diameter,
            "side": self.side,
            "thickness": self.thickness,
        }
        given = {name: value for name, value in flags.items() if value is not None}
        columns |= given
        if given.keys() & {"E", "density"}:
            columns.pop("E_over_rho", None)  # the file's own, of other numbers
            posterior = None
        if "E_over_rho" not in columns and {"E", "density"} <= columns.keys():
            columns["E_over_rho"] = columns["E"] / columns["density"]
            given["E_over_rho"] = columns["E_over_rho"]
        missing = [name for name in KINDS[task.kind].sizes if name not in columns]
        # not every recording determines damping and friction
        missing += [
            name
            for name in needs
            if name not in ("damping", "friction") and PARAMETERS[name].column not in columns
        ]
        if missing:
            raise GendomError(
                "the object is not fully described",
                where=None if self.params is None else str(self.params),
                fix=f"give {', '.join(dict.fromkeys(_FLAGS[name] for name in missing))}"
                + (", or --params with an estimate" if self.params is None else ""),
            )
        return ObjectInfo(
            columns=columns, posterior=posterior, flags=frozenset(given), executions=executions
        )
