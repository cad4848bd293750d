"""The replay that is nearest to the clouds, found by an evolution strategy over the whole prior.

Covariance matrix adaptation with a weighted recombination of the better half (Hansen 2016, "The CMA
evolution strategy: a tutorial", with its default rates). It compares mean distances, which, unlike
the likelihood, keep their slope far from the clouds and leave nothing to a displacement of the
model.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gendom.estimation.likelihood import Comparisons
from gendom.estimation.problem import Problem, Start

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class NearestSettings:
    """How the evolution strategy searches."""

    population: int = 3
    """Members for each unknown."""
    generations: int = 40
    """The mean distance of real cloths then falls by less than 0.1 mm a generation."""
    width: float = 0.5
    """Deviations of the first population, in those of the prior."""
    reach: float = 3.0
    """How far from its mean an unknown may lie, in deviations of the prior."""
    finalists: int = 20
    """Best ones of all generations that are simulated as finely as the problem asks for."""


def nearest(problem: Problem, settings: NearestSettings | None = None) -> Start:
    """The nearest replay, with derivatives; generations are simulated coarsely.

    Raises:
        SimulationError: Nothing could be simulated.
    """
    settings, prior = settings or NearestSettings(), problem.prior
    low, high = prior.within(settings.reach)
    best = Start(initial=prior.mean, vector=prior.mean)
    tried: list[tuple[float, Array]] = []

    def distances(steps: Array) -> Array:
        """Of a generation [S, P], in deviations from the mean."""
        vectors = np.clip(prior.mean + steps * prior.sd, low, high)
        compared = problem.coarse.compare(list(vectors), derivatives=False)
        for vector, comparison in zip(vectors, compared, strict=True):
            if comparison is not None:
                _keep(best, vector, comparison)
                tried.append((comparison.distance, vector))
        best.iterations += 1
        if best.comparison is not None:
            best.history.append((best.iterations, best.vector, best.comparison.rms))
        problem.tell("nearest", best.iterations, settings.generations, best)
        return np.array([math.inf if c is None else c.distance for c in compared])

    adapted(
        distances,
        settings.width * np.ones(len(prior.mean)),
        population=settings.population * len(prior.mean),
        generations=settings.generations,
        rng=np.random.default_rng(problem.settings.seed),
    )
    finalists = [v for _, v in sorted(tried, key=lambda one: one[0])[: settings.finalists]]
    best.comparison, best.value = None, math.inf
    for vector, comparison in zip(
        finalists, problem.compare(finalists, derivatives=False), strict=True
    ):
        if comparison is not None:
            _keep(best, vector, comparison)
    best.comparison = problem.compare([best.vector])[0]
    if best.comparison is None:
        raise problem.nothing_runs()
    best.coarse, best.done, best.exact = best.iterations, True, True
    return best


def _keep(best: Start, vector: Array, comparison: Comparisons) -> None:
    """Move a start to a place that is nearer."""
    if comparison.distance < best.value:
        best.vector, best.comparison, best.value = vector, comparison, comparison.distance


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
