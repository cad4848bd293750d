"""Priors of a recording's unknowns, and where a search for them should begin."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from gendom.datasets import ObjectDescription, Recording
from gendom.errors import ParameterError
from gendom.estimation.theta import UNKNOWNS, Prior, Theta, prior_of
from gendom.materials.catalogue import Listed

BENDING_RANGE = {"rope": (0.04, 2.5), "cloth": (0.01, 0.2)}
"""Range of bending lengths that is searched, in lengths of a rope or diagonals of a cloth: below it
the object hangs like a chain, above it it does not bend."""


def recording_prior(
    recording: Recording,
    moduli: tuple[float, float],
    *,
    quasi_static: bool,
    wanted: tuple[str, ...] = (),
    material: Listed | None = None,
) -> tuple[Prior, Theta]:
    """What is looked for, its prior, and the estimate that has everything else.

    Args:
        recording: Of a rope or cloth.
        moduli: Ends of the range of E / density [m^2/s^2].
        quasi_static: Whether it is replayed on another clock, or nothing moves.
        wanted: Names; by default what a recording of this kind shows.
        material: What it is made of, of the catalogue; None: unknown.

    Raises:
        ParameterError: There is no such unknown, or the object has none; or the material's is
            another kind, or an object of this size could not be made of it.
    """
    described = recording.object
    kind = described.kind
    measured = recording.gripper_source == "measured"
    for name in wanted:
        if name in UNKNOWNS and kind not in UNKNOWNS[name].kinds:
            raise ParameterError(f"a {kind} has no {name}", where="unknowns")
    logs = np.log(moduli)
    changes: dict[str, dict[str, float]] = {
        # searched over its range without preference: a wide Gaussian
        "specific_modulus": {
            "low": moduli[0], "high": moduli[1],
            "mean": math.exp(logs.mean()), "sd": float(np.ptp(logs)) / 2,
        },
        # an arm follows its commands with a delay, and commands are for a point of the hand
        "grip_height": {"sd": 0.002 if measured else (0.02 if kind == "cloth" else 0.01)},
        "delay": {"sd": 0.02 if measured else 0.1, "mean": 0.0 if measured else 0.05},
        "grip_along": {"sd": 0.002 if described.grasp_inset is not None else 0.008},
        # an assumed value is uncertain by about a factor of two
        "thickness": {} if _thickness_stated(described) else {"sd": 0.5},
    }  # fmt: skip
    if kind == "cloth":
        inset = (0.002, 0.01) if described.grasp_inset is not None else (0.01, 0.02)
        changes["grip_along"] = {"sd": inset[0 if measured else 1], "low": -0.02, "step": 3e-3}
        if recording.gripper_axis is not None:
            # the corner turns as its axis does
            changes["grip_tilt"] = {"mean": 0.0, "sd": 0.1}
        changes["specific_modulus"]["step"] = 0.06
        changes["grip_height"] |= {"step": 2e-3}
    base = Theta(specific_modulus=math.exp(logs.mean()))
    if material is not None:
        of_material = material_prior(material, kind, moduli)
        for name, change in of_material.items():
            changes[name] = changes.get(name, {}) | change
        base = base.with_values({name: change["mean"] for name, change in of_material.items()})
    prior = prior_of(wanted or _shown(recording, quasi_static), changes)
    return prior, prior.theta(prior.mean, base)


def _thickness_stated(described: ObjectDescription) -> bool:
    stated = described.diameter if described.kind == "rope" else described.thickness
    return stated is not None


_NINE_OF_TEN = NormalDist().inv_cdf(0.95)
"""Half width of a Gaussian's central 90 % interval, in deviations."""


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
    width = math.hypot(math.log(E.high / E.low), math.log(density.high / density.low))
    found = {"specific_modulus": {"mean": modulus, "sd": width / 2.0 / _NINE_OF_TEN}}
    for name in ("nu", "damping", "friction"):
        unknown, known = UNKNOWNS[name], getattr(material, name)
        ends = unknown.transformed(known.low), unknown.transformed(known.high)
        found[name] = {
            "mean": min(max(known.typical, unknown.low), unknown.high),
            "sd": (ends[1] - ends[0]) / 2.0 / _NINE_OF_TEN,
        }
    return found


def _shown(recording: Recording, quasi_static: bool) -> tuple[str, ...]:
    """Unknowns that a recording may determine."""
    names = ["specific_modulus", "nu", "friction", "grip_height", "grip_along"]
    if not quasi_static:
        names += ["damping", "delay"]
    if recording.table_height is None:
        names.remove("friction")
    if recording.num_grippers > 1:
        names.remove("grip_height")
        names.remove("grip_along")
    if recording.object.kind == "cloth":
        names.remove("nu")
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
