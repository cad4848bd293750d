"""The replay that is nearest to the clouds, found by differential evolution over the whole prior.

It compares mean distances (Storn and Price 1997, with scipy's rates), which, unlike the likelihood,
keep their slope far from the clouds and leave nothing to a displacement of the model.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import optimize

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
    best = Start(initial=prior.mean, vector=prior.mean, stage="coarse")
    tried: list[tuple[float, Array]] = []

    def distances(x: Array) -> Array:
        """Of a generation [P, S]."""
        vectors = x.T.copy()
        found = _tried(best, vectors, problem.coarse.compare(list(vectors), derivatives=False))
        tried.extend(zip(found, vectors, strict=True))
        best.iterations += 1
        if best.comparison is not None:
            best.noted()
        problem.tell("nearest", best.iterations, generations, best)
        return found

    optimize.differential_evolution(
        distances,
        list(zip(*prior.within(3.0), strict=True)),
        popsize=3,
        maxiter=generations - 1,  # the first generation is drawn, not evolved
        rng=problem.settings.seed,
        polish=False,
        vectorized=True,
        updating="deferred",
        tol=0.0,
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
