"""What the arm does in the MuJoCo test scene: the predefined lift, and any task.

A `Trial` is the plan: the object's place, the tool's path, when the hand closes and opens.
`TrialRun` carries it out, on the arm or, for tests, with a free hand that follows the same path
exactly. `RealWorld` does so for tasks.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any

import numpy as np
import numpy.typing as npt

from gendom.arguments import require
from gendom.arrays import Array, placed
from gendom.errors import DeviceError, RobotError, SimulationError
from gendom.materials import AIR_DENSITY, Item, size_of, thickness_of
from gendom.perception.camera import Camera
from gendom.reality.arm import RobotArm, surroundings
from gendom.reality.model import Layout, default_cameras
from gendom.reality.objects import RealCloth, RealObject, RealRope, as_real
from gendom.reality.world import FINGER_WIDTH, Reality
from gendom.robot import XARM7, JointMotion, LiftMotion, TcpPath, follow, motions, predefined_lift
from gendom.tasks import Observed, Task
from gendom.tasks.task import Outcome
from gendom.tasks.world import check_actions

TIP_HEIGHT = 0.002
"""The lowest that the tool point goes above the table [m]: the pads reach 1.1 mm below it."""

START = 0.32
"""How far in front of the base the nearest point of a lying object is [m]."""

SETTLE = 0.5
"""Time in which the object comes to rest before the hand closes, and the hand's pauses [s]."""

FRAME_RATE = 100.0
"""At which tasks look at objects [1/s]."""

START_DELAY = 0.01
"""When the hand closes in a task [s]: what hangs would fall until then."""


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
    inset: float = FINGER_WIDTH / 2.0
    """How far from the rope's end, or inside the cloth's corner, that point is [m]."""
    end: float
    """Duration [s]."""
    quasi_static: bool = False
    """Whether inertia plays no part."""
    timestep: float | None = None
    """Time step of MuJoCo [s]; None: the default of the object's kind."""
    adaptive: bool = False
    """Whether steps of a cloth that moves fast are shorter, see `Reality`."""
    quick: bool = False
    """Whether the object moves so fast that cameras must be synchronised."""


class TrialRun:
    """A trial in progress.

    Args:
        trial: What is done.
        robot: True: the xArm 7 does it; False: a free hand.
        cameras: Fixed cameras.

    Raises:
        RobotError: The arm cannot follow the path within its limits, or would touch itself, the
            table or a camera.
        DeviceError: MuJoCo is not installed.
    """

    def __init__(self, trial: Trial, *, robot: bool = True, cameras: Sequence[Camera] = ()):
        self.trial = trial
        self.motion, arm = None, None
        if robot:
            self.motion = arm_motion(trial, cameras)
            arm = RobotArm(XARM7, self.motion, opening=thickness_of(trial.item))
        self.world = Reality(
            trial.item,
            trial.layout,
            robot=arm,
            cameras=cameras,
            timestep=trial.timestep,
            adaptive=trial.adaptive,
        )
        if arm is None:
            blend = trial.path.blend or 0.0
            self.world.follow(lambda time: trial.path.position_at(time, blend))
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
        return end_of(self.trial, self.motion)

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


def arm_motion(trial: Trial, cameras: Sequence[Camera] = ()) -> JointMotion:
    """How the xArm 7 carries out a trial beside fixed cameras.

    Raises:
        RobotError: It cannot within its limits, or would touch itself, the table or a camera.
    """
    return follow(
        XARM7, trial.path, surroundings=surroundings(cameras), opening=thickness_of(trial.item)
    )


def end_of(trial: Trial, motion: JointMotion | None) -> float:
    """When everything is over [s]: later than in the trial where the arm takes longer.

    Args:
        trial: What is done.
        motion: How the arm does it; None: a free hand.
    """
    if motion is None:
        return trial.end
    last = motion.events[-1]
    end = trial.end + last.time - trial.path.events[-1].time
    # The hand still moves after it has closed, and an arm that is slowed down for longer.
    return max(end, motion.end - 0.5 * motion.blend) if last.closed else end


