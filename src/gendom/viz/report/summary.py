"""What a report reads of an estimate, and its numbers as people read them: four digits at the most,
with their unit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gendom.materials.unknowns import UNKNOWNS

RATIOS = tuple(n for n, u in UNKNOWNS.items() if u.material and u.unit == "1" and not u.log)
"""Quantities without a unit, on a linear scale."""

SHOWN_UNITS = {
    "m": (1e3, "mm"),
    "s": (1e3, "ms"),
    "rad": (180.0 / math.pi, "°"),
    "1": (1.0, ""),
    "m^2/s^2": (1.0, "m²/s²"),
    "kg/m^3": (1.0, "kg/m³"),
}
"""What numbers in SI units are multiplied by, and the unit, to be read."""

# Of quantities that are no unknowns, or shown in another form.
_UNITS = {"density": "kg/m^3", "bending_length": "m", "thickness": "m"}
_TITLES = {
    "E": "Young's modulus",
    "density": "density",
    "E_over_rho": "specific modulus E / ρ",
    "bending_length": "bending length",
    "thickness": "diameter or thickness",
}


def title_of(key: str) -> str:
    """What people call a quantity, with a capital letter."""
    title = _TITLES.get(key) or (UNKNOWNS[key].title if key in UNKNOWNS else key.replace("_", " "))
    return title[0].upper() + title[1:]


def unit_of(key: str, value: float = 0.0) -> tuple[float, str]:
    """What a quantity is multiplied by, and its unit, to be read."""
    if key == "E":
        return pascal_unit(value)
    unit = _UNITS.get(key) or (UNKNOWNS[key].unit if key in UNKNOWNS else "")
    return SHOWN_UNITS.get(unit, (1.0, unit))


@dataclass(frozen=True, kw_only=True)
class EstimateSummary:
    """What was estimated, and what is known besides."""

    values: Mapping[str, Any]
    """An estimate's record (gendom-estimate/1), in SI units."""
    truth: Mapping[str, float] | None = None
    """True values under the keys of `values`, as far as known."""

    def value(self, key: str) -> float | None:
        """What was estimated, in the unit of `values`."""
        return finite(self.values.get(key))

    def true(self, key: str) -> float | None:
        """The true value, where it is known."""
        return finite((self.truth or {}).get(key))

    def interval(self, key: str) -> tuple[float, float] | None:
        """Lowest and highest plausible value."""
        ends = (self.values.get("intervals") or {}).get(key)
        return None if ends is None else (float(ends[0]), float(ends[1]))

    @property
    def level(self) -> float | None:
        """How probable the intervals are, from 0 to 1."""
        return finite((self.values.get("intervals") or {}).get("level"))

    @property
    def level_text(self) -> str:
        """How probable the intervals are: "90 %"."""
        return "" if self.level is None else f"{100.0 * self.level:g} %"

    @property
    def usable(self) -> bool | None:
        """Whether the estimate is of any use; None: not said."""
        return (self.values.get("verdict") or {}).get("usable")

    def determined(self, key: str) -> bool | None:
        """Whether the lift determines a parameter; None: not said."""
        return (self.values.get("identifiable") or {}).get(key)


def finite(value: Any) -> float | None:
    """A finite float, or None."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    return float(value) if math.isfinite(value) else None


def quantity_text(key: str, value: float) -> str:
    """A value with its unit."""
    if key in RATIOS:
        return with_minus(f"{value:.3f}")
    factor, unit = unit_of(key, value)
    if unit == "mm":
        return length_text(value)
    return with_minus(f"{factor * value:.{3 if key == 'damping' else 4}g} {unit}".rstrip())


def interval_text(key: str, interval: tuple[float, float]) -> str:
    """Both ends in one unit."""
    factor, unit = unit_of(key, interval[1])
    low, high = factor * interval[0], factor * interval[1]
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


def place_text(coordinates: np.ndarray) -> str:
    """Coordinates [D] [m]."""
    return with_minus(", ".join(f"{c:.3f}" for c in coordinates) + " m")


def with_minus(text: str) -> str:
    """`text` with minus signs for its hyphens."""
    return text.replace("-", "\N{MINUS SIGN}")
