"""A cell: a robot, its cameras and what stands around them, as cell.toml describes them
(docs/hardware.md).
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from datetime import date
from functools import cached_property
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gendom.arguments import require
from gendom.datasets import Fault
from gendom.errors import DeviceError, RobotError, did_you_mean
from gendom.hardware.contracts import DepthCamera, Robot, find_depth_camera, find_robot
from gendom.perception import Camera, read_camera
from gendom.perception.camera import rigid
from gendom.reading import read_toml, record_of
from gendom.reality.arm import housing
from gendom.robot import (
    XARM7,
    Arm,
    Box,
    JointMotion,
    Post,
    Surroundings,
    TcpPath,
    arm_shape,
    check_collisions,
    clearances,
    collision_at,
    find_arm,
    follow,
    joint_move,
    tcp_pose,
)

FASTEST_TOOL = 0.8
"""In servo mode [m/s]."""

OLD = 90
"""Days after which a calibration is asked for again."""

LARGEST_ERROR = 0.01
"""Of a camera's pose [m]; beyond it the cell is warned of."""

CAREFUL = 0.1
"""Share of the arm's speeds that an approach has, and any motion that no person confirmed."""

RATE = 50.0
"""At which the tool's way is compared with the workspace [1/s]."""


@dataclass(frozen=True, kw_only=True)
class Tool:
    """The gripper, as measured at setup."""

    max_opening: float
    """[m]."""
    latency: float
    """From the command until the fingers move [s]."""
    mass: float = 0.0
    """[kg]."""


