"""What lies in a file or folder, found by its own reader, and the command that goes on from it."""

from __future__ import annotations

import shlex
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gendom.arguments import require, time_text
from gendom.arrays import Array
from gendom.cli.summary import summarize, summary_rows
from gendom.datasets import Fault, ObjectDescription, Recording
from gendom.datasets.folder import BAGS, READERS, bag_files
from gendom.errors import RecordingError
from gendom.reading import file_size, near_name, read_json, read_toml

if TYPE_CHECKING:
    from gendom.perception import CameraRecording

_POINTS = 20_000  # drawn of a picture
_LARGEST_SCENE, _SMALLEST_SCENE = 20.0, 0.02  # [m]
_PERCEIVE = "Take table and robot out, and write a recording (--colour R G B helps)."
_OBJECT = 'object.toml with: [object] kind = "rope", length = METRES, diameter = METRES'


@dataclass
class Finding:
    """What lies somewhere."""

    kind: str
    """What it is, with its article."""
    rows: dict[str, str] = field(default_factory=dict)
    """For people, by what it is about."""
    summary: dict[str, Any] = field(default_factory=dict)
    """For programs."""
    faults: list[Fault] = field(default_factory=list)
    next: list[tuple[str, str]] = field(default_factory=list)
    """Commands that go on, and what they do."""
    clouds: list[Array] = field(default_factory=list)
    """[n, 3] at some moments, in the world [m]."""
    gripper: Array | None = None
    """[M, 3] its path [m]."""
    table: float | None = None
    """z of the table [m]."""

    def step(self, does: str, *words: object) -> None:
        """Add a command of gendom."""
        self.next.append((shlex.join(["gendom", *map(str, words)]), does))

    def lacks(self, what: str, where: object, fix: str, severity: str = "error") -> None:
        """Add a fault: one that prevents use, or a warning."""
        self.faults.append(Fault(what, str(where), fix, severity))


def look(place: Path) -> Finding:
    """Recognise what lies in a file or folder, and check it.

    Raises:
        GendomError: It cannot be read; one line a fault.
    """
    if place.is_dir():
        return next((of(place) for holds, of in _FOLDERS if holds(place)), None) or _below(place)
    file_size(place, RecordingError, most=1 << 62)
    reader = _FILES.get(place.suffix.lower())
    if reader is None:
        fix = f"unpack it, if it is packed; known are folders and {', '.join(sorted(_FILES))}"
        raise RecordingError("is of no kind that is known", where=str(place), fix=fix)
    return reader(place)


def _recording(place: Path) -> Finding:
    found = Finding("a recording")
    recording = Recording.read(place, on_warning=found.faults.append)
    found.summary = summarize(recording)
    found.rows = summary_rows(found.summary)
    valid = np.flatnonzero(recording.frame_valid)
    some = valid[np.unique(np.linspace(0, len(valid) - 1, 3).astype(int))]
    found.clouds = [recording.frame(int(t)) for t in some]
    found.gripper = recording.gripper_position[:, 0]
    found.table = recording.table_height
    if not recording.extra.get("static", False):
        found.step("Estimate the object's parameters.", "estimate", place)
    return found


def _clouds(place: Path) -> Finding:
    """A cloud, or a folder of clouds that lacks what is beside them in a recording."""
    files = sorted(p for p in place.glob("*") if p.suffix.lower() in READERS) or [place]
    found = Finding(f"a folder of {len(files)} clouds" if place.is_dir() else "a cloud")
    points = READERS[files[0].suffix.lower()](files[0])
    found.clouds.append(points[np.isfinite(points).all(axis=1)])
    found.rows = {"points": str(len(points)), **_extent(found.clouds[0], found)}
    if not place.is_dir():
        fix = "put one a frame into a folder, with gripper.csv and object.toml (docs/data.md)"
        found.lacks("is one cloud, a recording is a lift", place, fix)
        return found
    for name, content in (
        ("gripper.csv", "one row a cloud: time,x,y,z in seconds and metres"),
        ("object.toml", f"{_OBJECT} (or kind = 'cloth', width, height)"),
    ):
        if not (place / name).is_file():
            found.lacks("is missing", place / name, near_name(place / name) or f"write {content}")
    return found


