"""Messages of ROS, and bags of them of both versions."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("rosbags", reason="needs rosbags: the extra ros")

from rosbags import rosbag1
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE, STORE1 = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)
STORE1.register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", "tf2_msgs/msg/TFMessage")
)
CLOUD, POSE, TF = "sensor_msgs/PointCloud2", "geometry_msgs/PoseStamped", "tf2_msgs/TFMessage"
START = 1_700_000_000


def made(kind, values) -> Any:
    """A message of nested mappings; what is not given is zero or empty."""
    kind, fields = kind.replace("/msg", "").replace("/", "/msg/"), {}
    definitions: Any = STORE.fielddefs[kind][1]
    for name, (form, of) in definitions:
        value: Any = values.get(name)
        if form == Nodetype.NAME:
            value = made(of, value or {})
        elif value is None:
            empty = [] if of[0][0] == Nodetype.NAME or "string" in str(of) else np.zeros(0)
            value = {Nodetype.BASE: "" if of[0] == "string" else 0, Nodetype.SEQUENCE: empty}
            value = value.get(form, np.zeros(of[1]) if form == Nodetype.ARRAY else None)
        elif isinstance(value, list) and of[0][0] == Nodetype.NAME:
            value = [made(of[0][1], one) for one in value]
        fields[name] = value
    return STORE.types[kind](**fields)


def header(time, frame):
    sec, part = divmod(round(time * 1e9), 10**9)
    return {"stamp": {"sec": START + sec, "nanosec": part}, "frame_id": frame}


def xyzw(x):
    return dict(zip("xyzw", map(float, x), strict=False))


def tf(time, parent, child, x=(5.0, 5.0, 5.0), turn=None, length=1.0):
    """A transform of TF, with a quaternion of a length."""
    turn = Rotation.identity() if turn is None else turn
    moved = {"translation": xyzw(x), "rotation": xyzw(length * turn.as_quat())}
    of = {"header": header(time, parent), "child_frame_id": child, "transform": moved}
    return made(TF, {"transforms": [of]})


def pose(time, frame, position):
    """A pose, not turned."""
    values = {"position": xyzw(position), "orientation": {"w": 1.0}}
    return made(POSE, {"header": header(time, frame), "pose": values})


def cloud(time, frame, points, *, order="<", height=1, names="xyz", ends=b"junk"):
    """Each point has four bytes of colour before x and y, and z after a gap; rows end with
    something else."""
    offsets, kinds = [0, 4, 8, 16], [f"{order}u4", *[f"{order}f4"] * 3]
    of: Any = {"names": ["rgb", *"xyz"], "formats": kinds, "offsets": offsets, "itemsize": 24}
    table = np.zeros(len(points), np.dtype(of))
    table["x"], table["y"], table["z"] = np.asarray(points).T
    width = len(points) // height
    data = b"".join(table[k * width : (k + 1) * width].tobytes() + ends for k in range(height))
    fields = [
        {"name": n, "offset": o, "datatype": 7, "count": 1}
        for n, o in zip(names, offsets[1:], strict=True)
    ]
    size = {"height": height, "width": width, "point_step": 24, "row_step": 24 * width + len(ends)}
    values = {"header": header(time, frame), "fields": fields, "is_bigendian": order == ">", **size}
    return made(CLOUD, {**values, "data": np.frombuffer(data, np.uint8)})


def of_ros1(message) -> Any:
    """The same message as ROS 1 has it."""
    kind, fields = message.__msgtype__, {}
    if kind == "builtin_interfaces/msg/Time":
        return message
    definitions: Any = STORE1.fielddefs[kind][1]
    for name, (form, of) in definitions:
        value: Any = getattr(message, name, getattr(message, name.lower(), 0))
        if form == Nodetype.NAME:
            value = of_ros1(value)
        elif form == Nodetype.SEQUENCE and of[0][0] == Nodetype.NAME:
            value = [of_ros1(one) for one in value]
        fields[name] = value
    return STORE1.types[kind](**fields)


def write_bag(path, rows, plugin):
    """Topics and messages: a folder of ROS 2's, or a file of ROS 1's ("ROS1 LZ4": compressed)."""
    old, codec = plugin.startswith("ROS1"), plugin.removeprefix("ROS1").strip()
    writer: Any = rosbag1.Writer(path) if old else None
    if old and codec:
        writer.set_compression(getattr(writer.CompressionFormat, codec))
    known, store = {}, STORE1 if old else STORE
    with writer or Writer(path, version=9, storage_plugin=StoragePlugin[plugin]) as writer:
        for n, (topic, message) in enumerate(rows):
            kind = message.__msgtype__
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=store)
            data = STORE1.serialize_ros1(of_ros1(message), kind) if old else None
            writer.write(
                known[topic], START * 10**9 + n, data or STORE.serialize_cdr(message, kind)
            )
    return path
