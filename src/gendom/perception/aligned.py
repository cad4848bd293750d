"""Depth pictures and the colour beside them, which a sensor of its own saw."""

from collections.abc import Iterable, Iterator

import numpy as np
import numpy.typing as npt

from gendom.perception.camera import Camera, expect
from gendom.perception.frames import SYNC_TOLERANCE, Frame, Pictures

# What hides a point is nearer by this share of its depth, besides the change of depth over two
# cells of a surface whose slope is this many pixels' widths a pixel.
_MIN_NEARER_SHARE = 0.02
_MAX_DEPTH_SLOPE = 5.0


def aligned(
    camera: Camera,
    depths: Iterable[Frame],
    colour: Camera | None = None,
    colours: Iterable[Frame] = (),
    T_colour_depth: npt.ArrayLike = np.nan,
) -> Iterator[Frame]:
    """A camera's depth pictures, each with the nearest colour picture in its pixels.

    Args:
        camera: Of the depth pictures.
        depths, colours: Frames in order of time whose `read` gives one picture: [height, width]
            uint16, and [height, width, 3] uint8, RGB.
        colour: Camera of the colour pictures; None: there are none.
        T_colour_depth: [4, 4] from the depth camera's axes to the colour camera's [m].

    Reading raises `RecordingError` where a picture is not of its camera's size, or no colour is
    within `SYNC_TOLERANCE`.
    """
    align = None if colour is None else Alignment(camera, colour, T_colour_depth)

    def read(frame: Frame, beside: Frame | None) -> Pictures:
        depth = _sized(frame, camera, np.uint16)
        if align is None:
            return Pictures(depth)
        late = abs(beside.time - frame.time) if beside else np.inf
        what, fix = f"the nearest colour picture is {late:.3g} s away", "record colour at the rate "
        expect(beside and late <= SYNC_TOLERANCE, what, frame.where, f"{fix}of depth")
        assert beside is not None
        return align(depth, _sized(beside, align.colour, np.uint8))

    stream = iter(colours)
    near, after = next(stream, None), next(stream, None)
    for frame in depths:
        while near and after and abs(after.time - frame.time) <= abs(near.time - frame.time):
            near, after = after, next(stream, None)
        yield Frame(frame.time, frame.where, lambda f=frame, c=near: read(f, c))


def _sized(frame: Frame, camera: Camera, kind: type) -> npt.NDArray:
    """A picture, which has its camera's size and is of a kind of numbers."""
    picture = frame.read()
    what, fix = f"holds {picture.dtype}, not {np.dtype(kind)}", "record depth, or colour as rgb8"
    expect(picture.dtype == kind, what, frame.where, fix)
    camera.check_size(picture, frame.where)
    return picture


class Alignment:
    """Assign each depth pixel the colour of its point.

    Pixels without depth, and those whose point is outside the colour camera's view, become black.
    Where a nearer object occludes a point from the colour camera, the colour would be that of the
    nearer object; the depth of such pixels, at the edges of near objects, is removed.

    `T_colour_depth` [4, 4] leads from the depth camera's axes to the colour camera's [m]; neither
    their poses in the world nor the latter's depth unit matter.
    """

    def __init__(self, depth: Camera, colour: Camera, T_colour_depth: npt.ArrayLike):
        T = np.asarray(T_colour_depth, dtype=np.float64)
        self._unit = np.float32(depth.depth_unit)
        self.colour = colour
        self._rays = (depth.rays() @ T[:3, :3].T).astype(np.float32)
        self._shift = T[:3, 3].astype(np.float32)
        # The colour picture in cells of about a depth pixel's size, to find what hides what.
        self._cell = max(1.0, float(colour.K[0, 0] / depth.K[0, 0]))
        self._nearer = np.float32(1.0 + _MIN_NEARER_SHARE + 2.0 * _MAX_DEPTH_SLOPE / depth.K[0, 0])
        self._same = (
            np.allclose(T, np.eye(4), atol=1e-6)
            and (depth.width, depth.height) == (colour.width, colour.height)
            and np.allclose(depth.K, colour.K, atol=1e-3)
            and np.allclose(_five(depth), _five(colour), atol=1e-6)
        )

    def __call__(self, depth: npt.NDArray[np.uint16], colour: npt.NDArray[np.uint8]) -> Pictures:
        """Depth [height, width] in counts and colour [height, width, 3] of its own camera's size,
        both in the depth camera's pixels."""
        if self._same:
            return Pictures(depth, colour)
        raw = depth.ravel()
        pixels = np.flatnonzero(raw)
        points = self._rays[pixels] * (raw[pixels] * self._unit)[:, None] + self._shift
        front = points[:, 2] > 0.0
        pixels, points = pixels[front], points[front]
        found, inside = self.colour.pixels(points)
        pixels, z, (u, v) = pixels[inside], points[inside, 2], found[inside].T
        hidden = self._hidden(z, u, v)
        kept, painted = raw.copy(), np.zeros((len(raw), 3), np.uint8)
        kept[pixels[hidden]] = 0
        seen = ~hidden
        painted[pixels[seen]] = colour[v[seen], u[seen]]
        return Pictures(kept.reshape(depth.shape), painted.reshape(*depth.shape, 3))

    def _hidden(self, z: np.ndarray, u: np.ndarray, v: np.ndarray) -> npt.NDArray[np.bool_]:
        """Which points [n] of depth z [m] have something nearer within a cell of theirs."""
        columns = int(self.colour.width / self._cell) + 3
        rows = int(self.colour.height / self._cell) + 3
        cell = ((v / self._cell).astype(np.int64) + 1) * columns + (u / self._cell).astype(int) + 1
        nearest = np.full(rows * columns, np.inf, np.float32)
        np.minimum.at(nearest, cell, z)
        around = nearest[cell]
        for step in np.add.outer((-columns, 0, columns), (-1, 0, 1)).ravel():
            np.minimum(around, nearest[cell + step], out=around)
        return z > self._nearer * around


def _five(camera: Camera) -> tuple[float, ...]:
    """k1, k2, p1, p2, k3 of a camera with at most these."""
    return (*camera.distortion, *[0.0] * 5)[:5]