def _extent(points: Array, found: Finding, *, units: bool = True) -> dict[str, str]:
    """How large a scene is, and what is wrong with its units and axes."""
    from gendom.perception.quality import level_axis

    if not len(points):
        found.lacks("has no points", "points", "check the cropping and the depth range")
        return {}
    size = np.ptp(points, axis=0)
    if units and (size.max() > _LARGEST_SCENE or size.max() < _SMALLEST_SCENE):
        unit = "millimetres; divide by 1000" if size.max() > _LARGEST_SCENE else "kilometres"
        found.lacks(f"spans {size.max():.4g} m", "points", f"they look like {unit}")
    axis = level_axis(points)
    if axis in (0, 1):
        name = "xyz"[axis]
        what = f"the largest plane lies across {name}, as a table where {name} is up"
        fix = "give a world with z up, or check that this plane is a wall"
        found.lacks(what, "points", fix, "warning")
    return {"extent": " x ".join(f"{x:.3g}" for x in size) + " m"}


def _bag(place: Path) -> Finding:
    from gendom.perception.ros import bag_content

    content = bag_content(place)
    found = Finding(f"a bag of ROS {1 if bag_files(place)[0].suffix == '.bag' else 2}")
    found.rows = {n: f"{kind}, {count} messages" for n, (kind, count) in content.topics.items()}
    found.summary = {"topics": content.topics, "grippers": content.grippers}
    if content.of_realsense:
        found.kind = "a recording of the RealSense SDK"
        fix = "put it into DIR/cameras/NAME beside camera.toml, DIR/object.toml and DIR/gripper.csv"
        found.lacks("is one camera", place, f"{fix}, then gendom perceive DIR (docs/perception.md)")
        return found
    if not content.cameras:
        fix = "record PointCloud2, or depth Image and CameraInfo"
        found.lacks("holds no clouds and no depth", place, fix)
    if not content.grippers:
        fix = "record /tf (of quaternions of length 1), or the gripper's PoseStamped"
        found.lacks("does not say where the gripper is", place, fix)
    if found.faults:
        return found
    found.rows["gripper"] = f"perhaps {', '.join(content.grippers[:4])}"
    held = (place if place.is_dir() else place.parent) / "object.toml"
    if not held.exists():
        found.lacks("is missing", held, f"write {_OBJECT}; or name another file by --object")
    _bag_cameras(place, held, content.grippers[0], found)
    return found


def _bag_cameras(place: Path, held: Path, gripper: str, found: Finding) -> None:
    """Whether `gendom perceive` or `gendom import` takes a bag, whatever is held."""
    from gendom.perception import RosSettings, read_ros_cameras

    command, does = "import", "Write a recording of the clouds as they are."
    with tempfile.TemporaryDirectory() as folder:
        some = held if held.exists() else Path(folder) / "object.toml"
        if some is not held:
            some.write_text('[object]\nkind = "rope"\nlength = 0.5\n', encoding="utf-8")
        try:
            recorded = read_ros_cameras(place, some, RosSettings(gripper=gripper))
            stated = _cameras_seen(recorded, found)
            known = stated if some is held else None
            size = (known and (known.length or known.width)) or 0.0
            points = np.concatenate([np.zeros((0, 3)), *found.clouds])
            if not len(points) or np.ptp(points, axis=0).max() >= 1.5 * size:  # more is in view
                command, does = "perceive", _PERCEIVE
        except RecordingError as error:
            if error.fix is None or "gendom import" not in error.fix:
                raise
    found.step(does, command, place, "--gripper", gripper, "--out", f"{place.stem}.npz")


def _depth(place: Path) -> Finding:
    from gendom.perception import read_cameras

    found = Finding("depth pictures of cameras")
    _cameras_seen(read_cameras(place, on_warning=found.faults.append), found)
    if all(fault.severity == "warning" for fault in found.faults):
        found.step(_PERCEIVE, "perceive", place, "--out", f"{place.resolve().name}.npz")
    return found


