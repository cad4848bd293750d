"""Whether a recording and its fit are usable, with reasons."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gendom.datasets import Recording
from gendom.estimation.likelihood import Comparison, NoiseModel
from gendom.estimation.posterior import Posterior
from gendom.estimation.problem import Found, Part, Problem
from gendom.estimation.theta import UNKNOWNS

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class VerdictSettings:
    """Bounds beyond which a fit is not usable; shares are of the object's size."""

    frames: int = 4
    """Fewest frames with points."""
    moved: float = 0.15
    """Shortest path of a gripper: less shows almost nothing of the stiffness."""
    speed: tuple[float, float] = (5e-4, 4.0)
    """Slowest and fastest mean speed of a gripper on its path [m/s]; other values mean a wrong unit
    of time."""
    density: tuple[float, float] = (15.0, 25000.0)
    """Densities of solids, from cork to gold [kg/m^3]; other values mean a wrong unit of mass or
    length."""
    off: float = 0.035
    """Farthest mean distance of points from the fitted skin. Over 60 good lifts of ropes 0.25 to
    0.36 m long the root mean square is 4.3 mm at most."""
    sensor: float = 0.012
    """The same for small objects [m]: the noise of a poor depth camera."""
    displaced: float = 0.015
    """Largest smooth displacement between model and clouds of a rope that one gripper holds. Over
    those lifts it is 0.010 at most, 0.007 of a real rope; ropes that slip through the fingers have
    0.021 and more, with an E that is four and more times too small."""
    displaced_by_two: float = 0.06
    """The same of a rope between two grippers; of real cables in fast motion 0.010 to 0.016."""
    displaced_cloth: float = 0.01
    """The same of a cloth. Twice its E moves a sheet in a lift by as much (2 to 5 mm of a diagonal
    of 0.42 m): a larger displacement hides the effect of E."""
    bare: float = 0.3
    """Largest share of the object that clouds do not show, in the median frame."""
    stray: float = 0.25
    """Largest share of points farther away than `straying` times `far`."""
    far: float = 4.0
    below: float = 0.2
    """Largest share of points that lie under the stated table: by 1 cm and more, of a rope by a
    quarter of its diameter (and 4 mm) and more."""
    nuisance: float = 5.0
    """Largest difference, in deviations, of a camera, gripper or clock from its stated value, and
    of recordings of one object from each other."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Whether an estimate is usable."""

    usable: bool
    reasons: tuple[str, ...] = ()
    """Why it is not usable, one sentence each."""

    @property
    def text(self) -> str:
        return "usable" if self.usable else "not usable: " + "; ".join(self.reasons)


def recording_faults(
    recording: Recording, density: float | None, settings: VerdictSettings | None = None
) -> list[str]:
    """Why a recording is not usable, independently of the fit.

    Args:
        recording: A valid one.
        density: Mass over volume where both are stated [kg/m^3].
        settings: Bounds.
    """
    s, found = settings or VerdictSettings(), []
    frames = np.flatnonzero(recording.frame_valid)
    if recording.extra.get("static", False):
        return found
    if len(frames) < s.frames:
        found.append(f"{len(frames)} of the {s.frames} frames that a lift takes show points")
        return found
    path, time = recording.gripper_position[frames], recording.time[frames]
    steps = np.linalg.norm(np.diff(path, axis=0), axis=2)
    way = float(steps.sum(axis=0).max())
    size = recording.object.size or 0.0
    reach = float(np.linalg.norm(path - path[0], axis=2).max())
    if reach < s.moved * size:
        found.append(
            f"the gripper moves by {reach:.3g} m, {reach / max(size, 1e-9):.0%} of the object's "
            f"size: too little to tell a stiffness"
        )
    elif not recording.quasi_static:
        moving = float(np.diff(time)[steps.max(axis=1) > 1e-3 * size].sum())
        speed = way / max(moving, 1e-9)
        if not s.speed[0] <= speed <= s.speed[1]:
            found.append(
                f"the gripper's mean speed is {speed:.3g} m/s: are times in seconds and positions "
                "in metres?"
            )
    if recording.table_height is not None:
        thick = recording.object.diameter
        depth = 0.01 if thick is None else min(0.01, max(0.004, 0.25 * thick))
        under = float((recording.points[:, 2] < recording.table_height - depth).mean())
        if under > s.below:
            found.append(f"{under:.0%} of all points lie under the table: does z point up?")
    if density is not None and not s.density[0] <= density <= s.density[1]:
        found.append(
            f"mass and sizes give a density of {density:.3g} kg/m^3: is the mass in kilograms, are "
            "sizes in metres?"
        )
    return found


