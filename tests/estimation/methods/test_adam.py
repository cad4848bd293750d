"""Slopes of the density loss against central differences."""

import numpy as np
import pytest

from experiments.sim2sim import truth_of
from gendom.estimation.methods.adam import DensityLoss, _Descent
from gendom.estimation.problem import Start


@pytest.mark.parametrize("markers", [True, False])
@pytest.mark.parametrize("engine", ["thin", "mpm"])
def test_gradients_are_central_differences(short_lift, engine, markers):
    problem = short_lift(engine, markers)
    loss = DensityLoss(problem)
    vector = problem.prior.vector(truth_of(3300.0, 0.25))
    descent = _Descent(Start(initial=vector, vector=vector), vector)
    loss.evaluate([descent])
    assert descent.seen is not None
    for k, h in enumerate((1e-5, 1e-7)):
        x = problem.positions([vector + s * h * np.eye(2)[k] for s in (1.0, -1.0)])
        ahead, behind = (loss.value(x[:, w], descent.seen) for w in range(2))
        assert descent.gradient[k] == pytest.approx(
            (ahead - behind) / (2.0 * h), rel=1e-3, abs=1e-6
        )
    assert descent.start.value == pytest.approx(
        loss.value(problem.positions([vector])[:, 0], descent.seen), rel=1e-9
    )


def test_gradients_by_how_it_is_held_are_differences(short_lift):
    """Unknowns without a reverse mode, here the grip's height."""
    problem = short_lift()
    wide = type(problem)(
        [problem.scene],
        type(problem.settings)(
            unknowns=("E_over_rho", "grip_height"), scene=problem.settings.scene
        ),
        known=problem.bases[0],
    )
    loss = DensityLoss(wide)
    vector = wide.prior.vector(truth_of(3300.0, 0.25))
    descent = _Descent(Start(initial=vector, vector=vector), vector)
    loss.evaluate([descent])
    assert descent.seen is not None
    h = wide.prior.step[1]
    x = wide.positions([vector, vector + np.array([0.0, h])])
    here, beside = (loss.value(x[:, w], descent.seen) for w in range(2))
    assert descent.gradient[1] == pytest.approx((beside - here) / h, rel=1e-6)
    assert abs(descent.gradient[1]) > 0.1
