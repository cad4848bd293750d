"""Centre lines: places along them, frames, and the skin around them."""

import math

import numpy as np

from gendom.arrays import Array
from gendom.errors import ParameterError


def arc_length(line: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])


def along_line(line: Array, along: Array) -> tuple[Array, Array]:
    """Points [M, 3] and unit tangents [M, 3] at arc lengths; straight beyond both ends."""
    s = arc_length(line)
    steps = np.diff(line, axis=0)
    lengths = np.diff(s)
    if np.any(lengths <= 0.0):
        raise ParameterError("centre_line repeats a point: remove neighbours that coincide")
    unit = steps / lengths[:, None]
    segment = np.clip(np.searchsorted(s, along, side="right") - 1, 0, len(unit) - 1)
    points = line[segment] + unit[segment] * (along - s[segment])[:, None]
    # average tangents over neighbouring points, so that sections do not jump at corners
    tangent = np.gradient(points, axis=0)
    return points, tangent / np.linalg.norm(tangent, axis=1, keepdims=True)


def frames(tangent: Array) -> tuple[Array, Array]:
    """Two unit normals [M, 3] of each tangent; the first is horizontal where possible."""
    reference = np.array([0.0, 0.0, 1.0])
    if np.max(np.abs(tangent @ reference)) > 0.99:
        reference = np.array([0.0, 1.0, 0.0])
    side = np.cross(reference, tangent)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return side, np.cross(tangent, side)


def fixed_frame(direction: Array) -> Array:
    """[3, 3] rows: two normals of a direction [3], and its unit vector."""
    unit = direction / np.linalg.norm(direction)
    side, up = frames(unit[None])
    return np.stack([side[0], up[0], unit])


def around(points: Array, thickness: float, x: Array) -> Array:
    """Rings of eight points around a centre line x [..., n, 3] that is ``points`` [n, 3] at rest, a
    third of a diameter apart [m]."""
    spacing = np.linalg.norm(points[1] - points[0])
    parts = max(1, round(3.0 * float(spacing) / thickness))
    share = (np.arange(parts) + 0.5)[:, None] / parts
    step = np.diff(x, axis=-2)[..., :, None, :]
    centres = x[..., :-1, None, :] + share * step
    tangent = step / np.linalg.norm(step, axis=-1, keepdims=True)
    # any two normals that change smoothly: a fixed frame under the smallest rotation that
    # takes its axis to the tangent
    first = fixed_frame(points[1] - points[0])
    along = tangent + first[2]
    scale = np.maximum(1.0 + tangent @ first[2], 1e-9)[..., None]
    normals = [d - (tangent @ d)[..., None] / scale * along for d in first[:2]]
    angle = 2.0 * math.pi * np.arange(8) / 8.0
    ring = np.cos(angle)[:, None] * normals[0][..., None, :]
    ring = ring + np.sin(angle)[:, None] * normals[1][..., None, :]
    skin = centres[..., None, :] + 0.5 * thickness * ring
    return skin.reshape(*x.shape[:-2], -1, 3)
