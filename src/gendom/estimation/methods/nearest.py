"""The replay that is nearest to the clouds, found by an evolution strategy over the whole prior.

Covariance matrix adaptation with a weighted recombination of the better half (Hansen 2016, "The CMA
evolution strategy: a tutorial", with its default rates). It compares mean distances, which, unlike
the likelihood, keep their slope far from the clouds and leave nothing to a displacement of the
model.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from gendom.arrays import Array
from gendom.estimation.likelihood import Comparison, Comparisons
from gendom.estimation.methods.search import finished
from gendom.estimation.problem import Found, Problem, Start

GENERATIONS = 40
"""The mean distance of real cloths then falls by less than 0.1 mm a generation."""

FINALISTS = 20
"""Best ones of all generations that are simulated as finely as the problem asks for."""


def nearest(problem: Problem, *, generations: int = GENERATIONS) -> Found:
    """The nearest replay; generations of three members an unknown are simulated coarsely.

    Raises:
        SimulationError: Nothing could be simulated.
        KeyboardInterrupt: It was interrupted.
    """
    prior = problem.prior
    low, high = prior.within(3.0)
    best = Start(initial=prior.mean, vector=prior.mean, stage="coarse")
    tried: list[tuple[float, Array]] = []

    def distances(steps: Array) -> Array:
        """Of a generation [S, P], in deviations from the mean."""
        vectors = np.clip(prior.mean + steps * prior.sd, low, high)
        found = _tried(best, vectors, problem.coarse.compare(list(vectors), derivatives=False))
        tried.extend(zip(found, vectors, strict=True))
        best.iterations += 1
        if best.comparison is not None:
            best.noted()
        problem.tell("nearest", best.iterations, generations, best)
        return found

    adapted(
        distances,
        0.5 * np.ones(len(prior.mean)),
        population=3 * len(prior.mean),
        generations=generations,
        rng=np.random.default_rng(problem.settings.seed),
    )
    finalists = np.array([v for _, v in sorted(tried, key=lambda one: one[0])[:FINALISTS]])
    best.comparison, best.value, best.stage, best.done = None, math.inf, "", True
    _tried(best, finalists, problem.compare(list(finalists), derivatives=False))
    return finished(problem, [best], interrupted=False)


def _tried(best: Start, vectors: Array, compared: list[Comparisons | None]) -> Array:
    """[S] distances of vectors [S, P], infinite where nothing could be simulated; the start moves
    to a place that is nearer."""
    found = np.full(len(vectors), math.inf)
    for n, comparison in enumerate(compared):
        if comparison is not None:
            found[n] = sum(map(distance, comparison.parts)) / len(comparison.parts)
            if found[n] < best.value:
                best.vector, best.comparison, best.value = vectors[n], comparison, found[n]
    return found


def distance(comparison: Comparison) -> float:
    """Mean distance of points from the skin, plus that of skin which should be seen from the points
    [m]."""
    rows, counts = comparison.rows, comparison.observation.counts
    own, away = counts.shape[1], np.abs(rows.rho)
    points = (away[:, :own] * counts).sum(axis=1) / counts.sum(axis=1)
    return float((points + (away * (rows.counts > 0.0))[:, own:].mean(axis=1)).mean())


def adapted(
    function: Callable[[Array], Array],
    deviations: Array,
    *,
    population: int,
    generations: int,
    rng: np.random.Generator,
) -> Array:
    """[P] the mean of the last generation of a search for a function's least value.

    Args:
        function: From [population, P] places to their values; infinite where there is none.
        deviations: [P] of the first population, about 0.
        population: Places of a generation.
        generations: Number of them.
        rng: Draws them.
    """
    P, half = len(deviations), population // 2
    weights = math.log(half + 0.5) - np.log(np.arange(1, half + 1))
    weights /= weights.sum()
    effective = 1.0 / float((weights**2).sum())
    # rates of the two paths, of the covariance by one path and by the better half, of the step size
    fades = (effective + 2.0) / (P + effective + 5.0)
    turns = (4.0 + effective / P) / (P + 4.0 + 2.0 * effective / P)
    one = 2.0 / ((P + 1.3) ** 2 + effective)
    many = min(1.0 - one, 2.0 * (effective - 2.0 + 1.0 / effective) / ((P + 2.0) ** 2 + effective))
    damped = 1.0 + 2.0 * max(0.0, math.sqrt((effective - 1.0) / (P + 1.0)) - 1.0) + fades
    usual = math.sqrt(P) * (1.0 - 1.0 / (4.0 * P) + 1.0 / (21.0 * P**2))

    mean, size, C = np.zeros(P), 1.0, np.diag(deviations**2)
    size_path, path = np.zeros(P), np.zeros(P)
    for generation in range(generations):
        values, axes = np.linalg.eigh(C)
        scales = np.sqrt(np.maximum(values, 1e-20))
        steps = (rng.standard_normal((population, P)) * scales) @ axes.T
        found = function(mean + size * steps)
        order = np.argsort(found)
        better = steps[order[:half]]
        step = weights @ better
        mean = mean + size * step
        size_path = (1.0 - fades) * size_path
        size_path += math.sqrt(fades * (2.0 - fades) * effective) * (
            axes @ (axes.T @ step / scales)
        )
        long = float(np.linalg.norm(size_path))
        expected = usual * math.sqrt(1.0 - (1.0 - fades) ** (2 * (generation + 1)))
        straight = long < (1.4 + 2.0 / (P + 1.0)) * expected
        path = (1.0 - turns) * path
        if straight:
            path += math.sqrt(turns * (2.0 - turns) * effective) * step
        kept = 1.0 - one - many + (0.0 if straight else one * turns * (2.0 - turns))
        C = kept * C + one * np.outer(path, path) + many * (weights * better.T) @ better
        size *= math.exp(fades / damped * (long / usual - 1.0))
    return mean
