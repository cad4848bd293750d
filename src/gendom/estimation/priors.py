"""Priors of a recording's unknowns, and where a search for them should begin."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gendom.datasets import ObjectDescription, Recording
from gendom.errors import ParameterError
from gendom.materials.catalogue import Listed
from gendom.materials.posterior import Prior, half_width, prior_of
from gendom.materials.unknowns import UNKNOWNS, Theta

BENDING_RANGE = {"rope": (0.04, 2.5), "held rope": (0.04, 1.2), "cloth": (0.01, 0.2)}
"""Range of bending lengths that is searched, in lengths of a rope or diagonals of a cloth: below it
the object hangs like a chain, above it it does not bend; a rope between two hands then
has one shape whatever its E."""


@dataclass(frozen=True, kw_only=True)
class StatedErrors:
    """Standard deviations of what a recording states, or does not, about how an object is held and
    what it is. Of measured grippers they are those of calibrated arms and rulers; of commanded
    ones those of arms that follow late and of fingertips whose point is not the tool's."""

    height: float = 0.002
    """Of a measured gripper [m]."""
    commanded_height: float = 0.01
    """Of a rope's commanded one [m]."""
    commanded_height_cloth: float = 0.02
    delay: float = 0.02
    """Between clouds and a measured gripper [s]."""
    commanded_delay: tuple[float, float] = (0.05, 0.1)
    """Mean and deviation for a commanded one [s]."""
    frame_share: float = 12.0**-0.5
    """Of a quasi-static recording's delay, in intervals between frames: its times are often those
    of the nearest frame, or its numbers."""
    inset: float = 0.002
    """Of a stated distance from a rope's end [m]."""
    unknown_inset: float = 0.008
    """Where half the diameter is assumed [m]."""
    corner: tuple[float, float] = (0.002, 0.01)
    """Of a stated distance from a cloth's corner, measured and commanded [m]."""
    unknown_corner: tuple[float, float] = (0.01, 0.02)
    axis_tilt: float = 0.1
    """Of a cloth's corner against a recorded axis [rad]."""
    unknown_thickness: float = 0.8
    """Of the logarithm of a diameter or thickness that is assumed: ropes are a hundredth to a
    sixteenth of their length thick. That of a stated one is `UNKNOWNS`'s where a recording does not
    state it."""
    density: float = 0.5
    """Of the logarithm of a density that is assumed, as ropes and cloths have 300 to 2,000 kg/m^3.
    """


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
    """What is looked for, its prior, and the estimate that has everything else.

    Args:
        recording: Of a rope or cloth.
        moduli: Ends of the range of E / density [m^2/s^2].
        quasi_static: Whether it is replayed on another clock, or nothing moves.
        thin: Whether it is simulated as a rod or shell.
        curved: Whether it is a rope that lies curved.
        wanted: Names; by default what a recording of this kind shows.
        also: Names of further ones.
        material: What it is made of, of the catalogue; None: unknown.

    Raises:
        ParameterError: There is no such unknown, or the object has none; or the material's is
            another kind, or an object of this size could not be made of it.
    """
    described = recording.object
    kind = described.kind
    measured = recording.gripper_source == "measured"
    for name in (*wanted, *also):
        if name in UNKNOWNS and kind not in UNKNOWNS[name].kinds:
            raise ParameterError(f"a {kind} has no {name}", where="unknowns")
    logs, e = np.log(moduli), StatedErrors()
    changes: dict[str, dict[str, float]] = {
        # searched over its range without preference: a wide Gaussian
        "E_over_rho": {
            "low": moduli[0], "high": moduli[1],
            "mean": math.exp(logs.mean()), "sd": float(np.ptp(logs)) / 2,
        },
        # an arm follows its commands with a delay, and commands are for a point of the hand
        "grip_height": {"sd": e.height if measured else e.commanded_height},
        "delay": _delay(recording, e),
        "grip_along": {"sd": e.unknown_inset if described.grasp_inset is None else e.inset},
        "thickness": _thickness(described, e),
    }  # fmt: skip
    if kind == "cloth":
        inset = e.unknown_corner if described.grasp_inset is None else e.corner
        changes["grip_along"] = {"sd": inset[0 if measured else 1], "low": -0.02, "step": 3e-3}
        if not measured:
            changes["grip_height"] = {"sd": e.commanded_height_cloth}
        if recording.gripper_axis is not None:
            # the corner turns as its axis does
            changes["grip_tilt"] = {"mean": 0.0, "sd": e.axis_tilt}
        changes["E_over_rho"]["step"] = 0.06
        changes["grip_height"] |= {"step": 2e-3}
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


