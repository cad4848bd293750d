"""What grippers hold of rods: decided when they close, given back when they open; and transposes.

A gripper holds the edges whose middles lie inside its sphere, with both their points, and of a rod
that it touches at least one edge. Between a held edge and a free one the rod is free from where the
sphere's surface cuts its centre line: the joint between them stands for the length from there to
the free edge's middle, which makes it stiffer or softer.

Shapes: W worlds, G grippers, K knots, n points.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.sim.thin import rotation

Array = NDArray[Any]

SHORTEST = 0.02
"""Shortest length that a joint at a gripper's border stands for, of its own."""


@dataclass
class Pose:
    """Where a gripper of each world is, and how it moves."""

    centre: Array
    """[W, 3] [m]."""
    q: Array
    """[W, 4]."""
    velocity: Array
    """[W, 3] [m/s]."""
    spin: Array
    """[W, 3] [rad/s]."""


@dataclass
class PoseBars:
    """Derivatives by the parts of a ``Pose``; by q as by a turn in the world's axes."""

    centre: Array
    q: Array
    velocity: Array
    spin: Array


class Paths:
    """Grippers' paths as ``stack_paths`` gives them, with derivatives by their knots."""

    def __init__(self, stacked: dict[str, NDArray[Any]]):
        self.stacked = stacked
        shape = stacked["position"].shape
        self.position_bar = np.zeros(shape)
        self.turn_bar = np.zeros(shape)

    def _segment(self, g: int, w: Array, t: Array) -> tuple[Array, Array, Array]:
        """[W] the knot that begins the segment just before times t, the share of it gone by, and
        1 / its duration [1/s], 0 outside the path."""
        time = self.stacked["time"][w, g]
        last = time.shape[1] - 2
        k = np.clip(np.sum(time < t[:, None], axis=1) - 1, 0, last)
        rows = np.arange(len(w))
        begin, end = time[rows, k], time[rows, k + 1]
        span = end - begin
        inside = (span > 0.0) & (t > begin) & (t <= end)
        share = np.where(span > 0.0, (t - begin) / np.where(span > 0.0, span, 1.0), 0.0)
        return k, np.clip(share, 0.0, 1.0), np.where(inside, 1.0, 0.0) / np.where(inside, span, 1.0)

    def pose(self, g: int, w: Array, t: Array) -> Pose:
        """Of gripper g of worlds w [W] at times t [W] [s]; it moves as just before."""
        k, share, rate = self._segment(g, w, t)
        p, turn = self.stacked["position"], self.stacked["turn"][w, g, k]
        step = p[w, g, k + 1] - p[w, g, k]
        q = rotation.product(_exp(share[:, None] * turn), self.stacked["orientation"][w, g, k])
        turns = self.stacked["turns"][w, g, None] == 1
        return Pose(
            centre=p[w, g, k] + share[:, None] * step,
            q=np.where(turns, q, [0.0, 0.0, 0.0, 1.0]),
            velocity=rate[:, None] * step,
            spin=np.where(turns, rate[:, None] * turn, 0.0),
        )

    def pose_adjoint(self, g: int, w: Array, t: Array, bars: PoseBars) -> None:
        """Transpose of ``pose``."""
        k, share, rate = self._segment(g, w, t)
        share, rate = share[:, None], rate[:, None]
        moved = rate * bars.velocity
        np.add.at(self.position_bar, (w, g, k), (1.0 - share) * bars.centre - moved)
        np.add.at(self.position_bar, (w, g, k + 1), share * bars.centre + moved)
        turns = self.stacked["turns"][w, g, None] == 1
        turn = self.stacked["turn"][w, g, k]
        gone = _exp(share * turn)
        # exp(share turn): its left Jacobian times share
        J = np.linalg.inv(rotation.left_jacobian_inverse(share * turn))
        by_turn = share * np.einsum("wab,wa->wb", J, bars.q) + rate * bars.spin
        inverse = rotation.left_jacobian_inverse(turn)
        after = np.einsum("wab,wa->wb", inverse, by_turn)
        before = rotation.turned(rotation.conjugate(gone), bars.q)
        before -= np.einsum("wab,wb->wa", inverse, by_turn)
        np.add.at(self.turn_bar, (w, g, k), np.where(turns, before, 0.0))
        np.add.at(self.turn_bar, (w, g, k + 1), np.where(turns, after, 0.0))


