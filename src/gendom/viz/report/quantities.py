"""Numbers as people read them: four digits at the most, with their unit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

RATIOS = ("nu", "friction", "stiffness_slope")
"""Quantities without a unit, on a linear scale."""


def finite(value: Any) -> float | None:
    """A finite float, or None."""
    if value is None or isinstance(value, (bool, str)):
        return None
    try:
        value = float(value)
    except (TypeError, ValueError):
        return None
    return value if math.isfinite(value) else None


def quantity_text(key: str, value: float) -> str:
    """A value with its unit."""
    if key == "E":
        factor, unit = pascal_unit(value)
        return with_minus(f"{value * factor:.4g} {unit}")
    if key in ("bending_length", "thickness"):
        return length_text(value)
    if key in RATIOS:
        return with_minus(f"{value:.3f}")
    if key == "damping":
        return with_minus(f"{1e3 * value:.3g} ms")
    unit = {"density": " kg/m³", "E_over_rho": " m²/s²"}[key]
    return with_minus(f"{value:.4g}{unit}")


def interval_text(key: str, interval: tuple[float, float]) -> str:
    """Both ends in one unit."""
    low, high = interval
    factor, unit = 1.0, {"density": "kg/m³", "E_over_rho": "m²/s²"}.get(key, "")
    if key == "E":
        factor, unit = pascal_unit(high)
    elif key in ("bending_length", "thickness"):
        factor, unit = 1e3, "mm"
    elif key == "damping":
        factor, unit = 1e3, "ms"
    low, high = factor * low, factor * high
    decimals = 3
    if key not in RATIOS:
        decimals = max(0, 3 - math.floor(math.log10(max(abs(high), 1e-9))))
    return with_minus(f"{low:.{decimals}f} to {high:.{decimals}f} {unit}".rstrip())


def difference_text(key: str, value: float, true: float) -> str:
    """Relative, but absolute for ratios, whose zero means nothing special."""
    if key in RATIOS or true == 0.0:
        return with_minus(f"{value - true:+.3f}")
    return with_minus(f"{100.0 * (value / true - 1.0):+.1f} %")


def pascal_unit(value: float) -> tuple[float, str]:
    """What to multiply pascals by, and the unit, in which a value is at least 1."""
    for factor, unit in ((1e-9, "GPa"), (1e-6, "MPa"), (1e-3, "kPa")):
        if abs(value) * factor >= 1.0:
            return factor, unit
    return 1.0, "Pa"


def length_text(value: float) -> str:
    """Metres from 1 m on, millimetres below; never finer than a tenth, but for tiny ones."""
    if abs(value) >= 1.0:
        return with_minus(f"{value:.2f} m")
    form = ".0f" if abs(value) >= 0.1 else ".1f" if abs(value) >= 1e-4 else ".2g"
    return with_minus(f"{1e3 * value:{form}} mm")


def property_text(name: str, value: float | str) -> str:
    """A property of the object by its name in a recording, to four digits and with its unit."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (str, int)):
        return str(value)
    if name == "mass":
        return with_minus(f"{value:.4g} kg")
    if name in ("length", "width", "height", "diameter", "thickness"):
        text = f"{value:.4g} m" if abs(value) >= 1.0 else f"{1e3 * value:.4g} mm"
        return with_minus(text)
    return with_minus(f"{value:.4g}")


def place_text(coordinates: np.ndarray) -> str:
    """Coordinates [D] [m]."""
    return with_minus(", ".join(f"{c:.3f}" for c in coordinates) + " m")


def with_minus(text: str) -> str:
    """`text` with minus signs for its hyphens."""
    return text.replace("-", "\N{MINUS SIGN}")
