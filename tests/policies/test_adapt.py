"""Learning from executions, in a world solved in closed form."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gendom.errors import ParameterError, SimulationError
from gendom.materials import Cloth, dimensionless_parameters, size_of
from gendom.materials.estimate import Estimate
from gendom.policies import adaptation
from gendom.policies.adaptation import Execution, adapt, executions_from
from gendom.policies.belief import believed, uncertain, weighed
from gendom.policies.polishing import polish
from gendom.tasks import ClothSpreading
from policies.ballistic import ROPE, TASK, Throws, reach_of

POSTERIOR = {
    "names": ["E_over_rho", "grip_height"],
    "mean": [math.log(8e5 / 900), 0.0],
    "covariance": [[0.05**2, 0.0], [0.0, 1e-6]],
}
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


def test_two_exact_executions_tell_what_one_cannot(monkeypatch):
    """E and damping move the reach alike, so the sum is learnt; the prior shares it out."""
    monkeypatch.setattr(adaptation, "DISCREPANCY", 1e-5)
    monkeypatch.setattr(adaptation, "NOISE", 1e-5)
    belief = belief_of(ROPE, POSTERIOR, known=KNOWN)
    found = adapt(TASK, belief, [executed(0.4, 0.4)], world=Throws()).belief
    alike = dimensionless_parameters(found.most_likely)
    (reached,) = executed(0.4, 0.4).reached / ROPE.length
    assert reach_of(0.4, 0.4, alike["bending_ratio"], alike["damping"]) == pytest.approx(
        reached, abs=1e-5
    )
    # nearly all of it is damping, which no lift told
    assert found.most_likely.material.damping == pytest.approx(0.009, rel=0.2)
    assert found.most_likely.material.E == pytest.approx(8e5, rel=0.05)
    damping = belief.names.index("damping")
    assert found.sd[damping] < 0.3 * belief.sd[damping]


def test_belief_is_that_of_the_linear_model():
    """Near its mean the world is linear: mean and covariance are Kalman's."""
    belief = belief_of(ROPE, POSTERIOR, known=(*KNOWN, "damping"))
    seen = executed(0.4, 0.4, item=replace(ROPE, material=replace(ROPE.material, E=8.1e5)))
    found = adapt(TASK, belief, [seen], world=Throws())
    slope = 0.6 * 0.4 / 3.0  # the bending length goes by the cube root of E
    variance = 0.008**2 + 0.002**2
    gain = 0.05**2 * slope / (slope**2 * 0.05**2 + variance)
    assert found.belief.mean[0] - belief.mean[0] == pytest.approx(
        gain * slope * math.log(8.1 / 8.0), rel=1e-3
    )
    assert found.belief.sd[0] == pytest.approx(
        math.sqrt(1.0 / (1.0 / 0.05**2 + slope**2 / variance)), rel=1e-3
    )
    # nothing seen changes nothing
    belief = belief_of(ROPE, POSTERIOR, known=KNOWN)
    found = adapt(TASK, belief, [], world=Throws())
    assert found.belief is belief and found.discrepancy is None
    found = adapt(TASK, belief, [executed(0.4, 0.4)], world=Throws(), refine=False)
    assert np.array_equal(found.belief.mean, belief.mean) and found.discrepancy is not None
    # what a task depends on
    assert uncertain(TASK, ROPE) == ("E_over_rho", "damping")
    cloth = Cloth(side=0.3, thickness=0.001)
    assert uncertain(ClothSpreading(), cloth) == ("E_over_rho", "nu", "damping", "friction")


def test_what_parameters_cannot_explain_is_expected_again_nearby():
    tight = {"names": ["E_over_rho"], "mean": [math.log(8e5 / 900)], "covariance": [[1e-8]]}
    belief = belief_of(ROPE, tight, known=(*KNOWN, "damping"))
    seen = executed(0.4, 0.4, off=0.02, item=ROPE)
    found = adapt(TASK, belief, [seen], world=Throws())
    assert found.residuals[0, 0] == pytest.approx(0.02 * ROPE.length, rel=1e-2)
    assert found.discrepancy is not None
    here, doubt = found.discrepancy(seen.action)
    assert here[0] == pytest.approx(0.02 * ROPE.length, rel=0.1)
    far, doubt_far = found.discrepancy(seen.action + 0.3 * ROPE.length)
    assert abs(far[0]) < 0.01 * here[0]
    assert doubt < 0.3 * doubt_far
    # and the next action makes up for it
    goal = seen.reached[0] - 0.02 * ROPE.length
    action = polish(
        TASK, goal, Estimate.of(ROPE), seen.action, world=Throws(), discrepancy=found.discrepancy
    ).action
    (outcome,) = Throws(off=0.02).carry_out(TASK, [ROPE], [action])
    assert abs(outcome.values["x"] - goal) < 0.3 * 0.02 * ROPE.length


