"""What the arm does in the second reality: the predefined lift, and rope reaching.

A `Trial` is everything that is fixed beforehand: where the object is, where the tool goes, when
the hand closes and opens. `Performance` carries it out, on the arm or, for tests, with a free
hand that follows the same path exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gendom.errors import ParameterError
from gendom.perception.camera import Camera
from gendom.reality.arm import RobotArm
from gendom.reality.objects import RealObject, RealRope
from gendom.reality.scene import Layout, default_cameras, rest_height
from gendom.reality.world import FINGER_WIDTH, Reality
from gendom.robot import XARM7, Deviation, GripperEvent, TcpPath, follow, pointing_down
from gendom.tasks import RopeReaching

LIFT_SPEED = 0.05
"""Speed of the predefined lift [m/s]: slow enough that inertia plays no part."""

RISE = 0.75
"""Height of a rope's lift, in its lengths; of a cloth's, in its sides."""

START = 0.32
"""How far in front of the base the nearest point of a lying object is [m]."""

SETTLE = 0.5
"""Time in which the object comes to rest before the hand closes, and the hand's pauses [s]."""

TASK_ORIGIN = (0.48, 0.30, 0.12)
"""Where rope reaching's frame has its origin [m]; its x runs along the world's -y, so that the
rope swings across, in front of the arm, and its z is 0.12 m above the table."""

