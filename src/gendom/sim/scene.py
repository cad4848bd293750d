"""Surroundings of a body: a table and walls."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gendom.arguments import check_number, check_numbers
from gendom.errors import ParameterError
from gendom.materials import STANDARD_GRAVITY

GRAVITY = (0.0, 0.0, -STANDARD_GRAVITY)
"""Standard gravity, z up [m/s^2]."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """An impenetrable horizontal plane with Coulomb friction, which may differ between worlds.

    Raises:
        ParameterError: If a number is not finite, or friction is negative.
    """

    height: float
    """Height of the plane [m]."""
    friction: float | ArrayLike = 0.3
    """Coefficient of friction, one number or [W]."""

    def __post_init__(self) -> None:
        check_number("table height", self.height)
        check_numbers("friction", self.friction, (), ("W",), least=0.0)


@dataclass(frozen=True, kw_only=True)
class Box:
    """Walls: an axis-aligned box [m] that particles cannot leave.

    Raises:
        ParameterError: If a number is not finite, or ``lower`` is not below ``upper``.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    def __post_init__(self) -> None:
        lower = check_numbers("box lower", self.lower, (3,))
        upper = check_numbers("box upper", self.upper, (3,))
        if np.any(lower >= upper):
            raise ParameterError(f"box must have lower < upper, got {self.lower}, {self.upper}")
