"""ROS 2 bags: clouds and the gripper in one frame, of both kinds of files."""

import io
import sqlite3
import struct
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from gendom import cli
from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.perception import RealSenseRecording, RosSettings, read_ros_bag

pytest.importorskip("rosbags", reason="needs rosbags: the extra ros")

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
START = 1_700_000_000
CAMERA = Rotation.from_euler("xyz", [2.0, 0.1, -0.7])
"""How the camera is turned in the world."""
AT = np.array([0.4, -0.3, 0.8])
OBJECT = """
table_height = 0.0
[object]
kind = "rope"
length = 0.4
grasp = "end"
"""


def made(name, /, **values):
    return TYPES[name](**values)


def header(time, frame):
    sec, part = divmod(round(time * 1e9), 10**9)
    stamp = made("builtin_interfaces/msg/Time", sec=START + sec, nanosec=part)
    return made("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def vector(kind, x, **more):
    return made(kind, **dict(zip("xyzw", map(float, x), strict=False)), **more)


def transform(time, parent, child, x, turn):
    return made(
        "geometry_msgs/msg/TransformStamped",
        header=header(time, parent),
        child_frame_id=child,
        transform=made(
            "geometry_msgs/msg/Transform",
            translation=vector("geometry_msgs/msg/Vector3", x),
            rotation=vector("geometry_msgs/msg/Quaternion", turn.as_quat()),
        ),
    )


def pose(time, frame, x):
    return made(
        "geometry_msgs/msg/PoseStamped",
        header=header(time, frame),
        pose=made(
            "geometry_msgs/msg/Pose",
            position=vector("geometry_msgs/msg/Point", x),
            orientation=vector("geometry_msgs/msg/Quaternion", [0.0, 0.0, 0.0, 1.0]),
        ),
    )


def cloud(time, frame, points, *, order="<", height=1, names="xyz"):
    """Each point has four bytes of colour before x and y, and z after a gap."""
    row = np.dtype(
        {
            "names": ["rgb", "x", "y", "z"],
            "formats": [order + "u4", order + "f4", order + "f4", order + "f4"],
            "offsets": [0, 4, 8, 16],
            "itemsize": 24,
        }
    )
    table = np.zeros(len(points), row)
    table["x"], table["y"], table["z"] = np.asarray(points).T
    width = len(points) // height
    # rows end with something else
    data = b"".join(table[k * width : (k + 1) * width].tobytes() + b"junk" for k in range(height))
    return made(
        "sensor_msgs/msg/PointCloud2",
        header=header(time, frame),
        height=height,
        width=width,
        fields=[
            made("sensor_msgs/msg/PointField", name=n, offset=o, datatype=7, count=1)
            for n, o in zip(names, (4, 8, 16), strict=True)
        ],
        is_bigendian=order == ">",
        point_step=24,
        row_step=24 * width + 4,
        data=np.frombuffer(data, np.uint8),
        is_dense=False,
    )


@pytest.fixture
def lifted():
    """Clouds in the world at three times, and where the gripper is then."""
    x = np.linspace(0.0, 0.4, 20)
    clouds = [np.stack([x, 0.0 * x, 0.05 * t * x + 0.01], axis=1) for t in range(3)]
    return SimpleNamespace(
        times=[0.5, 1.0, 1.5],
        clouds=clouds,
        grip=[np.array([0.4, 0.0, 0.02 * t + 0.01]) for t in range(3)],
    )


def seen(points):
    """As the camera sees points of the world."""
    return CAMERA.inv().apply(points - AT)


def messages(lifted, **changes):
    """Topic, type and message of everything in the bag."""
    tf = "tf2_msgs/msg/TFMessage"
    still = [
        transform(0.0, "world", "base", [0.0, 0.0, 0.0], Rotation.identity()),
        transform(0.0, "world", "camera", AT, CAMERA),
    ]
    rows = [("/tf_static", tf, made(tf, transforms=still))]
    # the hand moves evenly
    turn, offset = Rotation.from_euler("xyz", [3.0, 0.2, 0.7]), np.array([0.01, 0.02, 0.1])
    for time in (0.0, 0.8, 2.0):
        tool = np.array([0.4, 0.0, 0.01 + 0.04 * (time - 0.5)])
        hand = transform(time, "base", "hand", tool - turn.apply(offset), turn)
        tip = transform(time, "hand", "tool", offset, Rotation.identity())
        rows.append(("/tf", tf, made(tf, transforms=[hand, tip])))
        held = pose(time, "camera", seen(tool))
        rows.append(("/tool_pose", "geometry_msgs/msg/PoseStamped", held))
    for time, points in zip(lifted.times, lifted.clouds, strict=True):
        message = cloud(time, "camera", seen(points), **changes)
        rows.append(("/camera/points", "sensor_msgs/msg/PointCloud2", message))
    return rows


def bag(path, rows, plugin=StoragePlugin.MCAP):
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        known = {}
        for n, (topic, kind, message) in enumerate(rows):
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(known[topic], START * 10**9 + n, STORE.serialize_cdr(message, kind))
    (path / "object.toml").write_text(OBJECT)
    return path


def check(recording, lifted):
    assert recording.time == pytest.approx([0.0, 0.5, 1.0])
    for t, points in enumerate(lifted.clouds):
        assert recording.frame(t) == pytest.approx(points, abs=1e-6)
    assert recording.gripper_position[:, 0] == pytest.approx(np.array(lifted.grip), abs=1e-7)
    assert recording.object.length == 0.4 and recording.table_height == 0.0


@pytest.mark.parametrize("plugin", StoragePlugin)
@pytest.mark.parametrize("gripper", ["tool", "/tool_pose"])
def test_a_lift(lifted, tmp_path, plugin, gripper):
    path = bag(tmp_path / "bag", messages(lifted), plugin)
    found = read_ros_bag(path, path / "object.toml", RosSettings(gripper=gripper))
    check(found, lifted)
    assert found.extra["world"] == "world" and found.extra["started"] == START + 0.5


@pytest.mark.parametrize("changes", [{"order": ">"}, {"height": 4}], ids=str)
def test_other_layouts_of_clouds(lifted, tmp_path, changes):
    path = bag(tmp_path / "bag", messages(lifted, **changes))
    check(read_ros_bag(path, path / "object.toml", RosSettings(gripper="tool")), lifted)


@pytest.mark.parametrize("box", [None, (-1.0, 1.0, -1.0, 1.0, -1.0, 1.0)])
def test_points_that_were_not_seen_and_those_outside_of_a_box(lifted, tmp_path, box):
    whole = list(lifted.clouds)
    more = np.full((2, 3), np.nan) if box is None else np.array([[0.2, 3.0, 0.0]])
    lifted.clouds[:] = [np.concatenate([more, points]) for points in whole]
    path = bag(tmp_path / "bag", messages(lifted))
    settings = RosSettings(gripper="tool", workspace=box)
    lifted.clouds[:] = whole
    check(read_ros_bag(path, path / "object.toml", settings), lifted)


def test_a_camera_that_turns(lifted, tmp_path):
    tf, rows = "tf2_msgs/msg/TFMessage", without("/tf_static", "/camera/points")(messages(lifted))
    for time in (0.0, 2.0):
        turned = transform(time, "base", "camera", AT, Rotation.from_euler("z", 0.5 * time))
        rows.append(("/tf", tf, made(tf, transforms=[turned])))
    for time, points in zip(lifted.times, lifted.clouds, strict=True):
        own = Rotation.from_euler("z", 0.5 * time).inv().apply(points - AT)
        rows.append(("/camera/points", "sensor_msgs/msg/PointCloud2", cloud(time, "camera", own)))
    path = bag(tmp_path / "bag", rows)
    check(read_ros_bag(path, path / "object.toml", RosSettings(gripper="tool")), lifted)


def test_the_world_can_be_any_frame(lifted, tmp_path):
    path = bag(tmp_path / "bag", messages(lifted))
    found = read_ros_bag(path, path / "object.toml", RosSettings(gripper="tool", world="camera"))
    assert found.frame(1) == pytest.approx(seen(lifted.clouds[1]), abs=1e-6)
    assert found.gripper_position[1, 0] == pytest.approx(seen(lifted.grip[1]))


def test_without_tf_clouds_are_taken_as_they_are(lifted, tmp_path):
    rows = [row for row in messages(lifted) if not row[0].startswith("/tf")]
    path = bag(tmp_path / "bag", rows)
    found = read_ros_bag(path, path / "object.toml", RosSettings(gripper="/tool_pose"))
    assert found.frame(1) == pytest.approx(seen(lifted.clouds[1]), abs=1e-6)


def test_clouds_at_other_times_are_left_out(lifted, tmp_path):
    rows = messages(lifted)
    late = cloud(5.0, "camera", seen(lifted.clouds[0]))
    path = bag(tmp_path / "bag", [*rows, ("/camera/points", "sensor_msgs/msg/PointCloud2", late)])
    faults = []
    settings = RosSettings(gripper="tool")
    found = read_ros_bag(path, path / "object.toml", settings, on_warning=faults.append)
    check(found, lifted)
    assert str(faults[0]).startswith("/camera/points: 1 of 4 clouds lie outside of the time")


def without(*topics):
    return lambda rows: [row for row in rows if row[0] not in topics]


def another_cloud(rows):
    return [*rows, ("/other", rows[-1][1], rows[-1][2])]


def unplaced(rows):
    other = replace(rows[-1][2], header=header(1.0, "nowhere"))
    return [*rows[:-1], (*rows[-1][:2], other)]


def no_z(rows):
    bad = cloud(1.5, "camera", np.zeros((3, 3)), names="xyi")
    return [*rows[:-1], (*rows[-1][:2], bad)]


def short(rows):
    bad = replace(rows[-1][2], data=rows[-1][2].data[:100])
    return [*rows[:-1], (*rows[-1][:2], bad)]


LACKING = {
    "no clouds": (
        without("/camera/points"),
        {},
        "has 0 topics of clouds or depth; record a sensor_msgs",
    ),
    "two clouds": (
        another_cloud,
        {},
        "has 2 topics of clouds or depth: /camera/points, /other; name one",
    ),
    "no such topic": (
        lambda rows: rows,
        {"points": "/points"},
        "has no topic /points of sensor_msgs/msg/PointCloud2; give one of: /camera/points",
    ),
    "no poses": (
        without("/tool_pose"),
        {"gripper": "/tool_pose"},
        "has no topic /tool_pose of geometry_msgs/msg/PoseStamped, nor another one; record one",
    ),
    "another type": (
        lambda rows: rows,
        {"gripper": "/camera/points"},
        "/camera/points is no geometry_msgs/msg/PoseStamped; give one of: /tool_pose",
    ),
    "no tool": (
        lambda rows: rows,
        {"gripper": "tol"},
        "TF does not say where tol is in world; give frames of one tree; it has base, camera, hand",
    ),
    "no frame of clouds": (unplaced, {}, "TF does not say where nowhere is in world"),
    "no z": (no_z, {}, "/camera/points: a cloud has no 'z'; record x, y, z"),
    "short": (short, {}, "/camera/points: a cloud has 100 bytes for 20 points of 24"),
    "two roots": (without("/tf_static"), {}, "TF does not say where camera is in base"),
}


@pytest.mark.parametrize("case", LACKING)
def test_what_is_lacking_is_told(lifted, tmp_path, case):
    spoil, changes, said = LACKING[case]
    path = bag(tmp_path / "bag", spoil(messages(lifted)))
    with pytest.raises(RecordingError) as caught:
        read_ros_bag(path, path / "object.toml", RosSettings(**{"gripper": "tool"} | changes))
    assert str(caught.value).removeprefix(f"{path}: ").startswith(said)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("plugin", StoragePlugin)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.8])
