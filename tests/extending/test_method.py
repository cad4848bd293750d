"""A new method of estimation is one function, in a package with an entry point."""

import json

METHOD = '''
"""`grid`: the best of 24 moduli, everything else as its prior says."""

import numpy as np

from gendom.estimation import Problem
from gendom.estimation.problem import Found, Start


def grid(problem: Problem) -> Found:
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
'''


def test_a_package_adds_a_method(outside, rope_lift, tmp_path):
    outside.add("grid", METHOD, methods="grid")
    rope_lift.seen().write(tmp_path / "lift.npz")
    words = ["--method", "grid", "--unknowns", "E_over_rho", "--points", 15, "--json"]
    estimated = outside.gendom("estimate", tmp_path / "lift.npz", *words)
    record = json.loads(estimated.stdout)
    assert record["method"] == "grid"
    assert 0.5 < record["E_over_rho"] / rope_lift.truth.E_over_rho < 2.0
