"""Files of others with random damage: each is read or refused, in bounded time and memory."""

import contextlib
import os
import resource
import shutil
import time
from functools import partial
from importlib import import_module, resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from datasets.test_clouds import ENCODINGS, at_rest, pcd, rows
from datasets.test_folder import write_ply
from gendom.cli.recognised import look
from gendom.datasets import ObjectDescription, Recording
from gendom.datasets.demonstrations import generate, load, read_description
from gendom.datasets.lerobot import export_recording
from gendom.errors import GendomError
from gendom.files import write_json
from gendom.hardware.cell import Cell, PlannedMotion
from gendom.hardware.contracts import Tick
from gendom.hardware.execution import ACTION_FORMAT, ExecutionLog, read_action, read_log
from gendom.materials import Material, Rope
from gendom.materials.estimate import Estimate
from gendom.perception import Camera, RealSenseRecording, read_cameras, write_camera
from gendom.perception.calibration import read_views
from gendom.perception.poses import read_poses
from gendom.perception.ros import RosSettings, read_ros_bag, read_ros_cameras
from gendom.policies import Policy
from gendom.reality.object_file import read_object
from gendom.robot import XARM7, joint_move, read_arm
from gendom.robot.motion import read_joints
from gendom.robot.motions import LiftMotion, predefined_lift
from simulated_cell import write_cell
from throwing import Throwing

LONGEST, MOST_MEMORY = 2.0, 500e3
"""Of a case [s of this process], and of all [KiB more than before]."""

WORDS = [b"\0", b"\n", b"-1", b"nan", b"1e400", b"9" * 400, b"../", b"\xff\xfe", b"[" * 2000, b"\\"]
OBJECT = 'kind = "rope"\nmaterial = "cotton-rope"\nlength = 0.4\ndiameter = 0.01\nmass = 0.02\n'
TOML = 'table_height = 0.0\n[object]\nkind = "rope"\nlength = 0.4\nmass = 0.02\n'
K = np.array([[10.0, 0.0, 4.0], [0.0, 10.0, 2.0], [0.0, 0.0, 1.0]])
CAMERA = Camera(name="left", width=8, height=4, K=K, T_world_camera=np.eye(4))
POLICY = Path(str(resources.files("gendom"))) / "assets" / "rope-reaching.onnx"
DB3 = Path(__file__).parents[1] / "perception" / "recordings" / "sdk-2.59.db3"
MOTION = {"format": "gendom-motion/1", "lift": predefined_lift("rope")}
POINTS = np.random.default_rng(0).normal(size=(12, 3)).astype(np.float32) * 0.05


def recording():
    steps = np.arange(4.0)
    grip = np.stack([0.0 * steps, 0.0 * steps, 0.01 * steps], axis=1)
    clouds = [POINTS + at.astype(np.float32) for at in grip]
    return Recording.from_frames(
        clouds, time=0.1 * steps, gripper_position=grip, table_height=0.0,
        object=ObjectDescription(kind="rope", length=0.4, mass=0.02),
    )  # fmt: skip


def as_pcd(path, encoding):
    path.write_bytes(pcd(encoding, 12) + ENCODINGS[encoding](rows(POINTS)))


def cameras(folder):
    place = folder / "cameras" / "left"
    place.mkdir(parents=True)
    write_camera(place / "camera.toml", CAMERA)
    for k in range(3):
        Image.fromarray(np.full((4, 8), 900, np.uint16)).save(place / f"{k}.png")
    table(place / "frames.csv", "time,depth", *(f"{0.1 * k},{k}.png" for k in range(3)))
    joints(folder)
    gripper(folder)


def joints(folder):
    times = (f"{0.1 * k},0,0,0,0.5,0,0,0,0.02" for k in range(3))
    table(folder / "joints.csv", "time,q0,q1,q2,q3,q4,q5,q6,gripper", *times)


def table(path, *rows):
    path.write_text("\n".join([*rows, ""]))


def gripper(folder):
    table(folder / "gripper.csv", "time,x,y,z", *(f"{0.1 * k},0,0,{0.01 * k}" for k in range(4)))
    (folder / "object.toml").write_text(TOML)


def board(folder):
    table(folder / "board.toml", "squares_x = 5", "squares_y = 4", "square = 0.04", "marker = 0.03")
    poses = (f"{k}.png,0,0,0,0,0,0,1" for k in range(2))
    table(folder / "poses.csv", "picture,x,y,z,qx,qy,qz,qw", *poses)
    for k in range(2):
        Image.fromarray(np.full((4, 8), 90, np.uint8)).save(folder / f"{k}.png")