def _delay(recording: Recording, e: StatedErrors) -> dict[str, float]:
    """The prior of how late clouds are, as changes to that of `UNKNOWNS`."""
    mean, sd = (0.0, e.delay) if recording.gripper_source == "measured" else e.commanded_delay
    frames = 0.0
    if recording.quasi_static and recording.num_frames > 1:
        frames = e.frame_share * float(np.median(np.diff(recording.time)))
    if frames <= sd:
        return {"mean": mean, "sd": sd}
    u, times = UNKNOWNS["delay"], frames / sd
    return {
        "mean": mean, "sd": frames,
        "low": times * u.low, "high": times * u.high,
        "step": times * u.step, "widest": times * u.widest,
    }  # fmt: skip


def _thickness(described: ObjectDescription, e: StatedErrors) -> dict[str, float]:
    """The prior of a diameter or thickness, as changes to that of `UNKNOWNS`."""
    rope = described.kind == "rope"
    stated = described.diameter if rope else described.thickness
    if stated is None:
        sd = e.unknown_thickness
    else:
        own = described.diameter_sd if rope else described.thickness_sd
        sd = UNKNOWNS["thickness"].sd if own is None else own / stated
    farthest = math.exp(max(2.0 * sd, math.log(2.0)))
    return {"sd": sd, "low": 1.0 / farthest, "high": farthest}


def thickness_stated(described: ObjectDescription) -> bool:
    """Whether a recording says how thick its object is."""
    stated = described.diameter if described.kind == "rope" else described.thickness
    return stated is not None


def thickness_prior(described: ObjectDescription) -> Prior:
    """Prior of a diameter or thickness, over the stated or the assumed one."""
    return prior_of(["thickness"], {"thickness": _thickness(described, StatedErrors())})


def material_prior(
    material: Listed, kind: str, moduli: tuple[float, float]
) -> dict[str, dict[str, float]]:
    """Means and deviations by unknown such that a material's ranges hold 90 % of the prior. The
    typical value is the mean, or the median where the logarithm is Gaussian.

    Args:
        material: Of the catalogue.
        kind: Of the recorded object.
        moduli: Ends of the range of E / density that is looked for [m^2/s^2].

    Raises:
        ParameterError: The material is of another kind, or its E / density is out of that range.
    """
    if material.kind != kind:
        raise ParameterError(
            f"{material.name} is a {material.kind}, and a {kind} was recorded",
            where="material",
            fix=f"gendom materials lists each {kind}",
        )
    E, density = material.E, material.density
    modulus = E.typical / density.typical
    if not moduli[0] < modulus < moduli[1]:
        like = "a chain" if modulus < moduli[0] else "a stick"
        raise ParameterError(
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
    names = ["E_over_rho", "nu", "friction", "grip_height", "grip_along"]
    if not quasi_static:
        names.append("damping")
    # markers are seen by what sees the hands that hold them
    if not recording.extra.get("static", False) and not recording.extra.get("ordered_markers"):
        names.append("delay")
    if recording.table_height is None:
        names.remove("friction")
    if recording.num_grippers > 1:
        names.remove("grip_height")
        names.remove("grip_along")
        if recording.extra.get("ordered_markers") and not recording.extra.get("static", False):
            names.remove("nu")
            names += CLAMPS
            if not thickness_stated(recording.object) or recording.object.mass is None:
                names.append("air_drag")
    elif recording.object.kind == "rope" and thin:
        names.append("grip_turn")
    if recording.object.kind == "cloth":
        names.remove("nu")
        names.append("warp_over_weft")
        if recording.object.grasp == "corner":
            names += ["grip_aside", "grip_tilt", "grip_reach", "yaw"]
    return tuple(names)


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
