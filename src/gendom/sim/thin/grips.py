"""Points held by grippers: selected when they close, released when they open; and transposes.

A gripper holds the edges whose midpoints lie inside its sphere, with both their points; of a rod
that it touches, at least one edge. Between a held and a free edge, the free part of the rod begins
where the sphere's surface cuts the centre line. The joint between them and the next one on the free
side represent the length from there to where that of the joint after them begins, which makes them
stiffer or softer. They divide it so that its first moment is right, too: then errors do not depend
on where the sphere ends between points. Lines of a shell's lattice are cut in the same way.

Shapes: W worlds, n points.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.arrays import Array, distinct
from gendom.errors import SimulationError
from gendom.sim.paths import HostPaths, Pose
from gendom.sim.setting import Setting
from gendom.sim.thin import rotation
from gendom.sim.thin.types import Lines

STRETCH = 0.2
"""Largest mean stretch or compression of a body, and stretch of what two grippers have between
them."""

LOCAL_STRETCH = 1.0
"""Largest momentary stretch of one edge: a soft rope that cracks like a whip stretches by 25 %."""


@dataclass
class BorderCut:
    """Intersections [c] of spheres with lines of points between held and free edges."""

    line: NDArray[Any]
    """Of all worlds, one after another."""
    between: NDArray[Any]
    """[c, 2] the two points on either side of the cut."""
    share: Array
    """Position of the cut from the first (0) to the second point (1)."""
    joints: NDArray[Any]
    """[c, 2] the joint there and the one that shares its free length, or itself again."""
    slopes: Array
    """[c, 2] derivatives of these joints' factors on the stiffness by ``share``."""


@dataclass
class Grip:
    """Points and directions held by a gripper in each world."""

    holds: NDArray[np.int32]
    """[W, n] 1: a point, + 2: the direction of the edge that begins there."""
    place: Array
    """[W, 7, n] points [m], and directions of rods, in the gripper's frame."""
    stiffer: Array
    """[W, M, n] factor on the stiffness of joints at its border, along each of the body's lines."""
    cuts: list[BorderCut]

    def repeated(self, worlds: int, every: list[Lines]) -> "Grip":
        """This grip of one world in many."""

        def many(values: Array) -> Array:
            return np.broadcast_to(values, (worlds, *values.shape[1:]))

        cuts = []
        for cut, lines in zip(self.cuts, every, strict=True):
            again = BorderCut(
                *(np.tile(a, (worlds, *[1] * (a.ndim - 1))) for a in vars(cut).values())
            )
            again.line += np.repeat(np.arange(worlds) * len(lines.index), len(cut.line))
            cuts.append(again)
        return Grip(many(self.holds), many(self.place), many(self.stiffer), cuts)


# ---- closing -------------------------------------------------------------------------------------


def close(
    x: Array, q: Array | None, pose: Pose, radius: Array, holds: NDArray[np.int32],
    every: list[Lines]
) -> Grip:  # fmt: skip
    """The grip of grippers of W worlds that close now.

    Args:
        x: [W, n, 3] points [m].
        q: [W, n - 1, 4] directions of rods' edges; None: of shells, which have none.
        pose: Of the grippers.
        radius: [W] [m].
        holds: What they hold.
        every: Lines of the body.
    """
    W, n = x.shape[:2]
    place = np.zeros((W, 7, n))
    back = rotation.conjugate(pose.q)[:, None]
    place[:, :3] = np.swapaxes(rotation.turned(back, x - pose.centre[:, None]), 1, 2)
    if q is not None:
        place[:, 3:, :-1] = np.swapaxes(rotation.product(np.broadcast_to(back, q.shape), q), 1, 2)
    cuts, stiffer = [], []
    for lines in every:
        held, many = lines.of(holds), len(lines.index)
        inside = (held[:, :-1] & (held[:, 1:] if q is None else 2)) > 0
        centre, radii = np.repeat(pose.centre, many, axis=0), np.repeat(radius, many)
        found, cut = _cut(lines.of(x), centre, radii, lines, inside)
        stiffer.append(lines.points(found))
        cuts.append(cut)
    return Grip(holds, place, np.stack(stiffer, axis=1), cuts)


# ---- where a sphere cuts lines -------------------------------------------------------------------


