"""From depth pictures to the cloud of the object, frame by frame.

Constant quantities are computed once for each pixel: its ray in the world, and the depth ranges in
which it is inside the workspace and on the table. Cropping and table removal are then comparisons
of 16-bit integers, and only the remaining pixels are converted to points.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gendom.arguments import require
from gendom.arrays import Array, rigid
from gendom.datasets import ObjectDescription
from gendom.errors import RecordingError
from gendom.perception.camera import Camera
from gendom.perception.colour import LIGHTNESS_WEIGHT, TOLERANCE, ObjectColour
from gendom.perception.frames import SYNC_TOLERANCE, Pictures
from gendom.perception.line import find_line
from gendom.perception.robot import Capsules

STAGES = ("depth", "workspace", "table", "colour", "support", "robot", "voxels", "outliers")
"""What is counted: pixels with depth, then those left after each stage, then fused voxels and
those left after outlier removal."""

MIN_DEPTH_PIXELS = 100
"""Pictures with fewer valid depth pixels are treated as empty."""

OUTLIER_RADIUS = 0.015
"""Points in the same or in touching cubes of this edge [m] are connected."""

VOXEL = 0.005
"""Edge of the cubes that give one point each, the mean of theirs [m]."""

MIN_CLUSTER = 10
"""Connected points fewer than this are dropped."""

MIN_SUPPORT = 3
"""So many of a pixel's eight neighbours must belong to the object at about the same depth: removes
mixed pixels at edges, and isolated ones."""

NARROW = 4.0
"""Pixels across an object from which on a pixel's neighbours lie beside it; of one half as broad
they may be two pixels away, as there are fewer of them."""

SPARSE = 0.006
"""Breadth from which on points of an object lie densely: three pixels at a metre [m]."""

_TABLE_SIGMAS = 3.0  # depths within so many standard deviations of the table's are on the table
_TABLE_CLEARANCE = 0.002  # [m]; so are points nearer to it than this, for any noise
_ROBOT_MARGIN = 0.01  # [m]; points nearer than this to a capsule are the robot's
_FINGERTIP = 0.02  # [m]; points farther from what is held may be as near to fingers as to links
_HANGING_TOGETHER = 0.06  # [m]; gaps in what is held are smaller
_ABOVE, _BESIDE = 0.03, 0.05  # [m]; an arm of unknown shape is a cone that begins so far above what
# it holds, and is wider by this than it is high
_NO_TABLE = np.uint16(65535)  # counts that no depth exceeds
_STEREO_NOISE = 0.005  # [1/m]; depth noise over depth squared, where no table shows it
_MAX_DEPTH_SLOPE = 5.0  # pixels' widths by which a surface's depth changes a pixel, at most
_COMMON_UNITS = (1.0, 1e-2, 1e-3, 5e-4, 2.5e-4, 2e-4, 1.25e-4, 1e-4, 1e-5, 1e-6)  # [m] a count
_SEEN = (0.15, 6.0)  # [m]; median depths of pictures
_TABLE_SHARE = 0.2  # of the downward pixels must lie on a table that decides the unit
_AROUND, _STRAY = 0.025, 0.4  # [m], of the usual number of a rope's points in that distance
_AT_ONCE = 1 << 18  # pixels
_MAX_CAMERAS = 8  # bits of a point's `seen_by`
# Of the table's plane:
_SEARCH_RANGE = 0.06  # [m]; how far from the expected height the table is looked for
_FIT_RANGE = 0.03  # [m]; heights around the most frequent one that begin the fit
_MAX_TILT = np.radians(5.0)
_MIN_POINTS = 300
_MIN_SHARE = 0.03  # of the points in the workspace
_MAX_POINTS = 20_000  # more do not make the plane better than its calibration


@dataclass(frozen=True, kw_only=True)
class PerceptionSettings:
    """Settings of segmentation and of the combination of frames."""

    workspace: tuple[float, float, float, float, float, float] | None = None
    """x0 y0 z0 x1 y1 z1 in metres; by default what the object can reach."""
    colour: tuple[int, int, int] | None = None
    """The object's colour: R G B, 0 to 255."""
    masks: Path | None = None
    """Or DIR of another program's masks: DIR/CAMERA/ has a PNG for each depth picture, of its name
    (of a RealSense recording 000000.png and so on) and size, above 0 where the object is."""
    colour_tolerance: float = TOLERANCE
    """Largest distance from that colour in L*a*b*."""
    lightness_weight: float = LIGHTNESS_WEIGHT
    """Weight of lightness in it; 1 for a black, grey or white object."""
    no_table: bool = False
    """Do not look for a table and remove it."""
    no_level: bool = False
    """Leave cameras where their calibration says, though the table they see is not level. Otherwise
    each is turned and raised, so that the table is level and at one height: where the object's
    description says, or where cameras see it in the mean."""
    sync_tolerance: float = SYNC_TOLERANCE
    """Largest difference of the time stamps of frames that belong together, in seconds."""

    def __post_init__(self):
        one, what = not (self.colour and self.masks), "colour and masks are both given"
        require(one, what, fix="choose one")
        right = all(0 <= c <= 255 for c in self.colour or ())
        require(right, f"colour {self.colour}", fix="give R G B, each 0 to 255")
        box = self.workspace or (0, 0, 0, 1, 1, 1)
        ordered = np.isfinite(box).all() and all(np.less(box[:3], box[3:]))
        what = f"the workspace runs from {box[:3]} to {box[3:]}"
        require(ordered, what, fix="give x0 y0 z0 x1 y1 z1 in metres, each lower value first")
        late = self.sync_tolerance
        require(0.0 <= late <= 1.0, f"sync_tolerance is {late:g} s", fix="give seconds, 1 at most")


