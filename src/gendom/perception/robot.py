"""The robot's own shape as capsules, to take it out of the clouds.

joints.csv has the joints' angles of a robot that `gendom.robot` knows, whose base frame is the
world; its capsules follow by forward kinematics.

Points within a margin around a capsule belong to the robot. The fingers and their pads touch the
object, so their margin is at most `FINGER_MARGIN`; a larger one would remove the held part of the
object and a piece below it.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import time_text
from gendom.arrays import Array
from gendom.datasets import Fault
from gendom.errors import RecordingError, RobotError
from gendom.perception.camera import expect
from gendom.perception.frames import interpolate
from gendom.robot import XARM7, Arm, JointStates, arm_shape, find_arm, read_joints

FINGER_MARGIN = 0.003
"""Largest margin around the fingers [m]: about the depth noise at 0.8 m."""

_MOST_TURNS = 2000.0  # [rad]; a robot at full speed needs ten minutes
_MAX_GAP_AT_ENDS = 0.1  # [s]; the joints may begin later and end earlier by so much


@dataclass(frozen=True, eq=False)
class Capsules:
    """C capsules at one moment."""

    start: Array
    """[C, 3] one end of the axis [m]."""
    end: Array
    """[C, 3] the other end [m]."""
    radius: Array
    """[C] [m]."""
    largest_margin: Array | None = None
    """[C] upper bound on the margin around each capsule [m]; None: no bounds."""

    def contain(self, points: Array, margin: float = 0.0) -> np.ndarray:
        """[n] points [n, 3] that are in a capsule or nearer to one than a margin [m]."""
        found = np.zeros(len(points), dtype=bool)
        columns = np.ascontiguousarray(points.T)
        most = np.inf if self.largest_margin is None else self.largest_margin
        reaches = self.radius + np.minimum(margin, most)
        for a, b, reach in zip(self.start, self.end, reaches, strict=True):
            low, high = np.minimum(a, b) - reach, np.maximum(a, b) + reach
            # Most links are far from the object; a bounding box test excludes them.
            near = (columns[0] >= low[0]) & (columns[0] <= high[0])
            for k in (1, 2):
                near &= (columns[k] >= low[k]) & (columns[k] <= high[k])
            some = np.flatnonzero(near)
            if len(some) == 0:
                continue
            axis, rel = b - a, columns[:, some].T - a
            length2 = axis @ axis
            along = np.clip(rel @ axis / length2, 0.0, 1.0) if length2 > 0 else np.zeros(len(some))
            rel -= along[:, None] * axis
            found[some] |= np.einsum("ij,ij->i", rel, rel) <= reach**2
        return found


def arm_capsules(
    arm: Arm, states: JointStates, *, held: float = 0.0
) -> Callable[[float], Capsules]:
    """An arm's capsules as a function of time [s], from its joints.

    Args:
        arm: Its base frame is the world.
        states: Joint angles, between which it turns evenly; before and after it is at rest.
        held: Thickness of what the fingers hold [m], their opening where the states have none.
    """

    def at(time: float) -> Capsules:
        opening = held
        if states.opening is not None:
            opening = np.interp(time, states.time, states.opening)
        shape = arm_shape(arm, interpolate(states.time, states.q, time), opening)
        margins = np.where(shape.touches_object, FINGER_MARGIN, np.inf)
        return Capsules(shape.start, shape.end, shape.radius, margins)

    return at


def read_shape(
    folder: str | os.PathLike,
    meta: Mapping[str, Any],
    span: tuple[float, float],
    *,
    arm: Arm | None = None,
    on_warning: Callable[[Fault], None] = lambda _: None,
) -> Callable[[float], Capsules] | None:
    """The robot's shape in a folder as a function of time [s], from joints.csv; None: it has none.

    Args:
        folder: It may hold the file.
        meta: The content of object.toml: `robot` names the arm, by default the xArm 7. Fingers are
            open by the object's diameter or thickness where joints.csv does not say.
        span: First and last time [s] at which the shape is needed; others are told.
        arm: In place of that which the content names.

    Raises:
        RecordingError: The file cannot be read, or the arm is unknown.
    """
    joints = Path(folder) / "joints.csv"
    if not joints.exists():
        return None
    held = meta.get("object")
    held = held if isinstance(held, dict) else {}
    where: str | None = f"{Path(folder) / 'object.toml'}: robot"
    try:
        arm = arm or find_arm(meta.get("robot", held.get("robot", XARM7.name)))
        where = None
        states = read_joints(joints, arm, on_cut=lambda line: on_warning(cut_off(joints, line)))
    except RobotError as error:
        raise RecordingError(error.what, where=where or error.where, fix=error.fix) from None
    turned = float(np.abs(np.diff(states.q, axis=0)).max(axis=1, initial=0.0).sum())
    what, fix = f"turn by {turned:.4g} rad in all", "give the joints of one lift, in radians"
    expect(turned < _MOST_TURNS, what, str(joints), fix)
    sizes = [held.get(size) for size in ("diameter", "thickness")]
    width = next((float(s) for s in sizes if isinstance(s, (int, float))), 0.0)
    first, last = states.time[0], states.time[-1]
    if first > span[0] + _MAX_GAP_AT_ENDS or last < span[1] - _MAX_GAP_AT_ENDS:
        what = f"spans {time_text(first)} to {time_text(last)} s of {time_text(span[0])} to "
        what += f"{time_text(span[1])} s: outside, the arm is taken to stand still"
        fix = "put joints and gripper on one clock, or record both throughout"
        on_warning(Fault(what, str(joints), fix, "warning"))
    return arm_capsules(arm, states, held=width)


def cut_off(path: Path, line: int) -> Fault:
    """Warning that the last row of a file is incomplete."""
    what = "is cut short, as by an interrupted recording; it is left out"
    fix = "record again if too much is missing"
    return Fault(what, f"{path}, line {line}", fix, "warning")
