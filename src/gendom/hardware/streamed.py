"""A robot whose driver runs in a process of its own.

The process outlives the program that started it: if that ends or is interrupted, the arm brakes
along its path. A late tick moves all those after it. A fault stays until the robot is connected
again.
"""

import math
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from gendom.arguments import check_number, require
from gendom.arrays import Array
from gendom.errors import DeviceError, GendomError
from gendom.hardware.cell import Cell
from gendom.hardware.contracts import RobotState, Tick
from gendom.hardware.streaming import Driver, Streamer
from gendom.robot import JointMotion

_CONNECTING, _STARTING, _SILENT = 20.0, 60.0, 5.0  # [s]; to connect, to start, without a row
_ROWS, _TEXT = 1 << 14, 2000  # of the board; ticks of 160 s
_REPORT = "press the emergency stop, then look at the controller"


class _Board:
    """Rows in shared memory, one a tick: written without waiting, read by the other process."""

    def __init__(self, context: Any, joints: int) -> None:
        self.joints = joints
        self.rows = context.RawArray("d", _ROWS * (5 + 2 * joints))
        self.count = context.RawValue("q", 0)
        self.text = context.RawArray("c", _TEXT)

    def _table(self) -> Array:
        return np.frombuffer(self.rows).reshape(_ROWS, -1)

    def write(self, streamer: Streamer) -> None:
        report, fault = streamer.report, streamer.fault
        opening = math.nan if report.opening is None else report.opening
        head = (time.monotonic(), streamer.elapsed, report.time, opening, streamer.moving)
        self.text.value = (fault or "").encode()[: _TEXT - 1]
        row = np.concatenate([head, streamer.command, report.q])
        self._table()[self.count.value % _ROWS] = row
        self.count.value += 1

    def read(self, first: int) -> tuple[list[Array], int]:
        """Rows from number `first` on, and the number of the next one."""
        table, end = self._table(), self.count.value
        numbers = range(max(first, end - _ROWS + 8), end)  # older ones are being overwritten
        return [table[k % _ROWS].copy() for k in numbers], end


def _serve(link: Connection, board: _Board, cell: Cell, make: Callable[[Cell], Driver]) -> None:
    """The process that streams: connects, then ticks until it is told to end or is alone."""
    parent = os.getppid()
    leaving: list[str] = []
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # until there is a motion to end
    with suppress(AttributeError, OSError):  # where it is allowed, ticks go before other work
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    link.send(("started", ""))
    driver = make(cell)
    try:
        driver.connect()
        streamer = Streamer(driver, cell)
    except Exception as error:  # SDKs raise what they like
        link.send(("fault", str(error)))
        return
    signal.signal(signal.SIGINT, lambda *_: streamer.brake("interrupted by Ctrl-C"))
    signal.signal(signal.SIGTERM, lambda *_: leaving.append("ended from outside"))
    link.send(("done", ""))
    due, asked = time.monotonic(), False
    while not (leaving and not streamer.moving):
        now = time.monotonic()  # a late tick moves those after it
        due = driver.period + (due if now < due + 0.5 * driver.period else now)
        streamer.tick()
        board.write(streamer)
        if os.getppid() != parent and not leaving:
            leaving.append("the program that moved the arm is gone")
        if leaving:
            streamer.brake(leaving[0])
        if asked and not streamer.moving and all(g.done() for g in streamer.grips):
            asked, streamer.fault = False, streamer.fault or streamer.grip_fault()
            kind = "fault" if streamer.fault else "refused" if streamer.ended else "done"
            with suppress(OSError):
                link.send((kind, streamer.fault or streamer.ended or ""))
        while (wait := due - time.monotonic()) > 0.0:
            try:
                if not link.poll(wait):
                    break
                asked = _obey(link.recv(), streamer, leaving) or asked
            except (EOFError, OSError):
                leaving.append("the program that moved the arm is gone")
                time.sleep(max(0.0, due - time.monotonic()))
    with suppress(GendomError):
        driver.disconnect()


def _obey(order: tuple[str, Any], streamer: Streamer, leaving: list[str]) -> bool:
    """Carry out an order of the program; whether it waits for an answer."""
    name, what = order
    if name == "stop":
        streamer.brake("stopped")
    elif name == "end":
        leaving.append("disconnected")
    else:
        streamer.ended = None
        try:
            (streamer.start if name == "play" else streamer.grip)(what)
        except Exception as error:
            streamer.ended = str(error)
    return name in ("play", "grip")


