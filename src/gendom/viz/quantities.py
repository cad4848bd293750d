"""Numbers as people read them: four digits at the most, with their unit."""

import math
from collections.abc import Iterable
from typing import Any

from gendom.materials.unknowns import UNKNOWNS

SHOWN_UNITS = {
    "m": (1e3, "mm"),
    "s": (1e3, "ms"),
    "rad": (180.0 / math.pi, "°"),
    "1": (1.0, ""),
    "m^2/s^2": (1.0, "m²/s²"),
    "kg/m^3": (1.0, "kg/m³"),
}
"""What numbers in SI units are multiplied by, and the unit, to be read."""

_OTHERS = {
    "E": ("Young's modulus", "Pa"),
    "density": ("density", "kg/m^3"),
    "bending_length": ("bending length", "m"),
    "thickness": ("diameter or thickness", "m"),
}
"""Title and unit of quantities that are no unknowns, or shown in another form."""


def title_of(key: str) -> str:
    """What people call a quantity, with a capital letter."""
    title = _OTHERS[key][0] if key in _OTHERS else UNKNOWNS[key].title
    return title[0].upper() + title[1:]


def unit_of(key: str, value: float = 0.0) -> tuple[float, str]:
    """What a quantity is multiplied by, and its unit, to be read."""
    unit = _OTHERS[key][1] if key in _OTHERS else UNKNOWNS[key].unit
    if unit == "Pa":
        large = ((1e-9, "GPa"), (1e-6, "MPa"), (1e-3, "kPa"))
        return next((of for of in large if abs(value) * of[0] >= 1.0), (1.0, "Pa"))
    return SHOWN_UNITS.get(unit, (1.0, unit))


def is_ratio(key: str) -> bool:
    """Whether a quantity has no unit and a linear scale: its zero means nothing special."""
    u = None if key in _OTHERS else UNKNOWNS[key]
    return u is not None and u.unit == "1" and not u.log


def quantity_text(key: str, value: float) -> str:
    """A value with its unit."""
    if is_ratio(key):
        return with_minus(f"{value:.3f}")
    factor, unit = unit_of(key, value)
    if unit == "mm":
        return length_text(value)
    return with_minus(f"{factor * value:.{3 if key == 'damping' else 4}g} {unit}".rstrip())


def interval_text(key: str, interval: tuple[float, float], value: float) -> str:
    """Both ends in the unit of a value."""
    factor, unit = unit_of(key, value)
    low, high = factor * interval[0], factor * interval[1]
    decimals = 3
    if not is_ratio(key):
        decimals = max(0, 3 - math.floor(math.log10(max(abs(high), 1e-9))))
    return with_minus(f"{low:.{decimals}f} to {high:.{decimals}f} {unit}".rstrip())


def difference_text(key: str, value: float, true: float) -> str:
    """Relative, but absolute for ratios."""
    if is_ratio(key) or true == 0.0:
        return with_minus(f"{value - true:+.3f}")
    return with_minus(f"{100.0 * (value / true - 1.0):+.1f} %")


def length_text(value: float) -> str:
    """Metres from 1 m on, millimetres below; never finer than a tenth, but for tiny ones."""
    if abs(value) >= 1.0:
        return with_minus(f"{value:.2f} m")
    form = ".0f" if abs(value) >= 0.1 else ".1f" if abs(value) >= 1e-4 else ".2g"
    return with_minus(f"{1e3 * value:{form}} mm")


def numbers_text(values: Iterable[Any], unit: str = "") -> str:
    """Three decimals each."""
    return with_minus(f"{', '.join(f'{v:.3f}' for v in values)} {unit}".rstrip())


def with_minus(text: str) -> str:
    """`text` with minus signs for its hyphens."""
    return text.replace("-", "\N{MINUS SIGN}")
