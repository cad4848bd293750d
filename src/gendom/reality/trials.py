"""What the arm does in the second reality: the predefined lift and the three tasks.

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
from PIL import Image, ImageDraw

from gendom.errors import RobotError
from gendom.materials import AIR_DENSITY
from gendom.perception.camera import Camera
from gendom.reality.arm import RobotArm, surroundings
from gendom.reality.objects import RealCloth, RealObject, RealRope
from gendom.reality.scene import Layout, default_cameras, rest_height
from gendom.reality.world import FINGER_WIDTH, Reality
from gendom.robot import XARM7, Deviation, TcpPath, follow, motions, pointing_down
from gendom.tasks import RopeReaching

ROPE_LIFT_SPEED, CLOTH_LIFT_SPEED = 0.05, 0.1
"""Speed of the predefined lift [m/s]: of a rope so slow that inertia plays no part."""

RISE = 0.75
"""Height of a rope's lift, in its lengths; of a cloth's, in its sides."""

TIP_HEIGHT = 0.002
"""The lowest that the tool point goes above the table [m]: the pads reach 1.1 mm below it."""

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

CAST_PLACE = (0.45, 0.15)
"""Where a rope is cast: how far in front of the base, and how high its tip hangs [m]."""

CAST_SPEED, CAST_AFTER = 0.8, 1.5
"""Speed of the cast [m/s], below what the arm's tool may have; and how long it is watched [s]."""

SPREAD_STEP = 0.04
"""Time of each of the 16 steps of spreading [s]: 0.25 m/s in the mean."""

FORWARD = np.sqrt([0.0, 0.5, 0.0, 0.5])
"""quat_xyzw of a gripper that points forward, its fingers opening along the world's y."""