def test_a_cut_bag_is_one_line(lifted, tmp_path, plugin, share):
    path = bag(tmp_path / "bag", messages(lifted), plugin)
    (file,) = (p for p in path.iterdir() if p.suffix in (".mcap", ".db3"))
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    with pytest.raises(
        RecordingError, match=r"bag.*: (cannot be read as a ROS 2 bag|is no .db3)"
    ) as caught:
        read_ros_bag(path, path / "object.toml", RosSettings(gripper="tool"))
    assert "\n" not in str(caught.value)


def test_the_command(lifted, tmp_path, capsys):
    path, out = bag(tmp_path / "bag", messages(lifted)), tmp_path / "lift.npz"
    words = ["import", str(path), "--gripper", "tool", "--out", str(out)]
    assert cli.main(words) == 0
    told = capsys.readouterr().out
    assert "frames    3" in told and told.endswith(f"written: {out}\n")
    check(Recording.read(out), lifted)
    assert cli.main(["import", str(path)]) == 2
    assert "--gripper: is missing; name a frame of TF" in capsys.readouterr().err
    # what is no bag
    assert cli.main(["import", str(out), "--out", str(tmp_path / "again.npz")]) == 0
    check(Recording.read(tmp_path / "again.npz"), lifted)
    assert cli.main(["import", str(out), "--gripper", "tool"]) == 2
    assert "is no ROS 2 bag; leave it out" in capsys.readouterr().err
    assert cli.main(["import", str(tmp_path / "none.mcap"), "--gripper", "tool"]) == 2


