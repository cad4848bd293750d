"""The registry of unknowns: every number that can be estimated, defined once.

A further unknown is one entry. Other packages add theirs by an entry point of the group
``gendom.unknowns`` whose object is an `Unknown`, or `register` it. Estimates, their files, reports,
viewers and policies go by the registry.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import check_number, require
from gendom.plugins import plugins


@dataclass(frozen=True)
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
    _: KW_ONLY
    log: bool = False
    low: float
    high: float
    mean: float
    sd: float
    step: float
    """By which it is changed for differences."""
    widest: float
    """Longest step of a search."""
    default: float | None = None
    """Where it is not estimated; None: the prior's mean."""
    above: float | None = None
    """What every value must exceed."""
    least: float = -math.inf
    """Least value that makes sense."""
    label: str = ""
    """What people call it; empty: its name."""
    form: str = ".4g"
    """Format of its value."""
    steps_with: tuple[tuple[str, float], ...] = ()
    """Unknowns whose difference takes this many of its steps, transformed: nearly equivalent
    unknowns need differences of small changes."""
    kinds: tuple[str, ...] = ("rope", "cloth")
    """Objects that have it."""
    material: bool = False
    """Whether it belongs to the object, not to one recording of it."""

    on_object: Callable[[Any, float], Any] | None = None
    """The object (`Rope`, `Cloth`) with a value of it: makes a material's unknown count for tasks.
    """
    on_replay: Callable[[Any, float], None] | None = None
    """Changes the inputs of a simulated world (`estimation.replay.WorldInputs`) to a value; None:
    the simulator takes it as it is."""

    @property
    def title(self) -> str:
        """What people call it."""
        return self.label or self.name.replace("_", " ")

    @property
    def usual(self) -> float:
        """Its value where it is not estimated."""
        return self.mean if self.default is None else self.default

    def transformed(self, value: float) -> float:
        return math.log(value) if self.log else value

    def value(self, transformed: float) -> float:
        return math.exp(transformed) if self.log else transformed

    def check(self, value: float) -> float:
        """A value that makes sense.

        Raises:
            ParameterError: It does not.
        """
        return check_number(self.name, value, least=self.least, above=self.above)


def _with(name: str) -> Callable[[Any, float], Any]:
    """How an object takes a value of its material's field."""
    return lambda item, value: replace(item, material=replace(item.material, **{name: value}))


def _turns(end: int, about: int) -> Callable[[Any, float], None]:
    """How a clamp takes its turn about an axis of the hand."""
    return lambda world, value: world.clamps.__setitem__((end, about), value)


def _clamp(end: int, across: int) -> Unknown:
    """How a clamp's direction differs from that of two markers that are glued beside the rope."""
    which, axis = ("first", "last")[end], "xy"[across]
    return Unknown(
        f"{which}_clamp_{axis}", f"{which} clamp, {axis}", "rad",
        f"turn of the clamp at the {which} end from its stated axis, about the hand's {axis} axis",
        low=-1.0, high=1.0, mean=0.0, sd=0.3, step=0.01, widest=0.1, kinds=("rope",),
        material=True, form=".3f", on_replay=_turns(end, across),
    )  # fmt: skip


