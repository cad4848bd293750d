"""Error models of a stereo depth camera, `observe`, and of a camera rig, `RigErrors`.

The values are those of an Intel RealSense D435i. Stereo measures disparity d = f B / z in
pixels (f: focal length in pixels, B: baseline), so errors are added to the disparity: an error s
of the disparity gives an error z^2 s / (f B) of the depth, and quantised disparity gives depth
steps that grow with z^2 (Keselman et al., "Intel RealSense Stereoscopic Depth Cameras", 2017,
section 2). Random errors are drawn independently for each pixel and picture, so a pixel lost in
one picture can be present in the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter
from scipy.spatial.transform import Rotation

from gendom.arrays import Array
from gendom.perception import Camera, Pictures

BASELINE = 0.05
"""Distance of the two imagers, B [m] (D400 series data sheet)."""

SUBPIXEL = 0.08
"""Standard deviation of the disparity, s [pixel]; 0.05 to 0.1 is usual for a well textured
surface."""

CORRELATION = 2.0
"""Correlation length of the noise: white noise is blurred by a Gaussian of this standard
deviation [pixel], with unchanged RMS. 2.0 corresponds to the 7 x 7 windows that the R200 of
Keselman et al. sums over; the D400's filters are not published."""

QUANTISATION = 1.0 / 32.0
"""Quantisation step of the disparity [pixel] (Grunnet-Jepsen et al., "Subpixel linearity
improvement for Intel RealSense depth cameras", 2019)."""

EDGE_STEP = 0.25
"""An edge is where the disparity departs by more than this [pixel] from a straight line through
three pixels, on which any plane lies; the pixel on either side of it is affected."""

EDGE_LOST, EDGE_MIXED = 0.5, 0.25
"""Shares of the pixels at edges that have no depth, and mixed depth ("flying pixels"): their
disparity is uniformly distributed between the smallest and the largest in their neighbourhood."""

GRAZING_FROM, GRAZING_TO = np.radians(65.0), np.radians(85.0)
"""Angle between ray and normal [rad] from which pixels are lost: none at this angle, and linearly
more up to the second, at which all are."""

DROPOUT = 0.005
"""Share of all other pixels that have no depth."""

MIN_RANGE, MAX_RANGE = 0.17, 3.0
"""Smallest and largest measurable depth [m]. 126 disparities are searched, which gives
z = f B / 126: 0.17 m for 848 x 480; 3 m is the end of the data sheet's ideal range."""

COLOUR_NOISE = 2.0
"""Standard deviation of colour noise, on the scale 0 to 255."""

Mask = npt.NDArray[np.bool_]


def observe(
    depth: npt.ArrayLike,
    colour: npt.NDArray[np.uint8],
    camera: Camera,
    rng: np.random.Generator,
    *,
    noisy: bool = True,
    times: float = 1.0,
) -> Pictures:
    """Add the sensor's errors to clean pictures of the camera's size.

    There is no depth where the right imager does not see a point of the left one, i.e. to the left
    of near objects and in the f B / z leftmost columns.

    Args:
        depth: [height, width] along the optical axis [m]; 0 or infinity: no surface.
        colour: [height, width, 3] aligned with depth.
        camera: Its K scales disparity, its depth_unit the counts. Lens distortion is ignored,
            because the stereo matching of a D400 works on rectified pictures.
        rng: Random number generator.
        times: Noise of the disparity, over `SUBPIXEL`.
        noisy: False for depth that is only rounded to the depth unit, and the colour as it is.

    Returns:
        Depth in counts of `camera.depth_unit`, colour with noise.
    """
    z = np.asarray(depth, dtype=np.float64)
    if not noisy:
        return Pictures(_counted(np.where(np.isfinite(z), z, 0.0), camera), colour)
    counts = _counted(_measured(z, camera, rng, times), camera)
    noise = colour + COLOUR_NOISE * rng.standard_normal(colour.shape)
    return Pictures(counts, np.clip(np.rint(noise), 0.0, 255.0).astype(np.uint8))


def _counted(z: Array, camera: Camera) -> npt.NDArray[np.uint16]:
    """Depth [m] in counts of the depth unit, 0 where it is beyond what they hold."""
    counts = np.round(z / camera.depth_unit)
    return np.where(counts > 65535.0, 0.0, counts).astype(np.uint16)


def _measured(z: Array, camera: Camera, rng: np.random.Generator, times: float) -> Array:
    """Measured depth [m], 0 where there is none."""
    seen = (z > 0.0) & np.isfinite(z)
    fB = camera.K[0, 0] * BASELINE
    # Where nothing is, nothing is infinitely far away.
    clean = np.divide(fB, z, out=np.zeros_like(z), where=seen)
    disparity = clean.copy()
    lost, mixed = _at_edges(clean, seen, rng)
    disparity[mixed] = _between(clean, seen, mixed, rng)
    seen &= ~lost & ~_in_shadow(clean) & ~_grazed(clean / fB, camera, rng)
    seen &= rng.random(z.shape) >= DROPOUT
    noise = gaussian_filter(rng.standard_normal(z.shape), CORRELATION, mode="wrap", truncate=6.0)
    # blurred, white noise has an RMS of 1 / (2 sqrt(pi) of these pixels)
    disparity += times * SUBPIXEL * max(2.0 * np.sqrt(np.pi) * CORRELATION, 1.0) * noise
    disparity = np.round(disparity / QUANTISATION) * QUANTISATION
    seen &= disparity > 0.0
    measured = np.divide(fB, disparity, out=np.zeros_like(z), where=seen)
    return np.where((measured >= MIN_RANGE) & (measured <= MAX_RANGE), measured, 0.0)