AREA_PIXEL = 5e-4
"""Resolution at which covered area is measured [m]."""


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
        air_density: Of the still air [kg/m^3]; 0: none.
        timestep: MuJoCo's [s]; None for the default of the object's kind.

    Raises:
        RobotError: The arm cannot follow the path within its limits, or would touch itself, the
            table or a camera.
        ParameterError: `air_density` is negative or not finite.
        DeviceError: MuJoCo is not installed.
    """

    def __init__(
        self,
        trial: Trial,
        *,
        robot: bool = True,
        cameras: Sequence[Camera] = (),
        air_density: float = AIR_DENSITY,
        timestep: float | None = None,
    ):
        self.trial = trial
        thick = trial.item.diameter if isinstance(trial.item, RealRope) else trial.item.thickness
        self.motion = None
        if robot:
            self.motion = follow(
                XARM7,
                trial.path,
                slow_down=True,
                surroundings=surroundings(cameras),
                opening=thick,
            )
        arm = None if self.motion is None else RobotArm(XARM7, self.motion, opening=thick)
        self.world = Reality(
            trial.item,
            trial.layout,
            robot=arm,
            cameras=cameras,
            timestep=timestep,
            air_density=air_density,
        )
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
        last = self.events[-1]
        end = self.trial.end + last.time - self.trial.path.events[-1].time
        if self.motion is None or not last.closed:
            return end
        # The hand still moves after it has closed, and an arm that is slowed down for longer.
        return max(end, self.motion.end - 0.5 * self.motion.blend)

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


def lift(item: RealObject, *, rise: float | None = None, speed: float | None = None) -> Trial:
    """The predefined lift: a rope by its end, a cloth by its corner, straight up.

    The object lies on the table in front of the arm, a rope pointing away, a cloth with its
    diagonal pointing away. Fingers hold what is within half their breadth of the tool point.

    Args:
        item: The object.
        rise: How high [m]; by default `RISE` lengths or sides.
        speed: [m/s]; by default `ROPE_LIFT_SPEED` or `CLOTH_LIFT_SPEED`.

    Raises:
        RobotError: Rise or speed is no number above 0.
    """
    height = rest_height(item)
    origin = np.array([START, 0.0, height])
    rope = isinstance(item, RealRope)
    if rope:
        layout, size = Layout(origin=origin), item.length
    else:
        half = np.sqrt(0.5)
        layout = Layout(origin=origin, along=(half, -half, 0.0), across=(half, half, 0.0))
        size = item.side
    path = motions.lift(
        origin + np.array([FINGER_WIDTH / 2.0, 0.0, max(TIP_HEIGHT - height, 0.0)]),
        height=RISE * size if rise is None else rise,
        speed=(ROPE_LIFT_SPEED if rope else CLOTH_LIFT_SPEED) if speed is None else speed,
        quat_xyzw=pointing_down(),
        wait=SETTLE,
        after=SETTLE,
    ).shifted(SETTLE)
    return Trial(
        item=item,
        layout=layout,
        path=path,
        grasp="end" if rope else "corner",
        # A corner's vertices are farther from its middle than an end's.
        reach=FINGER_WIDTH / 2.0 if rope else FINGER_WIDTH,
        end=path.end,
        quasi_static=rope,
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
    top = in_world(task.top)
    # The held regions of both worlds are the same, to the nearest vertex.
    held = gripper.radius
    layout = Layout(origin=top, along=(0.0, 0.0, -1.0), across=(0.0, 1.0, 0.0), clamped=held)
    path = motions.rope_reaching(
        gripper.time,
        in_world(gripper.position),
        release_time=task.release_time,
        quat_xyzw=FORWARD,
        wait=SETTLE,
        after=task.end_time - task.release_time,
    ).shifted(2.0 * SETTLE)
    return Trial(item=rope, layout=layout, path=path, grasp="end", reach=held, end=path.end)


def casting(rope: RealRope, action: float) -> Trial:
    """Rope casting: the rope hangs from the hand, which makes one quick horizontal move.

    Args:
        rope: The rope.
        action: How far the hand moves along the world's y [m], negative: the other way. It
            moves as fast as the arm can, at most `CAST_SPEED`.

    Raises:
        RobotError: The action is 0 or not finite.
    """
    if not math.isfinite(action) or action == 0.0:
        raise RobotError(f"action is {action}", where="cast", fix="give metres, not 0")
    top = np.array([CAST_PLACE[0], -0.5 * action, CAST_PLACE[1] + rope.length])
    # The fingers point down and hold the rope's first centimetres between them.
    grip = top - np.array([0.0, 0.0, FINGER_WIDTH / 2.0])
    layout = Layout(origin=top, along=(0.0, 0.0, -1.0), across=(0.0, 1.0, 0.0))
    path = motions.rope_casting(
        grip,
        action,
        duration=abs(action) / CAST_SPEED,
        heading=np.pi / 2.0,
        quat_xyzw=pointing_down(),
        wait=SETTLE,
        after=CAST_AFTER,
    ).shifted(0.01)
    return Trial(item=rope, layout=layout, path=path, grasp="end", end=path.end)


def spreading(cloth: RealCloth, A: float) -> Trial:
    """Cloth spreading: the cloth is raised by its centre and brought down with an acceleration.

    Args:
        cloth: The cloth.
        A: The paper's acceleration [-], see `gendom.robot.motions.spreading_steps`.

    Raises:
        RobotError: A is negative or not finite.
    """
    half, height = cloth.side / 2.0, rest_height(cloth)
    layout = Layout(origin=(START, -half, height))
    centre = (START + half, 0.0, max(height, TIP_HEIGHT))
    path = motions.cloth_spreading(
        centre, A, step_time=SPREAD_STEP, quat_xyzw=pointing_down(), wait=SETTLE
    ).shifted(SETTLE)
    return Trial(item=cloth, layout=layout, path=path, grasp="center", end=path.end)


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
    released: int
    """The first of these times at which the tip is free."""

    @property
    def in_task(self) -> npt.NDArray[np.float64]:
        """[T, V, 3] the rope in the task's frame [m]."""
        return (self.vertices - T_WORLD_TASK[:3, 3]) @ T_WORLD_TASK[:3, :3]


