"""Which particles a camera could see."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.errors import ParameterError

CELL = 1.25
"""Width of the cells in which points hide one another, in spacings."""

DEPTH = 2.25
"""How far behind the nearest point of its cell a point is still seen, in spacings."""


def visible(
    points: ArrayLike, *, spacing: float, camera_positions: ArrayLike | None = None
) -> NDArray[np.bool_]:
    """Mark the points that no other point hides, from any of the cameras.

    Points are sorted into square cells across the line of sight, ``CELL`` spacings wide; a point
    is hidden when its cell holds a point nearer by more than ``DEPTH`` spacings. A surface steeper
    than their ratio counts as seen edge-on.

    Args:
        points: [n, 3] [m].
        spacing: Distance between neighbouring points of the object [m].
        camera_positions: [K, 3] optical centres [m], or None for a view from straight above.

    Returns:
        [n] True where a camera sees the point.

    Raises:
        ParameterError: If shapes do not fit.
    """
    p = np.asarray(points, dtype=float)
    if p.ndim != 2 or p.shape[1] != 3:
        raise ParameterError(f"points must be [n, 3], got {p.shape}")
    if camera_positions is None:
        return _front(p[:, :2], -p[:, 2], spacing)
    seen = np.zeros(len(p), dtype=bool)
    cameras = np.atleast_2d(np.asarray(camera_positions, dtype=float))
    if cameras.shape[1] != 3:
        raise ParameterError(f"camera_positions must be [K, 3], got {cameras.shape}")
    for camera in cameras:
        ray = p - camera
        distance = np.linalg.norm(ray, axis=1)
        axis = ray.mean(axis=0)
        axis /= np.linalg.norm(axis)
        side = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
        side /= np.linalg.norm(side)
        across = np.stack([ray @ side, ray @ np.cross(side, axis)], axis=1)
        scale = np.median(distance) / np.maximum(ray @ axis, 1e-6)
        seen |= _front(across * scale[:, None], distance, spacing)
    return seen


def _front(across: NDArray, depth: NDArray, spacing: float) -> NDArray[np.bool_]:
    cell = np.floor((across - across.min(axis=0)) / (CELL * spacing)).astype(np.int64)
    nearest = np.full(tuple(cell.max(axis=0) + 1), np.inf)
    np.minimum.at(nearest, (cell[:, 0], cell[:, 1]), depth)
    return depth <= nearest[cell[:, 0], cell[:, 1]] + DEPTH * spacing
