"""Positions of the arm's capsules, to remove the arm from clouds and to avoid collisions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.robot.arm import Arm, FingerCapsule, ParallelGripper
from gendom.robot.kinematics import link_poses

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ArmShape:
    """C capsules of an arm, at one or more configurations."""

    names: tuple[str, ...]
    """[C] unique."""
    start: NDArray[np.float64]
    """[..., C, 3] one end of each axis in the base's frame [m]."""
    end: NDArray[np.float64]
    """[..., C, 3] the other end [m]."""
    radius: NDArray[np.float64]
    """[C] [m]."""
    touches_object: NDArray[np.bool_]
    """[C] whether the inner side of a capsule holds the object."""


def arm_shape(arm: Arm, q: ArrayLike, opening: ArrayLike = 0.0) -> ArmShape:
    """The arm's capsules, gripper included.

    Args:
        arm: The arm.
        q: [..., J] joint angles [rad].
        opening: [...] distance of the fingers' inner faces [m].

    Raises:
        RobotError: As `link_poses`.
    """
    poses = link_poses(arm, q)
    opening = np.broadcast_to(np.asarray(opening, dtype=float), poses.shape[:-3])
    fixed, gripper = arm.capsules, arm.gripper
    own = np.array([(c.start, c.end) for c in fixed], dtype=float).reshape(-1, 2, 3)
    hand = poses[..., -1, :, :].copy()
    hand[..., :3, 3] -= gripper.length * hand[..., :3, 2]
    carried = gripper.finger_pivot(opening)
    moved = [_turned(gripper, carried), _shifted(gripper, carried)]
    right = np.concatenate(moved, axis=-3)
    both = np.concatenate([right, right * [1.0, -1.0, 1.0]], axis=-3)
    ends = np.concatenate(
        [
            _placed(poses[..., [c.link for c in fixed], :, :], own),
            _placed(hand[..., None, :, :], both),
        ],
        axis=-3,
    )
    movable = (*gripper.knuckles, *gripper.fingers)
    names = [c.name for c in fixed]
    names += [f"{side} {c.name}" for side in ("left", "right") for c in movable]  # as the URDF
    touches = [isinstance(c, FingerCapsule) and c.touches_object for c in movable]
    return ArmShape(
        tuple(names),
        ends[..., 0, :],
        ends[..., 1, :],
        np.array([c.radius for c in (*fixed, *movable, *movable)]),
        np.array([False] * len(fixed) + 2 * touches, dtype=bool),
    )


def _turned(gripper: ParallelGripper, carried: Array) -> Array:
    """[..., K, 2, 3] ends of the +y knuckles' capsules [m] that carry a finger [..., 2]."""
    ends = np.array([(c.start, c.end) for c in gripper.knuckles], dtype=float).reshape(-1, 2, 3)
    pivots = np.array([c.pivot for c in gripper.knuckles], dtype=float).reshape(-1, 1, 2)
    along = (carried - [gripper.pivot_y, gripper.pivot_z]) / max(gripper.knuckle, 1e-9)
    c, s = along[..., None, None, 0], along[..., None, None, 1]
    x, y, z = np.moveaxis(ends, -1, 0)
    y, z = c * y - s * z + pivots[..., 0], s * y + c * z + pivots[..., 1]
    return np.stack([np.broadcast_to(x, y.shape), y, z], axis=-1)


def _shifted(gripper: ParallelGripper, carried: Array) -> Array:
    """[..., F, 2, 3] ends of the +y finger's capsules [m]."""
    ends = np.array([(c.start, c.end) for c in gripper.fingers], dtype=float).reshape(-1, 2, 3)
    return ends + np.insert(carried, 0, 0.0, axis=-1)[..., None, None, :]


def _placed(T: Array, ends: Array) -> Array:
    """[..., C, 2, 3] points of frames [..., C or 1, 4, 4], in the base's."""
    return ends @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]
