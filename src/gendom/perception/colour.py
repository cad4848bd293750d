"""Segmentation by colour.

Colours are compared in CIE L*a*b*, where a distance of about 2 is just visible. Lightness has a
smaller weight, because shading changes it along a rope much more than hue and saturation. Shadow
reduces all three: if light is reduced by a factor q^3, (L* + 16, a*, b*) is reduced by q, by the
definition of L*a*b*. Colours on that line also belong to the object.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from gendom.arguments import require
from gendom.arrays import Array

TOLERANCE = 25.0
"""Largest distance from the reference colour in L*a*b*, lightness weighed."""
LIGHTNESS_WEIGHT = 0.4
"""How much a difference of lightness counts beside one of a* or b*."""

# (L* + 16, a*, b*) in the darkest shadow, a tenth of the light. A colour there may be as far off
# as this share of its saturation: grey is no shadow of a colour.
_DARKEST_SHADOW, _SHADOW_SATURATION = 0.45, 0.6
# Less saturated than this, a reference is white, grey or black, and a* and b* count twice: light
# skin is within 25 of white.
_NEUTRAL = 12.0
_BITS = 6  # of each channel in the table of colours; 2^18 answers, found in a millisecond
_WHITE = np.array([0.95047, 1.0, 1.08883])  # D65
_RGB_TO_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)


def lab(rgb: npt.ArrayLike) -> Array:
    """[..., 3] L*, a*, b* of sRGB colours [..., 3] in 0..255, white point D65.

    Source: IEC 61966-2-1 (sRGB to XYZ), CIE 15 (XYZ to L*a*b*).
    """
    c = np.asarray(rgb, dtype=np.float64) / 255.0
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    t = linear @ _RGB_TO_XYZ.T / _WHITE
    delta = 6.0 / 29.0
    f = np.where(t > delta**3, np.cbrt(t), t / (3.0 * delta**2) + 4.0 / 29.0)
    x, y, z = f[..., 0], f[..., 1], f[..., 2]
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


@cache
def _colours() -> Array:
    """[2^18, 3] L*, a*, b* in the middle of each entry of a table of colours."""
    middle = (np.arange(1 << _BITS) + 0.5) * (256 >> _BITS) - 0.5
    return lab(np.stack(np.meshgrid(middle, middle, middle, indexing="ij"), axis=-1).reshape(-1, 3))


@dataclass(frozen=True, eq=False)
class ObjectColour:
    """All colours near a reference."""

    reference: Array
    """[3] L*, a*, b*."""
    table: npt.NDArray[np.bool_]
    """[2^18] whether a colour is the object's, by the upper six bits of R, G and B."""

    @classmethod
    def near(
        cls,
        reference: npt.ArrayLike,
        *,
        tolerance: float = TOLERANCE,
        lightness_weight: float = LIGHTNESS_WEIGHT,
    ) -> ObjectColour:
        """Colours within a distance of L*, a*, b* `reference` [3], and what they are in shadow
        unless lightness counts in full; see `lab` for one of RGB.

        Raises:
            ParameterError: The tolerance is not above 0 or the weight is negative.
        """
        what = f"colour tolerance {tolerance}, lightness weight {lightness_weight}"
        fix = "give a tolerance above 0 and a weight of 0 or more"
        require(tolerance > 0.0 and lightness_weight >= 0.0, what, fix=fix)
        at, colours = np.asarray(reference, dtype=np.float64), _colours()
        hue = 2.0 if np.hypot(at[1], at[2]) < _NEUTRAL else 1.0
        weight, black = np.array([lightness_weight, hue, hue]), np.array([-16.0, 0.0, 0.0])
        own = (((colours - at) * weight) ** 2).sum(axis=1) <= tolerance**2
        if lightness_weight < 1.0:
            ray, seen = (at - black) * weight, (colours - black) * weight
            q = np.clip(seen @ ray / (ray @ ray), _DARKEST_SHADOW, 1.0)
            near = q * min(tolerance, _SHADOW_SATURATION * float(np.hypot(at[1], at[2])))
            own |= np.linalg.norm(seen - q[:, None] * ray, axis=1) < near
        return cls(at, own)

    def match(self, rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
        """[n] True where a colour [n, 3] is the object's."""
        r, g, b = rgb.T >> (8 - _BITS)
        index = (r.astype(np.int32) << (2 * _BITS)) | (g.astype(np.int32) << _BITS) | b
        return self.table[index]