def judge(
    problem: Problem,
    found: Found,
    alone: Sequence[Posterior],
    settings: VerdictSettings | None = None,
) -> Verdict:
    """The verdict of a fit. Reasons that concern one of several recordings begin with its name.

    Args:
        problem: The problem.
        found: The result of the search.
        alone: Posteriors of each recording alone; empty where they are not compared.
        settings: Bounds.
    """
    s, compared = settings or VerdictSettings(), found.best.comparison
    assert compared is not None
    reasons = []
    for k, (part, comparison) in enumerate(zip(problem.parts, compared.parts, strict=True)):
        faults = _faults(part, comparison, found.noise[k], s)
        faults += _pressed(problem, found.best.vector, k, s)
        reasons += [part.named(reason) for reason in faults]
    reasons += _at_end(problem, found.best.vector)
    reasons += _disagreeing(problem, alone, s)
    return Verdict(usable=not reasons, reasons=tuple(reasons))


def _faults(part: Part, comparison: Comparison, noise: NoiseModel, s: VerdictSettings) -> list[str]:
    """Why a recording, or its fit, is not usable."""
    scene, observation = part.scene, part.observation
    density = None if scene.recording.object.mass is None else scene.density
    reasons = recording_faults(scene.recording, density, s)
    rows = comparison.rows
    own = observation.counts.shape[1]
    real = observation.counts > 0.0
    away = np.abs(rows.rho[:, :own])[real]
    mean = float(away.mean())
    if mean > max(s.off * scene.size, s.sensor):
        reasons.append(
            f"points lie {1e3 * mean:.0f} mm from the best fit in the mean, where "
            f"{1e3 * max(s.off * scene.size, s.sensor):.0f} mm are usual at most"
        )
    stray = float((away > s.far * observation.noise.straying).mean())
    if stray > s.stray:
        reasons.append(f"{stray:.0%} of all points do not belong to the object")
    if observation.markers is None:
        bare = (rows.counts[:, own:] > 0.0) & (rows.rho[:, own:] > s.far * 0.001)
        share = float(np.median(bare.mean(axis=1)))
        if share > s.bare:
            reasons.append(
                f"clouds show nothing where {share:.0%} of the object should be: is its size right?"
            )
    if displaced(part, noise, s):
        reasons.append(
            f"the object moves {1e3 * noise.model:.0f} mm otherwise than any simulated one"
        )
    return reasons


def displaced(
    part: Part, noise: NoiseModel, settings: VerdictSettings | None = None, times: float = 1.0
) -> bool:
    """Whether the object moves otherwise than any simulated one, by so many times what is
    usable."""
    s, scene = settings or VerdictSettings(), part.scene
    most = s.displaced if len(scene.held) == 1 else s.displaced_by_two
    if scene.kind == "cloth":
        most = s.displaced_cloth
    return noise.model > times * most * scene.size


def _at_end(problem: Problem, vector: Array) -> list[str]:
    """Whether the modulus lies at a bound of the search."""
    prior = problem.prior
    if "specific_modulus" not in prior.names:
        return []
    k = prior.index("specific_modulus")
    if min(vector[k] - prior.low[k], prior.high[k] - vector[k]) < 1e-3:
        return ["E / density lies at the end of the range that was searched"]
    return []


def _pressed(problem: Problem, vector: Array, recording: int, s: VerdictSettings) -> list[str]:
    """A recording's own unknowns that are far from their priors."""
    prior, far = problem.prior, []
    for k in prior.of(recording):
        u, x = UNKNOWNS[prior.names[k]], float(vector[k])
        if not u.material and abs(x - prior.mean[k]) > s.nuisance * prior.sd[k]:
            far.append(
                f"{u.symbol} would have to be {u.value(x):.3g} {u.unit} ({u.meaning}): the stated "
                "motion or size is wrong"
            )
    return far


def _disagreeing(problem: Problem, alone: Sequence[Posterior], s: VerdictSettings) -> list[str]:
    """Recordings that disagree in E / density: the two that differ by the most deviations."""
    name = "specific_modulus"
    if name not in problem.prior.names:
        return []
    at = [float(p.mean[p.prior.index(name)]) for p in alone]
    sd = [p.sd(name) for p in alone]
    pairs = combinations(range(len(at)), 2)
    apart = ((abs(at[a] - at[b]) / math.hypot(sd[a], sd[b]), a, b) for a, b in pairs)
    deviations, a, b = max(apart, default=(0.0, 0, 0))
    if deviations <= s.nuisance:
        return []
    (one, low), (other, high) = ((problem.parts[n].name, math.exp(at[n])) for n in (a, b))
    return [
        f"{one} and {other} do not show one object: by themselves they say that E / density is "
        f"{low:.3g} and {high:.3g} m^2/s^2, {deviations:.0f} standard deviations apart"
    ]
