"""Priors of a recording's unknowns, and where a search for them should begin."""

from __future__ import annotations

import math

import numpy as np

from gendom.arguments import require
from gendom.datasets import ObjectDescription, Recording
from gendom.materials.catalogue import Listed
from gendom.materials.posterior import Prior, half_width, prior_of
from gendom.materials.unknowns import UNKNOWNS, Theta

BENDING_RANGE = {"rope": (0.04, 2.5), "held rope": (0.04, 1.2), "cloth": (0.01, 0.2)}
"""Range of bending lengths that is searched, in lengths of a rope or diagonals of a cloth: below it
the object hangs like a chain, above it it does not bend; a rope between two hands then
has one shape whatever its E."""


DENSITY_SD = 0.5
"""Of the logarithm of a density that is assumed, as ropes and cloths have 300 to 2,000 kg/m^3."""

UNKNOWN_THICKNESS = 0.8
"""Deviation of the logarithm of a diameter or thickness that is assumed: ropes are a hundredth to a
sixteenth of their length thick. `UNKNOWNS` has that of one whose accuracy is not stated."""

HEIGHT = {"measured": 0.002, "commanded": 0.01}
"""Deviation of a rope's gripper [m]: of calibrated arms and rulers, and of arms that follow late,
with fingertips whose point is not the tool's. A cloth's commanded one has twice the latter."""

INSET, UNKNOWN_INSET = 0.002, 0.008
"""Deviation of a distance from a rope's end [m]: stated, and where half the diameter is assumed."""

CORNER = {("measured", True): 0.002, ("commanded", True): 0.01,
          ("measured", False): 0.01, ("commanded", False): 0.02}  # fmt: skip
"""Of the distance from a cloth's corner, by the gripper and whether it is stated [m]."""

DELAY = {"measured": (0.0, 0.02), "commanded": (0.05, 0.1)}
"""Mean and deviation of how late clouds are after the gripper [s]."""

FRAME_SHARE = 12.0**-0.5
"""Deviation of a quasi-static recording's delay, in intervals between frames: its times are often
those of the nearest frame, or its numbers."""

CLAMPS = ("first_clamp_x", "first_clamp_y", "last_clamp_x", "last_clamp_y", "clamp_twist")
"""How two hands hold a rope, where markers beside it show its ends."""


def recording_prior(
    recording: Recording,
    moduli: tuple[float, float],
    *,
    quasi_static: bool,
    thin: bool = True,
    curved: bool = False,
    wanted: tuple[str, ...] = (),
    also: tuple[str, ...] = (),
    material: Listed | None = None,
) -> tuple[Prior, Theta]:
    """The prior of what is looked for, and the estimate that has everything else, see
    `LiftScene.prior`.

    Args:
        recording: Of a rope or cloth.
        moduli: Ends of the range of E / density [m^2/s^2].
        quasi_static: Whether it is replayed on another clock, or nothing moves.
        thin: Whether it is simulated as a rod or shell.
        curved: Whether it is a rope that lies curved.
        wanted: Names; by default what a recording of this kind shows.
        also: Names of further ones.
        material: What it is made of, of the catalogue.
    """
    described, gripper = recording.object, recording.gripper_source
    kind, inset = described.kind, described.grasp_inset is not None
    for name in (*wanted, *also):
        known = name not in UNKNOWNS or kind in UNKNOWNS[name].kinds
        require(known, f"a {kind} has no {name}", where="unknowns")
    logs = np.log(moduli)
    changes: dict[str, dict[str, float]] = {
        # searched over its range without preference: a wide Gaussian
        "E_over_rho": {
            "low": moduli[0], "high": moduli[1],
            "mean": math.exp(logs.mean()), "sd": float(np.ptp(logs)) / 2,
        },
        # an arm follows its commands with a delay, and commands are for a point of the hand
        "grip_height": {"sd": HEIGHT[gripper]},
        "delay": _delay(recording),
        "grip_along": {"sd": INSET if inset else UNKNOWN_INSET},
        "thickness": _thickness(described),
    }  # fmt: skip
    if kind == "cloth":
        changes["grip_along"] = {"sd": CORNER[gripper, inset], "low": -0.02, "step": 3e-3}
        times = 1.0 if gripper == "measured" else 2.0
        changes["grip_height"] = {"sd": times * HEIGHT[gripper], "step": 2e-3}
        changes["E_over_rho"]["step"] = 0.06
        if recording.gripper_axis is not None:
            # the corner turns as its axis does
            changes["grip_tilt"] = {"mean": 0.0, "sd": 0.1}
    base = Theta(E_over_rho=math.exp(logs.mean()))
    if material is not None:
        of_material = material_prior(material, kind, moduli)
        for name, change in of_material.items():
            changes[name] = changes.get(name, {}) | change
        base = base.with_values({name: change["mean"] for name, change in of_material.items()})
    stated = described.extra.get("natural_curvature")
    if stated is not None:
        base, curved = base.with_values({"natural_curvature": stated}), False
    shown = _shown(recording, quasi_static, thin) + (("natural_curvature",) if curved else ())
    prior = prior_of((*(wanted or shown), *also), changes)
    return prior, prior.theta(prior.mean, base)


