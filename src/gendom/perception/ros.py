"""Recordings from ROS 2 bags: clouds of a topic, and the gripper's motion from TF or a topic.

A bag is a folder with metadata.yaml, or one or all of its files (.db3, .mcap). Read are

    sensor_msgs/msg/PointCloud2    the clouds, of one topic, or
    sensor_msgs/msg/Image          depth, 16UC1 in millimetres or 32FC1 in metres, also as a
                                   CompressedImage (PNG), with its CameraInfo
    tf2_msgs/msg/TFMessage         /tf and /tf_static: where frames are
    geometry_msgs/msg/PoseStamped  the gripper, where it is no frame of TF

Clouds and the gripper are brought into one frame, the world's. Times are those of the headers.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from gendom.datasets import Fault, Recording
from gendom.datasets.folder import read_object
from gendom.datasets.npz import short
from gendom.datasets.recording_form import parse_meta
from gendom.errors import RecordingError
from gendom.perception.camera import Camera, expect, rigid
from gendom.perception.rosbag import (
    ANY_SIZE,
    ZSTD,
    decompressed,
    open_database,
    packed_picture,
    raw_picture,
)
from gendom.reading import check_unpacked, file_size, read_bytes

Array = NDArray[np.float64]

CLOUD, IMAGE, PACKED, INFO = (
    f"sensor_msgs/msg/{name}" for name in ("PointCloud2", "Image", "CompressedImage", "CameraInfo")
)
POSE, TF = "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage"
_SUFFIXES = (".db3", ".mcap")
_LARGEST_METADATA, _MOST_MARKS = 1 << 17, 6000  # [bytes], lines and parts: YAML is read slowly
_DENORMAL = 0.01  # of a quaternion's squared length, as tf2 has it
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # of PointField


@dataclass(frozen=True, kw_only=True)
class RosSettings:
    """Selection of the data to read from a bag."""

    gripper: str = ""
    """Of a bag: frame of the point between the fingertips, or topic of its poses."""
    points: str | None = None
    """Of a bag: topic of the clouds, if there are several."""
    world: str | None = None
    """Of a bag: frame of the recording, z up; by default the root of TF."""
    workspace: tuple[float, float, float, float, float, float] | None = None
    """Of a bag: x, y and z from and to in the world, in metres; points elsewhere are left out."""


def bag_files(path: str | os.PathLike) -> list[Path]:
    """What of a ROS 2 bag is opened: a folder with metadata.yaml, or else the files of one kind in
    it, or the file itself; empty: it is no bag."""
    path = Path(path)
    if not path.is_dir():
        return [path] if path.suffix in _SUFFIXES else []
    if (path / "metadata.yaml").exists():
        return [path]
    found = [sorted(path.glob(f"*{suffix}")) for suffix in _SUFFIXES]
    return next(filter(None, found), [])


def read_ros_bag(
    path: str | os.PathLike,
    object_file: str | os.PathLike,
    settings: RosSettings,
    *,
    on_warning: Callable[[Fault], None] = lambda _: None,
) -> Recording:
    """Read a recording from a bag.

    Args:
        path: The bag.
        object_file: What is held, as object.toml of a folder (see `gendom.datasets.folder`).
        settings: What is read.
        on_warning: Called with what is left out.

    Raises:
        RecordingError: The bag cannot be read or lacks something, or the recording is not valid.
        ModuleNotFoundError: There is no rosbags.
    """
    where = str(path)
    values, faults = parse_meta(read_object(Path(object_file)))
    if faults:
        raise RecordingError(where=str(object_file), faults=faults)
    with _opened(path) as bag:
        topics = {c.topic: c.msgtype for c in bag.connections}
        topic = _cloud_topic(topics, settings.points, where)
        points_of = _reader(bag, topics, topic, where)
        frames, gripper, poses = _Frames(where), settings.gripper, None
        for name, message in _messages(bag, *(name for name, kind in topics.items() if kind == TF)):
            for stated in message.transforms:
                frames.add(stated, still=name.endswith("tf_static"))
        if gripper.startswith("/"):
            _check_type(topics, gripper, POSE, where)
            poses = _Track(f"{where}: {gripper}")
            for _, message in _messages(bag, gripper):
                poses.add(message.header, message.pose.position, message.pose.orientation)
            expect(poses.times, "has no message", where=poses.where, fix="record it")
        world, clouds, times, positions, left_out = settings.world or frames.root, [], [], [], 0
        for _, message in _messages(bag, topic):
            time, frame = _time(message.header), message.header.frame_id
            world = world or frame
            try:
                T = frames.between(world, frame, time)
                held = frames.between(world, poses.frame if poses else gripper, time)
                held = held @ poses.at(time) if poses else held
            except _OutOfTimeError:
                left_out += 1
                continue
            cloud = points_of(message) @ T[:3, :3].T + T[:3, 3]
            if settings.workspace is not None:
                low, high = np.reshape(settings.workspace, (3, 2)).T
                cloud = cloud[((cloud >= low) & (cloud <= high)).all(axis=1)]
            clouds.append(cloud.astype(np.float32))
            times.append(time)
            positions.append(held[:3, 3])
    what = f"none of {left_out} clouds lies in the time in which the gripper's place is known"
    fix = "record /tf, or the gripper's poses, as long as the clouds"
    expect(clouds, what, where=where, fix=fix)
    if left_out:
        what = f"{left_out} of {left_out + len(clouds)} clouds lie outside of the time in which "
        what += "frames are known; they are left out"
        on_warning(Fault(what, topic, "record /tf as long as the clouds", "warning"))
    values["source"] = values["source"] or f"ROS bag {Path(path).name}"
    values["extra"] |= {"ros": {"points": topic, "gripper": gripper}}
    values["extra"] |= {"started": times[0], "world": world}
    time = np.array(times) - times[0]
    made = Recording.from_frames(clouds, time=time, gripper_position=np.array(positions), **values)
    made.require_valid(where, on_warning=on_warning)
    return made


@contextmanager
def _opened(path: str | os.PathLike) -> Iterator[Any]:
    """The bag's reader."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    files, store = bag_files(path), get_typestore(Stores.ROS2_HUMBLE)
    there, fix = bool(files) and Path(path).exists(), "check the path"
    expect(there, "no such bag", where=str(path), fix=fix)
    try:
        for file in files if files[0].is_file() else sorted(files[0].iterdir()):
            _check_file(file)
        with AnyReader(files, default_typestore=store) as bag:
            yield bag
    except (RecordingError, ModuleNotFoundError):
        raise
    except Exception as error:  # the reader's, and whatever its decoders make of damaged data
        what = f"cannot be read as a ROS 2 bag ({short(error)})"
        fix = "give the bag's folder, whole; ros2 bag reindex may mend it"
        raise RecordingError(what, where=str(path), fix=fix) from error


