"""The colours of clouds, and the fixed palette that their pictures are stored with."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from PIL import Image

# From Okabe and Ito's palette, told apart with every common form of colour blindness.
RECORDED_COLOR = "#0072B2"
SIMULATED_COLOR = "#E69F00"

INK = (34, 34, 34)
SOFT_INK = (110, 110, 110)
GRID = (234, 234, 234)
TABLE_FILL = (244, 244, 244)
TABLE_LINE = (150, 150, 150)
SIMULATED_OPACITY = 0.55
RECORDED_OPACITY = 0.9


def rgb(color: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of "#rrggbb"."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def with_palette(image: Image.Image) -> Image.Image:
    """The image with the colours that a `Stage` can mix; one palette for all frames.

    A fixed palette keeps frames from flickering and the file small.
    """
    return image.quantize(palette=_palette(), dither=Image.Dither.NONE)


@cache
def _palette() -> Image.Image:
    white = np.array([255.0, 255.0, 255.0])
    table = np.array(TABLE_FILL, dtype=float)
    blue, orange = (np.array(rgb(c), dtype=float) for c in (RECORDED_COLOR, SIMULATED_COLOR))
    ink = np.array(INK, dtype=float)
    orange_mix = white + SIMULATED_OPACITY * (orange - white)
    ramps = [
        (white, ink, 14),
        (white, orange_mix, 7),
        (white, white + RECORDED_OPACITY * (blue - white), 8),
        (orange_mix, orange_mix + RECORDED_OPACITY * (blue - orange_mix), 7),
        (table, table, 1),
        (orange, orange, 1),  # the legend's dots are opaque
        (blue, blue, 1),
        (np.array(GRID, dtype=float), np.array(GRID, dtype=float), 1),
        (orange_mix, ink, 4),
    ]
    colors = np.concatenate([a + np.linspace(0.0, 1.0, n)[:, None] * (b - a) for a, b, n in ramps])
    colors = np.unique(colors.round().astype(np.uint8), axis=0)
    holder = Image.new("P", (1, 1))
    holder.putpalette(colors.tobytes())
    return holder


def nice_step(at_least: float) -> float:
    """The smallest of 1, 2 and 5 times a power of ten that is not below `at_least`."""
    power = 10.0 ** math.floor(math.log10(at_least))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= at_least * (1.0 - 1e-9))
