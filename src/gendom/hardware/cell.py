"""A cell: a robot, its cameras and what stands around them, as cell.toml describes them
(docs/hardware.md).
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from datetime import date
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.arrays import Array
from gendom.datasets import Fault
from gendom.errors import DeviceError, RobotError
from gendom.hardware.contracts import DepthCamera, Robot, find_depth_camera, find_robot
from gendom.reading import read_toml, record_of
from gendom.robot import (
    XARM7,
    Arm,
    Box,
    CollisionChecker,
    JointMotion,
    Post,
    Surroundings,
    TcpPath,
    arm_shape,
    find_arm,
    follow,
    joint_move,
    known_arms,
    tcp_pose,
)

FASTEST_TOOL = 0.8
"""In servo mode [m/s]."""

OLD = 90
"""Days after which a calibration is asked for again."""

FARTHEST = 20.0
"""That an obstacle or the table may be from the robot's base [m]; more was not given in metres."""

LARGEST_ERROR = 0.01
"""Of a camera's pose [m]; beyond it the cell is warned of."""

CAREFUL = 0.1
"""Share of the arm's speeds that an approach has, and any motion that no person confirmed."""

FIRST_POSE = (math.radians(1.0), 0.005)
"""Largest distance of the arm from a motion's first pose [rad], [m]."""