def _check_file(path: Path) -> None:
    """Refuse a bag's file that is no regular file or plain database, or in which something is
    damaged or unpacks to too much."""
    if path.suffix == ".yaml":
        text = read_bytes(path, RecordingError, most=_LARGEST_METADATA)
        marks = sum(map(text.count, (b"\n", b"[", b"{", b",", b"- ", b"? ")))
        what, fix = f"has {marks} lines and parts, at most {_MOST_MARKS} are read", "split the bag"
        expect(marks <= _MOST_MARKS, what, where=str(path), fix=fix)
    elif path.suffix == ".db3":
        with closing(open_database(path)) as database:
            packed = "SELECT data FROM messages WHERE substr(data, 1, 4) = ?"
            for (data,) in database.execute(packed, (ZSTD,)):
                decompressed(data)
    elif path.suffix in (".mcap", ".zstd"):
        size = file_size(path, RecordingError, most=ANY_SIZE)
        with open(path, "rb") as file:
            if path.suffix == ".mcap":
                _check_chunks(file, size)
            else:
                _check_stream(file, size)


def _check_chunks(file: BinaryIO, size: int) -> None:
    """Unpack each chunk of a .mcap file (its specification, "Chunk")."""
    at = 8
    while at < size:
        file.seek(at)
        head = file.read(49)
        kind, length = head[0], int.from_bytes(head[1:9], "little")
        if kind == 6 and len(head) == 49:
            word = int.from_bytes(head[37:41], "little")
            codec = (head[41:] + file.read(word))[: min(word, 8)].decode("latin-1")
            file.seek(at + 49 - 8 + word)
            packed = file.read(min(int.from_bytes(file.read(8), "little"), size))
            if codec in ("lz4", "zstd"):
                decompressed(packed, codec)
        at += 9 + length


