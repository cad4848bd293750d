"""Clouds, depth and colour of messages of ROS, of both versions."""

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gendom.arrays import Array
from gendom.errors import RecordingError
from gendom.perception.camera import Camera, expect
from gendom.perception.frames import decode
from gendom.perception.ros_bag import decompressed

CLOUD, IMAGE, PACKED, INFO, JOINTS = (
    f"sensor_msgs/msg/{name}"
    for name in ("PointCloud2", "Image", "CompressedImage", "CameraInfo", "JointState")
)
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
POSES = {
    "geometry_msgs/msg/PoseStamped": lambda m: (m.pose.position, m.pose.orientation),
    "geometry_msgs/msg/TransformStamped": lambda m: (m.transform.translation, m.transform.rotation),
    "franka_msgs/msg/FrankaState": lambda m: _of_matrix(m.O_T_EE),
    "franka_msgs/msg/FrankaRobotState": lambda m: (
        m.o_t_ee.pose.position,
        m.o_t_ee.pose.orientation,
    ),
}
"""Types of topics that tell where a gripper is, and the place and orientation in a message."""

_PNG = b"\x89PNG"
_ZSTD_FORMAT = re.compile(r"(\w+); zstd; (\d+)x(\d+) step=(\d+)$")

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # of PointField


def _of_matrix(columns: Any) -> tuple[Any, Any]:
    """Place and orientation of 16 numbers, column after column."""
    T = np.array(columns, dtype=float).reshape(4, 4).T
    turn = Rotation.from_matrix(T[:3, :3]).as_quat()
    place, turned = (dict(zip("xyzw", x, strict=False)) for x in (T[:3, 3], turn))
    return SimpleNamespace(**place), SimpleNamespace(**turned)


def camera_of(info: Any, *, rectified: bool, name: str, depth_unit: float) -> Camera:
    """The camera of a CameraInfo; RecordingError: it is none. ROS 1 has its fields in capitals."""
    K, D, P = (
        np.array(getattr(info, field, getattr(info, field.upper(), ())))
        for field in ("k", "d", "p")
    )
    K, D = K.reshape(3, 3), tuple(map(float, D))
    if rectified and P.any():  # some simulations leave it 0
        K, D = P.reshape(3, 4)[:, :3], ()
    size = {"width": int(info.width), "height": int(info.height), "depth_unit": depth_unit}
    distortion = D if any(D) else ()
    return Camera(name=name, K=K, distortion=distortion, T_world_camera=None, **size)


def picture_of(message: Any, kind: str, where: str) -> Array:
    """The picture of a message: [height, width] of depth, uint16 as stored or float32 [m], or
    [height, width, 3] uint8, RGB; RecordingError: it is damaged or of an unknown format.

    A CompressedImage's format is "16UC1; compressedDepth png", "rgb8; jpeg compressed bgr8" or, of
    the RealSense SDK, "rgb8; zstd; 64x48 step=192".
    """
    data = np.asarray(message.data, dtype=np.uint8).tobytes()
    try:
        if kind != PACKED:
            order, size = "<>"[bool(message.is_bigendian)], (message.width, message.height)
            return raw_picture(data, message.encoding, *size, message.step, order, where)
        if raw := _ZSTD_FORMAT.match(message.format):
            width, height, step = (int(raw[k]) for k in (2, 3, 4))
            return raw_picture(decompressed(data), raw[1], width, height, step, "<", where)
    except ValueError as error:
        raise RecordingError(f"is damaged ({error})", where=where, fix="copy it") from None
    what, fix = f"is {message.format[:40]!r}", "record depth in PNG as 16UC1"
    expect(not message.format.startswith("32FC1;"), what, where, fix)
    if data.startswith(b"\xff\xd8"):
        return np.asarray(decode(data, where, "JPEG").convert("RGB"))
    # Depth has twelve bytes more in front (compressed_depth_image_transport).
    picture = decode(data[max(data.find(_PNG, 0, 16), 0) :], where)
    if picture.mode.startswith("I"):
        return np.asarray(picture).astype(np.uint16, copy=False)
    return np.asarray(picture.convert("RGB"))


