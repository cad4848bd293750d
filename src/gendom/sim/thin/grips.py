"""What grippers hold: decided when they close, given back when they open; and transposes.

A gripper holds the edges whose middles lie inside its sphere, with both their points, and of a rod
that it touches at least one edge. Between a held edge and a free one the rod is free from where the
sphere's surface cuts its centre line: the joint between them stands for the length from there to
the free edge's middle, which makes it stiffer or softer. Lines of a shell's lattice are cut alike.

Shapes: W worlds, G grippers, K knots, n points.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.sim.thin import rotation

Array = NDArray[Any]

SHORTEST = 0.02
"""Shortest length that a rod's joint at a gripper's border stands for, of its own."""

SHORTEST_OF_SHELL = 0.125
"""The same of a shell's, which no inertia slows down."""


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
        """Transpose of ``pose``; every world at most once."""
        k, share, rate = self._segment(g, w, t)
        share, rate = share[:, None], rate[:, None]
        moved = rate * bars.velocity
        self.position_bar[w, g, k] += (1.0 - share) * bars.centre - moved
        self.position_bar[w, g, k + 1] += share * bars.centre + moved
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
        self.turn_bar[w, g, k] += np.where(turns, before, 0.0)
        self.turn_bar[w, g, k + 1] += np.where(turns, after, 0.0)


@dataclass
class Cut:
    """Where spheres cut lines of points between held and free edges."""

    stiffer: Array
    """[L, n] how much stiffer than usual joints are."""
    between: Array
    """[L, n, 2] the points that a cut is between, -1 where there is none."""
    share: Array
    """[L, n] how far it is from the first to the second of them."""
    free: Array
    """[L, n] how the length that the joint stands for changes with ``share`` [m]."""


@dataclass
class Grip:
    """What a gripper of each world holds."""

    holds: NDArray[np.int32]
    """[W, n] 1: a point, + 2: the direction of the edge that begins there."""
    place: Array
    """[W, ., n] points [m], and directions of rods, as seen from the gripper."""
    stiffer: Array
    """[W, M, n] how much stiffer than usual joints are at its border: a rod's, or a shell's along
    rows and along columns."""
    cuts: tuple[Cut, ...]

    @property
    def misses(self) -> NDArray[np.bool_]:
        """[W] whether nothing is held."""
        return np.logical_not(np.any(self.holds, axis=1))


def close_rod(
    x: Array, q: Array, pose: Pose, radius: Array, length: Array, taken: NDArray[np.bool_]
) -> Grip:
    """What grippers of W worlds hold of rods that close now.

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
    cut = _cut(x, pose.centre, radius, length, inside, SHORTEST)
    return Grip(holds, place, cut.stiffer[:, None], (cut,))


def close_shell(
    x: Array, shape: tuple[int, int], pose: Pose, radius: Array,
    spacing: tuple[float, float], taken: NDArray[np.bool_],
) -> Grip:  # fmt: skip
    """What grippers of W worlds hold of shells that close now: points inside the sphere and those
    whose lattice edge to one of them has its middle inside; or else, where it touches the sheet,
    the point that is nearest.

    Args:
        x: [W, n, 3] points [m].
        shape: Rows, and points of a row.
        pose: Of the grippers.
        radius: [W] [m].
        spacing: Along rows and along columns [m].
        taken: [W, n] points that other grippers hold.
    """
    W, n = x.shape[:2]
    at = x.reshape(W, *shape, 3)
    distance = np.linalg.norm(at - pose.centre[:, None, None], axis=3)
    held = distance < radius[:, None, None]
    for axis in (1, 2):
        first, second = (np.take(at, k, axis) for k in _ends(at.shape[axis]))
        middle = np.linalg.norm(0.5 * (first + second) - pose.centre[:, None, None], axis=3)
        near = middle < radius[:, None, None]
        ends = np.moveaxis(held, axis, 0)
        near = np.moveaxis(near, axis, 0)
        ends[:-1] |= near
        ends[1:] |= near
    flat = distance.reshape(W, n)
    touched = (flat.min(axis=1) < np.maximum(radius, 0.75 * max(spacing))) & ~held.any(axis=(1, 2))
    held = held.reshape(W, n)
    held[np.flatnonzero(touched), flat.argmin(axis=1)[touched]] = True
    held &= ~taken
    place = np.zeros((W, 7, n))
    back = rotation.conjugate(pose.q)[:, None]
    place[:, :3] = np.swapaxes(rotation.turned(back, x - pose.centre[:, None]), 1, 2)
    grid = held.reshape(W, *shape)
    cuts, stiffer = [], []
    for axis, step in ((1, spacing[0]), (0, spacing[1])):
        lines = _lines(at, axis)
        edges = np.logical_and(*(_lines(grid, axis)[:, k] for k in _ends(lines.shape[1])))
        many = shape[0] if axis == 1 else shape[1]
        centre, radii = np.repeat(pose.centre, many, axis=0), np.repeat(radius, many)
        length = np.full(lines.shape[1] - 1, step)
        cuts.append(_cut(lines, centre, radii, length, edges, SHORTEST_OF_SHELL))
        stiffer.append(_unlines(cuts[-1].stiffer, W, shape, axis).reshape(W, n))
    return Grip(held.astype(np.int32), place, np.stack(stiffer, axis=1), tuple(cuts))


def _ends(count: int) -> tuple[Array, Array]:
    """First and second points of a line's edges."""
    return np.arange(count - 1), np.arange(1, count)


