"""Colours of the object."""

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.perception.colour import ObjectColour, lab


@pytest.mark.parametrize(
    ("rgb", "expected"),
    [
        ((255, 255, 255), (100.0, 0.0, 0.0)),
        ((0, 0, 0), (0.0, 0.0, 0.0)),
        ((0, 0, 255), (32.30, 79.19, -107.86)),
        # Between the ends sRGB is not linear.
        ((128, 0, 0), (25.54, 48.05, 38.06)),
        ((8, 8, 8), (2.19, 0.0, 0.0)),
    ],
)
def test_lab_of_known_colours(rgb, expected):
    """Reference values of CIE L*a*b* under D65."""
    np.testing.assert_allclose(lab(rgb), expected, atol=0.05)


@pytest.mark.parametrize("rgb", [(180, 30, 35), (40, 70, 190), (60, 160, 70), (190, 150, 60)])
def test_what_lies_in_shadow_is_the_object_s(rgb):
    """With down to an eighth of the light; grey, black and other hues in shadow are not."""
    linear = np.where(np.array(rgb) <= 10, 0.0, ((np.array(rgb) / 255 + 0.055) / 1.055) ** 2.4)
    shades = np.array([1.0, 0.5, 0.25, 0.125])[:, None] * linear
    shades = np.rint(255 * (1.055 * shades ** (1 / 2.4) - 0.055)).clip(0).astype(np.uint8)
    assert ObjectColour.near(lab(rgb)).match(shades).all()
    level = shades.mean(axis=1, keepdims=True).astype(np.uint8).repeat(3, axis=1)
    others = np.concatenate([level, shades[:, [1, 2, 0]], shades[:, [2, 0, 1]], 0 * shades])
    assert not ObjectColour.near(lab(rgb)).match(others).any()


def test_lightness_tells_greys_apart_when_it_counts():
    white, black = np.array([[240, 240, 240]], np.uint8), np.array([[150, 150, 150]], np.uint8)
    strict = ObjectColour.near(lab(white[0]), lightness_weight=1.0)
    lenient = ObjectColour.near(lab(white[0]), lightness_weight=0.0)
    assert strict.match(white)[0] and not strict.match(black)[0]
    assert lenient.match(black)[0]
    with pytest.raises(ParameterError, match="tolerance"):
        ObjectColour.near((50, 0, 0), tolerance=0.0)