@dataclass(frozen=True)
class TablePlane:
    """A plane as one camera sees it."""

    normal: Array
    """[3] unit vector, upwards."""
    offset: float
    """Points p of the plane have normal . p = offset [m]."""
    noise: float
    """Depth noise over depth squared [1/m]: RMS = noise z^2, as stereo has it."""

    def height(self, x: float, y: float) -> float:
        """z of the plane at a place [m]."""
        return float((self.offset - self.normal[:2] @ [x, y]) / self.normal[2])

    def levelled(self, x: float, y: float, height: float) -> Array:
        """The motion [4, 4] that makes the plane level and brings its point at a place [m] to a
        height [m], by the smallest turn."""
        R = Rotation.align_vectors([0.0, 0.0, 1.0], self.normal)[0].as_matrix()
        return rigid(R, [x, y, height] - R @ [x, y, self.height(x, y)])


def fit_table(
    points: Array, directions: Array, depth: Array, *, expected_height: float | None = None
) -> TablePlane | None:
    """The horizontal plane that most points lie on.

    Begins at the most frequent height and repeats least squares on the points within 2.5 robust
    standard deviations, so that objects on the table do not lift it. The noise is
    s / (f B) of the stereo model RMS = z^2 s / (f B), from the residuals along the rays.

    Args:
        points: [n, 3] in the world [m].
        directions: [n, 3] their rays in the world, of length such that depth 1 is one ray.
        depth: [n] along the camera's axis [m].
        expected_height: z [m]; the table is looked for within 6 cm of it. None: anywhere.

    Returns:
        None: fewer than 300 points or 3 % are on a plane, or it is tilted by more than 5 degrees.
    """
    if len(points) > _MAX_POINTS:
        pick = np.random.default_rng(0).choice(len(points), _MAX_POINTS, replace=False)
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
        before, keep = keep, np.abs(residual) < max(2.5 * spread, 5e-4)
        if (keep == before).all():  # it would stay so
            break
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


