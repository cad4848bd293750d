"""Random objects of the MuJoCo test scene, and their lifts as an estimate is given them."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace

import numpy as np

from experiments.runs import Runs
from gendom.datasets import Recording
from gendom.estimation import UNKNOWNS, EstimateSettings, SceneSettings
from gendom.estimation.lift_plan import CLOUD_POINTS
from gendom.materials import STANDARD_GRAVITY, Material
from gendom.materials.parameters import E_over_rho_of, bending_length
from gendom.reality import RealCloth, RealObject, RealRope
from gendom.reality.model import CLOTH_STEP
from gendom.reality.objects import vertices_of
from gendom.robot import predefined_lift

LEVEL = 0.9
"""Probability that intervals claim."""

RULER, CALIPER, SCALE = 0.001, 0.03, 0.01
"""Standard deviations of what people measure: lengths and places of the clamp [m], thickness and
mass [-]."""


@dataclass(frozen=True, kw_only=True)
class Lifts:
    """What is lifted and how; one random object a seed."""

    kind: str = "rope"
    """``rope``, ``cloth``, or ``thin`` for ropes of 3 to 8 mm, which are drawn widely."""
    end: str = "hold"
    """How lifts end, one of `gendom.robot.LIFT_ENDS`."""
    wide: bool = False
    """Whether objects are drawn by `draw_widely`."""

    @classmethod
    def of(cls, flags: argparse.Namespace) -> Lifts:
        return cls(kind=flags.kind, end=flags.end, wide=flags.wide or flags.kind == "thin")

    @property
    def drawn(self) -> str:
        """From what objects are drawn, whatever is done with them."""
        return f"{self.kind}-wide" if self.wide else self.kind

    @property
    def name(self) -> str:
        """Part of the names of files."""
        return self.drawn if self.end == "hold" else f"{self.drawn}-{self.end}"

    def object(self, seed: int) -> RealObject:
        """The random object of a seed."""
        return draw_widely(self.kind, seed) if self.wide else draw_object(self.kind, seed)

    def recorded(self, runs: Runs, seed: int) -> Recording:
        """The lift of a random object, of twice as many points a frame as estimates compare."""
        kind = "rope" if self.kind == "thin" else self.kind
        own, label = replace(runs, seed=seed), f"{self.name}-{seed:04d}"
        motion = predefined_lift(kind, self.end)
        return own.recorded(label, self.object(seed), motion, CLOUD_POINTS[kind])


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