@pytest.mark.parametrize("height", [1, 4])
@pytest.mark.parametrize("step", ["none", "whole"])
def test_rows_whose_length_is_not_said(lifted, tmp_path, height, step):
    rows: Any = messages(lifted, height=height)
    for k, (topic, kind, message) in enumerate(rows):
        if topic == "/camera/points":
            data = message.data.reshape(height, -1)[:, :-4].ravel()
            of_rows = 0 if step == "none" else len(data)
            rows[k] = (topic, kind, replace(message, data=data, row_step=of_rows))
    path = bag(tmp_path / "bag", rows)
    check(read_ros_bag(path, path / "object.toml", RosSettings(gripper="tool")), lifted)


def moved(parent, child, at=(5.0, 5.0, 5.0), time=0.0, turn=None):
    turn = Rotation.identity() if turn is None else turn
    return made(
        "tf2_msgs/msg/TFMessage", transforms=[transform(time, parent, child, list(at), turn)]
    )


OF_TF = {
    "static poses of one frame": ("/tf_static", moved("world", "camera"), None),
    "a static one that was wrong in time": ("/tf_static", moved("world", "camera", time=9.0), None),
    "moving poses of one time": ("/tf", moved("base", "hand"), None),
    "static before moving": ("/tf_static", moved("base", "hand"), None),
    "moving before static": ("/tf", moved("world", "camera"), None),
    "no numbers": (None, None, ("/tf", moved("hand", "tool", at=(np.nan, 0.0, 0.0), time=0.6))),
}


