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


def outwards(hull: Any) -> Array:
    """[T, 3] points of the triangles of a convex hull (SciPy's), anticlockwise from outside."""
    faces = hull.simplices.copy()
    a, b, c = np.moveaxis(hull.points[faces], 1, 0)
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inwards] = faces[inwards, ::-1]
    return faces
