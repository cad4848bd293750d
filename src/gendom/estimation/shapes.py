"""The shape of a cloth that is not flat: how it lay crumpled and how its corner is pleated."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.optimize import minimize
from scipy.spatial import KDTree

from gendom.estimation.hold import Hold

Array = NDArray[Any]

NODES = 29
"""Nodes of the registered sheet along each side."""

TURNS = np.radians([-10.0, -5.0, 0.0, 5.0, 10.0, 15.0])
"""Turns of the flat square from which the registered sheet is looked for."""

TURN_SD = 0.2
"""Standard deviation of that turn [rad]."""

ROUNDS = 15
"""How often points and nodes are paired anew."""

BENDING, ATTRACTION, WEIGHT, CONTACT, PIN = 0.05, 0.02, 3e-4, 5.0, 2.0
"""Stiffnesses beside that of the edges, which is 1: a sheet hardly stretches, bends easily, is
drawn to the points, and lies on the table where nothing is seen."""

STRAY = 0.02
"""Distance beyond which points draw by their distance alone [m]."""

PLEAT_FADE = 0.25
"""How far from the held point a pleat reaches: whole over the first half, then fading [m]."""

PRESSED_FADE = 0.12
"""How far from the held point the pleat stands already as the cloth lies, likewise [m]."""

LARGEST_CURVATURE = 60.0
"""Limit of the registered sheet's curvature [1/m]: the tightest bend that two cells show."""

HEIGHT_HELD = 0.5
"""Where fingers hold a pleat, as a share of its height."""


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """A square cloth as it lies, registered to the first clouds."""

    nodes: NDArray[np.floating]
    """[K, K, 3] positions over the cloth's first and second axis, relative to the held point, in
    axes along and to the left of the diagonal and up [m]."""
    yaw: float
    """Direction of the diagonal [rad]."""
    inset: float
    aside: float
    """Where in the cloth the held point was taken to be [m]."""
    energy: float
    """What the sheet's strain and distance from the points amount to [-]."""


