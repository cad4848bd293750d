"""Bags with what cameras saw: `gendom perceive` takes table and robot out of them."""

import io
from functools import cache

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gendom import cli
from gendom.arrays import rigid
from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.perception import RosSettings, read_camera, read_ros_cameras, write_camera
from gendom.robot import XARM7, arm_shape

pytest.importorskip("rosbags", reason="needs rosbags: the extra ros")

from perception.conftest import Plane, Scene, lifted_rope, make_camera, pair
from ros_messages import START, header, made, tf, write_bag
from ros_messages import cloud as ros_cloud

OBJECT = 'table_height = 0.0\n[object]\nkind = "rope"\nlength = 0.4\ndiameter = 0.01\n'
FRAMES = 3
OFFSET = np.array([0.015, 0.0, 0.0])
"""Of the colour camera, to the right of the depth camera [m]."""


def placed(parent, child, T):
    turn = Rotation.from_matrix(np.array(T[:3, :3]))
    return "/tf_static", tf(0.0, parent, child, T[:3, 3], turn)


def info(camera, frame):
    of = {"height": camera.height, "width": camera.width, "d": np.zeros(5), "k": camera.K.ravel()}
    of |= {"header": header(0, frame), "p": np.pad(camera.K, [(0, 0), (0, 1)]).ravel()}
    return made("sensor_msgs/CameraInfo", of)


def image(time, frame, picture, encoding):
    of = dict(zip(("height", "width"), picture.shape, strict=False), encoding=encoding)
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
    points = np.where(z > 0.0, camera.rays() * z, np.nan).astype("<f4")
    r, g, b = pictures.colour.reshape(-1, 3).astype("<u4").T
    table = np.column_stack([points, (r << 16 | g << 8 | b).view("<f4")])
    fields = [
        {"name": n, "offset": 4 * k, "datatype": 7, "count": 1}
        for k, n in enumerate(("x", "y", "z", "rgb"))
    ]
    table = table if organised else table[z[:, 0] > 0.0]
    width, height = (camera.width, camera.height) if organised else (len(table), 1)
    size = {"height": height, "width": width, "point_step": 16, "row_step": 16 * width}
    data = np.frombuffer(table.tobytes(), np.uint8)
    of = {"header": header(time, frame), "fields": fields, "data": data, **size}
    return made("sensor_msgs/PointCloud2", of)


@cache
def rows_of(form, *, stated=True):
    """A lift of a rope from a table, seen by two cameras; the gripper and they in TF."""
    cameras, rows, ropes = pair(0.5), [], []
    if stated:
        rows += [placed("base", f"{c.name}_optical_frame", c.T_world_camera) for c in cameras]
    for camera in cameras:
        name, frame, other = names_of(camera)
        rows.append(placed(frame, other, rigid(np.eye(3), OFFSET)))
        if form != "unknown":
            rows.append((f"{name}/depth/camera_info", info(camera, frame)))
            rows.append((f"{name}/color/camera_info", info(camera, other)))
    for t in range(FRAMES):
        time, tip = t / 30.0, (0.0, 0.0, 0.2 + 0.01 * t)
        rows.append(("/tf", tf(time, "base", "tool", tip)))
        ropes.append(lifted_rope(tip=tip))
        scene = Scene([Plane(), ropes[-1]])
        for k, camera in enumerate(cameras):
            name, frame, other = names_of(camera)
            seen = scene.pictures(camera, seed=10 * k + t)
            if form in ("organised", "unknown"):
                message = cloud(time, frame, camera, seen, form == "organised")
                rows.append((f"{name}/points", message))
                continue
            beside = camera.at(camera.T_world_camera @ rigid(np.eye(3), OFFSET))
            colour = scene.pictures(beside, seed=50 + 10 * k + t).colour
            depth, late = np.rint(1e3 * seen.depth * camera.depth_unit).astype("u2"), time + 0.004
            of_depth, of_colour = f"{name}/depth/image_rect_raw", f"{name}/color/image_raw"
            if form == "raw":
                rows.append((of_depth, image(time, frame, depth, "16UC1")))
                rows.append((of_colour, image(late, other, colour, "rgb8")))
                continue
            message = packed(time, frame, depth, "16UC1; compressedDepth png")
            rows.append((f"{of_depth}/compressedDepth", message))
            message = packed(late, other, colour, "rgb8; jpeg compressed bgr8")
            rows.append((f"{of_colour}/compressed", message))
    return rows, ropes, cameras


