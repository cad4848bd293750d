"""Where a recorded object lies before it is moved, and where it is held."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline, CubicSpline
from scipy.linalg import solveh_banded
from scipy.optimize import minimize_scalar
from scipy.sparse.csgraph import shortest_path
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from gendom.arguments import require
from gendom.arrays import Array
from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.materials import KINDS
from gendom.sim import Body, cloth, rope
from gendom.sim.lines import along_line, arc_length

SHELL_POINTS = 33
"""Along the longer side of a cloth. Cloths that bend over 0.09 and 0.16 of a side then move like
ones of 81 points if E is 0.87 and 1.01 times theirs."""

LINE_PLACES = 200
"""Along the line of a rope at rest."""

THICK, THIN = 50.0, 200.0
"""Length over the diameter that is assumed of a rope in motion; and at rest, where points of the
centre line alone are compared. Thicker rods that bend alike stretch more, thinner take longer."""

SMOOTHING = 1e3, 1e1, 1.0, 1e-1, 1e-2, 1e-3
"""Weights of its roughness."""

MEASURED_LINE = 0.93, 1.04
"""Length of the line through points of a rope between two grippers, over that of the rope: chords
are shorter than arcs, noise makes them longer. Of six real cables and a wire 0.997 to 1.003."""

MARKER, STRAIN, TURN = 0.001, 1e-3, 0.1
"""How well such points are met by the simulated rope [m], how well its edges keep their length, and
the turn from one edge to the next that counts as much [rad]."""

CELLS = 1.5
"""Of the MPM across a rope's diameter; a cloth's longer side then has 14."""

BINS = 16
"""Along an edge of a cloth."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Placed:
    """Where an object is in the beginning."""

    body: Body
    initial: Array
    """[N, 3] points of a rod or shell, or particles [m]."""
    velocities: Array | None = None
    """[N, 3] likewise [m/s]; None: at rest."""
    places: Array | None = None
    """[m] of markers along a rope, in its edges, as they are recorded."""
    shown_length: float | None = None
    """Of the line that a rope between two hands follows in the first frame [m]."""
    held: Array
    """[G, 3] points of the object that the grippers hold [m]."""
    inwards: Array
    """[G, 3] unit vectors from those along the object: a rope's direction, a cloth's diagonal."""
    lies: Array | None = None
    """How an object lies on its table: [K, 3] a rope's centre line [m], or a cloth's turn [rad]."""


def place(
    recording: Recording,
    points: int | None,
    notes: list[str],
    lies: Array | None = None,
    cells: float | None = None,
) -> Placed:
    """Where the recorded object lies in the beginning, with so many points along it, and where it
    is held; ``notes`` get what was assumed. ``lies`` is `Placed.lies` where that is known,
    ``cells`` are those of the MPM across a rope's diameter, None: rods and shells.

    Raises:
        RecordingError: The recording shows too little to place the object, or no rope or cloth.
        ParameterError: The engine cannot simulate it.
    """
    kind = recording.object.kind
    what, where = f"objects of kind {kind!r} cannot be simulated", "meta.object.kind"
    require(kind in KINDS, what, where=where, fix="use rope or cloth", error=RecordingError)
    if kind == "cloth":
        return _place_cloth(recording, points, notes, lies, cells)
    length, diameter = recording.object.length, recording.object.diameter
    assert length is not None  # the recording's own check
    if diameter is None:
        share = THIN if recording.extra.get("static", False) else THICK
        diameter = length / share
        notes.append(f"diameter not stated: {diameter:.4g} m assumed (length / {share:g})")
    what = f"a rope {diameter:g} m thick and {length:g} m long is no rope"
    where, fix = "meta.object", "give both in metres"
    require(diameter <= 0.2 * length, what, where=where, fix=fix, error=RecordingError)
    if recording.num_grippers == 1:
        line = _line_from(recording, length, diameter) if lies is None else lies
        return _place_rope(recording, points, line, cells, length=length, diameter=diameter)
    # bodies of the MPM are free of stress as they begin
    what = "a rope held at both ends is simulated as a rod"
    require(cells is None, what, where="engine", fix="engine 'thin'")
    notes.append("held at both ends: straight by nature, as far as is known")
    return _place_between(recording, points, length, diameter)


