"""The unknowns: names, units, ranges and priors, each defined once.

A further unknown is one entry of `UNKNOWNS` and one field of `Theta`; its effect on a replay is in
`replay`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from gendom.errors import ParameterError

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """One number to be estimated, and its prior.

    The prior is Gaussian, and steps are taken, in the transformed value (log or none); low, high
    and mean are in its unit, sd, step and widest step in the transformed one.
    """

    name: str
    symbol: str
    """As people write it."""
    unit: str
    meaning: str
    log: bool = False
    low: float
    high: float
    mean: float
    sd: float
    step: float
    """Of differences."""
    widest: float
    """Of a search."""
    steps_with: tuple[tuple[str, float], ...] = ()
    """Unknowns whose difference takes this many of its steps, transformed: nearly equivalent
    unknowns need differences of small changes."""
    kinds: tuple[str, ...] = ("rope", "cloth")
    """Objects that have it."""
    material: bool = False
    """Whether it belongs to the object, not to one recording of it."""

    def transformed(self, value: float) -> float:
        return math.log(value) if self.log else value

    def value(self, transformed: float) -> float:
        return math.exp(transformed) if self.log else transformed


def _unknown(name: str, symbol: str, unit: str, meaning: str, **other) -> Unknown:
    return Unknown(name=name, symbol=symbol, unit=unit, meaning=meaning, **other)


UNKNOWNS: dict[str, Unknown] = {
    u.name: u
    for u in (
        # the range is that of a scene, by bending lengths: see `prior_of`
        _unknown(
            "E_over_rho", "E / density", "m^2/s^2", "Young's modulus over density",
            log=True, low=1e-2, high=1e9, mean=1e3, sd=4.0, step=0.02, widest=1.0, material=True,
        ),
        _unknown(
            "nu", "nu", "1", "Poisson's ratio",
            low=0.05, high=0.45, mean=0.3, sd=0.06, step=0.02, widest=0.1, material=True,
        ),
        # log-uniform 1 to 20 ms, as ropes and cloths have it, has this mean and deviation
        _unknown(
            "damping", "damping", "s", "viscous over elastic stress",
            log=True, low=3e-4, high=0.2, mean=0.0045, sd=0.86, step=0.1, widest=1.0,
            material=True,
        ),
        # dry materials on tables: 0.1 to 0.8
        _unknown(
            "friction", "friction", "1", "coefficient of friction on the table",
            low=0.02, high=1.5, mean=0.45, sd=0.22, step=0.03, widest=0.2, material=True,
        ),
        _unknown(
            "stiffness_slope", "d ln(E) / d(s / L)", "1", "how E varies along a rope",
            low=-3.0, high=3.0, mean=0.0, sd=1.0, step=0.05, widest=0.5, kinds=("rope",),
            material=True,
        ),
        # a ruler on a soft rope: half a millimetre of a centimetre
        _unknown(
            "thickness", "thickness / stated", "1",
            "diameter of a rope, thickness of a cloth, over the stated one",
            log=True, low=0.5, high=2.0, mean=1.0, sd=0.05, step=0.02, widest=0.1, material=True,
            steps_with=(("E_over_rho", -2.0),),
        ),
        _unknown(
            "delay", "delay", "s", "how late clouds show the stated motion of the gripper",
            low=-0.5, high=0.5, mean=0.0, sd=0.02, step=0.005, widest=0.05,
        ),
        _unknown(
            "grip_height", "grip height", "m", "how much higher than stated the object is held",
            low=-0.1, high=0.1, mean=0.0, sd=0.002, step=1e-3, widest=0.01,
        ),
        _unknown(
            "grip_along", "grip along", "m",
            "how much farther from its end, or corner, than stated the object is held",
            low=-0.1, high=0.1, mean=0.0, sd=0.003, step=1e-3, widest=0.01,
        ),
        _unknown(
            "grip_aside", "grip aside", "m",
            "how far to the left of the diagonal, seen from the corner, a cloth is held",
            low=-0.1, high=0.1, mean=0.0, sd=0.008, step=2e-3, widest=0.01, kinds=("cloth",),
        ),
        _unknown(
            "grip_tilt", "grip tilt", "rad",
            "how far the held corner turns from level, or its recorded axis, as it is lifted",
            low=-0.3, high=2.2, mean=0.8, sd=0.6, step=0.05, widest=0.4, kinds=("cloth",),
        ),
        _unknown(
            "grip_reach", "grip reach", "m",
            "how much farther from the held point than stated the cloth moves with the gripper",
            low=-0.05, high=0.05, mean=0.0, sd=0.004, step=2e-3, widest=0.01, kinds=("cloth",),
        ),
        _unknown(
            "yaw", "yaw", "rad", "turn of the lying cloth from the first guess on",
            low=-0.8, high=0.8, mean=0.0, sd=0.15, step=0.02, widest=0.15, kinds=("cloth",),
        ),
    )
}  # fmt: skip
"""All unknowns that can be estimated, by name."""


@dataclass(frozen=True, kw_only=True)
class Theta:
    """Values of `UNKNOWNS`; see there for units and meanings."""

    E_over_rho: float
    nu: float = 0.3
    damping: float = 0.0045
    friction: float = 0.45
    stiffness_slope: float = 0.0
    thickness: float = 1.0
    delay: float = 0.0
    grip_height: float = 0.0
    grip_along: float = 0.0
    grip_aside: float = 0.0
    grip_tilt: float = 0.0
    grip_reach: float = 0.0
    yaw: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not math.isfinite(value):
                raise ParameterError(f"{field.name} must be a finite number, got {value}")
        if not -1.0 < self.nu < 0.5:
            raise ParameterError(f"nu must lie in (-1, 0.5), got {self.nu}")
        if self.thickness <= 0.0:
            raise ParameterError(f"thickness must be above 0, got {self.thickness}")
        for name in ("friction", "damping"):
            if getattr(self, name) < 0.0:
                raise ParameterError(
                    f"{name} must be at least 0, got {getattr(self, name)}", fix="give 0 for none"
                )

    def with_values(self, values: Mapping[str, float]) -> Theta:
        return replace(self, **values)


NUMBERS = ("low", "high", "mean", "sd", "step", "widest")
"""Fields of `Prior` that are arrays."""


@dataclass(frozen=True, kw_only=True)
class Prior:
    """Gaussian prior of P unknowns of an object and its recordings, in transformed coordinates."""

    names: tuple[str, ...]
    """A recording's own unknowns are named once for each recording."""
    owners: tuple[int | None, ...]
    """Which recording has each; None: the object, so that all recordings share it."""
    low: Array
    high: Array
    mean: Array
    sd: Array
    step: Array
    widest: Array

    @property
    def unknowns(self) -> list[Unknown]:
        return [UNKNOWNS[name] for name in self.names]

    def of(self, recording: int) -> list[int]:
        """Indices of the unknowns that a recording shares or has."""
        return [k for k, owner in enumerate(self.owners) if owner in (None, recording)]

    def taken(self, which: Sequence[int] | NDArray[np.intp]) -> Prior:
        """Prior of unknowns with these indices, those of one recording."""
        numbers = {name: getattr(self, name)[which] for name in NUMBERS}
        names = tuple(self.names[k] for k in which)
        return Prior(names=names, owners=owners_of(names), **numbers)

    def followed_by(self, other: Prior) -> Prior:
        """Prior of these unknowns and then those, none of them twice."""
        numbers = {n: np.append(getattr(self, n), getattr(other, n)) for n in NUMBERS}
        return Prior(names=self.names + other.names, owners=self.owners + other.owners, **numbers)

    def index(self, name: str, recording: int = 0) -> int:
        """Of an unknown, of this recording if each has its own.

        Raises:
            ValueError: It is not among them.
        """
        own = self.of(recording)
        return own[[self.names[k] for k in own].index(name)]

    def vector(self, *thetas: Theta) -> Array:
        """[P] transformed values of an estimate, one for each recording."""
        own = [thetas[owner or 0] for owner in self.owners]
        return np.array(
            [u.transformed(getattr(t, u.name)) for u, t in zip(self.unknowns, own, strict=True)]
        )

    def theta(self, vector: Sequence[float] | Array, base: Theta, recording: int = 0) -> Theta:
        """A recording's estimate with these transformed values [P], others as in ``base``."""
        own = self.of(recording)
        values = ((UNKNOWNS[self.names[k]], float(vector[k])) for k in own)
        return base.with_values({u.name: u.value(x) for u, x in values})

    def within(self, reach: float) -> tuple[Array, Array]:
        """[P] and [P] ends of the ranges, no farther than so many deviations from the means."""
        low, high = self.mean - reach * self.sd, self.mean + reach * self.sd
        return np.maximum(self.low, low), np.minimum(self.high, high)

    def clipped(self, vector: Array) -> Array:
        return np.clip(vector, self.low, self.high)


