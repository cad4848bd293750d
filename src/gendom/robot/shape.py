"""Positions of the arm's capsules, to remove the arm from clouds and to avoid collisions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.robot.arm import Arm
from gendom.robot.kinematics import link_poses


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
    flange = poses[..., -2, :, :]
    names, ends, radius, touches = [], [], [], []
    for capsule in arm.capsules:
        names.append(capsule.name)
        ends.append(_placed(poses[..., capsule.link, :, :], capsule.start, capsule.end))
        radius.append(capsule.radius)
        touches.append(False)
    gripper = arm.gripper
    pivot = np.array([gripper.pivot_y, gripper.pivot_z])
    carried = gripper.finger_pivot(opening)
    for side, sign in (("left", 1.0), ("right", -1.0)):  # as the URDF calls them
        mirror = np.array([1.0, sign, 1.0])
        for knuckle in gripper.knuckles:
            y, z = np.moveaxis(np.stack([np.broadcast_to(pivot, carried.shape), carried]), -1, 0)
            yz = np.stack([y + knuckle.offset[0], z + knuckle.offset[1]], axis=-1)
            a, b = (np.concatenate([0.0 * p[..., :1], p], axis=-1) * mirror for p in yz)
            names.append(f"{side} {knuckle.name}")
            ends.append(_placed(flange, a, b))
            radius.append(knuckle.radius)
            touches.append(False)
        origin = np.concatenate([0.0 * carried[..., :1], carried], axis=-1)
        for finger in gripper.fingers:
            a, b = ((origin + np.array(p)) * mirror for p in (finger.start, finger.end))
            names.append(f"{side} {finger.name}")
            ends.append(_placed(flange, a, b))
            radius.append(finger.radius)
            touches.append(finger.touches_object)
    both = np.stack(ends, axis=-3)
    return ArmShape(
        tuple(names), both[..., 0, :], both[..., 1, :], np.array(radius), np.array(touches)
    )


def _placed(T: NDArray[np.float64], start: ArrayLike, end: ArrayLike) -> NDArray[np.float64]:
    """[..., 2, 3] two points [..., 3] of a frame T [..., 4, 4], in the base's."""
    points = np.stack(np.broadcast_arrays(np.asarray(start), np.asarray(end)), axis=-2)
    return points @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]