def _place_rope(
    recording: Recording, points: int | None, line: Array, cells: float | None, **sizes: float
) -> Placed:
    """A rope of these sizes along a line [K, 3] on its table, held near one end."""
    inset = recording.object.grasp_inset or sizes["diameter"] / 2.0
    body = rope(**sizes, cells_across=cells or CELLS, centre_line=line, points=points)
    steps, s = np.diff(body.points, axis=0), arc_length(body.points)
    held = np.array([np.interp(inset, s, x) for x in body.points.T])
    direction = steps[min(int(np.searchsorted(s, inset)), len(steps) - 1)]
    return Placed(
        body=body,
        initial=np.asarray(body.points if cells is None else body.x, dtype=float),
        held=held[None],
        inwards=direction[None] / np.linalg.norm(direction),
        lies=line,
    )


def _place_between(
    recording: Recording, points: int | None, length: float, diameter: float
) -> Placed:
    """A rope that two grippers hold by its ends, straight by nature."""
    grip = grip_of(recording)
    s, line, speeds, backwards = _line_between(recording, grip, length, diameter)
    shown, s = float(s[-1]), s * (length / s[-1])
    body = rope(diameter=diameter, length=length, points=points)
    u = np.linspace(0.0, length, len(body.points))
    ordered = recording.extra.get("ordered_markers", False)
    near = MARKER if ordered else max(MARKER, 0.5 * diameter)
    x = rod_near(length, line, s / u[1], len(u), near)
    ends = np.stack([x[1] - x[0], x[-2] - x[-1]])
    return Placed(
        body=body,
        initial=x,
        velocities=None if speeds is None else CubicSpline(s, speeds)(u),
        places=(s[::-1] if backwards else s) / u[1] if ordered else None,
        shown_length=shown,
        held=grip,
        inwards=ends / np.linalg.norm(ends, axis=1, keepdims=True),
    )


def lost_time(recording: Recording) -> Array:
    """[T] time that is missing in the recorded times by each frame [s].

    A recorder that numbers frames and loses some states times that are too short: where measured
    hands leap, with like steps before and after, that took as many intervals as it has such steps.
    """
    time, late = recording.time, np.zeros(recording.num_frames)
    if recording.gripper_source != "measured" or recording.quasi_static or len(time) < 8:
        return late
    between = np.diff(time)
    steps = np.diff(recording.gripper_position.reshape(len(time), -1), axis=0)
    if np.ptp(between) > 1e-3 * between.mean():
        return late  # these are times of a clock
    before, leap, after = steps[:-2], steps[1:-1], steps[2:]
    usual = 0.5 * (before + after)
    size = np.linalg.norm(usual, axis=1)
    count = np.round((leap * usual).sum(axis=1) / np.maximum(size, 1e-9) ** 2)
    off = np.linalg.norm(leap - usual, axis=1)
    leaps = (count >= 2) & (off > 6.0 * np.percentile(off, 90))
    leaps &= np.linalg.norm(after - before, axis=1) < 1.5 * size
    leaps &= np.linalg.norm(leap - count[:, None] * usual, axis=1) < 0.5 * off
    late[2:-1] = np.cumsum(np.where(leaps, count - 1.0, 0.0) * between[1:-1])
    late[-1] = late[-2]
    return late


