"""Bags with what cameras saw: `gendom perceive` takes table and robot out of them."""

import io

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gendom import cli
from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.perception import RosSettings, read_camera, read_ros_cameras, write_camera
from gendom.robot import XARM7, arm_shape

pytest.importorskip("rosbags", reason="needs rosbags: the extra ros")

from ros_messages import START, header, made, tf, write_bag
from ros_messages import cloud as ros_cloud

OBJECT = 'table_height = 0.0\n[object]\nkind = "rope"\nlength = 0.4\ndiameter = 0.01\n'
FRAMES = 4
OFFSET = np.array([0.015, 0.0, 0.0])
"""Of the colour camera, to the right of the depth camera [m]."""


def placed(parent, child, T):
    return (
        "/tf_static",
        tf(0.0, parent, child, T[:3, 3], Rotation.from_matrix(np.array(T[:3, :3]))),
    )


def info(camera, frame):
    K = np.pad(camera.K, [(0, 0), (0, 1)])
    size = {"height": camera.height, "width": camera.width}
    return made(
        "sensor_msgs/CameraInfo",
        {
            "header": header(0, frame),
            "d": np.zeros(5),
            "k": camera.K.ravel(),
            "p": K.ravel(),
            **size,
        },
    )


def image(time, frame, picture, encoding):
    height, width = picture.shape[:2]
    of = {"height": height, "width": width, "encoding": encoding}
    data = np.frombuffer(picture.tobytes(), np.uint8)
    return made("sensor_msgs/Image", {"header": header(time, frame), "data": data, **of})


def packed(time, frame, picture, form):
    data = io.BytesIO()
    Image.fromarray(picture).save(data, "JPEG" if "jpeg" in form else "PNG", quality=95)
    raw = (bytes(12) if "Depth" in form else b"") + data.getvalue()
    of = {"header": header(time, frame), "format": form, "data": np.frombuffer(raw, np.uint8)}
    return made("sensor_msgs/CompressedImage", of)


def cloud(time, frame, camera, pictures, organised):
    """As drivers make it: x, y, z and the colour of each pixel, or of those with depth."""
    z = pictures.depth.reshape(-1, 1) * camera.depth_unit
    points = np.where(z > 0.0, camera.rays() * z, np.nan).astype("f4")
    r, g, b = pictures.colour.reshape(-1, 3).astype(np.uint32).T
    kinds = [(name, "<f4") for name in "xyz"] + [("rgb", "<u4")]
    table = np.zeros(len(points), kinds)
    table["x"], table["y"], table["z"] = points.T
    table["rgb"] = r << 16 | g << 8 | b
    table = table if organised else table[z[:, 0] > 0.0]
    fields = [
        {"name": n, "offset": 4 * k, "datatype": 7, "count": 1}
        for k, n in enumerate(("x", "y", "z", "rgb"))
    ]
    width, height = (camera.width, camera.height) if organised else (len(table), 1)
    size = {"height": height, "width": width, "point_step": 16, "row_step": 16 * width}
    values = {"header": header(time, frame), "fields": fields, **size}
    data = np.frombuffer(table.tobytes(), np.uint8)
    return made("sensor_msgs/PointCloud2", {**values, "data": data})


MADE = {}


def rows_of(world, form, *, stated=True):
    """As `_rows_of`, which takes long, in a list that may be changed."""
    if (form, stated) not in MADE:
        MADE[form, stated] = _rows_of(world, form, stated)
    rows, ropes, cameras = MADE[form, stated]
    return list(rows), ropes, cameras


def _rows_of(world, form, stated):
    """A lift of a rope from a table, seen by two cameras; the gripper and they in TF."""
    cameras, rows, ropes = world.pair(0.5), [], []
    if stated:
        rows += [placed("base", f"{c.name}_optical_frame", c.T_world_camera) for c in cameras]
    for camera in cameras:
        frame, name = f"{camera.name}_optical_frame", f"/{camera.name}"
        to_colour = np.eye(4)
        to_colour[:3, 3] = OFFSET
        rows.append(placed(frame, f"{camera.name}_colour_frame", to_colour))
        if form != "unknown":
            rows.append((f"{name}/depth/camera_info", info(camera, frame)))
            rows.append((f"{name}/color/camera_info", info(camera, f"{camera.name}_colour_frame")))
    for t in range(FRAMES):
        time, height = t / 30.0, 0.2 + 0.01 * t
        rows.append(("/tf", tf(time, "base", "tool", (0.0, 0.0, height))))
        ropes.append(world.lifted_rope(tip=(0.0, 0.0, height)))
        scene = world.Scene([world.Plane(), ropes[-1]])
        for k, camera in enumerate(cameras):
            name, frame = f"/{camera.name}", f"{camera.name}_optical_frame"
            seen = scene.pictures(camera, seed=10 * k + t)
            if form in ("organised", "unknown"):
                message = cloud(time, frame, camera, seen, form == "organised")
                rows.append((f"{name}/points", message))
                continue
            metres = seen.depth * camera.depth_unit
            beside = camera.at(camera.T_world_camera @ _shift(OFFSET))
            colour = scene.pictures(beside, seed=50 + 10 * k + t).colour
            other, late = f"{camera.name}_colour_frame", time + 0.004
            if form == "raw":
                depth = np.rint(1e3 * metres).astype(np.uint16)
                rows.append((f"{name}/depth/image_rect_raw", image(time, frame, depth, "16UC1")))
                rows.append((f"{name}/color/image_raw", image(late, other, colour, "rgb8")))
            else:
                depth = np.rint(1e3 * metres).astype(np.uint16)
                message = packed(time, frame, depth, "16UC1; compressedDepth png")
                rows.append((f"{name}/depth/image_rect_raw/compressedDepth", message))
                message = packed(late, other, colour, "rgb8; jpeg compressed bgr8")
                rows.append((f"{name}/color/image_raw/compressed", message))
    return rows, ropes, cameras


