"""What a policy chooses, and what it says lies outside of its training."""

from contextlib import nullcontext

import numpy as np
import pytest

from gendom.errors import PolicyError
from gendom.materials import dimensionless_parameters, with_dimensionless
from gendom.policies import Policy
from gendom.policies.policy import MARGIN


@pytest.mark.parametrize("task", ["cloth-spreading", "cloth-dragging"])
def test_the_action_without_a_goal_is_the_first_of_the_surest(task):
    policy = Policy.pretrained(task)
    item = policy.task().item
    for ratio in np.linspace(*policy.description.parameters["bending_ratio"], 5):
        cloth = with_dimensionless(item, {"bending_ratio": float(ratio)})
        action = np.array(policy.act((), cloth).values)
        seen = {n: dimensionless_parameters(cloth)[n] for n in policy.description.parameters}
        known = np.array(policy.description.candidates)
        chances = policy.chances(known, seen)
        first = known[next(k for k, c in enumerate(chances) if c >= chances.max() - MARGIN)]
        assert action / policy.task().action_units(cloth) == pytest.approx(first)


@pytest.mark.parametrize(("beyond", "refused"), [(0.995, False), (1.004, False), (1.05, True)])
def test_parameters_may_lie_a_hundredth_outside(beyond, refused):
    policy = Policy.pretrained("rope-reaching")
    high = policy.description.parameters["bending_ratio"][1]
    rope = with_dimensionless(policy.task().item, {"bending_ratio": beyond * high})
    goal = np.mean(policy.goal_range(rope), axis=1)
    with pytest.raises(PolicyError, match="bending_ratio") if refused else nullcontext():
        policy.act(goal, rope)
