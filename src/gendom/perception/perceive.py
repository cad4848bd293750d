"""Convert recorded pictures and the robot's path to a recording for the estimator."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from gendom.arguments import time_text
from gendom.datasets import Fault, Recording
from gendom.datasets.recording_form import parse_meta
from gendom.errors import RecordingError
from gendom.perception.camera import Camera, expect
from gendom.perception.cloud import (
    MIN_CLUSTER,
    MIN_DEPTH_PIXELS,
    OUTLIER_RADIUS,
    STAGES,
    VOXEL,
    CameraView,
    FusedCloud,
    Held,
    PerceptionSettings,
    perceive_frame,
)
from gendom.perception.colour import ObjectColour, lab
from gendom.perception.folder import CameraRecording
from gendom.perception.frames import Frame, MatchedFrames, Pictures, read_png
from gendom.perception.line import MOST_FAR
from gendom.perception.quality import (
    MAX_DISAGREEMENT,
    MOST_COVERED,
    offset_between,
    own_area,
    seen_share,
    sides_apart,
    times_own_area,
)

_AGREEMENT_FRAMES = 5  # disagreement is judged from so many comparisons in a row
_AGREEMENT_STRIDE = 5  # beyond the first of them, one frame of so many is compared
_AGREEMENT_POINTS = 30
_AGREEMENT_SHARE = 0.03  # of the pixels that the object would fill; fewer may be the table's noise
_SHARE_FRAMES = 10  # frames on which the seen share is measured
_MAX_RISE, _MAX_TURN = 0.005, 1.0  # [m], degrees; beyond, a camera ought to be calibrated again
_BELOW_TABLE = 0.05  # [m]; the workspace reaches so far below a known table
_MARGIN = 0.05  # [m]; and so far beyond what the object can reach
_BEYOND = 0.03  # [m]; points farther from a gripper than the object is long may be its own
_FEWEST_ACROSS = 2.0  # pixels that a rope is across; of thinner ones most pixels are lost or mixed
_ALIKE = 0.3  # of its own area, apart from it on the table: the table has the object's colour
_LOW = 0.01  # [m]; points so near to the table may be the table's
_MOST_CROWDED = 1 / 3  # of the frames may be left out because more than the object is in them
_MASKS = "give a PNG a picture, of its name and size, above 0 where the object is"
_CHOOSE = "narrow the colour (--lightness-weight 1, --colour-tolerance), or give --masks"


@dataclass(frozen=True, eq=False)
class Perceived:
    """A recording, and how it was made."""

    recording: Recording
    """The object's clouds and the grippers."""
    counts: npt.NDArray[np.int64]
    """[T, 8] points left at each of `gendom.perception.STAGES`, summed over the cameras."""
    cameras: list[str]
    """Their names, in the order of the recording's `seen_by` and `camera_positions`."""
    seen_share: float
    """About how much of the object is seen in the middle of all frames, 0 to 1."""
    disagreement: float | None
    """How far another camera's clouds are from the first's [m], the sides of the object that
    they see allowed for, at the worst stretch of the recording; None: unknown."""


def perceive(
    recorded: CameraRecording,
    settings: PerceptionSettings | None = None,
    *,
    on_warning: Callable[[Fault], None] = lambda _: None,
) -> Perceived:
    """Turn depth pictures into the object's clouds.

    Frames whose pictures are damaged or missing, that match no frame of the other cameras, or
    that lie outside of the grippers' path are left out with a warning; all others are kept.

    Args:
        recorded: Cameras, the robot's path and the object's description.
        settings: By default the workspace follows from the grippers' path, and all that stands
            above the table is the object.
        on_warning: Called with every fault that does not prevent use.

    Raises:
        RecordingError: No frames match, depth misses the workspace, cameras disagree by more
            than 2 cm, no object is in view, or the recording that came of it is not valid.
        ParameterError: A setting is out of its range.
    """
    return _Perception(recorded, settings or PerceptionSettings(), on_warning).run()


