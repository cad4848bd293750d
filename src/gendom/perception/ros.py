"""Recordings from bags of ROS 1 and ROS 2: what cameras saw, and the gripper's motion.

What is read of which messages, docs/data.md says. `read_ros_bag` takes the clouds as they are,
`read_ros_cameras` makes cameras of them for `gendom.perception.perceive`, which removes table and
robot. All is brought into one frame, the world's. Times are those of the headers.
"""

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arrays import Array, placed
from gendom.datasets import Fault, Recording
from gendom.datasets.folder import read_object
from gendom.datasets.recording_form import parse_meta
from gendom.errors import RecordingError
from gendom.perception.camera import expect
from gendom.perception.folder import CameraRecording, RobotPath
from gendom.perception.frames import Frame, MatchedFrames
from gendom.perception.poses import read_poses
from gendom.perception.robot import Capsules, arm_capsules
from gendom.perception.ros_bag import RosBag
from gendom.perception.ros_cameras import cloud_camera, depth_camera, topics_of
from gendom.perception.ros_frames import FrameTree, Track, stamp
from gendom.perception.ros_messages import CLOUD, IMAGE, JOINTS, PACKED, POSES, TF, points_of
from gendom.robot import Arm, JointStates, find_arm

Box = tuple[float, float, float, float, float, float]

_LIKELY = ("tcp", "fingertip", "grasp", "tool", "gripper", "hand", "ee", "flange")
"""In names of the point between the fingertips, the likeliest first."""

_MOST_SHIFT, _MOST_TURN = 0.002, np.radians(0.2)  # [m], [rad]; beyond, a camera moves


@dataclass(frozen=True, kw_only=True)
class RosSettings:
    """Selection of the data to read from a bag."""

    gripper: str = ""
    """Of a bag: frame of the point between the fingertips, or topic of its poses."""
    points: tuple[str, ...] = ()
    """Of a bag: topics of the clouds or the depth; by default all, one of each frame."""
    world: str | None = None
    """Of a bag: frame of the recording, z up; by default the root of TF."""
    poses: tuple[Path, ...] = ()
    """Of a bag: files with cameras' poses, of easy_handeye (YAML) or MoveIt (a launch file)."""


def read_ros_bag(
    path: str | os.PathLike,
    object_file: str | os.PathLike,
    settings: RosSettings,
    *,
    workspace: Box | None = None,
    on_warning: Callable[[Fault], None] = lambda _: None,
) -> Recording:
    """Read a recording from a bag, its clouds as they are.

    Args:
        path: The bag.
        object_file: What is held, as object.toml of a folder (see `gendom.datasets.folder`).
        settings: What is read.
        workspace: x0 y0 z0 x1 y1 z1 in the world [m]; points elsewhere are left out.
        on_warning: Called with what is left out.

    Raises:
        RecordingError: The bag cannot be read or lacks something, or the recording is not valid.
        ModuleNotFoundError: There is no rosbags.
    """
    scene = _Scene(path, object_file, settings)
    chosen = _chosen(scene, settings.points, (CLOUD,), f"; gendom perceive {path} takes depth")
    matched = MatchedFrames([scene.bag.frames(topic) for topic in chosen])
    clouds, times, positions, left_out = [], [], [], 0
    for frames in matched:
        parts = [scene.placed(frame) for frame in frames]
        time = float(np.mean([frame.time for frame in frames]))
        held = scene.gripper(np.array([time]), parts[0][1])[0, 0]
        cloud = np.concatenate([part for part, _ in parts])
        if not np.isfinite(held).all() or not np.isfinite(cloud).all():
            left_out += 1
            continue
        if workspace is not None:
            low, high = np.reshape(workspace, (2, 3))
            cloud = cloud[((cloud >= low) & (cloud <= high)).all(axis=1)]
        clouds.append(cloud.astype(np.float32))
        times.append(time)
        positions.append(held)
    where, topics = scene.bag.where, ", ".join(chosen)
    what = f"none of {left_out} clouds lies in the time in which the gripper's place is known"
    what = what if matched.used else f"no clouds of {topics} are of one time"
    fix = "record /tf, or the gripper's poses, as long as the clouds"
    expect(clouds, what, where, fix)
    if left_out:
        what = f"{left_out} of {left_out + len(clouds)} clouds lie outside of the time in which "
        what += "frames are known; they are left out"
        on_warning(Fault(what, topics, "record /tf as long as the clouds", "warning"))
    for fault in matched.left_out(chosen):
        on_warning(fault)
    values = scene.values
    values["extra"] |= {"ros": {"points": chosen, "gripper": settings.gripper}}
    values["extra"] |= {"started": times[0], "world": scene.world}
    time, position = np.array(times) - times[0], np.array(positions)[:, None]
    made = Recording.from_frames(clouds, time=time, gripper_position=position, **values)
    try:
        made.require_valid(where, on_warning=on_warning)
    except RecordingError as error:
        if workspace is None and any(f.where == "points" for f in error.faults):
            fault = error.faults[0]
            fix = f"{fault.fix}; if table or robot are in the clouds: gendom perceive {path} "
            faults = [replace(fault, fix=f"{fix}--gripper {settings.gripper}"), *error.faults[1:]]
            raise RecordingError(where=where, faults=faults) from None
        raise
    return made


