"""Packages for LeRobot, found by LeRobot itself (`make lerobot` makes the environment)."""

import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("lerobot", reason="needs lerobot, which no extra brings")
pytest.importorskip("mujoco", reason="needs the extra reality")

from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import _call_make_env, _load_module_from_path, _normalize_hub_result
from lerobot.robots import RobotConfig
from lerobot.utils.import_utils import register_third_party_plugins

from simulated_cell import write_cell

ROOT = Path(__file__).resolve().parents[1] / "integrations"


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Both packages, as if pip had installed them."""
    for folder in ROOT.glob("lerobot_*"):
        info = tmp_path / f"{folder.name}-0.2.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {folder.name}\nVersion: 0.2.0\n"
        )
        monkeypatch.syspath_prepend(str(folder))
    monkeypatch.syspath_prepend(str(tmp_path))
    register_third_party_plugins()
    yield
    for name in [n for n in sys.modules if n.startswith(("lerobot_env_g", "lerobot_robot_g"))]:
        del sys.modules[name]


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
        wanted = {**seen, "joint_1.pos": seen["joint_1.pos"] + 0.1, "joint_2.pos": 99.0}
        wanted["joint_2.pos"] = seen["joint_2.pos"]
        assert robot.send_action(wanted) == pytest.approx(wanted, nan_ok=True)
        now = robot.get_observation()
        assert now["joint_1.pos"] == pytest.approx(wanted["joint_1.pos"], abs=0.02)
    finally:
        robot.disconnect()


def test_the_environment_is_one_of_the_hub(tmp_path):
    """As LeRobot loads a repository's env.py."""
    module = _load_module_from_path(str(ROOT / "lerobot_env_gendom/lerobot_env_gendom/env.py"))
    made = _normalize_hub_result(_call_make_env(module, 2, False, None))
    seen = acted(made["gendom"][0])
    assert seen.shape == (2, module.SEEN["rope-reaching"]) and np.isfinite(seen).all()