def _cameras_seen(recorded: CameraRecording, found: Finding) -> ObjectDescription | None:
    """What cameras see in their first picture, in the world, as `gendom perceive` looks at it.
    Returns the object as stated, where it is."""
    from gendom.datasets.recording_form import parse_meta
    from gendom.perception import CameraView, PerceptionSettings
    from gendom.perception.perceive import within_reach
    from gendom.perception.quality import odd_intrinsics

    values, faults = parse_meta(recorded.meta)
    found.faults += faults
    path, table, stated = recorded.robot, values["table_height"], values.get("object")
    found.gripper, found.table = path.position[:, 0], table
    box = within_reach(recorded, (stated and stated.size) or 0.5, table)
    for source in recorded.sources:
        camera, name = source.camera, source.camera.name
        odd = [*odd_intrinsics(camera)] if getattr(source, "stated", True) else []
        found.faults += odd
        found.rows[name] = f"{camera.width} x {camera.height}, f {camera.K[0, 0]:.0f} pixels"
        try:
            frame = next(iter(source))
            depth, view = frame.read().depth, CameraView(camera, PerceptionSettings(workspace=box))
            raw = depth.ravel()
            seen = np.flatnonzero(raw)[:: max(1, np.count_nonzero(raw) // _POINTS)]
            away, share = np.median(raw[seen]) * camera.depth_unit, np.count_nonzero(raw) / raw.size
            found.rows[name] += f", depth in {100 * share:.0f} % of the first picture, "
            found.rows[name] += f"median {away:.2f} m"
            found.clouds.append(view.points(raw, seen))
            if not odd:  # which would pass for another unit
                view.check_depth(depth, table)
        except StopIteration:
            found.lacks("holds no picture", name, "record again")
            continue
        except RecordingError as error:
            found.lacks(error.what, error.where or name, error.fix or "record again")
            continue
        if path.at(frame.time) is None:
            first, last = (time_text(time) for time in path.time[[0, -1]])
            what = f"its first picture is of {time_text(frame.time)} s, the gripper's path of "
            found.lacks(f"{what}{first} to {last} s", name, "put all times on one clock")
        view.find_table(depth, table)
        if table is not None and view.table is None:
            fix = "check T_world_camera (camera to world, not its inverse) and table_height"
            found.lacks(f"sees no table at z = {table:g} m", name, fix, "warning")
    if found.clouds:
        found.rows |= _extent(np.concatenate(found.clouds), found, units=False)
    return stated


def _board(place: Path) -> Finding:
    from gendom.perception.calibration import read_board, read_poses

    board, poses = read_board(place / "board.toml"), read_poses(place / "poses.csv")
    found = Finding("pictures of a board, for a camera's calibration")
    size = f"{board.squares_x} x {board.squares_y} squares of {1e3 * board.square:g} mm"
    found.rows = {"board": size, "pictures": str(len(poses))}
    files = (place / "camera.toml", *place.glob("*.toml"))
    camera = next((p for p in files if p.is_file() and "K" in read_toml(p)), None)
    if camera is None:
        fix = "write it with width, height, K and depth_unit of the stream that took the pictures"
        found.lacks("is missing", place / "camera.toml", fix)
        return found
    does = "Find the camera's pose, and how far it may be trusted."
    found.step(does, "calibrate", place, "--camera", camera, "--out", camera)
    return found


def _toml(place: Path) -> Finding:
    table = read_toml(place, error=RecordingError)
    if "K" in table or "T_world_camera" in table:
        from gendom.perception import read_camera
        from gendom.perception.quality import odd_intrinsics

        camera = read_camera(place)
        T = camera.T_world_camera
        known = "no pose yet" if T is None else f"at {camera.position.round(3)} m"
        rows = {"camera": f"{camera.width} x {camera.height}, {known}"}
        return Finding("a camera", rows, faults=[*odd_intrinsics(camera)])
    what, fix = "is no table that is known", "known are camera.toml and cell.toml"
    right = "robot" in table and "address" in table
    require(right, what, where=str(place), fix=fix, error=RecordingError)
    found = Finding("a cell")
    found.step("Check the cell.", "cell", "check", place)
    return found


def _json(place: Path) -> Finding:
    from gendom.materials.estimate import Estimate

    estimate = Estimate.load(place)
    found = Finding(f"an estimate of a {estimate.kind}")
    found.rows = {name: value for name, value, _ in estimate.rows()}
    found.rows["verdict"] = "usable" if estimate.usable else "not usable"
    if estimate.usable:
        from gendom.cli.estimate import task_and_goal

        task, does = task_and_goal(estimate.kind, estimate.known.get("length")), "Get an action"
        does += " for this object, and the robot's motion."
        found.step(does, "act", *task, "--params", place)
    return found


def _lerobot(place: Path) -> Finding:
    own = place / "meta/gendom.json"
    form = read_json(own, RecordingError).get("format") if own.exists() else ""
    if str(form).startswith("gendom-recording/"):
        found = _recording(place)
        found.kind = "a recording as a data set of LeRobot"
        return found
    info = read_json(place / "meta/info.json", RecordingError)
    names = ("codebase_version", "robot_type", "total_episodes", "total_frames", "fps")
    found = Finding("a data set of LeRobot", {n: str(info[n]) for n in names if n in info})
    fix = "gendom reads those that gendom export made of a recording"
    found.lacks("is not a recording", place, fix, "warning")
    return found


def _poses(place: Path) -> Finding:
    from gendom.perception.poses import read_poses

    found = Finding("a calibration of another program")
    for pose in read_poses(place):
        x, y, z = pose.T[:3, 3]
        found.rows[pose.child] = f"at ({x:.3f}, {y:.3f}, {z:.3f}) m in {pose.parent}"
    does = "in camera.toml, or --poses of gendom perceive for a ROS bag"
    found.rows["use"] = f'T_world_camera = "{place.name}" {does}'
    return found


def _below(place: Path) -> Finding:
    """A folder that is nothing itself: what its folders and files are."""
    found = Finding("a folder")
    for path in sorted(place.iterdir())[:200]:
        known = [holds for holds, _ in _FOLDERS if path.is_dir() and holds(path)]
        if known or (path.suffix.lower() in (".npz", *BAGS) and path.is_file()):
            found.step("Look into it.", "doctor", path)
    active = sorted(place.glob("*.bag.active"))
    if active:
        found.lacks("was not closed by its recorder", active[0], "mend it: rosbag reindex FILE")
    elif not found.next:
        fix = "unpack what is packed; docs/data.md and docs/perception.md say what is known"
        found.lacks("holds nothing that is known", place, fix)
    return found


_FOLDERS: list[tuple[Callable[[Path], bool], Callable[[Path], Finding]]] = [
    (lambda p: (p / "meta/info.json").is_file(), _lerobot),
    (lambda p: (p / "cameras").is_dir(), _depth),
    (lambda p: (p / "board.toml").is_file() or (p / "poses.csv").is_file(), _board),
    (lambda p: bool(bag_files(p)) and not (p / "gripper.csv").is_file(), _bag),
    (lambda p: (p / "gripper.csv").is_file() and (p / "object.toml").is_file(), _recording),
    (lambda p: any(f.suffix.lower() in (".ply", ".pcd") for f in p.iterdir()), _clouds),
    (lambda p: (p / "gripper.csv").is_file(), _recording),
    (lambda p: (p / "estimate.json").is_file(), lambda p: _json(p / "estimate.json")),
]
"""Whether a folder is of a kind, and what looks into it."""

_FILES: dict[str, Callable[[Path], Finding]] = {
    ".npz": _recording,
    ".json": _json,
    ".toml": _toml,
    **dict.fromkeys((".ply", ".pcd"), _clouds),
    **dict.fromkeys(BAGS, _bag),
    **dict.fromkeys((".yaml", ".yml", ".calib", ".launch", ".xml", ".py"), _poses),
}
"""What looks into a file, by its suffix."""