@pytest.mark.parametrize("case", OF_TF)
def test_frames_are_those_of_tf2(lifted, tmp_path, case):
    """The last of equal times counts, the last kind of a frame, and none that is no pose."""
    topic, first, last = OF_TF[case]
    rows, kind = messages(lifted), "tf2_msgs/msg/TFMessage"
    rows = [(topic, kind, first), *rows] if topic else [*rows, (last[0], kind, last[1])]
    path = bag(tmp_path / "bag", rows)
    check(read_ros_bag(path, path / "object.toml", RosSettings(gripper="tool")), lifted)


@pytest.mark.parametrize("plugin", StoragePlugin)
def test_a_bag_whose_recorder_was_killed(lifted, tmp_path, plugin, capsys):
    path, out = bag(tmp_path / "bag", messages(lifted), plugin), tmp_path / "lift.npz"
    (path / "metadata.yaml").unlink()
    assert cli.main(["import", str(path), "--gripper", "tool", "--out", str(out)]) == 0
    check(Recording.read(out), lifted)
    capsys.readouterr()


@pytest.mark.slow
def test_the_hint_for_bags_of_ros_1_is_right(lifted, tmp_path, capsys):
    """rosbags-convert makes bags of ROS 1 too, so it can be tried both ways."""
    convert = [sys.executable, "-c", "from rosbags.convert.cli import main; main()"]
    rows = [row for row in messages(lifted)]
    there, old, new = bag(tmp_path / "bag", rows), tmp_path / "x.bag", tmp_path / "new"
    subprocess.run([*convert, "--src", there, "--dst", old], check=True)
    assert cli.main(["import", str(old)]) == 2
    assert f"rosbags-convert --src {old.name} --dst NEW" in capsys.readouterr().err
    subprocess.run([*convert, "--src", old, "--dst", new], check=True)
    (new / "object.toml").write_text(OBJECT)
    check(read_ros_bag(new, new / "object.toml", RosSettings(gripper="tool")), lifted)


