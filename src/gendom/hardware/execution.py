"""Planned actions as files, their execution, and the log of it.

A log is JSON lines, `gendom-execution/1`: the action's plan first, then every call of the robot,
every tick (`Tick`) and every fault as it happens, an `end` last. What was written before a program
was killed can be read; a log without an `end` is told at the next start.
"""

import fcntl
import json
import os
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import DeviceError, RobotError
from gendom.files import LEAST_ROOM, free_room, to_json, write_json
from gendom.hardware.cell import CAREFUL, Cell, PlannedMotion
from gendom.hardware.contracts import Robot, Tick
from gendom.reading import parse_json, read_bytes, read_json, record_of
from gendom.robot import Arm, JointMotion, find_arm, tcp_pose

ACTION_FORMAT = "gendom-action/5"
LOG_FORMAT = "gendom-execution/1"

_FIX = "make it again with gendom act --cell"


# ---- planned actions -----------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """Where a task was planned."""

    T_base_task: Array
    """[4, 4] the task's frame in the robot's [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedAction:
    """What is read of a file of ``gendom act``."""

    task: str
    action: dict[str, float]
    """[SI]."""
    goal: dict[str, float]
    """[SI]."""
    object: dict[str, Any]
    """Kind, sizes and parameters, as `gendom.materials.from_columns` takes them."""
    trajectory: Trajectory
    plan: PlannedMotion


def read_action(path: str | os.PathLike, arm: Arm | None = None) -> PlannedAction:
    """The action in a file of ``gendom act --out``, or in the log of its execution.

    Args:
        path: The file.
        arm: Its arm where that is none of `find_arm`, as one of a URDF or MJCF file.

    Raises:
        GendomError: The file cannot be read.
        RobotError: It holds no planned action, or one that cannot be: a number is not finite, a
            pose leaves the arm's limits, the approach does not lead to the motion's start.
    """
    where = str(path)
    said = read_log(path).header if Path(path).suffix == ".jsonl" else read_json(path, RobotError)
    what = f"has format {said.get('format')!r}, not {ACTION_FORMAT!r}"
    require(said.get("format") == ACTION_FORMAT, what, where=where, fix=_FIX, error=RobotError)
    what = "holds no plan: the arm could not follow it"
    require(said.get("plan"), what, where=where, fix=_FIX, error=RobotError)
    try:
        read = record_of(PlannedAction, said, where=where, fix=_FIX, error=RobotError)
        square = read.trajectory.T_base_task.shape == (4, 4)
        require(square, "T_base_task is no 4 x 4 matrix", error=RobotError)
        arm = arm if arm is not None and arm.name == read.plan.arm else find_arm(read.plan.arm)
        for motion in (read.plan.motion, read.plan.approach):
            motion.check_limits(arm)
    except RobotError as error:
        place = error.where if (error.where or "").startswith(where) else where
        raise RobotError(error.what, where=place, fix=_FIX) from None
    return read


def write_trajectory(path: str | os.PathLike, motion: JointMotion) -> None:
    """Write a motion as a ROS ``trajectory_msgs/JointTrajectory`` of 100 points a second: JSON,
    which is YAML, too. Joints become joint1 and so on, as the vendor's URDF names them."""
    time = motion.sampled(100.0)
    stamps = [divmod(round((t - motion.start) * 1e9), 10**9) for t in time]
    values = {"positions": motion.at(time), "velocities": motion.speed_at(time),
              "accelerations": motion.acceleration_at(time)}  # fmt: skip
    points = [{name: rows[k] for name, rows in values.items()}
              | {"time_from_start": {"sec": seconds, "nanosec": rest}}
              for k, (seconds, rest) in enumerate(stamps)]  # fmt: skip
    names = [f"joint{j + 1}" for j in range(motion.q.shape[1])]
    stamp = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    write_json(path, {"header": stamp, "joint_names": names, "points": points})


# ---- before it moves -----------------------------------------------------------------------------