def _shift(x):
    T = np.eye(4)
    T[:3, 3] = x
    return T


@pytest.mark.parametrize(
    ("form", "plugin"),
    [("raw", "SQLITE3"), ("packed", "ROS1"), ("organised", "MCAP"), ("unknown", "ROS1")],
)
def test_a_lift_before_two_cameras(world, tmp_path, capsys, form, plugin):
    """Depth and colour, raw and packed, and clouds with and without a known camera."""
    rows, ropes, _ = rows_of(world, form)
    path = write_bag(tmp_path / ("lift.bag" if plugin == "ROS1" else "lift"), rows, plugin)
    (tmp_path / "held.toml").write_text(OBJECT)
    words = ["--gripper", "tool", "--object", str(tmp_path / "held.toml"), "--colour", "180", "30"]
    out = tmp_path / "lift.npz"
    assert cli.main(["perceive", str(path), *words, "35", "--out", str(out)]) == 0
    assert "left" in capsys.readouterr().out
    found = Recording.read(out)
    assert found.num_frames == FRAMES and found.gripper_source == "measured"
    assert found.extra["perception"]["cameras"] == ["left", "right"]
    np.testing.assert_allclose(found.gripper_position[:, 0, 2], 0.2 + 0.01 * np.arange(FRAMES))
    for t, rope in enumerate(ropes):
        error = rope.distance(found.frame(t).astype(float))
        assert len(error) > 60 and np.sqrt(np.mean(error**2)) < 0.004


EASY = """parameters:
  eye_on_hand: false
  robot_base_frame: {parent}
  robot_effector_frame: tool
  tracking_base_frame: {child}
transformation: {{x: {x}, y: {y}, z: {z}, qx: {qx}, qy: {qy}, qz: {qz}, qw: {qw}}}
"""
EASY2 = """parameters:
  name: left
  calibration_type: eye_on_base
  robot_base_frame: {parent}
  tracking_base_frame: {child}
transform:
  translation:
    x: {x}
    y: {y}
    z: {z}
  rotation:
    x: {qx}
    y: {qy}
    z: {qz}
    w: {qw}
"""
MOVEIT = """<launch>
  <!-- xyz="0 0 0" rpy="0 0 0" by static_transform_publisher -->
  <node pkg="tf2_ros" type="static_transform_publisher" name="camera_link_broadcaster"
      args="{x} {y} {z}   {qx} {qy} {qz} {qw} {parent} {child}" />
</launch>
"""
MOVEIT2 = """Node(
    package="tf2_ros",
    executable="static_transform_publisher",
    arguments=[
        "--frame-id", "{parent}", "--child-frame-id", "{child}",
        "--x", "{x}", "--y", "{y}", "--z", "{z}",
        "--qx", "{qx}", "--qy", "{qy}", "--qz", "{qz}", "--qw", "{qw}",
    ],
)
"""


def calibration(form, camera, child, parent="base"):
    T = camera.T_world_camera
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    numbers = [*T[:3, 3], *Rotation.from_matrix(np.array(T[:3, :3])).as_quat()]
    return form.format(
        child=child, parent=parent, **{n: f"{x:.9f}" for n, x in zip(names, numbers, strict=True)}
    )


@pytest.mark.parametrize(("left", "right"), [(EASY, MOVEIT), (MOVEIT2, EASY2)])
def test_poses_as_other_programs_write_them(world, tmp_path, left, right):
    """In place of TF's, also of the frame beside that of the pictures; and of a folder's camera."""
    rows, ropes, cameras = rows_of(world, "raw", stated=False)
    path = write_bag(tmp_path / "lift.bag", rows, "ROS1")
    (tmp_path / "object.toml").write_text(OBJECT)
    files = []
    for camera, form, child, T in (
        (cameras[0], left, "left_optical_frame", np.eye(4)),
        (cameras[1], right, "right_colour_frame", _shift(OFFSET)),
    ):
        files.append(tmp_path / f"{camera.name}.txt")
        files[-1].write_text(calibration(form, camera.at(camera.T_world_camera @ T), child))
    out = tmp_path / "lift.npz"
    words = ["perceive", str(path), "--gripper", "tool", "--colour", "180", "30", "35"]
    assert cli.main([*words, "--poses", *map(str, files), "--out", str(out)]) == 0
    error = ropes[2].distance(Recording.read(out).frame(2).astype(float))
    assert np.sqrt(np.mean(error**2)) < 0.004