@dataclass(frozen=True, kw_only=True)
class SpeedLimits:
    """How fast the arm may move."""

    tool: float = 0.25
    """[m/s]; at most 0.8."""
    share: float = 0.3
    """Of the arm's own joint speeds and accelerations."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CellCamera:
    """One depth camera of a cell."""

    name: str
    device: str
    """A name that `gendom.hardware.find_depth_camera` knows."""
    serial: str
    T_world_camera: NDArray[np.float64] | None
    """[4, 4] camera to world [m]; None: not calibrated."""
    calibrated: str | None = None
    """Date of the calibration, YYYY-MM-DD."""
    stated_error: float = math.nan
    """Of the pose, as gendom calibrate states it [m]."""


@dataclass(frozen=True, kw_only=True)
class PlannedMotion:
    """A motion of an arm among what stands around it, and how it gets to its start."""

    arm: Arm
    motion: JointMotion
    approach: JointMotion
    """Slow, from the arm's home to the motion's first pose."""
    surroundings: dict[str, Any]
    """What it was planned among, as in files."""
    opening: float
    """Distance of the fingers' inner faces where they hold the object [m]."""
    hangs: float = 0.0
    """How far the object hangs out of them [m]."""
    cell: str | None = None
    """The cell's file; None: planned for a table alone, for simulation only."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """A robot and the space in which it works. The world is the robot's base frame, z up."""

    robot: str
    """A name that `gendom.hardware.find_robot` knows."""
    address: str
    """Of the robot's controller."""
    arm: str
    """As `gendom.robot.find_arm` takes it."""
    tool: Tool
    surroundings: Surroundings
    """Table, keep-out boxes, camera stands, and the least distances of the arm from them and from
    itself."""
    workspace: tuple[NDArray[np.float64], NDArray[np.float64]]
    """Lowest and highest corner [3] of a box that the tool point never leaves [m]."""
    cameras: tuple[CellCamera, ...] = ()
    speed: SpeedLimits = field(default_factory=SpeedLimits)
    path: Path | None = None
    """The file that it was read from."""

    @classmethod
    def read(cls, path: str | os.PathLike) -> Cell:
        """The cell of a file (docs/hardware.md).

        Raises:
            DeviceError: The file cannot be read, a key is unknown or missing, a value impossible.
            RecordingError: A camera's calibration cannot be read.
        """
        path, where = Path(path), str(path)
        table = read_toml(path, error=DeviceError, fix="write one as docs/hardware.md has it")
        _check_keys(_File, table, where)
        fix = "see docs/hardware.md for what belongs there"
        said = record_of(_File, table, where=where, fix=fix, error=DeviceError)
        cameras = tuple(_camera(c, path) for c in said.camera)
        try:
            obstacles = [Box(name=b.name, pose=b.pose(), size=b.size) for b in said.box]
            obstacles += [Post(**vars(s)) for s in said.stand]
        except ValueError:
            fix = "give four numbers, not all 0"
            raise DeviceError("a box is turned by no quaternion", where=where, fix=fix) from None
        except RobotError as error:
            raise DeviceError(error.what, where=f"{where}: {error.where}", fix=error.fix) from None
        poses = {c.name: c.T_world_camera for c in cameras}
        obstacles += [housing(name, T) for name, T in poses.items() if T is not None]
        own = ("robot", "address", "arm", "tool", "speed")
        low, high = (np.array(corner) for corner in said.workspace)
        cell = cls(
            **{name: getattr(said, name) for name in own},
            surroundings=Surroundings(
                table_height=said.table_height,
                obstacles=tuple(obstacles),
                clearance=said.scene_clearance,
                self_clearance=said.self_clearance,
            ),
            workspace=(low, high),
            cameras=cameras,
            path=path,
        )
        cell._check_values()
        return cell

    def _check_values(self) -> None:
        """Refuse what no cell can have.

        Raises:
            DeviceError: It has.
        """
        tool, speed, (low, high) = self.tool, self.speed, self.workspace
        widest = self.model.gripper.max_opening
        names = [o.name for o in self.surroundings.obstacles]
        around = self.surroundings
        table = around.table_height
        opens = 0.0 < tool.max_opening <= widest + 1e-6
        checks = {
            "tool.max_opening": (opens, f"metres up to {widest:g}"),
            "tool.latency": (0.0 <= tool.latency <= 5.0, "seconds"),
            "tool.mass": (0.0 <= tool.mass <= 50.0, "kilograms"),
            "speed.tool": (0.0 < speed.tool <= FASTEST_TOOL, f"m/s up to {FASTEST_TOOL}"),
            "speed.share": (0.0 < speed.share <= 1.0, "a share up to 1"),
            "scene_clearance": (0.0 <= around.clearance <= 1.0, "metres, 0 or more"),
            "self_clearance": (0.0 <= around.self_clearance <= 1.0, "metres, 0 or more"),
            "table_height": (table is None or math.isfinite(table), "metres"),
            "workspace": (bool(np.all(low < high)), "its lowest corner, then the highest"),
            "box, stand, camera": (len(set(names)) == len(names), "each a name of its own"),
        }
        for name, (holds, fix) in checks.items():
            where = f"{self.path}: {name}"
            require(holds, "is out of range", where=where, fix=f"give {fix}", error=DeviceError)
        find_robot(self.robot)
        for camera in self.cameras:
            find_depth_camera(camera.device)

    @cached_property
    def model(self) -> Arm:
        """The arm, with its own limits."""
        return find_arm(self.arm, files=True)

    @cached_property
    def limited(self) -> Arm:
        """The arm, with no more than this cell's speeds and accelerations."""
        arm, share = self.model, self.speed.share
        return replace(
            arm,
            max_speed=share * arm.max_speed,
            max_acceleration=share * arm.max_acceleration,
            max_tcp_speed=min(self.speed.tool, arm.max_tcp_speed),
        )

    @property
    def simulated(self) -> bool:
        """Whether nothing real moves."""
        return self.robot == "simulated"

    def devices(self) -> tuple[Robot, list[DepthCamera]]:
        """The robot and the cameras, not connected yet.

        Raises:
            DeviceError: A vendor's SDK is missing, or a camera has no pose.
        """
        robot = find_robot(self.robot)(self)
        return robot, [find_depth_camera(c.device)(c) for c in self.cameras]

    # ---- what is wrong with it -------------------------------------------------------------------

    def faults(self, today: date | None = None) -> list[Fault]:
        """What is wrong with the cell: errors, and warnings of what to look after.

        Args:
            today: Date that calibrations are compared with; None: the clock's.
        """
        found = [Fault(*said, "error") for said in self._wrong()]
        return found + [Fault(*said, "warning") for said in self._doubtful(today or date.today())]

    def _wrong(self) -> Iterator[tuple[str, str, str]]:
        arm, (low, high) = self.model, self.workspace
        if hit := collision_at(arm, arm.home, self.surroundings):
            yield f"at the arm's home pose {hit}", "home", f"move the {hit.second}"
        home = tcp_pose(arm, arm.home)[:3, 3]
        if not np.all((home >= low) & (home <= high)):
            what = f"does not hold the tool point of the arm's home pose, {_point(home)} m"
            yield what, "workspace", "enlarge it, or check that it is in the base's frame"
        links = [*arm.T_links[1:], arm.T_flange_tcp]
        shoulder, reach = arm.T_links[0][:3, 3], sum(np.linalg.norm(T[:3, 3]) for T in links)
        far = np.maximum(np.abs(low - shoulder), np.abs(high - shoulder))
        if np.linalg.norm(far) > 1.5 * reach:
            what = (
                f"goes {np.linalg.norm(far):.3g} m from the shoulder, the arm {reach:.3g} at most"
            )
            yield what, "workspace", "give metres, and no more than the arm needs"
        table = self.surroundings.table_height
        if table is not None and low[2] < table - 1e-9:
            what = f"begins {1e3 * (table - low[2]):.0f} mm below the table"
            yield what, "workspace", "raise its lowest corner to the table"

    def _doubtful(self, today: date) -> Iterator[tuple[str, str, str]]:
        for camera in self.cameras:
            where, fix = f"camera {camera.name}", "run gendom calibrate"
            if camera.T_world_camera is None:
                yield "is not calibrated", where, fix
                continue
            if camera.calibrated is None:
                yield "does not say when it was calibrated", where, "give calibrated = YYYY-MM-DD"
            elif (days := (today - date.fromisoformat(camera.calibrated)).days) > OLD:
                yield f"was calibrated {days} days ago", where, f"{fix} again"
            if not camera.stated_error <= LARGEST_ERROR:
                said = "nothing" if math.isnan(camera.stated_error) else f"{camera.stated_error} m"
                yield f"states {said} as its error", where, fix
        if not self.cameras:
            yield "has no camera", "camera", "add one: a lift is seen by two"
        if self.surroundings.table_height is None:
            yield "has no table", "table_height", "give it unless the arm hangs free"

    # ---- planning --------------------------------------------------------------------------------

    def plan(self, path: TcpPath, *, opening: float, hangs: float = 0.0) -> PlannedMotion:
        """How the arm follows a path of the tool here.

        Args:
            path: In the base's frame.
            opening: Distance of the fingers' inner faces, the object's thickness [m].
            hangs: How far the object hangs out of them [m].

        Raises:
            RobotError: It cannot within its limits, or leaves the workspace, or comes too near to
                something.
        """
        arm, around = held(self.limited, opening, hangs), self.surroundings
        motion = follow(arm, path, slow_down=True, surroundings=around, opening=opening)
        planned = PlannedMotion(
            arm=self.model,
            motion=motion,
            approach=self.approach(self.model.home, motion.q[0]),
            surroundings=asdict(around),
            opening=opening,
            hangs=hangs,
            cell=None if self.path is None else str(self.path),
        )
        self._check_workspace(planned)
        return planned

    def approach(self, q_from: NDArray[np.float64], q_to: NDArray[np.float64]) -> JointMotion:
        """A slow move from joint to joint, at `CAREFUL` of the arm's limits, with the fingers open:
        straight, or with a stop where some joints have moved and the others not yet.

        Raises:
            RobotError: It comes too near to something.
        """
        joint, refused = np.arange(self.model.joints), None
        masks = [mask for k in joint[1:] for mask in (joint < k, joint >= k)]
        for via in [q_from, *(np.where(mask, q_to, q_from) for mask in masks)]:
            ways = [(q_from, q_to)] if via is q_from else [(q_from, via), (via, q_to)]
            try:
                first, *more = [
                    joint_move(
                        self.model, *way, share=min(CAREFUL, self.speed.share),
                        surroundings=self.surroundings, opening=self.tool.max_opening,
                    )
                    for way in ways
                ]  # fmt: skip
            except RobotError as error:
                refused = refused or error
                continue
            return first.then(more[0]) if more else first
        assert refused is not None
        raise RobotError(f"the approach: {refused.what}", where=refused.where, fix=refused.fix)

    def check(self, planned: PlannedMotion) -> None:
        """Check a planned motion against this cell, whatever it was planned for.

        Raises:
            RobotError: A limit is passed, the tool leaves the workspace, or a clearance is missed.
        """
        arm, around = held(self.limited, planned.opening, planned.hangs), self.surroundings
        moves = (
            (arm, planned.motion, planned.opening),
            (self.limited, planned.approach, self.tool.max_opening),
        )
        for body, move, opening in moves:
            move.check_limits(self.limited)
            check_collisions(body, move, around, opening=opening)
        self._check_workspace(planned)

    def _check_workspace(self, planned: PlannedMotion) -> None:
        low, high = self.workspace
        x = planned.motion.tcp_at(self.model, planned.motion.sampled(RATE))[:, :3, 3]
        out = np.maximum(low - x, x - high).max(axis=1)
        k = int(np.argmax(out))
        what = f"the tool leaves the workspace by {1e3 * out[k]:.0f} mm, at {_point(x[k])} m"
        fix, where = "choose another --origin, or enlarge the workspace", str(self.path or "cell")
        require(out[k] <= 1e-6, what, where=where, fix=fix, error=RobotError)

    def least_clearances(
        self, q: NDArray[np.float64], *, opening: float
    ) -> tuple[tuple[float, str], tuple[float, str]]:
        """Least distances [m] at joint angles [N, J] of the arm from its surroundings and from
        itself, each with whose it is; the fingers, which reach for the object, are not compared
        with the table."""
        found = clearances(self.model, q, self.surroundings, opening=opening)
        distance = found.distance.min(axis=0)
        others = {"table", *(o.name for o in self.surroundings.obstacles)}
        shape = arm_shape(self.model, self.model.home, opening)
        fingers = {n for n, t in zip(shape.names, shape.touches_object, strict=True) if t}
        least = []
        for outside in (True, False):
            some = [
                (float(d), f"{a} and {b}")
                for d, (a, b) in zip(distance, found.pairs, strict=True)
                if (b in others) == outside and not (b == "table" and a in fingers)
            ]
            least.append(min(some, default=(math.inf, "")))
        return least[0], least[1]