def lift(item: RealObject, motion: LiftMotion | None = None) -> Trial:
    """The lift of an object by a motion for its kind (default: the predefined one): a rope by its
    end, a cloth by its corner, straight up.

    The object lies on the table in front of the arm, a rope pointing away, a cloth with its
    diagonal pointing away. Fingers hold what is within half their breadth of the tool point. A
    swing goes away from the robot.

    Raises:
        RobotError: The motion is for the other kind.
    """
    motion = motion or predefined_lift(item.kind)
    path = lift_path(item, motion).shifted(SETTLE)
    rope, origin = isinstance(item, RealRope), np.array([START, 0.0, item.radius])
    layout = Layout(origin=origin)
    if not rope:
        half = np.sqrt(0.5)
        layout = Layout(origin=origin, along=(half, -half, 0.0), across=(half, half, 0.0))
    return Trial(
        item=item,
        layout=layout,
        path=path,
        grasp="end" if rope else "corner",
        # A corner's vertices are farther from its middle than an end's.
        reach=_rope_reach(item) if isinstance(item, RealRope) else FINGER_WIDTH,
        end=path.end,
        quasi_static=motion.quasi_static,
        quick=motion.end != "hold",
    )


def lift_path(
    item: RealObject, motion: LiftMotion, at: npt.ArrayLike | None = None, table: float = 0.0
) -> TcpPath:
    """Where the tool goes in a lift from a place [3]; None: ahead of the arm on a table of such a
    height [m].

    Raises:
        RobotError: The motion is for the other kind.
    """
    what = f"is for a {motion.kind}, and {item.name} is a {item.kind}"
    fix = f"plan one with gendom plan-lift {item.kind}"
    require(motion.kind == item.kind, what, where="motion", fix=fix, error=RobotError)
    ahead = START + FINGER_WIDTH / 2.0, 0.0, table + max(TIP_HEIGHT, item.radius)
    return motions.lift(
        ahead if at is None else at,
        height=motion.rise * size_of(item),
        speed=motion.speed,
        wait=SETTLE,
        after=SETTLE if motion.end == "hold" else None,
        end=motion.end,
    )


def _rope_reach(item: RealRope) -> float:
    """How far beyond the tool point the fingers hold a rope's end [m]: about half their breadth,
    and just as far as vertices can have it (see `Reality.attach`)."""
    held = max(round(FINGER_WIDTH / item.spacing + 0.5), 1)
    return (held - 0.5) * item.spacing - FINGER_WIDTH / 2.0


def lift_cameras(item: RealObject) -> list[Camera]:
    """Two cameras on opposite sides of the predefined lift."""
    size = size_of(item) * (1.0 if isinstance(item, RealRope) else np.sqrt(2.0))
    return default_cameras((START + size / 2.0, 0.0, motions.RISE * size / 2.0))


def task_trial(
    task: Task, item: RealObject, action: npt.ArrayLike, lying: Observed | None = None
) -> Trial:
    """A task with an object, in front of the arm.

    Args:
        task: What is done.
        item: The object.
        action: [A].
        lying: As it was seen in the try before.

    Raises:
        ParameterError: The task does not allow it.
    """
    scene, T = task.scene(item), task.T_world_task(item)
    path = task.tool_path(item, task.check_action(item, action))
    if lying is not None:
        path = task.next_path(item, lying.points[-1], lying.hand[-1])
    closes = next(e.time for e in path.events if e.closed)
    cloth = task.kind == "cloth"
    origin = np.array(scene.origin, dtype=float)
    if scene.table is not None:
        # MuJoCo's contact radius may be larger than half the thickness
        origin[2] = max(origin[2], scene.table + item.radius)
    R = T[:3, :3]
    return Trial(
        item=item,
        layout=Layout(
            origin=R @ origin + T[:3, 3],
            along=R @ np.asarray(scene.along, dtype=float),
            across=R @ np.asarray(scene.across, dtype=float),
            clamped=scene.stand,
        ),
        path=path.moved(T).shifted(START_DELAY - closes),
        grasp="center" if cloth else "end",
        reach=scene.grip,
        end=START_DELAY - closes + float(task.times(item)[-1]),
        adaptive=cloth,
    )