UNKNOWNS: dict[str, Unknown] = {
    u.name: u
    for u in (
        # the range is that of a scene, by bending lengths: see `prior_of`
        Unknown(
            "E_over_rho", "E / density", "m^2/s^2", "Young's modulus over density",
            log=True, low=1e-2, high=1e9, mean=1e3, sd=4.0, step=0.02, widest=1.0, material=True,
            label="E / density",
            on_object=lambda item, value: _with("E")(item, value * item.material.density),
        ),
        Unknown(
            "nu", "nu", "1", "Poisson's ratio",
            low=0.05, high=0.45, mean=0.3, sd=0.1, step=0.02, widest=0.1, material=True,
            label="Poisson's ratio", form=".3f", on_object=_with("nu"),
        ),
        # log-uniform 0.5 to 50 ms has this mean and deviation
        Unknown(
            "damping", "damping", "s", "viscous over elastic stress",
            log=True, low=3e-4, high=0.2, mean=0.005, sd=1.33, step=0.1, widest=1.0,
            material=True, least=0.0, form=".2g",
            on_object=_with("damping"),
        ),
        # uniform 0.05 to 1 has this deviation
        Unknown(
            "friction", "friction", "1", "coefficient of friction on the table",
            low=0.02, high=1.5, mean=0.5, sd=0.27, step=0.03, widest=0.2, material=True,
            least=0.0, form=".2f",
            on_object=lambda item, value: replace(item, friction=value),
        ),
        Unknown(
            "stiffness_slope", "d ln(E) / d(s / L)", "1", "how E varies along a rope",
            low=-3.0, high=3.0, mean=0.0, sd=1.0, step=0.05, widest=0.5, kinds=("rope",),
            material=True, label="d ln(E) / d(s/L)", form=".2f",
            on_replay=lambda world, value: world.stiffen_along(value),
        ),
        # all of it in a hose from its coil, nothing in a string that somebody laid down
        Unknown(
            "natural_curvature", "natural curvature", "1",
            "share of a lying rope's curvature that it has by nature",
            low=0.0, high=1.0, mean=0.5, sd=0.5, step=0.05, widest=0.5, kinds=("rope",),
            default=1.0, least=0.0, form=".2f",
        ),
        # of woven cloths one side is up to twice as stiff
        Unknown(
            "warp_over_weft", "warp / weft", "1",
            "bending stiffness along a cloth's first side over that along its second one",
            log=True, low=0.1, high=10.0, mean=1.0, sd=0.5, step=0.06, widest=0.5,
            kinds=("cloth",), material=True, above=0.0, label="warp / weft", form=".2f",
        ),
        # cloth folded over once or twice, and sewn
        Unknown(
            "hem_stiffness", "hem's stiffness", "1",
            "bending stiffness of a cloth's border over that of the rest",
            log=True, low=0.5, high=50.0, mean=1.0, sd=1.5, step=0.2, widest=1.0,
            kinds=("cloth",), material=True, above=0.0, form=".2f",
            on_replay=lambda world, value: world.hem(stiffness=value),
        ),
        Unknown(
            "hem_mass", "hem's mass", "1",
            "mass by area of a cloth's border over that of the rest",
            log=True, low=0.5, high=6.0, mean=1.0, sd=0.6, step=0.1, widest=0.5,
            kinds=("cloth",), material=True, above=0.0, form=".2f",
            on_replay=lambda world, value: world.hem(mass=value),
        ),
        Unknown(
            "tip_mass", "tip mass", "1", "share of a rope's mass at its free end: a knot, a sheath",
            low=0.0, high=0.5, mean=0.05, sd=0.1, step=0.02, widest=0.1, kinds=("rope",),
            default=0.0, material=True, least=0.0, form=".3f",
            on_replay=lambda world, value: world.weigh_tip(value),
        ),
        # a caliper squeezes what is soft: half a millimetre of a centimetre
        Unknown(
            "thickness", "thickness / stated", "1",
            "diameter of a rope, thickness of a cloth, over the stated one",
            log=True, low=0.5, high=2.0, mean=1.0, sd=0.05, step=0.02, widest=0.1, material=True,
            above=0.0,
            steps_with=(("E_over_rho", -2.0),),
            on_replay=lambda world, value: world.thicken(value),
        ),
        # of a cable 6 mm thick and of 1,500 kg/m^3 twice that of the 20 mm and 1,000 kg/m^3 assumed
        Unknown(
            "air_drag", "air drag / assumed", "1",
            "drag of the air over mass, over that of the assumed diameter and density",
            log=True, low=0.1, high=10.0, mean=2.0, sd=0.7, step=0.1, widest=0.7, default=1.0,
            kinds=("rope",), material=True, above=0.0, form=".2f",
        ),
        # a line through markers in zigzag is longer, one through few is shorter
        Unknown(
            "length_ratio", "length / stated", "1", "length of a cable over the stated one",
            log=True, low=0.9, high=1.1, mean=1.0, sd=0.02, step=0.002, widest=0.02,
            kinds=("rope",), default=1.0, material=True, above=0.0,
        ),
        *(_clamp(end, across) for end in (0, 1) for across in (0, 1)),
        # a rope is clamped as it comes: half a turn more or less
        Unknown(
            "clamp_twist", "clamp twist", "rad", "twist of a rope between two clamps",
            low=-8.0, high=8.0, mean=0.0, sd=1.5, step=0.1, widest=1.0, kinds=("rope",),
            material=True, form=".2f", on_replay=_turns(1, 2),
        ),
        Unknown(
            "delay", "delay", "s", "how late clouds show the stated motion of the gripper",
            low=-0.5, high=0.5, mean=0.0, sd=0.02, step=0.005, widest=0.05,
        ),
        Unknown(
            "grip_height", "grip height", "m", "how much higher than stated the object is held",
            low=-0.1, high=0.1, mean=0.0, sd=0.002, step=1e-3, widest=0.01,
            on_replay=lambda world, value: setattr(world, "raised", world.raised + value),
        ),
        Unknown(
            "grip_along", "grip along", "m",
            "how much farther from its end, or corner, than stated the object is held",
            low=-0.1, high=0.1, mean=0.0, sd=0.003, step=1e-3, widest=0.01,
            on_replay=lambda world, value: world.shift(along=value),
        ),
        Unknown(
            "grip_aside", "grip aside", "m",
            "how far to the left of the diagonal, seen from the corner, a cloth is held",
            low=-0.1, high=0.1, mean=0.0, sd=0.008, step=2e-3, widest=0.01, kinds=("cloth",),
            on_replay=lambda world, value: world.shift(aside=value),
        ),
        Unknown(
            "grip_tilt", "grip tilt", "rad",
            "how far the held corner turns from level, or its recorded axis, as it is lifted",
            low=-0.3, high=2.2, mean=0.8, sd=0.6, step=0.05, widest=0.4, kinds=("cloth",),
            default=0.0,
        ),
        Unknown(
            "grip_reach", "grip reach", "m",
            "how much farther from the held point than stated the cloth moves with the gripper",
            low=-0.05, high=0.05, mean=0.0, sd=0.004, step=2e-3, widest=0.01, kinds=("cloth",),
        ),
        Unknown(
            "yaw", "yaw", "rad", "turn of the lying cloth from the first guess on",
            low=-0.8, high=0.8, mean=0.0, sd=0.15, step=0.02, widest=0.15, kinds=("cloth",),
            on_replay=lambda world, value: world.turn(value),
        ),
        # after what moves the object in the fingers
        Unknown(
            "grip_turn", "grip turn", "rad", "how far a rope turns in soft fingers by its weight",
            low=0.0, high=1.5, mean=0.0, sd=0.15, step=0.02, widest=0.2, kinds=("rope",),
            least=0.0, on_replay=lambda world, value: world.soften_grip(value),
        ),
    )
}  # fmt: skip
"""All unknowns that can be estimated, by name."""


