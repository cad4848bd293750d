"""Record a motion of the robot and what the cameras see of it, as `gendom perceive` reads it.

    DIR/
      object.toml      as given
      joints.csv       measured joint angles, 100 rows a second
      gripper.csv      the tool point by these angles, and whether the gripper is closed
      cameras/NAME/    each camera's recording and pose
      recording.json   pictures written and missing of each camera, and what ended the recording

All times are those of the cameras' clock. Rows are on disk as they come: what an interruption or a
fault leaves can be read.
"""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Protocol, TextIO

from gendom.arguments import require
from gendom.errors import DeviceError, GendomError
from gendom.files import write_json
from gendom.hardware.contracts import DepthCamera, Recorded, Tick
from gendom.robot import Arm, JointMotion, tcp_pose

_PIXEL = 5 * 30  # bytes a second of a pixel: 16 bit of depth and 24 of colour, 30 times
_STOP_SPACE = 2e8  # [bytes] at which a recording stops
_LOOK = 0.1  # [s] between two looks at cameras and disk


class Player(Protocol):
    """What is needed of a `gendom.hardware.Robot`."""

    arm: Arm

    def play(self, motion: JointMotion, *, on_tick: Callable[[Tick], None]) -> None: ...

    def stop(self) -> None: ...


def record_motion(
    robot: Player,
    cameras: Sequence[DepthCamera],
    motion: JointMotion,
    folder: Path,
    *,
    description: str,
) -> dict[str, Recorded]:
    """Play a motion and record it; all devices are connected.

    A camera that fails or a full disk stops the robot; what was recorded is kept.

    Args:
        robot: It stands at the motion's start.
        cameras: With different names.
        motion: What is played.
        folder: Made if missing; must not hold a recording.
        description: Content of object.toml.

    Returns:
        How each camera's recording went.

    Raises:
        DeviceError: A device failed, or the disk is full: which, and what is kept.
        GendomError: The folder holds a recording, or cannot be written.
    """
    _check(folder, cameras, motion.end - motion.start)
    for place in (folder, *(folder / "cameras" / camera.name for camera in cameras)):
        place.mkdir(parents=True, exist_ok=True)
    (folder / "object.toml").write_text(description, encoding="utf-8")
    watch = _Watch(robot, cameras, folder)
    started: list[DepthCamera] = []
    recorded: dict[str, Recorded] = {}
    ended = "done"
    try:
        with ExitStack() as stack:
            stack.callback(lambda: recorded.update(_stop_all(started)))
            for camera in cameras:
                camera.start_recording(folder / "cameras" / camera.name)
                started.append(camera)
            for camera in cameras:
                camera.wait_for_pictures()
            rows = stack.enter_context(_Rows(folder, robot, motion))
            stack.enter_context(watch)
            robot.play(motion, on_tick=rows.add)
    except BaseException as error:
        ended = watch.fault or str(error) or type(error).__name__
        raise
    finally:
        about = {
            name: {"pictures": r.pictures, "missing": r.missing} for name, r in recorded.items()
        }
        write_json(
            folder / "recording.json",
            {"format": "gendom-recorded/1", "cameras": about, "ended": watch.fault or ended},
        )
    if watch.fault:
        fix = "mend it and record again; what was recorded so far is kept"
        raise DeviceError(watch.fault, where=str(folder), fix=fix)
    return recorded


def _check(folder: Path, cameras: Sequence[DepthCamera], seconds: float) -> None:
    """Check that a recording can be written to a folder."""
    taken, fix = (folder / "cameras").exists(), "name another folder"
    require(not taken, "holds a recording already", where=str(folder), fix=fix, error=GendomError)
    above = next(p for p in (folder, *folder.resolve().parents) if p.exists())
    free = shutil.disk_usage(above).free
    pixels = sum(one.camera.width * one.camera.height for one in cameras)
    need = _STOP_SPACE + _PIXEL * pixels * seconds
    what = f"the disk has {1e-9 * free:.1f} GB left, {seconds:.0f} s take {1e-9 * need:.1f}"
    fix = "free some, or name another folder"
    require(free >= need, what, where=str(folder), fix=fix, error=DeviceError)


def _stop_all(cameras: Sequence[DepthCamera]) -> dict[str, Recorded]:
    """Stop recordings at the same time: each then waits for its disk."""
    with ThreadPoolExecutor(max(1, len(cameras))) as pool:
        stopped = pool.map(lambda camera: camera.stop_recording(), cameras)
        return dict(zip((camera.name for camera in cameras), stopped, strict=True))


class _Watch:
    """A thread that looks at cameras and disk, and stops the robot when one of them fails."""

    def __init__(self, robot: Player, cameras: Sequence[DepthCamera], folder: Path):
        self.fault: str | None = None
        self._robot, self._cameras, self._folder = robot, cameras, folder
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self._over.wait(_LOOK):
            self.fault = self._found()
            if self.fault:
                self._robot.stop()
                return

    def _found(self) -> str | None:
        for camera in self._cameras:
            if said := camera.fault():
                return f"camera {camera.name} {said}"
        free = shutil.disk_usage(self._folder).free
        return None if free >= _STOP_SPACE else f"the disk has {1e-6 * free:.0f} MB left"

    def __enter__(self) -> _Watch:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._over.set()
        self._thread.join()


class _Rows:
    """joints.csv and gripper.csv, to which each tick adds a row."""

    def __init__(self, folder: Path, robot: Player, motion: JointMotion):
        self._arm, self._motion = robot.arm, motion
        self._files: list[TextIO] = []
        self._last = -float("inf")
        names = ",".join(f"q{j}" for j in range(self._arm.joints))
        for name, header in (("joints.csv", f"time,{names}"), ("gripper.csv", "time,x,y,z,closed")):
            file = open(folder / name, "w", buffering=1, encoding="utf-8")  # noqa: SIM115
            file.write(f"{header}\n")
            self._files.append(file)

    def add(self, tick: Tick) -> None:
        if tick.stamp <= self._last:  # the same report as before
            return
        self._last = tick.stamp
        tool = tcp_pose(self._arm, tick.measured)[:3, 3]
        closed = float(self._motion.closed_at(tick.time) or False)
        for file, row in zip(self._files, (tick.measured, [*tool, closed]), strict=True):
            file.write(",".join([f"{tick.stamp:.6f}", *(f"{x:.6f}" for x in row)]) + "\n")

    def __enter__(self) -> _Rows:
        return self

    def __exit__(self, *_: object) -> None:
        for file in self._files:
            file.close()
