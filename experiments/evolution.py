"""`differential-evolution`: a population without derivatives (Storn and Price 1997), by scipy with
its own rates, that minimises the clouds' misfit with fixed noise plus the prior's, as R2S2R
(Lim et al. 2022, "Planar robot casting with real2sim2real self-supervised learning").
"""

from __future__ import annotations

import numpy as np

from gendom.estimation.likelihood import Comparisons
from gendom.estimation.methods.nearest import evolve
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
    noise = problem.first_noise(sensor=0.005, model=problem.settings.noise.least_model, rounds=1)
    middle = problem.prior.vector(*problem.bases)
    best, interrupted = Start(initial=middle, vector=middle), False

    def misfit(vector: np.ndarray, comparison: Comparisons) -> float:
        return problem.value(vector, comparison, noise)

    try:
        evolve(problem, best, misfit, members, problem.settings.max_iterations, tol=0.01)
    except KeyboardInterrupt:
        interrupted = True
        if best.comparison is None:
            raise
    return finished(problem, [best], interrupted)
