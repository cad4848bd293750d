"""Polishing, and scores of policies whose errors are known, in a world solved in closed form."""

import math
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from gendom.errors import ParameterError, PolicyError, SimulationError
from gendom.materials import PARAMETERS, Item, dimensionless_parameters
from gendom.materials.estimate import Estimate
from gendom.policies import GoalRange, Policy
from gendom.policies.evaluation import choose, judge, score
from gendom.policies.polishing import polish, polishing
from gendom.policies.rollouts import side_by_side
from gendom.reality import OBJECTS
from gendom.tasks import ClothSpreading, RopeCasting
from gendom.tasks.cases import draw_cases
from gendom.tasks.world import Simulation
from policies.conftest import ROPE, TASK, Throws, describe, reach_of

KNOWN = Estimate.of(ROPE)
START = ROPE.length * np.array([0.45, 0.45])


def missed(action, goal, item: Item = ROPE, **world) -> float:
    (outcome,) = Throws(**world).carry_out(TASK, [item], [action])
    return abs(outcome.values["x"] - goal)


def test_a_known_object_is_reached_within_risk_discrepancy_and_doubt():
    reach = partial(polish, TASK, belief=KNOWN, start=START, world=Throws())
    found = reach(0.42)
    assert found.before == pytest.approx(missed(START, 0.42), rel=1e-9)
    assert missed(found.action, 0.42) < 1e-4 * ROPE.length
    assert found.expected < 1e-4 * ROPE.length < found.before
    assert TASK.allows(ROPE, found.action)
    # risk is avoided
    found = reach(0.4, start=ROPE.length * np.array([0.3, 0.8]), world=Throws(risky_above=0.5))
    assert found.action[1] < 0.5 * ROPE.length
    assert missed(found.action, 0.4) < 1e-3
    # discrepancy is made up for
    found = reach(0.42, discrepancy=lambda _: (np.array([0.006]), 0.0))
    assert missed(found.action, 0.42, off=0.02) < 1e-3
    # doubt keeps the action near to what was tried
    doubt = lambda action: (np.zeros(1), float(np.linalg.norm(action - START)))  # noqa: E731
    near, far = (reach(0.45, discrepancy=b).action - START for b in (doubt, None))
    assert np.linalg.norm(near) < np.linalg.norm(far)


def test_a_goal_is_not_given_up_to_sway_less():
    """Near goals of a stiff rope are reached by releases that sway beyond the limit."""
    item, shipped = OBJECTS["rope-polyethylene"], Policy.pretrained("rope-reaching")
    task, start = shipped.task(), list(shipped.act([0.38], item, force=True).values)
    found = polish(task, 0.38, Estimate.of(item), start, seconds=300.0)
    polished, first = Simulation().carry_out(task, [item, item], np.array([found.action, start]))
    assert abs(polished.values["x"] - 0.38) < 1e-3 < abs(first.values["x"] - 0.38)


def test_many_side_by_side_are_as_one_by_one():
    goals = (0.38, 0.42, 0.46)
    together = side_by_side(TASK, Throws(), [polishing(TASK, g, KNOWN, START) for g in goals])
    for goal, found in zip(goals, together, strict=True):
        alone = polish(TASK, goal, KNOWN, START, world=Throws())
        assert np.array_equal(found.action, alone.action)
        assert found.expected == alone.expected
    # an object that cannot be simulated is told
    with pytest.raises(SimulationError, match="no action"):
        polish(TASK, 0.4, KNOWN, START, world=Throws(fails=True))


def test_time_is_kept(monkeypatch):
    calls = []

    class Slow(Throws):
        def carry_out(self, task, items, actions, **_):
            time.sleep(0.05)
            calls.append(len(items))
            return super().carry_out(task, items, actions)

    for name, value in {"MAX_ITERATIONS": 50, "TOLERANCE": 1e-12, "LEAST_GAIN": 1e-12}.items():
        monkeypatch.setattr(f"gendom.policies.polishing.{name}", value)
    polish(TASK, 0.42, KNOWN, START, world=Slow())
    without = len(calls)
    calls.clear()
    polish(TASK, 0.42, KNOWN, START, world=Slow(), seconds=0.12)
    assert len(calls) <= 4 < without


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"goal": (0.4, 0.4)}, "goal"),
        ({"goal": math.nan}, "goal"),
        ({"start": (9.0, 9.0)}, "out of limits"),
        ({"seconds": 0.0}, "seconds"),
    ],
)
def test_bad_input_is_refused(given, text):
    arguments = {"goal": 0.4, "belief": KNOWN, "start": START} | given
    with pytest.raises(ParameterError, match=text):
        polish(TASK, world=Throws(), **arguments)
    with pytest.raises(ParameterError, match="cloth-spreading has no goal"):
        polish(ClothSpreading(), **arguments | {"goal": ()})