def _check_stream(file: BinaryIO, size: int) -> None:
    """Unpack a file of zstd, piece by piece."""
    import pyarrow

    there = 0
    with pyarrow.CompressedInputStream(file, "zstd") as stream:
        while piece := stream.read(1 << 20):
            there += len(piece)
            check_unpacked(there, size, "compressed file", RecordingError)


def _messages(bag: Any, *topics: str) -> Iterator[tuple[str, Any]]:
    """Topics and messages of some topics, in the order in which they came."""
    wanted = [c for c in bag.connections if c.topic in topics]
    if wanted:
        for connection, _, data in bag.messages(connections=wanted):
            yield connection.topic, bag.deserialize(data, connection.msgtype)


def _cloud_topic(topics: dict[str, str], wanted: str | None, where: str) -> str:
    """The topic of the clouds, or else of depth pictures."""
    if wanted is not None:
        if topics.get(wanted) not in (IMAGE, PACKED):
            _check_type(topics, wanted, CLOUD, where)
        return wanted
    own = [name for name, kind in topics.items() if kind == CLOUD]
    is_realsense = not own and any(name.startswith("/device_0/") for name in topics)
    what = "is a recording of the RealSense SDK, of depth pictures"
    fix = "put it into DIR/cameras/NAME and run gendom perceive DIR"
    expect(not is_realsense, what, where=where, fix=fix)
    for kind in (IMAGE, PACKED):
        depth = [name for name, k in topics.items() if k == kind and "depth" in name.lower()]
        own = own or depth
    what = f"has {len(own)} topics of clouds or depth" + (f": {', '.join(own)}" if own else "")
    fix = "name one with --points" if own else f"record a {CLOUD}, or depth and its CameraInfo"
    expect(len(own) == 1, what, where=where, fix=fix)
    return own[0]


def _reader(
    bag: Any, topics: dict[str, str], topic: str, where: str
) -> Callable[[Any], NDArray[np.floating]]:
    """What makes a cloud [n, 3] of a message, in its own frame [m]."""
    where = f"{where}: {topic}"
    if topics[topic] == CLOUD:
        return lambda message: _points(message, where)
    folders = topic.split("/")
    above = ["/".join(folders[:n]) for n in range(len(folders) - 1, 0, -1)]
    named = (f"{folder}/camera_info" for folder in above)
    found = next((name for name in named if topics.get(name) == INFO), None)
    info: Any = next((message for _, message in _messages(bag, found)), None) if found else None
    what = "are depth pictures without a CameraInfo beside them"
    expect(info, what, where=where, fix="record camera_info too")
    K, D = np.reshape(info.k, (3, 3)), tuple(map(float, info.d))
    if "image_rect" in topic:
        K, D = np.reshape(info.p, (3, 4))[:, :3], ()
    D = D if any(D) else ()
    size = {"width": int(info.width), "height": int(info.height)}
    camera = Camera(name=where, K=K, distortion=D, T_world_camera=None, **size)
    rays = camera.rays()

    def points(message: Any) -> NDArray[np.floating]:
        try:
            depth = _depth(message, topics[topic], where)
        except ValueError as error:
            raise RecordingError(f"is damaged ({error})", where=where, fix="copy it") from None
        right = depth.size == len(rays)
        what = f"is {depth.shape[1]} x {depth.shape[0]}, its CameraInfo {camera.width} x "
        fix = "record the CameraInfo of these pictures"
        expect(right, f"{what}{camera.height}", where=where, fix=fix)
        z = depth.reshape(-1, 1) * (1e-3 if depth.dtype == np.uint16 else 1.0)
        seen = (np.isfinite(z) & (z > 0.0))[:, 0]
        return rays[seen] * z[seen]

    return points