HANDEYE = """parameters: {eye_on_hand: false, robot_base_frame: base, tracking_base_frame: eye}
transformation: {x: 1.0, y: 0.0, z: 0.5, qx: 0.0, qy: 0.0, qz: 0.0, qw: 1.0}
"""
LAUNCH = """<launch>
<node pkg="tf2_ros" exec="static_transform_publisher" args="1 0 0.5 0 0 0 base eye"/>
<node exec="static_transform_publisher" args="--x 1 --qw 1 --frame-id base --child-frame-id o"/>
</launch>"""
LINK = '<body name="l{}" pos="0 0 0.1"><joint axis="0 {} {}" range="-100 90"/><geom size="0.03"/>'
LINKS = "".join(LINK.format(k, k % 2, 1 - k % 2) for k in range(1, 7))
MJCF = f"<mujoco><worldbody>{LINKS}{'</body>' * 6}</worldbody></mujoco>"
HAND = 'flange = "l6"\ntool = 0.2\nhome = [0, 0, 0, 1, 0, 0]\n'


def arm(folder):
    """Six joints with meshes, and the .toml beside them."""
    pytest.importorskip("mujoco", reason="needs the extra reality")
    mesh = '<collision><geometry><mesh filename="package://a/b.stl"/></geometry></collision>'
    links = (
        f'<link name="l{k}">{mesh}</link><joint name="j{k}" type="revolute"><origin xyz="0 0 0.1"/>'
        f'<parent link="l{k - 1}"/><child link="l{k}"/><axis xyz="0 {k % 2} {1 - k % 2}"/>'
        '<limit lower="-2" upper="2" velocity="2"/></joint>'
        for k in range(1, 7)
    )
    table(folder / "arm.urdf", '<robot name="r"><link name="l0"/>', *links, "</robot>")
    (folder / "arm.toml").write_text(HAND)
    corners = 0.05 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "<f4")
    faces = corners[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]]
    data = b"".join(bytes(12) + face.tobytes() + b"\0\0" for face in faces)
    (folder / "b.stl").write_bytes(bytes(80) + np.array([4], "<u4").tobytes() + data)


def bag(plugin, topics, folder):
    """A folder of ROS 2's or a file of ROS 1's: clouds, or depth pictures, raw or as PNG."""
    messages: Any = pytest.importorskip("ros_messages", reason="needs rosbags: the extra ros")
    ros: Any = import_module("perception.test_ros_cameras")
    frame, depth = "eye_optical", np.full((4, 8), 900, "<u2")
    sent: list = [ros.placed("world", frame, np.eye(4))]
    sent += [("/eye/depth/camera_info", ros.info(CAMERA, frame))] * (topics != "clouds")
    for t in range(4):
        time, at, form = 0.1 * t, (0.0, 0.0, 0.01 * t), "16UC1; compressedDepth png"
        sent.append(("/tf", ros.tf(time, "world", "tool", at)))
        sent.append(("/pose", messages.pose(time, "world", at)))
        sent.append({
            "clouds": ("/clouds", messages.cloud(time, "world", POINTS)),
            "raw": ("/eye/depth/image_rect_raw", ros.image(time, frame, depth, "16UC1")),
            "packed": ("/eye/depth/image_rect_raw/compressedDepth",
                       ros.packed(time, frame, depth, form)),
        }[topics])  # fmt: skip
    ros.write_bag(folder / ("x.bag" if plugin.startswith("ROS1") else "x"), sent, plugin)
    (folder / "object.toml").write_text(TOML)


def read_bag(folder, topics):
    """Clouds with the topic of poses, or pictures with TF."""
    (place,), held = folder.glob("x*"), folder / "object.toml"
    if topics == "clouds":
        read_ros_bag(place, held, RosSettings(gripper="/pose"))
    else:
        read_frames(*read_ros_cameras(place, held, RosSettings(gripper="tool")).sources)


def read_frames(*sources):
    for source in sources:
        for frame in source:
            frame.read()


LOOPS = np.linspace([0.0, 0.0, 0.2], [0.3, 0.0, 0.2], 8)[None] + np.zeros((2, 8, 3))


def estimate(folder):
    material = Material(E=8e5, nu=0.3, density=800.0, damping=0.005)
    rope = Rope(length=0.3, diameter=0.016, material=material)
    Estimate.of(rope).with_uncertain("E_over_rho", 0.03).save(folder / "estimate.json")


def files(**contents):
    """Files by their names, with _ for the dot: text, copies of other files, or JSON."""

    def make(folder):
        for name, content in contents.items():
            path = folder / name.replace("_", ".")
            if isinstance(content, str):
                path.write_text(content)
            elif isinstance(content, Path):
                shutil.copy(content, path)
            else:
                write_json(path, content)

    return make


