"""Forward kinematics, Jacobian and inverse kinematics of the tool; where the arm's capsules are.

Poses are T_base_tcp [4, 4]: they map coordinates of the tool point (tcp) to the robot's base.
The gripper's z points out of the fingers, its y from finger to finger. Joint angles that are not
finite, or not as many as the arm has, are refused with a `RobotError`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import RobotError
from gendom.robot.arm import Arm, FingerCapsule, LinkCapsule, ParallelGripper

POSITION_TOLERANCE, ROTATION_TOLERANCE = 1e-7, 1e-6
"""Tolerances of inverse kinematics for a pose [m], [rad]; one more Newton step follows, which
squares the error."""

ANGLE_LENGTH = 0.3  # [m/rad]; a rotation of the tool counts as this movement
_WEIGHT = np.repeat([1.0, ANGLE_LENGTH], 3)  # of pose errors
_IDENTITY = np.eye(6)
_DAMPING = 0.1  # damping^2 = (this)^2 |error|: zero at the solution, so that the end is Newton's
_LARGEST_STEP = 0.4  # [rad]; a joint's step in one iteration
_ITERATIONS, _STARTS = 100, 23
_HOMING = 0.5  # share of the distance to the resting pose in one iteration, within the null space
_HOMED = 75  # iterations with it: where it keeps a start from its pose, the others leave it out
_SETTLED = 1e-5  # [rad]; the null space's steps end below this


def link_poses(arm: Arm, q: ArrayLike) -> Array:
    """T_base_link of the base, all J links and the tool point.

    Args:
        arm: The arm.
        q: [..., J] joint angles [rad].

    Returns:
        [..., J + 2, 4, 4]: base (the identity), links 1 to J, tool point.
    """
    q = arm.check_q(q)
    c, s = np.cos(q)[..., None], np.sin(q)[..., None]
    step = np.broadcast_to(arm.T_links, (*q.shape, 4, 4)).copy()
    x, y = arm.T_links[..., 0], arm.T_links[..., 1]
    step[..., 0], step[..., 1] = c * x + s * y, c * y - s * x
    poses = np.empty((*q.shape[:-1], arm.joints + 2, 4, 4))
    poses[..., 0, :, :] = np.eye(4)
    for i in range(arm.joints):
        np.matmul(poses[..., i, :, :], step[..., i, :, :], out=poses[..., i + 1, :, :])
    np.matmul(poses[..., -2, :, :], arm.T_flange_tcp, out=poses[..., -1, :, :])
    return poses


def tcp_pose(arm: Arm, q: ArrayLike) -> Array:
    """T_base_tcp [..., 4, 4] at joint angles [..., J] [rad]."""
    return link_poses(arm, q)[..., -1, :, :]


def jacobian(arm: Arm, q: ArrayLike) -> Array:
    """Geometric Jacobian of the tool point [..., 6, J] at joint angles [..., J] [rad].

    Rows 0 to 2 times joint speeds are the tool point's velocity, rows 3 to 5 the tool's angular
    velocity, both in the base's axes: column i is (z_i x (p_tcp - p_i), z_i) with the axis z_i
    and the origin p_i of frame i.
    """
    return _jacobian(link_poses(arm, q))


def _jacobian(poses: Array) -> Array:
    J = np.empty((*poses.shape[:-3], 6, poses.shape[-3] - 2))
    x, y, z = (poses[..., -1:, k, 3] - poses[..., 1:-1, k, 3] for k in range(3))
    ax, ay, az = (poses[..., 1:-1, k, 2] for k in range(3))
    J[..., 0, :], J[..., 1, :], J[..., 2, :] = ay * z - az * y, az * x - ax * z, ax * y - ay * x
    J[..., 3, :], J[..., 4, :], J[..., 5, :] = ax, ay, az
    return J


def pose_error(T_base_to: ArrayLike, T_base_from: ArrayLike) -> Array:
    """[..., 6] displacement [m] and rotation vector [rad], in the base's axes, between poses.

    Args:
        T_base_to: [..., 4, 4] target pose.
        T_base_from: [..., 4, 4] current pose.
    """
    to, start = np.asarray(T_base_to, dtype=float), np.asarray(T_base_from, dtype=float)
    turn = to[..., :3, :3] @ np.swapaxes(start[..., :3, :3], -1, -2)
    vector = _rotation_vector(turn)
    return np.concatenate([to[..., :3, 3] - start[..., :3, 3], vector], axis=-1)


def _rotation_vector(R: Array) -> Array:
    """[..., 3] rotation vectors [rad] of matrices [..., 3, 3]."""
    # R - R^T holds 2 sin(angle) times the axis: quick and exact but near half a turn.
    twice = R[..., [2, 0, 1], [1, 2, 0]] - R[..., [1, 2, 0], [2, 0, 1]]
    sine = 0.5 * np.sqrt((twice * twice).sum(axis=-1))
    cosine = 0.5 * (R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1.0)
    scale = np.where(sine > 1e-12, np.arctan2(sine, cosine) / np.maximum(sine, 1e-12), 1.0)
    vector = 0.5 * scale[..., None] * twice
    turned = (cosine < 0.0) & (sine < 1e-3)
    if turned.any():
        vector[turned] = Rotation.from_matrix(R[turned]).as_rotvec()
    return vector


def solutions(arm: Arm, T_base_tcp: ArrayLike) -> list[Array]:
    """All distinct joint angles [J] [rad] within the limits that are found for a pose, to 0.1 um
    and 1 urad, those nearest to `arm.home` first.

    Damped least squares from home and random starts (Buss, "Introduction to inverse kinematics with
    Jacobian transpose, pseudoinverse and damped least squares methods", 2004), the damping
    vanishing with the error. The arm's redundancy is used to approach home, by steps in the null
    space of the Jacobian.

    Raises:
        RobotError: The matrix [4, 4] is not a pose, or no start converges to it.
    """
    T, rest = _check_pose(T_base_tcp), np.clip(arm.home, arm.q_min, arm.q_max)
    # A joint rotated by more than half a turn from home only winds up the arm.
    low = np.maximum(arm.q_min, arm.home - np.pi)
    high = np.minimum(arm.q_max, arm.home + np.pi)
    random = np.random.default_rng(0).uniform(low, high, (_STARTS - 1, arm.joints))
    q = np.concatenate([rest[None], random])
    q, error = descend(arm, np.broadcast_to(T, (len(q), 4, 4)), q, rest)
    good = reached(error)
    if not good.any():
        k = int(np.argmin(_size(error)))
        what = out_of_reach(arm, T, q[k], error[k])
        fix = "move it nearer to the base or turn the gripper"
        raise RobotError(what, where=arm.name, fix=fix)
    q = _unwound(arm, q[good], rest)
    found: list[Array] = []
    for candidate in q[np.argsort(np.linalg.norm(q - rest, axis=1), kind="stable")]:
        if all(np.abs(candidate - other).max() > 0.02 for other in found):
            found.append(candidate)
    return found


def descend(
    arm: Arm,
    T_base_tcp: Array,
    q: Array,
    rest: Array,
    *,
    homing: float = _HOMING,
    homed: int = _HOMED,
    iterations: int = _ITERATIONS,
) -> tuple[Array, Array]:
    """Iterate from starts q [B, J] [rad] to poses [B, 4, 4], and in the null space towards `rest`
    [J], by a share `homing` of the distance in each of the first `homed` steps.

    Returns:
        q [B, J] within the limits, and the remaining error [B, 6] [m], [rad]: of those that reach
        their pose at most that, as a last step squares it.
    """
    q = np.clip(q, arm.q_min, arm.q_max)
    active, error = np.arange(len(q)), np.empty((len(q), 6))
    for k in range(iterations):
        poses = link_poses(arm, here := q[active])
        error[active] = off = pose_error(T_base_tcp[active], poses[:, -1])
        share = homing if k < homed else 0.0
        step, null_motion = _step(arm, poses, here, off, rest, share)
        q[active] = np.clip(here + step, arm.q_min, arm.q_max)
        active = active[~(reached(off) & (null_motion < _SETTLED))]
        if len(active) == 0:
            return q, error
    error[active] = pose_error(T_base_tcp[active], tcp_pose(arm, q[active]))
    return q, error


def _step(
    arm: Arm, poses: Array, q: Array, error: Array, rest: Array, homing: float
) -> tuple[Array, Array]:
    """One step [B, J] of damped least squares, and the largest part within the null space [B]."""
    J = _jacobian(poses) * _WEIGHT[:, None]
    e = error * _WEIGHT
    far = np.sqrt((e * e).sum(axis=1))
    e = e * np.minimum(1.0, 0.3 / np.maximum(far, 1e-12))[:, None]
    damping = (_DAMPING**2 * np.minimum(far, 0.3) + 1e-10)[:, None, None] * _IDENTITY
    free, towards = np.ones(q.shape, dtype=bool), homing * (rest - q)
    for _ in range(3):
        # Joints that would leave their range are fixed, and the others compensate.
        Jf = J * free[:, None, :]
        JT = np.swapaxes(Jf, 1, 2)
        A = Jf @ JT + damping
        wish = towards * free
        main = np.linalg.solve(A, np.stack([e, (Jf @ wish[..., None])[..., 0]], axis=-1))
        moves = JT @ main
        null_motion = wish - moves[..., 1]
        step = moves[..., 0] + null_motion
        out = free & (((q <= arm.q_min) & (step < 0.0)) | ((q >= arm.q_max) & (step > 0.0)))
        if not out.any():
            break
        free &= ~out
    step = step * free
    step *= np.minimum(1.0, _LARGEST_STEP / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
    return step, np.abs(null_motion * free).max(axis=1)


def reached(error: Array) -> NDArray[np.bool_]:
    """[...] whether errors of poses [..., 6] are within the tolerances."""
    squared = error * error
    near = squared[..., :3].sum(axis=-1) <= POSITION_TOLERANCE**2
    return near & (squared[..., 3:].sum(axis=-1) <= ROTATION_TOLERANCE**2)


def _size(error: Array) -> Array:
    """Distance [m], with angles weighted by `ANGLE_LENGTH`."""
    turn = ANGLE_LENGTH * np.linalg.norm(error[..., 3:], axis=-1)
    return np.hypot(np.linalg.norm(error[..., :3], axis=-1), turn)


def _unwound(arm: Arm, q: Array, rest: Array) -> Array:
    """Shift each joint by whole turns to be closest to the resting angles."""
    turned = q - 2.0 * np.pi * np.round((q - rest) / (2.0 * np.pi))
    return np.where((turned >= arm.q_min) & (turned <= arm.q_max), turned, q)


def _check_pose(T: ArrayLike) -> Array:
    """A pose [4, 4] as float64."""
    T = np.asarray(T, dtype=float)
    good = T.shape == (4, 4) and bool(np.isfinite(T).all() and np.all(T[3] == [0, 0, 0, 1]))
    R = T[:3, :3] if good else np.zeros((3, 3))
    proper = np.abs(R @ R.T - np.eye(3)).max() <= 1e-4 and np.linalg.det(R) >= 0.0
    fix = "give [4, 4]: a rotation, the position in metres, and 0 0 0 1"
    require(proper, "is no rigid transform", where="pose T_base_tcp", fix=fix, error=RobotError)
    return T


def out_of_reach(arm: Arm, T_base_tcp: Array, q: Array, error: Array) -> str:
    """That angles [J] miss a pose by an error (`pose_error`), in words."""
    x, y, z, *quat = *T_base_tcp[:3, 3], *Rotation.from_matrix(T_base_tcp[:3, :3]).as_quat()
    turn = ", ".join(f"{value:.3f}" for value in quat)
    held = [str(j + 1) for j in np.flatnonzero((q <= arm.q_min) | (q >= arm.q_max))]
    far, angle = 1e3 * np.linalg.norm(error[:3]), np.degrees(np.linalg.norm(error[3:]))
    what = f"({x:.3f}, {y:.3f}, {z:.3f}) m, quat_xyzw ({turn}), is out of reach: missed by "
    at_end = f", joint {' and '.join(held)} at its end" if held else ""
    return f"{what}{far:.2g} mm and {angle:.2g} degrees{at_end}"


# ---- where the arm's capsules are ---------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ArmShape:
    """C capsules of an arm, at one or more configurations."""

    names: tuple[str, ...]
    """[C] unique."""
    start: Array
    """[..., C, 3] one end of each axis in the base's frame [m]."""
    end: Array
    """[..., C, 3] the other end [m]."""
    radius: Array
    """[C] [m]."""
    touches_object: NDArray[np.bool_]
    """[C] whether the inner side of a capsule holds the object."""


def arm_shape(arm: Arm, q: ArrayLike, opening: ArrayLike = 0.0) -> ArmShape:
    """The arm's capsules, gripper included.

    Args:
        arm: The arm.
        q: [..., J] joint angles [rad].
        opening: [...] distance of the fingers' inner faces [m].
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
