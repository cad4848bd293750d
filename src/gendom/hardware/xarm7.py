"""The UFACTORY xArm 7 with its gripper, through the vendor's SDK.

Three connections: commands and the stream of reports (port 30003, 100 Hz: mode and state),
measured joints (the stream's are those commanded), and the gripper.

Sources: xarm-python-sdk 1.18, and UFACTORY's developer manual for modes, states and codes.
"""

import contextlib
import io
import logging
import socket
import threading
import time
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import DeviceError
from gendom.hardware.cell import Cell
from gendom.hardware.contracts import RobotState
from gendom.installation import how_to_install

SERVO_MODE = 1
"""The controller follows a stream of joint angles; it does not limit their speed itself."""
OLDEST_FIRMWARE = (1, 10, 0)
"""Older ones report commanded joints only."""

_READY = (0, 1, 2)  # states: in motion or standing, not paused and not stopped
_WAIT, _QUICK = 2.0, 0.1  # [s]; for an answer before and while commands are streamed
_PULSES = 850.0  # of the gripper's position, fully open
_GRIPPER_SPEED = 5000  # the largest [pulses/s]
_NEAR, _STUCK = 10, 5  # [pulses]; arrived; not moved
_HELD, _GRIPPING = 0.5, 4.0  # [s]; fingers that stand so long hold something; the longest move
_LOOK = "check its cable and power, and look at UFACTORY Studio"