def _cut(
    x: Array, centre: Array, radius: Array, lines: Lines, inside: NDArray[np.bool_]
) -> tuple[Array, BorderCut]:
    """Cut lines of points [L, n, 3] with spheres [L] between held edges, which are ``inside``
    [L, n - 1], and free ones; returns also the factors [L, n] on the stiffness of joints."""
    L, n = x.shape[:2]
    length, borders = lines.length, inside[:, :-1] != inside[:, 1:]
    w, i = np.nonzero(borders)
    i = i + 1
    before = inside[w, i - 1]
    held, free = np.where(before, i - 1, i), np.where(before, i, i - 1)
    outer, inner = np.where(before, i + 1, i - 1), np.where(before, i - 1, i + 1)
    # beyond the joint, as far as the free edge's middle, or else along the held edge
    beyond = _leaves(x[w, i] - centre[w], x[w, outer] - x[w, i], radius[w])
    along = _leaves(x[w, inner] - centre[w], x[w, i] - x[w, inner], radius[w])
    far = beyond <= 0.5 + 1e-9
    share = np.where(far, beyond, along)
    cuts = np.isfinite(share)
    w, i, before, held, free, outer, inner, far, share = (
        values[cuts] for values in (w, i, before, held, free, outer, inner, far, share)
    )
    edge = length[free]
    step = np.where(far, edge, length[held])
    border = np.where(far, share, share - 1.0) * step  # from the joint on
    after = np.clip(np.where(before, outer, outer - 1), 0, n - 2)
    shared = (outer > 0) & (outer < n - 1)
    taken = np.pad(borders, ((0, 0), (1, 1))).astype(int)
    np.add.at(taken, (w, outer), 1)
    shared &= taken[w, outer] == 1  # it is at no border, and beside one
    own = 0.5 * (length[i - 1] + length[i])
    beyond_outer = np.where(shared, length[after], 0.0)
    least, h = lines.least * own, 1e-30
    first, second = _divided(edge, beyond_outer, border, least)
    moved = _divided(edge, beyond_outer, border + 1j * h, least)  # complex step
    by_border = np.stack([np.imag(of) / h for of in moved], axis=1)
    stiffer, beside = np.ones((L, n)), 0.5 * (edge + beyond_outer)
    stiffer[w, i] = own / first
    stiffer[w[shared], outer[shared]] = (beside / np.where(shared, second, 1.0))[shared]
    slopes = -by_border * step[:, None] * np.stack(
        [stiffer[w, i] ** 2 / own, np.where(shared, stiffer[w, outer] ** 2 / beside, 0.0)], axis=1
    )  # fmt: skip
    ends = np.stack([np.where(far, i, inner), np.where(far, outer, i)], axis=1)
    joints = np.stack([i, np.where(shared, outer, i)], axis=1)
    return stiffer, BorderCut(w, ends, share, joints, slopes)


def _divided(edge: Array, beyond: Array, border: Array, least: Array) -> tuple[Array, Array]:
    """Divide the free length at borders [k] between the joint there and the next one.

    With x the distance from the joint, the border at x = b, the free edge's length l and the end of
    the length of the next joint at x = e, both represent e - b, of which the next one represents
    (e^2 - b^2) / (2 l): its moment about the joint is that of the rod.

    Args:
        edge: l [k] [m].
        beyond: [k] length of the edge beyond the next joint, 0 where that does not share [m].
        border: b [k], which may be complex [m].
        least: [k] least length that the joint represents [m].

    Returns:
        Lengths of the joint and of the next one (0 where it does not share) [k] [m].
    """
    shared = beyond > 0.0
    end = np.where(shared, edge + 0.5 * beyond, 0.5 * edge)
    second = np.where(shared, 0.5 * (end**2 - border**2) / edge, 0.0)
    first = end - border - second
    first = np.where(np.real(first) > least, first, least)
    return first, np.where(shared, end - border - first, 0.0)


def _leaves(offset: Array, step: Array, radius: Array) -> Array:
    """Largest share [k] in [0, 1] at which offset + share step [k, 3] leaves the sphere; NaN where
    it does not."""
    a, b = np.sum(step**2, axis=1), np.sum(offset * step, axis=1)
    square = b**2 - a * (np.sum(offset**2, axis=1) - radius**2)
    t = (-b + np.sqrt(np.maximum(square, 0.0))) / a
    # a sphere that ends exactly at a point is assigned to one of its two sides
    found = (square >= 0.0) & (np.abs(t - 0.5) <= 0.5 + 1e-9)
    return np.where(found, np.clip(t, 0.0, 1.0), np.nan)


