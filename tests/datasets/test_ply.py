"""PLY: three encodings, foreign properties skipped, and recordings kept as folders."""

import struct

import numpy as np
import pytest

from gendom.datasets import Recording, read_ply, write_ply
from gendom.errors import RecordingError

POINTS = np.array([[0.1, -2.0, 3.5], [1e-7, 0.0, -0.25]])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("text", [False, True])
def test_round_trip_is_exact(tmp_path, dtype, text):
    points = np.random.default_rng(0).normal(size=(50, 3)).astype(dtype)
    write_ply(tmp_path / "a.ply", points, text=text)
    again = read_ply(tmp_path / "a.ply")
    assert again.dtype == dtype
    np.testing.assert_array_equal(again, points)


@pytest.mark.parametrize("text", [False, True])
def test_no_points(tmp_path, text):
    write_ply(tmp_path / "a.ply", np.zeros((0, 3)), text=text)
    assert read_ply(tmp_path / "a.ply").shape == (0, 3)


XYZ = ["element vertex 2", *(f"property float {axis}" for axis in "xyz")]


def header(encoding, *lines):
    text = "\n".join(["ply", f"format {encoding} 1.0", "comment by a test", *lines, "end_header"])
    return text.encode() + b"\n"


# A list element before the vertices, vertex properties before, between and after x, y, z.
FOREIGN = [
    "element camera 2",
    "property list uchar int ids",
    "property float gain",
    "element vertex 2",
    "property uchar red",
    "property double x",
    "property double y",
    "property float confidence",
    "property double z",
    "element face 1",
    "property list uchar int vertex_indices",
]


@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_with_foreign_properties(tmp_path, order):
    name = "binary_little_endian" if order == "<" else "binary_big_endian"
    data = struct.pack(order + "B3if", 3, 7, 8, 9, 0.5) + struct.pack(order + "Bf", 0, 0.5)
    for x, y, z in POINTS:
        data += struct.pack(order + "Bddfd", 255, x, y, 0.9, z)
    data += struct.pack(order + "B3i", 3, 0, 1, 1)
    (tmp_path / "a.ply").write_bytes(header(name, *FOREIGN) + data)
    np.testing.assert_array_equal(read_ply(tmp_path / "a.ply"), POINTS)


def test_ascii_with_foreign_properties(tmp_path):
    rows = ["3 7 8 9 0.5", "0 0.5"]
    rows += [f"255 {x} {y} 0.9 {z}" for x, y, z in POINTS.tolist()]
    rows += ["3 0 1 1"]
    data = "\r\n".join(rows).encode()
    (tmp_path / "a.ply").write_bytes(header("ascii", *FOREIGN) + data)
    np.testing.assert_array_equal(read_ply(tmp_path / "a.ply"), POINTS)


LIST_IN_VERTEX = [
    "element vertex 2",
    "property float z",
    "property list uchar float weights",
    "property float y",
    "property float x",
]