def _lines(values: Array, axis: int) -> Array:
    """[W many, count, ...] of [W, rows, columns, ...]: its rows (axis 1) or its columns (0)."""
    ordered = values if axis == 1 else np.swapaxes(values, 1, 2)
    return ordered.reshape(-1, *ordered.shape[2:])


def _unlines(lines: Array, W: int, shape: tuple[int, int], axis: int) -> Array:
    """Inverse of ``_lines``."""
    if axis == 1:
        return lines.reshape(W, *shape, *lines.shape[2:])
    return np.swapaxes(lines.reshape(W, *shape[::-1], *lines.shape[2:]), 1, 2)


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
    x: Array, centre: Array, radius: Array, length: Array, inside: NDArray[np.bool_], least: float
) -> Cut:
    """Where spheres [L] cut lines of points [L, n, 3] between held and free edges, and what the
    joints between them then stand for, at least the share ``least`` of their own length."""
    L, n = x.shape[:2]
    w, i = np.nonzero(inside[:, :-1] != inside[:, 1:])
    i = i + 1
    before = inside[w, i - 1]
    held, free = np.where(before, i - 1, i), np.where(before, i, i - 1)
    outer, inner = np.where(before, i + 1, i - 1), np.where(before, i - 1, i + 1)
    # beyond the joint, as far as the free edge's middle, or else along the held edge
    beyond = _leaves(x[w, i] - centre[w], x[w, outer] - x[w, i], radius[w])
    along = _leaves(x[w, inner] - centre[w], x[w, i] - x[w, inner], radius[w])
    far = beyond <= 0.5 + 1e-9
    share = np.where(far, beyond, along)
    stands_for = np.where(
        far, (0.5 - share) * length[free], 0.5 * length[free] + (1.0 - share) * length[held]
    )
    own = 0.5 * (length[i - 1] + length[i])
    cuts = np.isfinite(share)
    follows = cuts & (stands_for > least * own)
    stands_for = np.where(cuts, np.maximum(stands_for, least * own), own)
    cut = Cut(np.ones((L, n)), np.full((L, n, 2), -1), np.zeros((L, n)), np.zeros((L, n)))
    cut.stiffer[w, i] = own / stands_for
    ends = np.stack([np.where(far, i, inner), np.where(far, outer, i)], axis=1)
    cut.between[w, i] = np.where(follows[:, None], ends, -1)
    cut.share[w, i] = share
    cut.free[w, i] = -np.where(far, length[free], length[held])
    return cut


def _leaves(offset: Array, step: Array, radius: Array) -> Array:
    """[k] the last share in [0, 1] of ways at which offset + share step [k, 3] leaves the sphere;
    NaN where it does not."""
    a, b = np.sum(step**2, axis=1), np.sum(offset * step, axis=1)
    square = b**2 - a * (np.sum(offset**2, axis=1) - radius**2)
    t = (-b + np.sqrt(np.maximum(square, 0.0))) / a
    # a sphere that ends at a point does so on one side of it or the other
    found = (square >= 0.0) & (np.abs(t - 0.5) <= 0.5 + 1e-9)
    return np.where(found, np.clip(t, 0.0, 1.0), np.nan)