class XArmDriver:
    """A `gendom.hardware.streaming.Driver` that streams joint angles."""

    period = 0.01

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self._open = False
        self._streaming = False
        self._stream = (-np.inf, 0, 4)  # when it arrived, mode and state
        self._measured: tuple[float, Array] = (-np.inf, np.zeros(7))
        self._code = 0
        self._opening: float | None = None
        self._holding = False

    def connect(self) -> None:
        """Connect three times, check firmware, faults and gripper."""
        sdk = _sdk()
        self._commands = self._api(sdk, report_type="real")
        self._joints = self._api(sdk, enable_report=False)
        self._hand = self._api(sdk, enable_report=False)
        found, axes = self._commands.version_number, self._commands.axis
        self._require(axes == 7, f"the arm has {axes} joints", "give the address of an xArm 7")
        what = f"firmware {'.'.join(map(str, found))} does not report measured joints"
        self._require(found >= OLDEST_FIRMWARE, what, "update to 1.10 or newer in UFACTORY Studio")
        self._joints.set_timeout(_QUICK)
        self._open = True
        self._commands.register_report_callback(self._reported)
        threading.Thread(target=self._measure, daemon=True).start()
        end = time.monotonic() + _WAIT
        while not np.isfinite(self.report().time):
            self._require(time.monotonic() < end, "no reports arrive", "check the cable")
            time.sleep(0.01)
        fault = self.report().fault
        self._require(fault is None, fault or "", None)
        for order, value in (("enable", True), ("mode", 0), ("speed", _GRIPPER_SPEED)):
            code = getattr(self._hand, f"set_gripper_{order}")(value)
            self._require(code == 0, f"the gripper refuses to set its {order} ({code})", _LOOK)
        self._pulses()

    def report(self) -> RobotState:
        """The newest measured joints; as old as they or the stream, whichever is older."""
        (arrived, mode, state), (asked, q) = self._stream, self._measured
        fault = None
        stopped = self._streaming and state not in _READY
        if stopped:
            self._ask(self._commands)
        if self._code:
            fault = self._said(self._code)
        elif stopped:
            fault = f"the controller stopped (state {state}); look at UFACTORY Studio"
        elif self._streaming and mode != SERVO_MODE:
            fault = f"something else set mode {mode}; end UFACTORY Studio and other programs"
        return RobotState(time=min(arrived, asked), q=q, opening=self._opening, fault=fault)

    def begin(self) -> None:
        """Enable the motors and enter servo mode."""
        api = self._commands
        self._check(api.motion_enable(True), "enable its motors")
        self._check(api.set_mode(SERVO_MODE), "enter servo mode")
        self._check(api.set_state(0), "enter servo mode")
        end = time.monotonic() + _WAIT
        while not (self._stream[1] == SERVO_MODE and self._stream[2] in _READY):
            mode, state = self._stream[1:]
            what = f"it stays in mode {mode}, state {state}"
            self._require(time.monotonic() < end, what, "end UFACTORY Studio and other programs")
            time.sleep(0.01)
        api.set_timeout(_QUICK)
        self._streaming = True

    def servo(self, q: Array) -> None:
        """One joint target."""
        self._check(self._commands.set_servo_angle_j(q.tolist(), is_radian=True), "follow")

    def end(self) -> None:
        """Leave servo mode; the arm stands and holds."""
        self._streaming = False
        self._commands.set_timeout(_WAIT)
        self._check(self._commands.set_mode(0), "leave servo mode")
        self._check(self._commands.set_state(0), "leave servo mode")

    def halt(self) -> None:
        """Stop, by the connection that is not waiting for an answer to a command."""
        self._streaming = False
        self._check(self._joints.set_state(4), "stop")

    def grip(self, opening: float) -> None:
        """Move the fingers until they arrive or hold something."""
        target = round(_PULSES * opening / self.cell.tool.max_opening)
        start = self._pulses()
        if self._holding and target <= start:
            return
        self._check(self._hand.set_gripper_position(target, wait_motion=False), "grip")
        begun = moved = time.monotonic()
        last = start
        while abs(last - target) > _NEAR and (now := time.monotonic()) - moved < _HELD:
            self._require(now - begun < _GRIPPING, "the gripper does not arrive", "look at it")
            time.sleep(0.02)
            at = self._pulses()
            moved, last = (now, at) if abs(at - last) > _STUCK else (moved, last)
        stuck = abs(last - start) <= _STUCK and abs(start - target) > _NEAR
        fix = "check its power and what blocks it, then connect again"
        what = f"the gripper does not move, at {1e3 * (self._opening or 0.0):.0f} mm"
        self._require(not stuck, what, fix)
        self._holding = last - target > _NEAR

    def disconnect(self) -> None:
        """Close all connections."""
        self._open = False
        for api in (self._commands, self._joints, self._hand):
            api.disconnect()

    # ---- the SDK ---------------------------------------------------------------------------------

    def _api(self, sdk: Any, **options: Any) -> Any:
        """A connection. The SDK prints, and sets the process's default timeout of sockets."""
        before = socket.getdefaulttimeout()
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                return sdk(self.cell.address, is_radian=True, check_joint_limit=False, **options)
        except Exception as error:  # the SDK raises no narrower class
            fix = "check its power, the cable and `address`"
            where = f"xArm at {self.cell.address}"
            raise DeviceError(f"it is not there ({error})", where=where, fix=fix) from None
        finally:
            socket.setdefaulttimeout(before)

    def _reported(self, _: Any) -> None:
        self._stream = (time.monotonic(), self._commands.mode, self._commands.state)

    def _measure(self) -> None:
        """Ask for measured joints, and for the fault if there is one."""
        while self._open:
            asked = time.monotonic()
            code, states = self._joints.get_joint_states(num=1)
            if code == 0:
                self._measured = (asked, np.asarray(states[0], dtype=float))
            if not self._streaming:
                self._ask(self._joints)
            time.sleep(max(0.0, self.period - (time.monotonic() - asked)))

    def _ask(self, api: Any) -> None:
        code, found = api.get_err_warn_code()
        self._code = found[0] if code == 0 else self._code

    def _pulses(self) -> int:
        answer = self._hand.get_gripper_position()
        code, pulses = answer if isinstance(answer, tuple) else (answer, 0)
        self._require(code == 0, f"the gripper has a fault ({code})", _LOOK)
        self._opening = self.cell.tool.max_opening * pulses / _PULSES
        return pulses

    def _check(self, code: int, what: str) -> None:
        if code != 0:
            self._ask(self._joints)
        said = self._said(self._code) if self._code else None
        silent = "it does not answer" if code in (-1, 3) else f"it refuses to {what} (code {code})"
        self._require(code == 0, said or silent, None if said else "look at the controller")

    def _said(self, code: int) -> str:
        """A fault in the vendor's words."""
        from xarm.core.config.x_code import ControllerError

        error = ControllerError(code)
        words = (error.title["en"].strip(" ."), error.description["en"].strip(" ."))
        return f"C{code}: {'; '.join(filter(None, words))}; clear it in UFACTORY Studio"

    def _require(self, holds: Any, what: str, fix: str | None) -> None:
        require(holds, what, where=f"xArm at {self.cell.address}", fix=fix, error=DeviceError)


def _sdk() -> Any:
    """The vendor's class of connections."""
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            from xarm.core.utils.log import logger, origin_logger
            from xarm.wrapper import XArmAPI
    except (ImportError, OSError) as error:  # it makes a folder at home when imported
        what = f"the xArm's SDK cannot be imported ({error})"
        raise DeviceError(what, fix=how_to_install("robot")) from None
    for words in (logger, origin_logger):  # they go to standard output
        words.setLevel(logging.CRITICAL)
    return XArmAPI
