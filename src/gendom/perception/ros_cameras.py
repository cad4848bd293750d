"""Cameras of ROS bags, as `FrameSource`s: depth pictures with their colour, and clouds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.arrays import Array, rigid
from gendom.errors import RecordingError
from gendom.perception.aligned import aligned
from gendom.perception.camera import Camera, expect
from gendom.perception.frames import Frame, Pictures
from gendom.perception.ros_bag import RosBag
from gendom.perception.ros_frames import FrameTree, stamp
from gendom.perception.ros_messages import (
    CLOUD,
    IMAGE,
    INFO,
    PACKED,
    camera_of,
    colours_of,
    picture_of,
    points_of,
)
from gendom.reading import MOST_PIXELS

DEPTH_UNIT = 1e-4
"""Metres a count of depth pictures that are made of metres."""

_FORWARD = rigid([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [0.0, 0.0, 0.0])
"""From a camera's axes to those of ROS's bodies: x forward, y left, z up (REP 103)."""
_WIDEST = 2.0  # tangent of the angle from the axis that a camera sees at most
_COARSEST = 150.0  # [pixels]; focal length of a camera with so few points that they are thinned
_AROUND = 0.1  # of the width of the first cloud's view, that later ones may exceed it by
_HIDDEN = ("depth", "infra", "ir", "stereo", "mask", "label")  # in names of pictures without colour


def topics_of(bag: RosBag, kind: str) -> list[str]:
    """Topics of clouds, or of depth pictures: of those that one camera gives twice the ones that
    are aligned with colour."""
    found = sorted(n for n, k in bag.topics.items() if k == kind)
    if kind == CLOUD:
        return found
    found = [name for name in found if "depth" in name.lower()]
    twice = {name.split("/aligned_depth")[0] for name in found if "/aligned_depth" in name}
    return [n for n in found if "/aligned_depth" in n or n.rpartition("/depth")[0] not in twice]


def intrinsics(bag: RosBag, topic: str, name: str, depth_unit: float = 1e-3) -> Camera:
    """The camera of a topic of pictures, from the CameraInfo beside it."""
    folders, where = topic.split("/"), f"{bag.where}: {topic}"
    above = ["/".join(folders[:n]) for n in range(len(folders) - 1, 0, -1)]
    named = (f"{folder}/camera_info" for folder in above)
    found = next((n for n in named if bag.topics.get(n) == INFO and bag.counts[n]), None)
    expect(found, "are pictures without a CameraInfo beside them", where, "record camera_info too")
    assert found is not None
    info, rectified = bag.first(found), "image_rect" in topic
    try:
        return camera_of(info, rectified=rectified, name=name, depth_unit=depth_unit)
    except RecordingError as error:
        place = f"{bag.where}: {found}: {str(error.where).rpartition(': ')[2]}"
        raise RecordingError(error.what, where=place, fix=error.fix) from None


def colour_topic(bag: RosBag, depth: str) -> str | None:
    """The topic of the colour pictures of a depth topic's camera; None: there is none."""
    folders = depth.split("/")
    found = []
    for name, kind in bag.topics.items():
        parts = name.split("/")
        hidden = any(part.startswith(_HIDDEN) for part in parts)
        if kind not in (IMAGE, PACKED) or hidden or not bag.counts[name]:
            continue
        same = (a == b for a, b in zip(parts, folders, strict=False))
        shared = sum(takewhile(bool, same))
        # The empty part in front of the first / is alone shared by /depth/... and /rgb/...
        if shared > (not folders[1].startswith("depth")):
            found.append((-shared, "rect" not in name, kind == PACKED, name))
    return min(found)[-1] if found else None


@dataclass(frozen=True, eq=False)
class RosCamera:
    """A topic, or two, as a `FrameSource`."""

    camera: Camera
    """Its intrinsics, and where it has been placed its pose."""
    frame_id: str
    """The frame of TF that it rests in."""
    frames: Callable[[Camera], Iterator[Frame]]
    """What it sees."""
    T_frame_camera: Array = field(default_factory=lambda: np.eye(4))
    """[4, 4] from the camera's axes to those of its frame [m]."""
    stated: bool = True
    """Whether a CameraInfo states the intrinsics; else they are made up."""

    def at(self, T_world_frame: Array) -> RosCamera:
        """The same where its frame is in the world, [4, 4] [m]."""
        return replace(self, camera=self.camera.at(T_world_frame @ self.T_frame_camera))

    def __iter__(self) -> Iterator[Frame]:
        return self.frames(self.camera)