def border_adjoint(
    grip: Grip, every: list[Lines], x: Array, pose: Pose, stiffer_bar: Array
) -> tuple[Array, Array, Array]:
    """Derivatives by x [W, n, 3], by the centre [W, 3] and by the radius [W], given those by
    ``grip.stiffer`` [W, M, n]."""
    x_bar, centre_bar, radius_bar = np.zeros_like(x), np.zeros((len(x), 3)), np.zeros(len(x))
    for k, (lines, cut) in enumerate(zip(every, grip.cuts, strict=True)):
        at, bar, world = lines.of(x), lines.of(stiffer_bar[:, k]), cut.line // len(lines.index)
        line, (first, second), share = cut.line, cut.between.T, cut.share[:, None]
        step = at[line, second] - at[line, first]
        out = at[line, first] + share * step - pose.centre[world]
        by_share = np.sum(cut.slopes * bar[line[:, None], cut.joints], axis=1)
        moved = (by_share / np.sum(out * step, axis=1))[:, None] * out
        by_points = np.zeros_like(at)
        np.add.at(by_points, (line, first), -(1.0 - share) * moved)
        np.add.at(by_points, (line, second), -share * moved)
        x_bar += lines.points(by_points)
        np.add.at(centre_bar, world, moved)
        out_of = np.sum(moved * out, axis=1) / np.linalg.norm(out, axis=1)
        np.add.at(radius_bar, world, out_of)
    return x_bar, centre_bar, radius_bar


def close_adjoint(grip: Grip, x: Array, pose: Pose, place_bar: Array) -> tuple[Array, Array, Pose]:
    """Transpose of the computation of ``Grip.place`` when a gripper closes.

    Args:
        grip, x, pose: As in ``close``.
        place_bar: [W, 6, n] derivatives by places, and by directions as rotations in the gripper's
            axes.

    Returns:
        Derivatives by x [W, n, 3], by rotations of q [W, n, 3], and by the pose.
    """
    by_place = rotation.turned(pose.q[:, None], np.swapaxes(place_bar[:, :3], 1, 2))
    by_place = np.where((grip.holds & 1)[..., None] > 0, by_place, 0.0)
    q_bar = rotation.turned(pose.q[:, None], np.swapaxes(place_bar[:, 3:], 1, 2))
    q_bar = np.where((grip.holds & 2)[..., None] > 0, q_bar, 0.0)
    # places are R^T (x - c): a rotation of R by d changes them by R^T ((x - c) x d)
    turned = -np.cross(x - pose.centre[:, None], by_place).sum(axis=1) - q_bar.sum(axis=1)
    none = np.zeros_like(pose.centre)
    return by_place, q_bar, Pose(-by_place.sum(axis=1), turned, none, none)


def released(x: Array, pose: Pose, holds: NDArray[np.integer]) -> tuple[Array, Array]:
    """Velocities [m/s] and spins [rad/s] of held points, [W, n, 3] each; 0 for others.

    Args:
        x: [W, n, 3] points [m].
        pose: Of the gripper.
        holds: [W, n] see ``Grip.holds``.
    """
    v = pose.velocity[:, None] + np.cross(pose.spin[:, None], x - pose.centre[:, None])
    v = np.where((holds & 1)[..., None] > 0, v, 0.0)
    spin = np.where((holds & 2)[..., None] > 0, pose.spin[:, None], 0.0)
    return v, spin


def released_adjoint(
    x: Array, pose: Pose, holds: NDArray[np.integer], v_bar: Array, spin_bar: Array
) -> tuple[Array, Pose]:
    """Transpose of ``released``: derivatives by x [W, n, 3] and by the pose."""
    v_bar = np.where((holds & 1)[..., None] > 0, v_bar, 0.0)
    spin_bar = np.where((holds & 2)[..., None] > 0, spin_bar, 0.0)
    x_bar = np.cross(v_bar, pose.spin[:, None])
    turned = np.cross(x - pose.centre[:, None], v_bar).sum(axis=1) + spin_bar.sum(axis=1)
    none = np.zeros_like(pose.centre)
    return x_bar, Pose(-x_bar.sum(axis=1), none, v_bar.sum(axis=1), turned)