def read_ros_cameras(
    path: str | os.PathLike,
    object_file: str | os.PathLike,
    settings: RosSettings,
    *,
    cameras: Sequence[str] = (),
    arm: Arm | None = None,
) -> CameraRecording:
    """Cameras, the robot's path and the object of a bag, for `gendom.perception.perceive`.

    Clouds of an optical frame become pictures of a camera, that of a CameraInfo of their frame if
    there is one.

    Args:
        path: The bag.
        object_file: What is held, as object.toml of a folder (see `gendom.datasets.folder`).
        settings: What is read.
        cameras: Names of those to use, the first parts of their topics; by default all.
        arm: The robot of the joint states; by default the one that the object's file names.

    Raises:
        RecordingError: The bag cannot be read or lacks something, or a camera moves.
        ModuleNotFoundError: There is no rosbags.
    """
    scene = _Scene(path, object_file, settings)
    where, names = scene.bag.where, {}
    chosen = _chosen(scene, settings.points, (IMAGE, PACKED, CLOUD))
    for topic, name in _named(chosen).items():
        names[name] = topic
    for name in cameras:
        expect(name in names, f"there is no camera {name!r}", where, f"have {', '.join(names)}")
    sources = [
        cloud_camera(scene.bag, names[name], name, scene.world)
        if scene.bag.topics[names[name]] == CLOUD
        else depth_camera(scene.bag, names[name], name, scene.frames)
        for name in cameras or names
    ]
    frame = sources[0].frame_id
    scene.world = scene.world or frame
    at_rest: list[Any] = [source.at(_at_rest(scene, source.frame_id)) for source in sources]
    times = scene.times()
    position = scene.gripper(times, frame)
    known = np.isfinite(position).all(axis=(1, 2))
    what, fix = "does not move, or its place is never known", "record /tf, or the gripper's poses"
    expect(known.sum() > 1, what, f"{where}: {settings.gripper}", fix)
    path_of = RobotPath(times[known], position[known])
    capsules = _capsules(scene, arm)
    return CameraRecording(at_rest, path_of, scene.meta, capsules, where)


@dataclass(frozen=True)
class BagContent:
    """What a bag holds."""

    topics: dict[str, tuple[str, int]]
    """Type, without its package, and number of messages of each topic."""
    cameras: list[str]
    """Topics of clouds, or else of depth."""
    grippers: list[str]
    """Frames of TF that move, and topics of poses, the likeliest first."""
    of_realsense: bool
    """Whether the SDK of RealSense cameras recorded it."""


def bag_content(path: str | os.PathLike) -> BagContent:
    """Look into a bag.

    Raises:
        RecordingError: It cannot be read.
        ModuleNotFoundError: There is no rosbags.
    """
    bag = RosBag(path)
    tree = _tree(bag)
    moving = [f for f in tree.tracks if len(tree.times(f)) > 1 and "optical" not in f]
    poses = [name for name, kind in bag.topics.items() if kind in POSES and bag.counts[name]]

    def likeliness(name: str) -> tuple[int, int, str]:
        known = [k for k, word in enumerate(_LIKELY) if word in name.lower()]
        depth = 0 if name.startswith("/") else len(tree.lineage(name))
        return (min(known, default=len(_LIKELY)), -depth, name)

    cameras = next(filter(None, (topics_of(bag, k) for k in (IMAGE, PACKED, CLOUD))), [])
    topics = {n: (k.rpartition("/")[2], bag.counts[n]) for n, k in sorted(bag.topics.items())}
    return BagContent(topics, cameras, sorted([*moving, *poses], key=likeliness), is_sdk(bag))


