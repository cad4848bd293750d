"""Registers ``gendom`` among LeRobot's environments; LeRobot imports packages of this name."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig

from lerobot_env_gendom.env import SEEN, TASKS, make_env

__all__ = ["TASKS", "GendomEnv", "make_env"]


@EnvConfig.register_subclass("gendom")
@dataclass
class GendomEnv(EnvConfig):
    """``lerobot-eval --env.type=gendom``: all tasks, or ``--env.task=rope-casting`` alone."""

    task: str | None = None
    fps: int = 1
    features: dict[str, PolicyFeature] = field(
        default_factory=lambda: {
            "agent_pos": PolicyFeature(type=FeatureType.STATE, shape=(SEEN["rope-casting"],)),
            "action": PolicyFeature(type=FeatureType.ACTION, shape=(1,)),
        }
    )
    features_map: dict[str, str] = field(
        default_factory=lambda: {"agent_pos": "observation.state", "action": "action"}
    )

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """None: `make_env` has what is needed."""
        return {}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, Any]]:
        """``{"gendom": {task's number: environments}}``."""
        made = make_env(n_envs, use_async_envs)["gendom"]
        wanted = TASKS if self.task is None else (self.task,)
        return {"gendom": {k: made[k] for k, name in enumerate(TASKS) if name in wanted}}
