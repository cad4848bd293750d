"""ROS 2 bags: clouds and the gripper in one frame, of both kinds of files."""

import sqlite3
import struct
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom import cli
from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.perception import RealSenseRecording, RosSettings, read_ros_bag

pytest.importorskip("rosbags", reason="needs rosbags: the extra ros")

from rosbags.typesys import get_types_from_msg

import ros_messages
from ros_messages import START, cloud, header, made, pose, tf, write_bag

POINTS = "/camera/points"
PLUGINS = ("MCAP", "SQLITE3", "ROS1", "ROS1 LZ4", "ROS1 BZ2")
NONE = np.zeros((3, 3))
CAMERA, AT = Rotation.from_euler("xyz", [2.0, 0.1, -0.7]), np.array([0.4, -0.3, 0.8])
"""How the camera is turned in the world, and where it is."""
OBJECT = '[object]\nkind = "rope"\nlength = 0.4\ngrasp = "end"\n'

TIMES = [0.5, 1.0, 1.5]
LINE = np.linspace(0.0, 0.4, 20)
CLOUDS = [np.stack([LINE, 0.0 * LINE, 0.05 * t * LINE + 0.01], axis=1) for t in range(3)]
GRIP = [np.array([0.4, 0.0, 0.02 * t + 0.01]) for t in range(3)]
"""Clouds in the world at three times, and where the gripper is then."""


def seen(points):
    """As the camera sees points of the world."""
    return CAMERA.inv().apply(points - AT)


def messages(clouds=CLOUDS, **changes):
    """Topic and message of everything in the bag."""
    rows = [
        ("/tf_static", tf(0.0, "world", "base", (0.0, 0.0, 0.0))),
        ("/tf_static", tf(0.0, "world", "camera", AT, CAMERA)),
    ]
    # the hand moves evenly
    turn, offset = Rotation.from_euler("xyz", [3.0, 0.2, 0.7]), np.array([0.01, 0.02, 0.1])
    for time in (0.0, 0.8, 2.0):
        tool = np.array([0.4, 0.0, 0.01 + 0.04 * (time - 0.5)])
        rows.append(("/tf", tf(time, "base", "hand", tool - turn.apply(offset), turn)))
        rows.append(("/tf", tf(time, "hand", "tool", offset)))
        rows.append(("/tool_pose", pose(time, "camera", seen(tool))))
    for time, points in zip(TIMES, clouds, strict=True):
        rows.append(("/camera/points", cloud(time, "camera", seen(points), **changes)))
    return rows


@pytest.fixture
def bag(tmp_path):
    def write(rows, plugin="MCAP", name="bag"):
        file = f"{name}.bag" if plugin.startswith("ROS1") else name
        path = write_bag(tmp_path / file, rows, plugin)
        folder = path if path.is_dir() else path.parent
        (folder / "object.toml").write_text(OBJECT)
        return path

    return write


def read(path, gripper="tool", workspace=None, on_warning=print, **settings):
    description = (path if path.is_dir() else path.parent) / "object.toml"
    settings = RosSettings(gripper=gripper, **settings)
    return read_ros_bag(path, description, settings, workspace=workspace, on_warning=on_warning)


def check(recording):
    assert recording.time == pytest.approx([0.0, 0.5, 1.0])
    for t, points in enumerate(CLOUDS):
        assert recording.frame(t) == pytest.approx(points, abs=1e-6)
    assert recording.gripper_position[:, 0] == pytest.approx(np.array(GRIP), abs=1e-7)
    assert recording.object.length == 0.4


@pytest.mark.parametrize("plugin", PLUGINS)
@pytest.mark.parametrize("gripper", ["tool", "/tool_pose"])
def test_a_lift(bag, plugin, gripper):
    found = read(bag(messages(), plugin), gripper)
    check(found)
    assert found.extra["world"] == "world" and found.extra["started"] == START + 0.5


def test_other_layouts_of_clouds(bag):
    """Rows' length may be left 0 or that of the whole cloud."""
    for k, changes in enumerate(({"order": ">"}, {"height": 4})):
        check(read(bag(messages(**changes), name=f"{k}")))
    for height in (1, 4):
        for step in (lambda m: 0, lambda m: len(m.data)):
            rows = [
                (topic, replace(m, row_step=step(m)) if topic == POINTS else m)
                for topic, m in messages(height=height, ends=b"")
            ]
            check(read(bag(rows, name=f"{height}{step(rows[-1][1])}")))


def test_points_that_were_not_seen_and_those_outside_of_a_box(bag):
    more = np.array([[np.nan] * 3, [0.2, 3.0, 0.0]])
    for name, extra, box in (("a", more[:1], None), ("b", more, (-1.0,) * 3 + (1.0,) * 3)):
        clouds = [np.concatenate([extra, points]) for points in CLOUDS]
        check(read(bag(messages(clouds), name=name), workspace=box))