def preview(planned: PlannedMotion, cell: Cell) -> list[str]:
    """What will happen, for a person: times, distances, speeds.

    Raises:
        RobotError: The cell does not allow it.
    """
    cell.check(planned)
    lines = []
    for name, motion, opening in (
        ("approach", planned.approach, cell.tool.max_opening),
        ("motion", planned.motion, planned.opening),
    ):
        q = motion.at(motion.sampled(100.0))
        x = tcp_pose(cell.model, q)[:, :3, 3]
        way = float(np.linalg.norm(np.diff(x, axis=0), axis=1).sum())
        fastest = next(u.value for u in motion.limit_uses(cell.model) if u.joint is None)
        scene, own = cell.least_clearances(q, opening=opening)
        lines += [
            f"{name:<9} {motion.end - motion.start:.2f} s, the tool goes {1e3 * way:.0f} mm, "
            f"at most {fastest:.3f} m/s, and ends at {', '.join(f'{v:.3f}' for v in x[-1])} m",
            f"{'':<9} nearest {1e3 * scene[0]:.0f} mm ({scene[1] or 'nothing around'}), to itself "
            f"{1e3 * own[0]:.0f} mm ({own[1]})",
        ]
    for event in planned.motion.events:
        word = "closes" if event.closed else "opens"
        lines.append(f"{'hand':<9} {word} at {event.time - planned.motion.start:.3f} s")
    return lines


def careful(planned: PlannedMotion, cell: Cell) -> PlannedMotion:
    """The same motion, so slow that no joint and not the tool passes `CAREFUL` of its speed."""

    def slowed(motion: JointMotion) -> JointMotion:
        uses = motion.limit_uses(cell.model)
        most = max(u.share for u in uses if u.kind in ("speed", "tool speed"))
        return motion.stretched(max(1.0, most / CAREFUL))

    return replace(planned, motion=slowed(planned.motion), approach=slowed(planned.approach))


# ---- the log -------------------------------------------------------------------------------------


class ExecutionLog:
    """Lines of a log, each on its way to the disk as soon as it is written.

    Raises:
        DeviceError: The disk is full.
    """

    def __init__(self, path: Path, header: dict[str, Any]):
        path.parent.mkdir(parents=True, exist_ok=True)
        what, fix = "the disk is full", "make room first: what happens must be written down"
        full = free_room(path.parent) < LEAST_ROOM
        require(not full, what, where=str(path.parent), fix=fix, error=DeviceError)
        self.path = path
        self._file = open(path, "x", buffering=1, encoding="utf-8")  # noqa: SIM115
        fcntl.flock(self._file, fcntl.LOCK_EX)
        self._begun = time.monotonic()
        self.write(log=LOG_FORMAT, started=datetime.now().isoformat(), **header)

    def write(self, **said: Any) -> None:
        said = {"at": round(time.monotonic() - self._begun, 4), **said}
        self._add(json.loads(to_json(said)))

    def tick(self, tick: Tick) -> None:
        """Without the detour of `write`: a hundred a second."""
        self._add({"t": tick.time, "command": tick.command.tolist(), "age": tick.age,
                   "measured": tick.measured.tolist(), "opening": tick.opening})  # fmt: skip

    def _add(self, row: dict[str, Any]) -> None:
        try:
            self._file.write(json.dumps(row, separators=(",", ":")) + "\n")
        except OSError as error:
            what, fix = f"cannot be written ({error.strerror})", "make room: the arm was stopped"
            raise DeviceError(what, where=str(self.path), fix=fix) from None

    def end(self, said: str) -> None:
        try:
            self.write(end=said)
        finally:
            with suppress(OSError):  # of a full disk, which `write` has told
                self._file.close()


@dataclass(frozen=True, eq=False)
class ExecutionRecord:
    """What a log says."""

    header: dict[str, Any]
    """The action's file as it was executed, when, and how fast."""
    time: Array
    """[N] since the start [s] of what was played last: the approach, or the motion."""
    command: Array
    """[N, J] [rad]."""
    measured: Array
    """[N, J] [rad]."""
    age: Array
    """[N] of the reports [s]."""
    events: list[dict[str, Any]]
    """Calls and faults in order."""
    end: str | None
    """How it ended; None: the program was killed."""


def read_log(path: str | os.PathLike) -> ExecutionRecord:
    """What a log says, up to its last whole line.

    Raises:
        DeviceError: It cannot be read, or is no log.
    """
    where, fix = str(path), "name a log of gendom execute"
    lines = read_bytes(path, DeviceError).split(b"\n")
    rows = [parse_json(line, f"{where}, line {n + 1}", DeviceError)
            for n, line in enumerate(lines[:-1]) if line.strip()]  # fmt: skip
    good = bool(rows) and rows[0].get("log") == LOG_FORMAT
    require(good, f"does not begin with {LOG_FORMAT}", where=where, fix=fix, error=DeviceError)
    plays = [n for n, row in enumerate(rows) if row.get("call") == "play" and "given" in row]
    ticks = [row for row in rows[max(plays, default=0) :] if "command" in row]
    keys = ("t", "command", "measured", "age")
    try:
        t, command, measured, age = (np.array([x[k] for x in ticks], dtype=float) for k in keys)
    except (KeyError, TypeError, ValueError):
        raise DeviceError("holds a malformed tick", where=where, fix=fix) from None
    events = [row for row in rows[1:] if "command" not in row]
    end = next((row["end"] for row in reversed(events) if "end" in row), None)
    return ExecutionRecord(rows[0], t, command, measured, age, events, end)


