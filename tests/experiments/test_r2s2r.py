"""R2S2R's identification, in a world solved in closed form."""

import numpy as np
import pytest

from experiments.r2s2r import identify
from gendom.errors import ParameterError, SimulationError
from gendom.materials import with_dimensionless
from gendom.policies.adaptation import Execution
from policies.ballistic import ROPE, TASK, Throws

PARAMETERS = {"bending_ratio": 0.5, "damping": 0.03}
TRUE = with_dimensionless(ROPE, PARAMETERS)


def seen(item, count=20):
    rng = np.random.default_rng(0)
    actions = TASK.sample_actions(item, rng, count)
    outcomes = Throws().carry_out(TASK, [item] * count, actions)
    return [
        (ROPE, Execution(action=a, reached=np.array([o.values["x"]])))
        for a, o in zip(actions, outcomes, strict=True)
    ]


def test_one_object_is_explained():
    found = identify(TASK, seen(TRUE), world=Throws())
    # E and damping move the reach alike: what they reach is found, not each of them
    value = 0.6 * np.log(found.parameters["bending_ratio"] / 0.4) - 6.0 * (
        found.parameters["damping"] - 0.02
    )
    assert value == pytest.approx(0.6 * np.log(0.5 / 0.4) - 6.0 * 0.01, abs=1e-3)
    assert found.misfit < 1e-4 and found.executions == 20
    again = identify(TASK, seen(TRUE), world=Throws())
    assert again == found
    # nothing to learn from is told
    with pytest.raises(ParameterError, match="no executions"):
        identify(TASK, [], world=Throws())
    with pytest.raises(SimulationError, match="no parameters could be simulated"):
        identify(TASK, seen(TRUE), world=Throws(fails=True), generations=1)