class Ties:
    """How far apart pairs of the G grippers of W worlds may have what they hold, which their paths
    alone tell.

    Args:
        rest: [n, .] places of the body's points at rest [m].
        shape: (W, G).
        setting: For errors.
    """

    def __init__(self, rest: Array, shape: tuple[int, int], setting: Setting):
        self._rest, self._pairs = rest, list(combinations(range(shape[1]), 2))
        self._setting = setting
        self._ends = np.array(self._pairs).T
        self._place = np.zeros((shape[0], len(self._pairs), 2, 3))
        """The two points that have least of the body between them, in their grippers' frames."""
        self._most = np.full(self._place.shape[:2], np.inf)
        """[W, pairs] how far apart they may be [m]."""
        self._centres = self._most.copy()
        """[W, pairs] up to where their grippers' centres hold them closer however they turn [m]."""

    def hold(self, worlds: NDArray[np.int64], holds: Array, place: Array) -> None:
        """Let worlds [k] hold ``holds`` [k, G, n], with places [k, G, 3, n]."""
        for p, pair in enumerate(self._pairs):
            # the few ways of holding
            ways, which = distinct(holds[:, pair].reshape(len(worlds), -1))
            for way in range(len(ways)):
                some = np.flatnonzero(which == way)
                i, j = map(np.flatnonzero, holds[some[0], pair] & 1)
                far = np.linalg.norm(self._rest[i][:, None] - self._rest[j], axis=2)
                self._most[worlds[some], p] = (1.0 + STRETCH) * far.min(initial=np.inf)
                if far.size:
                    a, b = np.unravel_index(far.argmin(), far.shape)
                    for end, n in enumerate((i[a], j[b])):
                        self._place[worlds[some], p, end] = place[some, pair[end], :, n]
        self._centres[worlds] = self._most[worlds]
        self._centres[worlds] -= np.linalg.norm(self._place[worlds], axis=-1).sum(axis=-1)

    def are_safe(self, paths: HostPaths, group: slice) -> bool:
        """Whether the centres of grippers of a group of worlds stay close enough, as a glance at
        their knots tells where these have the same times, or one of a pair stays where it is."""
        time, x = paths.arrays["time"][group], paths.arrays["position"][group]
        first, second = self._ends
        way, still = x[:, second] - x[:, first], (x == x[:, :, :1]).all(axis=(2, 3))
        far2, most = np.einsum("wpkc,wpkc->wpk", way, way).max(axis=2), self._centres[group]
        alike = (time[:, first] == time[:, second]).all(axis=2) | still[:, first] | still[:, second]
        return bool((alike & (far2 < most * np.abs(most))).all())

    def broken(
        self, paths: HostPaths, worlds: NDArray[np.int64], begin: Array, end: Array
    ) -> dict[int, SimulationError]:
        """Errors of worlds [k] in which a pair comes too far apart from ``begin`` to ``end`` [k]
        [s], at the time at which it first does."""
        found: dict[int, SimulationError] = {}
        if not len(worlds):
            return found
        knots = paths.arrays["time"][worlds].reshape(len(worlds), -1)
        begin, end = begin[:, None], end[:, None]
        t = np.sort(np.clip(np.hstack([begin, end, knots]), begin, end), axis=1)
        t = t[:, np.append(True, (np.diff(t, axis=1) > 0.0).any(axis=0))]
        if paths.arrays["turn"].any():  # else they are farthest apart at a knot
            share = np.linspace(0.0, 1.0, 9)
            t = (t[:, :-1, None] + np.diff(t, axis=1)[..., None] * share).reshape(len(worlds), -1)
        each = np.repeat(worlds, t.shape[1])
        poses = [paths.pose(g, each, t.ravel()) for g in range(paths.arrays["time"].shape[1])]
        for p, pair in enumerate(self._pairs):
            x, y = (
                poses[g].centre + rotation.turned(poses[g].q, self._place[each, p, n])
                for n, g in enumerate(pair)
            )
            far, most = np.linalg.norm(y - x, axis=1).reshape(t.shape), self._most[worlds, p]
            beyond = far > most[:, None]
            for k in np.flatnonzero(beyond.any(axis=1)).tolist():
                s = int(beyond[k].argmax())
                part = slice(max(s - 1, 0), s + 1)
                time, w = float(np.interp(most[k], far[k, part], t[k, part])), int(worlds[k])
                if w not in found or time < float(found[w].time or 0.0):
                    found[w] = self._setting.error(
                        w, time,
                        f"grippers {pair[0]} and {pair[1]} pull the body apart: what they hold "
                        f"would be more than {most[k]:.4g} m apart, {100 * STRETCH:.0f} % more "
                        "than the body between it is long", where="grippers",
                        fix="paths that stay closer together, or a gripper that opens before",
                    )  # fmt: skip
        return found
