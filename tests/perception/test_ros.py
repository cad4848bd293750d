"""ROS 2 bags: clouds and the gripper in one frame, of both kinds of files."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom import cli
from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.perception import RosSettings, read_ros_bag

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
    "no clouds": (without("/camera/points"), {}, "has 0 topics of clouds; record a sensor_msgs"),
    "two clouds": (another_cloud, {}, "has 2 topics of clouds: /camera/points, /other; name one"),
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
    with pytest.raises(RecordingError, match="bag: cannot be read as a ROS 2 bag") as caught:
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
