"""Smooth discs, lines and letters on a NumPy picture.

A full plotting library would take ten times as long for each frame of an animation.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from PIL import ImageFont


def splat(
    canvas: np.ndarray,
    place: np.ndarray,
    radius: float,
    color: tuple[int, int, int],
    opacity: float,
) -> None:
    """Paint the union of smooth discs, so that a dense cloud is no darker than a thin one.

    Args:
        canvas: [h, w, 3] float32, painted in place.
        place: [n, 2] the discs' middles, right and down from the canvas's corner [pixels].
        radius: Of the discs [pixels].
        color: Red, green and blue, 0 to 255.
        opacity: 0 to 1.
    """
    if len(place) == 0:
        return
    height, width = canvas.shape[:2]
    reach = math.ceil(radius + 0.5)
    place = place[((place > -reach) & (place < [width + reach, height + reach])).all(axis=1)]
    corner = np.floor(place).astype(np.int64)
    offsets = np.arange(-reach, reach + 1)
    x = corner[:, 0, None] + offsets
    y = corner[:, 1, None] + offsets
    dx, dy = x + 0.5 - place[:, 0, None], y + 0.5 - place[:, 1, None]
    distance = np.sqrt(dx[:, None, :] ** 2 + dy[:, :, None] ** 2)
    cover = np.clip(radius + 0.5 - distance, 0.0, 1.0).astype(np.float32)
    cell = y[:, :, None] * width + x[:, None, :]
    inside = ((y >= 0) & (y < height))[:, :, None] & ((x >= 0) & (x < width))[:, None, :]
    inside &= cover > 0.0
    mask = np.zeros(width * height, dtype=np.float32)
    np.maximum.at(mask, cell[inside], cover[inside])
    _blend(canvas, opacity * mask.reshape(height, width), color)


def stroke(
    canvas: np.ndarray,
    start: np.ndarray,
    end: np.ndarray,
    half_width: float,
    color: tuple[int, int, int],
) -> None:
    """A smooth line between two points in pixels."""
    height, width = canvas.shape[:2]
    reach = half_width + 1.0
    low = np.floor(np.minimum(start, end) - reach).astype(int)
    high = np.ceil(np.maximum(start, end) + reach).astype(int)
    x0, y0 = np.clip(low, 0, [width, height])
    x1, y1 = np.clip(high, 0, [width, height])
    if x0 >= x1 or y0 >= y1:
        return
    y, x = np.mgrid[y0:y1, x0:x1] + 0.5
    along = end - start
    length2 = max(float(along @ along), 1e-12)
    s = np.clip(((x - start[0]) * along[0] + (y - start[1]) * along[1]) / length2, 0.0, 1.0)
    distance = np.hypot(x - start[0] - s * along[0], y - start[1] - s * along[1])
    opacity = np.clip(half_width + 0.5 - distance, 0.0, 1.0).astype(np.float32)
    _blend(canvas[y0:y1, x0:x1], opacity, color)


def _blend(canvas: np.ndarray, opacity: np.ndarray, color: tuple[int, int, int]) -> None:
    """Lay a colour over [h, w, 3], with opacity [h, w]."""
    canvas += opacity[..., None] * (np.array(color, dtype=np.float32) - canvas)


@cache
def lettering(size: float) -> ImageFont.FreeTypeFont:
    """The pictures' one font in a size [pixels]."""
    # Matplotlib brings this font along, so that pictures are the same on every machine.
    path = Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")
    return ImageFont.truetype(path, size, layout_engine=ImageFont.Layout.BASIC)