def names_of(camera):
    """Of a camera's topics and of the frames of its depth and colour."""
    name = camera.name
    return f"/{name}", f"{name}_optical_frame", f"{name}_colour_frame"


EASY = """parameters:
  eye_on_hand: false
  robot_base_frame: {parent}
  robot_effector_frame: tool
  tracking_base_frame: {child}
transformation: {{x: {x}, y: {y}, z: {z}, qx: {qx}, qy: {qy}, qz: {qz}, qw: {qw}}}
"""
EASY2 = """parameters: {{name: left, calibration_type: eye_on_base,
  robot_base_frame: {parent}, tracking_base_frame: {child}}}
transform:
  translation: {{x: {x}, y: {y}, z: {z}}}
  rotation: {{x: {qx}, y: {qy}, z: {qz}, w: {qw}}}
"""
MOVEIT = """<launch>
  <!-- xyz="0 0 0" rpy="0 0 0" by static_transform_publisher -->
  <node pkg="tf2_ros" type="static_transform_publisher" name="camera_link_broadcaster"
      args="{x} {y} {z}   {qx} {qy} {qz} {qw} {parent} {child}" />
</launch>
"""
MOVEIT2 = """Node(package="tf2_ros", executable="static_transform_publisher", arguments=[
        "--frame-id", "{parent}", "--child-frame-id", "{child}",
        "--x", "{x}", "--y", "{y}", "--z", "{z}",
        "--qx", "{qx}", "--qy", "{qy}", "--qz", "{qz}", "--qw", "{qw}",
])
"""


def calibration(form, camera, child, parent="base"):
    T = camera.T_world_camera
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    numbers = [*T[:3, 3], *Rotation.from_matrix(np.array(T[:3, :3])).as_quat()]
    said = {n: f"{x:.9f}" for n, x in zip(names, numbers, strict=True)}
    return form.format(child=child, parent=parent, **said)


@pytest.fixture
def bag(tmp_path):
    """Function (rows, plugin) -> a bag of them, with what is held in object.toml beside it."""

    def write(rows, plugin="ROS1", name="lift"):
        (tmp_path / "object.toml").write_text(OBJECT)
        return write_bag(tmp_path / (f"{name}.bag" if plugin == "ROS1" else name), rows, plugin)

    return write


def perceived(path, *words):
    """The recording that `gendom perceive` makes of a bag."""
    out, red = path.parent / "lift.npz", ["--colour", "180", "30", "35"]
    words = ["perceive", str(path), "--gripper", "tool", *red, *map(str, words), "--out", str(out)]
    assert cli.main(words) == 0
    return Recording.read(out)


@pytest.mark.parametrize(
    ("form", "plugin"),
    [("raw", "SQLITE3"), ("packed", "ROS1"), ("organised", "MCAP"), ("unknown", "ROS1")],
)
def test_a_lift_before_two_cameras(bag, tmp_path, capsys, form, plugin):
    """Depth and colour, raw and packed, and clouds with and without a known camera."""
    rows, ropes, _ = rows_of(form)
    path = bag(rows, plugin)
    (tmp_path / "object.toml").rename(tmp_path / "held.toml")
    found = perceived(path, "--object", tmp_path / "held.toml")
    assert "left" in capsys.readouterr().out
    assert found.num_frames == FRAMES and found.gripper_source == "measured"
    assert found.extra["perception"]["cameras"] == ["left", "right"]
    np.testing.assert_allclose(found.gripper_position[:, 0, 2], 0.2 + 0.01 * np.arange(FRAMES))
    for t, rope in enumerate(ropes):
        error = rope.distance(found.frame(t).astype(float))
        assert len(error) > 60 and np.sqrt(np.mean(error**2)) < 0.004


def test_poses_as_other_programs_write_them(bag, tmp_path):
    """In place of TF's, also of the frame beside that of the pictures; and of a folder's camera."""
    rows, ropes, cameras = rows_of("raw", stated=False)
    files = [tmp_path / "left.txt", tmp_path / "right.txt"]
    files[0].write_text(calibration(EASY, cameras[0], "left_optical_frame"))
    beside = cameras[1].at(cameras[1].T_world_camera @ rigid(np.eye(3), OFFSET))
    files[1].write_text(calibration(MOVEIT, beside, "right_colour_frame"))
    found = perceived(bag(rows), "--poses", *files)
    error = ropes[2].distance(found.frame(2).astype(float))
    assert np.sqrt(np.mean(error**2)) < 0.004


