"""Surroundings of a body: a table and walls."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gendom.errors import ParameterError
from gendom.materials import STANDARD_GRAVITY

GRAVITY = (0.0, 0.0, -STANDARD_GRAVITY)
"""Standard gravity, z up [m/s^2]."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """An impenetrable horizontal plane with Coulomb friction, which may differ between worlds."""

    height: float
    """Height of the plane [m]."""
    friction: float | ArrayLike = 0.3
    """Coefficient of friction, one number or [W]."""

    def __post_init__(self) -> None:
        check_numbers("table height", self.height)
        check_numbers("friction", self.friction, least=0.0)


@dataclass(frozen=True, kw_only=True)
class Box:
    """Walls: an axis-aligned box [m] that particles cannot leave."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    def __post_init__(self) -> None:
        check_numbers("box", (self.lower, self.upper))
        if np.any(np.asarray(self.lower) >= np.asarray(self.upper)):
            raise ParameterError(f"box must have lower < upper, got {self.lower}, {self.upper}")


def check_numbers(
    name: str, values: ArrayLike, *, least: float = -math.inf, above: float = -math.inf
) -> None:
    """Check that numbers are finite, at least ``least`` and greater than ``above``.

    Raises:
        ParameterError: If they are not; the error names the parameter and the values.
    """
    a = np.asarray(values, dtype=float)
    if not np.isfinite(a).all() or (a < least).any() or (a <= above).any():
        limit = f" and above {above:g}" if above > -math.inf else ""
        limit = f" and at least {least:g}" if least > -math.inf else limit
        raise ParameterError(f"{name} must be finite{limit}, got {values}")
