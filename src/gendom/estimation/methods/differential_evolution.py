"""`differential-evolution`: a population of parameters, as in R2S2R.

scipy's differential evolution, with its own rates, minimises the clouds' misfit with fixed noise
plus the prior's (Storn and Price 1997); a generation is one batch of worlds. Derivatives are taken
only at the end, for the uncertainty. Source: Lim et al. (2022), "Planar robot casting with
real2sim2real self-supervised learning".
"""

from __future__ import annotations

import math

import numpy as np
from scipy import optimize

from gendom.arrays import Array
from gendom.estimation.methods.search import finished
from gendom.estimation.problem import Found, Problem, Start


def differential_evolution(problem: Problem, *, members: int = 15) -> Found:
    """Search, and keep the best so far if interrupted.

    Args:
        problem: What is looked for.
        members: Of the population, for each unknown.

    Raises:
        SimulationError: Nothing of a population can be simulated.
        KeyboardInterrupt: If interrupted before anything was found.
    """
    prior, most = problem.prior, problem.settings.max_iterations
    noise = problem.first_noise(sensor=0.005, model=problem.settings.noise.least_model, rounds=1)
    middle = prior.vector(*problem.bases)
    best = Start(initial=middle, vector=middle)

    def generation(x: Array) -> Array:
        """[S] values of vectors [P, S]; the best so far is kept in `best`."""
        found = np.full(x.shape[1], math.inf)
        for n, comparison in enumerate(problem.compare(list(x.T), derivatives=False)):
            if comparison is None:
                continue
            found[n] = problem.value(x[:, n], comparison, noise)
            if found[n] < best.value:
                best.vector, best.comparison, best.value = x[:, n].copy(), comparison, found[n]
        best.iterations += 1
        if best.comparison is None:
            raise problem.nothing_runs()
        best.noted()
        problem.tell("evolution", best.iterations, most, best)
        return found

    interrupted = False
    try:
        ended = optimize.differential_evolution(
            generation,
            list(zip(*prior.within(3.0), strict=True)),
            popsize=members,
            maxiter=most - 1,  # the first generation is drawn, not evolved
            rng=problem.settings.seed,
            polish=False,
            vectorized=True,
            updating="deferred",
        )
        best.done = bool(ended.success)
    except KeyboardInterrupt:
        interrupted = True
        if best.comparison is None:
            raise
    return finished(problem, [best], interrupted)
