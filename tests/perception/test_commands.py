"""`gendom perceive`: a recording comes of it, and bad input gives one line."""

import json
import shutil
import zlib
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gendom import cli
from gendom.datasets import Recording
from gendom.perception import (
    FrameSource,
    PngCamera,
    read_cameras,
)
from software_camera import recording

RED = ["--colour", "180", "30", "35"]


@pytest.fixture(scope="module")
def lift(world, tmp_path_factory):
    """A good recording and the ropes in it."""
    folder = tmp_path_factory.mktemp("good") / "lift"
    return folder, world.write_lift(folder)


@pytest.fixture
def copy(lift, tmp_path):
    """A copy to spoil."""
    return shutil.copytree(lift[0], tmp_path / "lift")


@pytest.fixture
def perceive(tmp_path, capsys):
    def run(folder, *words):
        out = tmp_path / "out" / "recording.npz"
        code = cli.main(["perceive", str(folder), "--out", str(out), *words])
        printed = capsys.readouterr()
        return code, printed, out

    return run


def refused(result, *parts):
    code, printed, out = result
    assert code == 2 and not out.exists()
    assert len(printed.err.splitlines()) == 1, printed.err
    for part in parts:
        assert part in printed.err


def test_recording_of_a_rope(lift, perceive):
    folder, ropes = lift
    code, printed, out = perceive(folder, *RED, "--frames")
    assert code == 0 and printed.err == ""
    assert "warning" not in printed.out
    assert "levelled by the table: left " in printed.out and "; right " in printed.out
    assert len([line for line in printed.out.splitlines() if line.startswith("    0.")]) == 6
    recording = Recording.read(out)
    np.testing.assert_allclose(recording.time, np.arange(6) / 30)
    np.testing.assert_allclose(recording.gripper_position[:, 0, 2], 0.2 + 0.01 * np.arange(6))
    assert recording.camera_positions is not None
    # moved by what the depth noise leaves of the table's tilt
    positions = [[0.0, -0.65, 0.47], [0.1, 0.65, 0.47]]
    np.testing.assert_allclose(recording.camera_positions, positions, atol=1e-3)
    assert recording.table_height == 0.0 and recording.gripper_source == "measured"
    for t, rope in enumerate(ropes):
        error = rope.distance(recording.frame(t).astype(float))
        # Half the pictures' size doubles the noise.
        assert abs(error.mean()) < 2e-3 and np.sqrt(np.mean(error**2)) < 6e-3
    seen_by = np.load(out)["seen_by"]
    assert seen_by is not None and len(seen_by) == len(recording.points)
    assert set(np.unique(seen_by)) == {1, 2, 3}


def in_picture(camera, points):
    """Columns and rows of points [n, 3] [m]."""
    T = camera.T_world_camera
    x = (points - T[:3, 3]) @ T[:3, :3]
    return (camera.K[k, k] * x[:, k] / x[:, 2] + camera.K[k, 2] for k in (0, 1))


@pytest.mark.parametrize("place", ["pick", "box"])
def test_colour_from_the_first_picture(world, lift, perceive, place):
    folder, ropes = lift
    u, v = in_picture(world.make_camera("left", scale=0.5), ropes[0].line)
    if place == "pick":
        words = ["--pick", "left", str(round(u[:2].mean())), str(round(v[:2].mean()))]
    else:
        corners = [u.min() - 5, v.min() - 5, u.max() + 5, v.max() + 5]
        words = ["--box", "left", *(str(round(c)) for c in corners)]
    code, _, out = perceive(folder, *words)
    assert code == 0
    points = Recording.read(out).frame(0)
    assert len(points) > 300 and np.abs(ropes[0].distance(points)).max() < 0.02


def test_a_box_is_compared_with_the_workspace_only(world, tmp_path, perceive):
    """Something large of the object's colour stands behind it, out of the robot's reach."""
    wall = world.Sphere((0.0, 2.0, 0.3), 1.0)
    camera = world.make_camera("left", scale=0.5)
    folder = tmp_path / "wall"
    ropes = world.write_lift(folder, frames=1, cameras=[camera], things=lambda t: [wall])
    u, v = in_picture(camera, ropes[0].line)
    corners = [u.min() - 5, v.min() - 5, u.max() + 5, v.max() + 5]
    code, printed, out = perceive(folder, "--box", "left", *(str(round(c)) for c in corners))
    assert code == 0, printed.err
    assert np.abs(ropes[0].distance(Recording.read(out).frame(0))).max() < 0.02


