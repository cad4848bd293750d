"""The posterior of what was found: the likelihood's Gaussian, with what it does not know.

The likelihood's own deviations are wrong, because the simulator is not exact. The calibration comes
from lifts whose true parameters are known: `python -m experiments coverage --calibrate` records
random objects in the second reality, estimates them and writes, for each unknown, the factor of its
deviations or the deviation to add in squares, in the form of `assets/calibration.json`.

Where a recorded object moves otherwise than any simulated one, the likelihood takes the difference
for random: it averages it over frames and becomes sure of the parameters that imitate it best. But
it may be the same throughout, like a bend that the real object has by nature. So a parameter is
uncertain by at least the change that moves the shape by as much as is not explained. The change is
simulated, not extrapolated from derivatives: shapes that swing have derivatives that grow with the
stiffness, while large changes of it hardly move them. Only what exceeds the differences of the
calibration's lifts counts (`IntervalCalibration.displaced`).
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources

import numpy as np

from gendom.arrays import Array
from gendom.errors import SimulationError
from gendom.estimation.methods.gauss_newton import gauss_newton
from gendom.estimation.priors import INSTRUMENTED
from gendom.estimation.problem import Found, Part, Problem
from gendom.estimation.verdict import displaced
from gendom.materials.posterior import IDENTIFIABLE, Posterior, Prior
from gendom.materials.unknowns import UNKNOWNS, Theta

SHARES = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, IDENTIFIABLE)
"""Of the prior's deviation: changes that are simulated, both ways. Beyond the last the recording
does not determine a parameter."""

EPISODES = 10
"""Parts of a motion capture that pull parameters independently of each other."""


@dataclass(frozen=True, kw_only=True)
class IntervalCalibration:
    """Calibration of intervals for one kind of object: factors of the likelihood's standard
    deviations, and what is added to them in squares."""

    factor: Mapping[str, float] = field(default_factory=dict)
    added: Mapping[str, float] = field(default_factory=dict)
    displaced: float = math.inf
    """Up to which displacement of the model, over the object's size, it holds."""

    @classmethod
    @functools.cache
    def of(cls, kind: str, frames: str = "all") -> IntervalCalibration:
        """The shipped one of ropes, cables or cloths, of all frames or, of ropes, of the last one
        alone."""
        place = resources.files("gendom") / "assets" / "calibration.json"
        every = json.loads(place.read_text(encoding="utf-8"))
        read = every.get(f"{kind}-{frames}", every[kind])
        return cls(factor=read["factor"], added=read["added"], displaced=read["displaced"])

    def posterior(
        self,
        prior: Prior,
        mean: Array,
        covariance: Array,
        bases: Sequence[Theta],
        added: Array | float = 0.0,
    ) -> Posterior:
        """The Gaussian of likelihood times prior with calibrated deviations, and further ones [P]
        added in squares; they are at most those of the prior.

        Both the factor and what is added are errors of the likelihood alone: the less it says, the
        nearer to the prior's mean the posterior's is.
        """
        own = np.sqrt(np.diag(covariance))
        factor, more = (
            np.array([by.get(name, usual) for name in prior.names])
            for by, usual in ((self.factor, 1.0), (self.added, 0.0))
        )
        wide = prior.sd**2
        inside = np.minimum(own**2, (1.0 - 1e-9) * wide)
        alone = inside * wide / (wide - inside)  # the likelihood's variance without the prior
        worse = factor**2 * alone + more**2
        mean = prior.mean + (wide + alone) / (wide + worse) * (mean - prior.mean)
        sd = np.hypot(np.sqrt(wide * worse / (wide + worse)), added)
        share = np.minimum(sd, np.maximum(prior.sd, own)) / own
        return Posterior(
            prior=prior,
            mean=mean,
            covariance=covariance * share[:, None] * share,
            bases=tuple(bases),
        )


