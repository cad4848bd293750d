"""The Franka Research 3 with its hand, through franky-control on libfranka.

Joint velocities are streamed, which franky turns into a trajectory within the arm's limits of
acceleration and jerk at 1 kHz: what a command asks for, plus a share of how far the arm is behind.
A command holds for `_HOLD`; after that franky brakes by itself.

Sources: franky-control 2.0's documentation.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import DeviceError
from gendom.hardware.cell import Cell
from gendom.hardware.contracts import RobotState
from gendom.installation import how_to_install

_GAIN = 10.0  # [1/s]; of the distance from the last command
_HOLD = 50  # [ms]
_FINGER_SPEED, _FORCE = 0.1, 20.0  # [m/s], [N]
_MODES = {
    "UserStopped": "the user stop is pressed; release it",
    "Guiding": "it is being guided by hand; let go",
    "Reflex": "it stopped by a reflex; look for what it touched",
    "Other": "it is not in execution mode; unlock its joints in Desk",
}


class FrankaDriver:
    """A `gendom.hardware.streaming.Driver` that streams joint velocities."""

    period = 0.01
    realtime = "Enforce"
    """Whether the kernel must be a real-time one: a name of ``franky.RealtimeConfig``."""

    def __init__(self, cell: Cell, clock: Callable[[], float] = time.monotonic) -> None:
        self.cell, self.clock = cell, clock
        self._opening: float | None = None
        self._device_time = self._time = -np.inf
        self._said: str | None = None

    def connect(self) -> None:
        """Connect to arm and hand; reflexes of before are forgotten."""
        try:
            import franky  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            what = f"franky cannot be imported ({error})"
            raise DeviceError(what, fix=how_to_install("franka")) from None
        self._franky: Any = franky
        sdk = self._franky
        config = getattr(sdk.RealtimeConfig, self.realtime)
        self._robot = self._try(lambda: sdk.Robot(self.cell.address, realtime_config=config))
        if self._robot.has_errors:
            self._try(self._robot.recover_from_errors)
        self._robot.relative_dynamics_factor = 1.0
        self._hand = self._try(lambda: sdk.Gripper(self.cell.address))
        self._opening = self._hand.width
        fault = self.report().fault
        require(fault is None, fault or "", where=self.cell.address, error=DeviceError)

    def report(self) -> RobotState:
        """The newest state."""
        state = self._try(lambda: self._robot.state)
        if state.time.to_sec() != self._device_time:
            self._device_time, self._time = state.time.to_sec(), self.clock()
        mode, fault = state.robot_mode.name, self._said
        if mode in _MODES:
            errors = str(state.last_motion_errors).strip("[]")
            fault = f"{_MODES[mode]}{f' ({errors})' if errors else ''}"
        return RobotState(time=self._time, q=np.array(state.q), opening=self._opening, fault=fault)

    def begin(self) -> None:
        """Take the arm where it is as the last command."""
        self._last = np.array(self._robot.state.q)

    def servo(self, q: Array) -> None:
        """One command [J] [rad]."""
        behind = self._last - np.array(self._robot.state.q_d)
        speed, self._last = (q - self._last) / self.period + _GAIN * behind, q
        sdk = self._franky
        motion = sdk.JointVelocityMotion(speed, duration=sdk.Duration(_HOLD))
        self._try(lambda: self._robot.move(motion, asynchronous=True))

    def end(self) -> None:
        """Brake what is left of the motion, and hold."""
        self._try(lambda: self._robot.move(self._franky.JointVelocityStopMotion()))

    def halt(self) -> None:
        """End control; the controller brakes."""
        self._try(self._robot.stop)

    def grip(self, opening: float) -> None:
        """Move the fingers, or close them with a force until they hold something."""
        if opening < self._hand.width:
            most = self.cell.tool.max_opening
            order = (opening, _FINGER_SPEED, _FORCE, most, most)
            done = self._try(lambda: self._hand.grasp(*order))
        else:
            done = self._try(lambda: self._hand.move(opening, _FINGER_SPEED))
        self._opening = self._hand.width
        what, fix = "the hand does not move", "look what blocks it, and home it in Desk"
        require(done, what, where=self.cell.address, fix=fix, error=DeviceError)

    def disconnect(self) -> None:
        """Let go of the controller."""
        self._try(self._robot.stop)
        del self._robot, self._hand

    def _try(self, call: Callable[[], Any]) -> Any:
        """Call franky; its errors are faults."""
        try:
            return call()
        except self._franky.Exception as error:
            fix = "look at Desk, then connect again"
            raise DeviceError(str(error), where=self.cell.address, fix=fix) from None
