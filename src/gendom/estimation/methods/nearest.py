"""The replay that is nearest to the clouds, by differential evolution (Storn and Price 1997).

Mean distances are compared, which, unlike the likelihood, keep their slope far from the clouds and
leave nothing to a displacement of the model. A generation is one batch of worlds. Derivatives are
taken only at the end, for the uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import optimize

from gendom.arrays import Array
from gendom.estimation.likelihood import Comparison
from gendom.estimation.methods.search import finished
from gendom.estimation.problem import Found, Problem, Start

GENERATIONS = 40
"""The mean distance of real cloths then falls by less than 0.1 mm a generation."""

FINALISTS = 20
"""The best ones of all generations that are simulated as finely as the problem asks for."""


def nearest(problem: Problem, *, generations: int = GENERATIONS) -> Found:
    """The nearest replay within three deviations of the prior; generations of three members an
    unknown are simulated coarsely.

    Raises:
        SimulationError: Nothing could be simulated.
        KeyboardInterrupt: It was interrupted.
    """
    prior, tried = problem.prior, []
    best = Start(initial=prior.mean, vector=prior.mean)

    def away(problem: Problem, vectors: Sequence[Array]) -> Array:
        """[S] distances at vectors [P], infinite where nothing runs; the best start moves."""
        found = np.full(len(vectors), math.inf)
        for n, compared in enumerate(problem.compare(vectors, derivatives=False)):
            if compared is not None:
                found[n] = sum(map(distance, compared.parts)) / len(compared.parts)
                if found[n] < best.value:
                    best.vector, best.comparison, best.value = vectors[n], compared, found[n]
        return found

    def generation(x: Array) -> Array:
        """[S] distances at vectors [P, S]."""
        found = away(problem.coarse, list(x.T.copy()))
        tried.extend(zip(found.tolist(), x.T.copy(), strict=True))
        best.iterations += 1
        if best.comparison is None:
            raise problem.nothing_runs()
        problem.tell("coarse", best.iterations, generations, best)
        return found

    optimize.differential_evolution(
        generation,
        list(zip(*prior.within(3.0), strict=True)),
        popsize=3,
        maxiter=generations - 1,  # the first generation is drawn, not evolved
        rng=problem.settings.seed,
        polish=False,
        vectorized=True,
        updating="deferred",
        tol=0.0,
    )
    best.comparison, best.value, best.done = None, math.inf, True
    away(problem, [v for _, v in sorted(tried, key=lambda one: one[0])[:FINALISTS]])
    return finished(problem, [best], interrupted=False)


def distance(comparison: Comparison) -> float:
    """Mean distance of points from the skin, plus that of skin which should be seen from the points
    [m]."""
    rows, counts = comparison.rows, comparison.observation.counts
    own, away = counts.shape[1], np.abs(rows.rho)
    points = (away[:, :own] * counts).sum(axis=1) / counts.sum(axis=1)
    return float((points + (away * (rows.counts > 0.0))[:, own:].mean(axis=1)).mean())