@pytest.mark.parametrize("form", [EASY, EASY2, MOVEIT, MOVEIT2])
def test_a_camera_toml_names_the_file(tmp_path, form):
    camera = pair()[0]
    text = calibration(form, camera, "left_optical_frame")
    file, poses = tmp_path / "camera.toml", tmp_path / "calibration.txt"
    write_camera(file, camera)
    stated = 'T_world_camera = "calibration.txt"\n'
    file.write_text(file.read_text().partition("T_world_camera")[0] + stated)
    poses.write_text(text)
    np.testing.assert_allclose(read_camera(file).calibrated(), camera.calibrated(), atol=1e-7)
    link = text.replace("left_optical_frame", "left_link")
    in_hand = calibration(form, camera, "left_optical_frame", "tool0")
    for change, said in (
        (link, "left_link, whose axes need not be a camera's"),
        (in_hand, "in tool0: the camera is in the hand"),
        ("robot: 3", "does not say which frame is in which"),
    ):
        poses.write_text(change)
        with pytest.raises(RecordingError, match=said):
            read_camera(file)


def test_joint_states_tell_the_robots_shape(bag, tmp_path):
    """Of the robot that the object's file names, fingers and their order aside."""
    rows, q = rows_of("organised")[0], XARM7.home + 0.1
    names = [f"joint{k}" for k in range(7, 0, -1)] + ["left_finger_joint2"]
    of = {"name": names, "position": np.array([*q[::-1], 0.04])}
    states = (made("sensor_msgs/JointState", {"header": header(t, ""), **of}) for t in (0.0, 0.1))
    path = bag([*rows, *(("/joint_states", state) for state in states)])
    (tmp_path / "object.toml").write_text('robot = "xarm7"\n' + OBJECT)
    settings = RosSettings(gripper="tool")
    found = read_ros_cameras(path, tmp_path / "object.toml", settings).capsules
    assert found is not None
    here, there = found(START + 0.05), arm_shape(XARM7, q[None], np.array([0.01]))
    np.testing.assert_allclose(here.start, there.start[0], atol=1e-9)


def moving(by):
    """The tool's way, by metres a second."""
    return [("/tf", tf(t, "base", "tool", (0.0, 0.0, 0.2 + by * t))) for t in (0.0, 0.1, 1.0)]


def test_a_cloud_that_was_cropped_beside_the_axis(bag, tmp_path):
    """The camera that is made of it has its axis in the picture, and the points at their places."""
    points = np.stack(np.meshgrid(np.linspace(0.2, 0.4, 80), np.linspace(0.3, 0.4, 40)), -1)
    points = np.concatenate([points.reshape(-1, 2), np.full((3200, 1), 0.8)], axis=1)
    place = placed("base", "eye_optical_frame", make_camera().T_world_camera)
    path = bag([*moving(1.0), place, ("/eye/points", ros_cloud(0.5, "eye_optical_frame", points))])
    recorded = read_ros_cameras(path, tmp_path / "object.toml", RosSettings(gripper="tool"))
    (source,) = recorded.sources
    depth = next(iter(source)).read().depth.ravel()
    found = source.camera.rays()[depth > 0] * (depth[depth > 0, None] * source.camera.depth_unit)
    assert len(found) > 2000 and KDTree(points).query(found)[0].max() < 0.005


def test_what_perceive_cannot_use(bag, refused):
    """A camera in the hand, and clouds that are in the world's frame already."""
    turned = [r for r in rows_of("organised")[0] if r[0] not in ("/tf", "/tf_static")]
    sparse = np.random.default_rng(0).uniform((0.0, 0.0, 0.7), (0.3, 0.3, 0.8), (120, 3))
    thin = ("/far/points", ros_cloud(0.05, "far_optical_frame", sparse))
    bare = [row for row in rows_of("raw")[0] if not row[0].endswith("camera_info")]
    hand = [placed("tool", f"{n}_optical_frame", np.eye(4)) for n in ("left", "right")]
    still = placed("base", "far_optical_frame", np.eye(4))
    for name, of, said in (
        ("hand", [*turned, *moving(3.0)[:2], *hand], "_optical_frame moves in base by 300.0 mm"),
        ("thin", [still, *moving(3.0), thin], "frame far_optical_frame are thinned, or not"),
        ("lost", turned, "TF does not say where right_optical_frame is"),
        ("bare", bare, "without a CameraInfo beside them; record camera_info"),
    ):
        assert said in refused("perceive", bag(of, name=name), "--gripper", "tool")
