"""Scores of policies whose errors are known, in a world that is solved in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import ParameterError, PolicyError, SimulationError
from gendom.materials import PARAMETERS, dimensionless_parameters
from gendom.policies import GoalRange, Policy
from gendom.policies.evaluation import choose, judge, score
from gendom.tasks.cases import draw_cases
from policies.ballistic import TASK, Throws, reach_of
from policies.conftest import describe

Z = 0.45
"""Height at which `Inverse` lets go [lengths]."""


class Inverse:
    """The exact inverse of `reach_of`, for what it is told or else a middling rope."""

    def run(self, names, feed):
        goal = feed["goal_x"]
        E, damping = (np.asarray(feed.get(n, v)) for n, v in
                      (("bending_ratio", 0.4), ("damping", 0.02)))  # fmt: skip
        x = (goal - reach_of(0.0, Z, E, damping)) / 0.5
        return [np.concatenate([x, np.full_like(x, Z)], axis=1)]


def make_policy(conditioned_on=("bending_ratio", "damping"), *, task=None) -> Policy:
    about = describe(
        conditioned_on,
        task=task or {"name": "rope-reaching", **TASK.settings()},
        goals=GoalRange(at=(0.4,), low=((1.4,),), high=((1.7,),)),
        parameters=dict.fromkeys(PARAMETERS, (1e-4, 1e2)),
    )
    return Policy(Inverse(), about, where="inverse.onnx")


def free(policy, cases, **how) -> np.ndarray:
    """Cases in which the policy's action is within the limits."""
    x, z = choose(policy, cases, **how).T / 0.25
    own = np.isclose(z, Z) & (x > 0.2401) & (x < 0.8999)
    assert own.mean() > 0.3
    return own


def seen(items) -> list[np.ndarray]:
    alike = [dimensionless_parameters(item) for item in items]
    return [np.array([a[n] for a in alike]) for n in ("bending_ratio", "damping")]


def test_exact_policy_has_no_error_and_one_that_knows_less_has():
    cases = draw_cases(TASK, 60, seed=3, simulation=Throws())
    exact, unseeing = make_policy(), make_policy(conditioned_on=())
    assert score(exact, cases, world=Throws()).error[free(exact, cases)].max() < 1e-6
    blind, own = score(unseeing, cases, world=Throws()), free(unseeing, cases)
    expected = 0.25 * np.abs(reach_of(0.0, Z, *seen(cases.items)) - reach_of(0.0, Z, 0.4, 0.02))
    assert blind.error[own] == pytest.approx(expected[own], abs=1e-6)
    summary = blind.summary()
    assert summary["error"]["mean"] == pytest.approx(blind.error.mean())
    assert summary["error"]["max"] == pytest.approx(blind.error.max())
    assert summary["error_over_size"]["p95"] == pytest.approx(summary["error"]["p95"] / 0.25)
    # a policy may know less than the truth
    wrong = [replace(i, material=replace(i.material, E=i.material.E * 1.1**3)) for i in cases.items]
    result = judge(cases, choose(exact, cases, known=wrong), world=Throws())
    off = 0.25 * 0.6 * Z * np.log(1.1)
    assert result.error[free(exact, cases, known=wrong)] == pytest.approx(off, abs=1e-6)


def test_what_cannot_be_relied_on_makes_no_goal():
    height = {}

    class Watched(Throws):
        def carry_out(self, task, items, actions, **_):
            found = super().carry_out(task, items, actions)
            height.update({o.values["x"]: a[1] for o, a in zip(found, actions, strict=True)})
            return found

    cases = draw_cases(TASK, 40, seed=1, simulation=Watched(risky_above=0.5))
    assert max(height[x] for x in cases.goal[:, 0]) <= 0.5 * 0.25 < max(height.values())
    # case depends on seed and number alone
    few, many = (draw_cases(TASK, n, seed=3, simulation=Throws()) for n in (5, 9))
    assert few.items == many.items[:5]
    assert np.array_equal(few.goal, many.goal[:5])
    assert few.items[0] != draw_cases(TASK, 1, seed=4, simulation=Throws()).items[0]


def test_failures_are_counted_and_faults_told():
    cases = draw_cases(TASK, 40, seed=1, simulation=Throws())
    assert score(make_policy(), cases, world=Throws()).summary()["failed"] == 0
    none = score(make_policy(), cases, world=Throws(fails=True)).summary()
    assert none["failed"] == 40 and none["error"]["mean"] is None
    with pytest.raises(ParameterError, match="0 cases"):
        draw_cases(TASK, 0, seed=0)
    with pytest.raises(SimulationError, match="3 of 3 cases failed"):
        draw_cases(TASK, 3, seed=0, simulation=Throws(fails=True))
    with pytest.raises(PolicyError, match="there is no task 'knitting'"):
        score(make_policy(task={"name": "knitting"}), cases)