def _depth(message: Any, kind: str, where: str) -> NDArray[Any]:
    """[height, width] uint16 [mm] or float32 [m] of a message; ValueError: it is damaged."""
    data = np.asarray(message.data, dtype=np.uint8).tobytes()
    if kind == PACKED:
        depth, said = packed_picture(data, message.format, where), message.format
    else:
        order, size = "<>"[bool(message.is_bigendian)], (message.width, message.height)
        depth = raw_picture(data, message.encoding, *size, message.step, order, where)
        said = message.encoding
    fix = "record 16UC1 or 32FC1, packed ones as 16UC1 PNG"
    right = depth.ndim == 2 and not said.startswith("32FC1;")
    expect(right, f"is {said[:40]!r}, no depth", where=where, fix=fix)
    return depth


def _check_type(topics: dict[str, str], name: str, kind: str, where: str) -> None:
    others = ", ".join(n for n, k in topics.items() if k == kind)
    what = f"{name} is no {kind}" if name in topics else f"has no topic {name} of {kind}"
    fix = f"give one of: {others}" if others else "record one"
    what += "" if others else ", nor another one"
    expect(topics.get(name) == kind, what, where=where, fix=fix)


def _time(header: Any) -> float:
    """Since 1970, to a quarter of a microsecond [s]."""
    return header.stamp.sec + 1e-9 * header.stamp.nanosec


class _OutOfTimeError(Exception):
    """A moving frame's pose is unknown at a time."""


class _Track:
    """Pose of an object over time, in one frame; of static ones the last counts."""

    def __init__(self, where: str, still: bool = False):
        self.where, self.still = where, still
        self.frame = ""
        self.times: list[float] = []
        self._poses: list[list[float]] = []

    def add(self, header: Any, at: Any, turn: Any) -> None:
        """A place and an orientation of messages."""
        what = f"is in {header.frame_id} after {self.frame}"
        expect(self.frame in ("", header.frame_id), what, where=self.where, fix="keep one")
        self.frame = header.frame_id
        self.times.append(_time(header))
        self._poses.append([at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w])

    @cached_property
    def _settled(self) -> tuple[Array, Array]:
        """Increasing times [M] [s] and poses [M, 7]; of equal times the last counts."""
        times, back = np.unique(self.times[::-1], return_index=True)
        poses = np.array(self._poses)[::-1][back]
        right = np.isfinite(poses).all() and (np.linalg.norm(poses[:, 3:], axis=1) >= 0.5).all()
        expect(right, "has a pose that is none", where=self.where, fix="record it again")
        return times, poses

    def at(self, time: float) -> Array:
        """[4, 4] from its own axes to those of `frame` [m]; `_OutOfTimeError`: it moves, and `time`
        lies before its first or after its last place."""
        times, poses = self._settled
        if self.still or len(times) == 1:
            return rigid(Rotation.from_quat(poses[-1, 3:]).as_matrix(), poses[-1, :3])
        if not times[0] <= time <= times[-1]:
            raise _OutOfTimeError
        k = max(int(np.searchsorted(times, time)), 1)
        turns = Rotation.from_quat(poses[k - 1 : k + 1, 3:])
        x = [np.interp(time, times, axis) for axis in poses[:, :3].T]
        return rigid(Slerp(times[k - 1 : k + 1], turns)(time).as_matrix(), x)


