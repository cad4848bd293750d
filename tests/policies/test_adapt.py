"""Learning from executions, beside formulas and slow searches."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from gendom.errors import GendomError, ParameterError
from gendom.materials import Cloth, dimensionless_parameters, size_of
from gendom.materials.estimate import Estimate
from gendom.policies.adaptation import Execution, adapt, executions_from
from gendom.policies.belief import believed, uncertain, weighed
from gendom.tasks import ClothSpreading
from gendom.tasks.task import Outcome
from policies.conftest import ROPE, TASK, Throws, reach_of


def gaussian(names, mean, covariance) -> dict:
    """A posterior as files have it."""
    return {"names": names, "mean": mean, "covariance": np.asarray(covariance).tolist()}


LOG_E = math.log(8e5 / 900)
POSTERIOR = gaussian(["E_over_rho", "grip_height"], [LOG_E, 0.0], np.diag([0.05**2, 1e-6]))
KNOWN = ("nu", "friction")
TRUE = replace(ROPE, material=replace(ROPE.material, E=7.7e5, damping=0.009))
EVERY = ("E_over_rho", "nu", "damping", "friction")


def belief_of(item, posterior, *, known=()) -> Estimate:
    """What a posterior says of an object, where some parameters are known."""
    return Estimate.of(item, posterior).of_object([n for n in EVERY if n not in known])


def executed(x, z, *, off=0.0, item=TRUE) -> Execution:
    L, alike = item.length, dimensionless_parameters(item)
    reached = L * (reach_of(x, z, alike["bending_ratio"], alike["damping"]) + off)
    return Execution(action=L * np.array([x, z]), reached=np.array([reached]))


def test_nothing_seen_changes_nothing_and_tasks_depend_on_what_they_do():
    belief = belief_of(ROPE, POSTERIOR, known=KNOWN)
    found = adapt(TASK, belief, [], world=Throws())
    assert found.belief is belief and found.discrepancy is None
    assert uncertain(TASK, ROPE) == ("E_over_rho", "damping")
    cloth = Cloth(side=0.3, thickness=0.001)
    assert uncertain(ClothSpreading(), cloth) == ("E_over_rho", "nu", "damping", "friction")


METRES = r"m, and the rope 0\.3 m; give metres"


@pytest.mark.parametrize(
    ("task", "action", "reached", "said"),
    [
        (TASK, [0.2], [0.4], "1 numbers of an action and 1 reached, rope-reaching has 2 and 1: x"),
        (TASK, [0.1] * 3, [0.4], "3 numbers of an action and 1 reached"),
        (TASK, [0.1] * 2, [0.4] * 2, "2 numbers of an action and 2 reached"),
        (TASK, [0.1] * 2, [], "2 numbers of an action and 0 reached"),
        (TASK, [0.2, math.nan], [0.4], "finite"),
        (TASK, [0.1, 0.1], [357.0], rf"x is 357 {METRES}: 357 mm are 0\.357"),
        (TASK, [0.1, 0.1], [-3.01], rf"x is -3\.01 {METRES}"),
        (TASK, [0.1, 0.1], [2.99], "check the object's numbers and the action"),
        (ClothSpreading(), [0.2], [4.0], "share is 4; give a share"),
    ],
)
def test_executions_have_the_numbers_of_their_task(task, action, reached, said):
    belief = belief_of(ROPE, POSTERIOR, known=KNOWN) if task is TASK else Estimate.of(task.item)
    with pytest.raises(GendomError, match=said):
        one = Execution(action=np.array(action), reached=np.array(reached))
        adapt(task, belief, [one], world=Throws(fails=True))


def test_executions_are_read_back_and_400_at_most_are_learnt_from():
    seen = executed(0.4, 0.4)
    (again,) = executions_from([seen.to_dict()], "file")
    assert np.array_equal(again.action, seen.action) and again.reached == seen.reached
    for rows in ([{"action": [1.0]}], ["x"], [{"action": ["a"], "reached": [1.0]}]):
        with pytest.raises(ParameterError, match=r"file\.json"):
            executions_from(rows, "file.json")
    with pytest.raises(ParameterError, match="executions: are 401, at most 400 are learnt from"):
        adapt(TASK, belief_of(ROPE, POSTERIOR, known=KNOWN), [seen] * 401, world=Throws())


def test_belief_takes_the_posterior_and_doubts_the_rest():
    belief = belief_of(ROPE, POSTERIOR, known=("friction",))
    assert belief.names == ("E_over_rho", "nu", "damping")
    assert belief.sd == pytest.approx([0.05, 0.1, 1.33])
    assert belief.most_likely.material.E == pytest.approx(8e5)
    drawn = belief.draws(4000, seed=1)
    logs = np.log([item.material.E_over_rho for item in drawn])
    assert logs.mean() == pytest.approx(LOG_E, abs=0.003)
    assert logs.std() == pytest.approx(0.05, rel=0.05)
    assert all(size_of(item) == ROPE.length for item in drawn)


def test_beliefs_keep_correlations_their_size_and_what_recordings_have_each():
    covariance = [[0.04, 0.0, 0.01], [0.0, 1.0, 0.0], [0.01, 0.0, 0.09]]
    posterior = gaussian(["damping", "yaw", "E_over_rho"], [-5.0, 0.0, 7.0], covariance)
    belief = belief_of(ROPE, posterior, known=KNOWN)
    assert belief.names == ("E_over_rho", "damping")
    assert belief.mean == pytest.approx([7.0, -5.0])
    assert belief.covariance == pytest.approx(np.array([[0.09, 0.01], [0.01, 0.04]]))
    # about an object of the item's thickness
    covariance = np.diag([0.03**2, 0.0]) + 0.8**2 * np.outer([-2.0, 1.0], [-2.0, 1.0])
    posterior = gaussian(["E_over_rho", "thickness"], [LOG_E, 0.0], covariance)
    belief = belief_of(ROPE, posterior, known=(*KNOWN, "damping"))
    assert belief.names == ("E_over_rho",) and belief.sd == pytest.approx([0.03])
    old = {"names": ["E_over_rho", "grip_height", "grip_height"], "recordings": [None, 0, 1],
           "log": [True, False, False], "mean": [math.log(900.0), 0.001, 0.002],
           "prior_mean": [5.0, 0.0, 0.0], "prior_sd": [4.0, 0.01, 0.01],
           "low": [1.0, -0.1, -0.1], "high": [9.0, 0.1, 0.1],
           "covariance": np.diag([1e-2, 1e-6, 4e-6]).tolist()}  # fmt: skip
    estimate = Estimate.of(ROPE, old)
    found = estimate.updated(estimate.of_object(["E_over_rho"]), {}).posterior.to_dict()
    assert [found[n] for n in ("names", "recordings")] == [old["names"], old["recordings"]]
    assert found["mean"][1:] == [0.001, 0.002]
    assert np.diag(found["covariance"]) == pytest.approx([1e-2, 1e-6, 4e-6])
    whole = gaussian(["E_over_rho"], [1.0], [[1.0]])
    for broken in ({}, whole | {"covariance": [[-1.0]]}, whole | {"mean": ["x"]}):
        with pytest.raises(ParameterError):
            belief_of(ROPE, broken, known=KNOWN)


def test_what_was_enough_says_which_objects_are_likely():
    """Of a task without goals: a policy's probabilities weigh the drawn objects."""
    task = ClothSpreading()
    # enough is A beyond what the friction asks for, in nine of ten cases
    knows: Any = SimpleNamespace(
        description=SimpleNamespace(candidates=ClothSpreading.candidates),
        task=ClothSpreading,
        chances=lambda A, parameters: np.where(np.ravel(A) > parameters["friction"], 0.9, 0.05),
    )
    drawn = [replace(task.item, friction=f) for f in np.linspace(0.2, 0.6, 200)]
    tried = [
        Execution(action=np.array([A]), reached=np.array([s])) for A, s in ((0.4, 0.8), (0.3, 0.5))
    ]
    friction = np.array([item.friction for item in weighed(drawn, tried, knows, 0)])
    assert np.mean((friction > 0.3) & (friction < 0.4)) > 0.75
    assert weighed(drawn, [], knows, 0) == drawn
    # they are kept as they are, for the policy
    belief = believed(Estimate.of(task.item), task)
    assert adapt(task, belief, tried, world=Throws()).belief is belief