def test_list_among_the_vertex_properties(tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes(header("ascii", *LIST_IN_VERTEX) + b"3 2 0.5 0.5 2 1\n6 0 5 4\n")
    np.testing.assert_array_equal(read_ply(path), [[1, 2, 3], [4, 5, 6]])
    data = struct.pack("<fBffff", 3, 2, 0.5, 0.5, 2, 1) + struct.pack("<fBff", 6, 0, 5, 4)
    path.write_bytes(header("binary_little_endian", *LIST_IN_VERTEX) + data)
    np.testing.assert_array_equal(read_ply(path), [[1, 2, 3], [4, 5, 6]])
    assert read_ply(path).dtype == np.float32


def test_long_ascii_numbers(tmp_path):
    """More digits than a double holds, in one of them."""
    data = b"1 2 3\n4 5 6" + b"0" * 40 + b"e-40"
    (tmp_path / "a.ply").write_bytes(header("ascii", *XYZ) + data)
    assert read_ply(tmp_path / "a.ply").tolist() == [[1, 2, 3], [4, 5, 6]]


def test_windows_line_ends_and_integers(tmp_path):
    lines = ["element vertex 1", *(f"property int {axis}" for axis in "xyz")]
    data = header("ascii", *lines).replace(b"\n", b"\r\n") + b"1 2 3\r\n"
    (tmp_path / "a.ply").write_bytes(data)
    assert read_ply(tmp_path / "a.ply").tolist() == [[1.0, 2.0, 3.0]]


BAD_FILES = {
    "not PLY": (b"solid cube\n", "does not begin with the line 'ply'"),
    "no end of header": (b"ply\nformat ascii 1.0\n", "has no end_header"),
    "odd format": (header("ebcdic", *XYZ), "has the format 'ebcdic'"),
    "no vertices": (header("ascii", "element face 0"), "has no element 'vertex'"),
    "no z": (header("ascii", *XYZ[:3]), "has 0 vertex properties 'z'"),
    "odd type": (header("ascii", *XYZ, "property half w"), "'property half w'"),
    "short ascii": (header("ascii", *XYZ) + b"1 2 3 4", "cut short: 4 numbers"),
    "short binary": (header("binary_big_endian", *XYZ) + bytes(20), "is cut short"),
    "a word": (header("ascii", *XYZ) + b"1 2 3 4 five 6", "a coordinate that is no number"),
    "short list": (
        header("binary_little_endian", *LIST_IN_VERTEX) + struct.pack("<fB", 1.0, 200),
        "is cut short",
    ),
    "absurd count": (
        header("binary_little_endian", "element vertex 99999999999999", *LIST_IN_VERTEX[1:]),
        "is cut short",
    ),
    "negative list": (
        header("ascii", *LIST_IN_VERTEX) + b"3 -2 2 1",
        "as the length of the list 'weights'",
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files(tmp_path, case):
    data, message = BAD_FILES[case]
    path = tmp_path / "a.ply"
    path.write_bytes(data)
    with pytest.raises(RecordingError) as caught:
        read_ply(path)
    assert str(caught.value).startswith(f"{path}: ") and message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_write_refuses_other_shapes(tmp_path):
    with pytest.raises(RecordingError, match=r"shape \(3,\); give \[n, 3\]"):
        write_ply(tmp_path / "a.ply", np.zeros(3))


@pytest.fixture
def folder(lift, tmp_path):
    """The lift as a folder, with file names whose natural order is not the alphabetical one."""
    folder = tmp_path / "take"
    folder.mkdir()
    for t in range(5):
        write_ply(folder / f"frame_{8 + t}.ply", lift.frame(t))
    rows = ["time,x,y,z,ax,ay,az"]
    for t in range(5):
        values = [lift.time[t], *lift.gripper_position[t, 0], *lift.gripper_axis[t, 0]]
        rows.append(",".join(map(repr, map(float, values))))
    (folder / "gripper.csv").write_text("\n".join(rows) + "\n")
    (folder / "object.toml").write_text(
        'table_height = 0.0\noperator = "nobody"\n'
        '[object]\nkind = "rope"\nlength = 0.4\nmass = 0.02\ngrasp = "end"\n'
    )
    return folder


def test_folder_equals_the_recording(lift, folder):
    recording = Recording.read(folder)
    for name in ("points", "offsets", "time", "gripper_position", "gripper_axis"):
        np.testing.assert_array_equal(getattr(recording, name), getattr(lift, name))
    assert (recording.object.length, recording.object.mass) == (0.4, 0.02)
    assert recording.table_height == 0.0 and not recording.quasi_static
    assert recording.extra == {"operator": "nobody"}


def test_keys_below_the_table_count_too(folder):
    """TOML gives every key below [object] to that table."""
    path = folder / "object.toml"
    path.write_text(
        '[object]\nkind = "rope"\nlength = 0.4\ntable_height = -0.1\nquasi_static = true'
    )
    recording = Recording.read(folder)
    assert recording.table_height == -0.1 and recording.quasi_static
    assert recording.object.extra == {}


def test_two_grippers(folder):
    rows = ["time,x0,y0,z0,x1,y1,z1"]
    rows += [f"{0.1 * t},0.4,0,{0.01 * t},0,0,0" for t in range(5)]
    (folder / "gripper.csv").write_text("\n".join(rows))
    recording = Recording.read(folder)
    assert recording.gripper_position.shape == (5, 2, 3) and recording.gripper_axis is None
    assert recording.gripper_position[4].tolist() == [[0.4, 0.0, 0.04], [0.0, 0.0, 0.0]]


def test_when_the_gripper_is_closed(folder):
    add_closed(1, 1, 1, 0, 0)(folder)
    recording = Recording.read(folder)
    assert recording.gripper_axis is not None and recording.gripper_closed is not None
    assert recording.gripper_closed[:, 0].tolist() == [True, True, True, False, False]


def test_when_each_of_two_grippers_is_closed(folder):
    rows = ["time,x0,y0,z0,x1,y1,z1,closed0,closed1"]
    rows += [f"{0.1 * t},0.4,0,{0.01 * t},0,0,0,1,{int(t < 2)}" for t in range(5)]
    (folder / "gripper.csv").write_text("\n".join(rows))
    recording = Recording.read(folder)
    assert recording.gripper_closed is not None
    assert recording.gripper_closed.T.tolist() == [[True] * 5, [True, True, False, False, False]]


def test_missing_table_height_is_a_warning(folder):
    (folder / "object.toml").write_text('[object]\nkind = "rope"\nlength = 0.4\n')
    faults = []
    assert Recording.read(folder, on_warning=faults.append).table_height is None
    assert [fault.where for fault in faults] == ["table_height"]


def rewrite(name, old, new):
    def spoil(folder):
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return spoil


def add_closed(*states):
    """Add the column `closed`."""

    def add(folder):
        path = folder / "gripper.csv"
        rows = zip(path.read_text().splitlines(), ("closed", *states), strict=True)
        path.write_text("\n".join(f"{row},{state}" for row, state in rows) + "\n")

    return add


BAD_FOLDERS = {
    "no clouds": (
        lambda f: [p.unlink() for p in f.glob("*.ply")],
        "{}: holds no .ply file; put one PLY point cloud a frame there",
    ),
    "a cloud less": (
        lambda f: (f / "frame_9.ply").unlink(),
        "{}: 4 .ply files but 5 rows in gripper.csv; give one row a frame",
    ),
    "no gripper.csv": (
        lambda f: (f / "gripper.csv").unlink(),
        "{}/gripper.csv: no such file; write one row a frame under time,x,y,z",
    ),
    "no object.toml": (lambda f: (f / "object.toml").unlink(), "{}/object.toml: no such file; "),
    "not TOML": (rewrite("object.toml", "kind =", "kind"), "{}/object.toml: is not TOML ("),
    "no length": (
        rewrite("object.toml", "length = 0.4", ""),
        "{}: object.length: is missing for a rope; measure it and give metres",
    ),
    "a word for a number": (
        rewrite("gripper.csv", "0.01", "high"),
        "{}/gripper.csv, line 3, column z: 'high' is no number; give seconds and metres",
    ),
    "a value too few": (
        rewrite("gripper.csv", "0.01,", ""),
        "{}/gripper.csv, line 3: 6 values under 7 column names; give one value a column",
    ),
    "no time column": (
        rewrite("gripper.csv", "time", "seconds"),
        "{}/gripper.csv: the header lacks 'time'; use time,x,y,z[,ax,ay,az][,closed], or",
    ),
    "half an axis": (
        rewrite("gripper.csv", "ax,ay,az", "ax,ay,bz"),
        "{}/gripper.csv: the header lacks 'az'; ",
    ),
    "a strange column": (
        rewrite("gripper.csv", "ax,ay,az", "force,,torque"),
        "{}/gripper.csv: the header has unknown 'force', '', 'torque'; ",
    ),
    "half closed": (
        add_closed(1, 1, 0.5, 0, 0),
        "{}/gripper.csv, line 4, column closed: is '0.5'; "
        "give 1 where the gripper is closed, 0 where it is open",
    ),
    "one of two grippers closed": (
        lambda f: (f / "gripper.csv").write_text("time,x0,y0,z0,x1,y1,z1,closed0\n0,0,0,0,0,0,0,1"),
        "{}/gripper.csv: the header lacks 'closed1'; use time,x,y,z[,ax,ay,az][,closed], or",
    ),
    "empty gripper.csv": (
        lambda f: (f / "gripper.csv").write_text(""),
        "{}/gripper.csv: is empty; write the header time,x,y,z",
    ),
    "a broken cloud": (
        lambda f: (f / "frame_10.ply").write_bytes(b"no"),
        "{}/frame_10.ply: is not a PLY file",
    ),
}


@pytest.mark.parametrize("case", BAD_FOLDERS)
def test_bad_folders(folder, case):
    spoil, message = BAD_FOLDERS[case]
    spoil(folder)
    with pytest.raises(RecordingError) as caught:
        Recording.read(folder)
    assert str(caught.value).startswith(message.format(folder))
    assert "\n" not in str(caught.value)


def test_a_gripper_table_without_rows(folder):
    (folder / "gripper.csv").write_text("time,x,y,z\n")
    with pytest.raises(RecordingError, match="no rows"):
        Recording.read(folder)
