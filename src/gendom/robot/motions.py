"""The predefined lift as a timed path of the tool, for any robot or simulator.

After Kuroki et al. (2024), "GenDOM: Generalizable One-shot Deformable Object Manipulation with
Parameter-Aware Policy". The path is ideal: straight lines at constant speeds, whose velocity
jumps at the knots. `gendom.robot.follow` rounds the jumps off as far as an arm's accelerations
ask for and states how far that is from the ideal path; `TcpPath.position_at` takes the same
blend, so that a simulator can replay what the arm does. Paths of tasks are in their own files
(`gendom.tasks`).

Positions are those of the point between the fingertips, in the robot's base frame, z up.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.errors import RobotError
from gendom.robot.path import DOWN, GripperEvent, TcpPath

Array = NDArray[np.float64]


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
