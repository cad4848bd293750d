"""Messages of ROS 2, and bags of them."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("rosbags", reason="needs rosbags: the extra ros")

from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
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
            value = {Nodetype.BASE: "" if of[0] == "string" else 0, Nodetype.SEQUENCE: []}.get(form)
            value = np.zeros(of[1]) if value is None else value
        elif isinstance(value, list):
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


def write_bag(path, rows, plugin):
    """A folder with topics and messages."""
    known = {}
    with Writer(path, version=9, storage_plugin=StoragePlugin[plugin]) as writer:
        for n, (topic, message) in enumerate(rows):
            kind = message.__msgtype__
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(known[topic], START * 10**9 + n, STORE.serialize_cdr(message, kind))
    return path
