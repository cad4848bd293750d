"""`gendom perceive`: a recording comes of it, and bad input gives one line."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image

from gendom import cli
from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.perception import PngCamera, read_camera, write_camera

RED = ["--colour", "180", "30", "35"]
RIGHT = "cameras/right/camera.toml"


@pytest.fixture(scope="module")
def lift(world, tmp_path_factory):
    """A good recording and the ropes in it."""
    folder = tmp_path_factory.mktemp("good") / "lift"
    return folder, world.write_lift(folder, frames=5)


@pytest.fixture
def copy(lift, tmp_path):
    """A copy to spoil."""
    return shutil.copytree(lift[0], tmp_path / "lift")


def refused(result, *parts):
    code, printed, out = result
    assert code == 2 and not out.exists()
    assert len(printed.err.splitlines()) == 1, printed.err
    for part in parts:
        assert part in printed.err


def test_recording_of_a_rope(lift, command):
    folder, ropes = lift
    code, printed, out = command(folder, *RED)
    assert code == 0 and printed.err == "" and "warning" not in printed.out
    assert "levelled by the table: left " in printed.out and "; right " in printed.out
    recording = Recording.read(out)
    np.testing.assert_allclose(recording.time, np.arange(5) / 30)
    np.testing.assert_allclose(recording.gripper_position[:, 0, 2], 0.2 + 0.01 * np.arange(5))
    # moved by what the depth noise leaves of the table's tilt
    positions = [[0.0, -0.65, 0.47], [0.1, 0.65, 0.47]]
    assert recording.camera_positions == pytest.approx(np.array(positions), abs=1e-3)
    assert recording.table_height == 0.0 and recording.gripper_source == "measured"
    for t, rope in enumerate(ropes):
        error = rope.distance(recording.frame(t).astype(float))
        # Half the pictures' size doubles the noise.
        assert abs(error.mean()) < 2e-3 and np.sqrt(np.mean(error**2)) < 6e-3
        assert len(error) > 300 and np.abs(error).max() < 0.02
    seen_by = np.load(out)["seen_by"]
    assert len(seen_by) == len(recording.points) and set(np.unique(seen_by)) == {1, 2, 3}


def test_one_camera_and_json_that_has_all_frames(lift, command):
    code, printed, out = command(lift[0], *RED, "--cameras", "right", "--json")
    found = json.loads(printed.out)
    assert code == 0 and found["warnings"] == [] and found["disagreement"] is None
    positions = Recording.read(out).camera_positions
    assert positions is not None and positions.shape == (1, 3)
    assert len(found["points_by_frame"]) == found["frames"] == 5 and found["seen_share"] > 0.8
    for row in found["points_by_frame"]:
        stages = [row[s] for s in ("depth", "workspace", "table", "colour", "voxels", "outliers")]
        assert stages == sorted(stages, reverse=True)


@pytest.mark.parametrize(
    ("shift", "words"),
    [((0.03, 0, 0), "apart"), ((0, 0, 0.03), "table"), ((0, 0.008, 6e-3), "")],
)  # fmt: skip
def test_cameras_that_disagree(copy, command, shift, words):
    """Sideways shows in the object, upwards in the table; 1 cm is reported and let pass."""
    camera = read_camera(copy / RIGHT)
    T = camera.calibrated().copy()
    T[:3, 3] += shift
    write_camera(copy / RIGHT, camera.at(T))
    code, printed, out = command(copy, *RED, "--json")
    if words:
        return refused((code, printed, out), words)
    recording = Recording.read(out)
    apart = recording.extra["perception"]["cameras_apart"]
    assert code == 0 and apart["table"] == pytest.approx(0.006, abs=0.001)
    assert 0.005 < apart["at_rest"] < 0.011
    found = json.loads(printed.out)["disagreement"]
    assert recording.cameras_apart == apart["at_worst"] == found


def text(file, change):
    """A function that changes the text of a folder's file."""
    return lambda folder: (folder / file).write_text(change((folder / file).read_text()))


def edit(file, old, new):
    def change(content):
        assert old in content
        return content.replace(old, new)

    return text(file, change)


def put(file, content):
    return lambda folder: (folder / file).write_text(content)


def empty(pattern, rows=slice(None)):
    """Zero rows of pictures; the files stay ones that can be read."""

    def change(folder):
        for path in folder.glob(pattern):
            with Image.open(path) as picture:
                pixels = np.array(picture)
            pixels[rows] = 0
            Image.fromarray(pixels).save(path)

    return change


def without_colour(folder):
    for path in folder.glob("cameras/*/frames.csv"):
        lines = [line.rsplit(",", 1)[0] for line in path.read_text().splitlines()]
        path.write_text("\n".join(lines) + "\n")


def late(content):
    head, *rows = content.splitlines()
    return "\n".join([head, *(f"{5.0 + k},{r.split(',', 1)[1]}" for k, r in enumerate(rows)), ""])