def rod_near(length: float, shown: Array, places: Array, n: int, near: float = MARKER) -> Array:
    """Points of a rod [n, 3] with edges of one length, which pass near points [K, 3], about so near
    [m], at these places along it [K] [edges].

    Splines between markers have edges that are up to a quarter too long or too short: a shock as
    the motion begins. Gauss-Newton steps for edges, points, and a smooth line, in this order.
    """
    edge, order = length / (n - 1), np.argsort(places)
    x = CubicSpline(places[order], shown[order])(np.arange(n))
    own = np.clip(places.astype(int), 0, n - 2)
    at = np.zeros((len(places), n))
    at[np.arange(len(places)), own] = 1.0 - (places - own)
    at[np.arange(len(places)), own + 1] = places - own
    bend = np.diff(np.eye(n), 2, axis=0)
    linear = np.concatenate([at / near, bend / (TURN * edge)])
    wanted = linear.T @ np.concatenate([shown / near, np.zeros((n - 2, 3))])
    square, e = np.kron(linear.T @ linear, np.eye(3)), np.arange(n - 1)
    band = np.zeros((9, 3 * n))
    for _ in range(6):
        step = np.diff(x, axis=0)
        size = np.linalg.norm(step, axis=1)
        rows = np.zeros((n - 1, n, 3))
        rows[e, e + 1], rows[e, e] = step / size[:, None], -step / size[:, None]
        J = rows.reshape(n - 1, -1) / (STRAIN * edge)
        pull = (wanted - linear.T @ (linear @ x)).ravel() + J.T @ (edge - size) / (STRAIN * edge)
        A = J.T @ J + square  # a point meets its neighbours and theirs
        for k in range(9):
            band[k, : 3 * n - k] = np.diagonal(A, -k)
        x = x + solveh_banded(band, pull, lower=True).reshape(n, 3)
    return x


def _line_between(
    recording: Recording, grip: Array, length: float, diameter: float
) -> tuple[Array, Array, Array | None, bool]:
    """Places along a rope [K] [m] from one end to the other, where the first frame shows them
    [K, 3] [m], how fast markers are there [K, 3] [m/s], and whether they are recorded backwards."""
    frames = with_points(recording)
    cloud, speeds = recording.frame(frames[0]).astype(float), None
    if recording.extra.get("ordered_markers", False):
        first = [t for t in frames[:5] if len(recording.frame(t)) == len(cloud)]
        x = np.stack([recording.frame(t) for t in first]).astype(float)
        if len(first) == 5 and not recording.extra.get("static", False):
            # the speed in the first frame, by a parabola through five
            t = (recording.time + lost_time(recording))[first]
            t -= t[0]
            fit = np.polynomial.polynomial.polyfit(t, x.reshape(len(t), -1), 2)
            speeds = fit[1].reshape(-1, 3)
        gaps = np.linalg.norm(np.diff(x, axis=1), axis=2).mean(axis=0)
    else:
        line = grip[0] + lying_line(cloud - grip[0], length / diameter)[::8]
        cloud = np.concatenate([grip[:1], line[1:-1], grip[1:]])
        gaps = np.diff(arc_length(cloud))
    backwards = bool(np.linalg.norm(cloud[0] - grip[0]) > np.linalg.norm(cloud[-1] - grip[0]))
    if backwards:
        cloud, gaps = cloud[::-1], gaps[::-1]
        speeds = None if speeds is None else speeds[::-1]
    s = np.concatenate([[0.0], np.cumsum(gaps)])
    what = f"in the first frame points lie along a line of {s[-1]:.3g} m from one gripper to the"
    what += f" other, the object is stated to be {length:.3g} m long"
    where, fix = "meta.object.length", "give the length between the grippers, and points in metres"
    near = MEASURED_LINE[0] * length <= s[-1] <= MEASURED_LINE[1] * length
    require(near, what, where=where, fix=fix, error=RecordingError)
    for _ in range(3):  # chords of a bend are shorter than what is between the markers
        fine = np.linspace(s[:-1], s[1:], 17, axis=1)
        steps = np.diff(CubicSpline(s, cloud)(fine), axis=1)
        s = np.append(0.0, np.cumsum(np.linalg.norm(steps, axis=2).sum(axis=1)))
    return s, cloud, speeds, backwards