def test_json_has_all_frames(lift, perceive):
    code, printed, _ = perceive(lift[0], *RED, "--json")
    found = json.loads(printed.out)
    assert code == 0 and found["warnings"] == []
    assert len(found["points_by_frame"]) == found["frames"] == 6
    for row in found["points_by_frame"]:
        stages = [row[s] for s in ("depth", "workspace", "table", "colour", "voxels", "outliers")]
        assert stages == sorted(stages, reverse=True)
    assert found["seen_share"] > 0.8 and found["disagreement"] < 0.004


def test_one_camera(lift, perceive):
    code, printed, out = perceive(lift[0], *RED, "--cameras", "right")
    assert code == 0 and "points seen by: right 100 %" in printed.out
    cameras = Recording.read(out).camera_positions
    assert cameras is not None and len(cameras) == 1


def test_a_folder_is_a_source_of_frames(lift):
    source = PngCamera(lift[0] / "cameras" / "left")
    assert isinstance(source, FrameSource) and len(source) == 6
    pictures = list(source)[2].read()
    assert pictures.depth.shape == (240, 320) and pictures.depth.dtype == np.uint16
    assert pictures.colour is not None and pictures.colour.shape == (240, 320, 3)


def test_unknown_places(lift, perceive):
    refused(perceive(lift[0] / "x"), "no such folder")
    refused(perceive(lift[0], "--cameras", "top"), "no camera 'top'", "left, right")


def test_without_colour_pictures(copy, perceive):
    for name in ("left", "right"):
        path = copy / "cameras" / name / "frames.csv"
        lines = [line.rsplit(",", 1)[0] for line in path.read_text().splitlines()]
        path.write_text("\n".join(lines) + "\n")
    refused(perceive(copy, *RED), "has no colour pictures")
    shutil.rmtree(copy / "cameras" / "left" / "colour")
    assert perceive(copy)[0] == 0


@pytest.mark.parametrize("unit", [1.0, 1e-3, 5e-4, 2e-4, 1.25e-4, 5e-5, 1e-5])
def test_depth_in_the_wrong_unit(copy, perceive, unit):
    path = copy / "cameras" / "right" / "camera.toml"
    path.write_text(path.read_text().replace("depth_unit = 0.0001", f"depth_unit = {unit}"))
    refused(perceive(copy, *RED), "'right': depth_unit", "0.0001 seems right")


def test_missing_intrinsics(copy, perceive):
    path = copy / "cameras" / "left" / "camera.toml"
    text = path.read_text()
    path.write_text(text.replace("K = ", "P = "))
    refused(perceive(copy, *RED), "camera.toml: lacks K")
    path.unlink()
    refused(perceive(copy, *RED), "the intrinsics are unknown")


def test_uncalibrated_camera(copy, perceive):
    path = copy / "cameras" / "left" / "camera.toml"
    text = path.read_text()
    path.write_text(text[: text.index("T_world_camera")])
    refused(perceive(copy, *RED), "T_world_camera: is missing", "gendom calibrate")


@pytest.mark.parametrize(
    ("shift", "words"),
    [
        ((0, 0.025, 0), "apart"),
        ((0.03, 0, 0), "apart"),
        ((0, 0, 0.03), "table"),
        ((0, 0.01, 0), ""),
    ],
)
def test_cameras_that_disagree(world, tmp_path, perceive, shift, words):
    """Sideways shows in the object, upwards in the table; 1 cm is reported and let pass."""
    cameras = [
        world.make_camera("left", scale=0.5),
        world.make_camera("right", eye=(0.1, 0.65, 0.47), scale=0.5),
    ]
    T = cameras[1].T_world_camera.copy()
    T[:3, 3] += shift
    world.write_lift(
        tmp_path / "lift", cameras=cameras, stored=[cameras[0], cameras[1].at(T)], frames=5
    )
    result = perceive(tmp_path / "lift", *RED, "--json")
    if words:
        refused(result, words)
    else:
        found = json.loads(result[1].out)
        assert result[0] == 0 and found["disagreement"] == pytest.approx(0.01, abs=0.003)


def test_unsynchronised_cameras(world, tmp_path, perceive):
    world.write_lift(tmp_path / "a", frames=2, scale=0.25, time=lambda k, t: 5.0 * k + t / 30)
    refused(perceive(tmp_path / "a", *RED), "no frames of the cameras lie within", "one clock")