ACTIONS = np.array([[0.4, 0.4], [0.42, 0.43], [0.3, 0.45], [0.5, 0.35]])
OFFS = (0.01, -0.015, 0.02, 0.0)


def reached(belief, vector):
    """[N] in lengths, of `ACTIONS`."""
    alike = dimensionless_parameters(belief.at(vector))
    known = alike["bending_ratio"], alike["damping"]
    return np.array([reach_of(x, z, *known) for x, z in ACTIONS])


def gram(a, b):
    """8 mm of a metre, alike over 5 cm of one."""
    return np.array(
        [[0.008**2 * math.exp(-0.5 * ((x - y) @ (x - y)) / 0.05**2) for y in b] for x in a]
    )


@pytest.mark.parametrize(("item", "share"), [(TRUE, 1.0), (ROPE, 0.5)])
def test_a_belief_is_the_most_likely_one_and_the_rest_a_gaussian_process(item, share):
    """By a simplex search of the same sum of squares, and normal equations."""
    belief = belief_of(ROPE, POSTERIOR, known=KNOWN)
    seen = [executed(*a, off=share * off, item=item) for a, off in zip(ACTIONS, OFFS, strict=True)]
    found = adapt(TASK, belief, seen, world=Throws())
    L = ROPE.length
    y, K = np.array([e.reached[0] for e in seen]) / L, gram(ACTIONS, ACTIONS) + 0.002**2 * np.eye(4)
    prior = np.linalg.inv(belief.covariance)

    def cost(z):
        v = belief.mean + z * belief.sd
        r, d = y - reached(belief, v), v - belief.mean
        return r @ np.linalg.solve(K, r) + d @ prior @ d

    best = minimize(
        cost, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-10}
    )
    at = belief.mean + best.x * belief.sd
    np.testing.assert_allclose((found.belief.mean - at) / belief.sd, 0.0, atol=0.02)
    mean = found.belief.mean
    h = 1e-4 * belief.sd
    J = np.stack([(reached(belief, mean + d) - reached(belief, mean - d)) / (2.0 * abs(d).max())
                  for d in np.diag(h)], axis=1)  # fmt: skip
    covariance = np.linalg.inv(J.T @ np.linalg.solve(K, J) + prior)
    np.testing.assert_allclose(found.belief.covariance, covariance, rtol=0.02, atol=1e-7)
    left = y - reached(belief, mean)
    np.testing.assert_allclose(found.residuals[:, 0], left * L, atol=1e-9)
    assert found.discrepancy is not None
    for at in (ACTIONS[0], ACTIONS[1] + 0.02, np.array([0.9, 0.1])):
        k = gram([at], ACTIONS)[0]
        by, deviation = found.discrepancy(at * L)
        assert by == pytest.approx([k @ np.linalg.solve(K, left) * L], abs=1e-9)
        variance = 0.008**2 - k @ np.linalg.solve(K, k)
        assert deviation == pytest.approx(math.sqrt(variance) * L, rel=1e-6)
    # where it is all known, only the rest is found
    fixed = adapt(TASK, belief, seen, world=Throws(), refine=False)
    np.testing.assert_array_equal(fixed.belief.mean, belief.mean)
    np.testing.assert_allclose(fixed.belief.covariance, belief.covariance)
    np.testing.assert_allclose(fixed.residuals[:, 0], (y - reached(belief, belief.mean)) * L)