def _line_from(recording: Recording, length: float, diameter: float) -> Array:
    """Centre line of a rope at rest, from somewhat behind the gripper on."""
    early, grip = early_points(recording, diameter), grip_of(recording)[0]
    behind, flat = recording.object.grasp_inset or diameter / 2.0, early[:, :2] - grip[:2]
    what = "the first frames show too little of the rope to tell which way it lies"
    frames = with_points(recording)[:10]
    where = f"frames {frames[0]}-{frames[-1]}"
    fix = "record from the rope at rest on; is its length in metres?"
    # points farther from the gripper tell which way it lies
    far = int((np.linalg.norm(flat, axis=1) > 0.25 * length).sum())
    require(far >= 5, what, where=where, fix=fix, error=RecordingError)
    line = lying_line(flat, length / diameter)
    s = arc_length(line)
    # where the gripper is along it: before its first point, which fingers may hide, straight on
    steps, gaps = np.diff(line, axis=0), np.diff(s)
    share = np.clip(-np.sum(line[:-1] * steps, axis=1) / gaps**2, 0.0, 1.0)
    k = int(np.linalg.norm(line[:-1] + share[:, None] * steps, axis=1).argmin())
    begin = float(s[k] + share[k] * gaps[k]) or min(0.0, float(-line[0] @ steps[0] / gaps[0]))
    s = np.linspace(begin - behind, begin + length, 4 * LINE_PLACES)
    height = float(np.median(early[:, 2])) - diameter / 2.0
    if recording.table_height is not None:
        height = recording.table_height + diameter / 2.0
    xy = grip[:2] + along_line(line, s)[0]
    return np.concatenate([xy, np.full((len(s), 1), height)], axis=1)


def lying_line(points: Array, slenderness: float) -> Array:
    """[K, d] the smooth line that points [n, d] of a rope lie along, from its end near the gripper,
    the origin, on [m]; its length over its diameter is its slenderness.

    Points are ordered by shortest paths from the far end; steps cost their fourth power, so that
    paths follow the cloud. A principal curve (Hastie and Stuetzle 1989) goes through them, a
    penalised spline of its arc length, as smooth as the information criterion of Schwarz (1978)
    wants it, and no less than Akaike's: with that, one cloud of a straight rope winds by several
    radians. Thick ropes have few independent points: cameras that are off show their sides apart.
    """
    apart = KDTree(points).query(points, k=min(5, len(points)))[0][:, -1]
    points = points[apart <= 4.0 * np.median(apart)]  # without lonely ones
    some = points[:: math.ceil(len(points) / 400)]
    steps = cdist(some, some)
    first = int(np.linalg.norm(some, axis=1).argmin())
    last = int(np.argmax(shortest_path(steps**4, indices=first)))
    cost, before = shortest_path(steps**4, indices=last, return_predecessors=True)
    along = np.zeros(len(some))
    for k in np.argsort(cost)[1:]:
        along[k] = along[before[k]] + steps[k, before[k]]
    share = 1.0 - along[KDTree(some).query(points)[1]] / along.max()
    # four points share their noise; no more than eight to a diameter are independent
    count = min(len(points) / 4.0, 8.0 * slenderness)
    found = [_principal_curve(points, share, SMOOTHING[0], order=2)]
    found += [_principal_curve(points, share, stiff) for stiff in SMOOTHING]
    each = max(2.0, math.log(count))
    return min(found, key=lambda f: 2.0 * count * math.log(f[1]) + each * f[2])[0]


