"""Tasks led step by step as Gymnasium environments."""

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="needs the extra reality")

import gymnasium
from gymnasium.utils.env_checker import check_env

from gendom.errors import ParameterError
from gendom.materials import size_of, thickness_of
from gendom.tasks.envs import MARKERS, STEPS, StepsEnv, StepsVectorEnv

W, MODULE = 3, "gendom.environments:"


@pytest.fixture(scope="module")
def envs():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gendom.tasks.envs.BANK", 8)
        name = f"{MODULE}gendom/RopeReachingSteps-v0"
        made = gymnasium.make_vec(name, num_envs=W, parameters=True)
        made.reset(seed=0)
        yield made


def episode(envs, action):
    """Seen in all steps, and the last one's reward and information."""
    seen = [envs.reset(seed=1)[0]]
    for k in range(STEPS):
        now, reward, done, _, info = envs.step(np.tile(action(k), (W, 1)))
        seen.append(now)
        assert done.all() == (k == STEPS - 1)
    return np.array(seen), reward, info


def test_a_cloud_stands_in_place_of_markers(envs, monkeypatch):
    """Its points lie on the skin of what the markers show; drawn by the seed."""
    monkeypatch.setattr("gendom.tasks.envs.BANK", 8)
    cloud = StepsVectorEnv("rope-reaching", W, cloud=50)
    (seen, _), (same, _), (markers, _) = (of.reset(seed=3) for of in (cloud, cloud, envs))
    assert cloud.single_observation_space.shape == (3 * 50 + 5 + 1,) and np.array_equal(seen, same)
    points = seen[:, :150].reshape(W, 50, 3)
    item = cloud.items[0]
    spine = markers[:, : 3 * MARKERS].reshape(W, MARKERS, 3)
    off = np.linalg.norm(points[:, :, None] - spine[:, None], axis=-1).min(axis=2)
    assert off.max() < 0.5 / (MARKERS - 1) + thickness_of(item) / size_of(item)
    np.testing.assert_array_equal(seen[:, 150:], markers[:, 6 * MARKERS : -5])
    for _ in range(3):
        moved = cloud.step(np.tile([-1.0, -1.0, 1.0], (W, 1)))[0][:, :150].reshape(W, 50, 3)
    assert (points[..., 0].mean(axis=1) - moved[..., 0].mean(axis=1)).min() > 0.15


def test_a_tool_that_goes_back_and_lets_go_swings_the_tip(envs):
    def pull(k):
        return [-0.25, 0.0, 1.0] if k < 20 else [0.0, 0.0, -1.0]

    seen, reward, info = episode(envs, pull)
    assert seen.shape == (STEPS + 1, W, 6 * MARKERS + 5 + 1 + 5)
    parameters = envs.reset(seed=1)[1]["parameters"]
    assert np.array_equal(seen[0, :, -5:], parameters.astype(np.float32))
    assert len(np.unique(parameters[:, 0])) > 1  # ropes of their own, drawn from the bank
    rest, *_ = episode(envs, lambda k: [0.0, 0.0, 1.0])
    assert np.all((reward > -2.0) & (reward <= 0.0))
    L, goal = size_of(StepsVectorEnv("rope-reaching").task.item), seen[0][:, -6]
    np.testing.assert_allclose(-reward, np.abs(info["reached"][:, 0] / L - goal), atol=1e-4)
    holds = 6 * MARKERS + 3
    assert np.all(seen[:21, :, holds] == 1.0) and not seen[21:, :, holds].any()
    tip = slice(3 * (MARKERS - 1), 3 * MARKERS)
    assert np.all(np.ptp(seen[:, :, tip], axis=0)[:, 0] > 0.3)
    assert np.all(np.ptp(rest[:, :, tip], axis=0)[:, 0] < 0.02)
    assert np.array_equal(seen[0], rest[0])  # the same seed begins the same episodes
    # and they begin again with the next step
    seen, reward, done, _, _ = envs.step(np.zeros((W, 3)))
    assert not done.any() and not reward.any()
    assert np.all(seen[:, 6 * MARKERS + 4] == 1.0)  # all of the time is left


@pytest.mark.parametrize(
    "task", ["rope-casting", pytest.param("cloth-spreading", marks=pytest.mark.slow)]
)
def test_gymnasium_finds_nothing_amiss_and_bad_steps_are_refused(task, monkeypatch):
    monkeypatch.setattr("gendom.tasks.envs.BANK", 2)
    one = StepsEnv(task)
    with pytest.raises(ParameterError, match="call reset first"):
        one.step(np.zeros(2))
    check_env(one, skip_render_check=True)
    seen, _ = one.reset(seed=0)
    after, *_ = one.step(np.ones(2))
    assert np.isfinite(after).all()
    assert after[6 * MARKERS] > seen[6 * MARKERS]  # the tool went ahead
    with pytest.raises(ParameterError, match="actions"):
        one.step(np.zeros(3))
    while not one.step(np.zeros(2))[2]:
        pass
    with pytest.raises(ParameterError, match="the episode is over"):
        one.step(np.zeros(2))


@pytest.mark.parametrize(
    ("words", "task", "settings"),
    [
        ("rope-reaching", "rope-knotting", {"num_envs": 1}),
        ("num_envs", "rope-casting", {"num_envs": 0}),
        ("cloud must be at least 0", "rope-reaching", {"num_envs": 1, "cloud": -1}),
    ],
)
def test_environments_that_there_cannot_be_are_refused(words, task, settings):
    with pytest.raises(ParameterError, match=words):
        StepsVectorEnv(task, **settings)
