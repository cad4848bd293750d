"""The predefined lift as a timed path of the tool, for any robot or simulator.

After Kuroki et al. (2024), "GenDOM: Generalizable One-shot Deformable Object Manipulation with
Parameter-Aware Policy". The path is ideal: straight lines at constant speeds, whose velocity
jumps at the knots. `gendom.robot.follow` rounds the jumps as far as an arm's accelerations require
and reports the deviation from the ideal path; `TcpPath.position_at` takes the same blend, so that
a simulator can replay the arm's motion. Paths of tasks are defined in `gendom.tasks`.

Positions are those of the point between the fingertips, in the robot's base frame, z up.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gendom.arguments import require
from gendom.errors import RobotError
from gendom.reading import read_json, record_of
from gendom.robot.path import DOWN, GripperEvent, TcpPath

LIFT_ENDS = ("hold", "swing", "drop")
"""How the predefined lift may end: the object held still, swinging or falling."""

SWING_SPEED = 0.5
"""Speed of the quick move of a lift that ends in a swing [m/s]."""

SWING_STROKE = 0.25
"""Length of that move, in heights of the lift."""

REST_AT_END = 1.0
"""Time for which the arm stands still while the object swings or falls [s]."""

ROPE_LIFT_SPEED, CLOTH_LIFT_SPEED = 0.05, 0.1
"""Speed of the predefined lift [m/s]: of a rope so slow that inertia plays no part."""

RISE = 0.75
"""Height of a rope's lift, in its lengths; of a cloth's, in its sides."""

FREE_RISE = 1.0
"""The same of a rope that is to swing: no part of it touches the table then, whose friction and the
rope's rolling would hide its damping."""

LIFT_FRAME_RATE = {"hold": 10.0, "swing": 30.0, "drop": 30.0}
"""Of cameras that record a lift, by its end [1/s]."""


MOTION_FORMAT = "gendom-motion/1"
"""Format of files that hold a `LiftMotion`."""


@dataclass(frozen=True, kw_only=True)
class LiftMotion:
    """A predefined lift of objects of one kind and any size.

    Raises:
        RobotError: A number is out of its range, or there is no such end.
    """

    kind: str
    """``rope`` or ``cloth``."""
    rise: float
    """Height of the lift, in lengths of a rope or sides of a cloth."""
    speed: float
    """[m/s]."""
    end: str = "hold"
    """One of `LIFT_ENDS`."""

    def __post_init__(self) -> None:
        _require(self.kind in ("rope", "cloth"), f"kind is {self.kind!r}", "give rope or cloth")
        _check(self.end, rise=self.rise, speed=self.speed)

    @property
    def quasi_static(self) -> bool:
        """Whether inertia plays no part."""
        return self.kind == "rope" and self.end == "hold" and self.speed <= ROPE_LIFT_SPEED

    def __str__(self) -> str:
        size = "lengths" if self.kind == "rope" else "sides"
        return f"{self.end}, {self.rise:g} {size} at {self.speed:g} m/s"

    @classmethod
    def read(cls, path: str | os.PathLike) -> LiftMotion:
        """The motion in a ``gendom-motion/1`` file, as ``gendom plan-lift`` writes it.

        Raises:
            GendomError: The file cannot be read.
            RobotError: It holds no such motion.
        """
        said, fix = read_json(path), "give motion.json of gendom plan-lift"
        what = f"has format {said.get('format')!r}, not {MOTION_FORMAT!r}"
        right = said.get("format") == MOTION_FORMAT
        require(right, what, where=str(path), fix=fix, error=RobotError)
        try:
            return record_of(cls, said.get("lift"), where="lift", fix=fix, error=RobotError)
        except RobotError as error:
            raise RobotError(error.what, where=f"{path}: {error.where}", fix=error.fix) from None


def predefined_lift(kind: str, end: str = "hold") -> LiftMotion:
    """The default lift of a kind of object.

    Args:
        kind: ``rope`` or ``cloth``.
        end: One of `LIFT_ENDS`.

    Raises:
        RobotError: There is no such end.
    """
    rope = kind == "rope"
    return LiftMotion(
        kind=kind,
        rise=FREE_RISE if rope and end == "swing" else RISE,
        speed=ROPE_LIFT_SPEED if rope else CLOTH_LIFT_SPEED,
        end=end,
    )


def lift(
    start: ArrayLike,
    *,
    height: float,
    speed: float,
    quat_xyzw: ArrayLike = DOWN,
    wait: float = 1.0,
    after: float | None = None,
    end: str = "hold",
) -> TcpPath:
    """Lift straight up at constant speed: the demonstration for estimating parameters.

    The gripper closes at t = 0 around a rope's end or a cloth's corner. Ramps take at most a
    tenth of the rise at each end, and do not overlap the waits. At the top the object is held (end
    "hold"); or, after a second wait, a quick move along x ends in a hard stop ("swing"), or the
    gripper opens ("drop"). The quick move goes `SWING_STROKE` heights at `SWING_SPEED`.

    Args:
        start: [3] grasp position [m].
        height: Height of the lift [m].
        speed: Speed of the lift [m/s].
        quat_xyzw: [4] the gripper's orientation.
        wait: Wait between closing and rising, and at the top before a swing or a drop [s].
        after: Rest at the end [s]; None: 0 after "hold", else `REST_AT_END`.
        end: One of `LIFT_ENDS`.

    Raises:
        RobotError: A number is out of its range, or there is no such end.
    """
    start = np.asarray(start, dtype=float)
    good = start.shape == (3,) and np.isfinite(start).all()
    _require(good, f"start is {start.tolist()}", "give x, y, z in metres")
    _check(end, height=height, speed=speed, wait=wait)
    if after is None:
        after = 0.0 if end == "hold" else REST_AT_END
    rise, stroke, still = height / speed, SWING_STROKE * height, np.zeros(3)
    legs = [(wait, still), (rise, np.array([0.0, 0.0, height]))]
    blends = [0.2 * rise, 2.0 * wait]
    events = [GripperEvent(time=0.0, closed=True)]
    if end != "hold":
        legs.append((wait, still))
    if end == "swing":
        legs.append((stroke / SWING_SPEED, np.array([stroke, 0.0, 0.0])))
        # The gripper rests before the move, and accelerates within it.
        blends += [wait, stroke / SWING_SPEED]
    elif end == "drop":
        events.append(GripperEvent(time=sum(seconds for seconds, _ in legs), closed=False))
    _require(math.isfinite(after) and after >= 0.0, f"after is {after}", "give seconds, 0 or more")
    if after > 0.0:
        legs.append((after, still))
        blends.append(2.0 * after)
    seconds, moves = zip(*legs, strict=True)
    return TcpPath(
        time=np.cumsum([0.0, *seconds]),
        position=start + np.cumsum([still, *moves], axis=0),
        quat_xyzw=np.asarray(quat_xyzw, dtype=float),
        events=tuple(events),
        max_blend=min(blends),
    )


def _check(end: str, **positive: float) -> None:
    _require(end in LIFT_ENDS, f"end is {end!r}", f"choose {', '.join(LIFT_ENDS)}")
    for name, value in positive.items():
        fix = "give a number above 0, in SI units"
        _require(math.isfinite(value) and value > 0.0, f"{name} is {value}", fix)


def _require(holds: Any, what: str, fix: str) -> None:
    require(holds, what, where="motion", fix=fix, error=RobotError)
