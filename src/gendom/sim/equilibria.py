"""Shapes at rest, frame by frame."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Equilibria:
    """What ``Simulator.equilibria`` found in T frames of W worlds."""

    times: NDArray[np.float64]
    """[T] [s]."""
    positions: NDArray[np.floating]
    """[T, W, N, 3] points [m]; NaN where a world failed."""
    residual: NDArray[np.float64]
    """[T, W] largest force that is not balanced over the weight of the point at standard gravity,
    or of rods a torque over that weight and an edge's length [-]."""
    converged: NDArray[np.bool_]
    """[T, W] whether that is at most the tolerance."""
    steps: NDArray[np.int64]
    """[T, W] steps of relaxation."""
    solves: NDArray[np.int64]
    """[T, W] linear systems solved."""
    derivatives: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    """[T, W, N, 3] of positions by each parameter that was asked for, with further axes last: see
    ``Simulator.equilibria``."""
