"""Chamfer distance between two point clouds."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from gendom.arguments import require


def chamfer(a: ArrayLike, b: ArrayLike, *, of_b: NDArray[np.bool_] | None = None) -> float:
    """Mean distance from A to its nearest in B plus mean distance from B to its nearest in A [m].

    This is the definition that the GenDOM authors' figures follow: distances, not their squares,
    and a sum of both directions, not their mean.

    Args:
        a, b: [n, 3] and [m, 3] points [m].
        of_b: [m] the points of B that A could show at all: only these count in the second mean,
            while all of B may be nearest to a point of A. None counts all.

    Raises:
        ParameterError: If a cloud is empty or has the wrong shape.
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    for name, cloud in (("a", a), ("b", b)):
        right = cloud.ndim == 2 and cloud.shape[1] == 3 and len(cloud) > 0
        require(right, f"chamfer needs clouds [n > 0, 3], {name} is {cloud.shape}")
    to_b = KDTree(b).query(a)[0]
    counted = b if of_b is None or not np.any(of_b) else b[of_b]
    to_a = KDTree(a).query(counted)[0]
    return float(to_b.mean() + to_a.mean())