def _cut_adjoint(
    cut: Cut, x: Array, centre: Array, length: Array, stiffer_bar: Array
) -> tuple[Array, Array, Array]:
    """Transpose of ``_cut``: derivatives by points [L, n, 3], centres [L, 3] and radii [L]."""
    w, i = np.nonzero(cut.between[..., 0] >= 0)
    (first, second), share = cut.between[w, i].T, cut.share[w, i, None]
    step = x[w, second] - x[w, first]
    out = x[w, first] + share * step - centre[w]
    own = 0.5 * (length[i - 1] + length[i])
    by_share = -(cut.stiffer[w, i] ** 2) / own * cut.free[w, i] * stiffer_bar[w, i]
    moved = (by_share / np.sum(out * step, axis=1))[:, None] * out
    x_bar, centre_bar, radius_bar = np.zeros_like(x), np.zeros_like(centre), np.zeros(len(x))
    np.add.at(x_bar, (w, first), -(1.0 - share) * moved)
    np.add.at(x_bar, (w, second), -share * moved)
    np.add.at(centre_bar, w, moved)
    np.add.at(radius_bar, w, np.sum(moved * out, axis=1) / np.linalg.norm(out, axis=1))
    return x_bar, centre_bar, radius_bar


def close_adjoint(
    grip: Grip, x: Array, pose: Pose, place_bar: Array
) -> tuple[Array, Array, PoseBars]:
    """Transpose of the places of what a gripper closes on.

    Args:
        grip, x, pose: As there.
        place_bar: [W, 6, n] by places and, as turns in the gripper's axes, by directions.

    Returns:
        Derivatives by x [W, n, 3], by turns of q [W, n, 3], and by the pose.
    """
    by_place = rotation.turned(pose.q[:, None], np.swapaxes(place_bar[:, :3], 1, 2))
    by_place = np.where((grip.holds & 1)[..., None] > 0, by_place, 0.0)
    q_bar = rotation.turned(pose.q[:, None], np.swapaxes(place_bar[:, 3:], 1, 2))
    q_bar = np.where((grip.holds & 2)[..., None] > 0, q_bar, 0.0)
    # places are R^T (x - c): a turn of R by d changes them by R^T ((x - c) x d)
    turned = -np.cross(x - pose.centre[:, None], by_place).sum(axis=1) - q_bar.sum(axis=1)
    none = np.zeros_like(pose.centre)
    return by_place, q_bar, PoseBars(-by_place.sum(axis=1), turned, none, none)


def border_of_rod_adjoint(
    grip: Grip, x: Array, pose: Pose, length: Array, stiffer_bar: Array
) -> tuple[Array, Array, Array]:
    """From derivatives by ``grip.stiffer`` [W, 1, n] those by x [W, n, 3], by the centre [W, 3] and
    by the radius [W]."""
    return _cut_adjoint(grip.cuts[0], x, pose.centre, length, stiffer_bar[:, 0])


def border_of_shell_adjoint(
    grip: Grip, x: Array, pose: Pose, shape: tuple[int, int], spacing: tuple[float, float],
    stiffer_bar: Array,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """As ``border_of_rod_adjoint``, of a shell's rows and columns."""
    W, n = x.shape[:2]
    at = x.reshape(W, *shape, 3)
    x_bar, centre_bar, radius_bar = np.zeros_like(x), np.zeros((W, 3)), np.zeros(W)
    for k, (axis, step) in enumerate(((1, spacing[0]), (0, spacing[1]))):
        lines = _lines(at, axis)
        many = shape[0] if axis == 1 else shape[1]
        bars = _lines(stiffer_bar[:, k].reshape(W, *shape), axis)
        by_x, by_centre, by_radius = _cut_adjoint(
            grip.cuts[k], lines, np.repeat(pose.centre, many, axis=0),
            np.full(lines.shape[1] - 1, step), bars,
        )  # fmt: skip
        x_bar += _unlines(by_x, W, shape, axis).reshape(W, n, 3)
        centre_bar += by_centre.reshape(W, many, 3).sum(axis=1)
        radius_bar += by_radius.reshape(W, many).sum(axis=1)
    return x_bar, centre_bar, radius_bar


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
