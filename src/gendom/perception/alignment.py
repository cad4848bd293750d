"""Align the colour of one camera with the depth of a neighbouring one."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gendom.perception.camera import Camera
from gendom.perception.frames import Pictures

# What hides a point is nearer by this share of its depth, besides the change of depth over two
# cells of a surface whose slope is this many pixels' widths a pixel.
_MIN_NEARER_SHARE = 0.02
_MAX_DEPTH_SLOPE = 5.0


class Alignment:
    """Assign each depth pixel the colour of its point.

    Pixels without depth, and those whose point is outside the colour camera's view, become black.
    Where a nearer object occludes a point from the colour camera, the colour would be that of the
    nearer object; the depth of such pixels, at the edges of near objects, is removed.

    Args:
        depth: The depth camera.
        colour: The colour camera; its pose in the world and its depth unit do not matter.
        T_colour_depth: [4, 4] from the depth camera's axes to the colour camera's [m].
    """

    def __init__(self, depth: Camera, colour: Camera, T_colour_depth: npt.ArrayLike):
        T = np.asarray(T_colour_depth, dtype=np.float64)
        self._unit = np.float32(depth.depth_unit)
        self.colour = colour
        self._rays = (depth.rays() @ T[:3, :3].T).astype(np.float32)
        self._shift = T[:3, 3].astype(np.float32)
        # The colour picture in cells of about a depth pixel's size, to find what hides what.
        self._cell = max(1.0, float(colour.K[0, 0] / depth.K[0, 0]))
        self._nearer = np.float32(1.0 + _MIN_NEARER_SHARE + 2.0 * _MAX_DEPTH_SLOPE / depth.K[0, 0])
        self._same = (
            np.allclose(T, np.eye(4), atol=1e-6)
            and (depth.width, depth.height) == (colour.width, colour.height)
            and np.allclose(depth.K, colour.K, atol=1e-3)
            and np.allclose(_five(depth), _five(colour), atol=1e-6)
        )

    def __call__(self, depth: npt.NDArray[np.uint16], colour: npt.NDArray[np.uint8]) -> Pictures:
        """Both pictures in the depth camera's pixels.

        Args:
            depth: [height, width] counts.
            colour: [height, width, 3] of the colour camera's size.
        """
        if self._same:
            return Pictures(depth, colour)
        raw = depth.ravel()
        pixels = np.flatnonzero(raw)
        points = self._rays[pixels] * (raw[pixels] * self._unit)[:, None] + self._shift
        front = points[:, 2] > 0.0
        pixels, points = pixels[front], points[front]
        u, v = self._project(points)
        inside = (u >= 0) & (u < self.colour.width) & (v >= 0) & (v < self.colour.height)
        pixels, z, u, v = pixels[inside], points[inside, 2], u[inside], v[inside]
        hidden = self._hidden(z, u, v)
        kept, painted = raw.copy(), np.zeros((len(raw), 3), np.uint8)
        kept[pixels[hidden]] = 0
        seen = ~hidden
        painted[pixels[seen]] = colour[v[seen], u[seen]]
        return Pictures(kept.reshape(depth.shape), painted.reshape(*depth.shape, 3))

    def _project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Column and row of the colour picture, nearest pixels, of points [n, 3] before it."""
        K = self.colour.K
        x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
        k1, k2, p1, p2, k3 = _five(self.colour)
        if any((k1, k2, p1, p2, k3)):
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            x, y = (
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            )
        u = np.rint(K[0, 0] * x + K[0, 1] * y + K[0, 2])
        v = np.rint(K[1, 1] * y + K[1, 2])
        # Rays far outside of the lens would not fit an integer.
        return tuple(np.clip(a, -1, 1e6).astype(np.int64) for a in (u, v))

    def _hidden(self, z: np.ndarray, u: np.ndarray, v: np.ndarray) -> npt.NDArray[np.bool_]:
        """Which points [n] of depth z [m] have something nearer within a cell of theirs."""
        columns = int(self.colour.width / self._cell) + 3
        rows = int(self.colour.height / self._cell) + 3
        cell = ((v / self._cell).astype(np.int64) + 1) * columns + (u / self._cell).astype(int) + 1
        nearest = np.full(rows * columns, np.inf, np.float32)
        np.minimum.at(nearest, cell, z)
        around = nearest[cell]
        for step in np.add.outer((-columns, 0, columns), (-1, 0, 1)).ravel():
            np.minimum(around, nearest[cell + step], out=around)
        return z > self._nearer * around


def _five(camera: Camera) -> tuple[float, float, float, float, float]:
    """k1, k2, p1, p2, k3 of a camera with at most these."""
    k1, k2, p1, p2, k3 = (*camera.distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    return k1, k2, p1, p2, k3