def test_robot_on_another_clock(copy, perceive):
    path = copy / "gripper.csv"
    path.write_text("time,x,y,z\n100,0,0,0.2\n101,0,0,0.3\n")
    refused(
        perceive(copy, *RED),
        "the robot's path is at other times, 100 to 101 s, than the cameras' frames (left 0 to",
        "one clock",
    )


def test_dropped_frames_are_told(copy, perceive):
    path = copy / "cameras" / "left" / "frames.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:3] + lines[4:]) + "\n")
    code, printed, out = perceive(copy, *RED)
    assert code == 0 and Recording.read(out).num_frames == 5
    assert "camera 'right': 1 of 6 frames match no frame" in printed.out


def with_other_pixels(png):
    """A PNG file that decodes to other pixels; only a chunk's checksum tells."""
    start = png.index(b"IDAT")
    pixels, end = b"", start - 4
    unpack = zlib.decompressobj()
    while png[end + 4 : end + 8] == b"IDAT":
        length = int.from_bytes(png[end : end + 4])
        pixels += unpack.decompress(png[end + 8 : end + 8 + length])
        checksum = png[end + 8 + length : end + 12 + length]
        end += 12 + length
    packed = zlib.compress(pixels[:-1] + bytes([pixels[-1] ^ 1]))
    return png[: start - 4] + len(packed).to_bytes(4) + b"IDAT" + packed + checksum + png[end:]


