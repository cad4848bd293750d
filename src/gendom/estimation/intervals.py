"""The posterior of what was found: the likelihood's Gaussian, with what it does not know.

The likelihood's own deviations are wrong, because the simulator is not exact: `python -m
experiments coverage --calibrate` estimates random objects of the second reality and writes, for
each unknown, a factor of its deviations or one to add in squares (`assets/calibration.json`).

Where a recorded object moves otherwise than any simulated one, the likelihood takes the difference
for random. But it may last, like a bend by nature. So a parameter is uncertain by at least the
change that moves the shape by as much, simulated: derivatives of shapes that swing grow with the
stiffness, while large changes of it hardly move them. What the calibration's lifts have, too, does
not count (`IntervalCalibration.displaced`).
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources

import numpy as np

from gendom.arrays import Array
from gendom.estimation.priors import INSTRUMENTED
from gendom.estimation.problem import Found, Part, Problem
from gendom.estimation.replay import middle
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
        """The shipped one of ropes, cables or cloths; of ropes also of the last frame alone."""
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
        factor = np.array([self.factor.get(name, 1.0) for name in prior.names])
        more = np.array([self.added.get(name, 0.0) for name in prior.names])
        wide = prior.sd**2
        inside = np.minimum(own**2, (1.0 - 1e-9) * wide)
        alone = inside * wide / (wide - inside)  # the likelihood's variance without the prior
        worse = factor**2 * alone + more**2
        mean = prior.mean + (wide + alone) / (wide + worse) * (mean - prior.mean)
        sd = np.hypot(np.sqrt(wide * worse / (wide + worse)), added)
        share = np.minimum(sd, np.maximum(prior.sd, own)) / own
        covariance = covariance * share[:, None] * share
        return Posterior(prior=prior, mean=mean, covariance=covariance, bases=tuple(bases))


def posterior_of(
    problem: Problem, found: Found, calibration: IntervalCalibration, added: float | Array = 0.0
) -> Posterior:
    """The posterior of what was found, with further deviations [P] added in squares."""
    covariance = found.covariance
    if covariance is None:
        gradient, hessian = problem.gradient_and_hessian(found.best, found.noise)
        covariance = with_episodes(problem, found, np.linalg.inv(hessian))
        short = problem.scene.kind == "cloth" and not found.best.done
        if problem.settings.method != "gauss-newton" or found.interrupted or short:
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
    prior, vector = problem.prior, found.best.vector
    sd = np.full(len(prior.names), math.inf)
    wanted = np.sqrt(np.diag(covariance)) < IDENTIFIABLE * prior.sd
    wanted &= [UNKNOWNS[name].material and name not in INSTRUMENTED for name in prior.names]
    for k, part in enumerate(problem.parts):
        own = wanted & np.isin(np.arange(len(sd)), part.shown)
        changes = _changes(problem, vector, k, own, _unexplained(found, part, k, calibration))
        sd[part.shown] = np.minimum(sd, changes)[part.shown]
    return np.where(np.isfinite(sd), sd, 0.0)


def _unexplained(
    found: Found, part: Part, recording: int, calibration: IntervalCalibration
) -> float:
    """Displacement of the model beyond that of lifts with known truth, of a coordinate [m]."""
    noise = found.noise[recording]
    if part.scene.static:
        # repeats of one shape average the sensor's noise, not what is wrong with the shape
        return found.best.compared.parts[recording].fit(noise).rms
    usual = calibration.displaced * part.scene.size if len(part.scene.held) == 1 else 0.0
    return math.sqrt(max(noise.model**2 - max(usual, noise.least_model) ** 2, 0.0))


def _changes(problem: Problem, vector: Array, recording: int, wanted: Array, by: float) -> Array:
    """[P] of each unknown that is wanted [P] the change beyond which every larger one, up or down,
    moves the shape by more than this, root mean square of a coordinate [m]; at most the prior's
    deviation. A world that diverges or lies beyond the range of the search says nothing."""
    prior, scene, found = problem.prior, problem.parts[recording].coarser, np.zeros(len(vector))
    going = np.flatnonzero(wanted & (by > 0.0))
    larger = np.tile([[by], [1.0]], len(vector))
    for share in (*SHARES[::-1], 0.0):  # most unknowns end with the largest
        moved = np.zeros(len(going))
        if share > 0.0 and len(going):
            worlds = np.tile(vector, (2, len(going), 1))
            ways = np.array([[-share], [share]]) * prior.sd[going]
            worlds[:, np.arange(len(going)), going] += ways
            every = [vector, *prior.clipped(worlds).reshape(-1, len(vector))]
            x = middle(scene, problem.positions(every, recording, scene))
            off = np.sqrt(np.mean((x[:, 1:] - x[:, :1]) ** 2, axis=(0, 2, 3))).reshape(2, -1)
            says = (worlds == prior.clipped(worlds)).all(axis=2) & np.isfinite(off)
            # in the direction that moves it less
            moved = np.where(says, off, np.inf).min(axis=0)
        for p, least in zip(going, moved, strict=True):
            between = [least, larger[0, p]], [share, larger[1, p]]
            found[p] = prior.sd[p] * np.interp(by, *between) if least < by else 0.0
        larger[:, going], going = (moved, np.full(len(going), share)), going[moved >= by]
    return found


def with_episodes(problem: Problem, found: Found, covariance: Array) -> Array:
    """[P, P] covariance, no smaller than what parts of markers' motion say of each other.

    A cable that swings as no simulated one does pulls parameters one way for some tenths of a
    second, then another way. How strong these pulls are is seen, without a model of their cause
    (Huber 1967, "The behavior of maximum likelihood estimates under nonstandard conditions").
    """
    total, compared = np.zeros(covariance.shape), found.best.compared.parts
    for part, own, noise in zip(problem.parts, compared, found.noise, strict=True):
        if part.scene.captured:
            parts = np.array_split(own.fit(noise).pulls, EPISODES)
            sums = np.stack([pulls.sum(axis=0) for pulls in parts])
            total[np.ix_(part.shown, part.shown)] += sums.T @ sums
    times = np.diag(covariance @ total @ covariance) / np.diag(covariance)
    share = np.sqrt(np.maximum(times, 1.0))
    return covariance * share[:, None] * share


def with_fingers(problem: Problem, found: Found, covariance: Array) -> Array:
    """[P, P] covariance, where ropes that turn in the fingers do not turn just as their moment."""
    prior = problem.prior
    for k in np.flatnonzero(np.array(prior.names) == "grip_turn"):
        # what a quarter of the turn does to the others
        moved = covariance[k] / covariance[k, k] * 0.25 * found.best.vector[k]
        moved = np.clip(moved, -prior.sd, prior.sd)
        covariance = covariance + np.outer(moved, moved)
    return covariance


def told_apart(problem: Problem, found: Found) -> tuple[str, ...]:
    """What to say where starts have ended apart."""
    ends = [problem.theta(v) for v in (found.best.vector, *found.others)]
    bends = [problem.scene.bending_length(t.E_over_rho, t.thickness) for t in ends]
    what = "starts end apart and fit about as well, with bending lengths of"
    texts = ", ".join(f"{b:.4g}" for b in bends)
    return (f"{what} {texts} m: the intervals hold all of them",) if found.others else ()