def without(*topics):
    return lambda rows: [row for row in rows if row[0] not in topics]


def test_a_camera_that_turns(bag):
    rows = without("/tf_static", "/camera/points")(messages())
    for time in (0.0, 2.0):
        rows.append(("/tf", tf(time, "base", "camera", AT, Rotation.from_euler("z", 0.5 * time))))
    for time, points in zip(TIMES, CLOUDS, strict=True):
        own = Rotation.from_euler("z", 0.5 * time).inv().apply(points - AT)
        rows.append(("/camera/points", cloud(time, "camera", own)))
    check(read(bag(rows)))


def test_the_world_is_any_frame_or_without_tf_the_clouds(bag):
    for name, rows, settings in (
        ("a", messages(), {"world": "camera"}),
        ("b", without("/tf", "/tf_static")(messages()), {"gripper": "/tool_pose"}),
    ):
        found = read(bag(rows, name=name), **settings)
        assert found.frame(1) == pytest.approx(seen(CLOUDS[1]), abs=1e-6)
        assert found.gripper_position[1, 0] == pytest.approx(seen(GRIP[1]))


def test_clouds_that_came_late_are_read_at_their_time(bag):
    rows = messages()
    check(read(bag([*rows[:-3], rows[-1], rows[-3], rows[-2]])))


def test_clouds_at_other_times_are_left_out(bag):
    faults = []
    path = bag([*messages(), (POINTS, cloud(5.0, "camera", seen(CLOUDS[0])))])
    check(read(path, on_warning=faults.append))
    assert str(faults[0]).startswith("/camera/points: 1 of 4 clouds lie outside of the time")


def last(change):
    """Rows whose last cloud is changed."""
    return lambda rows: [*rows[:-1], (rows[-1][0], change(rows[-1][1]))]


HELD, NOT_SAID = "/tool_pose", "TF does not say where "
CLOUD = f"{POINTS}: frame 2: a cloud has"
LACKING = [
    (without(POINTS), {}, "has no topic of sensor_msgs/msg/PointCloud2; record clouds, or depth"),
    (lambda rows: [*rows, ("/b", rows[-1][1])], {}, f"has /b and {POINTS}, both of frame camera"),
    (list, {"points": ("/p",)}, "has no topic /p of sensor_msgs/msg/PointCloud2; give one of: /c"),
    (
        without(HELD),
        {"gripper": HELD},
        "has no topic /tool_pose of geometry_msgs/msg/PoseStamped or ",
    ),
    (list, {"gripper": POINTS}, f"{POINTS} is no geometry_msgs/msg/PoseStamped or "),
    (list, {"gripper": "tol"}, f"{NOT_SAID}tol is in world; give frames of one tree; it has base"),
    (last(lambda m: cloud(1.6, "nowhere", NONE)), {}, f"{NOT_SAID}nowhere is in world"),
    (last(lambda m: cloud(1.5, "camera", NONE, names="xyi")), {}, f"{CLOUD} no 'z'"),
    (last(lambda m: replace(m, data=m.data[:100])), {}, f"{CLOUD} 100 bytes for"),
    (last(lambda m: replace(m, width=1)), {}, f"{CLOUD} "),  # and more than one point
    (without("/tf_static"), {}, f"{NOT_SAID}camera is in base"),
    (lambda rows: [*rows, ("/tf", tf(0.0, "tool", "base"))], {"world": "camera"}, "TF has a loop"),
]


@pytest.mark.parametrize(("spoil", "settings", "said"), LACKING)
def test_what_is_lacking_is_told(bag, spoil, settings, said):
    path = bag(spoil(messages()))
    with pytest.raises(RecordingError) as caught:
        read(path, **settings)
    assert str(caught.value).removeprefix(f"{path}: ").startswith(said)
    assert "\n" not in str(caught.value)


OF_TF = {
    "static poses of one frame": ("/tf_static", tf(0.0, "world", "camera")),
    "a static one that was wrong in time": ("/tf_static", tf(9.0, "world", "camera")),
    "moving poses of one time": ("/tf", tf(0.0, "base", "hand")),
    "static before moving": ("/tf_static", tf(0.0, "base", "hand")),
    "moving before static": ("/tf", tf(0.0, "world", "camera")),
    "no numbers": ("/tf", tf(0.6, "hand", "tool", (np.nan, 0.0, 0.0))),
    "no turn": ("/tf", tf(0.6, "hand", "tool", length=1.1)),
}


@pytest.mark.parametrize("case", OF_TF)
def test_frames_are_those_of_tf2(bag, case):
    """The last of equal times counts, the last kind of a frame, and none that is no pose."""
    rows = [*messages(), OF_TF[case]] if case[:3] == "no " else [OF_TF[case], *messages()]
    check(read(bag(rows)))