def carry_out_reaching(performance: Performance, *, frame_rate: float = 100.0) -> Reached:
    """Carry out a rope reaching trial and see how far the tip gets.

    Raises:
        SimulationError: The world diverged.
    """
    times, vertices = _watched(performance, performance.closes, frame_rate)
    released = int(np.searchsorted(times, performance.opens))
    tip = (vertices[released:, -1] - T_WORLD_TASK[:3, 3]) @ T_WORLD_TASK[:3, :3]
    return Reached(
        reached=float(tip[:, 0].max()),
        sideways=float(np.abs(tip[:, 1]).max()),
        times=times,
        vertices=vertices,
        released=released,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Cast:
    """What came of a cast."""

    highest: npt.NDArray[np.float64]
    """[2] where the tip is when it is highest: along the cast from where it hung, and above the
    table [m]."""
    times: npt.NDArray[np.float64]
    """[T] from the closing of the hand on [s]."""
    vertices: npt.NDArray[np.float64]
    """[T, V, 3] the rope, in the world [m]."""


def carry_out_casting(performance: Performance, *, frame_rate: float = 100.0) -> Cast:
    """Carry out a casting trial and see where the tip is highest.

    Raises:
        SimulationError: The world diverged.
    """
    times, vertices = _watched(performance, performance.closes, frame_rate)
    tip = vertices[:, -1]
    top = tip[np.argmax(tip[:, 2])]
    along = np.sign(performance.trial.path.position[-1, 1] - performance.trial.path.position[0, 1])
    return Cast(
        highest=np.array([along * (top[1] - tip[0, 1]), top[2]]), times=times, vertices=vertices
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Spread:
    """What came of a spreading."""

    ratio: float
    """Area of the table that the cloth covers in the end, over its own: the extended ratio."""
    times: npt.NDArray[np.float64]
    """[T] from the closing of the hand on [s]."""
    vertices: npt.NDArray[np.float64]
    """[T, V, 3] the cloth, in the world [m]."""


def carry_out_spreading(performance: Performance, *, frame_rate: float = 30.0) -> Spread:
    """Carry out a spreading trial and measure how far the cloth is spread in the end.

    Raises:
        SimulationError: The world diverged.
    """
    item = performance.trial.item
    assert isinstance(item, RealCloth)
    times, vertices = _watched(performance, performance.closes, frame_rate)
    return Spread(
        ratio=covered_area(item, vertices[-1]) / item.side**2, times=times, vertices=vertices
    )


def covered_area(cloth: RealCloth, vertices: npt.NDArray[np.float64]) -> float:
    """Area of the table under a cloth [m^2], seen from straight above.

    Args:
        cloth: The cloth.
        vertices: [V, 3] [m].
    """
    low = vertices[:, :2].min(axis=0)
    pixels = (vertices[:, :2] - low) / AREA_PIXEL
    width, height = (int(x) + 2 for x in pixels.max(axis=0))
    picture = Image.new("1", (width, height))
    draw = ImageDraw.Draw(picture)
    for triangle in pixels[cloth.sheet[1]]:
        draw.polygon([tuple(point) for point in triangle], fill=1)
    return float(np.asarray(picture).sum()) * AREA_PIXEL**2


def _watched(
    performance: Performance, begin: float, frame_rate: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Times [T] [s] from a moment to the end, and the vertices [T, V, 3] [m] then."""
    times = np.arange(begin, performance.end + 0.5 / frame_rate, 1.0 / frame_rate)
    return times, performance.watch(times)


def in_world(points: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Points [..., 3] [m] of rope reaching's frame in the world's."""
    return np.asarray(points, dtype=float) @ T_WORLD_TASK[:3, :3].T + T_WORLD_TASK[:3, 3]