def posterior_of(
    problem: Problem,
    found: Found,
    calibration: IntervalCalibration,
    added: float | Array = 0.0,
) -> Posterior:
    """The posterior of what was found, with further deviations [P] added in squares."""
    covariance = found.covariance
    if covariance is None:
        gradient, hessian = problem.gradient_and_hessian(found.best, found.noise)
        covariance = with_episodes(problem, found, np.linalg.inv(hessian))
        if problem.settings.method != "gauss-newton" or found.interrupted:
            # other searches minimise something else, or end before the likelihood is greatest
            added = np.hypot(added, np.abs(np.linalg.solve(hessian, gradient)))
    covariance = with_fingers(problem, found, covariance)
    for other in found.others:
        added = np.maximum(added, np.abs(other - found.best.vector))
    # what moves otherwise than any simulated object gets no intervals
    if not any(displaced(p, n) for p, n in zip(problem.parts, found.noise, strict=True)):
        added = np.hypot(added, discrepancy(problem, found, covariance, calibration))
    error = problem.scene.mesh_error(problem.theta(found.best.vector))
    added = np.hypot(added, error * (np.array(problem.prior.names) == "E_over_rho"))
    return calibration.posterior(problem.prior, found.best.vector, covariance, problem.bases, added)


def discrepancy(
    problem: Problem, found: Found, covariance: Array, calibration: IntervalCalibration
) -> Array:
    """[P] deviations of the transformed unknowns by unexplained displacements, at most those of the
    prior; 0 where there is no more of it than in lifts with known truth, or the likelihood's
    covariance [P, P] does not determine them. Of several recordings the best one counts: their
    errors need not be independent."""
    prior = problem.prior
    sd = np.full(len(prior.names), math.inf)
    wanted = np.sqrt(np.diag(covariance)) < IDENTIFIABLE * prior.sd
    wanted &= [UNKNOWNS[name].material and name not in INSTRUMENTED for name in prior.names]
    for k, part in enumerate(problem.parts):
        excess = _unexplained(found, part, k, calibration)
        for p in part.shown:
            change = wanted[p] and excess > 0.0
            own = _change(problem, found.best.vector, k, int(p), excess) if change else 0.0
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
    changes = float(problem.prior.sd[p]) * np.array(SHARES)
    moved = _moved(problem, vector, recording, p, changes)
    n = int(np.flatnonzero(np.append(True, moved < by))[-1])
    if n == len(changes):
        return float(problem.prior.sd[p])
    # linear between changes that were simulated, and from none on
    moved, changes = np.append(0.0, moved), np.append(0.0, changes)
    share = (by - moved[n]) / (moved[n + 1] - moved[n])
    return float(changes[n] + share * (changes[n + 1] - changes[n]))


def _moved(problem: Problem, vector: Array, recording: int, p: int, changes: Array) -> Array:
    """[k] how far shapes move with changes [k] of unknown p in the direction that moves them less
    [m]. A world that diverges or lies beyond the range of the search says nothing."""
    prior, part = problem.prior, problem.parts[recording]
    scene = part.coarser if part.scene.kind == "rope" else part.scene
    ends = vector[p] + np.array([[-1.0], [1.0]]) * changes
    inside = (ends >= prior.low[p]) & (ends <= prior.high[p])
    worlds = [vector]
    for end in np.clip(ends, prior.low[p], prior.high[p]).ravel():
        worlds.append(np.where(np.arange(len(vector)) == p, end, vector))
    x = problem.positions(worlds, recording, scene)
    off = np.sqrt(np.mean((x[:, 1:] - x[:, :1]) ** 2, axis=(0, 2, 3))).reshape(2, -1)
    return np.where(inside & np.isfinite(off), off, np.inf).min(axis=0)


