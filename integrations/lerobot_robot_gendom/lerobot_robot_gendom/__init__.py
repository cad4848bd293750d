"""Registers ``gendom`` among LeRobot's robots; LeRobot imports packages of this name.

The robot is the one of a GenDOM cell (``cell.toml``, docs/hardware.md): xArm 7, Franka, another
package's, or simulated. An action is a place to go to: the arm moves there slowly, point to point,
within the cell's limits, and every fault stops it. It is not a servo loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.robots import Robot, RobotConfig


@RobotConfig.register_subclass("gendom")
@dataclass(kw_only=True)
class GendomRobotConfig(RobotConfig):
    """``--robot.type=gendom --robot.cell=cell.toml``."""

    cell: str = "cell.toml"


class GendomRobot(Robot):
    """The robot of a cell: joint angles [rad] and the fingers' opening [m], measured."""

    config_class = GendomRobotConfig
    name = "gendom"

    def __init__(self, config: GendomRobotConfig):
        super().__init__(config)
        from gendom.hardware.cell import Cell
        from gendom.hardware.contracts import find_robot

        self.config = config
        self._cell = Cell.read(Path(config.cell))
        self._robot: Any = find_robot(self._cell.robot)(self._cell)
        self._connected = False

    @property
    def _joints(self) -> list[str]:
        return [f"joint_{k + 1}.pos" for k in range(self._robot.arm.joints)]

    @property
    def observation_features(self) -> dict[str, type]:
        return dict.fromkeys([*self._joints, "gripper.pos"], float)

    @property
    def action_features(self) -> dict[str, type]:
        return self.observation_features

    @property
    def is_connected(self) -> bool:
        return self._connected

    @property
    def is_calibrated(self) -> bool:
        return True

    def connect(self, calibrate: bool = True) -> None:
        """Raises `gendom.errors.DeviceError`: there is no robot, or it has a fault."""
        self._robot.connect()
        self._connected = True

    def calibrate(self) -> None:
        """Nothing: the controller has its joints' zeros."""

    def configure(self) -> None:
        """Nothing: the cell says all."""

    def get_observation(self) -> dict[str, float]:
        """What is measured; an opening that is not reported is NaN."""
        state = self._robot.state()
        opening = np.nan if state.opening is None else state.opening
        return dict(
            zip([*self._joints, "gripper.pos"], map(float, [*state.q, opening]), strict=True)
        )

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        """Go there, and return where the arm was sent: angles beyond its range are cut.

        Raises:
            DeviceError: A fault stopped it; the message says which, and what to do.
        """
        arm = self._robot.arm
        q = np.array([float(action[name]) for name in self._joints])
        q = np.clip(q, arm.q_min, arm.q_max)
        self._robot.play(self._cell.approach(self._robot.state().q, q))
        sent = dict(zip(self._joints, map(float, q), strict=True))
        if (opening := action.get("gripper.pos")) is not None and np.isfinite(opening):
            self._robot.gripper(float(np.clip(opening, 0.0, arm.gripper.max_opening)))
            sent["gripper.pos"] = float(opening)
        return sent

    def disconnect(self) -> None:
        """Leave the arm where it is."""
        self._robot.disconnect()
        self._connected = False
