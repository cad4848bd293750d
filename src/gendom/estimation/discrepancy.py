"""What the simulator cannot explain, as uncertainty of the parameters.

Where a recorded object moves otherwise than any simulated one, the likelihood takes the difference
for random: it averages it over frames and becomes sure of the parameters that imitate it best. But
it may be the same throughout, like a bend that the real object has by nature. So a parameter is
uncertain by at least the change that moves the shape by as much as is not explained. The change is
simulated, not extrapolated from derivatives: shapes that swing have derivatives that grow with the
stiffness, while large changes of it hardly move them.

Lifts with known truth have such differences, too, and their intervals are calibrated with them;
only what exceeds theirs counts (`IntervalCalibration.displaced`).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gendom.errors import SimulationError
from gendom.estimation.calibration import IntervalCalibration
from gendom.estimation.methods.gauss_newton import gauss_newton
from gendom.estimation.problem import Found, Part, Problem
from gendom.estimation.replay import middle
from gendom.materials.posterior import IDENTIFIABLE
from gendom.materials.unknowns import UNKNOWNS

Array = NDArray[np.floating]

SHARES = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, IDENTIFIABLE)
"""Of the prior's deviation: changes that are simulated, both ways. Beyond the last the recording
does not determine a parameter."""

FINGERS = 0.25
"""How far a rope's end may turn otherwise in fingers than its moment says, over its turn."""

SUSPICIOUS, CERTAIN = 1.0, 9.0
"""Deviations from its usual value at which an unknown that was left out is looked for, and what it
then gains in -2 log likelihood, the square of three deviations, where it counts."""


def discrepancy(
    problem: Problem, found: Found, covariance: Array, calibration: IntervalCalibration
) -> Array:
    """Deviations of the transformed unknowns by unexplained displacements.

    Of several recordings the best one counts: their errors need not be independent.

    Args:
        problem: The problem.
        found: The result of the search.
        covariance: [P, P] of the likelihood; what it does not determine is left alone.
        calibration: Of the intervals.

    Returns:
        [P] at most those of the prior; 0 where there is no more of it than in lifts with known
        truth.
    """
    prior = problem.prior
    sd = np.full(len(prior.names), math.inf)
    determined = np.sqrt(np.diag(covariance)) < IDENTIFIABLE * prior.sd
    for k, part in enumerate(problem.parts):
        excess = _unexplained(found, part, k, calibration)
        for p in part.shown:
            own, wanted = 0.0, determined[p] and UNKNOWNS[prior.names[p]].material
            if wanted and excess > 0.0:
                own = _change(problem, found.best.vector, k, int(p), excess)
            sd[p] = min(sd[p], own)
    return np.where(np.isfinite(sd), sd, 0.0)


def _unexplained(
    found: Found, part: Part, recording: int, calibration: IntervalCalibration
) -> float:
    """Displacement of the model beyond that of lifts with known truth, of a coordinate [m]."""
    noise, comparison = found.noise[recording], found.best.comparison
    if part.scene.static:
        # repeats of one shape average the sensor's noise, not what is wrong with the shape
        assert comparison is not None
        return comparison.parts[recording].fit(noise).rms
    usual = calibration.displaced * part.scene.size if len(part.scene.held) == 1 else 0.0
    return math.sqrt(max(noise.model**2 - max(usual, noise.least_model) ** 2, 0.0))


def _change(problem: Problem, vector: Array, recording: int, p: int, by: float) -> float:
    """The change of unknown p beyond which every larger one, up or down, moves the shape by more
    than this, root mean square of a coordinate [m]; at most the prior's deviation."""
    sd = float(problem.prior.sd[p])
    changes = sd * np.array(SHARES)
    (last,) = _moved(problem, vector, recording, p, changes[-1:])
    if last < by:
        return sd
    moved = np.append(_moved(problem, vector, recording, p, changes[:-1]), last)
    within = np.flatnonzero(moved < by)
    if len(within) == 0:
        return float(changes[0] * by / moved[0])
    n = int(within[-1])
    share = (by - moved[n]) / (moved[n + 1] - moved[n])
    return float(changes[n] + share * (changes[n + 1] - changes[n]))


