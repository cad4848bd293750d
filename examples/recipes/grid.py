"""An estimation method: the best of 24 moduli, everything else as its prior says
(`gendom.methods`)."""

import numpy as np

from gendom.estimation import Problem
from gendom.estimation.problem import Found, Start


def grid(problem: Problem) -> Found:
    """`gendom estimate --method grid`."""
    middle = problem.prior.vector(*problem.bases)
    k = problem.prior.index("E_over_rho")
    moduli = np.linspace(problem.prior.low[k], problem.prior.high[k], 26)[1:-1]
    tried = np.repeat(middle[None], len(moduli), axis=0)
    tried[:, k] = moduli
    noise = problem.first_noise()
    values = problem.values(list(tried), problem.compare(list(tried), derivatives=False), noise)
    best = Start(initial=middle, vector=tried[int(np.argmin(values))], value=min(values), done=True)
    best.comparison = problem.compare([best.vector])[0]
    problem.tell("grid", 1, 1, best)
    return Found(best=best, starts=[best], noise=noise)