LEFT_FRAMES, PATH, ROWS = "cameras/left/frames.csv", "gripper.csv", "time,x,y,z\n"
REFUSED = [
    *(
        (edit(RIGHT, "= 0.0001", f"= {unit}"), "'right': depth_unit | 0.0001 seems right")
        for unit in (1.0, 1e-3, 1.25e-4, 1e-5)
    ),
    (edit(RIGHT, "K = ", "P = "), "camera.toml: lacks K"),
    (lambda folder: (folder / RIGHT).unlink(), "the intrinsics are unknown"),
    (edit(RIGHT, "320", "640"), "000000.png: none of 5 | is 320 x 240, the camera 640 x 240"),
    (text(RIGHT, lambda s: s[: s.index("T_w")]), "T_world_camera: is missing | gendom calibrate"),
    (text("cameras/right/frames.csv", late), "within 0.02 s (left 0 to 0.133333 s, right 5 | one "),
    (put(PATH, f"{ROWS}100,0,0,0.2\n101,0,0,0.3\n"), "path is at other times, 100 to 101 s, than"),
    (put(PATH, f"{ROWS}1,0,0,0\n0,0,0,0\n"), "gripper.csv: its times do not increase"),
    (without_colour, "has no colour pictures"),
    (
        lambda folder: [p.write_bytes(b"") for p in folder.glob("cameras/left/depth/*")],
        "0000.png: none of 5 frames can be read; the first: is damaged (no PNG); copy",
    ),
    (empty("cameras/right/depth/*"), "none of 5 frames can | 0 of 76800 pixels have depth"),
    (
        put("object.toml", "[object]\nkind = 'rope'\n"),
        "object.toml: the object's sizes are missing",
    ),
    (put(LEFT_FRAMES, "t,d\n"), "frames.csv: has the header"),
    (put(LEFT_FRAMES, "time,depth\nx,y\n"), "frames.csv: holds no usable row"),
]


@pytest.mark.parametrize(("spoil", "said"), REFUSED)
def test_what_is_refused(copy, command, spoil, said):
    spoil(copy)
    refused(command(copy, *RED), *said.split(" | "))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--cameras top", "no camera 'top' | left, right"),
        ("--colour 9 9 9 --workspace 5 5 0 6 6 1", "sees nothing of the workspace, (5, 5, 0) to"),
        ("--colour 0 255 0", "no object in view | 'colour' | 5 frames"),
    ],
)
def test_flags_that_are_refused(lift, command, words, said):
    refused(command(lift[0], *words.split()), *said.split(" | "))


def test_places_that_are_none(tmp_path, command, capsys):
    refused(command(tmp_path / "x"), "no such folder")
    (tmp_path / "y").write_text("")
    refused(command(tmp_path / "y"), f"y: is no folder; gendom doctor {tmp_path / 'y'} says what")
    assert cli.main(["perceive", str(tmp_path / "x"), "--out", str(tmp_path / "a.txt")]) == 2
    assert "a.txt: does not end in .npz" in capsys.readouterr().err


def cut_frames(folder):
    """The disk was full: the last pictures are missing and the last row is half written."""
    for place in (folder / "cameras" / "left", folder / "cameras" / "right"):
        (place / "frames.csv").write_text((place / "frames.csv").read_text()[:-20])
        (place / "depth" / "000003.png").unlink()


ALL, ZERO = [0, 1, 2, 3, 4], "000000.png: 1 of 5 frames cannot be read and are left out; the fir"
LEFT_OUT = [
    (edit("object.toml", "length = 0.4", "length = 0.34"), ALL,
     "beyond a line of 0.34 m and are left out; check the stated length"),
    (text(LEFT_FRAMES, lambda s: "\n".join(s.split("\n")[:-2])), ALL[:4], "1 of 5 frames match no"),
    (cut_frames, ALL[:3], "1 of 5 rows are cut short | 000003.png: 1 of 4 frames cannot"),
    (empty("cameras/right/depth/000000.png"), ALL[1:], f"{ZERO} | only 0 of 76800"),
    (empty("cameras/right/colour/*"), ALL, "'right': sees nothing of the object in any frame"),
    (empty("cameras/*/colour/*", slice(95, 240)), ALL, "of the object is seen; che"),
    (text(PATH, lambda s: s[: s.index("0.24")] + "-"), ALL[:4],
     "gripper.csv, line 6: is cut short | 1 of 5 frames are outside"),
]  # fmt: skip


@pytest.mark.parametrize(("spoil", "kept", "said"), LEFT_OUT)
def test_what_is_left_out_is_told(copy, command, spoil, kept, said):
    spoil(copy)
    code, printed, out = command(copy, *RED)
    assert code == 0, printed.err
    np.testing.assert_allclose(Recording.read(out).time * 30, kept, atol=1e-9)
    assert all(part in printed.out for part in said.split(" | ")), printed.out


def test_damaged_pictures(copy):
    """One frame cannot be read, others can: of pixels that their checksum belies, and of 8 bits."""
    path = copy / "cameras" / "right" / "depth" / "000003.png"
    data = bytearray(path.read_bytes())
    data[data.rindex(b"IEND") - 5] ^= 0xFF
    for spoil in (lambda: path.write_bytes(data), lambda: Image.new("L", (320, 240)).save(path)):
        spoil()
        frames = list(PngCamera(copy / "cameras" / "right"))
        assert frames[2].read().depth.shape == (240, 320)
        with pytest.raises(RecordingError, match=r"depth/000003\.png: "):
            frames[3].read()