def register(unknown: Unknown) -> None:
    """Add an unknown to the registry.

    Raises:
        ParameterError: There is one of this name.
    """
    require(unknown.name not in UNKNOWNS, f"there is an unknown {unknown.name!r} already")
    UNKNOWNS[unknown.name] = unknown


@dataclass(frozen=True, init=False, repr=False, eq=False)
class Theta(Mapping[str, float]):
    """A value of each unknown of the registry, by name and as attributes; never changed.

    Args:
        values: By name; others have their defaults. E_over_rho has none.

    Raises:
        TypeError: There is no such unknown, or E_over_rho is missing.
        ParameterError: A value makes no sense.
    """

    _values: dict[str, float]
    offsets: tuple[tuple[float, ...], ...] = ()
    """Where each marker of a cable is in the frame of its cross-section [m]; empty: on the axis."""

    def __init__(self, **values: float):
        if unknown := values.keys() - UNKNOWNS.keys():
            raise TypeError(f"there is no unknown {min(unknown)!r}")
        if "E_over_rho" not in values:
            raise TypeError("E_over_rho is missing")
        nu = values.get("nu", 0.3)
        require(-1.0 < nu < 0.5, f"nu must lie in (-1, 0.5), got {nu}")
        checked = {n: u.check(float(values[n])) for n, u in UNKNOWNS.items() if n in values}
        object.__setattr__(self, "_values", checked)

    def __getitem__(self, name: str) -> float:
        return self._values.get(name, UNKNOWNS[name].usual)

    def __getattr__(self, name: str) -> float:
        if name not in UNKNOWNS:
            raise AttributeError(name)
        return self[name]

    def __iter__(self) -> Iterator[str]:
        return iter(UNKNOWNS)

    def __len__(self) -> int:
        return len(UNKNOWNS)

    def __hash__(self) -> int:
        return hash((*self.items(), self.offsets))

    def __repr__(self) -> str:
        return f"Theta({', '.join(f'{n}={v:g}' for n, v in self.items())})"

    def with_values(self, values: Mapping[str, float]) -> Theta:
        """The same with other values, by name."""
        return Theta(**{**self._values, **values}).with_offsets(self.offsets)

    def with_offsets(self, offsets: Sequence[Sequence[float]] | NDArray[np.floating]) -> Theta:
        """The same of a cable with markers so far beside its axis [m, 3] [m]."""
        other = copy.copy(self)
        object.__setattr__(other, "offsets", tuple(tuple(map(float, row)) for row in offsets))
        return other


# last, so that their modules can import this one
plugins("unknowns", register)