def read(folder):
    Recording.read(folder, on_warning=lambda _: None)


def clouds(write, suffix):
    """A folder with a cloud a frame, by a function of a path."""

    def make(folder):
        for k in range(4):
            write(folder / f"{k:04d}{suffix}")
        gripper(folder)

    return make, read


def numbers(path):
    """All that a recording holds, as text."""
    recording = Recording.read(path, on_warning=lambda _: None)
    arrays = (recording.points, recording.offsets, recording.time, recording.gripper_position)
    return repr([recording.meta(), *(a.tolist() for a in arrays)])


def estimated(folder):
    found = Estimate.load(folder / "estimate.json")
    return repr([found.rows(), found.posterior.to_dict(), found.verdict])


def acted(path):
    """What a policy says of itself, and does."""
    read = Policy.read(path)
    middle = {name: sum(ends) / 2.0 for name, ends in read.description.parameters.items()}
    return repr([read.description, read.actions(read.description.goals(None).T, middle).tolist()])


def action(folder):
    home, there = XARM7.home, XARM7.home + 0.1
    moves: dict = {"motion": joint_move(XARM7, there, home)}
    moves |= {"approach": joint_move(XARM7, home, there)}
    planned = PlannedMotion(arm="xarm7", first=there, surroundings={}, opening=0.01, **moves)
    said = {"format": ACTION_FORMAT, "task": "t", "goal": {}, "action": {"a": 1.0}, "object": {}}
    said |= {"trajectory": {"T_base_task": np.eye(4)}, "plan": planned}
    write_json(folder / "action.json", said)


def log(folder):
    written = ExecutionLog(folder / "a.jsonl", {"format": ACTION_FORMAT})
    for k in range(4):
        q = np.zeros(7)
        written.tick(Tick(time=0.01 * k, command=q, measured=q, age=0.0, stamp=0.0))
    written.write(call="stop")
    written.end("done")


BAGS = [(plugin, "clouds") for plugin in ("MCAP", "ROS1", "ROS1 LZ4", "SQLITE3")]
BAGS += [("ROS1", "raw"), ("ROS1", "packed")]

READERS = {
    "cell": (write_cell, lambda f: Cell.read(f / "cell.toml").faults()),
    "action": (action, lambda f: read_action(f / "action.json")),
    "log": (log, lambda f: read_log(f / "a.jsonl")),
    "npz": (lambda f: recording().write(f / "a.npz"), lambda f: numbers(f / "a.npz")),
    "lerobot": (lambda f: export_recording(recording(), f / "out"), lambda f: numbers(f / "out")),
    "estimate": (estimate, estimated),
    "policy": (files(policy_onnx=POLICY), lambda f: acted(f / "policy.onnx")),
    "demonstrations": (
        lambda f: generate(Throwing(), 40, f / "set", seed=5, shard_size=16),
        lambda f: repr([read_description(f / "set"), load(f / "set").to_pydict()]),
    ),
    "motion": (files(motion_json=MOTION), lambda f: LiftMotion.read(f / "motion.json")),
    "ply": clouds(partial(write_ply, points=POINTS), ".ply"),
    "ply as text": clouds(partial(write_ply, points=POINTS, text=True), ".ply"),
    "clouds as npz": clouds(partial(np.savez, points=POINTS), ".npz"),
    **{f"pcd {e}": clouds(partial(as_pcd, encoding=e), ".pcd") for e in ENCODINGS},
    **{" ".join(b): (partial(bag, *b), partial(read_bag, topics=b[-1])) for b in BAGS},
    "cameras": (cameras, lambda f: read_frames(*read_cameras(f).sources)),
    "realsense": (files(recording_db3=DB3), lambda f: read_frames(RealSenseRecording(f))),
    "joints": (joints, lambda f: read_joints(f / "joints.csv", XARM7)),
    "board": (board, lambda f: read_views(f, CAMERA, on_warning=lambda _: None)),
    "npz at rest": (lambda f: at_rest(f / "a.npz", LOOPS), lambda f: numbers(f / "a.npz")),
    "arm": (arm, lambda f: read_arm(f / "arm.urdf")),
    "arm as mjcf": (files(arm_xml=MJCF, arm_toml=HAND), lambda f: read_arm(f / "arm.xml")),
    "pose": (files(a_yaml=HANDEYE), lambda f: read_poses(f / "a.yaml")),
    "launch": (files(a_launch=LAUNCH), lambda f: read_poses(f / "a.launch")),
    "object": (files(a_toml=OBJECT), lambda f: read_object(f / "a.toml")),
}