def held(arm: Arm, opening: float, hangs: float) -> Arm:
    """The arm with an object in its fingers, of the thickness of their opening [m], that hangs out
    of them [m]; 0: none."""
    return arm.holding(hangs, 0.5 * opening) if hangs > 0.0 else arm


BARE = Cell(
    robot="simulated",
    address="",
    arm=XARM7.name,
    tool=Tool(max_opening=XARM7.gripper.max_opening, latency=0.0),
    surroundings=Surroundings(table_height=0.0),
    workspace=(np.full(3, -np.inf), np.full(3, np.inf)),
    speed=SpeedLimits(tool=math.inf, share=1.0),
)
"""An arm on its table and nothing else, for simulation only."""


def _point(x: NDArray[np.float64]) -> str:
    return f"({', '.join(f'{v:.3f}' for v in x)})"


# ---- the file ------------------------------------------------------------------------------------


_Point = tuple[float, float, float]
_Row = tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class _CameraEntry:
    name: str
    device: str
    serial: str = ""
    T_world_camera: tuple[_Row, _Row, _Row, _Row] | None = None
    calibration: str | None = None
    calibrated: date | None = None
    stated_error: float = math.nan


@dataclass(frozen=True, kw_only=True)
class _BoxEntry:
    name: str
    position: _Point
    size: _Point
    quat_xyzw: _Row = (0.0, 0.0, 0.0, 1.0)

    def pose(self) -> NDArray[np.float64]:
        return rigid(Rotation.from_quat(self.quat_xyzw).as_matrix(), self.position)


