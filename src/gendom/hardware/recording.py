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

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

from gendom.arguments import require
from gendom.errors import DeviceError, GendomError
from gendom.files import free_room, write_json
from gendom.hardware.contracts import DepthCamera, Recorded, Robot, Tick
from gendom.perception.folder import append_row
from gendom.robot import JointMotion, tcp_pose

_PIXEL = 5 * 30  # bytes a second of a pixel: 16 bit of depth and 24 of colour, 30 times
_STOP_SPACE = 2e8  # [bytes] at which a recording stops
_LOOK = 0.1  # [s] between two looks at cameras and disk


def record_motion(
    robot: Robot,
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
    faults: list[str] = []
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
            stack.enter_context(_watched(robot, cameras, folder, faults))
            robot.play(motion, on_tick=_rows(folder, robot, motion))
    except BaseException as error:
        ended = str(error) or type(error).__name__
        raise
    finally:
        about = {n: {"pictures": r.pictures, "missing": r.missing} for n, r in recorded.items()}
        said = {"format": "gendom-recorded/1", "cameras": about, "ended": (*faults, ended)[0]}
        write_json(folder / "recording.json", said)
    if faults:
        fix = "mend it and record again; what was recorded so far is kept"
        raise DeviceError(faults[0], where=str(folder), fix=fix)
    return recorded


def _check(folder: Path, cameras: Sequence[DepthCamera], seconds: float) -> None:
    """Check that a recording can be written to a folder."""
    taken, fix = (folder / "cameras").exists(), "name another folder"
    require(not taken, "holds a recording already", where=str(folder), fix=fix, error=GendomError)
    free = free_room(folder)
    need = _STOP_SPACE + _PIXEL * sum(one.pixels for one in cameras) * seconds
    what = f"the disk has {1e-9 * free:.1f} GB left, {seconds:.0f} s take {1e-9 * need:.1f}"
    fix = "free some, or name another folder"
    require(free >= need, what, where=str(folder), fix=fix, error=DeviceError)


def _stop_all(cameras: Sequence[DepthCamera]) -> dict[str, Recorded]:
    """Stop recordings at the same time: each then waits for its disk."""
    with ThreadPoolExecutor(max(1, len(cameras))) as pool:
        return dict(pool.map(lambda camera: (camera.name, camera.stop_recording()), cameras))


@contextmanager
def _watched(
    robot: Robot, cameras: Sequence[DepthCamera], folder: Path, faults: list[str]
) -> Iterator[None]:
    """Look at cameras and disk, in a thread; when one of them fails stop the robot, and say so in
    `faults`."""
    over = threading.Event()

    def look() -> None:
        while not over.wait(_LOOK) and not faults:
            faults.extend(f"camera {c.name} {said}" for c in cameras if (said := c.fault()))
            free = free_room(folder)
            faults.extend([f"the disk has {1e-6 * free:.0f} MB left"] * (free < _STOP_SPACE))
            if faults:
                robot.stop()

    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _rows(folder: Path, robot: Robot, motion: JointMotion) -> Callable[[Tick], None]:
    """A function that adds a tick's rows to joints.csv and gripper.csv."""
    joints, gripper, last = folder / "joints.csv", folder / "gripper.csv", -math.inf
    names = ",".join(f"q{j}" for j in range(robot.arm.joints))
    joints.write_text(f"time,{names}\n", encoding="utf-8")
    gripper.write_text("time,x,y,z,closed\n", encoding="utf-8")

    def add(tick: Tick) -> None:
        nonlocal last
        if tick.stamp <= last:  # the same report as before
            return
        last, tool = tick.stamp, tcp_pose(robot.arm, tick.measured)[:3, 3]
        append_row(joints, (tick.stamp, *tick.measured))
        append_row(gripper, (tick.stamp, *tool, motion.closed_at(tick.time) or False))

    return add