def test_simulated_cast_is_polished_to_a_tenth_of_a_millimetre():
    """Also with a wrong estimate, where the goal tells what the object really does."""
    task, world = RopeCasting(), Simulation()
    (there,) = world.carry_out(task, [ROPE], [[0.2]])
    goal = [there.values["x"], there.values["z"]]
    found = polish(task, goal, KNOWN, [0.14], world=world)
    assert found.action[0] == pytest.approx(0.2, abs=1e-4)
    assert found.expected < 1e-4
    (there,) = world.carry_out(task, [ROPE], [[0.15]])
    goal = [there.values["x"], there.values["z"]]
    m = ROPE.material
    wrong = replace(ROPE, material=replace(m, E=1.02 * m.E, damping=2.5 * m.damping))
    doubted = Estimate.of(wrong).with_uncertain("E_over_rho", 0.03).with_uncertain("damping", 0.9)
    taken = {}
    for name, belief in {"exact": Estimate.of(wrong), "doubted": doubted}.items():
        action = polish(task, goal, belief, [0.14], world=world).action
        (reached,) = world.carry_out(task, [ROPE], [action])
        taken[name] = math.dist([reached.values["x"], reached.values["z"]], goal)
    assert taken["doubted"] < 6e-4 < 3e-3 < taken["exact"]


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


@pytest.fixture(scope="module")
def cases():
    return draw_cases(TASK, 60, seed=3, simulation=Throws())


def test_exact_policy_has_no_error_and_one_that_knows_less_has(cases):
    exact, unseeing = make_policy(), make_policy(conditioned_on=())
    assert score(exact, cases, world=Throws()).error[free(exact, cases)].max() < 1e-6
    blind, own = score(unseeing, cases, world=Throws()), free(unseeing, cases)
    alike = [dimensionless_parameters(item) for item in cases.items]
    E, damping = (np.array([a[n] for a in alike]) for n in ("bending_ratio", "damping"))
    expected = 0.25 * np.abs(reach_of(0.0, Z, E, damping) - reach_of(0.0, Z, 0.4, 0.02))
    assert blind.error[own] == pytest.approx(expected[own], abs=1e-6)
    summary = blind.summary()
    whole = {"mean": np.mean(blind.error), "p95": np.quantile(blind.error, 0.95)}
    assert summary["error"] == pytest.approx(summary["error"] | whole)
    assert summary["error_over_size"]["p95"] == pytest.approx(summary["error"]["p95"] / 0.25)
    # a policy may know less than the truth
    wrong = [replace(i, material=replace(i.material, E=i.material.E * 1.1**3)) for i in cases.items]
    result = judge(cases, choose(exact, cases, known=wrong), world=Throws())
    off = 0.25 * 0.6 * Z * np.log(1.1)
    assert result.error[free(exact, cases, known=wrong)] == pytest.approx(off, abs=1e-6)


def test_what_cannot_be_relied_on_makes_no_goal(cases):
    height = {}

    class Watched(Throws):
        def carry_out(self, task, items, actions, **_):
            found = super().carry_out(task, items, actions)
            height.update({o.values["x"]: a[1] for o, a in zip(found, actions, strict=True)})
            return found

    safe = draw_cases(TASK, 40, seed=1, simulation=Watched(risky_above=0.5))
    assert max(height[x] for x in safe.goal[:, 0]) <= 0.5 * 0.25 < max(height.values())
    # case depends on seed and number alone
    few = draw_cases(TASK, 5, seed=3, simulation=Throws())
    assert few.items == cases.items[:5] and np.array_equal(few.goal, cases.goal[:5])
    assert few.items[0] != draw_cases(TASK, 1, seed=4, simulation=Throws()).items[0]


def test_failures_are_counted_and_faults_told(cases):
    assert score(make_policy(), cases, world=Throws()).summary()["failed"] == 0
    none = score(make_policy(), cases, world=Throws(fails=True)).summary()
    assert none["failed"] == 60 and none["error"]["mean"] is None
    with pytest.raises(ParameterError, match="0 cases"):
        draw_cases(TASK, 0, seed=0)
    with pytest.raises(SimulationError, match="3 of 3 cases failed"):
        draw_cases(TASK, 3, seed=0, simulation=Throws(fails=True))
    with pytest.raises(PolicyError, match="there is no task 'knitting'"):
        score(make_policy(task={"name": "knitting"}), cases)