def is_sdk(bag: RosBag) -> bool:
    """Whether the SDK of RealSense cameras recorded a bag."""
    return any(name.startswith("/device_0/") for name in bag.topics)


def _tree(bag: RosBag) -> FrameTree:
    """All that a bag says of frames."""
    tree = FrameTree(bag.where)
    for name, message in bag.messages(*(n for n, kind in bag.topics.items() if kind in TF)):
        for stated in message.transforms:
            tree.add(stated, still=name.endswith("tf_static"))
    return tree


class _Scene:
    """A bag's tree of frames, the gripper's track in it and the object."""

    def __init__(self, path: str | os.PathLike, object_file: Any, settings: RosSettings):
        object_file = Path(object_file)
        self.meta = {"gripper_source": "measured", **read_object(object_file)}
        self.values, faults = parse_meta(self.meta)
        if faults:
            raise RecordingError(where=str(object_file), faults=faults)
        self.bag, self.track, self.name = RosBag(path), None, settings.gripper
        self.values["source"] = self.values["source"] or f"ROS bag {Path(path).name}"
        self.frames = _tree(self.bag)
        for file in settings.poses:
            for pose in read_poses(file):
                self.frames.attach(pose)
        self.world = settings.world or self.frames.root
        plain = self.name.lstrip("/")  # of a frame as it was called in tf
        if self.name not in self.bag.topics and plain in self.frames.tracks:
            self.name = plain
        if self.name.startswith("/"):
            self.track = self._poses(self.name)

    def _poses(self, topic: str) -> Track:
        """The gripper's track from a topic; of one that names no frame it is in the world."""
        kind = self.bag.topics.get(topic, "")
        _check_type(self.bag, topic, tuple(POSES))
        track = Track(f"{self.bag.where}: {topic}")
        for _, message in self.bag.messages(topic):
            header = getattr(message, "header", None) or message.o_t_ee.header
            track.add(header.frame_id.lstrip("/"), stamp(header), *POSES[kind](message))
        expect(track.times, "has no message", track.where, "record it")
        return track

    def gripper(self, times: Array, seen_in: str) -> Array:
        """[N, 1, 3] places at times [s] in the world, which without TF is the frame in which things
        are seen [m]; NaN: unknown."""
        self.world = self.world or seen_in
        if self.track is None:
            return self.frames.between(self.world, self.name, times)[:, None, :3, 3]
        bases = [name for name in self.frames.tracks if name.endswith("link0")]  # of a Franka
        frame = self.track.frame or next(iter(bases), self.world)
        T = self.frames.between(self.world, frame, times) @ self.track.at(times)
        return T[:, None, :3, 3]

    def times(self) -> Array:
        """Times at which the gripper's place is known [s]."""
        if self.track is None:
            return self.frames.times(self.name, self.world)
        return np.unique(self.track.times)

    def placed(self, seen: Frame) -> tuple[Array, str]:
        """A cloud's points [n, 3] in the world [m], NaN where its place is unknown, and the frame
        it is in."""
        message: Any = seen.read()
        frame = message.header.frame_id.lstrip("/")
        self.world = self.world or frame
        (T,) = self.frames.between(self.world, frame, np.array([seen.time]))
        cloud, known = points_of(message, seen.where)
        return placed(T, cloud[known]), frame


def _check_type(bag: RosBag, name: str, kinds: Sequence[str]) -> None:
    """Refuse a topic that is missing or of another type."""
    others = ", ".join(n for n, k in bag.topics.items() if k in kinds)
    wanted = " or ".join(kinds)
    what = f"{name} is no {wanted}" if name in bag.topics else f"has no topic {name} of {wanted}"
    fix = f"give one of: {others}" if others else "record one"
    what += "" if others else ", nor another one"
    expect(bag.topics.get(name) in kinds, what, bag.where, fix)


