"""Positions of the arm's capsules, to remove the arm from clouds and to avoid collisions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.robot.arm import Arm, FingerCapsule, LinkCapsule, ParallelGripper
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
    fixed, moved, gripper = arm.capsules, arm.gripper.fingers, arm.gripper
    hand = poses[..., -1, :, :].copy()
    hand[..., :3, 3] -= gripper.length * hand[..., :3, 2]
    right = _carried(gripper, opening)
    both = np.concatenate([right, right * [1.0, -1.0, 1.0]], axis=-3)
    own = _placed(poses[..., [c.link for c in fixed], :, :], _ends(fixed))
    ends = np.concatenate([own, _placed(hand[..., None, :, :], both)], axis=-3)
    names = [c.name for c in fixed]
    names += [f"{side} {c.name}" for side in ("left", "right") for c in moved]  # as the URDF
    return ArmShape(
        tuple(names),
        ends[..., 0, :],
        ends[..., 1, :],
        np.array([c.radius for c in (*fixed, *moved, *moved)]),
        np.array([False] * len(fixed) + 2 * [c.touches_object for c in moved], dtype=bool),
    )


def _ends(capsules: Sequence[LinkCapsule | FingerCapsule]) -> Array:
    """[C, 2, 3] [m]."""
    return np.array([(c.start, c.end) for c in capsules], dtype=float).reshape(-1, 2, 3)


def _carried(gripper: ParallelGripper, opening: Array) -> Array:
    """[..., C, 2, 3] ends of the +y finger's capsules in the gripper's frame [m]."""
    finger = gripper.finger_pivot(opening)[..., None, :]
    turns = np.array([c.pivot is not None for c in gripper.fingers])
    about = np.array([c.pivot or (0.0, 0.0) for c in gripper.fingers]).reshape(-1, 2)
    along = (finger - [gripper.pivot_y, gripper.pivot_z]) / max(gripper.knuckle, 1e-9)
    c = np.where(turns, along[..., 0], 1.0)[..., None]
    s = np.where(turns, along[..., 1], 0.0)[..., None]
    pivot = np.where(turns[:, None], about, finger)[..., None, :]
    x, y, z = np.moveaxis(_ends(gripper.fingers), -1, 0)
    y, z = c * y - s * z + pivot[..., 0], s * y + c * z + pivot[..., 1]
    return np.stack([np.broadcast_to(x, y.shape), y, z], axis=-1)


def _placed(T: Array, ends: Array) -> Array:
    """[..., C, 2, 3] points of frames [..., C or 1, 4, 4], in the base's."""
    return ends @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]