def register(
    points: NDArray[np.floating],
    grip: NDArray[np.floating],
    *,
    size: float,
    floor: float,
    table: float,
    yaw: float,
    inset: float,
    aside: float,
) -> Sheet:
    """The square sheet that comes nearest to points [n, 3], hardly stretched, from one direction.

    A grid of nodes with stiff edges and weak bending; each point draws its nearest node, each node
    that should have been seen its nearest point; all else sinks onto the table.

    Args:
        points: What was seen of the cloth at rest, all of it above ``floor`` [m].
        grip: [2] where it is held [m].
        size: Side of the square [m].
        floor: Height below which nothing is seen [m].
        table: Height of the table [m].
        yaw: Direction of the diagonal [rad].
        inset, aside: Held point inside the corner and left of the diagonal [m].
    """
    ticks = np.linspace(0.0, size, NODES)
    h = ticks[1]
    a, b = np.meshgrid(ticks, ticks, indexing="ij")
    flat = np.stack([(a + b) / math.sqrt(2), (b - a) / math.sqrt(2), 0.0 * a], axis=-1)
    flat -= [inset, aside, 0.0]
    c, s = math.cos(yaw), math.sin(yaw)
    # in the axes of the cloth the sheet need not be turned back
    local = (points - [*grip, table]) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    number = np.arange(NODES**2).reshape(NODES, NODES)
    first, second, length = _edges(number, h)
    rows = [
        np.stack([n.ravel() for n in (line[2:], line[1:-1], line[:-2])], axis=1)
        for line in (number, number.T)
    ]
    left, mid, right = np.concatenate(rows).T
    pin = int(np.argmin(np.linalg.norm(flat.reshape(-1, 3), axis=1)))
    tree = KDTree(local)

    def energy(
        v: Array, pair: Array, draw: Array, target: Array, drawn: Array
    ) -> tuple[float, Array]:
        """And its slope, at positions v of pairs of points and nodes that draw so much."""
        x = v.reshape(-1, 3) / h
        slope = np.zeros_like(x)
        d = x[first] - x[second]
        now = np.linalg.norm(d, axis=1)
        strain = now - length / h
        e = 0.5 * (strain**2).sum()
        _add(slope, first, second, (strain / now)[:, None] * d)
        bend = x[left] - 2.0 * x[mid] + x[right]
        e += 0.5 * BENDING * (bend**2).sum()
        _add(slope, left, mid, BENDING * bend)
        _add(slope, right, mid, BENDING * bend)
        r = x[pair] - local / h
        e += 0.5 * ATTRACTION * (draw[:, None] * r**2).sum()
        np.add.at(slope, pair, ATTRACTION * draw[:, None] * r)
        r = x - target / h
        e += 0.5 * ATTRACTION * (drawn[:, None] * r**2).sum()
        slope += ATTRACTION * drawn[:, None] * r
        under = np.minimum(x[:, 2], 0.0)
        e += 0.5 * CONTACT * (under**2).sum() + WEIGHT * x[:, 2].sum()
        slope[:, 2] += CONTACT * under + WEIGHT
        e += 0.5 * PIN * (x[pin, :2] ** 2).sum()
        slope[pin, :2] += PIN * x[pin, :2]
        return e, slope.ravel() / h

    x, e = flat.reshape(-1, 3), math.inf
    # a camera sees no farther than its farthest point
    low, high = local[:, :2].min(axis=0), local[:, :2].max(axis=0)
    for _ in range(ROUNDS):
        gap, pair = KDTree(x).query(local)
        away, near = tree.query(x)
        seen = (x[:, 2] > floor - table) & ((x[:, :2] > low) & (x[:, :2] < high)).all(axis=1)
        draw = 1.0 / np.sqrt(1.0 + (gap / STRAY) ** 2)
        drawn = np.where(seen, 1.0 / np.sqrt(1.0 + (away / STRAY) ** 2), 0.0)
        found = minimize(
            energy,
            x.ravel(),
            args=(pair, draw, local[near], drawn),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": 25},
        )
        x, e = found.x.reshape(-1, 3), float(found.fun)
    return Sheet(nodes=x.reshape(NODES, NODES, 3), yaw=yaw, inset=inset, aside=aside, energy=e)


def _add(slope: Array, plus: Array, minus: Array, value: Array) -> None:
    """Add values [n, 3] to some rows and take them from others."""
    np.add.at(slope, plus, value)
    np.add.at(slope, minus, -value)


def _edges(number: Array, h: float) -> tuple[Array, Array, Array]:
    """First and second nodes and lengths of the edges of a grid with diagonals."""
    pairs = [
        (number[1:], number[:-1], h),
        (number[:, 1:], number[:, :-1], h),
        (number[1:, 1:], number[:-1, :-1], h * math.sqrt(2)),
        (number[1:, :-1], number[:-1, 1:], h * math.sqrt(2)),
    ]
    first = np.concatenate([p.ravel() for p, _, _ in pairs])
    second = np.concatenate([q.ravel() for _, q, _ in pairs])
    length = np.concatenate([np.full(p.size, d) for p, _, d in pairs])
    return first, second, length


def best_sheet(
    points: NDArray[np.floating], grip: NDArray[np.floating], *, yaw: float, **given: float
) -> Sheet:
    """The least strained of the sheets registered from several directions about ``yaw``."""

    def cost(sheet: Sheet) -> float:
        return sheet.energy * (1.0 + 0.5 * ((sheet.yaw - yaw) / TURN_SD) ** 2)

    return min((register(points, grip, yaw=yaw + t, **given) for t in TURNS), key=cost)


