"""A cell: a robot, its cameras and what stands around them, as cell.toml describes them.

robot = "xarm7"                     # xarm7, fr3, simulated, or of an entry point
address = "192.168.1.203"           # of its controller; simulated: the object that is handled
table_height = 0.0                  # metres in the robot's base frame, as all that follows
workspace = [[0.2, -0.5, 0.0], [0.75, 0.5, 0.8]]

[tool]
max_opening = 0.084                 # metres
latency = 0.2                       # seconds from the command until the fingers move
mass = 0.82                         # kg

[speed]                             # may be left out, as the clearances: 0.02 and 0.01 m
tool = 0.25                         # m/s
share = 0.3                         # of the arm's own limits

[[camera]]
name = "left"
device = "realsense"
serial = "032622070000"
calibration = "left/camera.toml"    # of gendom calibrate; or T_world_camera = [[...], ...]
calibrated = 2026-11-25
stated_error = 0.003                # metres

[[box]]                             # keep out
name = "shelf"
position = [0.5, 0.7, 0.2]          # of its middle; quat_xyzw where it is turned
size = [0.4, 0.2, 0.4]

[[stand]]                           # a pole of a camera, or one that holds a rope
name = "pole"
start = [0.9, 0.6, 0.0]
end = [0.9, 0.6, 0.8]
radius = 0.02
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass, replace
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
from gendom.perception import read_camera
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
    surroundings: Surroundings
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
    """Table, keep-out boxes, camera stands."""
    workspace: tuple[NDArray[np.float64], NDArray[np.float64]]
    """Lowest and highest corner [3] of a box that the tool point never leaves [m]."""
    cameras: tuple[CellCamera, ...] = ()
    speed: SpeedLimits = field(default_factory=SpeedLimits)
    scene_clearance: float = 0.02
    """Least distance of the arm from its surroundings [m]."""
    self_clearance: float = 0.01
    """Least distance of the arm's parts from each other [m]."""
    path: Path | None = None
    """The file that it was read from."""

    @classmethod
    def read(cls, path: str | os.PathLike) -> Cell:
        """The cell of a file; see the top of this module.

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
        except RobotError as error:
            raise DeviceError(error.what, where=f"{where}: {error.where}", fix=error.fix) from None
        seen = [c for c in cameras if c.T_world_camera is not None]
        obstacles += [housing(c.name, c.T_world_camera) for c in seen]
        own = ("robot", "address", "arm", "tool", "speed", "scene_clearance", "self_clearance")
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
        where, (low, high) = str(self.path), self.workspace
        names = [o.name for o in self.surroundings.obstacles]
        positive = {
            "tool.max_opening": self.tool.max_opening,
            "speed.tool": self.speed.tool,
            "speed.share": self.speed.share,
        }
        not_below = {
            "tool.latency": self.tool.latency,
            "tool.mass": self.tool.mass,
            "scene_clearance": self.scene_clearance,
            "self_clearance": self.self_clearance,
        }
        checks = [(0.0 < v < math.inf, n, f"is {v:g}", "give a number above 0, in SI units")
                  for n, v in positive.items()]  # fmt: skip
        checks += [(0.0 <= v < math.inf, n, f"is {v:g}", "give 0 or more, in SI units")
                   for n, v in not_below.items()]  # fmt: skip
        fastest = f"give {FASTEST_TOOL} m/s or less"
        widest = self.model.gripper.max_opening
        open_fix = f"the gripper of {self.arm} opens to {widest:g} m"
        checks += [
            (self.speed.tool <= FASTEST_TOOL, "speed.tool", f"is {self.speed.tool:g}", fastest),
            (self.speed.share <= 1.0, "speed.share", f"is {self.speed.share:g}", "give 1 or less"),
            (self.tool.max_opening <= widest + 1e-6, "tool.max_opening",
             f"is {self.tool.max_opening:g} m", open_fix),
            (bool(np.all(low < high)), "workspace", "has no lowest and highest corner",
             "give the lowest corner and the highest, in metres"),
            (len(set(names)) == len(names), "box, stand, camera", "share a name", "rename one"),
        ]  # fmt: skip
        for holds, name, what, fix in checks:
            require(holds, what, where=f"{where}: {name}", fix=fix, error=DeviceError)
        find_robot(self.robot)
        for camera in self.cameras:
            find_depth_camera(camera.device)

    @cached_property
    def model(self) -> Arm:
        """The arm, with its own limits."""
        return find_arm(self.arm)

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
        shoulder = np.array([0.0, 0.0, arm.d[0]])
        reach = float(np.hypot(arm.a, arm.d)[1:].sum() + np.linalg.norm(arm.T_flange_tcp[:3, 3]))
        far = np.maximum(np.abs(low - shoulder), np.abs(high - shoulder))
        if np.linalg.norm(far) > 1.5 * reach:
            what = (
                f"goes {np.linalg.norm(far):.3g} m from the shoulder, the arm at most {reach:.3g}"
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
            days = None
            if camera.calibrated is not None:
                days = (today - date.fromisoformat(camera.calibrated)).days
            if days is None:
                yield "does not say when it was calibrated", where, "give calibrated = YYYY-MM-DD"
            elif days > OLD:
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
            surroundings=around,
            opening=opening,
            hangs=hangs,
            cell=None if self.path is None else str(self.path),
        )
        self._check_workspace(planned)
        return planned

    def approach(self, q_from: NDArray[np.float64], q_to: NDArray[np.float64]) -> JointMotion:
        """A slow move from joint to joint, at `CAREFUL` of the arm's limits, with the fingers open.

        Raises:
            RobotError: It comes too near to something.
        """
        return joint_move(
            self.model, q_from, q_to, share=min(CAREFUL, self.speed.share),
            surroundings=self.surroundings, opening=self.tool.max_opening,
        )  # fmt: skip

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


def table_alone(path: TcpPath, *, opening: float, hangs: float = 0.0) -> PlannedMotion:
    """How the xArm 7 follows a path beside nothing but its table, for simulation only.

    Args:
        path: In the base's frame.
        opening: Distance of the fingers' inner faces, the object's thickness [m].
        hangs: How far the object hangs out of them [m].

    Raises:
        RobotError: It cannot within its limits, or would touch itself or the table.
    """
    around, arm = Surroundings(table_height=0.0), held(XARM7, opening, hangs)
    motion = follow(arm, path, slow_down=True, surroundings=around, opening=opening)
    approach = joint_move(XARM7, XARM7.home, motion.q[0], share=0.15, surroundings=around)
    return PlannedMotion(
        arm=XARM7, motion=motion, approach=approach, surroundings=around, opening=opening,
        hangs=hangs,
    )  # fmt: skip


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
        DeviceError: Its pose is given twice or is none.
        RecordingError: That file cannot be read.
    """
    where, T = f"{path}: camera {said.name}", None
    twice = said.calibration is not None and said.T_world_camera is not None
    fix = "leave one of them out"
    require(
        not twice, "has calibration and T_world_camera", where=where, fix=fix, error=DeviceError
    )
    if said.calibration is not None:
        T = read_camera(path.parent / said.calibration, said.name).T_world_camera
    elif said.T_world_camera is not None:
        T = np.array(said.T_world_camera)
        turned = np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3)
        good = turned and np.linalg.det(T[:3, :3]) > 0.0 and np.allclose(T[3], [0, 0, 0, 1])
        what, fix = (
            "T_world_camera is no rigid transform",
            "give [[R, t], [0, 0, 0, 1]], t in metres",
        )
        require(good, what, where=where, fix=fix, error=DeviceError)
    day = None if said.calibrated is None else said.calibrated.isoformat()
    return CellCamera(
        name=said.name, device=said.device, serial=said.serial, T_world_camera=T,
        calibrated=day, stated_error=said.stated_error,
    )  # fmt: skip
