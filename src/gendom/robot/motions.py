"""The paper's motions as timed paths of the tool, for any robot or simulator.

After Kuroki et al. (2024), "GenDOM: Generalizable One-shot Deformable Object Manipulation with
Parameter-Aware Policy". The paths are ideal: straight lines at constant speeds, whose velocity
jumps at the knots. `gendom.robot.follow` rounds the jumps off as far as an arm's accelerations
ask for and states how far that is from the ideal path; `TcpPath.position_at` takes the same
blend, so that a simulator can replay what the arm does.

Positions are those of the point between the fingertips, in the robot's base frame, z up.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.errors import RobotError
from gendom.robot.path import DOWN, GripperEvent, TcpPath

Array = NDArray[np.float64]

SPREADING_STEPS = 16
"""Steps in which a cloth is brought down."""

SPREADING_HEIGHT = 0.16
"""How far a cloth is raised and brought down [m]."""

LARGEST_PAPER_A = 0.25
"""Beyond it the paper's formula asks for steps upwards."""


def lift(
    start: ArrayLike,
    *,
    height: float,
    speed: float,
    quat_xyzw: ArrayLike = DOWN,
    wait: float = 1.0,
    after: float = 0.0,
) -> TcpPath:
    """Straight up at constant speed: the demonstration that parameters are estimated from.

    The gripper closes at t = 0 around a rope's end or a cloth's corner. Ramps take at most a
    tenth of the rise at each end, and end before and begin after the waits.

    Args:
        start: [3] where it grasps [m].
        height: How far it rises [m].
        speed: [m/s].
        quat_xyzw: [4] the gripper's orientation.
        wait: Between closing and rising [s].
        after: Still at the top [s].

    Raises:
        RobotError: A number is out of its range.
    """
    start = _point(start, "start")
    _positive(height=height, speed=speed, wait=wait)
    rise = height / speed
    time = [0.0, wait, wait + rise]
    position = [start, start, start + np.array([0.0, 0.0, height])]
    if _not_negative(after=after):
        time.append(time[-1] + after)
        position.append(position[-1])
    return TcpPath(
        time=np.array(time),
        position=np.array(position),
        quat_xyzw=np.asarray(quat_xyzw, dtype=float),
        events=(GripperEvent(time=0.0, closed=True),),
        max_blend=min(0.2 * rise, 2.0 * wait, 2.0 * after if after > 0.0 else math.inf),
    )


def rope_reaching(
    time: ArrayLike,
    position: ArrayLike,
    *,
    release_time: float,
    quat_xyzw: ArrayLike,
    origin: ArrayLike = (0.0, 0.0, 0.0),
    wait: float = 0.5,
    after: float = 1.0,
) -> TcpPath:
    """Carry the tip of a hanging rope to a release point, hold it still, and let go.

    Time and position are the knots of the task's gripper that holds the tip: straight, at
    constant speed, from where the tip hangs to the release point. The tool is still when it
    opens: blends reach at most into the hold.

    Args:
        time: [K] of the knots [s].
        position: [K, 3] [m].
        release_time: When it opens [s], after the last knot.
        quat_xyzw: [4] the gripper's orientation; it should not be in the rope's way when that
            swings.
        origin: [3] of the task's frame in the robot's base frame [m]. The task's release points
            begin 0.24 rope lengths from its origin, which for short ropes is inside the arm.
        wait: Between closing and the first knot [s].
        after: Still after opening [s].

    Raises:
        RobotError: Shapes do not agree, or the release does not come after the last knot.
    """
    time, position = np.asarray(time, dtype=float), np.asarray(position, dtype=float)
    if time.ndim != 1 or position.shape != (len(time), 3) or len(time) < 2:
        raise _bad(f"needs time [K >= 2] and position [K, 3], got {time.shape}, {position.shape}")
    _positive(wait=wait, after=after)
    if not release_time > time[-1]:
        raise _bad(
            f"the release at {release_time:g} s is not after the last knot at {time[-1]:g} s",
            fix="give the tool time to come to rest",
        )
    position = position + _point(origin, "origin")
    return TcpPath(
        time=np.concatenate([[time[0] - wait], time, [release_time + after]]),
        position=np.concatenate([position[:1], position, position[-1:]]),
        quat_xyzw=np.asarray(quat_xyzw, dtype=float),
        events=(
            GripperEvent(time=float(time[0] - wait), closed=True),
            GripperEvent(time=float(release_time), closed=False),
        ),
        max_blend=2.0 * min(release_time - float(time[-1]), wait),
    )