RATE, SLACK = 50.0, 1.01
"""At which the tool's way is looked at [1/s], and how much of a limit differences may be."""


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
    serial: str = ""
    T_world_camera: Array | None = None
    """[4, 4] camera to world [m]; None: not calibrated."""
    calibration: str | None = None
    """File of gendom calibrate that holds the pose, from the cell's file on."""
    calibrated: date | None = None
    """When."""
    stated_error: float = math.nan
    """Of the pose, as gendom calibrate states it [m]."""

    def placed(self, path: Path) -> CellCamera:
        """The camera with the pose of its calibration's file, of a cell's file.

        Raises:
            DeviceError: Its pose is given twice.
            RecordingError: That file cannot be read, or the pose is none.
        """
        from gendom.perception import Camera, read_camera

        where, T = f"{path}: camera {self.name}", self.T_world_camera
        once, fix = self.calibration is None or T is None, "leave one of them out"
        require(once, "has calibration and T_world_camera", where=where, fix=fix, error=DeviceError)
        if self.calibration is not None:
            camera = read_camera(path.parent / self.calibration)
        else:  # whose checks are those of calibrations
            camera = Camera(name=where, width=1, height=1, K=np.eye(3), T_world_camera=T)
        return replace(self, T_world_camera=camera.T_world_camera)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedMotion:
    """A motion of an arm among what stands around it, and how it gets to its start; a file's `plan`
    holds its fields.

    Raises:
        RobotError: The approach does not end where the motion starts.
    """

    arm: str
    """Its name."""
    motion: JointMotion
    approach: JointMotion
    """Slow, from the arm's home to the motion's first pose."""
    first: Array
    """[J] that pose [rad]."""
    surroundings: dict[str, Any]
    """What it was planned among."""
    opening: float
    """Distance of the fingers' inner faces where they hold the object [m]."""
    hangs: float = 0.0
    """How far the object hangs out of them [m]."""
    cell: str | None = None
    """The cell's file; None: planned for a table alone, for simulation only."""

    def __post_init__(self) -> None:
        start, ends = self.motion.q[0], (self.approach.q[-1], np.asarray(self.first))
        meets = all(end.shape == start.shape and np.abs(end - start).max() < 1e-6 for end in ends)
        require(meets, "its approach does not end where it starts", error=RobotError)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """A robot and the space in which it works, with the keys of cell.toml. The world is the robot's
    base frame, z up."""

    robot: str
    """A name that `gendom.hardware.find_robot` knows."""
    address: str
    """Of the robot's controller."""
    tool: Tool
    workspace: Array
    """[2, 3] lowest and highest corner of a box that the tool point never leaves [m]."""
    arm: str = ""
    """As `gendom.robot.find_arm` takes it; a file from the cell's file on. By default the robot's
    own, of others the xArm 7."""
    speed: SpeedLimits = field(default_factory=SpeedLimits)
    table_height: float | None = None
    """z of the table [m]; None: there is none."""
    scene_clearance: float = 0.02
    """Least distance of the arm from its surroundings [m]."""
    self_clearance: float = 0.01
    """The same from itself [m]."""
    camera: tuple[CellCamera, ...] = ()
    box: tuple[Box, ...] = ()
    """What to keep out of."""
    stand: tuple[Post, ...] = ()
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
        fix = "see docs/hardware.md for what belongs there"
        try:
            cell = record_of(cls, table, where=where, fix=fix, by_hand=True, error=DeviceError)
        except RobotError as error:  # of a box or a stand
            raise DeviceError(error.what, where=f"{where}: {error.where}", fix=error.fix) from None
        own = cell.robot if cell.robot in known_arms() else XARM7.name
        arm = str(path.parent / cell.arm) if Path(cell.arm).suffix else cell.arm or own
        cell = replace(cell, path=path, arm=arm, camera=tuple(c.placed(path) for c in cell.camera))
        cell._check_values()
        return cell

    def _check_values(self) -> None:
        """Refuse what no cell can have."""
        tool, speed, space, table = self.tool, self.speed, self.workspace, self.table_height
        widest, arms, seen = self.model.gripper.max_opening, known_arms(), self.camera
        around, origin = (*self.box, *self.stand), np.zeros(3)
        names = ["table", *(o.name for o in around), *(f"camera {c.name}" for c in seen)]
        box = space.shape == (2, 3) and bool(np.all(space[0] < space[1]))
        fits = 0.0 < tool.max_opening <= widest + 1e-6
        near = all(o.distance(origin, origin) < FARTHEST for o in around)
        plain = all(re.fullmatch(r"\w[\w.-]*", c.name) for c in seen)
        errors = np.array([c.stated_error for c in seen])
        stated = bool(np.all(np.isnan(errors) | ((errors > 0.0) & (errors < 1.0))))
        serials = [(c.device, c.serial) for c in seen if c.serial]
        one = len(set(serials)) == len(serials)
        checks = {
            "address": (self.address.strip() != "", "that of the robot's controller"),
            "arm": (not {self.robot, self.arm} <= arms.keys() or self.robot == self.arm,
                    f"{self.robot}, or the file of one that differs from it"),
            "tool.max_opening": (fits, f"metres up to {widest:g}"),
            "tool.latency": (0.0 <= tool.latency <= 5.0, "seconds"),
            "tool.mass": (0.0 <= tool.mass <= 50.0, "kilograms"),
            "speed.tool": (0.0 < speed.tool <= FASTEST_TOOL, f"m/s up to {FASTEST_TOOL}"),
            "speed.share": (0.0 < speed.share <= 1.0, "a share up to 1"),
            "scene_clearance": (0.0 <= self.scene_clearance <= 1.0, "metres, 0 or more"),
            "self_clearance": (0.0 <= self.self_clearance <= 1.0, "metres, 0 or more"),
            "table_height": (table is None or abs(table) < FARTHEST, "metres"),
            "workspace": (box, "its lowest corner, then the highest"),
            "box, stand": (near, "metres, in the frame of the robot's base"),
            "box, stand, camera": (len(set(names)) == len(names), "each a name of its own"),
            "camera.name": (plain, "letters, digits, '-', '_' and '.': it names a folder"),
            "camera.serial": (one, "each its own"),
            "camera.stated_error": (stated, "metres above 0, as gendom calibrate states it"),
        }  # fmt: skip
        for name, (holds, fix) in checks.items():
            where = f"{self.path}: {name}"
            require(holds, "is not valid", where=where, fix=f"give {fix}", error=DeviceError)
        find_robot(self.robot)
        for camera in seen:
            find_depth_camera(camera.device)
        if self.simulated:
            from gendom.reality import find_object

            find_object(self.address)

    @cached_property
    def surroundings(self) -> Surroundings:
        """Table, boxes, stands and the housings of calibrated cameras, with their clearances."""
        housings, seen = [], {c.name: c.T_world_camera for c in self.camera}
        if seen:
            from gendom.reality.arm import housing  # with all of MuJoCo's scene

            housings = [housing(name, T) for name, T in seen.items() if T is not None]
        return Surroundings(
            table_height=self.table_height,
            obstacles=(*self.box, *self.stand, *housings),
            clearance=self.scene_clearance,
            self_clearance=self.self_clearance,
        )

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
        return robot, [find_depth_camera(c.device)(c) for c in self.camera]

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
        if hit := CollisionChecker(arm, self.surroundings).at(arm.home):
            yield f"at the arm's home pose {hit}", "home", f"move the {hit.second}"
        home = tcp_pose(arm, arm.home)[:3, 3]
        if not np.all((home >= low) & (home <= high)):
            what = f"does not hold the tool point of the arm's home pose, {_point(home)} m"
            yield what, "workspace", "enlarge it, or check that it is in the base's frame"
        links = [*arm.T_links[1:], arm.T_flange_tcp]
        shoulder, reach = arm.T_links[0][:3, 3], sum(np.linalg.norm(T[:3, 3]) for T in links)
        far = np.linalg.norm(np.maximum(np.abs(low - shoulder), np.abs(high - shoulder)))
        if far > 1.5 * reach:
            what = f"goes {far:.3g} m from the shoulder, the arm {reach:.3g} at most"
            yield what, "workspace", "give metres, and no more than the arm needs"
        table = self.table_height
        if table is not None and low[2] < table - 1e-9:
            what = f"begins {1e3 * (table - low[2]):.0f} mm below the table"
            yield what, "workspace", "raise its lowest corner to the table"

    def _doubtful(self, today: date) -> Iterator[tuple[str, str, str]]:
        for camera in self.camera:
            where, fix = f"camera {camera.name}", "run gendom calibrate"
            if camera.T_world_camera is None:
                yield "is not calibrated", where, fix
                continue
            if camera.calibrated is None:
                yield "does not say when it was calibrated", where, "give calibrated = YYYY-MM-DD"
            elif (days := (today - camera.calibrated).days) > OLD:
                yield f"was calibrated {days} days ago", where, f"{fix} again"
            elif days < -1:
                yield f"is calibrated {-days} days from now", where, "correct the date"
            if not camera.stated_error <= LARGEST_ERROR:
                said = "nothing" if math.isnan(camera.stated_error) else f"{camera.stated_error} m"
                yield f"states {said} as its error", where, fix
        if not self.camera:
            yield "has no camera", "camera", "add one: a lift is seen by two"
        if self.table_height is None:
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
        arm, around = self.limited.holding(hangs, 0.5 * opening), self.surroundings
        motion = follow(arm, path, surroundings=around, opening=opening)
        self.check_tool(motion)
        return PlannedMotion(
            arm=self.model.name,
            motion=motion,
            approach=self.approach(self.model.home, motion.q[0]),
            first=motion.q[0],
            surroundings=asdict(around),
            opening=opening,
            hangs=hangs,
            cell=None if self.path is None else str(self.path),
        )

    def slow_move(self, q_from: Array, q_to: Array, **around: Any) -> JointMotion:
        """A move from joint to joint, at `CAREFUL` of the arm's limits and within the cell's.

        Args:
            q_from, q_to: [J] [rad].
            around: `surroundings` and `opening` of `joint_move`.

        Raises:
            RobotError: As `joint_move`.
        """
        share = min(CAREFUL, self.speed.share)
        tool = min(self.model.max_tcp_speed, self.speed.tool / share)
        return joint_move(
            replace(self.model, max_tcp_speed=tool), q_from, q_to, share=share, **around
        )

    def approach(self, q_from: Array, q_to: Array) -> JointMotion:
        """A slow move from where the arm is, with the fingers open: straight, or with a stop where
        some joints have moved and the others not yet.

        Raises:
            RobotError: It comes too near to something.
        """
        around: Any = {"surroundings": self.surroundings, "opening": self.tool.max_opening}
        joint, refused = np.arange(self.model.joints), None
        q_from = np.clip(q_from, self.model.q_min, self.model.q_max)  # as measured
        masks = [mask for k in joint[1:] for mask in (joint < k, joint >= k)]
        for via in (None, *(np.where(mask, q_to, q_from) for mask in masks)):
            try:
                if via is None:
                    return self.slow_move(q_from, q_to, **around)
                first = self.slow_move(q_from, via, **around)
                return first.then(self.slow_move(via, q_to, **around))
            except RobotError as error:
                refused = refused or error
        assert refused is not None
        raise RobotError(f"the approach: {refused.what}", where=refused.where, fix=refused.fix)

    # ---- what is checked before the arm moves ----------------------------------------------------

    def check(self, planned: PlannedMotion) -> None:
        """Check a planned motion against this cell, whatever it was planned for.

        Raises:
            RobotError: It is another arm's or was planned without a cell, a limit is passed, the
                tool leaves the workspace, or a clearance is missed.
        """
        fix = "make it again with gendom act --cell"
        what = f"was planned for {planned.arm}, the cell has {self.arm}"
        same = planned.arm == self.model.name
        require(same, what, where="action", fix=fix, error=RobotError)
        what, free = "was planned without a cell", planned.cell is not None or self.simulated
        require(free, what, where="action", fix=fix, error=RobotError)
        arm = self.limited.holding(planned.hangs, 0.5 * planned.opening)
        moves = (
            (arm, planned.motion, planned.opening),
            (self.limited, planned.approach, self.tool.max_opening),
        )
        for body, move, opening in moves:
            move.check_limits(self.limited)
            CollisionChecker(body, self.surroundings, opening=opening).check(move)
        self.check_tool(planned.motion)

    def check_tool(self, motion: JointMotion, rate: float = RATE) -> None:
        """Compare the tool's way, so many times a second, with the workspace and its speed.

        Raises:
            RobotError: It leaves it, or is too quick between the knots that `check_limits` sees.
        """
        time = motion.sampled(rate)
        x, most = motion.tcp_at(self.model, time)[:, :3, 3], self.limited.max_tcp_speed
        speed = np.linalg.norm(np.diff(x, axis=0), axis=1).max() / (time[1] - time[0])
        what = f"the tool moves at {speed:.3f} m/s, limit {most:g}"
        fix = f"take {speed / most:.3f} times as long"
        require(speed <= SLACK * most, what, where="motion", fix=fix, error=RobotError)
        out = np.maximum(self.workspace[0] - x, x - self.workspace[1]).max(axis=1)
        k = int(np.argmax(out))
        what = f"the tool leaves the workspace by {1e3 * out[k]:.0f} mm, at {_point(x[k])} m"
        fix, where = "choose another --origin, or enlarge the workspace", str(self.path or "cell")
        require(out[k] <= 1e-6, what, where=where, fix=fix, error=RobotError)

    def check_start(self, motion: JointMotion, q: Array) -> None:
        """Compare where the arm is [J] [rad] with where a motion starts.

        Raises:
            DeviceError: It is farther away than `FIRST_POSE`.
        """
        off = np.abs(motion.q[0] - q)
        j, ends = int(off.argmax()), tcp_pose(self.model, np.stack([q, motion.q[0]]))[:, :3, 3]
        gap = float(np.linalg.norm(ends[1] - ends[0]))
        what = f"the arm is {math.degrees(off[j]):.1f} degrees (joint {j + 1}) and "
        what += f"{1e3 * gap:.0f} mm off the motion's first pose"
        near = off[j] <= FIRST_POSE[0] and gap <= FIRST_POSE[1]
        require(near, what, where="motion", fix="approach it first", error=DeviceError)

    def least_clearances(self, q: Array, *, opening: float) -> list[tuple[float, str]]:
        """Least distances [m] at joint angles [N, J] of the arm from its surroundings and from
        itself, each with whose it is; the fingers, which reach for the object, are not compared
        with the table."""
        collisions = CollisionChecker(self.model, self.surroundings, opening=opening)
        shape = arm_shape(self.model, self.model.home, opening)
        fingers = {n for n, t in zip(shape.names, shape.touches_object, strict=True) if t}
        least = {True: (math.inf, ""), False: (math.inf, "")}
        for d, (a, b) in zip(collisions.distance(q).min(axis=0), collisions.pairs, strict=True):
            if not (b == "table" and a in fingers):
                other = b in collisions.around
                least[other] = min(least[other], (float(d), f"{a} and {b}"))
        return [least[True], least[False]]


BARE = Cell(
    robot="simulated",
    address="",
    arm=XARM7.name,
    tool=Tool(max_opening=XARM7.gripper.max_opening, latency=0.0),
    workspace=np.outer([-np.inf, np.inf], np.ones(3)),
    speed=SpeedLimits(tool=math.inf, share=1.0),
    table_height=0.0,
    scene_clearance=0.0,
    self_clearance=0.0,
)
"""An arm on its table and nothing else, for simulation only."""


def _point(x: Array) -> str:
    return f"({', '.join(f'{v:.3f}' for v in x)})"