@pytest.mark.parametrize("plugin", PLUGINS)
def test_the_command(bag, tmp_path, capsys, plugin):
    """Also of a bag whose recorder was killed, and of what is no bag."""
    path, out = bag(messages(), plugin), tmp_path / "lift.npz"
    words = ["import", str(path), "--gripper", "tool", "--out", str(out)]
    assert cli.main(words) == 0
    told = capsys.readouterr().out
    assert "frames    3" in told and told.endswith(f"written: {out}\n")
    check(Recording.read(out))
    if path.is_dir():
        (path / "metadata.yaml").unlink()
        assert cli.main(words) == 0
        check(Recording.read(out))
    assert cli.main(["import", str(path)]) == 2
    assert "--gripper: is missing; name a frame of TF" in capsys.readouterr().err
    assert cli.main(["import", str(out), "--out", str(tmp_path / "again.npz")]) == 0
    check(Recording.read(tmp_path / "again.npz"))
    assert cli.main(["import", str(out), "--gripper", "tool"]) == 2
    assert "is no ROS bag; leave it out" in capsys.readouterr().err
    assert cli.main(["import", str(tmp_path / "none.mcap"), "--gripper", "tool"]) == 2


def test_clouds_of_several_cameras_are_put_together(bag):
    """Each sees a part, ten milliseconds later than the other."""
    half = [points[:10] for points in CLOUDS]
    rows = messages(half)
    rows.append(("/tf_static", tf(0.0, "base", "other", (0.1, 0.2, 0.3))))
    for time, points in zip(TIMES, CLOUDS, strict=True):
        own = points[10:] - np.array([0.1, 0.2, 0.3])
        rows.append(("/other/points", cloud(time + 0.01, "other", own)))
    rows.append(("/other/points", cloud(1.8, "other", seen(CLOUDS[0]))))
    faults = []
    found = read(bag(rows), on_warning=faults.append)
    for t, points in enumerate(CLOUDS):
        np.testing.assert_allclose(found.frame(t), points, atol=1e-6)
    assert "1 of 4 frames match no frame of the others" in str(faults[0])
    assert found.gripper_source == "measured"


def test_the_gripper_of_a_franka(bag):
    """Its driver for ROS 1 records the hand's pose in the base's axes, columns first."""
    kind = "franka_msgs/msg/FrankaState"
    if kind not in ros_messages.STORE1.types:
        types = get_types_from_msg("std_msgs/Header header\nfloat64[16] O_T_EE\n", kind)
        ros_messages.STORE1.register(types)
        ros_messages.STORE.register(types)
    rows = [row for row in messages() if row[0] in ("/tf_static", POINTS)]
    for time in (0.0, 0.8, 2.0):
        T = np.eye(4)
        T[:3, 3] = 0.4, 0.0, 0.01 + 0.04 * (time - 0.5)
        of = {"header": header(time, ""), "O_T_EE": T.T.ravel()}
        rows.append(("/franka", made("franka_msgs/FrankaState", of)))
    check(read(bag(rows, "ROS1"), "/franka"))


@pytest.mark.parametrize("codec", ["zstd", "lz4"])
def test_chunks_that_unpack_to_gigabytes(tmp_path, codec):
    """A .mcap file of one chunk of compressed data."""
    import pyarrow

    buffer = pyarrow.BufferOutputStream()
    with pyarrow.CompressedOutputStream(buffer, codec) as stream:
        stream.write(bytes(140 << 20))
    packed = buffer.getvalue().to_pybytes()
    word = struct.pack("<I", len(codec)) + codec.encode()
    chunk = struct.pack("<QQQI", 0, 9, 9, 0) + word + struct.pack("<Q", len(packed)) + packed
    records = [(1, b"\4\0\0\0ros2\0\0\0\0"), (6, chunk), (2, bytes(20))]
    body = b"".join(bytes([k]) + struct.pack("<Q", len(of)) + of for k, of in records)
    path = tmp_path / "x.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + body + b"\x89MCAP0\r\n")
    (tmp_path / "object.toml").write_text(OBJECT)
    with pytest.raises(RecordingError, match="unpacks to more than"):
        read(path)


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
    for opened in (read, RealSenseRecording):
        with pytest.raises(RecordingError, match="has 'topics', which is no plain table"):
            opened(path)


@pytest.mark.parametrize("text", ["[" * 100_000, "{a: " * 9000, "- 1\n" * 9000, "", "link"])
def test_metadata_that_takes_long_to_read(bag, text):
    path = bag(messages())
    file, said = path / "metadata.yaml", r"metadata\.yaml: has \d+ lines and parts, at most 6000"
    if text == "link":
        file.unlink()
        file.symlink_to("/dev/zero")
        said = "pipe or device"
    else:
        file.write_text(text or "[" + "1," * 9000)
    with pytest.raises(RecordingError, match=said):
        read(path)