def test_bad_executions_are_refused():
    belief = belief_of(ROPE, POSTERIOR, known=KNOWN)
    wrong = Execution(action=np.array([0.2]), reached=np.array([0.4]))
    with pytest.raises(ParameterError, match="1 numbers of an action"):
        adapt(TASK, belief, [wrong], world=Throws())
    with pytest.raises(ParameterError, match="finite"):
        Execution(action=np.array([0.2, math.nan]), reached=np.array([0.4]))
    far = Execution(action=np.array([0.4, 0.4]), reached=np.array([357.0]))
    with pytest.raises(ParameterError, match=r"x is 357 m, .* give metres: 357 mm are 0\.357"):
        adapt(TASK, belief, [far], world=Throws())
    with pytest.raises(ParameterError, match="executions: are 401, at most 400 are learnt from"):
        adapt(TASK, belief, [executed(0.4, 0.4)] * 401, world=Throws())
    with pytest.raises(SimulationError, match="cannot be simulated"):
        adapt(TASK, belief, [executed(0.4, 0.4)], world=Throws(fails=True))
    with pytest.raises(ParameterError, match="share is 4; give a share"):
        many = Execution(action=np.array([0.2]), reached=np.array([4.0]))
        adapt(ClothSpreading(), belief, [many], world=Throws())
    seen = executed(0.4, 0.4)
    (again,) = executions_from([seen.to_dict()], "file")
    assert np.array_equal(again.action, seen.action) and again.reached == seen.reached
    for rows in ([{"action": [1.0]}], ["x"], [{"action": ["a"], "reached": [1.0]}]):
        with pytest.raises(ParameterError, match=r"file\.json"):
            executions_from(rows, "file.json")


# ---- beliefs ---------------------------------------------------------------------------------


def test_belief_takes_the_posterior_and_doubts_the_rest():
    belief = belief_of(ROPE, POSTERIOR, known=("friction",))
    assert belief.names == ("E_over_rho", "nu", "damping")
    assert belief.sd == pytest.approx([0.05, 0.06, 1.33])
    assert belief.most_likely.material.E == pytest.approx(8e5)
    drawn = belief.draws(4000, seed=1)
    logs = np.log([item.material.E_over_rho for item in drawn])
    assert logs.mean() == pytest.approx(math.log(8e5 / 900), abs=0.003)
    assert logs.std() == pytest.approx(0.05, rel=0.05)
    low, high = belief.posterior.interval("E_over_rho", 0.9)
    inside = (np.exp(logs) > low) & (np.exp(logs) < high)
    assert inside.mean() == pytest.approx(0.9, abs=0.02)
    assert all(size_of(item) == ROPE.length for item in drawn)
    # belief keeps correlations in any order
    posterior = {"names": ["damping", "yaw", "E_over_rho"], "mean": [-5.0, 0.0, 7.0],
                 "covariance": [[0.04, 0.0, 0.01], [0.0, 1.0, 0.0], [0.01, 0.0, 0.09]]}  # fmt: skip
    belief = belief_of(ROPE, posterior, known=KNOWN)
    assert belief.names == ("E_over_rho", "damping")
    assert belief.mean == pytest.approx([7.0, -5.0])
    assert belief.covariance == pytest.approx(np.array([[0.09, 0.01], [0.01, 0.04]]))
    # a belief is about an object of the item's thickness
    slope = np.array([-2.0, 1.0])
    covariance = np.diag([0.03**2, 0.0]) + 0.8**2 * np.outer(slope, slope)
    posterior = {
        "names": ["E_over_rho", "thickness"],
        "mean": [math.log(8e5 / 900), 0.0],
        "covariance": covariance.tolist(),
    }
    belief = belief_of(ROPE, posterior, known=("nu", "friction", "damping"))
    assert belief.names == ("E_over_rho",) and belief.sd == pytest.approx([0.03])
    # what recordings have each is kept
    old = {"names": ["E_over_rho", "grip_height", "grip_height"], "recordings": [None, 0, 1],
           "log": [True, False, False], "mean": [math.log(900.0), 0.001, 0.002],
           "prior_mean": [5.0, 0.0, 0.0], "prior_sd": [4.0, 0.01, 0.01],
           "low": [1.0, -0.1, -0.1], "high": [9.0, 0.1, 0.1],
           "covariance": np.diag([1e-2, 1e-6, 4e-6]).tolist()}  # fmt: skip
    estimate = Estimate.of(ROPE, old)
    found = estimate.updated(estimate.of_object(["E_over_rho"]), {}).posterior.to_dict()
    assert found["names"] == old["names"] and found["recordings"] == old["recordings"]
    assert found["mean"][1:] == [0.001, 0.002]
    assert np.diag(found["covariance"]) == pytest.approx([1e-2, 1e-6, 4e-6])


@pytest.mark.parametrize(
    "posterior",
    [{}, {"names": ["E_over_rho"], "mean": [1.0], "covariance": [[-1.0]]},
     {"names": ["E_over_rho"], "mean": ["x"], "covariance": [[1.0]]}],
)  # fmt: skip
def test_broken_posteriors_are_refused(posterior):
    with pytest.raises(ParameterError):
        belief_of(ROPE, posterior, known=KNOWN)


def test_what_was_enough_says_which_objects_are_likely():
    """Of a task without goals: a policy's probabilities weigh the drawn objects."""
    task = ClothSpreading()

    class Knows:
        """Enough is A beyond what the friction asks for, in nine of ten cases."""

        description = SimpleNamespace(candidates=ClothSpreading.candidates)

        def task(self):
            return ClothSpreading()

        def chances(self, actions, parameters):
            return np.where(np.ravel(actions) > parameters["friction"], 0.9, 0.05)

    drawn = [replace(task.item, friction=f) for f in np.linspace(0.2, 0.6, 200)]
    tried = [
        Execution(action=np.array([A]), reached=np.array([s])) for A, s in ((0.4, 0.8), (0.3, 0.5))
    ]
    friction = np.array([i.friction for i in weighed(drawn, tried, cast(Any, Knows()), 0)])
    assert np.mean((friction > 0.3) & (friction < 0.4)) > 0.75
    assert weighed(drawn, [], cast(Any, Knows()), 0) == drawn
    # they are kept as they are, for the policy
    belief = believed(Estimate.of(task.item), task)
    assert adapt(task, belief, tried, world=Throws()).belief is belief
