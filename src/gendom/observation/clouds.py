"""Clouds compared: their distance, and what of them cameras see."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, KDTree, QhullError

from gendom.arguments import require
from gendom.arrays import Array

_HEIGHT_FROM_ABOVE = 20.0  # of the viewpoint that stands for "from above", in sizes of the object
_FLIP_RADIUS = 30.0  # of the spherical flip, in distances of the farthest point
# Width of the pixels in which parts of a sheet hide others, in the distance of its points: no
# nearer part shows gaps.
_PIXEL_SPACINGS = 1.5
_MAX_SIGHT_ANGLE = 75.0  # to a sheet's normal, beyond which depth cameras measure nothing [degrees]


def chamfer(a: ArrayLike, b: ArrayLike, *, of_b: Array | None = None) -> float:
    """Mean distance from A to its nearest in B plus mean distance from B to its nearest in A [m].

    This is the definition that the GenDOM authors' figures follow: distances, not their squares,
    and a sum of both directions, not their mean.

    Args:
        a, b: [n, 3] and [m, 3] points [m].
        of_b: [m] the points of B that A could show at all: only these count in the second mean,
            while all of B may be nearest to a point of A. None counts all.

    Raises:
        ParameterError: If a cloud is empty or has the wrong shape.
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    for name, cloud in (("a", a), ("b", b)):
        right = cloud.ndim == 2 and cloud.shape[1] == 3 and len(cloud) > 0
        require(right, f"chamfer needs clouds [n > 0, 3], {name} is {cloud.shape}")
    to_b = KDTree(b).query(a)[0]
    counted = b if of_b is None or not np.any(of_b) else b[of_b]
    to_a = KDTree(a).query(counted)[0]
    return float(to_b.mean() + to_a.mean())


def visible(points: ArrayLike, *, camera_positions: ArrayLike | None = None) -> Array:
    """Mark the points that no others hide, from any of the cameras.

    Hidden point removal: points are mirrored in a sphere around the viewpoint, and those on the
    convex hull of the result are seen. Source: Katz, Tal and Basri (2007), "Direct visibility
    of point sets".

    Args:
        points: [n, 3] [m].
        camera_positions: [K, 3] optical centres [m], or None for a view from far above.

    Returns:
        [n] True where a camera sees the point.

    Raises:
        ParameterError: If shapes do not fit.
    """
    p = np.asarray(points, dtype=float)
    right = p.ndim == 2 and p.shape[1] == 3 and len(p) > 0
    require(right, f"points must be [n > 0, 3], got {p.shape}")
    seen = np.zeros(len(p), dtype=bool)
    for camera in _viewpoints(p, camera_positions):
        ray = p - camera
        distance = np.linalg.norm(ray, axis=1, keepdims=True)
        radius = _FLIP_RADIUS * distance.max()
        flipped = ray + 2.0 * (radius - distance) * ray / distance
        try:
            hull = ConvexHull(np.concatenate([flipped, np.zeros((1, 3))]))
        except QhullError:  # too few points for a solid: none hides another
            seen[:] = True
            continue
        seen[hull.vertices[hull.vertices < len(p)]] = True
    return seen


def visible_on_sheet(
    points: ArrayLike,
    normals: ArrayLike,
    sheet: ArrayLike,
    *,
    spacing: float,
    camera_positions: ArrayLike | None = None,
) -> Array:
    """Mark the points on a sheet that a camera sees.

    They are seen no more aslant than by 75 degrees, and no nearer part of the sheet lies in
    their pixel.

    Args:
        points: [n, 3] [m].
        normals: [n, 3] unit normals there, of either sign.
        sheet: [m, 3] points all over the sheet [m].
        spacing: Between neighbours of these [m].
        camera_positions: [K, 3] optical centres [m], or None for a view from far above.

    Returns:
        [n] True where a camera sees the point.

    Raises:
        ParameterError: If shapes do not fit.
    """
    p, n, q = (np.asarray(x, dtype=float) for x in (points, normals, sheet))
    right = all(x.ndim == 2 and x.shape[1] == 3 for x in (p, n, q))
    what = f"the sheet [m > 0, 3], got {p.shape}, {n.shape} and {q.shape}"
    right = right and len(p) == len(n) and len(q) > 0
    require(right, f"points and normals must be [n, 3], {what}")
    steepest = math.cos(math.radians(_MAX_SIGHT_ANGLE))
    seen = np.zeros(len(p), dtype=bool)
    for camera in _viewpoints(q, camera_positions):
        middle = q.mean(axis=0) - camera
        away = float(np.linalg.norm(middle))
        _, _, axes = np.linalg.svd(middle[None] / away)
        to_sheet, to_points = (q - camera) @ axes.T, (p - camera) @ axes.T
        sign = np.sign(to_sheet[:, 0].mean())
        depth, own = sign * to_sheet[:, 0], sign * to_points[:, 0]
        pixel = _PIXEL_SPACINGS * spacing / away
        low = (to_sheet[:, 1:] / depth[:, None]).min(axis=0)
        at = ((to_sheet[:, 1:] / depth[:, None] - low) / pixel).astype(np.int64)
        size = at.max(axis=0) + 1
        nearest = np.full(size.prod(), np.inf)
        np.minimum.at(nearest, at[:, 0] * size[1] + at[:, 1], depth)
        here = np.floor((to_points[:, 1:] / own[:, None] - low) / pixel).astype(np.int64)
        inside = np.all((here >= 0) & (here < size), axis=1)
        here = np.clip(here, 0, size - 1)
        ray = p - camera
        cosine = np.abs((ray * n).sum(axis=1)) / np.linalg.norm(ray, axis=1)
        # so much depth has the sheet itself within a pixel
        slope = np.sqrt(1.0 - np.minimum(cosine, 1.0) ** 2) / np.maximum(cosine, steepest)
        margin = spacing * (1.0 + 1.5 * _PIXEL_SPACINGS * slope)
        open_ = own <= nearest[here[:, 0] * size[1] + here[:, 1]] + margin
        seen |= (open_ | ~inside) & (cosine > steepest)
    return seen


def _viewpoints(points: Array, positions: ArrayLike | None) -> Array:
    """[K, 3] optical centres [m]."""
    if positions is None:
        size = max(float(np.ptp(points, axis=0).max()), 1e-6)
        return np.atleast_2d(points.mean(axis=0) + np.array([0.0, 0.0, _HEIGHT_FROM_ABOVE * size]))
    cameras = np.atleast_2d(np.asarray(positions, dtype=float))
    require(cameras.shape[1] == 3, f"camera_positions must be [K, 3], got {cameras.shape}")
    return cameras
