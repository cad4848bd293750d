"""How much of a cloth lies spread: its triangles are drawn on the table, by compiled code, as sets
of demonstrations have thousands of cloths of as many triangles."""

# pyright: reportInvalidTypeForm=false

import math
from functools import cache, partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from gendom.arrays import Array
from gendom.sim.device import load_kernels

wp.set_module_options({"enable_backward": False})

FLAT_ANGLE, FLAT_HEIGHT = math.radians(20.0), 0.05
"""What lies flat is inclined by at most this [rad], and at most so high above the table [sides]."""

PIXEL = 1.0 / 500.0
"""Resolution [sides]."""

REAL, LONG = wp.float64, wp.int64
UP = wp.constant(wp.vec3d(0.0, 0.0, 1.0))
STEEPEST, HIGHEST = wp.constant(REAL(math.cos(FLAT_ANGLE))), wp.constant(REAL(FLAT_HEIGHT))
SIZE = wp.constant(REAL(PIXEL))
COVERED, SPREAD = wp.constant(wp.uint8(1)), wp.constant(wp.uint8(2))


@wp.kernel
def draw(
    x: wp.array(dtype=wp.vec3d),
    triangles: wp.array2d(dtype=LONG),
    origin: wp.vec3d,
    picture: wp.array2d(dtype=wp.uint8),
):
    """Marks what a triangle covers, row by row; a border covers the pixel that it crosses."""
    i = wp.tid()
    a, b, c = x[triangles[i, 0]], x[triangles[i, 1]], x[triangles[i, 2]]
    corners = wp.matrix_from_cols(a - origin, b - origin, c - origin)
    upright = wp.abs(wp.dot(wp.normalize(wp.cross(b - a, c - a)), UP))
    mark = COVERED
    if upright >= STEEPEST and wp.max(a[2], wp.max(b[2], c[2])) <= HIGHEST:
        mark = SPREAD
    u, v = corners[0] / SIZE, corners[1] / SIZE
    for row in range(int(wp.round(wp.min(v))), int(wp.round(wp.max(v))) + 1):
        left, right = REAL(1e9), REAL(-1e9)
        for k in range(3):
            n = (k + 1) % 3
            share = (REAL(row) - v[k]) / (v[n] - v[k])
            if share >= REAL(0.0) and share <= REAL(1.0):
                at = u[k] + share * (u[n] - u[k])
                left, right = wp.min(left, at), wp.max(right, at)
        for column in range(int(wp.round(left)), int(wp.round(right)) + 1):
            picture[row, column] = wp.max(picture[row, column], mark)


@cache
def _loaded() -> Any:
    load_kernels(draw.module, "cpu")
    return draw


def spread_areas(x: Array, triangles: NDArray[np.int64]) -> tuple[float, float]:
    """Share of a cloth that lies spread, and the area of the table under all of it [sides^2].

    What lies spread is smooth and free of wrinkles: the area of the table under triangles that lie
    flat, inclined by at most 20 degrees and at most 0.05 sides above it. What lies below another
    layer does not count twice.

    Args:
        x: [V, 3] vertices [sides]; the table is z = 0.
        triangles: [F, 3] vertices of each.
    """
    kernel, low = _loaded(), x.min(axis=0)
    width, height = (np.ptp(x[:, :2], axis=0) / PIXEL).astype(int) + 2
    picture = np.zeros((height, width), np.uint8)
    shared = partial(wp.array, device="cpu", copy=False)
    given = (
        shared(x, dtype=wp.vec3d), shared(triangles, dtype=LONG),
        wp.vec3d(low[0], low[1], 0.0), shared(picture, dtype=wp.uint8),
    )  # fmt: skip
    wp.launch(kernel, dim=len(triangles), inputs=given, device="cpu")
    spread, covered = (np.count_nonzero(picture >= mark.value) for mark in (SPREAD, COVERED))
    return min(spread * PIXEL**2, 1.0), min(covered * PIXEL**2, 1.0)