def raw_picture(
    data: bytes, encoding: str, width: int, height: int, step: int, order: str, where: str
) -> Array:
    """A picture of raw rows, `step` bytes apart."""
    if (form := _RAW.get(encoding.lower())) is None:
        fix = "record colour as RGB8, depth as Z16"
        raise RecordingError(f"is stored as {encoding}", where=where, fix=fix)
    size, places = form
    row = width * size
    step = row if step in (0, len(data)) else step  # where drivers leave it 0, or give the whole
    if step < row or len(data) < step * height or not 0 < height * width < 2**28:
        raise ValueError("fewer pixels than its size says")
    rows = np.frombuffer(data, np.uint8, step * height).reshape(height, step)[:, :row]
    if not places:
        kind = f"{'u' if size == 2 else 'f'}{size}"
        return np.ascontiguousarray(rows).view(order + kind).astype(kind)
    return np.ascontiguousarray(rows.reshape(height, width, size)[:, :, places])


# Raw formats by the names of ROS or the SDK: bytes a pixel, and which of them are red, green and
# blue; none: it is depth.
_RAW: dict[str, tuple[int, list[int]]] = {
    "mono16": (2, []),
    "16uc1": (2, []),
    "32fc1": (4, []),
    "rgb8": (3, [0, 1, 2]),
    "bgr8": (3, [2, 1, 0]),
    "rgba8": (4, [0, 1, 2]),
    "bgra8": (4, [2, 1, 0]),
}


def points_of(message: Any, where: str) -> tuple[Array, NDArray[np.bool_]]:
    """Points [height, width, 3] of a PointCloud2 in its own frame [m], and which [height, width]
    were seen; RecordingError: it is damaged, or has no x, y and z."""
    order, fields = "<>"[bool(message.is_bigendian)], {f.name: f for f in message.fields}
    try:
        kinds = [f"{order}{_TYPES[fields[axis].datatype]}" for axis in "xyz"]
    except KeyError as error:
        raise RecordingError(f"a cloud has no {error}", where=where, fix="record x, y, z") from None
    columns = [_column(message, fields[a], k, where) for a, k in zip("xyz", kinds, strict=True)]
    cloud = np.stack(columns, axis=-1).astype(np.float64)
    return cloud, np.asarray(np.isfinite(cloud).all(axis=-1))


def colours_of(message: Any, where: str) -> NDArray[np.uint8] | None:
    """[height, width, 3] sRGB of a PointCloud2; None: it has none."""
    field = next((f for f in message.fields if f.name in ("rgb", "rgba")), None)
    if field is None:
        return None
    order = "<>"[bool(message.is_bigendian)]
    packed = _column(message, field, f"{order}u4", where)  # also where it says float32
    return np.stack([packed >> 16, packed >> 8, packed], axis=-1).astype(np.uint8)


def _column(message: Any, field: Any, kind: str, where: str) -> Array:
    """One field of all points, [height, width]."""
    step, row, least = message.point_step, message.row_step, message.width * message.point_step
    data, shape = np.asarray(message.data, dtype=np.uint8), (message.height, message.width)
    # Drivers leave it 0, or give the whole cloud's: then rows follow each other.
    if row < least or len(data) < (message.height - 1) * row + least:
        row = least
    last = field.offset + np.dtype(kind).itemsize
    what = f"a cloud has {len(data)} bytes for {shape[0] * shape[1]} points of {step}"
    beyond = len(data) - message.height * least  # less than a point a row, or zeros
    whole = beyond < message.height * step or not data[-beyond:].any()
    expect(last <= step and beyond >= 0 and whole, what, where, "record it again")
    if not shape[0] * shape[1]:
        return np.zeros(shape, kind)
    raw = np.ascontiguousarray(data)
    return np.ndarray(shape, kind, raw, field.offset, (row, step)).copy()
