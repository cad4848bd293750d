"""Random objects of the MuJoCo test scene, and their lifts as an estimate is given them."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.runs import Runs
from gendom.arrays import Array
from gendom.datasets import Recording
from gendom.estimation import UNKNOWNS, EstimateSettings, SceneSettings
from gendom.estimation.lift_plan import CLOUD_POINTS
from gendom.materials import STANDARD_GRAVITY, Material
from gendom.materials.parameters import E_over_rho_of, bending_length
from gendom.reality import RealCloth, RealObject, RealRope, TrialRun
from gendom.reality.model import CLOTH_STEP
from gendom.reality.objects import vertices_of
from gendom.robot import predefined_lift

LEVEL = 0.9
"""Probability that intervals claim."""

RULER, CALIPER, SCALE = 0.001, 0.03, 0.01
"""Standard deviations of what people measure: lengths and places of the clamp [m], thickness and
mass [-]."""

PADS = 0.02
"""Time in which soft fingers give way [s]."""


@dataclass(frozen=True, kw_only=True)
class Lifts:
    """What is lifted and how; one random object a seed."""

    kind: str = "rope"
    """``rope``, ``cloth``, or ``thin`` for ropes of 3 to 8 mm, which are drawn widely."""
    end: str = "hold"
    """How lifts end, one of `gendom.robot.LIFT_ENDS`."""
    wide: bool = False
    """Whether objects are drawn by `draw_widely`."""
    unlike: str = ""
    """What is otherwise than estimates are told: a key of `HELD` or `TOLD`."""

    @classmethod
    def of(cls, flags: argparse.Namespace) -> Lifts:
        wide = flags.wide or flags.kind == "thin"
        return cls(kind=flags.kind, end=flags.end, wide=wide, unlike=flags.unlike or "")

    @property
    def drawn(self) -> str:
        """From what objects are drawn, whatever is done with them."""
        return f"{self.kind}-wide" if self.wide else self.kind

    @property
    def name(self) -> str:
        """Part of the names of files."""
        plain = self.drawn if self.end == "hold" else f"{self.drawn}-{self.end}"
        return f"{plain}-{self.unlike}" if self.unlike else plain

    def object(self, seed: int) -> RealObject:
        """The random object of a seed."""
        return draw_widely(self.kind, seed) if self.wide else draw_object(self.kind, seed)

    def recorded(self, runs: Runs, seed: int) -> Recording:
        """The lift of a random object, of twice as many points a frame as estimates compare."""
        kind = "rope" if self.kind == "thin" else self.kind
        lifted = self if self.unlike in HELD else replace(self, unlike="")
        own, label = replace(runs, seed=seed), f"{lifted.name}-{seed:04d}"
        motion = predefined_lift(kind, self.end)
        prepare = HELD.get(self.unlike, lambda _: None)
        recording = own.recorded(label, self.object(seed), motion, CLOUD_POINTS[kind], prepare)
        return TOLD.get(self.unlike, lambda r: r)(recording)


def estimate_settings(seed: int) -> EstimateSettings:
    """Of a lift: one start on one thread, as processes work side by side."""
    return EstimateSettings(starts=1, seed=seed, level=LEVEL, scene=SceneSettings(threads=1))


def measured(recording: Recording, seed: int) -> Recording:
    """The recording with sizes, mass and clamp as a ruler, a caliper and a scale give them, where
    those of simulated lifts are exact."""
    rng = np.random.default_rng([78, seed])
    stated = recording.object
    changes: dict[str, float] = {}
    for name in ("length", "width", "height", "grasp_radius", "grasp_inset"):
        error = RULER * float(rng.standard_normal())
        if (own := getattr(stated, name)) is not None:
            changes[name] = max(own + error, 0.0)
    for name, sd in (("diameter", CALIPER), ("thickness", CALIPER), ("mass", SCALE)):
        factor = math.exp(sd * float(rng.standard_normal()))
        if (own := getattr(stated, name)) is not None:
            changes[name] = own * factor
    return replace(recording, object=replace(stated, **changes))


def soften(run: TrialRun, degrees: float) -> None:
    """Let a rope turn in the fingers by its bending moment there: by so much under the moment with
    which its other end leaves the table, that of a stick or, if that is less, of a chain."""
    world, rope = run.world, run.world.item
    assert isinstance(rope, RealRope)
    EI = rope.material.E * math.pi * rope.diameter**4 / 64.0
    weight = STANDARD_GRAVITY * rope.mass / rope.length  # by length
    most = min(0.5 * weight * rope.length**2, math.sqrt(2.0 * EI * weight * rope.length))
    control, turn, first = world.robot.control, np.zeros(3), {}

    def yielding(data: Any, times: Array) -> Iterator[None]:
        for _ in control(data, times):
            give_way(data)
            yield

    def give_way(data: Any) -> None:
        held = world.held
        if len(held) < 2:
            return
        edges = np.diff(world.vertices()[held[-1] - 1 : held[-1] + 2], axis=0)
        a, b = edges / np.linalg.norm(edges, axis=1)[:, None]
        moment = 2.0 * EI / rope.spacing * np.cross(a, b) / (1.0 + a @ b)
        turn[:] += (moment / most * math.radians(degrees) - turn) * world.model.opt.timestep / PADS
        R = data.body("hand").xmat.reshape(3, 3)
        for v in held:
            anchor = world.model.equality(f"hand_{v}").data[3:6]
            own = first.setdefault(v, anchor.copy())
            anchor[:] = R.T @ Rotation.from_rotvec(turn).as_matrix() @ R @ own

    world.robot.control = yielding


def weigh_tip(run: TrialRun, share: float) -> None:
    """Put so much of the rope's mass to its free end."""
    model = run.world.model
    model.body_mass[model.flex_vertbodyid] *= 1.0 - share
    model.body_mass[model.flex_vertbodyid[-1]] += share * run.world.item.mass


