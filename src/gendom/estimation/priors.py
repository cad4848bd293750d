"""Priors of unknowns: what recordings and materials say of them."""

from __future__ import annotations

import math

import numpy as np

from gendom.arguments import require
from gendom.datasets import ObjectDescription, Recording
from gendom.materials import KINDS
from gendom.materials.catalogue import Listed
from gendom.materials.posterior import half_width
from gendom.materials.unknowns import UNKNOWNS

BENDING_RANGE = {"rope": (0.04, 2.5), "held rope": (0.04, 1.2), "cloth": (0.01, 0.2)}
"""Range of bending lengths that is searched, in lengths of a rope or diagonals of a cloth: below it
the object hangs like a chain, above it it does not bend."""

UNKNOWN_THICKNESS = 0.8
"""Deviation of the logarithm of a diameter or thickness that is assumed: ropes are a hundredth to a
sixteenth of their length thick."""

HEIGHT = {"measured": 0.002, "commanded": 0.01}
"""Deviation of a rope's gripper [m]: of calibrated arms and rulers, and of arms that follow late. A
cloth's commanded one has twice the latter."""

INSET, UNKNOWN_INSET = 0.002, 0.008
"""Deviation of a distance from a rope's end [m]: stated, and where half the diameter is assumed."""

CORNER = {("measured", True): 0.002, ("commanded", True): 0.01,
          ("measured", False): 0.01, ("commanded", False): 0.02}  # fmt: skip
"""Of the distance from a cloth's corner, by the gripper and whether it is stated [m]."""

DELAY = {"measured": (0.0, 0.02), "commanded": (0.05, 0.1)}
"""Mean and deviation of how late clouds are after the gripper [s]."""

FRAME_SHARE = 12.0**-0.5
"""Deviation of a quasi-static recording's delay, in intervals: its times are often frames'."""

CLAMPS = ("first_clamp_x", "first_clamp_y", "last_clamp_x", "last_clamp_y", "clamp_twist")
"""How two hands hold a rope, where markers beside it show its ends."""

INSTRUMENTED = (*CLAMPS, "length_ratio", "air_drag")
"""What is found of a cable beside its material."""


def stated_priors(recording: Recording) -> dict[str, dict[str, float]]:
    """What a recording says of its own unknowns and the thickness, as changes to `UNKNOWNS`."""
    described, gripper = recording.object, recording.gripper_source
    inset = described.grasp_inset is not None
    # an arm follows its commands with a delay, and commands are for a point of the hand
    changes = {"delay": _delay(recording), "thickness": _thickness(described)}
    if described.kind == "rope":
        changes["grip_height"] = {"sd": HEIGHT[gripper]}
        changes["grip_along"] = {"sd": INSET if inset else UNKNOWN_INSET}
        return changes
    times = 1.0 if gripper == "measured" else 2.0
    changes["grip_height"] = {"sd": times * HEIGHT[gripper], "step": 2e-3}
    changes["grip_along"] = {"sd": CORNER[gripper, inset], "low": -0.02, "step": 3e-3}
    if recording.gripper_axis is not None:
        # the corner turns as its axis does
        changes["grip_tilt"] = {"mean": 0.0, "sd": 0.1}
    return changes


def _delay(recording: Recording) -> dict[str, float]:
    """The prior of how late clouds are, as changes to that of `UNKNOWNS`."""
    (mean, sd), u, times = DELAY[recording.gripper_source], UNKNOWNS["delay"], 1.0
    if recording.quasi_static and recording.num_frames > 1:
        times = max(1.0, FRAME_SHARE * float(np.median(np.diff(recording.time))) / sd)
    wider = {n: times * getattr(u, n) for n in ("low", "high", "step", "widest")}
    return {"mean": mean, "sd": times * sd, **wider}


def _thickness(described: ObjectDescription) -> dict[str, float]:
    """The prior of a diameter or thickness, as changes to that of `UNKNOWNS`."""
    small = KINDS[described.kind].sizes[1]
    stated, sd = getattr(described, small), getattr(described, f"{small}_sd")
    if stated is None:
        sd = UNKNOWN_THICKNESS
    else:
        sd = UNKNOWNS["thickness"].sd if sd is None else sd / stated
    farthest = math.exp(max(2.0 * sd, math.log(2.0)))
    return {"sd": sd, "low": 1.0 / farthest, "high": farthest}


def thickness_stated(described: ObjectDescription) -> bool:
    """Whether a recording says how thick its object is."""
    return getattr(described, KINDS[described.kind].sizes[1]) is not None


def material_prior(
    material: Listed, kind: str, moduli: tuple[float, float]
) -> dict[str, dict[str, float]]:
    """Means and deviations by unknown such that a material's ranges hold 90 % of the prior. The
    typical value is the mean, or the median where the logarithm is Gaussian.

    Raises:
        ParameterError: It is of another kind, or its E / density is out of the range of ``moduli``
            [m^2/s^2].
    """
    what = f"{material.name} is a {material.kind}, and a {kind} was recorded"
    fix, E, density = f"gendom materials lists each {kind}", material.E, material.density
    require(material.kind == kind, what, where="material", fix=fix)
    modulus = E.typical / density.typical
    like = "a chain" if modulus <= moduli[0] else "a stick"
    what = f"an object of these sizes, made of {material.name}, would be {like}"
    fix = "check the recording's sizes with gendom check, or leave the material out"
    require(moduli[0] < modulus < moduli[1], what, where="material", fix=fix)
    found = {"E_over_rho": {"mean": modulus, "sd": math.hypot(E.log_sd, density.log_sd)}}
    for name in ("nu", "damping", "friction"):
        unknown, known = UNKNOWNS[name], getattr(material, name)
        ends = unknown.transformed(known.low), unknown.transformed(known.high)
        found[name] = {
            "mean": min(max(known.typical, unknown.low), unknown.high),
            "sd": (ends[1] - ends[0]) / 2.0 / half_width(0.9),
        }
    return found