def rope_casting(
    start: ArrayLike,
    action: float,
    *,
    duration: float,
    heading: float = 0.0,
    quat_xyzw: ArrayLike = DOWN,
    wait: float = 1.0,
    after: float = 2.0,
) -> TcpPath:
    """A rope hangs from the gripper, which makes one momentary horizontal move and stands still.

    In the authors' code the move takes 5 steps of a simulation whose rope is 0.5 long under
    gravity 12, 9.5 ms in its time, and goes 0.05 to 0.1 far. For a rope of 0.25 m that is 25 to
    50 mm in 7.4 ms, or 3.4 to 6.7 m/s, which no arm of 1 m/s does. `follow` makes the move as
    quick as the arm's accelerations allow: it takes `duration` plus the motion's `blend`.

    Args:
        start: [3] where the rope's top is held [m].
        action: How far it moves [m]; negative: backwards.
        duration: Of the move [s].
        heading: Direction of the move from x towards y [rad].
        quat_xyzw: [4] the gripper's orientation.
        wait: Still before the move, for the rope to hang still [s].
        after: Still after it [s].

    Raises:
        RobotError: A number is out of its range.
    """
    start = _point(start, "start")
    _positive(duration=duration, wait=wait, after=after)
    if not math.isfinite(action) or action == 0.0:
        raise _bad(f"action is {action}", fix="give metres, not 0")
    end = start + action * np.array([math.cos(heading), math.sin(heading), 0.0])
    return TcpPath(
        time=np.array([0.0, wait, wait + duration, wait + duration + after]),
        position=np.array([start, start, end, end]),
        quat_xyzw=np.asarray(quat_xyzw, dtype=float),
        events=(GripperEvent(time=0.0, closed=True),),
        max_blend=2.0 * min(wait, after),
    )


def spreading_steps(A: float, *, fast_first: bool = False) -> Array:
    """[16] way of each step of cloth spreading [m], 0.16 m in all.

    The paper's formula in centimetres is

        1 - (4.5 - 0.5 i) A  for i = 1..8,     1 + (0.5 i - 4.0) A  for i = 9..16:

    from 1 - 4 A to 1 - 0.5 A and from 1 + 0.5 A to 1 + 4 A. The two halves sum to 8 - 18 A and
    8 + 18 A, so every A gives 16 cm. Beyond A = 0.25 the first steps would go upwards. There
    the paper is silent and the authors' code sets them to zero, which lengthens the way; here
    they are zero too and all others are scaled to keep the 16 cm.

    Args:
        A: The paper's acceleration [-], not negative.
        fast_first: The same steps in reverse order, as the authors' code plays them; the paper
            has them grow.

    Raises:
        RobotError: A is negative or not finite.
    """
    if not (math.isfinite(A) and A >= 0.0):
        raise _bad(f"A is {A}", fix="give a number of at least 0")
    i = np.arange(1, SPREADING_STEPS + 1)
    steps = 1.0 + np.where(i <= 8, 0.5 * i - 4.5, 0.5 * i - 4.0) * A
    steps = np.maximum(steps, 0.0)
    steps *= SPREADING_HEIGHT / steps.sum()
    return steps[::-1] if fast_first else steps


def cloth_spreading(
    start: ArrayLike,
    A: float,
    *,
    step_time: float,
    rise_speed: float = 0.1,
    fast_first: bool = False,
    quat_xyzw: ArrayLike = DOWN,
    wait: float = 1.0,
    settle: float = 2.0,
    after: float = 1.0,
) -> TcpPath:
    """Raise a cloth by its centre and bring it down in 16 steps; the gripper stays closed.

    Args:
        start: [3] where the centre is grasped [m].
        A: The paper's acceleration [-], see `spreading_steps`.
        step_time: Of each of the 16 steps [s]. The paper gives none; in its authors' code a step
            is 30 times 1.9 ms in a scene of gravity 12 whose cloth is 0.4 wide.
        rise_speed: At which it is raised [m/s].
        fast_first: See `spreading_steps`.
        quat_xyzw: [4] the gripper's orientation.
        wait: Between closing and rising [s].
        settle: Still at the top, for the cloth to hang still [s].
        after: Still at the end [s].

    Raises:
        RobotError: A number is out of its range.
    """
    start = _point(start, "start")
    _positive(step_time=step_time, rise_speed=rise_speed, wait=wait, settle=settle, after=after)
    down = np.concatenate([[0.0], np.cumsum(spreading_steps(A, fast_first=fast_first))])
    top = wait + SPREADING_HEIGHT / rise_speed
    time = np.concatenate(
        [[0.0, wait, top], top + settle + step_time * np.arange(SPREADING_STEPS + 1)]
    )
    height = np.concatenate([[0.0, 0.0, SPREADING_HEIGHT], SPREADING_HEIGHT - down])
    position = start + height[:, None] * np.array([0.0, 0.0, 1.0])
    return TcpPath(
        time=np.append(time, time[-1] + after),
        position=np.concatenate([position, position[-1:]]),
        quat_xyzw=np.asarray(quat_xyzw, dtype=float),
        events=(GripperEvent(time=0.0, closed=True),),
        max_blend=min(2.0 * wait, settle, 2.0 * after),
    )


def _point(value: ArrayLike, name: str) -> Array:
    point = np.asarray(value, dtype=float)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise _bad(f"{name} is {np.asarray(value).tolist()}", fix="give x, y, z in metres")
    return point


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0.0):
            raise _bad(f"{name} is {value}", fix="give a number above 0, in SI units")


def _not_negative(**values: float) -> bool:
    """Whether all are above 0, where none is below."""
    for name, value in values.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise _bad(f"{name} is {value}", fix="give a number of at least 0, in SI units")
    return all(value > 0.0 for value in values.values())


def _bad(what: str, *, fix: str | None = None) -> RobotError:
    return RobotError(what, where="motion", fix=fix)