def with_episodes(problem: Problem, found: Found, covariance: Array) -> Array:
    """[P, P] covariance, no smaller than what parts of markers' motion say of each other.

    A cable that swings as no simulated one does pulls parameters one way for some tenths of a
    second, then another way. How strong these pulls are is seen, without a model of their cause
    (Huber 1967, "The behavior of maximum likelihood estimates under nonstandard conditions").
    """
    total, compared = np.zeros(covariance.shape), found.best.comparison
    assert compared is not None
    for part, own, noise in zip(problem.parts, compared.parts, found.noise, strict=True):
        if part.scene.captured:
            parts = np.array_split(own.pulls(noise), EPISODES)
            sums = np.stack([pulls.sum(axis=0) for pulls in parts])
            total[np.ix_(part.shown, part.shown)] += sums.T @ sums
    times = np.diag(covariance @ total @ covariance) / np.diag(covariance)
    share = np.sqrt(np.maximum(times, 1.0))
    return covariance * share[:, None] * share


def with_fingers(problem: Problem, found: Found, covariance: Array) -> Array:
    """[P, P] covariance, where ropes that turn in the fingers do not turn just as their moment."""
    prior = problem.prior
    for k, name in enumerate(prior.names):
        if name == "grip_turn":
            # what a quarter of the turn does to the others
            moved = covariance[k] / covariance[k, k] * 0.25 * found.best.vector[k]
            moved = np.clip(moved, -prior.sd, prior.sd)
            covariance = covariance + np.outer(moved, moved)
    return covariance


def told_apart(problem: Problem, found: Found) -> tuple[str, ...]:
    """What to say where starts have ended apart."""
    ends = [problem.theta(v) for v in (found.best.vector, *found.others)]
    bends = [problem.scene.bending_length(t.E_over_rho, t.thickness) for t in ends]
    texts = ", ".join(f"{b:.4g}" for b in bends)
    what = f"starts end apart and fit about as well, with bending lengths of {texts} m"
    return (f"{what}: the intervals hold all of them",) if found.others else ()


def tip_suspected(problem: Problem, found: Found) -> tuple[Array, tuple[str, ...]]:
    """Whether clouds look as if a rope's free end was heavier than the rest, which the search took
    for uniform: a Newton step by `tip_mass` beside all other unknowns says so.

    Returns:
        [P] by how much the others would change then, and what to say of it; 0 and nothing where
        there is no sign of it.
    """
    prior, scene, name = problem.prior, problem.scene, "tip_mass"
    one = len(problem.parts) == len(scene.held) == 1 and not scene.static
    rope = scene.kind == "rope" and name not in prior.names
    heavier = _heavier(problem, found) if one and rope else None
    if heavier is None:
        return np.zeros(len(prior.mean)), ()
    share = float(heavier[-1])
    said = (
        f"the free end hangs lower than that of a uniform rope, as if {share:.0%} of the mass "
        f"sat there (a knot, a sheath?): estimate it, too, with --also {name}"
    )
    return heavier[:-1] - found.best.vector, (said,)


def _heavier(problem: Problem, found: Found) -> Array | None:
    """[P + 1] the result with a heavier tip as the last unknown, None where it is no better."""
    more, compared = problem.with_unknown("tip_mass"), found.best.comparison
    at = np.append(found.best.vector, 0.0)
    (heavier,) = more.compare([at], free=[len(at) - 1])
    if heavier is None or compared is None:
        return None
    (one,), (other,) = compared.parts, heavier.parts
    other.J[..., :-1], other.widens[:-1] = one.J, one.widens
    other.warm_start(one)
    start = replace(found.best, vector=at, comparison=heavier)
    gradient, hessian = more.gradient_and_hessian(start, found.noise)
    step = -np.linalg.solve(hessian, gradient)
    if step[-1] < math.sqrt(np.linalg.inv(hessian)[-1, -1]):
        return None  # less than a deviation
    # from a heavy tip on: near none other unknowns make up for it
    begin = more.prior.clipped(at + step * more.prior.sd[-1] / step[-1])
    try:
        again = gauss_newton(more, initial=[begin]).best
    except SimulationError:  # it diverges with such a tip
        return None
    assert again.comparison is not None
    won = more.value(at, heavier, found.noise)
    won -= more.value(again.vector, again.comparison, found.noise)
    return again.vector if won >= 9.0 else None  # the square of three deviations
