"""The contracts of a robot and of a depth camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Protocol, runtime_checkable

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import DeviceError, did_you_mean
from gendom.plugins import plugins
from gendom.robot import Arm, JointMotion


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotState:
    """What a robot last reported."""

    time: float
    """When its oldest part was asked for or arrived, on the clock of `time.monotonic` [s]."""
    q: Array
    """[J] measured, not commanded, joint angles [rad]."""
    opening: float | None = None
    """Measured distance of the fingers' inner faces [m]; None: not reported."""
    moving: bool = False
    fault: str | None = None
    """What is wrong and what a person has to do; None: nothing."""


@runtime_checkable
class Robot(Protocol):
    """An arm with a gripper. All methods but `state` block until what they ask for is done.

    After a fault every method but `state`, `stop` and `disconnect` raises until the robot is
    connected again.
    """

    arm: Arm

    def connect(self) -> None:
        """Raises: `DeviceError` where there is no robot, or it has a fault."""

    def state(self) -> RobotState: ...

    def play(self, motion: JointMotion, *, on_tick: Callable[[Tick], None] | None = None) -> None:
        """Follow a motion in real time, its gripper events included.

        Raises:
            DeviceError: The arm is not at the motion's start, or a fault stopped it: the message
                says which, and what to do.
        """

    def gripper(self, opening: float) -> None:
        """Move the fingers' inner faces to a distance [m] or until they hold something."""

    def stop(self) -> None:
        """Brake along the path and hold. May be called from another thread."""

    def disconnect(self) -> None: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Tick:
    """One row of an execution's log."""

    time: float
    """Since the motion's start [s]."""
    command: Array
    """[J] [rad]."""
    measured: Array
    """[J] [rad]."""
    age: float
    """Of the report that `measured` comes from [s]."""
    stamp: float
    """When `measured` was true, on the clock of the cameras' time stamps [s]: since 1970, or
    simulated."""
    opening: float | None = None
    """[m]."""


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """How one camera's recording went."""

    pictures: int
    """On disk, of all streams."""
    missing: int
    """That the device numbered but that are not on disk."""


@runtime_checkable
class DepthCamera(Protocol):
    """A live depth camera. Its pictures are read from its recordings."""

    name: str

    @property
    def pixels(self) -> int:
        """Of a picture."""
        ...

    def connect(self) -> None:
        """Raises: `DeviceError` where there is no such camera, or it has no such streams."""

    def start_recording(self, folder: Path) -> None:
        """Write all pictures into a folder, as `gendom.perception.read_cameras` reads it."""

    def wait_for_pictures(self) -> None:
        """Return when pictures arrive. Raises: `DeviceError` where none do."""

    def fault(self) -> str | None:
        """What is wrong with the camera while it records; None: nothing."""
        ...

    def stop_recording(self) -> Recorded: ...

    def disconnect(self) -> None: ...


ROBOTS = {
    "xarm7": "gendom.hardware.xarm7:XArmDriver",
    "fr3": "gendom.hardware.franky:FrankaDriver",
    "simulated": "gendom.hardware.simulated:SimulatedRobot",
}
"""Robots by their names: what makes one, or its `gendom.hardware.streaming.Driver`, from the cell
that it stands in."""

DEPTH_CAMERAS = {
    "realsense": "gendom.hardware.realsense:RealSenseCamera",
    "simulated": "gendom.hardware.simulated:SimulatedCamera",
}
"""Depth cameras likewise."""


def find_robot(name: str) -> Any:
    """What makes a robot from its cell: one of `ROBOTS`, or of an entry point ``gendom.robots``.

    Raises:
        DeviceError: There is none.
    """
    found = _find("robot", name, ROBOTS, plugins("robots"))
    if hasattr(found, "servo"):
        return partial(resolve_name("gendom.hardware.streamed:StreamedRobot"), driver=found)
    return found


def find_depth_camera(name: str) -> Any:
    """The class of a depth camera: one of `DEPTH_CAMERAS`, or of an entry point
    ``gendom.depth_cameras``.

    Raises:
        DeviceError: There is none.
    """
    return _find("depth camera", name, DEPTH_CAMERAS, plugins("depth_cameras"))


def _find(kind: str, name: str, own: dict[str, str], others: dict[str, Any]) -> Any:
    found = ({**own, **others}).get(name)
    fix = did_you_mean(name, [*own, *others]) or f"have {', '.join([*own, *others])}"
    require(found, f"there is no {kind} {name!r}", fix=fix, error=DeviceError)
    return resolve_name(found) if isinstance(found, str) else found
