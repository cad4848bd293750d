"""Distances of segments from segments and from boxes, in closed form and vectorised."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_PARALLEL = 1e-12  # sin^2 of the angle below which two segments count as parallel
_POINT = 1e-24  # [m^2]; squared length below which a segment is a point


def segments_apart(a0: Array, a1: Array, b0: Array, b1: Array) -> Array:
    """[...] distance of the segments a0 a1 and b0 b1 [..., 3] [m].

    The nearest points of both lines, clamped to one segment, then to the other, then again to
    the first (Ericson, "Real-Time Collision Detection", 2005, section 5.1.9). Segments may be
    points.
    """
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    uw, vw = _dot(u, w), _dot(v, w)
    skew = uu * vv - uv * uv
    askew = skew > _PARALLEL * uu * vv
    s = np.where(askew, np.clip(_over(uv * vw - vv * uw, skew, askew), 0.0, 1.0), 0.0)
    t = np.clip(_over(uv * s + vw, vv, vv > _POINT), 0.0, 1.0)
    s = np.clip(_over(uv * t - uw, uu, uu > _POINT), 0.0, 1.0)
    return np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)


def segment_to_box(a: Array, b: Array, half: Array) -> Array:
    """[...] signed distance of segments from a box around the origin, along its axes [m].

    Negative inside: the segment's deepest point lies this far below the box's nearest face. A
    box's signed distance is convex, so the least along a segment is the least of its pieces'
    minima: outside the squared distance is a parabola between the planes of the faces, inside
    the distance is linear between the planes that part the faces' regions.

    Args:
        a, b: [..., 3] the segments' ends in the box's frame [m].
        half: [3] half of the box's edges [m].
    """
    way = b - a
    moving = np.abs(way) > 1e-15
    faces = np.concatenate(
        [_over(side * half - a, way, moving) for side in (-1.0, 0.0, 1.0)], axis=-1
    )
    parting = []
    for i, j in ((0, 1), (0, 2), (1, 2)):
        for sign in (-1.0, 1.0):
            for side in (-1.0, 1.0):
                # |x_i| - half_i = |x_j| - half_j for one pair of signs
                rate = way[..., i] - sign * way[..., j]
                start = a[..., i] - sign * a[..., j]
                parting.append(_over(side * (half[i] - half[j]) - start, rate, rate != 0.0))
    ends = np.broadcast_to([0.0, 1.0], (*way.shape[:-1], 2))
    edges = np.sort(np.clip(np.concatenate([faces, ends], axis=-1), 0.0, 1.0), axis=-1)
    middle = 0.5 * (edges[..., 1:] + edges[..., :-1])
    # Between two edges each coordinate is beyond a face, or within: x - clip(x) is linear.
    x = a[..., None, :] + middle[..., None] * way[..., None, :]
    beyond = np.where(np.abs(x) > half, way[..., None, :], 0.0)
    off = np.where(np.abs(x) > half, x - np.sign(x) * half, 0.0)
    slope, bend = _dot(off, beyond), _dot(beyond, beyond)
    lowest = np.clip(middle - _over(slope, bend, bend > 0.0), edges[..., :-1], edges[..., 1:])
    t = np.concatenate([edges, lowest, np.clip(np.stack(parting, axis=-1), 0.0, 1.0)], axis=-1)
    return _box(a[..., None, :] + t[..., None] * way[..., None, :], half).min(axis=-1)


def _box(x: Array, half: Array) -> Array:
    """[...] signed distance of points [..., 3] from a box [m]."""
    q = np.abs(x) - half
    return np.linalg.norm(np.maximum(q, 0.0), axis=-1) + np.minimum(q.max(axis=-1), 0.0)


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...i,...i->...", a, b)


def _over(a: Array, b: Array, good: NDArray[np.bool_]) -> Array:
    """a / b where ``good`` is true, 0 elsewhere."""
    return np.where(good, a / np.where(good, b, 1.0), 0.0)