def _principal_curve(
    points: Array, share: Array, stiff: float, order: int = 3
) -> tuple[Array, float, float]:
    """[K, d] a penalised spline through points [n, d], from their shares of its length [n] on; how
    far from it they lie in the mean [m], and its degrees of freedom. The stiffest is a parabola, of
    order 2 a straight line."""
    pieces = 20
    knots = np.clip(np.arange(-3, pieces + 4) / pieces, -3.0 / pieces, 1.0 + 3.0 / pieces)
    even, kept = np.linspace(0.0, 1.0, LINE_PLACES), np.ones(len(points), dtype=bool)
    rough = np.diff(np.eye(pieces + 3), order, axis=0)
    line, off, free = points, share, 0.0
    for _ in range(6):
        basis = BSpline.design_matrix(share[kept], knots, 3).toarray()
        inner = basis.T @ basis
        smooth = inner + stiff * len(basis) * rough.T @ rough
        free = float(np.trace(np.linalg.solve(smooth, inner)))
        shape = np.linalg.solve(smooth, basis.T @ points[kept])
        line = BSpline(knots, shape, 3)(even)
        off, k = KDTree(line).query(points)
        kept = off < 2.0 * math.sqrt(float((off**2).mean())) + 1e-6
        s = arc_length(line)[k]
        begin = s[kept].min()
        share = np.clip((s - begin) / (s[kept].max() - begin), 0.0, 1.0)
    return line, float(off.mean()), free


def _turn(yaw: float) -> Array:
    """[2, 2]."""
    return np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])


def _place_cloth(
    recording: Recording,
    points: int | None,
    notes: list[str],
    lies: Array | None,
    cells: float | None,
) -> Placed:
    """A flat cloth on its table."""
    described, thickness = recording.object, recording.object.thickness
    assert described.width is not None and described.height is not None  # its own check
    sides = np.array([described.width, described.height])
    if thickness is None:
        # of two sheets of equal bending stiffness the thicker is softer in its plane, as if woven
        thickness = 0.002
        notes.append(f"thickness not stated: {thickness * 1e3:.3g} mm assumed")
    grip, longer = grip_of(recording)[0], float(sides.max())
    diagonal, held = sides / math.hypot(*sides), sides / 2.0
    if described.grasp == "corner":
        held = (described.grasp_inset or 0.0) * diagonal
    yaw = _cloth_yaw(recording, sides, -held) if lies is None else float(lies)
    low = recording.table_height
    if low is None:
        low = float(np.percentile(early_points(recording, 0.05 * longer)[:, 2], 5))
    mid = low + thickness / 2.0
    turn, spacing = _turn(yaw), longer / ((points or SHELL_POINTS) - 1)
    body = cloth(
        width=described.width,
        height=described.height,
        thickness=thickness,
        dx=longer / 14.0 * (CELLS / (cells or CELLS)),
        corner=np.append(grip[:2] - turn @ held, mid),
        yaw=yaw,
        points=(1 + max(2, round(sides[0] / spacing)), 1 + max(2, round(sides[1] / spacing))),
    )
    return Placed(
        body=body,
        initial=np.asarray(body.points if cells is None else body.x, dtype=float),
        held=np.array([[grip[0], grip[1], mid]]),
        inwards=np.append(turn @ diagonal, 0.0)[None],
        lies=np.array(yaw),
    )


