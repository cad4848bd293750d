"""Derivatives of the numbers of a thin body's model by one parameter of its worlds."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

WEAVE = ("warp", "weft", "shear")
"""Parameters of a shell's weave, in the order of the derivatives by it."""


def _none() -> Array:
    return np.zeros(())


@dataclass(frozen=True)
class Slopes:
    """Derivatives by one parameter, of W worlds with n points."""

    stiffness: Array = field(default_factory=_none)
    """[W, R, n] of the stiffness without grippers, or 0."""
    mass: Array = field(default_factory=_none)
    """[W, 1] of points' masses, over them, or 0."""
    inertia: Array = field(default_factory=_none)
    """[W, n] of edges' moments of inertia, over them, or 0."""
    drag: float = 0.0
    """Of the area that is exposed to the air, over it."""
    thickness: float = 0.0
    """Of the thickness at which the body touches."""
