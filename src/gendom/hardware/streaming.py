"""An arm that follows a motion tick by tick: what a controller must offer, and what is checked.

Every tick compares the next command with the limits, and what was measured with what was
commanded. However late a tick is, the motion's clock goes on by one period, so that commands never
burst. What leaves the path in doubt brakes along the path; what the arm no longer obeys is left to
the controller's own stop. A fault stays.
"""

import math
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Protocol

import numpy as np

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import DeviceError, GendomError
from gendom.hardware.cell import FASTEST_TOOL, SLACK, Cell
from gendom.hardware.contracts import RobotState
from gendom.robot import JointMotion, tcp_pose

BLIND = (0.03, 0.1)
"""Largest age of a report, and lateness of a tick, at full speed and at most [s]. In between it is
inversely proportional to the motion's largest share of the speed limits: 0.1 s from 30 % down."""
TRACKING = math.radians(2.0)
"""Largest distance of the measured joints from all commands of the last `LAG` [rad]."""
LAG = 0.1
"""How far behind its commands an arm may be [s]."""

_STILL = math.radians(1.0)  # reports that stay equal while commands move so far are frozen
_SLOWEST_BRAKE = 0.5  # [s]; if a joint that turns back leaves no acceleration for braking


class Driver(Protocol):
    """A controller that follows a stream of joint angles. All methods may raise `DeviceError`."""

    period: float
    """Between two commands [s]."""

    def connect(self) -> None: ...

    def report(self) -> RobotState:
        """The newest report, `moving` left out; does not wait."""
        ...

    def begin(self) -> None:
        """Make the controller ready for a stream of commands."""

    def servo(self, q: Array) -> None:
        """One command [J] [rad]."""

    def end(self) -> None:
        """End the stream; the arm stands."""

    def halt(self) -> None:
        """Ask the controller to stop the arm its own way, whatever it does."""

    def grip(self, opening: float) -> None:
        """Move the fingers [m] and wait; on a connection of its own, called from a thread."""

    def disconnect(self) -> None: ...


