"""Triangles of tubes and capsules."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

SIDES = 12
"""Of a capsule."""

_LATITUDES = np.concatenate([np.linspace(0.0, 0.5, 5), np.linspace(0.5, 1.0, 5)]) * np.pi


def tube_faces(rings: int, sides: int) -> NDArray[np.integer]:
    """[F, 3] triangles of a closed tube: rings of vertices one after another, and its two ends.

    They are counter-clockwise from outside where rings are so, seen from the last one.
    """
    at = np.arange(rings * sides).reshape(rings, sides)
    a, b = at[:-1], at[1:]
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    fan = [[0, k, k + 1] for k in range(1, sides - 1)]
    faces = [np.stack([a, c, b], axis=-1), np.stack([a, d, c], axis=-1)]
    ends = [at[0][fan][:, ::-1], at[-1][fan]]
    return np.concatenate([f.reshape(-1, 3) for f in (*faces, *ends)])


def capsules(
    ends: ArrayLike, radius: ArrayLike
) -> tuple[NDArray[np.floating], NDArray[np.integer]]:
    """Vertices [T, V, 3] [m] and triangles [F, 3] of C capsules, of balls where both ends meet.

    Args:
        ends: [T, C, 2, 3] ends of their axes [m].
        radius: [C] [m].
    """
    ends, radius = np.asarray(ends, dtype=float), np.asarray(radius, dtype=float)
    axis = ends[..., 1, :] - ends[..., 0, :]
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    axis = np.where(length > 1e-9, axis / np.maximum(length, 1e-9), [0.0, 0.0, 1.0])
    # any direction that is far from the axis
    aside = np.eye(3)[np.argmin(np.abs(axis), axis=-1)]
    first = np.cross(axis, aside)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(axis, first)
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    around = np.cos(angle)[:, None] * first[..., None, :]
    around = around + np.sin(angle)[:, None] * second[..., None, :]  # [T, C, S, 3]
    out = np.sin(_LATITUDES)[:, None, None] * around[..., None, :, :]
    out = out - np.cos(_LATITUDES)[:, None, None] * axis[..., None, None, :]
    rings = len(_LATITUDES)
    centre = np.repeat(ends, rings // 2, axis=-2)[..., None, :]  # [T, C, R, 1, 3]
    vertices = centre + radius[:, None, None, None] * out
    one, each = tube_faces(rings, SIDES), rings * SIDES
    faces = np.concatenate([one + c * each for c in range(len(radius))])
    return vertices.reshape(len(ends), -1, 3), faces