def _delay(recording: Recording) -> dict[str, float]:
    """The prior of how late clouds are, as changes to that of `UNKNOWNS`."""
    (mean, sd), frames = DELAY[recording.gripper_source], 0.0
    if recording.quasi_static and recording.num_frames > 1:
        frames = FRAME_SHARE * float(np.median(np.diff(recording.time)))
    if frames <= sd:
        return {"mean": mean, "sd": sd}
    u, times = UNKNOWNS["delay"], frames / sd
    wider = {n: times * getattr(u, n) for n in ("low", "high", "step", "widest")}
    return {"mean": mean, "sd": frames, **wider}


def _thickness(described: ObjectDescription) -> dict[str, float]:
    """The prior of a diameter or thickness, as changes to that of `UNKNOWNS`."""
    stated, sd = described.diameter, described.diameter_sd
    if described.kind == "cloth":
        stated, sd = described.thickness, described.thickness_sd
    if stated is None:
        sd = UNKNOWN_THICKNESS
    else:
        sd = UNKNOWNS["thickness"].sd if sd is None else sd / stated
    farthest = math.exp(max(2.0 * sd, math.log(2.0)))
    return {"sd": sd, "low": 1.0 / farthest, "high": farthest}


def thickness_stated(described: ObjectDescription) -> bool:
    """Whether a recording says how thick its object is."""
    stated = described.diameter if described.kind == "rope" else described.thickness
    return stated is not None


def thickness_prior(described: ObjectDescription) -> Prior:
    """Prior of a diameter or thickness, over the stated or the assumed one."""
    return prior_of(["thickness"], {"thickness": _thickness(described)})


def material_prior(
    material: Listed, kind: str, moduli: tuple[float, float]
) -> dict[str, dict[str, float]]:
    """Means and deviations by unknown such that a material's ranges hold 90 % of the prior. The
    typical value is the mean, or the median where the logarithm is Gaussian.

    Raises:
        ParameterError: It is of another kind, or its E / density is out of the range of ``moduli``
            [m^2/s^2].
    """
    require(
        material.kind == kind,
        f"{material.name} is a {material.kind}, and a {kind} was recorded",
        where="material",
        fix=f"gendom materials lists each {kind}",
    )
    E, density = material.E, material.density
    modulus = E.typical / density.typical
    like = "a chain" if modulus <= moduli[0] else "a stick"
    require(
        moduli[0] < modulus < moduli[1],
        f"an object of these sizes, made of {material.name}, would be {like}",
        where="material",
        fix="check the recording's sizes with gendom check, or leave the material out",
    )
    found = {"E_over_rho": {"mean": modulus, "sd": math.hypot(E.log_sd, density.log_sd)}}
    for name in ("nu", "damping", "friction"):
        unknown, known = UNKNOWNS[name], getattr(material, name)
        ends = unknown.transformed(known.low), unknown.transformed(known.high)
        found[name] = {
            "mean": min(max(known.typical, unknown.low), unknown.high),
            "sd": (ends[1] - ends[0]) / 2.0 / half_width(0.9),
        }
    return found


def _shown(recording: Recording, quasi_static: bool, thin: bool) -> tuple[str, ...]:
    """Unknowns that a recording may determine."""
    described, rope = recording.object, recording.object.kind == "rope"
    ordered = bool(recording.extra.get("ordered_markers"))
    static = bool(recording.extra.get("static", False))
    two = recording.num_grippers > 1
    corner = not rope and described.grasp == "corner"
    swinging = two and ordered and not static
    drag = swinging and (not thickness_stated(described) or described.mass is None)
    rows = (
        (True, ("E_over_rho",)),
        (rope and not swinging, ("nu",)),
        (recording.table_height is not None, ("friction",)),
        (not two, ("grip_height", "grip_along")),
        (not quasi_static, ("damping",)),
        # markers are seen by what sees the hands that hold them
        (not static and not ordered, ("delay",)),
        (swinging, CLAMPS),
        (drag, ("air_drag",)),
        (not two and rope and thin, ("grip_turn",)),
        (not rope, ("warp_over_weft",)),
        (corner, ("grip_aside", "grip_tilt", "grip_reach", "yaw")),
    )
    return tuple(name for holds, names in rows if holds for name in names)


def first_guesses(recording: Recording) -> list[dict[str, float]]:
    """Values of a recording's own unknowns from which a search should begin.

    With commanded gripper positions, a level corner at the stated point and a hanging corner at
    fingertips below it give similar clouds, and a search from one does not reach the other.
    """
    described = recording.object
    if described.kind != "cloth" or described.grasp != "corner":
        return [{}]
    if recording.gripper_axis is not None:
        return [{}]  # the axis gives the direction of the corner
    hanging = {"grip_tilt": 1.4}
    if recording.gripper_source != "measured":
        hanging |= {"grip_along": 0.02, "grip_height": -0.02, "delay": 0.1}
    return [{"grip_tilt": 0.2}, {"grip_tilt": 0.8}, hanging]