def shaped(
    material: NDArray[np.floating], hold: Hold, sheet: Sheet | None, *, width: float, height: float
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """How a cloth lies that is not flat.

    Args:
        material: [N, 3] positions in the cloth's own frame, the held corner in its origin [m].
        hold: How it is held.
        sheet: How it lies, or None for flat.
        width, height: Sizes of the cloth [m].

    Returns:
        Positions [N, 3] relative to the held point on the table, in axes along and to the left of
        the diagonal and up [m]; natural curvature [N, 2, 2] in the cloth's own axes [1/m].
    """
    along = np.array([width, height]) / math.hypot(width, height)
    axes = np.stack([along, [-along[1], along[0]]])
    u, v = (material[:, :2] @ axes.T - [hold.inset, hold.aside]).T
    z = material[:, 2]
    K = np.tile(np.diag([hold.arch_along, hold.arch_across]), (len(u), 1, 1))
    c, s = math.cos(hold.pleat_turn), math.sin(hold.pleat_turn)
    down, out = c * u + s * v, c * v - s * u
    across = np.array([-s, c])
    P = hold.pleat_width
    bend = np.where(np.abs(out) < P, math.pi / P * np.cos(math.pi * out / P), 0.0)
    K += (hold.pleat * _fade(down, PLEAT_FADE) * bend)[:, None, None] * np.outer(across, across)
    K = axes.T @ K @ axes
    shift, rise = _pressed(out, z, hold.pleat * _fade(down, PRESSED_FADE), P)
    x = np.stack([u - s * shift, v + c * shift, rise], axis=1)
    if sheet is None or not hold.crumple:
        return x, K
    lies, normal, curves = _on_sheet(material, sheet, width, height)
    lies[:, :2] -= [hold.inset - sheet.inset, hold.aside - sheet.aside]
    x += lies + z[:, None] * normal - np.stack([u, v, z], axis=1)
    return x, K + hold.crumple * curves


def held_height(hold: Hold) -> float:
    """Height over the table at which fingers hold the pleat that they have pressed [m]."""
    crest = _pressed(np.zeros(1), np.zeros(1), np.array([hold.pleat]), hold.pleat_width)[1]
    return HEIGHT_HELD * max(float(crest[0]), 0.0)


def _fade(down: NDArray[np.floating], length: float) -> NDArray[np.floating]:
    return np.clip(2.0 - 2.0 * down / length, 0.0, 1.0)


def _pressed(out: Array, z: Array, slope: Array, P: float) -> tuple[Array, Array]:
    """How far [N] a pleat of steepest slopes [N] moves particles sideways and where up [m].

    Its section climbs at the angle slope sin(pi s / P) of the distance s from its crest.
    """
    share = np.linspace(0.0, 1.0, 60)
    s = np.clip(out, -P, P)[:, None] * share
    angle = -slope[:, None] * np.sin(math.pi * s / P)
    whole = P * share[None] + 0.0 * s
    deep = np.trapezoid(np.sin(slope[:, None] * np.sin(math.pi * share)), whole, axis=1)
    shift = np.trapezoid(np.cos(angle) - 1.0, s, axis=1) - z * np.sin(angle[:, -1])
    rise = deep + np.trapezoid(np.sin(angle), s, axis=1) + z * np.cos(angle[:, -1])
    return shift, rise


def _on_sheet(
    material: Array, sheet: Sheet, width: float, height: float
) -> tuple[Array, Array, Array]:
    """Positions [N, 3], normals [N, 3] and curvatures [N, 2, 2] of a sheet at material points."""
    a, b = (np.linspace(0.0, size, len(sheet.nodes)) for size in (width, height))
    splines = [RectBivariateSpline(a, b, sheet.nodes[..., k]) for k in range(3)]

    def at(i: int, j: int) -> Array:
        values = [f.ev(material[:, 0], material[:, 1], dx=i, dy=j) for f in splines]
        return np.stack(values, axis=-1)

    normal = np.cross(at(1, 0), at(0, 1))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    aa, ab, bb = (-(at(i, j) * normal).sum(axis=1) for i, j in ((2, 0), (1, 1), (0, 2)))
    curves = np.stack([np.stack([aa, ab], axis=-1), np.stack([ab, bb], axis=-1)], axis=-2)
    return at(0, 0), normal, np.clip(curves, -LARGEST_CURVATURE, LARGEST_CURVATURE)
