"""Policies refined in a world solved in closed form."""

import numpy as np
import pytest

from gendom.errors import PolicyError
from gendom.materials import PARAMETERS, dimensionless_parameters, size_of
from gendom.policies.demonstrations import Demonstrations
from gendom.tasks import ClothSpreading
from policies.ballistic import TASK, Throws, reach_of
from policies.conftest import demonstrations

torch = pytest.importorskip("torch", reason="needs the extra `train`")
pytest.importorskip("onnx", reason="needs the extra `train`")

from gendom.policies.training import Training, train  # noqa: E402

BRIEF = Training(epochs=4, refine=2, refine_cases=100, refine_steps=100, seed=1)
"""Too short for its method to learn the task."""


def thrown(count: int, seed: int = 0, world=None) -> Demonstrations:
    """Demonstrations of `Throws`."""
    rng = np.random.default_rng(seed)
    items = [TASK.draw_item(rng) for _ in range(count)]
    action = np.array([TASK.sample_actions(item, rng, 1)[0] for item in items])
    outcomes = (world or Throws()).carry_out(TASK, items, action)
    L = np.array([size_of(item) for item in items])
    alike = [dimensionless_parameters(item) for item in items]
    reached, risk = (np.array([o.values[n] for o in outcomes]) / L for n in ("x", "sideways"))
    parameters = {n: np.array([a[n] for a in alike]) for n in PARAMETERS}
    return demonstrations(TASK, action / L[:, None], reached, parameters, risk)


def misses(policy, seed: int = 9) -> np.ndarray:
    """Of 200 new cases [lengths]."""
    new = thrown(200, seed)
    action = policy.actions(new.goal, new.parameters)
    p = new.parameters
    return np.abs(
        reach_of(action[:, 0], action[:, 1], p["bending_ratio"], p["damping"]) - new.goal[:, 0]
    )


def test_refined_policies_reach_their_goals(tmp_path):
    data = thrown(300)
    plain = train(data, tmp_path / "plain.onnx", Training(epochs=4, seed=1))
    policy = train(data, tmp_path / "refined.onnx", BRIEF, world=Throws())
    assert misses(policy).mean() < 0.004 < 0.2 * misses(plain).mean()
    about = policy.description.training
    assert about["refine"] == 2 and about["refined_in"] == Throws().settings()
    first, last = (about["errors"][f"goal_rms_before_{n}"] for n in ("refining", "last_round"))
    assert last < 0.5 * first


class Swaying(Throws):
    """Ropes sway the more, the higher they are let go: beyond the limit from 0.5 lengths on."""

    def carry_out(self, task, items, actions, **_):
        assert TASK.risk is not None
        found = super().carry_out(task, items, actions)
        for outcome, item, (_, z) in zip(found, items, np.asarray(actions), strict=True):
            L = size_of(item)
            outcome.values["sideways"] = L * TASK.risk.limit * np.exp((z / L - 0.5) / 0.05)
        return found


def test_risk_is_avoided(tmp_path):
    """Without its loss a share of 0.05 of actions and more is beyond the limit."""
    world = Swaying()
    policy = train(thrown(300, world=world), tmp_path / "p.onnx", BRIEF, world=world)
    new = thrown(200, 9, world)
    assert new.risk is not None and TASK.risk is not None
    new = new.chosen(new.risk < TASK.risk.limit)
    high = policy.actions(new.goal, new.parameters)[:, 1] > 0.5
    assert high.mean() < 0.02


@pytest.mark.parametrize("given", [{"refine": -1}, {"refine": 1, "refine_cases": 0}])
def test_settings_are_checked(given):
    with pytest.raises(PolicyError, match="give 0 rounds or more"):
        Training(**given)


def test_what_cannot_be_refined_is_refused(tmp_path):
    with pytest.raises(PolicyError, match="can be relied on"):
        train(thrown(60), tmp_path / "b.onnx", BRIEF, world=Throws(fails=True))
    ropes = thrown(60)
    goal, action = np.empty((60, 0)), ropes.action[:, :1]
    goalless = demonstrations(ClothSpreading(), action, goal, ropes.parameters)
    with pytest.raises(PolicyError, match="has no goals"):
        train(goalless, tmp_path / "c.onnx", Training(method="inverse", epochs=1, refine=1))
    assert not list(tmp_path.glob("*.onnx"))