def last_time(folder: Path) -> str | None:
    """What happened in the last execution of a folder of logs, if it has no end; told once.

    Raises:
        DeviceError: It still runs.
    """
    logs = sorted(folder.glob("*.jsonl"))
    if not logs:
        return None
    with open(logs[-1], "a", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            fix = "wait for it, or stop it"
            raise DeviceError("another execution runs", where=str(logs[-1]), fix=fix) from None
        seen = read_log(logs[-1])
        if seen.end is not None:
            return None
        when = f"{seen.time[-1]:.2f} s into the motion" if len(seen.time) else "before the motion"
        last = next((e["call"] for e in reversed(seen.events) if "call" in e), "connect")
        said = f"the last execution was killed {when} (last call: {last})"
        file.truncate(logs[-1].read_bytes().rfind(b"\n") + 1)  # a line that was cut
        file.write(json.dumps({"end": f"{said}; told at the next start"}) + "\n")
    return f"{said}: see {logs[-1]}, and look at arm, gripper and object before going on"


class LoggedRobot:
    """A robot whose calls, ticks and faults are logged: a `Robot`, too."""

    def __init__(self, robot: Robot, log: ExecutionLog):
        self.arm, self._robot, self._log = robot.arm, robot, log

    def __getattr__(self, name: str) -> Any:
        call = getattr(self._robot, name)
        if name == "state":
            return call

        def logged(*given: Any, **others: Any) -> None:
            self._log.write(call=name, given=given if name != "play" else ())
            try:
                call(*given, **others)
            except BaseException as error:
                self._log.write(call=name, fault=f"{type(error).__name__}: {error}")
                raise
            state = self._robot.state()
            age = time.monotonic() - state.time
            self._log.write(call=name, state={**vars(state), "age": age})

        return logged

    def play(self, motion: JointMotion, *, on_tick: Callable[[Tick], None] | None = None) -> None:
        def told(tick: Tick) -> None:
            self._log.tick(tick)
            if on_tick is not None:
                on_tick(tick)

        self.__getattr__("play")(motion, on_tick=told)


# ---- execution -----------------------------------------------------------------------------------


def execute(
    planned: PlannedMotion,
    cell: Cell,
    robot: Robot,
    log: ExecutionLog,
    *,
    ready: Callable[[], None] = lambda: None,
    play: Callable[[Robot, JointMotion], None] = lambda robot, motion: robot.play(motion),
) -> None:
    """Carry out a planned motion: connect, approach, wait for the object, close, play.

    Whatever goes wrong, Ctrl-C included, the arm is told to brake, and the log to end.

    Args:
        planned: Checked against the cell again.
        cell: Where.
        robot: Not connected.
        log: Of all that happens.
        ready: Called at the motion's first pose with open fingers, for a person to bring the
            object; returns when the fingers may close.
        play: How the motion is played, e.g. under cameras that record.

    Raises:
        RobotError: The cell does not allow it.
        DeviceError: The robot has a fault.
    """
    cell.check(planned)
    told: Any = LoggedRobot(robot, log)
    try:
        told.connect()
        told.gripper(cell.tool.max_opening)
        told.play(cell.approach(told.state().q, planned.approach.q[0]))  # from wherever it is
        told.play(planned.approach)
        ready()
        told.gripper(planned.opening)
        motion = planned.motion.shifted(-planned.motion.start)
        if motion.events and motion.events[0].closed:  # they are: from the first report on
            first, *rest = motion.events
            motion = replace(motion, events=(replace(first, time=0.0), *rest))
        play(told, motion)
    except BaseException as error:
        by = f"{type(error).__name__}: {error}"
        by = "Ctrl-C" if isinstance(error, KeyboardInterrupt) else by
        try:
            robot.stop()  # also where nothing can be written any more
        finally:
            robot.disconnect()
            log.end(f"stopped by {by}")
        raise
    told.disconnect()
    log.end("done")
