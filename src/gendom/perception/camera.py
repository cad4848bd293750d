"""A depth camera's model: intrinsics, distortion, depth unit and pose.

Axes are OpenCV's: x right, y down, z forward; pixel (0, 0) is centred at u = v = 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from gendom.arguments import Shape, fits
from gendom.arrays import Array
from gendom.reading import MOST_DEPTHS, MOST_PIXELS
from gendom.reading import wanted as expect

MAX_DISTANCE = 20.0
"""What is farther from the robot's base than this [m] was given in millimetres."""

_DISTORTION_LENGTHS = (0, 4, 5, 8)


@dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """A pinhole camera with OpenCV's distortion, at rest in the world.

    Raises:
        RecordingError: A value is invalid; the error names it and the expected value.
    """

    name: str
    """What messages call it."""
    width: int
    """Columns of its pictures."""
    height: int
    """Rows."""
    K: Array
    """[3, 3] intrinsic matrix [pixels]."""
    T_world_camera: Array | None
    """[4, 4] camera to world [m]; None: not calibrated yet."""
    depth_unit: float = 1e-3
    """Metres a count of the depth pictures."""
    distortion: tuple[float, ...] = ()
    """OpenCV's k1, k2, p1, p2[, k3[, k4, k5, k6]]; empty: none."""

    def __post_init__(self):
        shapes = {"K": (3, 3), "T_world_camera": (4, 4), "depth_unit": (), "distortion": ("n",)}
        for name, shape in shapes.items():
            if (value := getattr(self, name)) is not None or name != "T_world_camera":
                array = _numbers(value, shape, f"{self.name}: {name}")
                array.flags.writeable = False
                object.__setattr__(self, name, array if array.ndim == 2 else array.tolist())
        object.__setattr__(self, "distortion", tuple(self.distortion))
        for right, key, what, fix in self._checks():
            expect(right, what, f"{self.name}: {key}", fix)

    def _checks(self) -> Iterator[tuple[Any, str, str, str]]:
        """(whether it is right, key, what is wrong if not, fix) of everything."""
        K, T, width, height = self.K, self.T_world_camera, self.width, self.height
        for key in ("width", "height"):
            value = getattr(self, key)
            yield isinstance(value, int), key, f"is {value!r}", "give pixels"
        fix = f"give the pictures' size, {MOST_PIXELS} pixels at most"
        right = width >= 1 and height >= 1 and width * height <= MOST_PIXELS
        yield right, "width, height", f"is {width} x {height}", fix
        fix = "give metres a count: 0.001 for depth in millimetres"
        yield self.depth_unit > 0.0, "depth_unit", f"is {self.depth_unit}", fix
        fix = "give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels, fx and fy above 0"
        right = K[0, 0] > 0 and K[1, 1] > 0 and np.allclose(K[2], [0, 0, 1]) and K[1, 0] == 0
        yield right, "K", "is no intrinsic matrix", fix
        what = f"has its centre ({K[0, 2]:g}, {K[1, 2]:g}) outside {width} x {height}"
        fix = "take the intrinsics of the stream with these pictures' size"
        yield -1 < K[0, 2] < width and -1 < K[1, 2] < height, "K", what, fix
        count, fix = len(self.distortion), "give none, or 4, 5 or 8 of OpenCV's k1, k2, p1, p2, "
        right, what = count in _DISTORTION_LENGTHS, f"has {count} numbers"
        yield right, "distortion", what, f"{fix}k3, k4, k5, k6"
        if T is not None:
            R, distance, key = T[:3, :3], np.linalg.norm(T[:3, 3]), "T_world_camera"
            right = np.allclose(R @ R.T, np.eye(3), atol=1e-3) and np.linalg.det(R) >= 0
            fix = "give [[R, t], [0, 0, 0, 1]] with a rotation R and t in metres"
            right = right and np.allclose(T[3], [0, 0, 0, 1])
            yield right, key, "is no rigid transform", fix
            what, fix = f"puts the camera {distance:.4g} m from the robot's base", "give t in "
            yield distance <= MAX_DISTANCE, key, what, f"{fix}metres, not millimetres"

    @property
    def position(self) -> Array:
        """[3] optical centre in the world [m]; RecordingError: the camera is not calibrated."""
        return self.calibrated()[:3, 3]

    def calibrated(self) -> Array:
        """`T_world_camera`, [4, 4] [m]; RecordingError: it is not known."""
        T, where = self.T_world_camera, f"{self.name}: T_world_camera"
        expect(T is not None, "is missing", where, "measure it with gendom calibrate")
        assert T is not None
        return T

    def rays(self, rows: slice = slice(None)) -> Array:
        """[n, 3] directions of the pixels of some rows, row after row, in the camera's axes.

        Their z is 1: a pixel of depth z is at z times its ray. Distortion is taken out.

        Raises:
            RecordingError: The camera has more pixels than pictures of depth have.
        """
        what, many = f"{self.width} x {self.height} pixels", self.width * self.height > MOST_DEPTHS
        fix = f"record depth of {MOST_DEPTHS} pixels at most"
        expect(not many, what, self.name, fix)
        v, u = np.mgrid[: self.height, : self.width][:, rows].astype(np.float64)
        pixels = np.stack([u.ravel(), v.ravel()], axis=1)
        if any(self.distortion):
            import cv2

            # OpenCV's inverse is iterative; five rounds, its default, leave a tenth of a pixel
            # in the corners of a wide lens.
            stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-7)
            xy = cv2.undistortPointsIter(
                pixels[:, None], self.K, np.array(self.distortion), np.eye(3), np.eye(3), stop
            ).reshape(-1, 2)
        else:
            K = self.K
            y = (pixels[:, 1] - K[1, 2]) / K[1, 1]
            xy = np.stack([(pixels[:, 0] - K[0, 2] - K[0, 1] * y) / K[0, 0], y], axis=1)
        return np.column_stack([xy, np.ones(len(xy))])

    def pixels(self, points: Array) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
        """Columns and rows [n, 2] of the pixels nearest to points [n, 3] before the camera, in its
        axes [m], and which [n] are in the picture."""
        if any(self.distortion):
            import cv2

            none = np.zeros(3)
            points = np.asarray(points, np.float64)
            uv = cv2.projectPoints(points, none, none, self.K, np.array(self.distortion))[0][:, 0]
        else:
            uv = points[:, :2] / points[:, 2:] @ self.K[:2, :2].T + self.K[:2, 2]
        # Rays far outside of the lens would not fit an integer.
        found = np.rint(np.clip(uv, -1.0, 1e6)).astype(np.int64)
        x, y = found.T
        inside = (x >= 0) & (y >= 0) & (x < self.width) & (y < self.height)
        return found, np.asarray(inside)

    def check_size(self, picture: npt.NDArray, where: str) -> None:
        """RecordingError: a picture [height, width, ...], which messages call `where`, has not the
        size of this camera's."""
        (height, width), own = picture.shape[:2], f"{self.width} x {self.height}"
        fix = "give the intrinsics of these pictures, colour and masks aligned with depth"
        right = (width, height) == (self.width, self.height)
        expect(right, f"is {width} x {height}, the camera {own}", where, fix)

    def at(self, T_world_camera: npt.ArrayLike) -> Camera:
        """The same camera at another pose, [4, 4] [m]."""
        return replace(self, T_world_camera=np.asarray(T_world_camera, dtype=np.float64))


def _numbers(value: Any, shape: Shape, where: str) -> np.ndarray:
    """`value` as finite float64 of a shape; "n" in it is any length."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    what, fix = "is not a number", "give one number"
    if shape:
        what, fix = f"is not {'x'.join(map(str, shape))} numbers", "give finite numbers in brackets"
    expect(fits(array.shape, shape) and np.isfinite(array).all(), what, where, fix)
    return array
