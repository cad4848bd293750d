"""The type of arrays of floating point numbers, whose shapes and units docstrings give; poses."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]


def rigid(R: ArrayLike, t: ArrayLike) -> Array:
    """[4, 4] transform of a rotation [3, 3] and a shift of three numbers [m]."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, np.ravel(t)
    return T


def placed(T: Array, points: ArrayLike) -> Array:
    """Points [..., 3] of the frame whose pose is T [4, 4], in that in which T is given."""
    return np.asarray(points, dtype=float) @ T[:3, :3].T + T[:3, 3]