ASKED: list[float] = []


class Bends(Throws):
    """Reaches that bend back beyond some E: whole steps gain nothing, and larger ones fail."""

    def carry_out(self, task, items, actions, **_):
        outcomes = []
        for item in items:
            x = math.log(item.material.E / ROPE.material.E)
            ASKED.append(round(x, 9))
            values = {"x": item.length * (1.0 + self.off * math.tanh(60.0 * x)), "sideways": 0.0}
            fault = "burst" if x > self.risky_above else None
            outcomes.append(Outcome(values={} if fault else values, fault=fault))
        return outcomes


@pytest.mark.parametrize("most", [9.0, 0.02])
def test_the_best_of_four_shares_of_a_step_is_taken(most):
    """A step of the slope at the middle goes too far; a world that fails is none of them."""
    posterior = gaussian(["E_over_rho"], [LOG_E], [[0.3**2]])
    belief = belief_of(ROPE, posterior, known=("nu", "friction", "damping"))
    seen = Execution(action=np.array([0.12, 0.12]), reached=np.array([0.3 * 1.05]))
    world = Bends(off=0.05, risky_above=most)
    ASKED.clear()
    found = adapt(TASK, belief, [seen], world=world)
    h = 0.05 * 0.3
    slope = 0.05 * math.tanh(60.0 * h) / h
    variance = 0.008**2 + 0.002**2
    H = slope**2 / variance + 1.0 / 0.3**2
    step = slope * 0.05 / variance / H
    assert ASKED[:3] == pytest.approx([0.0, h, -h], abs=1e-6)
    assert ASKED[3:7] == pytest.approx([step * s for s in (1.0, 0.5, 0.25, 0.1)], abs=1e-6)
    costs = [(0.05 - 0.05 * math.tanh(60.0 * x)) ** 2 / variance + (x / 0.3) ** 2
             if x < most else math.inf for x in ASKED[3:7]]  # fmt: skip
    best = ASKED[3:7][int(np.argmin(costs))]
    assert (best == ASKED[3]) is (most > 1.0)
    assert ASKED[7:9] == pytest.approx([best + h, best - h], abs=1e-6)
    # where one end of the differences fails they say nothing
    assert (found.belief.sd[0] < 0.29) == (most > 1.0)