def slowed(recording: Recording, rate: float) -> Recording:
    """With so many frames a second."""
    wanted = np.arange(recording.time[0], recording.time[-1] + 1e-9, 1.0 / rate)
    at = np.unique([int(np.abs(recording.time - t).argmin()) for t in wanted])
    names = ("time", "gripper_position", "gripper_axis", "gripper_closed")
    every = {name: getattr(recording, name) for name in names}
    counts, own = np.diff(recording.offsets), np.isin(np.arange(recording.num_frames), at)
    shown, by = np.repeat(own, counts), recording.seen_by
    return replace(
        recording,
        points=recording.points[shown],
        offsets=np.cumsum([0, *counts[own]]),
        seen_by=None if by is None else by[shown],
        **{name: array[at] for name, array in every.items() if array is not None},
    )


def _thicker(recording: Recording, factor: float) -> Recording:
    diameter = factor * (recording.object.diameter or 0.0)
    return replace(recording, object=replace(recording.object, diameter=diameter))


def _hand_alone(recording: Recording) -> Recording:
    """With the hand's axis at first throughout: what a robot knows while a rope turns in it."""
    axis = recording.gripper_axis
    axis = None if axis is None else np.repeat(axis[:1], len(axis), axis=0)
    return replace(recording, gripper_axis=axis)


SOFT = {f"soft-{degrees}": degrees for degrees in (5, 10, 20)}

HELD: dict[str, Callable[[TrialRun], None]] = {
    **{name: partial(soften, degrees=degrees) for name, degrees in SOFT.items()},
    **{f"tip-{percent}": partial(weigh_tip, share=percent / 100.0) for percent in (5, 15)},
}
"""Ropes that turn in the fingers by degrees, or have some percent of their mass at the free end."""

TOLD: dict[str, Callable[[Recording], Recording]] = {
    **dict.fromkeys(SOFT, _hand_alone),
    "thick": partial(_thicker, factor=1.05),
    "thin": partial(_thicker, factor=1.0 / 1.05),
    "2-hz": partial(slowed, rate=2.0),
}
"""Recordings with a diameter that is stated 5 % too large or too small, or of two frames a second.
"""


def draw_object(kind: str, seed: int) -> RealObject:
    """A random rope or square cloth of the second reality.

    Ropes are 0.25 to 0.36 m long, 3.5 to 6 % of that thick and bend over 0.25 to 0.7 lengths;
    cloths are 0.2 to 0.36 m wide, 0.4 to 1.2 mm thick and bend over 14 to 50 mm. Density 500 to
    1,100 (cloths from 300) kg/m^3, nu 0.2 to 0.4, damping log-uniform 1 to 20 ms, friction 0.1 to
    0.8.
    """
    rng = np.random.default_rng([77, seed])

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    nu, friction = between(0.2, 0.4), between(0.1, 0.8)
    damping = math.exp(between(math.log(0.001), math.log(0.02)))
    if kind == "rope":
        length, density = between(0.25, 0.36), between(500.0, 1100.0)
        diameter, bends = length * between(0.035, 0.06), length * between(0.25, 0.7)
        material = _bending_over(bends, diameter / 4.0, nu=nu, density=density, damping=damping)
        return _rope(f"rope-{seed}", length, diameter, material, friction, most=18)
    side, thickness, density = between(0.2, 0.36), between(4e-4, 1.2e-3), between(300.0, 1100.0)
    bends = math.exp(between(math.log(0.014), math.log(0.05)))
    k = thickness / math.sqrt(12.0 * (1.0 - nu**2))
    material = _bending_over(bends, k, nu=nu, density=density, damping=damping)
    return _cloth(f"cloth-{seed}", side, thickness, material, friction, bends)