@dataclass(frozen=True, kw_only=True)
class RealWorld:
    """The MuJoCo test scene as a world of tasks, see `gendom.tasks.world.World`."""

    robot: bool = True
    """Whether the arm acts, or a free hand."""
    timestep: float | None = None
    """MuJoCo's [s], throughout; None: the trial's."""
    jobs: int = 1
    """Processes that carry out trials side by side."""

    def carry_out(
        self,
        task: Task,
        items: Sequence[Item],
        actions: npt.ArrayLike,
        *,
        keep: bool = False,
        on_frame: Callable[[int], None] | None = None,
    ) -> list[Outcome]:
        """As `World.carry_out`, one after another; motions that the arm cannot do are faults.

        Raises:
            ParameterError: An action is out of its limits.
            DeviceError: MuJoCo is not installed.
        """
        wanted = check_actions(task, items, actions)
        one = functools.partial(_carried_out, self, task, keep)
        many = self.jobs > 1 and len(items) > 1
        outcomes = []
        for outcome in (_workers(self.jobs).map if many else map)(one, items, wanted):
            outcomes.append(outcome)
            if on_frame is not None:
                on_frame(len(outcomes))
        return outcomes

    def on(self, device: str) -> RealWorld:
        """As `World.on`.

        Raises:
            DeviceError: It is not the CPU.
        """
        what = f"the MuJoCo test scene runs on the CPU, not on {device}"
        require(device == "cpu", what, error=DeviceError)
        return self

    def settings(self) -> dict[str, Any]:
        """As `World.settings`."""
        own = {"robot": self.robot, "air_density": AIR_DENSITY, "timestep": self.timestep}
        return {"world": "reality", **own}

    def begin(
        self, task: Task, item: Item, action: npt.ArrayLike, lying: Observed | None = None
    ) -> TrialRun:
        """A try of a task about to be carried out, see `task_trial`.

        Raises:
            RobotError: The arm cannot do it.
            ParameterError: The task does not allow it.
        """
        trial = task_trial(task, as_real(item), action, lying)
        if self.timestep is not None:
            trial = replace(trial, timestep=self.timestep, adaptive=False)
        run = TrialRun(trial, robot=self.robot)
        if lying is not None:
            run.world.place(placed(task.T_world_task(item), lying.points[-1]))
        return run


def _carried_out(world: RealWorld, task: Task, keep: bool, item: Item, action: Array) -> Outcome:
    outcome, n = Outcome(values={}), 0
    try:
        while n < task.tries and not (n and task.within_risk(item, outcome.values)):
            seen, n = observe(task, world.begin(task, item, action, outcome.seen)), n + 1
            outcome = Outcome(values=task.outcome(item, seen), seen=seen, tries=n)
    except (RobotError, SimulationError) as error:
        # after a try the object stays as it lies
        outcome = outcome if n else Outcome(values={}, fault=str(error))
    return outcome if keep else replace(outcome, seen=None)


@functools.cache
def _workers(jobs: int) -> ProcessPoolExecutor:
    """A pool of processes that is kept, because each takes seconds to start."""
    return ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))


def observe(task: Task, run: TrialRun, frame_rate: float = FRAME_RATE) -> Observed:
    """Carry out a `task_trial` and see what its object does, in the task's frame.

    Raises:
        SimulationError: The world diverged, or the hand closes on nothing.
    """
    item, begin = run.trial.item, run.closes
    times = np.arange(begin, run.end + 0.5 / frame_rate, 1.0 / frame_rate)
    points, hand = [], []
    for time in times:
        run.step_to(float(time))
        points.append(run.world.vertices())
        hand.append(run.world.hand)
    T = np.linalg.inv(task.T_world_task(item))
    # times count from the path's own clock, on which the hand closes at the planned time
    late = begin - next(e.time for e in run.trial.path.events if e.closed)
    late += run.trial.end - float(task.times(item)[-1])
    return Observed(
        times=times - late,
        points=placed(T, points),
        hand=placed(T, hand),
        opens=run.opens - late,
        lattice=(item.vertices, item.vertices) if isinstance(item, RealCloth) else (0, 0),
    )
