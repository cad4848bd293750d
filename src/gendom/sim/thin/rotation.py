"""Unit quaternions (scalar last) for the directions of a rod, and twist-free frames."""

import numpy as np

from gendom.arrays import Array


def product(a: Array, b: Array) -> Array:
    """Product a b [..., 4]: the rotation b followed by a."""
    a0, a1, a2, a3 = (a[..., k] for k in range(4))
    b0, b1, b2, b3 = (b[..., k] for k in range(4))
    found = np.empty(np.broadcast_shapes(a.shape, b.shape))
    found[..., 0] = a3 * b0 + b3 * a0 + a1 * b2 - a2 * b1
    found[..., 1] = a3 * b1 + b3 * a1 + a2 * b0 - a0 * b2
    found[..., 2] = a3 * b2 + b3 * a2 + a0 * b1 - a1 * b0
    found[..., 3] = a3 * b3 - a0 * b0 - a1 * b1 - a2 * b2
    return found


def vector(q: Array) -> Array:
    """Rotation vector [..., 3] of at most half a turn [rad]."""
    q = np.where(q[..., 3:] < 0.0, -q, q)
    size = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(size, q[..., 3:])
    return np.where(size > 1e-12, angle / np.maximum(size, 1e-12), 2.0) * q[..., :3]


def conjugate(q: Array) -> Array:
    """Inverse rotation [..., 4]."""
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def between(a: Array, b: Array) -> Array:
    """Relative rotation conj(a) b [..., 4], with a non-negative scalar part."""
    p = product(conjugate(a), b)
    return np.where(p[..., 3:] < 0.0, -p, p)


def turned(q: Array, v: Array) -> Array:
    """Vectors v rotated by q, [..., 3]."""
    twice = 2.0 * np.cross(q[..., :3], v)
    return v + q[..., 3:] * twice + np.cross(q[..., :3], twice)


def shortest(a: Array, b: Array) -> Array:
    """Smallest rotation [..., 4] that takes direction a [..., 3] to direction b."""
    a = a / np.linalg.norm(a, axis=-1, keepdims=True)
    b = b / np.linalg.norm(b, axis=-1, keepdims=True)
    q = np.concatenate([np.cross(a, b), 1.0 + np.sum(a * b, axis=-1, keepdims=True)], axis=-1)
    opposite = q[..., 3] < 1e-9
    if opposite.any():  # half a turn about any axis across a
        axis = np.cross(a, np.eye(3)[np.argmin(np.abs(a), axis=-1)])
        q[opposite] = np.concatenate([axis, np.zeros_like(axis[..., :1])], axis=-1)[opposite]
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def transported(first: Array, step: Array) -> Array:
    """Twist-free frames [..., n - 1, 4] along edges [..., n - 1, 3], from a first frame [..., 4].

    The first frame is rotated onto the first edge by the smallest rotation, and each further frame
    results from the previous one in the same way. Quaternions of neighbours have non-negative
    scalar products. Source: Bishop (1975), "There is more than one way to frame a curve".
    """
    third = np.broadcast_to([0.0, 0.0, 1.0], (*step.shape[:-2], 3))
    start = product(shortest(turned(first, third), step[..., 0, :]), first)[..., None, :]
    turns = shortest(step[..., :-1, :], step[..., 1:, :])
    by = 1
    while by < turns.shape[-2]:  # cumulative products of rotations, in pairs, fours, eights...
        turns[..., by:, :] = product(turns[..., by:, :], turns[..., :-by, :])
        by *= 2
    return np.concatenate([start, product(turns, np.broadcast_to(start, turns.shape))], axis=-2)


def transported_adjoint(first: Array, step: Array, turn_bar: Array) -> Array:
    """Derivatives by edges [..., n - 1, 3], given those by rotations of their frames.

    ``turn_bar`` is [..., n - 1, 3]. An edge's frame rotates by t x dt, and about t so that the
    twist stays 0:
    d tau_e = d tau_(e-1) - (t_(e-1) x t_e) . (dt_(e-1) + dt_e) / (1 + t_(e-1) . t_e).
    """
    length = np.linalg.norm(step, axis=-1, keepdims=True)
    t = step / length
    third = np.broadcast_to([0.0, 0.0, 1.0], (*step.shape[:-2], 3))
    before = np.concatenate([turned(first, third)[..., None, :], t[..., :-1, :]], axis=-2)
    by_tau = np.sum(turn_bar * t, axis=-1)
    by_tau = np.flip(np.cumsum(np.flip(by_tau, -1), axis=-1), -1)[..., None]
    bend = np.cross(before, t) / (1.0 + np.sum(before * t, axis=-1, keepdims=True))
    t_bar = np.cross(turn_bar, t) - by_tau * bend
    t_bar[..., :-1, :] -= (by_tau * bend)[..., 1:, :]
    return (t_bar - np.sum(t_bar * t, axis=-1, keepdims=True) * t) / length


def left_jacobian(turn: Array) -> Array:
    """Left Jacobian J [..., 3, 3] of rotation vectors: exp(turn + d) = exp(J d) exp(turn).

    Source: Sola, Deray and Atchuthan (2018), "A micro Lie theory", equation 145.
    """
    angle = np.linalg.norm(turn, axis=-1)[..., None, None]
    K = np.cross(np.eye(3), turn[..., None, :])  # rows e x turn: of the matrix turn x
    small, safe = angle < 1e-4, np.maximum(angle, 1e-4)
    a = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    b = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) + a * K + b * (K @ K)
