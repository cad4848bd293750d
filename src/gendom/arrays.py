"""The type of arrays of floating point numbers, whose shapes and units docstrings give; poses."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]


def rigid(R: ArrayLike, t: ArrayLike) -> Array:
    """[4, 4] transform of a rotation [3, 3] and a shift of three numbers [m]."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, np.ravel(t)
    return T


def quaternion(R: Array) -> Array:
    """[4] unit quaternion, scalar last, of a rotation [3, 3]; as SciPy's, which takes long to
    import."""
    (a, b, c), trace = R, np.trace(R)
    k = int(np.argmax([a[0], b[1], c[2], trace]))
    q = np.array([c[1] - b[2], a[2] - c[0], b[0] - a[1], 1.0 + trace])
    if k < 3:
        i, j = (k + 1) % 3, (k + 2) % 3
        q[3], q[k] = q[k], 1.0 - trace + 2.0 * R[k, k]
        q[i], q[j] = R[i, k] + R[k, i], R[j, k] + R[k, j]
    return q / np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])


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


def of_each(every: Sequence[Any], what: Callable[[Any], Any]) -> Array:
    """[W, ...] what is said of each of W things, which often are all the same one."""
    if len(set(map(id, every))) == 1:
        return np.repeat(np.array(what(every[0]))[None], len(every), axis=0)
    return np.array(list(map(what, every)))


def distinct(rows: Array) -> tuple[Array, NDArray[np.intp]]:
    """The different ones of some rows [n, k], and which of them each is [n]."""
    if (rows == rows[:1]).all():
        return rows[:1], np.zeros(len(rows), dtype=int)
    ways, which = np.unique(rows, axis=0, return_inverse=True)
    return ways, which.reshape(-1)