def prior_of(names: Iterable[str], changes: Mapping[str, Mapping[str, float]]) -> Prior:
    """Prior of some unknowns, ``changes`` of a scene to what `UNKNOWNS` says applied.

    Args:
        names: Names of the unknowns to estimate.
        changes: By name, other values of low, high, mean, sd, step or widest.

    Raises:
        ParameterError: There is no such unknown, or one is named twice.
    """
    names = tuple(names)
    if twice := {name for name in names if names.count(name) > 1}:
        raise ParameterError(
            f"{min(twice)} is named twice", where="unknowns", fix="name each unknown once"
        )
    chosen = []
    for name in names:
        if name not in UNKNOWNS:
            raise ParameterError(
                f"there is no unknown {name!r}", fix=f"choose from {', '.join(UNKNOWNS)}"
            )
        chosen.append(replace(UNKNOWNS[name], **changes.get(name, {})))
    return Prior(
        names=tuple(u.name for u in chosen),
        owners=owners_of(u.name for u in chosen),
        low=np.array([u.transformed(u.low) for u in chosen]),
        high=np.array([u.transformed(u.high) for u in chosen]),
        mean=np.array([u.transformed(u.mean) for u in chosen]),
        sd=np.array([u.sd for u in chosen]),
        step=np.array([u.step for u in chosen]),
        widest=np.array([u.widest for u in chosen]),
    )


def owners_of(names: Iterable[str]) -> tuple[int | None, ...]:
    """`Prior.owners` of the unknowns of one recording."""
    return tuple(None if UNKNOWNS[name].material else 0 for name in names)


def joint_prior(priors: Sequence[Prior]) -> Prior:
    """Joint prior of several recordings of one object: the material's unknowns once, from the first
    recording that has them, and the unknowns of each recording."""
    chosen: dict[tuple[str, int | None], tuple[Prior, int]] = {}
    for recording, prior in enumerate(priors):
        for k, (name, owner) in enumerate(zip(prior.names, prior.owners, strict=True)):
            chosen.setdefault((name, None if owner is None else recording), (prior, k))

    def numbers(field: str) -> Array:
        return np.array([getattr(prior, field)[k] for prior, k in chosen.values()])

    return Prior(
        names=tuple(name for name, _ in chosen),
        owners=tuple(owner for _, owner in chosen),
        **{field: numbers(field) for field in NUMBERS},
    )
