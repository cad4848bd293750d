"""Colours of all pictures, round steps of axes, and what cameras saw as one picture."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from PIL import Image

from gendom.arguments import require
from gendom.arrays import Array

# From Okabe and Ito's palette, told apart with every common form of colour blindness.
RECORDED_COLOR = "#0072B2"
SIMULATED_COLOR = "#E69F00"
OBSTACLE_COLOR = "#8C96A0"
GOAL_COLOR = "#009E73"
ARM_COLOR = "#B4BBC3"
GRIPPER_COLOR = "#222222"

DEPTH_COLORS = ("#fde725", "#5ec962", "#21918c", "#3b528b", "#440154")
"""From near to far: five of the colours of matplotlib's viridis."""

DEPTHS = 0.5, 1.3
"""Of their ends [m]; black is no depth."""

WIDTH = 1280
"""Of a picture of what all cameras saw [pixels]."""

INK = (34, 34, 34)
SOFT_INK = (110, 110, 110)
TABLE_FILL = (244, 244, 244)
TABLE_LINE = (150, 150, 150)
SIMULATED_OPACITY = 0.55
RECORDED_OPACITY = 0.9


def rgb(color: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of "#rrggbb"."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def nice_step(at_least: float) -> float:
    """The smallest of 1, 2 and 5 times a power of ten that is not below `at_least`."""
    power = 10.0 ** math.floor(math.log10(at_least))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= at_least * (1.0 - 1e-9))


def encode_camera_views(
    views: Sequence[tuple[npt.NDArray[np.uint8], Array]],
) -> bytes:
    """One JPEG: a row for each camera, colour on the left and depth on the right.

    Args:
        views: Colour [height, width, 3] and depth [height, width] [m], 0 where there is none,
            of each camera; pictures of one size.

    Raises:
        ParameterError: There is no picture, or their sizes differ.
    """
    sizes = {colour.shape[:2] for colour, _ in views} | {depth.shape for _, depth in views}
    what, fix = f"has pictures of {len(sizes)} sizes", "give pictures of one size"
    require(len(sizes) == 1, what, where="views", fix=fix)
    scale = np.transpose([rgb(color) for color in DEPTH_COLORS])
    rows = []
    for colour, depth in views:
        share = np.clip((depth - DEPTHS[0]) / np.ptp(DEPTHS), 0.0, 1.0)
        channels = [np.interp(share, np.linspace(0.0, 1.0, len(c)), c) for c in scale]
        painted = np.stack(channels, axis=-1).astype(np.uint8)
        painted[depth <= 0.0] = 0
        rows.append(np.concatenate([colour, painted], axis=1))
    whole = Image.fromarray(np.concatenate(rows))
    size = WIDTH, round(whole.height * WIDTH / whole.width)
    buffer = io.BytesIO()
    whole.resize(size, Image.Resampling.LANCZOS).save(buffer, "JPEG", quality=80, optimize=True)
    return buffer.getvalue()