def _chosen(
    scene: _Scene, wanted: Sequence[str], kinds: tuple[str, ...], otherwise: str = ""
) -> list[str]:
    """The topics that are read: those wanted, or of the first kind that there is all, but for the
    same pictures once more; `otherwise` is what to do where there are none."""
    bag = scene.bag
    for topic in wanted:
        _check_type(bag, topic, kinds)
    if wanted:
        return list(wanted)
    what = "is a recording of the RealSense SDK, of depth pictures"
    fix = "put it into DIR/cameras/NAME and run gendom perceive DIR"
    expect(not is_sdk(bag), what, bag.where, fix)
    found: list[str] = next(filter(None, (topics_of(bag, kind) for kind in kinds)), [])
    what, fix = (
        f"has no topic of {' or '.join(kinds)}",
        "record clouds, or depth and its CameraInfo",
    )
    expect(found, what, bag.where, f"{fix}{otherwise}")
    by_frame: dict[str, str] = {}
    for topic in found:
        message = bag.first(topic)
        if message is None:
            continue
        frame, other = message.header.frame_id, by_frame.get(message.header.frame_id)
        what = f"has {other} and {topic}, both of frame {frame}"
        expect(other is None, what, bag.where, "name one with --points")
        by_frame[frame] = topic
    expect(by_frame, f"has no message of {', '.join(found)}", bag.where, "record them")
    return list(by_frame.values())


def _named(topics: list[str]) -> dict[str, str]:
    """Topics and a short name for each: the first parts in which they differ."""
    parts = {topic: topic.strip("/").split("/") for topic in topics}
    for n in range(1, max(map(len, parts.values())) + 1):
        names = {topic: "_".join(part[:n]) for topic, part in parts.items()}
        if len(set(names.values())) == len(topics):
            return names
    return {topic: topic.strip("/").replace("/", "_") for topic in topics}


def _at_rest(scene: _Scene, frame: str) -> Array:
    """Pose [4, 4] of a camera's frame in the world [m], which must not change."""
    times = scene.frames.times(frame, scene.world)
    some = times[np.unique(np.linspace(0, len(times) - 1, 50).astype(int))]
    T = scene.frames.between(scene.world, frame, some)
    T = T[np.isfinite(T).all(axis=(1, 2))]
    expect(len(T), f"frame {frame} has no place", scene.bag.where, "record /tf longer")
    shift = np.linalg.norm(T[:, :3, 3] - T[0, :3, 3], axis=1).max()
    cosine = 0.5 * (np.einsum("nij,ij->n", T[:, :3, :3], T[0, :3, :3]).min() - 1.0)
    turn = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    what = f"frame {frame} moves in {scene.world} by {1e3 * shift:.1f} mm and {turn:.2g} rad"
    fix = "name the robot's base with --world; clouds of a moving camera take gendom import"
    right = shift <= _MOST_SHIFT and turn <= _MOST_TURN
    expect(right, what, scene.bag.where, fix)
    return T[0]


def _capsules(scene: _Scene, arm: Arm | None) -> Callable[[float], Capsules] | None:
    """The robot's shape at a time from its joint states, where it is known which robot it is."""
    named, bag = scene.values["extra"].get("robot"), scene.bag
    topics = [n for n, kind in bag.topics.items() if kind == JOINTS]
    if not topics or (arm is None and not isinstance(named, str)):
        return None
    arm = arm or find_arm(named)
    rows: dict[float, list[float]] = {}
    for _, message in bag.messages(*topics):
        # The arm's joints are numbered; fingers and others are not among the first of them.
        joints = sorted(
            (int(number[1]), float(q))
            for name, q in zip(message.name, message.position, strict=False)
            if (number := re.search(r"joint[_a-z]*(\d+)$", name)) and "finger" not in name
        )
        if len(joints) >= arm.joints:
            rows[stamp(message.header)] = [q for _, q in joints[: arm.joints]]
    if len(rows) < 2:
        return None
    times = sorted(rows)
    states = JointStates(np.array(times), np.array([rows[t] for t in times]), None)
    held = scene.values["object"]
    return arm_capsules(arm, states, held=held.diameter or held.thickness or 0.0)