def pictures(form):
    """A lift as depth pictures of 8 x 4 pixels, seen from above, and what is seen [m]."""
    K = [10.0, 0.0, 4.0, 0.0, 10.0, 2.0, 0.0, 0.0, 1.0]
    calibrated = {"d": np.zeros(5), "k": np.array(K), "r": np.eye(3).ravel()}
    roi = made(
        "sensor_msgs/msg/RegionOfInterest",
        x_offset=0,
        y_offset=0,
        height=0,
        width=0,
        do_rectify=False,
    )
    plain = {"distortion_model": "plumb_bob", "binning_x": 0, "binning_y": 0, "roi": roi}
    P = np.array([10.0, 0.0, 4.0, 0.0, 0.0, 10.0, 2.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    down, tf = Rotation.from_euler("x", 180.0, degrees=True), "tf2_msgs/msg/TFMessage"
    name = "/camera/depth/image_rect_raw"
    info = made(
        "sensor_msgs/msg/CameraInfo",
        header=header(0.0, "eye"),
        height=4,
        width=8,
        p=P,
        **calibrated,
        **plain,
    )
    rows: list[Any] = [
        ("/tf_static", tf, made(tf, transforms=[transform(0, "world", "eye", [0, 0, 1.0], down)])),
        ("/camera/depth/camera_info", "sensor_msgs/msg/CameraInfo", info),
    ]
    for time in (0.0, 0.5, 1.0):
        depth = np.zeros((4, 8), np.uint16)
        depth[2, 1:7] = 1000 - 100 * time
        held = [-0.4 + 0.0 * time, 0.0, 0.1 * time]
        rows.append(("/tf", tf, moved("world", "tool", at=held, time=time)))
        of = {"header": header(time, "eye")}
        if form == "png":
            data = io.BytesIO()
            Image.fromarray(depth).save(data, "PNG")
            data = np.frombuffer(bytes(12) + data.getvalue(), np.uint8)
            of |= {"format": "16UC1; compressedDepth png", "data": data}
            rows.append((f"{name}/compressedDepth", "sensor_msgs/msg/CompressedImage", of))
        else:
            raw = depth if form == "16UC1" else np.where(depth, depth * 1e-3, np.nan).astype("f4")
            data = np.frombuffer(raw.tobytes(), np.uint8)
            of |= {"height": 4, "width": 8, "encoding": form, "is_bigendian": 0, "step": 0}
            rows.append((name, "sensor_msgs/msg/Image", of | {"data": data}))
    return [(t, k, made(k, **m) if isinstance(m, dict) else m) for t, k, m in rows]


@pytest.mark.parametrize("form", ["16UC1", "32FC1", "png"])
def test_depth_pictures_become_clouds(tmp_path, form):
    path = bag(tmp_path / "bag", pictures(form))
    found = read_ros_bag(path, path / "object.toml", RosSettings(gripper="tool"))
    x = (np.arange(1, 7) - 4.0) / 10.0
    for frame, time in enumerate((0.0, 0.5, 1.0)):
        z = 1.0 - 0.1 * time
        line = np.stack([x * z, 0.0 * x, np.full(6, 1.0 - z)], axis=1)
        np.testing.assert_allclose(found.frame(frame), line, atol=1e-6)


def test_depth_pictures_without_intrinsics(tmp_path):
    rows = without("/camera/depth/camera_info")(pictures("16UC1"))
    path = bag(tmp_path / "bag", rows)
    with pytest.raises(
        RecordingError, match="without a CameraInfo beside them; record camera_info"
    ):
        read_ros_bag(path, path / "object.toml", RosSettings(gripper="tool"))


def as_chunk(codec, data, size):
    """A .mcap file of one chunk of compressed data."""
    import pyarrow

    packed = pyarrow.compress(data, codec="lz4" if codec == "lz4" else codec, asbytes=True)
    if codec == "lz4":
        buffer = pyarrow.BufferOutputStream()
        with pyarrow.CompressedOutputStream(buffer, "lz4") as stream:
            stream.write(data)
        packed = buffer.getvalue().to_pybytes()
    word = struct.pack("<I", len(codec)) + codec.encode()
    chunk = struct.pack("<QQQI", 0, 9, size, 0) + word + struct.pack("<Q", len(packed)) + packed
    first = struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0)
    records = [(1, first), (6, chunk), (2, bytes(20))]
    body = b"".join(bytes([k]) + struct.pack("<Q", len(of)) + of for k, of in records)
    return b"\x89MCAP0\r\n" + body + b"\x89MCAP0\r\n"


@pytest.mark.parametrize("codec", ["zstd", "lz4"])
def test_chunks_that_unpack_to_gigabytes(tmp_path, codec):
    path = tmp_path / "x.mcap"
    path.write_bytes(as_chunk(codec, bytes(140 << 20), 9))
    (tmp_path / "object.toml").write_text(OBJECT)
    with pytest.raises(RecordingError, match="unpacks to more than"):
        read_ros_bag(path, tmp_path / "object.toml", RosSettings(gripper="tool"))


@pytest.mark.parametrize(
    "table",
    [
        "CREATE VIEW topics AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) "
        "SELECT id, 'a' AS name, 'b' AS type, 'cdr' AS serialization_format FROM n",
        "CREATE TABLE topics(id INTEGER, name AS (zeroblob(1000000000)))",
    ],
    ids=["view", "computed"],
)
def test_tables_that_are_none(tmp_path, table):
    path = tmp_path / "x.db3"
    with closing(sqlite3.connect(path)) as database:
        database.execute(table)
        database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, data BLOB)")
    (tmp_path / "object.toml").write_text(OBJECT)
    for read in (
        lambda: read_ros_bag(path, tmp_path / "object.toml", RosSettings(gripper="tool")),
        lambda: RealSenseRecording(path),
    ):
        with pytest.raises(RecordingError, match="has 'topics', which is no plain table"):
            read()


@pytest.mark.parametrize("text", ["[" * 100_000, "{a: " * 9000, "- 1\n" * 9000, "[" + "1," * 9000])
def test_metadata_that_takes_long_to_read(lifted, tmp_path, text):
    path = bag(tmp_path / "bag", messages(lifted))
    (path / "metadata.yaml").write_text(text)
    with pytest.raises(
        RecordingError, match=r"metadata\.yaml: has \d+ lines and parts, at most 6000"
    ):
        read_ros_bag(path, path / "object.toml", RosSettings(gripper="tool"))


def test_links_to_devices_in_a_bag(lifted, tmp_path):
    path = bag(tmp_path / "bag", messages(lifted))
    (path / "metadata.yaml").unlink()
    (path / "metadata.yaml").symlink_to("/dev/zero")
    with pytest.raises(RecordingError, match="pipe or device"):
        read_ros_bag(path, path / "object.toml", RosSettings(gripper="tool"))