@dataclass
class Grip:
    """What a gripper of each world holds."""

    holds: NDArray[np.int32]
    """[W, n] 1: a point, + 2: the direction of the edge that begins there."""
    place: Array
    """[W, 7, n] points [m] and directions as seen from the gripper."""
    stiffer: Array
    """[W, n] how much stiffer than usual joints are at its border."""
    cut: NDArray[np.int64]
    """[W, n, 2] where the centre line leaves the sphere near a joint at the border: the points
    that it is between, -1 elsewhere."""
    share: Array
    """[W, n] how far it is from the first to the second of them."""
    free: Array
    """[W, n] how the length that the joint stands for changes with ``share`` [m]."""

    @property
    def misses(self) -> NDArray[np.bool_]:
        """[W] whether nothing is held."""
        return np.logical_not(np.any(self.holds, axis=1))


def close(
    x: Array, q: Array, pose: Pose, radius: Array, length: Array, taken: NDArray[np.bool_]
) -> Grip:
    """What grippers of W worlds hold that close now.

    Args:
        x: [W, n, 3] points [m].
        q: [W, n - 1, 4] directions.
        pose: Of the grippers.
        radius: [W] [m].
        length: [n - 1] of edges at rest [m].
        taken: [W, n - 1] edges that other grippers hold.
    """
    W, n = x.shape[:2]
    inside = _held_edges(x, pose.centre, radius) & ~taken
    holds = np.zeros((W, n), dtype=np.int32)
    holds[:, :-1] |= np.where(inside, 3, 0).astype(np.int32)
    holds[:, 1:] |= np.where(inside, 1, 0).astype(np.int32)
    place = np.zeros((W, 7, n))
    back = rotation.conjugate(pose.q)[:, None]
    place[:, :3] = np.swapaxes(rotation.turned(back, x - pose.centre[:, None]), 1, 2)
    place[:, 3:, :-1] = np.swapaxes(rotation.product(np.broadcast_to(back, q.shape), q), 1, 2)
    grip = Grip(
        holds=holds,
        place=place,
        stiffer=np.ones((W, n)),
        cut=np.full((W, n, 2), -1),
        share=np.zeros((W, n)),
        free=np.zeros((W, n)),
    )
    _cut(grip, x, pose.centre, radius, length, inside)
    return grip


def _held_edges(x: Array, centre: Array, radius: Array) -> NDArray[np.bool_]:
    """[W, n - 1] edges whose middles lie in the sphere; or else, where it cuts the centre line, the
    edge that comes nearest."""
    step = np.diff(x, axis=1)
    from_first = centre[:, None] - x[:, :-1]
    middle = np.linalg.norm(from_first - 0.5 * step, axis=2)
    inside = middle < radius[:, None]
    t = np.sum(from_first * step, axis=2) / np.sum(step**2, axis=2)
    nearest = np.linalg.norm(from_first - np.clip(t, 0.0, 1.0)[:, :, None] * step, axis=2)
    edge = nearest.argmin(axis=1)
    touched = (nearest.min(axis=1) < radius) & ~inside.any(axis=1)
    inside[np.flatnonzero(touched), edge[touched]] = True
    return inside


def _cut(
    grip: Grip, x: Array, centre: Array, radius: Array, length: Array, inside: NDArray[np.bool_]
) -> None:
    """Where spheres cut the centre line between a held and a free edge, and what the joints between
    them then stand for."""
    w, i = np.nonzero(inside[:, :-1] != inside[:, 1:])
    i = i + 1
    before = inside[w, i - 1]
    held, free = np.where(before, i - 1, i), np.where(before, i, i - 1)
    outer, inner = np.where(before, i + 1, i - 1), np.where(before, i - 1, i + 1)
    # beyond the joint, as far as the free edge's middle, or else along the held edge
    beyond = _leaves(x[w, i] - centre[w], x[w, outer] - x[w, i], radius[w])
    along = _leaves(x[w, inner] - centre[w], x[w, i] - x[w, inner], radius[w])
    far = beyond <= 0.5
    share = np.where(far, beyond, along)
    stands_for = np.where(
        far, (0.5 - share) * length[free], 0.5 * length[free] + (1.0 - share) * length[held]
    )
    own = 0.5 * (length[i - 1] + length[i])
    cuts = np.isfinite(share)
    follows = cuts & (stands_for > SHORTEST * own)
    stands_for = np.where(cuts, np.maximum(stands_for, SHORTEST * own), own)
    grip.stiffer[w, i] = own / stands_for
    first, second = np.where(far, i, inner), np.where(far, outer, i)
    grip.cut[w, i] = np.where(follows[:, None], np.stack([first, second], axis=1), -1)
    grip.share[w, i] = share
    grip.free[w, i] = -np.where(far, length[free], length[held])


