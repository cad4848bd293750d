"""Scores of policies whose errors are known, in a world that is solved in closed form."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from gendom.errors import ParameterError, PolicyError, SimulationError
from gendom.materials import PARAMETERS, dimensionless_parameters, size_of
from gendom.policies import GoalRange, Policy
from gendom.policies.evaluation import choose, judge, score
from gendom.tasks import RopeReaching
from gendom.tasks.cases import draw_cases
from gendom.tasks.task import Outcome
from gendom.tasks.world import Simulation
from policies.conftest import describe

TASK = RopeReaching()


def reach_of(release_x, E):
    """Goal from release, both in rope lengths."""
    return 2.0 - 0.8 * release_x + 0.15 * np.log(E / 0.4)


@dataclass(frozen=True, kw_only=True)
class Quick(Simulation):
    """`reach_of` instead of a simulation; releases at the top fail, those far back fall."""

    fails_above: float = 2.0
    falls_before: float = 0.0

    def carry_out(self, task, items, actions, **_):
        outcomes = []
        for item, (x, z) in zip(items, np.asarray(actions), strict=True):
            L = size_of(item)
            reached = L * reach_of(x / L, dimensionless_parameters(item)["bending_ratio"])
            falls = x < self.falls_before * L
            values = {"x": reached, "sideways": 0.2 * L if falls else 0.0}
            fault = "failed" if z > self.fails_above * L else None
            outcomes.append(Outcome(values={} if fault else values, fault=fault))
        return outcomes


class Inverse:
    """The exact inverse of `reach_of`, for the E it is told or else 0.4."""

    def __init__(self, release_z=0.45):
        self.release_z = release_z

    def run(self, names, feed):
        goal = feed["goal_x"]
        E = feed.get("bending_ratio", np.full_like(goal, 0.4))
        x = (2.0 + 0.15 * np.log(E / 0.4) - goal) / 0.8
        return [np.concatenate([x, np.full_like(x, self.release_z)], axis=1)]


def make_policy(conditioned_on=("bending_ratio",), *, task=None, **session) -> Policy:
    about = describe(
        conditioned_on,
        task=task or {"name": "rope-reaching", **TASK.settings()},
        goals=GoalRange(at=(0.4,), low=((1.4,),), high=((1.7,),)),
        parameters=dict.fromkeys(PARAMETERS, (1e-4, 1e2)),
    )
    return Policy(Inverse(**session), about, where="inverse.onnx")


def free(policy, cases, **how) -> np.ndarray:
    """Cases in which the policy's action is within the limits; most are."""
    x, z = choose(policy, cases, **how).T / 0.25
    own = np.isclose(z, 0.45) & (x > 0.2401) & (x < 0.8999)
    assert own.mean() > 0.5
    return own


def test_exact_policy_has_no_error_and_blind_policy_has():
    cases = draw_cases(TASK, 60, seed=3, simulation=Quick())
    exact, unseeing = make_policy(), make_policy(conditioned_on=())
    assert score(exact, cases, world=Quick()).error[free(exact, cases)].max() < 1e-6
    blind, own = score(unseeing, cases, world=Quick()), free(unseeing, cases)
    E = np.array([dimensionless_parameters(item)["bending_ratio"] for item in cases.items])
    expected = 0.25 * np.abs(0.15 * np.log(E / 0.4))
    assert blind.error[own] == pytest.approx(expected[own], abs=1e-6)
    summary = blind.summary()
    assert summary["error"]["mean"] == pytest.approx(blind.error.mean())
    assert summary["error"]["max"] == pytest.approx(blind.error.max())
    assert summary["error_over_size"]["p95"] == pytest.approx(summary["error"]["p95"] / 0.25)
    # a policy may know less than the truth
    cases = draw_cases(TASK, 40, seed=3, simulation=Quick())
    wrong = [replace(i, material=replace(i.material, E=i.material.E * 1.1**3)) for i in cases.items]
    result = judge(cases, choose(make_policy(), cases, known=wrong), world=Quick())
    off = 0.25 * 0.15 * np.log(1.1)
    own = free(make_policy(), cases, known=wrong)
    assert result.error[own] == pytest.approx(off, abs=1e-6)


def test_what_cannot_be_relied_on_makes_no_goal():
    cases = draw_cases(TASK, 40, seed=1, simulation=Quick(falls_before=0.6))
    E = np.array([dimensionless_parameters(item)["bending_ratio"] for item in cases.items])
    release = (2.0 + 0.15 * np.log(E / 0.4) - cases.goal[:, 0] / 0.25) / 0.8
    assert release.min() >= 0.6 - 1e-9
    # case depends on seed and number alone
    few, many = (draw_cases(TASK, n, seed=3, simulation=Quick()) for n in (5, 9))
    assert few.items == many.items[:5]
    assert np.array_equal(few.goal, many.goal[:5])
    assert few.items[0] != draw_cases(TASK, 1, seed=4, simulation=Quick()).items[0]


def test_summary_counts_failures():
    cases = draw_cases(TASK, 40, seed=1, simulation=Quick(fails_above=0.8))
    assert np.isfinite(cases.goal).all()
    result = score(make_policy(release_z=0.45), cases, world=Quick(fails_above=0.8))
    summary = result.summary()
    assert summary["failed"] == 0
    high = score(make_policy(release_z=0.45), cases, world=Quick(fails_above=0.44))
    failed = int(np.isnan(high.error).sum())
    assert high.summary()["failed"] == failed > 0
    none = score(make_policy(), cases, world=Quick(fails_above=0.0)).summary()
    assert none["failed"] == 40 and none["error"]["mean"] is None


def test_faults_are_told():
    with pytest.raises(ParameterError, match="0 cases"):
        draw_cases(TASK, 0, seed=0)
    with pytest.raises(SimulationError, match="3 of 3 cases failed"):
        draw_cases(TASK, 3, seed=0, simulation=Quick(fails_above=0.0))
    cases = draw_cases(TASK, 1, seed=0, simulation=Quick())
    with pytest.raises(PolicyError, match="there is no task 'knitting'"):
        score(make_policy(task={"name": "knitting"}), cases)
