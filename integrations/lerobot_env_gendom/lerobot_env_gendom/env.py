"""Tasks of GenDOM for LeRobot, by its convention of environments (``make_env``).

An episode is one action, carried out to its end by the arm in the MuJoCo test scene (needs the
extra ``reality``). The observation ``agent_pos`` holds the goal, the object's sizes and its
parameters, SI; ``is_success`` in the info says whether the goal was missed by less than `NEAR`.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

TASKS = ("rope-reaching", "rope-casting")
"""In the order of their numbers."""

SEEN = {"rope-reaching": 8, "rope-casting": 9}
"""Numbers of their observations."""

NEAR = 0.01
"""[m]."""


class LeRobotEnv(gymnasium.Wrapper):
    """One task as LeRobot asks for it."""

    _max_episode_steps = 1

    def __init__(self, task: str):
        import gendom.environments  # noqa: F401  registers

        title = "".join(word.capitalize() for word in task.split("-"))
        made = gymnasium.make(f"gendom/{title}-v0", parameters=True, disable_env_checker=True)
        super().__init__(made)
        self.task = self.task_description = f"bring the rope's tip to the goal ({task})"
        spaces: Any = made.observation_space
        self._parts = tuple(sorted(spaces.spaces))
        size = sum(spaces[name].shape[0] for name in self._parts)
        seen = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.observation_space = gymnasium.spaces.Dict({"agent_pos": seen})

    def reset(self, **options: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        seen, info = self.env.reset(**options)
        return self._seen(seen), {**info, "is_success": False}

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        seen, reward, terminated, truncated, info = self.env.step(np.asarray(action, dtype=float))
        near = float(reward) > -NEAR
        return self._seen(seen), float(reward), terminated, truncated, {**info, "is_success": near}

    def _seen(self, seen: dict[str, Any]) -> dict[str, Any]:
        return {"agent_pos": np.concatenate([seen[name] for name in self._parts])}


def make_env(
    n_envs: int = 1, use_async_envs: bool = False
) -> dict[str, dict[int, gymnasium.vector.VectorEnv]]:
    """``{"gendom": {task's number: n_envs side by side}}``."""
    kind = gymnasium.vector.AsyncVectorEnv if use_async_envs else gymnasium.vector.SyncVectorEnv
    mode = gymnasium.vector.AutoresetMode.SAME_STEP
    return {
        "gendom": {
            number: kind(
                [lambda name=name: LeRobotEnv(name) for _ in range(n_envs)], autoreset_mode=mode
            )
            for number, name in enumerate(TASKS)
        }
    }