class _Perception:
    def __init__(
        self,
        recorded: CameraRecording,
        settings: PerceptionSettings,
        on_warning: Callable[[Fault], None],
    ):
        self.recorded, self.on_warning = recorded, on_warning
        where = f"{recorded.where}/object.toml"
        self.values, faults = parse_meta(recorded.meta)
        if faults:
            raise RecordingError(where=where, faults=faults)
        self.object, height = self.values["object"], self.values["table_height"]
        self.table_height = None if settings.no_table else height  # [m], if it is looked for
        self.names = [source.camera.name for source in recorded.sources]
        size = self.object.size or 0.0
        fix = "give length for a rope, width and height for a cloth, in metres"
        right = math.isfinite(size) and size > 0.0
        expect(right, "the object's sizes are missing", where, fix)
        if settings.workspace is None:
            settings = replace(settings, workspace=within_reach(recorded, size, height))
        self.settings = settings
        across = self.object.diameter or math.inf
        self.views = [CameraView(source.camera, settings, across) for source in recorded.sources]
        self.colour: ObjectColour | None = None
        self.all_seen = True  # of a rope on the table
        self.clouds: list[FusedCloud] = []
        self.times: list[float] = []
        self.grippers: list[tuple[np.ndarray, np.ndarray | None]] = []
        self.offsets: list[np.ndarray] = []
        self.comparable = 0  # frames with points enough in all views
        self.fewest = [self._fewest(view.camera) for view in self.views]
        self.apart: dict[str, float] = {}  # [m]; table, object at first, at worst
        self.seen = np.zeros(len(self.names), dtype=np.int64)  # points of each camera
        self.unreadable: list[RecordingError] = []
        self.off_path = 0
        self.crowded: list[float] = []  # how many times its area clouds of other things, too, have
        self.levelled: dict[str, dict[str, float]] = {}

    def run(self) -> Perceived:
        matched = MatchedFrames(self.recorded.sources, self.settings.sync_tolerance)
        robot, begun = self.recorded.robot, False
        for frames in matched:
            time = float(np.mean([frame.time for frame in frames]))
            if (gripper := robot.at(time)) is None:
                self.off_path += 1
                continue
            if (pictures := self._read(frames)) is None:
                continue
            capsules = self.recorded.capsules and self.recorded.capsules(time)
            held = Held(
                gripper[0],
                (self.object.size or 0.0) + _BEYOND,
                robot=capsules,
                arm_above=capsules is None and self.settings.masks is None,
                rope=self.object if self.object.kind == "rope" else None,
            )
            if not begun:
                self._begin(pictures, held)
                begun = True
            held = replace(held, chosen=self.colour is not None, all_seen=self.all_seen)
            closed = robot.closed_at(time)
            cloud = perceive_frame(
                self.views,
                pictures,
                colour=self.colour,
                capsules=capsules,
                held=held if closed is None or closed.all() else None,
            )
            times = times_own_area(cloud.points, self.object)
            if times <= MOST_COVERED * len(self.views):  # each may place it elsewhere
                self._compare(cloud)
            if times > MOST_COVERED or not cloud.clear:
                self.crowded.append(times)
                continue
            self.clouds.append(cloud)
            self.times.append(time)
            self.grippers.append(gripper)
        self._tell_left_out(matched)
        return self._result()

    def _require(self, holds: Any, what: str, fix: str | None, where: str = "") -> None:
        expect(holds, what, where or self.recorded.where, fix)

    def _warn(self, what: str, where: str, fix: str) -> None:
        self.on_warning(Fault(what, where, fix, "warning"))

    def _fewest(self, camera: Camera) -> float:
        """Minimum number of points of a camera's cloud for comparison with others."""
        pixels = camera.K[0, 0] * camera.K[1, 1] / self._away(camera) ** 2
        return max(_AGREEMENT_POINTS, _AGREEMENT_SHARE * own_area(self.object) * pixels)

    def _away(self, camera: Camera) -> float:
        """How far a camera is from the middle of the gripper's path [m]."""
        middle = self.recorded.robot.position.mean(axis=(0, 1))
        return max(float(np.linalg.norm(middle - camera.position)), 1e-3)

    def _read(self, frames: tuple[Frame, ...]) -> list[Pictures] | None:
        try:
            cameras = [view.camera for view in self.views]
            pictures = list(map(self._picture, cameras, frames))
            for frame, seen in zip(frames, pictures, strict=True):
                # Sensors give such pictures just after they are switched on.
                has = np.count_nonzero(seen.depth)
                what = f"only {has} of {seen.depth.size} pixels have depth"
                fix = "check the sensor, and that the depth pictures are 16 bit"
                self._require(has >= MIN_DEPTH_PIXELS, what, fix, frame.where)
        except RecordingError as error:
            self.unreadable.append(error)
            return None
        return pictures

    def _picture(self, camera: Camera, frame: Frame) -> Pictures:
        """What a camera saw; where there are masks, white is the object and the rest black."""
        seen = frame.read()
        if self.settings.masks is None:
            return seen
        file = Path(frame.where).name
        if not file.endswith(".png"):
            file = f"{file.rsplit(' ', 1)[-1]:0>6}.png"
        path = self.settings.masks / camera.name / file
        self._require(path.is_file(), "there is no such mask", _MASKS, str(path))
        picture = read_png(path)
        found = np.asarray(picture if picture.mode[0] == "I" else picture.convert("RGB")) > 0
        mask = np.asarray(found.reshape(*found.shape[:2], -1).any(axis=2))
        camera.check_size(mask, str(path))
        self._require(mask.any(), "masks nothing: all pixels are 0", _MASKS, str(path))
        return Pictures(seen.depth, np.repeat(mask[..., None], 3, axis=2) * np.uint8(255))

    def _begin(self, pictures: list[Pictures], held: Held) -> None:
        """Determine units, table and colour from the first frame."""
        for view, seen in zip(self.views, pictures, strict=True):
            view.check_depth(seen.depth, self.table_height)
        if not self.settings.no_table:
            self._find_table(pictures)
        self.colour = self._find_colour(pictures)
        pixels = max(
            view.breadth * view.camera.K[0, 0] / self._away(view.camera) for view in self.views
        )
        what = f"the rope is {pixels:.1f} pixels across, too few to tell it from what is behind it"
        fix = "choose it by --colour or --masks, or move the cameras nearer"
        self._require(pixels >= _FEWEST_ACROSS or self.colour is not None, what, fix)
        hidden = (view.hides(view.breadth, self._away(view.camera)) for view in self.views)
        self.all_seen = self.colour is not None or not any(hidden)
        alike = False
        for view, seen in zip(self.views, pictures, strict=True):
            if self.colour is not None and view.table is not None:
                points, _ = view.segment(seen, self.colour, held.robot)
                low = np.abs(points @ view.table.normal - view.table.offset) < _LOW
                apart = low & ~held.among(points)
                alike |= times_own_area(points[low], self.object) > MOST_COVERED
                alike |= times_own_area(points[apart], self.object) > _ALIKE
        if alike:
            for view in self.views:
                view.drop_table()
            what = "it, or what is on it, has the object's colour: all within its noise is left out"
            self._warn(what, "table", f"{_CHOOSE} if too much is")

    def _find_table(self, pictures: list[Pictures]) -> None:
        expected, heights = self.table_height, {}
        x, y, _ = np.reshape(np.array(self.settings.workspace), (2, 3)).mean(axis=0)
        for view, seen in zip(self.views, pictures, strict=True):
            view.find_table(seen.depth, expected)
            if view.table is not None:
                heights[view.camera.name] = view.table.height(x, y)
        known = dict(heights) if expected is None else {"object.toml": expected, **heights}
        apart = max(known.values()) - min(known.values()) if heights else 0.0
        listed = ", ".join(f"{1e3 * z:.0f} mm by {name}" for name, z in known.items())
        what = f"the table is at z = {listed}: more than {1e3 * MAX_DISAGREEMENT:.0f} mm apart"
        fix = "calibrate the cameras again, or correct table_height"
        self._require(apart <= MAX_DISAGREEMENT, what, fix)
        if len(heights) > 1:
            self.apart["table"] = max(heights.values()) - min(heights.values())
        if heights and not self.settings.no_level:
            mean = sum(heights.values()) / len(heights)
            self._level(pictures, x, y, mean if expected is None else expected)
        lacking = [name for name in self.names if name not in heights]
        if lacking and known:  # neither stated nor seen: there is none
            level = "" if expected is None else f" at z = {expected:g} m"
            what = f"no table{level} is seen by {', '.join(lacking)}, so none is removed there"
            fix = "check the workspace and T_world_camera; --no-table if there is none"
            self._warn(what, "table", fix)

    def _level(self, pictures: list[Pictures], x: float, y: float, height: float) -> None:
        """Move every camera so that its table is level and at this height [m]."""
        for k, (view, seen) in enumerate(zip(self.views, pictures, strict=True)):
            if view.table is None:
                continue
            rise, tilt = height - view.table.height(x, y), math.acos(min(view.table.normal[2], 1.0))
            T = view.table.levelled(x, y, height)
            moved = view.camera.at(T @ view.camera.calibrated())
            level = CameraView(moved, self.settings, view.breadth)
            level.find_table(seen.depth, height)
            if level.table is None:
                continue
            self.views[k] = level
            self.levelled[view.camera.name] = {"rise": rise, "turn": tilt}
            if abs(rise) > _MAX_RISE or math.degrees(tilt) > _MAX_TURN:
                what = f"sees the table {-1e3 * rise:+.0f} mm too high and tilted by "
                what += f"{math.degrees(tilt):.1f} degrees; it is moved to where that is right"
                fix = "calibrate it again (gendom calibrate), or --no-level"
                self._warn(what, f"camera {view.camera.name!r}", fix)

    def _find_colour(self, pictures: list[Pictures]) -> ObjectColour | None:
        chosen = self.settings
        if chosen.masks is None and chosen.colour is None:
            return None
        for name, seen in zip(self.names, pictures, strict=True):
            fix = "leave out --colour, or record colour"
            what, where = "has no colour pictures", f"camera {name!r}"
            self._require(seen.colour is not None, what, fix, where)
        return ObjectColour.near(
            lab(chosen.colour or (255, 255, 255)),  # of masks white is the object
            tolerance=chosen.colour_tolerance,
            lightness_weight=chosen.lightness_weight,
        )

    def _compare(self, cloud: FusedCloud) -> None:
        """Raise an error if cameras disagree about the position of the object.

        A shift along a straight rope is visible only later, when the rope is bent, so the whole
        recording is compared. A cloth's outline shows any shift at once, and later each camera may
        see a different side of it.
        """
        self.seen += [len(part) for part in cloud.parts]
        done = self.comparable >= _AGREEMENT_FRAMES and self.object.kind != "rope"
        if done or len(cloud.parts) < 2 or len(cloud.points) == 0:
            return
        tree, near = KDTree(cloud.together), OUTLIER_RADIUS
        clouds = [part[tree.query(part)[0] < near] for part in cloud.parts]
        if any(len(own) < least for own, least in zip(clouds, self.fewest, strict=True)):
            return
        self.comparable += 1
        if self.comparable > _AGREEMENT_FRAMES and self.comparable % _AGREEMENT_STRIDE:
            return
        # With more than two cameras: the one farthest from the first.
        first, *others = (view.camera.position for view in self.views)
        centre = np.concatenate(clouds).mean(axis=0)
        between = [
            offset_between(clouds[0], cloud) - sides_apart(centre, first, place, self.object)
            for cloud, place in zip(clouds[1:], others, strict=True)
        ]
        self.offsets.append(max(between, key=lambda d: float(np.linalg.norm(d))))
        if len(self.offsets) >= _AGREEMENT_FRAMES:
            self._check_agreement()

    def _check_agreement(self) -> None:
        latest = self.offsets[-_AGREEMENT_FRAMES:]
        offset = np.median(np.array(latest), axis=0)
        apart = float(np.linalg.norm(offset))
        self.apart.setdefault("at_rest", apart)
        self.apart["at_worst"] = max(apart, self.apart.get("at_worst", 0.0))
        x, y, z = 1e3 * offset
        what = f"cameras {', '.join(self.names)} place the object {1e3 * apart:.0f} mm apart "
        what += f"({x:.0f}, {y:.0f}, {z:.0f} mm)"
        fix = "calibrate them again (gendom calibrate), take the robot out of view "
        fix += "(--colour, joints.csv), or use one by --cameras"
        self._require(apart <= MAX_DISAGREEMENT, what, fix)

    def _tell_left_out(self, matched: MatchedFrames) -> None:
        """Warn of frames that are left out, and refuse if none is left."""
        late, used = f"{self.settings.sync_tolerance:g} s", matched.used
        pairs = zip(self.names, matched.spans, strict=True)
        spans = ", ".join(
            f"{name} {time_text(first)} to {time_text(last)} s" for name, (first, last) in pairs
        )
        what = f"no frames of the cameras lie within {late} ({spans})"
        self._require(used, what, "put all time stamps on one clock, or raise --sync-tolerance")
        for fault in matched.left_out(f"camera {name!r}" for name in self.names):
            self.on_warning(fault)
        path = self.recorded.robot.time
        times = f"{time_text(path[0])} to {time_text(path[-1])} s"
        if self.unreadable:
            first, count = self.unreadable[0], len(self.unreadable)
            where, fix = first.where or self.recorded.where, first.fix or ""
            what = f"none of {count} frames can be read; the first: {first.what}"
            self._require(self.clouds or self.crowded, what, fix, where)
            what = f"{count} of {used} frames cannot be read and are left out; the first: "
            self._warn(f"{what}{first.what}", where, fix)
        if self.off_path:
            what = f"{self.off_path} of {used} frames are outside of its times, {times}; "
            fix = "put robot and cameras on one clock if there are many"
            self._warn(f"{what}they are left out", f"{self.recorded.where}/gripper.csv", fix)
        if self.crowded:
            what = f"in {len(self.crowded)} of {used} frames other things are among the points, "
            what += "such as a hand, a cable, the table or the robot: "
            times = float(np.median(self.crowded))
            covers = f"they cover {times:.1f} times as much as the object can"
            what += covers if times > MOST_COVERED else "more than one line could be the rope"
            fix = "take them out of view, narrow --workspace, choose the object by --colour or "
            fix += "--masks, and check its sizes in object.toml"
            few = len(self.crowded) <= _MOST_CROWDED * (len(self.crowded) + len(self.clouds))
            self._require(few, what, fix)
            self._warn(f"{what}; they are left out", self.recorded.where, fix)
        beyond = [1.0 - len(c.points) / max(len(c.together), 1) for c in self.clouds]
        if (cut := np.sum(np.array(beyond) > MOST_FAR)) > 0.5 * len(beyond):
            what = f"in {cut} of {len(beyond)} frames {np.median(beyond):.0%} of the points lie "
            what += f"beyond a line of {self.object.length:g} m and are left out"
            fix = "check the stated length, or take other things out of view"
            self._warn(what, self.recorded.where, fix)
        what = f"the robot's path is at other times, {times}, than the cameras' frames ({spans})"
        self._require(self.clouds, what, "put both on one clock")

    def _result(self) -> Perceived:
        counts = np.array([cloud.counts for cloud in self.clouds])
        lost = next((s for s, n in zip(STAGES, counts.sum(axis=0), strict=True) if n == 0), "")
        what = f"no object in view: no points are left after {lost!r} in any of {len(counts)} "
        self._require(counts[:, -1].any(), f"{what}frames", _REMEDIES.get(lost))
        if self.offsets:
            self._check_agreement()
        recording = self._recording()
        recording.require_valid(self.recorded.where, on_warning=self.on_warning)
        for name, count in zip(self.names, self.seen, strict=True):
            if count == 0:
                what = "sees nothing of the object in any frame"
                fix = "check its colour pictures, its T_world_camera and what hides the object"
                self._warn(what, f"camera {name!r}", fix)
        some = np.unique(np.linspace(0, recording.num_frames - 1, _SHARE_FRAMES).astype(int))
        shares = [seen_share(recording.frame(int(t)), self.object) for t in some]
        if (share := float(np.median(shares))) < 0.5:
            what = f"only about {100 * share:.0f} % of the object is seen"
            fix = "check workspace, colour and what hides it; the estimate will be poor"
            self._warn(what, "points", fix)
        return Perceived(recording, counts, self.names, share, self.apart.get("at_worst"))

    def _recording(self) -> Recording:
        """The recording of all frames, not yet validated."""
        positions, axes = zip(*self.grippers, strict=True)
        closed = [self.recorded.robot.closed_at(time) for time in self.times]
        values = dict(self.values)
        box = self.settings.workspace
        assert box is not None
        history = {  # docs/perception.md
            "cameras": self.names,
            "settings": {
                "low": box[:3],
                "high": box[3:],
                "voxel": VOXEL,
                "min_cluster": MIN_CLUSTER,
            },
            "colour_lab": None if self.colour is None else self.colour.reference,
            "cameras_apart": self.apart,
            "levelled": self.levelled,
            "depth_noise": [None if v.table is None else v.table.noise for v in self.views],
        }
        values["extra"] = {**values["extra"], "perception": history}
        values["camera_positions"] = np.array([v.camera.position for v in self.views])
        tables = [v.table for v in self.views if v.table is not None]
        if values["table_height"] is None and tables:
            x, y, _ = np.mean(positions, axis=(0, 1))
            values["table_height"] = float(np.mean([t.height(x, y) for t in tables]))
        values["source"] = values["source"] or self.recorded.where
        return Recording.from_frames(
            [cloud.points for cloud in self.clouds],
            time=self.times,
            gripper_position=np.array(positions),
            gripper_axis=None if axes[0] is None else np.array(axes),
            gripper_closed=None if closed[0] is None else np.array(closed),
            seen_by=np.concatenate([cloud.seen_by for cloud in self.clouds]),
            **values,
        )


def within_reach(
    recorded: CameraRecording, size: float, table: float | None
) -> tuple[float, float, float, float, float, float]:
    """The workspace that an object of a size [m] can reach from the grippers' path, down to below a
    table at a height [m] or None."""
    path = recorded.robot.position.reshape(-1, 3)
    low, high = path.min(axis=0) - size - _MARGIN, path.max(axis=0) + _MARGIN
    high[:2] += size
    if table is not None and table < high[2]:
        low[2] = max(low[2], table - _BELOW_TABLE)
    x0, y0, z0, x1, y1, z1 = (float(x) for x in (*low, *high))
    return x0, y0, z0, x1, y1, z1


_REMEDIES = {
    "depth": "check the sensor",
    "workspace": "check --workspace and T_world_camera",
    "table": "everything is as low as the table: choose the object by --colour, or --no-table",
    "colour": "nothing has that colour: choose another, or raise --colour-tolerance",
    "support": "only single pixels are left: check the colour",
    "robot": "the robot's shape covers everything: check joints.csv",
    "voxels": "check the settings",
    "outliers": "only scattered points are left: check the colour",
}
