"""The object that an action is for, from an estimate's file and flags."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

from gendom.cli.arguments import read_params
from gendom.errors import GendomError
from gendom.materials import ASSUMED, KINDS, PARAMETERS, Item, from_columns

if TYPE_CHECKING:
    from gendom.policies.adapt import Execution
    from gendom.policies.belief import Belief
    from gendom.tasks import Task

# What is missing -> the flags that give it.
_FLAGS = {
    "E": "--E and --density",
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
class Held:
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
        known = {**self.assumed, **self.columns}
        modulus = known.get("specific_modulus", task.item.material.specific_modulus)
        known["youngs_modulus"] = modulus * known["density"]
        return from_columns(task.kind, known)

    def belief(self, task: Task) -> Belief:
        """The object, and how uncertain what counts for the task is."""
        from gendom.policies.adapt import uncertain
        from gendom.policies.belief import Belief

        item = self.item(task)
        counts = uncertain(task, item)
        known = [n for n, p in PARAMETERS.items() if n not in counts or p.column in self.flags]
        return Belief.of(item, self.posterior, known=known)

    def executed(self, task: Task) -> list[Execution]:
        """Earlier executions of a task."""
        from gendom.policies.adapt import executions_from

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
    """Accept an estimate that is not usable, and goals and objects outside of the policy's training
    range: it then uses the nearest numbers in range, with a warning."""

    def held(self, task: Task, *, needs: tuple[str, ...] = ()) -> Held:
        """What the file and the flags say.

        Args:
            task: What is done.
            needs: Parameters that must be known; damping and friction may be assumed.

        Raises:
            GendomError: The file cannot be used, or something that is needed is missing.
        """
        columns: dict[str, float] = {}
        posterior, executions = None, {}
        if self.params is not None:
            params = read_params(self.params, force=self.force)
            columns, posterior = read_estimate(params, str(self.params), task.kind)
            executions = params.get("executions") or {}
        flags = {
            "youngs_modulus": self.E,
            "poissons_ratio": self.nu,
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
        if given.keys() & {"youngs_modulus", "density"}:
            columns.pop("specific_modulus", None)  # the file's own, of other numbers
            posterior = None
        if "specific_modulus" not in columns and {"youngs_modulus", "density"} <= columns.keys():
            columns["specific_modulus"] = columns["youngs_modulus"] / columns["density"]
            given["specific_modulus"] = columns["specific_modulus"]
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
        return Held(
            columns=columns, posterior=posterior, flags=frozenset(given), executions=executions
        )


def read_estimate(
    params: Mapping[str, Any], where: str, kind: str
) -> tuple[dict[str, float], Mapping[str, Any] | None]:
    """The numbers of an estimate that a policy needs, as far as it has them, by column name; and
    its posterior, None if it says of nothing how sure it is.

    Args:
        params: An estimate's JSON, perhaps of an older version.
        where: Its file, for complaints.
        kind: Of the task's object.

    Raises:
        GendomError: It is of another kind of object, or a number in it is none.
    """
    names = ("youngs_modulus", "poissons_ratio", "density", "specific_modulus")
    found = {name: params.get(name) for name in (*names, "damping", "friction")}
    described = params.get("object")
    if isinstance(described, dict):
        if described.get("kind", kind) != kind:
            raise GendomError(
                f"describes a {described['kind']}, the task needs a {kind}",
                where=where,
                fix=f"give the estimate of a {kind}",
            )
        # a recording's cloth has width and height
        sizes = {**described, "side": described.get("width")}
        found |= {name: sizes.get(name) for name in KINDS[kind].sizes}
    for name, value in found.items():
        if value is None:
            continue
        may_be_zero = name in ("damping", "friction")
        if not (isinstance(value, (int, float)) and (value > 0.0 or (may_be_zero and value == 0))):
            raise GendomError(
                f"{name} must be a positive number, got {value!r}",
                where=where,
                fix="estimate again, or give the number by a flag",
            )
    known = {name: float(value) for name, value in found.items() if value is not None}
    intervals = params.get("intervals") or {}
    ends = intervals.get("youngs_modulus")
    if not ends:
        return known, None
    if isinstance(params.get("posterior"), dict):
        return known, params["posterior"]
    # files of older versions have the interval alone
    low, high = (math.log(end / known["density"]) for end in ends)
    half = NormalDist().inv_cdf(0.5 + intervals.get("level", 0.9) / 2.0)
    variance = (0.5 * (high - low) / half) ** 2
    return known, {
        "names": ["specific_modulus"],
        "mean": [0.5 * (low + high)],
        "covariance": [[variance]],
    }