@dataclass(frozen=True, kw_only=True)
class _StandEntry:
    name: str
    start: _Point
    end: _Point
    radius: float


@dataclass(frozen=True, kw_only=True)
class _File:
    robot: str
    address: str
    tool: Tool
    workspace: tuple[_Point, _Point]
    arm: str = XARM7.name
    table_height: float | None = None
    speed: SpeedLimits = field(default_factory=SpeedLimits)
    scene_clearance: float = 0.02
    self_clearance: float = 0.01
    camera: tuple[_CameraEntry, ...] = ()
    box: tuple[_BoxEntry, ...] = ()
    stand: tuple[_StandEntry, ...] = ()


def _check_keys(kind: Any, table: dict[str, Any], where: str) -> None:
    """Refuse keys that a file's tables do not have.

    Raises:
        DeviceError: There is one.
    """
    known, types = [f.name for f in fields(kind)], get_type_hints(kind)
    for key, value in table.items():
        fix = did_you_mean(key, known) or f"known are {', '.join(known)}"
        what = f"has the unknown key {key!r}"
        require(key in known, what, where=where, fix=fix, error=DeviceError)
        inner = next((k for k in (types[key], *get_args(types[key])) if is_dataclass(k)), None)
        for n, entry in enumerate(value if isinstance(value, list) else [value]):
            if inner is not None and isinstance(entry, dict):
                place = f"{key}[{n}]" if isinstance(value, list) else key
                _check_keys(inner, entry, f"{where}: {place}")


def _camera(said: _CameraEntry, path: Path) -> CellCamera:
    """A camera, with the pose of its calibration's file.

    Raises:
        DeviceError: Its pose is given twice.
        RecordingError: That file cannot be read, or the pose is none.
    """
    where, T = f"{path}: camera {said.name}", said.T_world_camera
    once, fix = said.calibration is None or T is None, "leave one of them out"
    require(once, "has calibration and T_world_camera", where=where, fix=fix, error=DeviceError)
    if said.calibration is not None:
        pose = read_camera(path.parent / said.calibration).T_world_camera
    else:  # whose checks are those of calibrations
        T = None if T is None else np.array(T)
        pose = Camera(name=where, width=1, height=1, K=np.eye(3), T_world_camera=T).T_world_camera
    day = None if said.calibrated is None else said.calibrated.isoformat()
    return CellCamera(
        name=said.name, device=said.device, serial=said.serial, T_world_camera=pose,
        calibrated=day, stated_error=said.stated_error,
    )  # fmt: skip