T_WORLD_TASK = np.array(
    [
        [0.0, 1.0, 0.0, TASK_ORIGIN[0]],
        [-1.0, 0.0, 0.0, TASK_ORIGIN[1]],
        [0.0, 0.0, 1.0, TASK_ORIGIN[2]],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
"""The task's frame to the world's [m]."""

FORWARD = np.sqrt([0.0, 0.5, 0.0, 0.5])
"""quat_xyzw of a gripper that points forward, its fingers opening along the world's y."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """One motion with one object."""

    item: RealObject
    layout: Layout
    """Where it is at time 0."""
    path: TcpPath
    """Where the tool goes, and when the hand closes and opens."""
    grasp: str
    """How a recording calls the hold: end, corner or center."""
    reach: float = FINGER_WIDTH / 2.0
    """How far from the tool point the hand holds the object [m]."""
    end: float
    """When everything is over [s]."""
    quasi_static: bool = False
    """Whether inertia plays no part."""


class Performance:
    """A trial being carried out.

    Args:
        trial: What is done.
        robot: True: the xArm 7 does it; False: a free hand.
        cameras: Fixed cameras.

    Raises:
        RobotError: The arm cannot follow the path within its limits.
        DeviceError: MuJoCo is not installed.
    """

    def __init__(self, trial: Trial, *, robot: bool = True, cameras: Sequence[Camera] = ()):
        self.trial = trial
        self.motion = follow(XARM7, trial.path, slow_down=True) if robot else None
        arm = None if self.motion is None else RobotArm(XARM7, self.motion)
        self.world = Reality(trial.item, trial.layout, robot=arm, cameras=cameras)
        if arm is None:
            self.world.follow(trial.path.position_at)
        self.events = trial.path.events if self.motion is None else self.motion.events
        self._todo = list(self.events)

    @property
    def closes(self) -> float:
        """When the hand closes [s]."""
        return next(e.time for e in self.events if e.closed)

    @property
    def opens(self) -> float:
        """When it opens [s]; infinite: never."""
        return next((e.time for e in self.events if not e.closed), math.inf)

    @property
    def end(self) -> float:
        """When everything is over [s]: later than in the trial where the arm takes longer."""
        return self.trial.end + self.events[-1].time - self.trial.path.events[-1].time

    @property
    def slowed_by(self) -> float:
        """How much longer the arm takes than the trial asks for."""
        return 1.0 if self.motion is None else self.motion.slowed_by

    @property
    def deviation(self) -> Deviation | None:
        """How far the arm's path is from the ideal one; None for a free hand."""
        return None if self.motion is None else self.motion.deviation

    def step_to(self, time: float) -> None:
        """Go on until a time [s], closing and opening the hand on the way.

        Raises:
            SimulationError: The hand closes on nothing, or the world diverged.
        """
        while self._todo and self._todo[0].time <= time + 1e-9:
            event = self._todo.pop(0)
            self.world.step_to(event.time)
            if event.closed:
                self.world.attach(self.trial.reach)
            else:
                self.world.release()
        self.world.step_to(time)

    def watch(
        self,
        times: Sequence[float] | npt.NDArray[np.float64],
        on_frame: Callable[[int], None] = lambda _: None,
    ) -> npt.NDArray[np.float64]:
        """[T, V, 3] the object's vertices [m] at increasing times [T] [s]."""
        seen = []
        for k, time in enumerate(times):
            self.step_to(float(time))
            seen.append(self.world.vertices())
            on_frame(k + 1)
        return np.array(seen)


def lift(item: RealObject, *, rise: float | None = None, speed: float = LIFT_SPEED) -> Trial:
    """The predefined lift: a rope by its end, a cloth by its corner, straight up.

    The object lies on the table in front of the arm, a rope pointing away, a cloth with its
    diagonal pointing away. Fingers hold what is within half their breadth of the tool point.

    Args:
        item: The object.
        rise: How high [m]; by default `RISE` lengths or sides.
        speed: [m/s].
    """
    height = rest_height(item)
    origin = np.array([START, 0.0, height])
    if isinstance(item, RealRope):
        size, grasp, reach = item.length, "end", FINGER_WIDTH / 2.0
        layout = Layout(origin=origin)
        inward = FINGER_WIDTH / 2.0
    else:
        size, grasp, reach = item.side, "corner", FINGER_WIDTH
        half = np.sqrt(0.5)
        layout = Layout(origin=origin, along=(half, -half, 0.0), across=(half, half, 0.0))
        inward = FINGER_WIDTH / 2.0
    rise = RISE * size if rise is None else rise
    if not (np.isfinite(rise) and rise > 0.0 and np.isfinite(speed) and speed > 0.0):
        raise ParameterError(f"a lift of {rise} m at {speed} m/s", fix="give numbers above 0")
    grip = origin + np.array([inward, 0.0, 0.0])
    top = grip + np.array([0.0, 0.0, rise])
    closes, begins = SETTLE, 2.0 * SETTLE
    ends = begins + rise / speed
    path = TcpPath(
        time=np.array([0.0, begins, ends, ends + SETTLE]),
        position=np.array([grip, grip, top, top]),
        quat_xyzw=pointing_down(),
        events=(GripperEvent(time=closes, closed=True),),
    )
    return Trial(
        item=item,
        layout=layout,
        path=path,
        grasp=grasp,
        reach=reach,
        end=ends + SETTLE,
        quasi_static=isinstance(item, RealRope),
    )


def lift_cameras(item: RealObject, **settings: Any) -> list[Camera]:
    """Two cameras on opposite sides of the predefined lift; settings as `default_cameras`."""
    size = item.length if isinstance(item, RealRope) else np.sqrt(2.0) * item.side
    return default_cameras((START + size / 2.0, 0.0, RISE * size / 2.0), **settings)


def reaching_task(rope: RealRope) -> RopeReaching:
    """Rope reaching for a rope of the second reality, in the task's own frame."""
    return RopeReaching().scaled_to(rope.length, rope.diameter)


def reaching(rope: RealRope, action: npt.ArrayLike) -> Trial:
    """Rope reaching: the top hangs from a stand, the arm carries the tip and lets go.

    Args:
        rope: The rope.
        action: [2] release point (x, z) in the task's frame [m].

    Raises:
        ParameterError: The task does not allow it.
    """
    task = reaching_task(rope)
    _, gripper = task.grippers(action)
    top, bottom = in_world(task.top), in_world(task.bottom)
    # The held regions of both worlds are the same, to the nearest vertex.
    held = gripper.radius
    layout = Layout(origin=top, along=(0.0, 0.0, -1.0), across=(0.0, 1.0, 0.0), clamped=held)
    knots = in_world(np.asarray(gripper.position))
    begins = 2.0 * SETTLE
    release = begins + task.release_time
    path = TcpPath(
        time=np.array([0.0, begins, begins + task.move_time, release]),
        position=np.array([bottom, bottom, knots[1], knots[1]]),
        quat_xyzw=FORWARD,
        events=(GripperEvent(time=SETTLE, closed=True), GripperEvent(time=release, closed=False)),
        max_blend=release - begins - task.move_time,
    )
    return Trial(
        item=rope,
        layout=layout,
        path=path,
        grasp="end",
        reach=held,
        end=begins + task.end_time,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Reached:
    """What came of a release."""

    reached: float
    """Farthest x of the tip in the task's frame, from the release to the end [m]."""
    sideways: float
    """Farthest |y| there [m]."""
    times: npt.NDArray[np.float64]
    """[T] from the closing of the hand on [s]."""
    vertices: npt.NDArray[np.float64]
    """[T, V, 3] the rope, in the world [m]."""


def carry_out_reaching(performance: Performance, *, frame_rate: float = 100.0) -> Reached:
    """Carry out a rope reaching trial and see how far the tip gets.

    Raises:
        SimulationError: The world diverged.
    """
    times = np.arange(performance.closes, performance.end + 0.5 / frame_rate, 1.0 / frame_rate)
    vertices = performance.watch(times)
    tip = (vertices[:, -1] - T_WORLD_TASK[:3, 3]) @ T_WORLD_TASK[:3, :3]
    free = tip[times >= performance.opens]
    return Reached(
        reached=float(free[:, 0].max()),
        sideways=float(np.abs(free[:, 1]).max()),
        times=times,
        vertices=vertices,
    )


def in_world(points: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Points [..., 3] [m] of rope reaching's frame in the world's."""
    return np.asarray(points, dtype=float) @ T_WORLD_TASK[:3, :3].T + T_WORLD_TASK[:3, 3]