EDITED = {"cell", "action", "log", "motion", "arm", "arm as mjcf", "pose", "launch"}
EDITED |= {"object", "joints"}
"""Text that people edit: other numbers are read without a word."""


def damaged(data, rng):
    """The same bytes with one to three places changed."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(len(data) + 1))
        end = min(len(data), at + int(rng.integers(1, 40)))
        kind = rng.integers(6)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << rng.integers(8)
        elif kind == 1:
            del data[at:end]
        elif kind == 2:
            data[at:at] = data[at:end]
        elif kind == 3:
            data[at:at] = WORDS[rng.integers(len(WORDS))]
        elif kind == 4:
            data[at:end] = rng.bytes(end - at)
        else:
            del data[at + int(0.9 * (len(data) - at)) :]
    return bytes(data)


def made(tmp_path, kind):
    """The folder of a kind, its files, and what its reader finds there."""
    folder = tmp_path / "in"
    folder.mkdir()
    make, take = READERS[kind]
    make(folder)
    return folder, sorted(path for path in folder.rglob("*") if path.is_file()), take(folder)


def check(kind, stated, folder, path, content, case):
    """Read a folder with another content of a file, by what reads it and by `gendom doctor`."""
    whole, take = path.read_bytes(), READERS[kind][1]
    path.write_bytes(content)
    for read, place in ((take, folder), (look, path), (look, folder)):
        by = "gendom doctor" if read is look else "its reader"
        began, at = time.process_time(), f"case {case}, {path.name}, {by}"
        try:
            found = read(place)
        except GendomError as error:
            lines = str(error).splitlines()
            assert len(lines) <= max(1, len(getattr(error, "faults", ()))), at
        except Exception as error:
            raise AssertionError(f"{at}: {error!r}") from error
        else:
            same = read is look or kind in EDITED or found == stated
            assert same, f"{at}: other numbers"
        assert time.process_time() - began < LONGEST, at
    path.write_bytes(whole)


@pytest.mark.parametrize("count", [5, pytest.param(70, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", READERS)
def test_damaged_files_are_read_or_refused(tmp_path, kind, count):
    folder, files, stated = made(tmp_path, kind)
    rng, before = np.random.default_rng(count), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for case in range(count):
        path = files[rng.integers(len(files))]
        check(kind, stated, folder, path, damaged(path.read_bytes(), rng), case)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MOST_MEMORY
    assert sorted(path for path in folder.rglob("*") if path.is_file()) == files
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


ODD = {
    "a loop of links": lambda path: path.symlink_to(path.name),
    "a link to nothing": lambda path: path.symlink_to("nothing"),
    "a link to zeros": lambda path: path.symlink_to("/dev/zero"),
    "a folder": Path.mkdir,
    "a pipe": os.mkfifo,
    "nothing": Path.touch,
    "a hole of a terabyte": lambda path: (path.touch(), os.truncate(path, 1 << 40)),
}


@pytest.mark.slow
@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("kind", READERS)
def test_what_stands_in_place_of_a_file_is_refused(tmp_path, kind, odd):
    """Or left out with a word, or never opened."""
    folder, files, _ = made(tmp_path, kind)
    path = files[len(files) // 2]
    path.unlink()
    ODD[odd](path)
    for take, place in ((READERS[kind][1], folder), (look, folder), (look, path)):
        began = time.process_time()
        with contextlib.suppress(GendomError):
            take(place)
        assert time.process_time() - began < LONGEST


FAR, ONE = np.full(3, 1e9, "<f4").tobytes(), np.float64(1.0).tobytes()


@pytest.mark.parametrize(
    ("kind", "old", "new"),
    [
        ("ply", POINTS[0].tobytes(), FAR),  # 100 GB of 10 mm
        ("ply", b"vertex 12", b"vertex 10"),  # two are left over
        ("MCAP clouds", b"float64 y", b"float64 Y"),
        ("MCAP clouds", bytes(24) + ONE, bytes(24) + np.float64(1e200).tobytes()),
        ("board", b"png,0,", b"png,1_0,"),
        ("arm", b"b.stl", b"b" * 300),  # longer than names are
        ("arm", np.array([0.05, 0, 0], "<f4").tobytes(), FAR),  # 1e21 triangles of 15 mm
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_was_found_stays_mended(tmp_path, kind, old, new):
    folder, files, stated = made(tmp_path, kind)
    path = next(path for path in files if old in path.read_bytes())
    check(kind, stated, folder, path, path.read_bytes().replace(old, new), old)