def _at_edges(disparity: Array, seen: Mask, rng: np.random.Generator) -> tuple[Mask, Mask]:
    """Masks [height, width] of the pixels lost at edges, and of those with mixed depth."""
    edge = np.zeros(disparity.shape, dtype=bool)
    for axis in (0, 1):
        bend = np.abs(np.diff(disparity, n=2, axis=axis)) > EDGE_STEP
        np.moveaxis(edge, axis, 0)[1:-1] |= np.moveaxis(bend, axis, 0)
    # The bend is at both pixels next to the edge.
    near = edge & seen
    draw = rng.random(disparity.shape)
    lost = near & (draw < EDGE_LOST)
    return lost, near & ~lost & (draw < EDGE_LOST + EDGE_MIXED)


def _grazed(inverse: Array, camera: Camera, rng: np.random.Generator) -> Mask:
    """Pixels [height, width] lost to steep surfaces.

    In a picture a plane n . p = h has 1 / z = n . ray / h, linear in the ray: the
    derivatives of 1 / z are the normal.

    Args:
        inverse: 1 / z [1/m], 0 where nothing is.
        camera: That sees it.
        rng: Random number generator.
    """
    x, y, squared = _rays(camera)
    normal_x = camera.K[0, 0] * _slope(inverse, 1)
    normal_y = camera.K[1, 1] * _slope(inverse, 0) - camera.K[0, 1] / camera.K[0, 0] * normal_x
    normal_z = inverse - normal_x * x - normal_y * y
    length = np.sqrt((normal_x**2 + normal_y**2 + normal_z**2) * squared)
    cosine = np.divide(inverse, length, out=np.ones_like(inverse), where=length > 0.0)
    draw = rng.random(inverse.shape)
    # Most are less steep than `GRAZING_FROM`: leave their arc cosine out.
    steep = cosine < np.cos(GRAZING_FROM)
    angle = np.arccos(np.clip(cosine[steep], 0.0, 1.0))
    steep[steep] = draw[steep] < (angle - GRAZING_FROM) / (GRAZING_TO - GRAZING_FROM)
    return steep


@dataclass(frozen=True, kw_only=True)
class RigErrors:
    """Errors of calibration and synchronisation of a pair of cameras and a robot."""

    translation: float = 2e-3
    """RMS size of the error of a camera's position [m]."""
    rotation: float = np.radians(0.3)
    """RMS angle of the error of its direction [rad]."""
    clock_offset: float = 0.02
    """Offset of the clocks of all other cameras ahead of the first camera's [s]."""

    @classmethod
    def synchronised(cls) -> RigErrors:
        """Return a rig whose cameras are synchronised by cable."""
        return cls(clock_offset=0.001)

    def believed(self, cameras: Sequence[Camera], rng: np.random.Generator) -> list[Camera]:
        """The cameras with erroneous calibrated poses, to be stored with their pictures.

        Each is translated by a vector and rotated about its centre by a rotation vector. Both have
        independent, identically distributed normal components, scaled so that their lengths have
        the given RMS; a third of the draws is longer.

        Raises:
            RecordingError: One is not calibrated.
        """
        found = []
        for camera in cameras:
            T = np.array(camera.calibrated(), dtype=np.float64)
            moved, turned = rng.normal(0.0, np.sqrt(1.0 / 3.0), (2, 3))
            T[:3, 3] += self.translation * moved
            T[:3, :3] = Rotation.from_rotvec(self.rotation * turned).as_matrix() @ T[:3, :3]
            found.append(camera.at(T))
        return found

    def stamp(self, camera: int, time: float) -> float:
        """Time stamp [s] that the camera with this index assigns to a true time [s]."""
        return time + (self.clock_offset if camera > 0 else 0.0)


@lru_cache(maxsize=4)
def _rays(camera: Camera) -> tuple[Array, ...]:
    """x, y and squared length of the pixels' rays, [height, width] each; cached for each camera."""
    x, y, _ = camera.rays().T.reshape(3, camera.height, camera.width)
    return np.ascontiguousarray(x), np.ascontiguousarray(y), x**2 + y**2 + 1.0


def _in_shadow(disparity: Array) -> Mask:
    """Pixels [height, width] of the left imager that the right one does not see.

    A pixel of column u is at u - disparity in the right picture. It is outside the picture if that
    is negative, and occluded if a pixel of larger u, which is then nearer, is at the same column
    or further left.
    """
    right = np.arange(disparity.shape[1]) - disparity
    hidden = np.zeros(disparity.shape, dtype=bool)
    leftmost = np.minimum.accumulate(right[:, ::-1], axis=1)[:, ::-1]
    hidden[:, :-1] = leftmost[:, 1:] <= right[:, :-1]
    return hidden | (right < 0.0)


def _slope(values: Array, axis: int) -> Array:
    """Derivative by pixel along an axis: the smaller of both one-sided differences.

    At an edge the smaller difference is the slope of the pixel's own surface, so that edges do
    not count as slopes.
    """
    steps = np.moveaxis(np.diff(values, axis=axis), axis, 0)
    size = np.abs(steps)
    slope = np.empty_like(values)
    along = np.moveaxis(slope, axis, 0)
    along[0], along[-1] = steps[0], steps[-1]
    along[1:-1] = np.where(size[:-1] <= size[1:], steps[:-1], steps[1:])
    return slope


def _between(disparity: Array, seen: Mask, chosen: Mask, rng: np.random.Generator) -> Array:
    """[M] disparities between the lowest and the highest seen next to M chosen pixels, which are
    seen; draws for every pixel, so that later draws do not depend on the scene."""
    low = minimum_filter(np.where(seen, disparity, np.inf), 3, mode="nearest")[chosen]
    high = maximum_filter(np.where(seen, disparity, -np.inf), 3, mode="nearest")[chosen]
    return low + rng.random(disparity.shape)[chosen] * (high - low)
