"""What makes a posterior wider than the likelihood says."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gendom.estimation.intervals import with_episodes, with_fingers
from gendom.materials.posterior import prior_of


def result(**best) -> Any:
    return SimpleNamespace(best=SimpleNamespace(**best), noise=[None, None])


def test_a_quarter_of_the_turn_in_the_fingers_counts():
    """With what it does to the others, at most the prior's deviation."""
    prior, covariance = (
        prior_of(("E_over_rho", "grip_turn")),
        np.array([[0.02, 0.02], [0.02, 0.04]]),
    )
    problem: Any = SimpleNamespace(prior=prior)
    wider = with_fingers(problem, result(vector=np.array([5.0, 0.4])), covariance)
    moved = np.minimum([0.05, 0.1], prior.sd)
    np.testing.assert_allclose(wider, covariance + np.outer(moved, moved), rtol=1e-12)
    others: Any = SimpleNamespace(prior=prior_of(("E_over_rho", "nu")))
    same = with_fingers(others, result(vector=np.array([5.0, 0.4])), covariance)
    np.testing.assert_array_equal(same, covariance)


@pytest.mark.parametrize("captured", [True, False])
def test_episodes_that_pull_apart_count(captured):
    """Ten of them pull by 2, and by nothing: a variance of 0.1 becomes 0.1^2 * 10 * 2^2. Of two
    recordings only a motion capture pulls."""
    pulls = np.zeros((40, 2))
    pulls[:, 0] = np.repeat([0.5, -0.5] * 5, 4)
    parts = [
        SimpleNamespace(scene=SimpleNamespace(captured=c), shown=np.arange(2))
        for c in (captured, False)
    ]
    own = [SimpleNamespace(fit=lambda noise: SimpleNamespace(pulls=pulls))] * 2
    problem: Any = SimpleNamespace(parts=parts)
    found = result(comparison=SimpleNamespace(parts=own))
    wider = with_episodes(problem, found, np.diag([0.1, 0.3]))
    np.testing.assert_allclose(wider, np.diag([0.4 if captured else 0.1, 0.3]), atol=1e-12)