@pytest.mark.parametrize(
    ("kind", "damage"),
    [
        *(
            (kind, d)
            for kind in ("depth", "colour")
            for d in ("cut", "flip", "pixels", "text", "gone", "size")
        ),
        ("depth", "8 bit"),
    ],
)
def test_a_damaged_picture_in_the_middle(copy, perceive, damage, kind):
    """The five other frames are kept."""
    path = copy / "cameras" / "right" / kind / "000003.png"
    data = bytearray(path.read_bytes())
    if damage == "cut":
        path.write_bytes(data[: len(data) // 2])
    elif damage == "flip":
        data[len(data) // 2] ^= 0xFF
        path.write_bytes(data)
    elif damage == "pixels":
        path.write_bytes(with_other_pixels(data))
    elif damage == "text":
        path.write_text("not found")
    elif damage == "gone":
        path.unlink()
    elif damage == "size":
        Image.fromarray(np.zeros((10, 10), np.uint16)).save(path)
    else:
        Image.fromarray(np.zeros((240, 320), np.uint8)).save(path)
    code, printed, out = perceive(copy, *RED)
    assert code == 0
    assert f"{kind}/000003.png: 1 of 6 frames cannot be read" in printed.out
    np.testing.assert_allclose(Recording.read(out).time * 30, [0, 1, 2, 4, 5], atol=1e-9)


def test_a_truncated_recording(copy, perceive):
    """The disk was full: the last pictures are missing and the last row is half written."""
    for name in ("left", "right"):
        folder = copy / "cameras" / name
        text = (folder / "frames.csv").read_text()
        (folder / "frames.csv").write_text(text[:-20])
        (folder / "depth" / "000004.png").unlink()
    code, printed, out = perceive(copy, *RED)
    assert code == 0 and Recording.read(out).num_frames == 4
    assert "1 of 6 rows are cut short" in printed.out
    assert "1 of 5 frames cannot be read" in printed.out


def test_all_pictures_damaged(copy, perceive):
    for path in copy.glob("cameras/left/depth/*.png"):
        path.write_bytes(b"")
    refused(
        perceive(copy, *RED),
        "left/depth/000000.png: none of 6 frames can be read; the first: is damaged (no PNG); copy",
    )


def test_intrinsics_of_another_size(copy, perceive):
    """The message says what does not fit, and where."""
    path = copy / "cameras" / "left" / "camera.toml"
    path.write_text(path.read_text().replace("width = 320", "width = 640"))
    refused(perceive(copy, *RED), "000000.png", "is 320 x 240, camera.toml says 640 x 240")


def without_depth(path):
    """Empty a picture; the file stays one that can be read."""
    with Image.open(path) as picture:
        Image.fromarray(np.zeros_like(np.asarray(picture))).save(path)


def test_a_sensor_that_wakes_up_late(copy, perceive):
    """The first picture has no depth: only it is lost."""
    without_depth(copy / "cameras" / "right" / "depth" / "000000.png")
    code, printed, out = perceive(copy, *RED)
    assert code == 0 and Recording.read(out).num_frames == 5
    assert "depth/000000.png: 1 of 6 frames cannot be read" in printed.out
    assert "only 0 of 76800 pixels have depth" in printed.out


def test_a_sensor_that_never_wakes_up(copy, perceive):
    for path in copy.glob("cameras/right/depth/*.png"):
        without_depth(path)
    refused(perceive(copy, *RED), "none of 6 frames can be read", "0 of 76800 pixels have depth")


def test_a_camera_that_sees_nothing_is_told(copy, perceive):
    for path in copy.glob("cameras/right/colour/*.png"):
        without_depth(path)
    code, printed, _ = perceive(copy, *RED)
    assert code == 0
    assert "camera 'right': sees nothing of the object in any frame" in printed.out
    assert "camera 'left': sees nothing" not in printed.out


@pytest.mark.parametrize("end", [",0.23", ",-"])
def test_a_robot_s_path_that_was_cut_off(copy, perceive, end):
    """What the robot wrote until then is used."""
    path = copy / "gripper.csv"
    rows = path.read_text().splitlines()
    half = rows[5].rsplit(",", 2 if end == ",0.23" else 1)[0] + end
    path.write_text("\n".join([*rows[:5], half]))
    code, printed, out = perceive(copy, *RED)
    assert code == 0, printed.err
    assert Recording.read(out).num_frames == 4
    assert "gripper.csv, line 6: is cut short" in printed.out
    out.unlink()
    path.write_text("\n".join([*rows[:5], half, rows[6]]))
    refused(perceive(copy, *RED), "gripper.csv, line 6")


def test_joint_angles_that_were_cut_off(copy):
    path = copy / "joints.csv"
    rows = [f"{t / 30!r},0,0,0,0.4,0,0.4,0" for t in range(6)]
    path.write_text("\n".join(["time,q0,q1,q2,q3,q4,q5,q6", *rows])[:-5])
    warnings = []
    assert read_cameras(copy, on_warning=warnings.append).capsules is not None
    assert "joints.csv, line 7: is cut short" in str(warnings[0])


def test_no_object_in_view(world, tmp_path, perceive):
    world.write_lift(tmp_path / "empty", frames=2, rope=False, scale=0.25)
    refused(perceive(tmp_path / "empty", *RED), "no object in view", "'colour'", "2 frames")


def test_workspace_beside_the_scene(lift, perceive):
    words = ["--workspace", "5", "5", "0", "6", "6", "1"]
    refused(perceive(lift[0], *RED, *words), "sees nothing of the workspace", "T_world_camera")


def test_a_hidden_object_is_told(world, tmp_path, perceive):
    """A box in front of the lying part, one camera."""
    wall = world.Cylinder((-0.1, -0.2, 0.03), (0.5, -0.2, 0.03), 0.15)
    world.write_lift(
        tmp_path / "hidden",
        frames=3,
        cameras=[world.make_camera("left", scale=0.5)],
        things=lambda t: [wall],
    )
    code, printed, _ = perceive(tmp_path / "hidden", *RED)
    assert code == 0 and "of the object is seen; check workspace" in printed.out


def test_robot_in_view(world, tmp_path, perceive):
    """Without its capsules the arm is in the cloud, which is refused, with them it is not."""
    arm = world.Cylinder((-0.05, 0.0, 0.22), (-0.3, 0.0, 0.22), 0.012)
    folder = tmp_path / "robot"
    ropes = world.write_lift(folder, frames=3, things=lambda t: [arm])
    refused(perceive(folder), "times the object's own area")
    row = ",".join(str(x) for x in (*arm.start, *arm.end, arm.radius))
    (folder / "capsules.csv").write_text(f"time,capsule,x0,y0,z0,x1,y1,z1,radius\n0,arm,{row}\n")
    code, _, out = perceive(folder)
    assert code == 0
    standing = Recording.read(out).frame(0)
    standing = standing[standing[:, 2] > 0.03]
    assert ropes[0].distance(standing).max() < 0.03


@pytest.mark.parametrize(
    ("file", "text", "line"),
    [
        ("gripper.csv", "time,x,y,z\n1,0,0,0\n0,0,0,0\n", "times do not increase"),
        ("gripper.csv", "time,x,y,z\n", "no rows"),
        ("capsules.csv", "time,capsule\n", "header"),
        (
            "capsules.csv",
            "time,capsule,x0,y0,z0,x1,y1,z1,radius\n0,a,0,0,0,1,1,1,-1\n",
            "line 2: is no capsule",
        ),
        ("object.toml", "[object]\nkind = 'rope'\n", "the object's sizes are missing"),
        ("cameras/left/frames.csv", "t,d\n", "has the header"),
        ("cameras/left/frames.csv", "time,depth\nx,y\n", "no usable row"),
    ],
)
def test_bad_files(copy, perceive, file, text, line):
    (copy / file).write_text(text)
    refused(perceive(copy, *RED), line, file)


def test_bad_flags(lift, perceive):
    refused(perceive(lift[0], *RED, "--pick", "left", "1", "1"), "both given")
    refused(perceive(lift[0], "--colour", "300", "0", "0"), "0 to 255")
    refused(perceive(lift[0], "--pick", "left", "999", "1"), "pixel (999, 1)")
    refused(perceive(lift[0], "--pick", "top", "9", "1"), "no camera 'top'")
    refused(perceive(lift[0], "--voxel", "-1"), "voxel is -1")


def test_a_bad_name_is_told_before_the_work(tmp_path, capsys):
    words = ["perceive", str(tmp_path / "absent"), "--out", str(tmp_path / "a.txt")]
    assert cli.main(words) == 2
    assert "a.txt: does not end in .npz" in capsys.readouterr().err


# The same lift as RealSense recordings.


def to_realsense(folder, names=("left", "right"), shift=0.0, unit=1.0):
    """Turn cameras of a folder into .db3, with other time stamps [s] or depth units."""
    for name in names:
        place = folder / "cameras" / name
        source = PngCamera(place)
        camera = replace(source.camera, depth_unit=unit * source.camera.depth_unit)
        with recording(place.with_name("new"), camera) as write:
            for frame in source:
                write(frame.time + (shift if name == "right" else 0.0), frame.read())
        shutil.rmtree(place)
        place.with_name("new").rename(place)
    return folder


@pytest.mark.parametrize("names", [("left", "right"), ("right",)])
def test_realsense_recordings_give_the_same_clouds(lift, copy, sdk, perceive, names):
    _, _, out = perceive(lift[0], *RED)
    expected = Recording.read(out)
    code, printed, out = perceive(to_realsense(copy, names), *RED)
    assert code == 0 and "warning" not in printed.out
    found = Recording.read(out)
    np.testing.assert_allclose(found.time, expected.time, atol=1e-9)
    np.testing.assert_allclose(found.points, expected.points, atol=1e-6)


def test_unsynchronised_realsense_cameras(copy, sdk, perceive):
    refused(
        perceive(to_realsense(copy, shift=5.0), *RED),
        "no frames of the cameras lie within 0.02 s (left 0 to 0.166667 s, right 5 to",
        "one clock",
    )


def test_wrong_depth_unit_of_a_realsense_recording(copy, sdk, perceive):
    """The message gives the value that mends it in camera.toml."""
    to_realsense(copy, ("right",), unit=10.0)
    refused(perceive(copy, *RED), "'right': depth_unit", "it is 0.001 m a count; 0.0001 seems")
    with open(copy / "cameras" / "right" / "camera.toml", "a") as file:
        file.write("depth_unit = 0.0001\n")
    assert perceive(copy, *RED)[0] == 0


def test_uncalibrated_realsense_camera(copy, sdk, perceive):
    (to_realsense(copy) / "cameras" / "left" / "camera.toml").unlink()
    refused(perceive(copy, *RED), "left: T_world_camera: is missing", "gendom calibrate")


def test_truncated_realsense_recording(copy, sdk, perceive):
    """What comes before the cut is kept."""
    path = to_realsense(copy) / "cameras" / "right" / "recording.db3"
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    code, printed, out = perceive(copy, *RED)
    assert code == 0 and 2 <= Recording.read(out).num_frames <= 4
    assert "recording.db3: is damaged or cut off" in printed.out


def test_a_realsense_recording_cut_off_at_its_start(copy, sdk, perceive):
    """Not even its intrinsics are left."""
    path = to_realsense(copy) / "cameras" / "right" / "recording.db3"
    path.write_bytes(path.read_bytes()[:20_000])
    refused(perceive(copy, *RED), "right/recording.db3", "is missing or damaged (no message of it")


def test_damage_inside_a_realsense_recording(copy, sdk, perceive):
    """One frame is lost, and told by its number."""
    path = to_realsense(copy) / "cameras" / "right" / "recording.db3"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    code, printed, out = perceive(copy, *RED)
    assert code == 0 and Recording.read(out).num_frames == 5
    assert "recording.db3: frame " in printed.out and "1 of 6 frames cannot be read" in printed.out