def _cloth_yaw(recording: Recording, sides: Array, first: Array) -> float:
    """Turn of a flat cloth with sides [2] and its first corner at [2] from the held point, about
    that point: of its outline, or, of one that lies in folds and hangs by a corner, evenly about
    its diagonal, of that, which points to where the lifted cloud is."""
    grip, longer, frames = grip_of(recording)[0], float(sides.max()), with_points(recording)
    lying = early_points(recording, 0.01 * longer)[:, :2] - grip[:2]
    yaw, off = _outline_yaw(lying, first, sides)
    # cloths of the second reality have 0.012, real ones that lie in folds 0.11 and more
    if off < 0.03 * longer or recording.object.grasp != "corner":
        return _along_edges(lying, yaw)
    later = frames[len(frames) // 2 :]
    towards = [recording.frame(t)[:, :2].mean(axis=0) - grip[:2] for t in later]
    x, y = np.median(np.array(towards, dtype=float), axis=0)
    return math.atan2(y, x) - math.atan2(sides[1], sides[0])


def _outline_yaw(points: Array, first: Array, sides: Array) -> tuple[float, float]:
    """The turn with which a rectangle, its first corner at [2], fits points [n, 2] best, both seen
    from the point that it turns about; and the mean distance from points to it and back [m]."""
    points = np.random.default_rng(0).permutation(points)[:2000]  # clouds may be lattices
    grid = (np.indices((12, 12)).reshape(2, -1).T + 0.5) / 12.0
    tree, inside = KDTree(points), first + grid * sides

    def off(yaw: float) -> float:
        turn = _turn(yaw)
        beyond = np.abs(points @ turn - first - sides / 2.0) - sides / 2.0
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1).mean()
        return float(outside + tree.query(inside @ turn.T)[0].mean())

    coarse = min(np.radians(np.arange(-180.0, 180.0, 2.5)), key=off)
    found = minimize_scalar(off, bounds=(coarse - 0.05, coarse + 0.05), method="bounded")
    return float(found.x), float(found.fun)


def _along_edges(points: Array, yaw: float) -> float:
    """The turn of a rectangle by the slopes of its four edges, as points [n, 2] that fill it show
    them, from a turn that is nearly right."""
    for _ in range(3):
        local = points @ _turn(yaw)
        slopes = []
        for axis in (0, 1):
            along, across = local[:, axis], local[:, 1 - axis]
            low, high = np.quantile(along, [0.1, 0.9]).tolist()  # corners are round
            ends = np.linspace(low, high, BINS + 1)
            bins = [across[(along >= a) & (along < b)] for a, b in pairwise(ends)]
            kept = [k for k, one in enumerate(bins) if len(one) > 10]
            if len(kept) < BINS / 2:
                return yaw
            middle = 0.5 * (ends[:-1] + ends[1:])[kept]
            for share in (0.01, 0.99):
                edge = [np.quantile(bins[k], share) for k in kept]
                slopes.append((1 - 2 * axis) * np.polyfit(middle, edge, 1)[0])
        yaw += math.atan(float(np.median(slopes)))
    return yaw


def lying_rectangle(points: Array) -> tuple[float, float] | None:
    """Longer and shorter side [m] of the smallest rectangle with nearly all points [n, 2] inside,
    None: they do not fill it."""

    def box(angle: float) -> tuple[Array, Array, Array]:
        local = points @ _turn(angle)
        low, high = np.quantile(local, [0.003, 0.997], axis=0)
        return local, low, high - low

    every = (box(angle) for angle in np.radians(np.arange(0.0, 90.0, 0.5)))
    local, low, sides = min(every, key=lambda one: float(one[2].prod()))
    cells = np.floor((local - low) / np.maximum(sides, 1e-9) * BINS).astype(int)
    inside = cells[((cells >= 0) & (cells < BINS)).all(axis=1)]
    if len(np.unique(inside, axis=0)) < 0.95 * BINS**2:
        return None
    return float(sides.max()), float(sides.min())


def with_points(recording: Recording) -> tuple[int, ...]:
    """Frames that hold points."""
    return tuple(np.flatnonzero(recording.frame_valid).tolist())


def grip_of(recording: Recording) -> Array:
    """[G, 3] of the grippers in the first frame with points [m]."""
    return recording.gripper_position[int(np.argmax(recording.frame_valid))].astype(float)


def early_points(recording: Recording, size: float) -> Array:
    """[n, 3] points of the frames before the gripper has moved by ``size`` [m]."""
    path, frames = recording.gripper_position[:, 0], with_points(recording)
    moved = np.linalg.norm(path - path[frames[0]], axis=1)
    early = [t for t in frames if moved[t] <= size] or frames[:1]
    return np.concatenate([recording.frame(t) for t in early]).astype(float)