class StreamedRobot:
    """A `Robot` whose driver runs in a process of its own.

    Args:
        cell: The cell, whose arm, address, limits and workspace hold.
        driver: Makes the driver from the cell, in the other process; must be picklable.
    """

    def __init__(self, cell: Cell, driver: Callable[[Cell], Driver]) -> None:
        self.cell, self.arm = cell, cell.model
        self._driver = driver
        self._process: Any = None
        self._board: Any = None
        self._lock = threading.Lock()
        self._asked = False
        self._fault: str | None = None

    def connect(self) -> None:
        """Start the process and connect to the controller; a fault of before is forgotten.

        Raises:
            DeviceError: The controller refuses, is silent or has a fault.
        """
        self.disconnect()
        context = multiprocessing.get_context("spawn")
        self._board = _Board(context, self.arm.joints)
        self._link, other = context.Pipe()
        arguments = (other, self._board, self.cell, self._driver)
        self._process = context.Process(target=_serve, args=arguments, daemon=True)
        self._process.start()
        other.close()
        try:
            for wait in (_STARTING, _CONNECTING):
                what = f"{self.cell.address} does not answer"
                fix = "check power, cable and address"
                require(self._link.poll(wait), what, fix=fix, error=DeviceError)
                self._answered()
            self._wait(lambda: self._board.count.value > 0, _SILENT)
        except BaseException:
            self._process.kill()
            self.disconnect()
            self._board = None
            raise
        self._fault = None

    def state(self) -> RobotState:
        """What was last reported, also after `disconnect`.

        Raises:
            DeviceError: The robot was never connected.
        """
        require(self._board is not None, "not connected", fix="connect()", error=DeviceError)
        row = self._board.read(self._board.count.value - 1)[0][-1]
        alive = self._process is not None and self._process.is_alive()
        fault = self._fault or self._board.text.value.decode(errors="replace") or None
        if fault is None and not alive:
            gone = f"the process that moves the arm is gone; {_REPORT}"
            fault = "not connected" if self._process is None else gone
        return RobotState(
            time=row[2],
            q=row[5 + self.arm.joints :],
            opening=None if math.isnan(row[3]) else row[3],
            moving=bool(row[4]) and alive,
            fault=fault,
        )

    def play(self, motion: JointMotion, *, on_tick: Callable[[Tick], None] | None = None) -> None:
        """Follow a motion; `gendom.hardware.Robot.play`."""
        self._do("play", motion, on_tick)

    def gripper(self, opening: float) -> None:
        """Move the fingers; `gendom.hardware.Robot.gripper`."""
        opening = check_number("opening", opening, least=0.0)
        self._do("grip", min(opening, self.cell.tool.max_opening))

    def stop(self) -> None:
        """Brake along the path and hold; returns when the arm stands."""
        if self._process is not None and self._process.is_alive():
            self._send("stop", None)
            self._wait(lambda: not self.state().moving, _SILENT)

    def disconnect(self) -> None:
        """Brake if it moves, and end the process."""
        if self._process is not None:
            with suppress(DeviceError, OSError):
                self._send("end", None)
            self._process.join(_SILENT)
            self._process.kill()
            self._process.join()
            self._link.close()
            self._process = None

    # ---- the other process -----------------------------------------------------------------------

    def _do(self, name: str, what: Any, on_tick: Callable[[Tick], None] | None = None) -> None:
        """Give an order and wait until it is done; Ctrl-C and errors of `on_tick` stop the arm."""
        fault, fix = self.state().fault, "then connect() again"
        require(fault is None, fault or "", fix=fix, error=DeviceError)
        first = self._board.count.value
        self._send(name, what)
        self._asked = True
        try:
            self._until_answered(first, on_tick)
        except BaseException:
            if self._asked:
                self.stop()
                with suppress(DeviceError):
                    self._until_answered(first, None)
            raise

    def _send(self, name: str, what: Any) -> None:
        try:
            with self._lock:
                self._link.send((name, what))
        except OSError:
            raise self._gone() from None

    def _gone(self) -> DeviceError:
        self._asked = False
        self._fault = f"the process that moves the arm is gone or hangs; {_REPORT}"
        return DeviceError(self._fault)

    def _answered(self) -> None:
        try:
            kind, text = self._link.recv()
        except (EOFError, OSError):
            raise self._gone() from None
        self._asked = False
        if kind == "fault":
            self._fault = text
        ok = kind in ("started", "done")
        require(ok, text, error=DeviceError)

    def _wait(self, done: Callable[[], bool], most: float) -> None:
        end = time.monotonic() + most
        while not done():
            if time.monotonic() > end or not self._process.is_alive():
                raise self._gone()
            time.sleep(0.005)

    def _until_answered(self, first: int, on_tick: Callable[[Tick], None] | None) -> None:
        """Hand on rows from number `first` on, until the other process answers."""
        heard, J, tell = time.monotonic(), self.arm.joints, on_tick or (lambda _: None)
        since_1970 = time.time() - heard
        while True:
            answered = self._link.poll(0.02)
            rows, first = self._board.read(first)
            heard = time.monotonic() if rows else heard
            for row in rows:
                written, elapsed, reported, opening = row[:4]
                if math.isfinite(elapsed):
                    tell(Tick(
                        time=elapsed, command=row[5 : 5 + J], measured=row[5 + J :],
                        age=written - reported, stamp=reported + since_1970,
                        opening=None if math.isnan(opening) else opening,
                    ))  # fmt: skip
            if answered:
                return self._answered()
            if time.monotonic() - heard > _SILENT or not self._process.is_alive():
                raise self._gone()
