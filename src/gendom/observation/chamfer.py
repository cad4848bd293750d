"""Chamfer distance between two point clouds."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from gendom.errors import ParameterError


def chamfer(a: ArrayLike, b: ArrayLike) -> float:
    """Mean distance from A to its nearest in B plus mean distance from B to its nearest in A [m].

    This is the definition that the GenDOM authors' figures follow: distances, not their squares,
    and a sum of both directions, not their mean.

    Args:
        a, b: [n, 3] and [m, 3] points [m].

    Raises:
        ParameterError: If a cloud is empty or has the wrong shape.
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    for name, cloud in (("a", a), ("b", b)):
        if cloud.ndim != 2 or cloud.shape[1] != 3 or len(cloud) == 0:
            raise ParameterError(f"chamfer needs clouds [n > 0, 3], {name} is {cloud.shape}")
    to_b = cKDTree(b).query(a)[0]
    to_a = cKDTree(a).query(b)[0]
    return float(to_b.mean() + to_a.mean())