class CameraView:
    """A camera's pixels in the workspace of settings, which is given.

    Args:
        camera: That sees the object.
        settings: Of segmentation.
        breadth: Of the object where it is narrow, a rope's diameter [m].

    Raises:
        RecordingError: The camera is not calibrated.
    """

    def __init__(self, camera: Camera, settings: PerceptionSettings, breadth: float = np.inf):
        assert settings.workspace is not None
        self.camera = camera
        self.settings = settings
        self.breadth = breadth
        self.table: TablePlane | None = None
        T, pixels = camera.calibrated(), camera.width * camera.height
        self._position = camera.position.astype(np.float32)
        self._directions = np.empty((3, pixels), np.float32)
        near, far = np.empty((2, pixels))
        box, step = np.reshape(settings.workspace, (2, 3)), max(_AT_ONCE // camera.width, 1)
        for first in range(0, camera.height, step):  # all at once would take a gigabyte
            directions = camera.rays(slice(first, first + step)) @ T[:3, :3].T
            own = slice(first * camera.width, (first + step) * camera.width)
            self._directions[:, own] = directions.T
            near[own], far[own] = _box_depths(camera.position, directions, *box)
        self._depths = near.astype(np.float32), far.astype(np.float32)
        self._near, self._far = self._counts(near, np.ceil), self._counts(far, np.floor)
        self._far[~(near <= far)] = 0  # the ray misses the workspace
        # Depths from `_top` on are on the table or below, those beyond `_bottom` below.
        self._top = np.full(len(self._near), _NO_TABLE)
        self._bottom = np.full(len(self._near), _NO_TABLE)

    def _counts(self, depth: np.ndarray, to_integer: np.ufunc) -> npt.NDArray[np.uint16]:
        """Depths [m] as counts of the depth unit, 1 to 65535."""
        counts = to_integer(depth / self.camera.depth_unit)
        return np.clip(np.nan_to_num(counts, posinf=65535.0), 1, 65535).astype(np.uint16)

    def points(self, raw: npt.NDArray[np.uint16], pixels: np.ndarray) -> npt.NDArray[np.float32]:
        """World points [n, 3] [m] of flat pixel numbers [n] of a flat depth picture."""
        z = raw[pixels] * np.float32(self.camera.depth_unit)
        points = np.empty((len(pixels), 3), np.float32)
        for axis in range(3):
            np.multiply(self._directions[axis].take(pixels), z, out=points[:, axis])
            points[:, axis] += self._position[axis]
        return points

    def in_workspace(self, depth: npt.NDArray[np.uint16]) -> npt.NDArray[np.bool_]:
        """[height, width] pixels of a depth picture whose points are in the workspace."""
        raw = depth.ravel()
        return ((raw >= self._near) & (raw <= self._far)).reshape(depth.shape)

    def check_depth(self, depth: npt.NDArray[np.uint16], table_height: float | None = None) -> None:
        """Refuse a picture [height, width] whose depth misses the workspace, or a table at a height
        [m], and name another unit of depth that would fit."""
        raw, where = depth.ravel(), f"camera {self.camera.name!r}"
        median = f"{np.median(raw[raw > 0]) * self.camera.depth_unit:.4g} m"
        if (unit := self._other_unit(raw.astype(np.float32), table_height)) is not None:
            what = (
                f"depth of median {median} would be on the table, or in the workspace, in another"
            )
            fix = f"it is {self.camera.depth_unit:g} m a count; {unit:g} seems right"
            raise RecordingError(f"{what} unit", where=f"{where}: depth_unit", fix=fix)
        if np.count_nonzero(self.in_workspace(depth)) < 50:
            corners = np.reshape(np.array(self.settings.workspace), (2, 3))
            low, high = (", ".join(f"{x:.3g}" for x in corner) for corner in corners)
            what = f"sees nothing of the workspace, ({low}) to ({high}) m; median depth {median}"
            fix = "check T_world_camera (camera to world, not its inverse) and --workspace"
            raise RecordingError(what, where=where, fix=fix)

    def _other_unit(self, raw: Array, table_height: float | None) -> float | None:
        """The unit [m a count], other than the camera's, in which depth [counts] is on a table at a
        height [m], or in the workspace; None: it is in its own.

        In any unit a table is a plane; only how far below the camera it lies changes.
        """
        own, some = self.camera.depth_unit, np.flatnonzero(raw)
        raw, slope = raw[some], -self._directions[2, some]
        (near, far), median = (depths[some] for depths in self._depths), np.median(raw)
        tens = (own * 10.0**k for k in range(-4, 5))
        usual = [[unit for unit in units if _SEEN[0] < median * unit < _SEEN[1]]
                 for units in (_COMMON_UNITS, tens)]  # fmt: skip
        if table_height is not None and usual[0]:
            below, expected = raw * slope, self.camera.position[2] - table_height
            found = {
                unit: np.count_nonzero(np.abs(unit * below - expected) < _FIT_RANGE)
                for unit in (own, *usual[0])
            }
            best = max(found, key=lambda unit: found[unit])
            if found[best] > max(_TABLE_SHARE * np.count_nonzero(slope > 0.1), 10 * found[own]):
                return best
        found = {
            unit: np.count_nonzero((unit * raw >= near) & (unit * raw <= far))
            for unit in (own, *usual[1])
        }
        best = max(found, key=lambda unit: found[unit])
        fits = found[best] >= max(10 * found[own], 0.005 * len(some), MIN_DEPTH_PIXELS)
        return best if fits else None

    def find_table(self, depth: npt.NDArray[np.uint16], expected_height: float | None) -> None:
        """Fit the table, near a height [m] where one is given, in a depth picture [height, width],
        and remove it from now on where there is one."""
        raw = depth.ravel()
        pixels = np.flatnonzero(self.in_workspace(depth))
        directions = self._directions[:, pixels].T
        z, points = raw[pixels] * self.camera.depth_unit, self.points(raw, pixels)
        self.table = fit_table(points, directions, z, expected_height=expected_height)
        if (table := self.table) is None:
            return
        slope = -(table.normal @ self._directions.astype(np.float64))  # per depth, downwards
        with np.errstate(divide="ignore", invalid="ignore"):
            z = (table.normal @ self.camera.position - table.offset) / slope
            band = np.maximum(_TABLE_SIGMAS * table.noise * z**2, _TABLE_CLEARANCE / slope)
            meets = (slope > 1e-6) & (z > 0)
            top, bottom = (np.where(meets, end, np.inf) for end in (z - band, z + band))
        self._top, self._bottom = self._counts(top, np.ceil), self._counts(bottom, np.floor)

    def hides(self, thickness: float, depth: float) -> bool:
        """Whether a thing of a thickness [m] on the table is within its noise, at a depth [m]."""
        return self.table is not None and thickness < _TABLE_SIGMAS * self.table.noise * depth**2

    def drop_table(self) -> None:
        """Leave out what lies within the table's noise, whatever its colour."""
        self._bottom = self._top - np.uint16(1)

    def segment(
        self,
        pictures: Pictures,
        colour: ObjectColour | None = None,
        capsules: Capsules | None = None,
    ) -> tuple[npt.NDArray[np.float32], list[int]]:
        """The object's points [n, 3] in the world [m] in one camera's pictures, and how many were
        left at each of the first six `STAGES`.

        A point on the table stays if its colour is the object's; without colours nothing that
        lies within the table's noise can be separated from it.
        """
        raw = pictures.depth.ravel()
        inside = (raw >= self._near) & (raw <= self._far)
        counts = [int(np.count_nonzero(raw)), int(np.count_nonzero(inside))]
        if colour is None or pictures.colour is None:
            inside &= raw < self._top
            pixels = np.flatnonzero(inside)
            counts += [len(pixels), len(pixels)]
        else:
            inside &= raw <= self._bottom
            pixels = np.flatnonzero(inside)
            own = colour.match(pictures.colour.reshape(-1, 3).take(pixels, axis=0))
            kept = pixels[own]
            above = np.count_nonzero(raw[pixels] < self._top[pixels])
            on_table = np.count_nonzero(raw[kept] >= self._top[kept])
            counts += [int(above + on_table), len(kept)]
            pixels = kept
        pixels = self._supported(raw, pixels)
        counts.append(len(pixels))
        points = self.points(raw, pixels)
        if capsules is not None and len(points):
            points = points[~capsules.contain(points, _ROBOT_MARGIN)]
        return points, [*counts, len(points)]

    def _supported(self, raw: npt.NDArray[np.uint16], pixels: np.ndarray) -> np.ndarray:
        """Those of the flat pixel numbers that have enough neighbours among them."""
        if len(pixels) == 0:
            return pixels
        own = raw[pixels].astype(np.int32)
        z = own * np.float32(self.camera.depth_unit)
        width, focal = self.camera.width, self.camera.K[0, 0]
        # Of so narrow an object all pixels are at edges, and most have no depth.
        across = max(self.breadth * focal / float(np.median(z)), 1.0)
        reach = max(round(NARROW / across), 1)
        # A picture of the object alone, with room for the neighbours of its corners.
        room = reach * (width + 1)
        alone = np.zeros(len(raw) + 2 * room, np.int32)
        at = pixels + room
        alone[at] = own
        noise = _STEREO_NOISE if self.table is None else self.table.noise
        apart = 4.0 * noise * z**2 + reach * _MAX_DEPTH_SLOPE / focal * z
        apart = (apart / self.camera.depth_unit).astype(np.int32) + 1
        support = np.zeros(len(pixels), np.int8)
        for step in np.ndindex(2 * reach + 1, 2 * reach + 1):
            if step != (reach, reach):
                offset = (step[0] - reach) * width + step[1] - reach
                support += np.abs(alone[at + offset] - own) <= apart
        return pixels[support >= MIN_SUPPORT]


@dataclass(frozen=True, eq=False)
class Held:
    """What grippers hold: the rest of a scene is farther away or apart from it."""

    places: Array
    """[G, 3] the grippers [m]."""
    reach: float
    """How far it reaches from each of them at most [m]."""
    chosen: bool = False
    """Whether its colour or masks chose the points: then most of them are the object's, even if
    they lie apart from the grippers."""
    robot: Capsules | None = None
    """The grippers' shape, of which noise is left where nothing chose the points; None: unknown."""
    arm_above: bool = False
    """Whether what is above the grippers is the arm: what hangs from them is not."""
    rope: ObjectDescription | None = None
    """The rope that they hold, whose line is followed; None: it is none."""
    all_seen: bool = True
    """Whether no part of the rope can lie within the table's noise."""

    def among(self, points: Array) -> npt.NDArray[np.bool_]:
        """[n] those of points [n, 3] [m] that belong to it."""
        away = np.linalg.norm(points[:, None] - self.places, axis=2)
        near = (away <= self.reach).all(axis=1)
        if self.arm_above:
            for off in points - self.places[:, None]:
                high = off[:, 2]
                near &= (high < _ABOVE) | (np.hypot(off[:, 0], off[:, 1]) > high + _BESIDE)
        if self.robot is not None and not self.chosen:
            whole = replace(self.robot, largest_margin=None).contain(points, _ROBOT_MARGIN)
            near &= ~(whole & (away > _FINGERTIP).all(axis=1))
        if not near.any():
            return near
        label = np.full(len(points), -1)
        label[near] = _clusters(points[near], _HANGING_TOGETHER / 2.0)
        own = near & np.isin(label, label[near][KDTree(points[near]).query(self.places)[1]])
        return near if self.chosen and 2 * own.sum() < near.sum() else own


@dataclass(frozen=True, eq=False)
class FusedCloud:
    """The object's points of one moment, from all cameras."""

    points: npt.NDArray[np.float32]
    """[n, 3] in the world [m]."""
    seen_by: npt.NDArray[np.uint8]
    """[n] bit k is set where camera k saw the point."""
    counts: npt.NDArray[np.int64]
    """[8] points left at each of `STAGES`, summed over the cameras."""
    parts: list[npt.NDArray[np.float32]]
    """[n, 3] each camera's own points, before they were fused [m]."""
    together: npt.NDArray[np.float32]
    """[m, 3] the points, and what hangs together with them beside a rope's line [m]."""
    clear: bool
    """Whether no other line among these could be the rope."""


def fuse(
    clouds: Sequence[npt.NDArray[np.float32]], held: Held | None = None, breadth: float = np.inf
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8], int]:
    """One cloud of several cameras' clouds [n_k, 3] [m]: one point a voxel, without outliers, and
    of what grippers hold, where it is given, only what hangs together with them. Points of objects
    that are no broader than some pixels [m] are few, and lie farther apart; of ropes, whose breadth
    is known, those are left out that lie much more sparsely than most, as between rope and table.

    Returns:
        Points [n, 3] [m], `seen_by` [n] (bit k: camera k), and how many voxels there were.

    Raises:
        ParameterError: More cameras than bits.
    """
    what, fix = f"{len(clouds)} cameras", f"use {_MAX_CAMERAS} at most"
    require(len(clouds) <= _MAX_CAMERAS, what, fix=fix)
    points = np.concatenate(clouds)
    bits = np.repeat((1 << np.arange(len(clouds))).astype(np.uint8), [len(c) for c in clouds])
    if not len(points):
        return points, bits, 0
    points, bits = _voxel_means(points, bits)
    voxels = len(points)
    label = _clusters(points, OUTLIER_RADIUS * min(max(SPARSE / breadth, 1.0), 2.0))
    keep = np.bincount(label)[label] >= MIN_CLUSTER
    points, bits = points[keep], bits[keep]
    if held is not None and len(points):
        keep = held.among(points)
        points, bits = points[keep], bits[keep]
    if np.isfinite(breadth) and len(points):
        tree = KDTree(points)
        near = np.asarray(tree.query_ball_point(points, _AROUND, return_length=True))
        keep = near >= _STRAY * np.median(near)
        points, bits = points[keep], bits[keep]
    return points, bits, voxels