def draw_widely(kind: str, seed: int) -> RealObject:
    """A random rope or square cloth of nearly all that people lift.

    Ropes are 0.18 to 0.6 m long, 2 to 7 % of that thick (``thin``: 0.25 to 0.6 m, 3 to 8 mm) and
    bend over 0.15 to 0.8 lengths; cloths are 0.16 to 0.5 m wide, 0.3 to 1.5 mm thick and bend over
    12 to 70 mm. Density 300 to 1,500 (cloths to 1,100) kg/m^3, nu 0.2 to 0.45, damping log-uniform
    1 to 30 ms, friction 0.1 to 0.9.
    """
    rng = np.random.default_rng([4711, seed])

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    def log_between(low: float, high: float) -> float:
        return math.exp(between(math.log(low), math.log(high)))

    nu, friction, damping = between(0.2, 0.45), between(0.1, 0.9), log_between(0.001, 0.03)
    if kind != "cloth":
        length, density = between(0.18, 0.6), between(300.0, 1500.0)
        diameter = between(0.003, 0.008) if kind == "thin" else length * between(0.02, 0.07)
        if kind == "thin":
            length = between(0.25, 0.6)
        bends = length * log_between(0.15, 0.8)
        material = _bending_over(bends, diameter / 4.0, nu=nu, density=density, damping=damping)
        most = 30 if kind == "thin" else 22
        return _rope(f"{kind}-wide-{seed}", length, diameter, material, friction, most=most)
    side, thickness = between(0.16, 0.5), log_between(3e-4, 1.5e-3)
    density, bends = between(300.0, 1100.0), log_between(0.012, 0.07)
    k = thickness / math.sqrt(12.0 * (1.0 - nu**2))
    material = _bending_over(bends, k, nu=nu, density=density, damping=damping)
    return _cloth(f"cloth-wide-{seed}", side, thickness, material, friction, bends)


def _bending_over(bends: float, k: float, *, density: float, **other: float) -> Material:
    """The material of what has a bending length and a radius of gyration [m]."""
    E = density * E_over_rho_of(bends, k, STANDARD_GRAVITY)
    return Material(E=E, density=density, **other)


def _rope(
    name: str, length: float, diameter: float, material: Material, friction: float, *, most: int
) -> RealRope:
    return RealRope(
        name=name,
        length=length,
        diameter=diameter,
        material=material,
        friction=friction,
        colour=(200, 40, 40),
        # MuJoCo wants vertices farther apart than they are thick
        vertices=min(most, int(0.95 * length / diameter)),
    )


def _cloth(
    name: str, side: float, thickness: float, material: Material, friction: float, bends: float
) -> RealCloth:
    return RealCloth(
        name=name,
        side=side,
        thickness=thickness,
        material=material,
        friction=friction,
        colour=(40, 70, 190),
        vertices=vertices_of(side, bends),
    )


def truth_of(item: RealObject) -> dict[str, float]:
    """By names of `gendom.estimation.UNKNOWNS` and of values of estimates. Lifts show a cloth's
    rigidity E t^3 / (12 (1 - nu^2)) alone: its E is the one that gives this with the nu that
    estimates assume. Its damping is at least MuJoCo's step, which damps as much
    (docs/reality.md)."""
    m, wide, least = item.material, 1.0, 0.0
    if isinstance(item, RealRope):
        k = item.diameter / 4.0
    else:
        k = item.thickness / math.sqrt(12.0)
        wide, least = (1.0 - m.nu**2) / (1.0 - UNKNOWNS["nu"].mean ** 2), CLOTH_STEP
    return {
        "E": m.E / wide,
        "E_over_rho": m.E_over_rho / wide,
        "bending_length": bending_length(m.E_over_rho / wide, k, STANDARD_GRAVITY),
        "nu": m.nu,
        "damping": max(m.damping, least),
        "friction": item.friction,
    }