def _leaves(offset: Array, step: Array, radius: Array) -> Array:
    """[k] the last share in [0, 1] of ways at which offset + share step [k, 3] leaves the sphere;
    NaN where it does not."""
    a, b = np.sum(step**2, axis=1), np.sum(offset * step, axis=1)
    square = b**2 - a * (np.sum(offset**2, axis=1) - radius**2)
    t = (-b + np.sqrt(np.maximum(square, 0.0))) / a
    return np.where((square >= 0.0) & (t >= 0.0) & (t <= 1.0), t, np.nan)


def close_adjoint(
    grip: Grip, x: Array, pose: Pose, length: Array, place_bar: Array, stiffer_bar: Array
) -> tuple[Array, Array, PoseBars, Array]:
    """Transpose of ``close``.

    Args:
        grip, x, pose, length: As there.
        place_bar: [W, 6, n] by places and, as turns in the gripper's axes, by directions.
        stiffer_bar: [W, n].

    Returns:
        Derivatives by x [W, n, 3], by turns of q [W, n - 1, 3], by the pose and by the radius [W].
    """
    W = len(x)
    by_place = rotation.turned(pose.q[:, None], np.swapaxes(place_bar[:, :3], 1, 2))
    by_place = np.where((grip.holds & 1)[..., None] > 0, by_place, 0.0)
    q_bar = rotation.turned(pose.q[:, None], np.swapaxes(place_bar[:, 3:], 1, 2))
    q_bar = np.where((grip.holds & 2)[..., None] > 0, q_bar, 0.0)
    # places are R^T (x - c): a turn of R by d changes them by R^T ((x - c) x d)
    turned = -np.cross(x - pose.centre[:, None], by_place).sum(axis=1) - q_bar.sum(axis=1)
    x_bar, centre_bar, radius_bar = by_place.copy(), -by_place.sum(axis=1), np.zeros(W)
    w, i = np.nonzero(grip.cut[..., 0] >= 0)
    (first, second), share = grip.cut[w, i].T, grip.share[w, i, None]
    step = x[w, second] - x[w, first]
    out = x[w, first] + share * step - pose.centre[w]
    own = 0.5 * (length[i - 1] + length[i])
    by_share = -(grip.stiffer[w, i] ** 2) / own * grip.free[w, i] * stiffer_bar[w, i]
    moved = (by_share / np.sum(out * step, axis=1))[:, None] * out
    np.add.at(x_bar, (w, first), -(1.0 - share) * moved)
    np.add.at(x_bar, (w, second), -share * moved)
    np.add.at(centre_bar, w, moved)
    np.add.at(radius_bar, w, np.sum(moved * out, axis=1) / np.linalg.norm(out, axis=1))
    none = np.zeros((W, 3))
    return x_bar, q_bar[:, :-1], PoseBars(centre_bar, turned, none, none), radius_bar


def released(x: Array, pose: Pose, grip: Grip) -> tuple[Array, Array]:
    """Velocities [W, n, 3] [m/s] and spins [W, n, 3] [rad/s] of what a gripper holds, else 0."""
    v = pose.velocity[:, None] + np.cross(pose.spin[:, None], x - pose.centre[:, None])
    v = np.where((grip.holds & 1)[..., None] > 0, v, 0.0)
    spin = np.where((grip.holds & 2)[..., None] > 0, pose.spin[:, None], 0.0)
    return v, spin


def released_adjoint(
    x: Array, pose: Pose, grip: Grip, v_bar: Array, spin_bar: Array
) -> tuple[Array, PoseBars]:
    """Transpose of ``released``: derivatives by x [W, n, 3] and by the pose."""
    v_bar = np.where((grip.holds & 1)[..., None] > 0, v_bar, 0.0)
    spin_bar = np.where((grip.holds & 2)[..., None] > 0, spin_bar, 0.0)
    x_bar = np.cross(v_bar, pose.spin[:, None])
    turned = np.cross(x - pose.centre[:, None], v_bar).sum(axis=1) + spin_bar.sum(axis=1)
    none = np.zeros_like(pose.centre)
    return x_bar, PoseBars(-x_bar.sum(axis=1), none, v_bar.sum(axis=1), turned)


def _exp(turn: Array) -> Array:
    """[..., 4] of rotation vectors [..., 3]."""
    angle = np.linalg.norm(turn, axis=-1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(0.5 * angle / np.pi) * turn, np.cos(0.5 * angle)], axis=-1)