def perceive_frame(
    views: Sequence[CameraView],
    pictures: Sequence[Pictures],
    *,
    colour: ObjectColour | None = None,
    capsules: Capsules | None = None,
    held: Held | None = None,
) -> FusedCloud:
    """The object's cloud of one moment.

    Args:
        views: The cameras, all with the same settings.
        pictures: One of each.
        colour: The object's colours; None: everything above the table is the object.
        capsules: The robot at that moment; None: it is not taken out.
        held: What grippers hold: only what hangs together with them is kept; None: all.
    """
    parts = [view.segment(p, colour, capsules) for view, p in zip(views, pictures, strict=True)]
    clouds = [points for points, _ in parts]
    points, seen_by, voxels = fuse(clouds, held, views[0].breadth)
    together, clear = points, True
    if held is not None and held.rope is not None and len(points):
        by_end = held.rope.grasp == "end" and len(held.places) == 1
        place = held.places[0] if by_end else None
        line = find_line(points, held.rope, place, all_seen=held.all_seen)
        clear = line.clear
        if by_end and clear:
            points, seen_by = points[line.own], seen_by[line.own]
    counts = np.sum([counts for _, counts in parts], axis=0).tolist()
    counts = np.array([*counts, voxels, len(points)])
    return FusedCloud(points, seen_by, counts, clouds, together, clear)


