"""Packages for LeRobot, found by LeRobot itself (`make lerobot` makes the environment)."""

from pathlib import Path

import pytest

pytest.importorskip("lerobot", reason="needs lerobot, which no extra brings")
pytest.importorskip("mujoco", reason="needs the extra reality")

from lerobot.envs.configs import EnvConfig
from lerobot.robots import RobotConfig
from lerobot.utils.import_utils import register_third_party_plugins

from simulated_cell import write_cell

ROOT = Path(__file__).resolve().parents[1] / "integrations"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """All packages, as if pip had installed them."""
    place, about = tmp_path_factory.mktemp("site"), "Metadata-Version: 2.1\nVersion: 0.2.0\nName: "
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(place))
        for folder in ROOT.glob("lerobot_*"):
            (place / f"{folder.name}-0.2.0.dist-info").mkdir()
            (place / f"{folder.name}-0.2.0.dist-info" / "METADATA").write_text(about + folder.name)
            patch.syspath_prepend(str(folder))
        register_third_party_plugins()
        yield


def acted(envs):
    seen, _ = envs.reset(seed=0)
    assert seen["agent_pos"].shape[0] == envs.num_envs
    _, reward, done, _, info = envs.step(envs.action_space.sample())
    assert done.all() and (reward < 0.0).all() and "is_success" in info["final_info"]
    return seen["agent_pos"]


def test_environments_and_the_robot_are_found_by_their_names(installed, tmp_path):
    from lerobot.envs.factory import make_env

    config = EnvConfig.get_choice_class("gendom")(task="rope-casting")
    ((number, envs),) = make_env(config, n_envs=2)["gendom"].items()
    assert number == 1
    assert acted(envs).shape[1] == config.features["agent_pos"].shape[0]
    envs.close()
    config = RobotConfig.get_choice_class("gendom")(cell=str(write_cell(tmp_path)))
    from lerobot_robot_gendom import GendomRobot

    robot = GendomRobot(config)
    robot.connect()
    try:
        seen = robot.get_observation()
        assert seen.keys() == robot.observation_features.keys()
        wanted = {**seen, "joint_1.pos": seen["joint_1.pos"] + 0.1}
        assert robot.send_action(wanted) == pytest.approx(wanted, nan_ok=True)
        now = robot.get_observation()
        assert now["joint_1.pos"] == pytest.approx(wanted["joint_1.pos"], abs=0.02)
    finally:
        robot.disconnect()


def test_the_policy_acts_in_the_environment(installed):
    """As `lerobot-eval` makes both; with the object's parameters the goals are reached."""
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.envs.factory import make_env
    from lerobot.envs.utils import preprocess_observation
    from lerobot.policies.factory import make_policy, make_pre_post_processors

    env = EnvConfig.get_choice_class("gendom")(task="rope-casting")
    config = PreTrainedConfig.get_choice_class("gendom")(task="rope-casting")
    policy = make_policy(config, env_cfg=env)
    before, after = make_pre_post_processors(config)
    (envs,) = make_env(env, n_envs=2)["gendom"].values()
    seen, _ = envs.reset(seed=1)
    action = after(policy.select_action(before(preprocess_observation(seen))))
    _, reward, done, _, info = envs.step(action.numpy())
    envs.close()
    assert done.all() and (reward > -0.01).all() and info["final_info"]["is_success"].all()