class Streamer:
    """Follows one motion at a time; `tick` is called once a period."""

    def __init__(
        self, driver: Driver, cell: Cell, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.driver, self.cell, self.clock = driver, cell, clock
        self.arm, self.limits = cell.model, cell.limited
        self.grips: list[Future[None]] = []
        """Orders to the gripper; a thread of its own gives them, which may take seconds."""
        self._hand = ThreadPoolExecutor(1)
        self.report = driver.report()
        self.command = self.report.q
        self.moving = False
        self.elapsed = math.nan
        """Since the motion's start [s]; NaN: it has not begun or is over."""
        self.fault: str | None = None
        self.ended: str | None = None
        """Why the last motion ended before its time, without a fault."""

    # ---- motions ---------------------------------------------------------------------------------

    def start(self, motion: JointMotion) -> None:
        """Begin to follow a motion.

        Raises:
            GendomError: It passes a limit or leaves the workspace, or the arm is not at its start.
        """
        self.report = report = self.driver.report()
        self.fault = self.fault or report.fault
        require(self.fault is None, self.fault or "", error=DeviceError)
        age, fix = self.clock() - report.time, "check the cable and the controller"
        what = f"the last report of the joints is {1e3 * age:.0f} ms old"
        require(age <= BLIND[1], what, fix=fix, error=DeviceError)
        motion.check_limits(self.limits)
        self.cell.check_tool(motion, 1.0 / self.driver.period)
        self.cell.check_start(motion, report.q)
        kinds = ("speed", "tool speed")
        full = replace(self.arm, max_tcp_speed=FASTEST_TOOL)
        share = max(use.share for use in motion.limit_uses(full) if use.kind in kinds)
        self.blind = min(BLIND[0] / max(share, 1e-9), BLIND[1])
        # What the arm is off the first pose is made up for slowly, before the motion's clock runs.
        at = np.clip(report.q, self.arm.q_min, self.arm.q_max)
        self._next = [self.cell.slow_move(at, motion.q[0]), motion]
        self._orders = [
            (e.time - self.cell.tool.latency, 0.0 if e.closed else self.cell.tool.max_opening)
            for e in motion.events
        ]
        self.driver.begin()
        self.command, self.velocity = at, np.zeros_like(at)
        self.tool = tcp_pose(self.limits, at)[:3, 3]
        self.last = self.clock()
        self._sent = deque([(self.last, at)], maxlen=64)
        self._seen, self._fresh, self._from = report.q, self.last, at
        self.braking, self.rate, self.moving = False, 1.0, True
        self._take_next()

    def grip(self, opening: float) -> None:
        """Order an opening [m]; returns at once."""
        self.grips.append(self._hand.submit(self.driver.grip, opening))

    def grip_fault(self) -> str | None:
        """Why the gripper did not do what it was told."""
        errors = (grip.exception() for grip in self.grips if grip.done())
        return next((str(error) for error in errors if error), None)

    def _take_next(self) -> None:
        self.motion: JointMotion = self._next.pop(0)
        self.s = self.motion.time[0]
        self.began = math.nan if self._next else self.clock()

    # ---- a tick ----------------------------------------------------------------------------------

    def tick(self) -> None:
        """Look at what was reported, and send the next command."""
        try:
            self._tick(self.clock())
        except Exception as error:  # whatever a driver, its SDK or we raise: the arm must stand
            self._halt(str(error) if isinstance(error, GendomError) else f"internal: {error!r}")

    def _tick(self, now: float) -> None:
        self.report = report = self.driver.report()
        if not self.moving:
            self.elapsed = math.nan
            self.fault = self.fault or report.fault or self.grip_fault()
            return
        late, self.last = now - self.last - self.driver.period, now
        stop = report.fault or self._stalled(late)
        stop = stop or (None if self.braking else self._lost(report))
        slow = self.grip_fault() or self._unseen(report, now)
        if slow and not stop:
            self.brake(slow, fault=True)
        rate, s, q = self._advanced()
        if stop := stop or self._broken(q):
            self._halt(stop)
            return
        self.driver.servo(q)
        self.velocity = (q - self.command) / self.driver.period
        self.command, self.tool = q, tcp_pose(self.limits, q)[:3, 3]
        self._sent.append((now, q))
        self.rate, self.s, self.elapsed = rate, s, now - self.began
        while self._orders and not self._next and s >= self._orders[0][0] and not self.braking:
            self.grip(self._orders.pop(0)[1])
        if rate == 0.0 or s >= self.motion.end:
            if self._next and not self.braking:
                self._take_next()
            else:
                self.driver.end()
                self.moving = False

    def brake(self, why: str, *, fault: bool = False) -> None:
        """Slow down along the path as fast as the arm's accelerations allow, and stand."""
        if self.moving and not self.braking:
            self.braking = True
            if fault:
                self._latch(why)
            else:
                self.ended = why

    def _latch(self, what: str) -> None:
        when = f" (at t = {self.elapsed:.3f} s)" if math.isfinite(self.elapsed) else ""
        self.fault = self.fault or f"{what}{when}"

    def _halt(self, what: str) -> None:
        self._latch(what)
        try:
            if self.moving:
                self.driver.halt()
        except Exception:
            self.fault = f"{self.fault}; it cannot be told to stop: press the emergency stop"
        self.moving = False

    def _advanced(self) -> tuple[float, float, Array]:
        """Rate of the motion's clock, its time [s] and the command [J] of the next tick."""
        period, motion = self.driver.period, self.motion
        rate = 1.0
        if self.braking:
            # |q' u + q'' rate^2| <= most for each joint, where q(s) is the path and u the change
            # of ds/dt: the least u. A joint that turns back may leave none for a moment.
            dq, ddq = motion.speed_at(self.s), motion.acceleration_at(self.s)
            quick = np.abs(dq) > 1e-9
            most = self.arm.max_acceleration + np.sign(dq) * ddq * self.rate**2
            u = -(most[quick] / np.abs(dq[quick])).min(initial=1.0 / period)
            rate = max(0.0, self.rate + min(u, -1.0 / _SLOWEST_BRAKE) * period)
        s = min(self.s + 0.5 * (self.rate + rate) * period, motion.end)
        return rate, s, motion.at(s)

    # ---- what is checked in a tick ---------------------------------------------------------------

    def _broken(self, q: Array) -> str | None:
        """What is wrong with a command."""
        if not np.isfinite(q).all():
            return "a command is not finite; the motion is damaged: plan it again"
        if self.braking:
            return None
        arm, period = self.limits, self.driver.period
        p, (low, high) = tcp_pose(arm, q)[:3, 3], self.cell.workspace
        velocity = (q - self.command) / period
        acceleration = np.abs(velocity - self.velocity) / period
        tool_speed = np.linalg.norm(p - self.tool) / period
        beyond = {
            "angle": np.maximum(arm.q_min - q, q - arm.q_max),
            "speed": np.abs(velocity) - SLACK * arm.max_speed,
            "acceleration": acceleration - SLACK * arm.max_acceleration,
            "tool speed": tool_speed - SLACK * arm.max_tcp_speed,
            "workspace": np.maximum(low - p, p - high),
        }
        for name, by in beyond.items():
            if np.max(by) > 1e-6:
                what = f"a command passes the limit of {name} by {np.max(by):.3g} (SI units)"
                return f"{what}; the motion is damaged: plan it again"
        return None

    def _lost(self, report: RobotState) -> str | None:
        """Whether the arm is where no command of late was."""
        times = [t for t, _ in self._sent]
        first = max(np.searchsorted(times, report.time - LAG) - 1, 0)
        off = [np.abs(q - report.q).max() for _, q in list(self._sent)[first:]]
        if min(off) <= TRACKING:
            return None
        what = f"the arm is {math.degrees(min(off)):.1f} degrees off its commands"
        return f"{what}; look for what it touched, its load and its brakes"

    def _unseen(self, report: RobotState, now: float) -> str | None:
        """Whether a report is too old, or repeats itself although the arm was sent away."""
        if not np.array_equal(report.q, self._seen):
            self._seen, self._from = report.q, self.command
        if np.abs(self.command - self._from).max() <= _STILL:
            self._fresh = report.time
        age = now - min(report.time, self._fresh)
        if age <= self.blind:
            return None
        old = now - report.time > self.blind
        what = f"is {1e3 * age:.0f} ms old" if old else "repeats itself or the arm does not move"
        what = f"the report of the joints {what}, {1e3 * self.blind:.0f} ms allowed at this speed"
        return f"{what}; check the cable, the arm and what else this computer does"

    def _stalled(self, late: float) -> str | None:
        what = f"a command was {1e3 * late:.0f} ms late, {1e3 * self.blind:.0f} allowed"
        return f"{what}; end other programs on this computer" if late > self.blind else None
