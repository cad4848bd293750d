"""Common parts of the methods: starting points, the best start, the noise of a fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gendom.arrays import Array
from gendom.estimation.likelihood import Comparisons
from gendom.estimation.observed import NoiseModel
from gendom.estimation.problem import Problem, Start

TURNS, FRICTIONS = (0.08, 0.2), (0.2, 0.8)
"""Of a rope in one hand: turns of stiff ones in soft fingers [rad], which look like a smaller
modulus, and frictions of limp ones, which end where their tails have slid."""

LIMP = 0.25
"""Bending length from which a rope is a stiff one, in its length."""


def first_starts(
    problem: Problem, scanned: int, initial: Sequence[Array] = ()
) -> tuple[Problem, list[Start]]:
    """Starting points: the best of a scan of so many moduli over the whole range with few points,
    and random points about it; of a rope in one hand the best ones of a second scan, with the
    problem as fine as a limp one needs. Or those where to begin instead, [P] transformed."""
    if initial:
        return problem, [Start(initial=v, vector=v) for v in initial]
    prior, rng = problem.prior, np.random.default_rng(problem.settings.seed)
    middle, k = prior.vector(*problem.bases), None
    found = [middle]
    if "E_over_rho" in prior.names:
        k = prior.names.index("E_over_rho")
        scan = np.linspace(prior.low[k], prior.high[k], scanned + 2)[1:-1]
        found = _scanned(problem.coarse, k, scan)
        if problem.lifted_rope:
            finer = problem.finer(found[0])
            if finer is not problem:
                return first_starts(finer, scanned)
            found = _scanned_about(problem.coarse, k, scan[1] - scan[0], found[0])
            return problem, [Start(initial=v, vector=v) for v in found[: problem.settings.starts]]
    begins = found[:1]
    while len(begins) < problem.settings.starts:
        drawn = prior.mean + prior.sd * np.sign(prior.step) * rng.standard_normal(len(middle))
        if k is not None:
            # one of the better half of the scan: beyond, shapes hardly depend on the modulus
            drawn[k] = found[rng.integers(1, max(2, len(found) // 2))][k]
        begins.append(prior.clipped(drawn))
    return problem, [Start(initial=v, vector=v) for v in begins]


def _scanned(problem: Problem, k: int, scan: Array) -> list[Array]:
    """[P] vectors with each modulus [S] of a scan as unknown k, the best ones first: with each
    modulus every recording takes its own best guess, then the next best."""
    prior, parts = problem.prior, problem.parts
    guesses, bases = [part.scene.guesses for part in parts], []
    most = max(map(len, guesses))
    for n in range(most):
        own = zip(problem.bases, guesses, strict=True)
        bases.append(prior.vector(*(b.with_values(g[n % len(g)]) for b, g in own)))
    vectors = np.repeat(np.array(bases)[:, None], len(scan), axis=1)
    vectors[:, :, k] = scan
    found = problem.compare(list(vectors.reshape(-1, len(bases[0]))), derivatives=False)
    none = [np.inf] * len(parts)
    rms = np.array([none if c is None else [one.rms for one in c.parts] for c in found])
    rms = rms.T.reshape(len(parts), most, len(scan))
    order = np.argsort(rms, axis=1, kind="stable")
    for recording in range(len(parts)):
        own = [n for n, owner in enumerate(prior.owners) if owner == recording]
        chosen = np.take_along_axis(vectors, order[recording][..., None], axis=0)
        vectors = np.where(np.isin(np.arange(vectors.shape[2]), own), chosen, vectors)
    total = np.square(np.take_along_axis(rms, order, axis=1)).sum(axis=0)
    if problem.captured:
        # before clamps are found, stiff cables fit a little better: of what is alike the softest
        total = np.maximum(total, 1.08**2 * total.min())
    return list(vectors.reshape(-1, vectors.shape[2])[np.argsort(total, axis=None, kind="stable")])


def _scanned_about(problem: Problem, k: int, step: float, best: Array) -> list[Array]:
    """[P] vectors in half steps about the best one of a scan of unknown k, and with other turns or
    frictions; those first that fit best, no two of them alike."""
    prior, scene, theta = problem.prior, problem.scene, problem.theta(best)
    stiff = scene.bending_length(theta.E_over_rho, theta.thickness) > LIMP * scene.size
    name, values = ("grip_turn", TURNS) if stiff else ("friction", FRICTIONS)
    ways = step * (np.arange(-0.5, 2.1, 0.5) if stiff else np.arange(-1.5, 1.6, 0.5))
    vectors = np.repeat(best[None], len(ways) * (1 + len(values)), axis=0)
    vectors[:, k] += np.tile(ways, 1 + len(values))
    if name in prior.names:
        j = prior.names.index(name)
        vectors[:, j] = np.repeat([best[j], *values], len(ways))
    vectors = np.unique(prior.clipped(vectors), axis=0)
    compared = problem.compare(list(vectors), derivatives=False)
    rms = [np.inf if c is None else c.rms for c in compared]
    found: list[Array] = []
    for v in vectors[np.argsort(rms, kind="stable")]:
        if all(abs(v[k] - other[k]) > 0.6 * step for other in found):
            found.append(v)
    return found


def best_of(starts: Sequence[Start]) -> Start | None:
    """The start with the least value, None where none could be simulated."""
    tried = [s for s in starts if s.comparison is not None]
    return min(tried, key=lambda s: s.value) if tried else None


def estimated_noise(comparison: Comparisons, noise: Sequence[NoiseModel]) -> tuple[NoiseModel, ...]:
    """Maximum likelihood noise of each recording: two registrations, each with `Fit.updated_noise`;
    of markers in motion `Fit.correlated_noise`."""
    found = list(noise)
    for k, part in enumerate(comparison.parts):
        for _ in range(2):
            fit, captured = part.fit(found[k]), part.observation.scene.captured
            found[k] = fit.correlated_noise() if captured else fit.updated_noise()
    return tuple(found)
