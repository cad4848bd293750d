"""Which particles a camera could see."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

from gendom.errors import ParameterError

FROM_ABOVE = 20.0
"""Height of the viewpoint that stands for "from above", in sizes of the object."""

FLIP_RADIUS = 30.0
"""Radius of the spherical flip, in distances of the farthest point."""


def visible(points: ArrayLike, *, camera_positions: ArrayLike | None = None) -> NDArray[np.bool_]:
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
    if p.ndim != 2 or p.shape[1] != 3 or len(p) == 0:
        raise ParameterError(f"points must be [n > 0, 3], got {p.shape}")
    if camera_positions is None:
        size = max(float(np.ptp(p, axis=0).max()), 1e-6)
        cameras = np.atleast_2d(p.mean(axis=0) + np.array([0.0, 0.0, FROM_ABOVE * size]))
    else:
        cameras = np.atleast_2d(np.asarray(camera_positions, dtype=float))
        if cameras.shape[1] != 3:
            raise ParameterError(f"camera_positions must be [K, 3], got {cameras.shape}")
    seen = np.zeros(len(p), dtype=bool)
    for camera in cameras:
        ray = p - camera
        distance = np.linalg.norm(ray, axis=1, keepdims=True)
        radius = FLIP_RADIUS * distance.max()
        flipped = ray + 2.0 * (radius - distance) * ray / distance
        try:
            hull = ConvexHull(np.concatenate([flipped, np.zeros((1, 3))]))
        except QhullError:  # too few points for a solid: none hides another
            seen[:] = True
            continue
        seen[hull.vertices[hull.vertices < len(p)]] = True
    return seen