class _Frames:
    """The tree of TF."""

    def __init__(self, where: str):
        self.where = where
        self.tracks: dict[str, _Track] = {}

    def add(self, stated: Any, *, still: bool) -> None:
        """As tf2 does: a static pose replaces all before, a moving one a static one, and what is
        no pose is ignored."""
        child, moved = stated.child_frame_id.lstrip("/"), stated.transform
        at, turn = moved.translation, moved.rotation
        q = turn.x, turn.y, turn.z, turn.w
        if not np.isfinite([at.x, at.y, at.z, *q]).all() or abs(np.dot(q, q) - 1.0) > _DENORMAL:
            return
        track = self.tracks.get(child)
        if still or track is None or track.still:
            self.tracks[child] = track = _Track(f"{self.where}: frame {child}", still)
        track.add(stated.header, at, turn)

    @property
    def root(self) -> str:
        """The frame in which all others are; empty without TF."""
        parents = {track.frame.lstrip("/") for track in self.tracks.values()}
        roots = sorted(parents - set(self.tracks))
        what = f"TF has several roots: {', '.join(roots)}"
        fix = "name the frame of the recording with --world"
        expect(len(roots) <= 1, what, where=self.where, fix=fix)
        return roots[0] if roots else ""

    def between(self, to: str, start: str, time: float) -> Array:
        """[4, 4] from the axes of `start` to those of `to` [m], as `_Track.at`."""
        to, start = to.lstrip("/"), start.lstrip("/")
        up, down = self._lineage(start), self._lineage(to)
        shared = next((frame for frame in up if frame in down), "")
        what = f"TF does not say where {start} is in {to}"
        fix = f"give frames of one tree; it has {', '.join(sorted(self.tracks)) or 'none'}"
        expect(shared in down, what, where=self.where, fix=fix)
        legs = []
        for way in (up, down):
            T = np.eye(4)
            for frame in way[: way.index(shared)]:
                T = self.tracks[frame].at(time) @ T
            legs.append(T)
        return np.linalg.inv(legs[1]) @ legs[0]

    def _lineage(self, frame: str) -> list[str]:
        found = [frame]
        while found[-1] in self.tracks:
            parent = self.tracks[found[-1]].frame.lstrip("/")
            what, new = f"TF has a loop at {parent}", parent not in found
            expect(new, what, where=self.where, fix="mend it")
            found.append(parent)
        return found


def _points(message: Any, where: str) -> Array:
    """[n, 3] of a PointCloud2 in its own frame, without those that were not seen."""
    fields, order = {f.name: f for f in message.fields}, "<>"[bool(message.is_bigendian)]
    try:
        at = [(fields[axis].offset, f"{order}{_TYPES[fields[axis].datatype]}") for axis in "xyz"]
    except KeyError as error:
        raise RecordingError(f"a cloud has no {error}", where=where, fix="record x, y, z") from None
    step, row, least = message.point_step, message.row_step, message.width * message.point_step
    data, shape = np.asarray(message.data, dtype=np.uint8), (message.height, message.width)
    # Drivers leave it 0, or give the whole cloud's: then rows follow each other.
    if row < least or len(data) < (message.height - 1) * row + least:
        row = least
    last = max(offset + np.dtype(kind).itemsize for offset, kind in at)
    what = f"a cloud has {len(data)} bytes for {shape[0] * shape[1]} points of {step}"
    fits = last <= step and len(data) >= message.height * least
    expect(fits, what, where=where, fix="record it again")
    if not shape[0] * shape[1]:
        return np.zeros((0, 3))
    raw = data.tobytes()
    columns = [np.ndarray(shape, kind, raw, offset, (row, step)) for offset, kind in at]
    cloud = np.stack(columns, axis=-1).reshape(-1, 3).astype(np.float64)
    return cloud[np.isfinite(cloud).all(axis=1)]
