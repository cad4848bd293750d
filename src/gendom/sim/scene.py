"""Surroundings of a body: gravity and a table."""

from dataclasses import dataclass

from numpy.typing import ArrayLike

from gendom.arguments import check_number, check_numbers
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