def _moved(problem: Problem, vector: Array, recording: int, p: int, changes: Array) -> Array:
    """[k] how far shapes move with changes [k] of unknown p in the direction that moves them less
    [m]. A world that diverges or lies beyond the range of the search says nothing."""
    prior, scene = problem.prior, problem.parts[recording].scene
    ends = vector[p] + np.array([[-1.0], [1.0]]) * changes
    inside = (ends >= prior.low[p]) & (ends <= prior.high[p])
    worlds = [vector]
    for end in np.clip(ends, prior.low[p], prior.high[p]).ravel():
        worlds.append(np.where(np.arange(len(vector)) == p, end, vector))
    x = middle(scene, problem.positions(worlds, recording))
    off = np.sqrt(np.mean((x[:, 1:] - x[:, :1]) ** 2, axis=(0, 2, 3))).reshape(2, -1)
    return np.where(inside & np.isfinite(off), off, np.inf).min(axis=0)


def with_fingers(problem: Problem, found: Found, covariance: Array) -> Array:
    """[P, P] covariance, where ropes that turn in the fingers do not turn just as their moment."""
    prior = problem.prior
    for k, name in enumerate(prior.names):
        if name == "grip_turn":
            # what that much turn does to the others
            moved = covariance[k] / covariance[k, k] * FINGERS * found.best.vector[k]
            moved = np.clip(moved, -prior.sd, prior.sd)
            covariance = covariance + np.outer(moved, moved)
    return covariance


def tip_suspected(problem: Problem, found: Found) -> tuple[Array, tuple[str, ...]]:
    """Whether clouds look as if a rope's free end was heavier than the rest, which the search took
    for uniform: a Newton step by `tip_mass` beside all other unknowns says so.

    Returns:
        [P] by how much the others would change then, and what to say of it; 0 and nothing where
        there is no sign of it.
    """
    prior, scene, compared = problem.prior, problem.scene, found.best.comparison
    nothing, name = np.zeros(len(prior.mean)), "tip_mass"
    one = len(problem.parts) == len(scene.held) == 1 and not scene.static
    rope = scene.kind == "rope" and scene.thin and name not in prior.names
    if not (one and rope) or compared is None:
        return nothing, ()
    more = problem.with_unknown(name)
    at = np.append(found.best.vector, 0.0)
    (heavier,) = more.compare([at], free=[len(prior.names)])
    if heavier is None:
        return nothing, ()
    (one,), (other,) = compared.parts, heavier.parts
    other.J[..., :-1], other.widens[:-1] = one.J, one.widens
    other.warm_start(one)
    gradient, hessian = more.gradient_and_hessian(
        replace(found.best, vector=at, comparison=heavier), found.noise
    )
    step = -np.linalg.solve(hessian, gradient)
    if step[-1] < SUSPICIOUS * math.sqrt(np.linalg.inv(hessian)[-1, -1]):
        return nothing, ()
    # from a heavy tip on: near none other unknowns make up for it
    begin = more.prior.clipped(at + step * more.prior.sd[-1] / step[-1])
    try:
        again = gauss_newton(more, initial=[begin]).best
    except SimulationError:  # it diverges with such a tip
        return nothing, ()
    assert again.comparison is not None
    won = more.value(at, heavier, found.noise)
    won -= more.value(again.vector, again.comparison, found.noise)
    if won < CERTAIN:
        return nothing, ()
    share = float(again.vector[-1])
    said = (
        f"the free end hangs lower than that of a uniform rope, as if {share:.0%} of the mass "
        f"sat there (a knot, a sheath?): estimate it, too, with --also {name}"
    )
    return again.vector[:-1] - found.best.vector, (said,)
