"""`differential-evolution`: a population of parameters, as in R2S2R.

scipy's differential evolution minimises the clouds' misfit with fixed noise plus the prior's (Storn
and Price 1997); a generation is one batch of worlds. Derivatives are taken only at the end, for the
uncertainty. Source: Lim et al. (2022), "Planar robot casting with real2sim2real self-supervised
learning".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from gendom.estimation.likelihood import NoiseModel
from gendom.estimation.methods.search import estimated_noise
from gendom.estimation.problem import Found, Problem, Start

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class DifferentialEvolutionSettings:
    """Of the search; numbers are scipy's own."""

    population: int = 15
    """Members for each unknown."""
    mutation: tuple[float, float] = (0.5, 1.0)
    """Range that the differential weight is drawn from in each generation."""
    recombination: float = 0.7
    """Probability with which an unknown is taken from the mutant."""
    tolerance: float = 0.01
    """The search ends where values of the population deviate by this share of their mean."""
    noise: float = 0.005
    """Of the comparison of clouds [m]."""
    reach: float = 3.0
    """How far from its mean an unknown may lie, in deviations of the prior."""


def differential_evolution(
    problem: Problem, settings: DifferentialEvolutionSettings | None = None
) -> Found:
    """Search for `EstimateSettings.max_iterations` generations at most, and keep the best so far if
    interrupted.

    Raises:
        SimulationError: Nothing of a population can be simulated.
        KeyboardInterrupt: If interrupted before anything was found.
    """
    settings = settings or DifferentialEvolutionSettings()
    prior = problem.prior
    noise = problem.first_noise(
        sensor=settings.noise, model=problem.settings.noise.least_model, rounds=1
    )
    most = problem.settings.max_iterations
    low, high = prior.within(settings.reach)
    middle = prior.vector(*problem.bases)
    best = Start(initial=middle, vector=middle)

    interrupted = False
    try:
        found = optimize.differential_evolution(
            lambda x: _generation(problem, best, noise, x, most),
            list(zip(low, high, strict=True)),
            popsize=settings.population,
            mutation=settings.mutation,
            recombination=settings.recombination,
            tol=settings.tolerance,
            # the first generation is drawn, not evolved
            maxiter=most - 1,
            rng=problem.settings.seed,
            polish=False,
            vectorized=True,
            updating="deferred",
        )
        best.done = bool(found.success)
    except KeyboardInterrupt:
        interrupted = True
        if best.comparison is None:
            raise
    best.comparison = problem.compare([best.vector])[0]
    if best.comparison is None:
        raise problem.nothing_runs()
    return Found(
        best=best,
        starts=[best],
        noise=estimated_noise(best.comparison, problem.first_noise()),
        interrupted=interrupted,
        extra={"generations": best.iterations, "population": settings.population * len(middle)},
    )


def _generation(
    problem: Problem, best: Start, noise: Sequence[NoiseModel], x: Array, most: int
) -> Array:
    """[S] values of a generation of vectors [P, S], of which the best so far is kept in `best`."""
    found = np.full(x.shape[1], math.inf)
    for n, comparison in enumerate(problem.compare(list(x.T), derivatives=False)):
        if comparison is None:
            continue
        found[n] = problem.value(x[:, n], comparison, noise)
        if found[n] < best.value:
            best.vector, best.comparison, best.value = x[:, n].copy(), comparison, found[n]
    best.iterations += 1
    if best.comparison is not None:
        best.history.append((best.iterations, best.vector.copy(), best.comparison.rms))
    problem.tell("evolution", best.iterations, most, best)
    if best.comparison is None:
        raise problem.nothing_runs()
    return found