@pytest.mark.parametrize("form", [EASY, EASY2, MOVEIT, MOVEIT2])
def test_a_camera_toml_names_the_file(world, tmp_path, form):
    camera = world.pair()[0]
    world_camera = camera.T_world_camera
    text = calibration(form, camera, "left_optical_frame")
    file, stated = tmp_path / "camera.toml", 'T_world_camera = "calibration.txt"\n'
    write_camera(file, camera)
    file.write_text(file.read_text().partition("T_world_camera")[0] + stated)
    (tmp_path / "calibration.txt").write_text(text)
    np.testing.assert_allclose(read_camera(file).calibrated(), world_camera, atol=1e-7)
    in_hand = calibration(form, camera, "left_optical_frame", "tool0")
    for change, said in (
        (
            text.replace("left_optical_frame", "left_link"),
            "left_link, whose axes need not be a camera's",
        ),
        (in_hand, "in tool0: the camera is in the hand"),
        ("robot: 3", "does not say which frame is in which"),
    ):
        (tmp_path / "calibration.txt").write_text(change)
        with pytest.raises(RecordingError, match=said):
            read_camera(file)


def test_joint_states_tell_the_robots_shape(world, tmp_path):
    """Of the robot that the object's file names, fingers and their order aside."""
    rows, _, _ = rows_of(world, "organised")
    q = XARM7.home + 0.1
    names = [f"joint{k}" for k in range(7, 0, -1)] + ["left_finger_joint2"]
    for t in (0.0, 0.1):
        of = {"header": header(t, ""), "name": names, "position": np.array([*q[::-1], 0.04])}
        rows.append(("/joint_states", made("sensor_msgs/JointState", of)))
    path = write_bag(tmp_path / "lift.bag", rows, "ROS1")
    (tmp_path / "object.toml").write_text('robot = "xarm7"\n' + OBJECT)
    settings = RosSettings(gripper="tool")
    found = read_ros_cameras(path, tmp_path / "object.toml", settings).capsules
    assert found is not None
    here, there = found.at(START + 0.05), arm_shape(XARM7, q[None], np.array([0.01]))
    np.testing.assert_allclose(here.start, there.start[0], atol=1e-9)


def test_a_cloud_that_was_cropped_beside_the_axis(world, tmp_path):
    """The camera that is made of it has its axis in the picture, and the points at their places."""
    camera = world.make_camera()
    points = np.stack(np.meshgrid(np.linspace(0.2, 0.4, 80), np.linspace(0.3, 0.4, 40)), -1)
    points = np.concatenate([points.reshape(-1, 2), np.full((3200, 1), 0.8)], axis=1)
    seen = [("/tf", tf(t, "base", "tool", (0.0, 0.0, 0.1 + t))) for t in (0.0, 1.0)]
    seen += [placed("base", "eye_optical_frame", camera.T_world_camera)]
    seen += [("/eye/points", ros_cloud(0.5, "eye_optical_frame", points))]
    path = write_bag(tmp_path / "lift.bag", seen, "ROS1")
    (tmp_path / "object.toml").write_text(OBJECT)
    recorded = read_ros_cameras(path, tmp_path / "object.toml", RosSettings(gripper="tool"))
    (source,) = recorded.sources
    depth = next(iter(source)).read().depth.ravel()
    found = source.camera.rays()[depth > 0] * (depth[depth > 0, None] * source.camera.depth_unit)
    assert len(found) > 2000 and KDTree(points).query(found)[0].max() < 0.005


def test_what_perceive_cannot_use(world, tmp_path, capsys):
    """A camera in the hand, and clouds that are in the world's frame already."""
    rows, _, _ = rows_of(world, "organised")
    (tmp_path / "object.toml").write_text(OBJECT)
    moving = [("/tf", tf(t / 30.0, "base", "tool", (0.0, 0.0, 0.2 + 0.1 * t))) for t in range(4)]
    turned = [r for r in rows if r[0] not in ("/tf", "/tf_static")]
    sparse = np.random.default_rng(0).uniform((0.0, 0.0, 0.7), (0.3, 0.3, 0.8), (120, 3))
    rows = [placed("base", "far_optical_frame", np.eye(4))]
    thin = ("/far/points", ros_cloud(0.05, "far_optical_frame", sparse))
    bare = [row for row in rows_of(world, "raw")[0] if not row[0].endswith("camera_info")]
    hand = [placed("tool", f"{n}_optical_frame", np.eye(4)) for n in ("left", "right")]
    for name, of, said in (
        ("hand", [*turned, *moving, *hand], "_optical_frame moves in base by 300.0 mm"),
        ("thin", [*rows, *moving, thin], "frame far_optical_frame are thinned, or not"),
        ("lost", turned, "TF does not say where right_optical_frame is"),
        ("bare", bare, "without a CameraInfo beside them; record camera_info"),
    ):
        path = write_bag(tmp_path / f"{name}.bag", of, "ROS1")
        assert cli.main(["perceive", str(path), "--gripper", "tool"]) == 2
        assert said in capsys.readouterr().err
