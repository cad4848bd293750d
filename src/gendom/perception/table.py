"""The table in a depth picture, and how noisy the depth on it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

_SEARCH_RANGE = 0.06  # [m]; how far from the expected height the table is looked for
_FIT_RANGE = 0.03  # [m]; heights around the most frequent one that begin the fit
_MAX_TILT = np.radians(5.0)
_MIN_POINTS = 300
_MIN_SHARE = 0.03  # of the points in the workspace
_MAX_POINTS = 20_000  # more do not make the plane better than its calibration


@dataclass(frozen=True)
class TablePlane:
    """A plane as one camera sees it."""

    normal: npt.NDArray[np.float64]
    """[3] unit vector, upwards."""
    offset: float
    """Points p of the plane have normal . p = offset [m]."""
    noise: float
    """Depth noise over depth squared [1/m]: RMS = noise z^2, as stereo has it."""

    def height(self, x: float, y: float) -> float:
        """z of the plane at a place [m]."""
        return float((self.offset - self.normal[:2] @ [x, y]) / self.normal[2])

    def levelled(self, x: float, y: float, height: float) -> npt.NDArray[np.float64]:
        """The motion [4, 4] that makes the plane level and brings its point at a place [m] to a
        height [m], by the smallest turn."""
        place = np.array([x, y, self.height(x, y)])
        axis = np.cross(self.normal, [0.0, 0.0, 1.0])
        sine, cosine = np.linalg.norm(axis), self.normal[2]
        turn = axis * (np.arctan2(sine, cosine) / max(sine, 1e-12))
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
        T[:3, 3] = [x, y, height] - T[:3, :3] @ place
        return T


def fit_table(
    points: npt.NDArray[np.floating],
    directions: npt.NDArray[np.floating],
    depth: npt.NDArray[np.floating],
    *,
    expected_height: float | None = None,
) -> TablePlane | None:
    """The horizontal plane that most points lie on.

    Begins at the most frequent height and repeats least squares on the points within 2.5 robust
    standard deviations, so that objects on the table do not lift it. The noise is
    s / (f B) of the stereo model RMS = z^2 s / (f B), from the residuals along the rays.

    Args:
        points: [n, 3] in the world [m].
        directions: [n, 3] their rays in the world, of length such that depth 1 is one ray.
        depth: [n] along the camera's axis [m].
        expected_height: Where the table should be, z [m]; it is looked for within 6 cm. None:
            anywhere.

    Returns:
        The plane, or None where there is none: fewer than 300 points or 3 % on it, or tilted
        by more than 5 degrees.
    """
    total = len(points)
    if total > _MAX_POINTS:
        pick = np.random.default_rng(0).choice(total, _MAX_POINTS, replace=False)
        points, directions, depth = points[pick], directions[pick], depth[pick]
    p = points.astype(np.float64)
    z = p[:, 2]
    near = np.ones(len(z), bool)
    if expected_height is not None:
        near = np.abs(z - expected_height) < _SEARCH_RANGE
    if near.sum() < _MIN_POINTS:
        return None
    low = z[near].min()
    counts = np.bincount(((z[near] - low) / 0.01).astype(np.int64))
    counts = np.convolve(counts, [1, 1, 1], mode="same")
    peak = low + (counts.argmax() + 0.5) * 0.01
    keep = np.abs(z - peak) < _FIT_RANGE
    centre = p[keep].mean(axis=0)
    design = np.stack([p[:, 0] - centre[0], p[:, 1] - centre[1], np.ones(len(p))], axis=1)
    coefficients = np.zeros(3)
    for _ in range(10):
        if keep.sum() < max(_MIN_POINTS, _MIN_SHARE * len(p)):
            return None
        coefficients = np.linalg.lstsq(design[keep], z[keep], rcond=None)[0]
        residual = z - design @ coefficients
        spread = 1.4826 * np.median(np.abs(residual[keep] - np.median(residual[keep])))
        keep = np.abs(residual) < max(2.5 * spread, 5e-4)
    a, b, c = coefficients
    normal = np.array([-a, -b, 1.0]) / np.sqrt(1.0 + a * a + b * b)
    if normal[2] < np.cos(_MAX_TILT):
        return None
    offset = float(normal @ [centre[0], centre[1], c])
    # The window must not cut the noise that is measured here, so it is wide again.
    residual = p @ normal - offset
    slope = np.abs(directions @ normal)
    wide = (np.abs(residual) < _FIT_RANGE) & (slope > 0.1)
    scaled = np.abs(residual[wide] / (slope[wide] * depth[wide] ** 2))
    return TablePlane(normal, offset, float(1.4826 * np.median(scaled)))