def depth_camera(bag: RosBag, topic: str, name: str, frames: FrameTree) -> RosCamera:
    """The camera of a topic of depth pictures, with the colour pictures beside it."""
    depth, kind = bag.first(topic), bag.topics[topic]
    expect(depth is not None, "has no message", f"{bag.where}: {topic}", "record it")
    is_float = kind == IMAGE and depth.encoding.lower() == "32fc1"
    camera = intrinsics(bag, topic, name, DEPTH_UNIT if is_float else 1e-3)
    frame, beside = depth.header.frame_id.lstrip("/"), colour_topic(bag, topic)

    def counts(message: Any, where: str) -> Array:
        found = picture_of(message, kind, where)
        return _counts(found) if found.dtype == np.float32 else found

    def seen(camera: Camera) -> Iterator[Frame]:
        depths = bag.frames(topic, counts)
        if beside is None:
            return aligned(camera, depths)
        of = partial(picture_of, kind=bag.topics[beside])
        colours = bag.frames(beside, lambda message, where: of(message, where=where))
        return aligned(camera, depths, colour, colours, T)

    if beside is not None:
        colour, message = intrinsics(bag, beside, f"{name}: colour"), bag.first(beside)
        other = message.header.frame_id.lstrip("/")
        (T,) = frames.between(other, frame, np.array([stamp(depth.header)]))
    return RosCamera(camera, frame, seen)


def cloud_camera(bag: RosBag, topic: str, name: str, world: str) -> RosCamera:
    """The camera of a topic of clouds: of the CameraInfo of its frame, or one that sees the first
    cloud with about a pixel a point; RecordingError: they are not seen from their origin."""
    where, message = f"{bag.where}: {topic}", bag.first(topic)
    frame = message.header.frame_id.lstrip("/")
    cloud, seen = points_of(message, where)
    what, fix = "the first cloud is empty", "record it from before the lift"
    expect(seen.sum() > 100, what, where, fix)

    def as_camera(camera: Camera, T: Array, stated: bool) -> RosCamera:
        def read(camera: Camera) -> Iterator[Frame]:
            return bag.frames(topic, lambda message, where: _picture(message, camera, T, where))

        return RosCamera(camera, frame, read, T, stated)

    for info_topic in (n for n, kind in bag.topics.items() if kind == INFO and bag.counts[n]):
        info = bag.first(info_topic)
        if info.header.frame_id.lstrip("/") == frame:
            camera = camera_of(info, rectified=False, name=name, depth_unit=DEPTH_UNIT)
            return as_camera(replace(camera, distortion=()), np.eye(4), True)
    for T in (np.eye(4), _FORWARD):
        points = cloud[seen] @ T[:3, :3]
        ahead = points[points[:, 2] > 0.0]
        slopes = ahead[:, :2] / ahead[:, 2:]
        all_ahead = len(ahead) > 0.99 * len(points) and np.abs(slopes).max() < _WIDEST
        if all_ahead and frame != world and (camera := _around(slopes, name)).K[0, 0] > _COARSEST:
            return as_camera(camera, T, False)
    what = f"clouds of frame {frame} are thinned, or not seen from its origin as a camera's are"
    fix = "gendom import takes them as they are; crop table and robot by --workspace"
    raise RecordingError(what, where=where, fix=fix)


def _picture(message: Any, camera: Camera, T_frame_camera: Array, where: str) -> Pictures:
    """A cloud, each point in the pixel that it falls into, the nearest one where several do."""
    cloud, seen = points_of(message, where)
    points = cloud[seen] @ T_frame_camera[:3, :3]
    ahead = points[:, 2] > 1e-3
    z = points[ahead, 2]
    found, inside = camera.pixels(points[ahead])
    farthest_first = np.argsort(-z[inside], kind="stable")
    pixels = (found[inside] @ [1, camera.width])[farthest_first]
    depth = np.zeros(camera.height * camera.width, np.uint16)
    depth[pixels] = _counts(z[inside][farthest_first])
    depth = depth.reshape(camera.height, camera.width)
    if (colours := colours_of(message, where)) is None:
        return Pictures(depth)
    painted = np.zeros((depth.size, 3), np.uint8)
    painted[pixels] = colours[seen][ahead][inside][farthest_first]
    return Pictures(depth, painted.reshape(*depth.shape, 3))


def _counts(metres: Array) -> NDArray[np.uint16]:
    """Depth in metres as counts of `DEPTH_UNIT`; 0 where there is none, or it is too far."""
    counts = np.rint(np.nan_to_num(metres, nan=0.0, posinf=0.0, neginf=0.0) / DEPTH_UNIT)
    return np.where((counts > 0) & (counts < 65535), counts, 0).astype(np.uint16)


def _around(slopes: Array, name: str) -> Camera:
    """A camera that sees points whose x / z and y / z are given [n, 2], one a pixel."""
    low, high = slopes.min(axis=0), slopes.max(axis=0)
    low, high = low - _AROUND * (high - low), high + _AROUND * (high - low)
    f = float(np.sqrt(len(slopes) / max(np.prod(high - low), 1e-6)))
    low, high = np.minimum(low, -1.0 / f), np.maximum(high, 1.0 / f)  # the axis is in the picture
    f = min(f, float(np.sqrt(0.9 * MOST_PIXELS / max(np.prod(high - low), 1e-6))))
    width, height = (int(n) + 1 for n in f * (high - low))
    K = np.array([[f, 0.0, -f * low[0]], [0.0, f, -f * low[1]], [0.0, 0.0, 1.0]])
    size = {"width": width, "height": height, "depth_unit": DEPTH_UNIT}
    return Camera(name=name, K=K, T_world_camera=None, **size)
