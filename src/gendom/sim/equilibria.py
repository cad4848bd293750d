"""Static equilibria, frame by frame."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Equilibria:
    """Result of ``Simulator.equilibria`` for T frames of W worlds."""

    times: NDArray[np.float64]
    """[T] times of the frames [s]."""
    positions: NDArray[np.floating]
    """[T, W, N, 3] points [m]; NaN where a world failed."""
    residual: NDArray[np.float64]
    """[T, W] largest unbalanced force on a point over the point's weight (at standard gravity
    where there is none), or,
    for rods, unbalanced torque over that weight times an edge's length [-]."""
    converged: NDArray[np.bool_]
    """[T, W] whether the residual is at most the tolerance."""
    steps: NDArray[np.int64]
    """[T, W] number of relaxation steps."""
    solves: NDArray[np.int64]
    """[T, W] number of linear systems solved."""
    derivatives: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    """[T, W, N, 3] derivatives of positions with respect to each requested parameter; axes of the
    parameter come last, see ``Simulator.equilibria``."""