def _box_depths(
    position: np.ndarray, directions: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Depths [n] [m] at which rays enter and leave a box; entry beyond exit where they miss it."""
    near, far = np.zeros(len(directions)), np.full(len(directions), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for at, way, least, most in zip(position, directions.T, low, high, strict=True):
            a, b = (least - at) / way, (most - at) / way
            # A ray along a face of the box gives 0 / 0 there: that face does not bound it.
            near, far = np.fmax(near, np.minimum(a, b)), np.fmin(far, np.maximum(a, b))
    return near, far


def _voxel_means(
    points: npt.NDArray[np.float32], bits: npt.NDArray[np.uint8]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8]]:
    """Mean point and united bits of each occupied voxel."""
    cells, place = unique_cells(points, VOXEL)
    n = len(cells)
    count = np.bincount(place, minlength=n)
    means = np.stack([np.bincount(place, x, n) / count for x in points.T], 1, dtype=np.float32)
    united = np.zeros(n, np.uint8)
    for bit in np.unique(bits):
        united[place[bits == bit]] |= bit
    return means, united


def unique_cells(points: np.ndarray, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """Occupied cells [m, 3] of a grid of an edge [m], and the cell [n] of each point."""
    cell = np.floor(points * (1.0 / edge)).astype(np.int32)
    low = cell.min(axis=0)
    size = (cell.max(axis=0) - low + 1).astype(np.int64)
    cell -= low
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    if size.prod() < 20 * len(key):  # counting beats sorting where most of the box is counted
        occupied = np.flatnonzero(np.bincount(key, minlength=int(size.prod())))
        number = np.empty(int(size.prod()), np.intp)
        number[occupied] = np.arange(len(occupied))
        keys, place = occupied, number[key]
    else:
        keys, place = np.unique(key, return_inverse=True)
    return np.stack(np.unravel_index(keys, tuple(size)), axis=1), place


def _clusters(points: np.ndarray, edge: float) -> npt.NDArray[np.intp]:
    """[n] the cluster of each point: those in cells of an edge [m] that touch, by a corner at
    least. Grouping cells instead of points keeps large objects as fast as small ones."""
    cells, place = unique_cells(points, edge)
    pairs = KDTree(cells).query_pairs(1.8, output_type="ndarray")  # sqrt(3) is a corner away
    n = len(cells)
    graph = coo_array((np.ones(len(pairs), np.bool_), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return connected_components(graph, directed=False)[1][place]
