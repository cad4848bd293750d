"""`differential-evolution`: a population without derivatives (Storn and Price 1997), by scipy with
its own rates, that minimises the clouds' misfit with fixed noise plus the prior's, as R2S2R
(Lim et al. 2022, "Planar robot casting with real2sim2real self-supervised learning").
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import optimize

from gendom.arguments import require
from gendom.estimation.methods.search import best_of, estimated_noise
from gendom.estimation.problem import Found, Part, Problem, Start


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
    middle, most = problem.prior.vector(*problem.bases), problem.settings.max_iterations
    best, interrupted = Start(initial=middle, vector=middle), False

    def generation(x: np.ndarray) -> list[float]:
        """[S] values of vectors [P, S]."""
        vectors = list(x.T.copy())
        compared = problem.compare(vectors, derivatives=False)
        values = problem.values(vectors, compared, noise)
        n, best.iterations = int(np.argmin(values)), best.iterations + 1
        if compared[n] is None and best.comparison is None:
            raise problem.nothing_runs()
        if values[n] < best.value:
            best.vector, best.comparison, best.value = vectors[n], compared[n], values[n]
        problem.tell("evolution", best.iterations, most, best)
        return values

    try:
        ended = optimize.differential_evolution(
            generation,
            list(zip(*problem.prior.within(3.0), strict=True)),
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


def only_part(problem: Problem) -> Part:
    """The one recording of a problem.

    Raises:
        ParameterError: There are several.
    """
    what, where = f"reads one recording, got {len(problem.parts)}", problem.settings.method
    require(len(problem.parts) == 1, what, where=f"method {where}", fix="use gauss-newton")
    return problem.parts[0]


def finished(problem: Problem, starts: Sequence[Start], interrupted: bool) -> Found:
    """The result of a search that took no derivatives and no noise: both are taken at its best.

    Raises:
        SimulationError: There is none, or it cannot be simulated.
    """
    best = best_of(starts)
    comparison = None if best is None else problem.compare([best.vector])[0]
    if best is None or comparison is None:
        raise problem.nothing_runs()
    best.comparison = comparison
    noise = estimated_noise(comparison, problem.first_noise())
    return Found(best=best, starts=starts, noise=noise, interrupted=interrupted)
