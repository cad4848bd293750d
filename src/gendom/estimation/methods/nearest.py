"""The replay that is nearest to the clouds, by differential evolution (Storn and Price 1997).

Mean distances are compared, which, unlike the likelihood, keep their slope far from the clouds and
leave nothing to a displacement of the model. A generation is one batch of worlds. Derivatives are
taken only at the end, for the uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy import optimize

from gendom.arrays import Array
from gendom.estimation.likelihood import Comparison, Comparisons
from gendom.estimation.methods.search import finished
from gendom.estimation.problem import Found, Problem, Start

GENERATIONS = 40
"""Of `nearest`: the mean distance of real cloths then falls by less than 0.1 mm a generation."""

FINALISTS = 20
"""Its best ones of all generations that are simulated as finely as the problem asks for."""

Objective = Callable[[Array, Comparisons], float]


def nearest(problem: Problem, *, generations: int = GENERATIONS) -> Found:
    """The nearest replay; generations of three members an unknown are simulated coarsely.

    Raises:
        SimulationError: Nothing could be simulated.
        KeyboardInterrupt: It was interrupted.
    """
    prior = problem.prior
    best = Start(initial=prior.mean, vector=prior.mean, stage="coarse")
    tried: list[tuple[float, Array]] = []

    def away(vector: Array, comparison: Comparisons) -> float:
        tried.append((sum(map(distance, comparison.parts)) / len(comparison.parts), vector))
        return tried[-1][0]

    evolve(problem.coarse, best, away, 3, generations, tol=0.0)
    finalists = [v for _, v in sorted(tried, key=lambda one: one[0])[:FINALISTS]]
    best.comparison, best.value, best.stage, best.done = None, math.inf, "", True
    _values(best, finalists, problem.compare(finalists, derivatives=False), away)
    return finished(problem, [best], interrupted=False)


def distance(comparison: Comparison) -> float:
    """Mean distance of points from the skin, plus that of skin which should be seen from the points
    [m]."""
    rows, counts = comparison.rows, comparison.observation.counts
    own, away = counts.shape[1], np.abs(rows.rho)
    points = (away[:, :own] * counts).sum(axis=1) / counts.sum(axis=1)
    return float((points + (away * (rows.counts > 0.0))[:, own:].mean(axis=1)).mean())


def evolve(
    problem: Problem, best: Start, of: Objective, members: int, generations: int, tol: float
) -> None:
    """Evolve a population within three deviations of the prior; ``best`` moves with its best."""

    def generation(x: Array) -> Array:
        """[S] values of vectors [P, S]."""
        vectors = list(x.T.copy())
        found = _values(best, vectors, problem.compare(vectors, derivatives=False), of)
        best.iterations += 1
        if best.comparison is None:
            raise problem.nothing_runs()
        best.noted()
        problem.tell(best.stage or "evolution", best.iterations, generations, best)
        return found

    ended = optimize.differential_evolution(
        generation,
        list(zip(*problem.prior.within(3.0), strict=True)),
        popsize=members,
        maxiter=generations - 1,  # the first generation is drawn, not evolved
        rng=problem.settings.seed,
        polish=False,
        vectorized=True,
        updating="deferred",
        tol=tol,
    )
    best.done = bool(ended.success)


def _values(
    best: Start, vectors: Sequence[Array], compared: Sequence[Comparisons | None], of: Objective
) -> Array:
    """[S] values of vectors [P], infinite where nothing runs; the start moves to lower ones."""
    found = np.full(len(vectors), math.inf)
    for n, comparison in enumerate(compared):
        if comparison is not None:
            found[n] = of(vectors[n], comparison)
            if found[n] < best.value:
                best.vector, best.comparison, best.value = vectors[n], comparison, found[n]
    return found
