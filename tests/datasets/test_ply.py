"""PLY: three encodings, foreign properties skipped."""

import resource
import struct
import time

import numpy as np
import pytest

from gendom.datasets import read_ply, write_ply
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


@pytest.mark.parametrize(("name", "order"), [("little", "<"), ("big", ">")])
def test_lengths_of_lists_have_the_order_of_the_file(tmp_path, name, order):
    lines = [line.replace("uchar", "ushort") for line in LIST_IN_VERTEX]
    data = struct.pack(f"{order}fHffff", 3, 2, 0.5, 0.5, 2, 1)
    data += struct.pack(f"{order}fHff", 6, 0, 5, 4)
    (tmp_path / "a.ply").write_bytes(header(f"binary_{name}_endian", *lines) + data)
    np.testing.assert_array_equal(read_ply(tmp_path / "a.ply"), [[1, 2, 3], [4, 5, 6]])


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
    "no z": (header("ascii", *XYZ[:3]), "has 0 fields 'z'"),
    "odd type": (header("ascii", *XYZ, "property half w"), "'property half w'"),
    "odd list": (header("ascii", *XYZ, "property list half int v"), "'property list half int v'"),
    "odd words": (header("ascii", *XYZ, "property of uchar int v"), "'property of uchar int v'"),
    "long header": (header("ascii", "comment " + "x" * 66_000, *XYZ), "has no end_header"),
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


def test_capital_letters_and_comments_in_any_encoding(tmp_path):
    """Bytes that other encodings take as the end of a line (NEL, FF) end none."""
    lines = ["comment \u00c5ngstr\u00f6m", "comment \x0b\x0c", *XYZ]
    text = "\n".join(["ply", "format ascii 1.0", *lines, "end_header", ""])
    for encoding in ("utf-8", "latin-1"):
        (tmp_path / "a.ply").write_bytes(text.encode(encoding) + b"1 2 3 4 5 6")
        assert read_ply(tmp_path / "a.ply").tolist() == [[1, 2, 3], [4, 5, 6]]
    (tmp_path / "a.ply").write_bytes(header("ascii", *XYZ).upper() + b"1 2 3 4 5 6")
    assert read_ply(tmp_path / "a.ply").tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize("nan", ["nan", "-nan(ind)", "NaN", "-1.#IND", "1.#QNAN0", "nan(0x1)"])
def test_points_that_were_not_seen_are_left_out(tmp_path, nan):
    data = header("ascii", *XYZ) + f"{nan} {nan} {nan}\n1 2 3".encode()
    (tmp_path / "a.ply").write_bytes(data)
    assert read_ply(tmp_path / "a.ply").tolist() == [[1, 2, 3]]
    data = header("binary_big_endian", *XYZ) + struct.pack(">6f", *[np.nan] * 3, 1, 2, 3)
    (tmp_path / "a.ply").write_bytes(data)
    assert read_ply(tmp_path / "a.ply").tolist() == [[1, 2, 3]]


TYPES = {
    **{"char": "b", "short": "h", "int": "i", "long": "q", "float": "f", "double": "d"},
    **{"uchar": "B", "ushort": "H", "uint": "I", "ulong": "Q", "bool": "B"},
    **{"int8": "b", "int16": "h", "int32": "i", "int64": "q", "float32": "f", "float64": "d"},
    **{"uint8": "B", "uint16": "H", "uint32": "I", "uint64": "Q"},
}


@pytest.mark.parametrize("name", TYPES)
def test_numbers_of_every_type(tmp_path, name):
    lines = ["element vertex 2", *(f"property {name} {axis}" for axis in "xyz")]
    values = [1, 2, 3, 4, 5, 100 if TYPES[name].isupper() else -100]
    for order, encoding in (("<", "binary_little_endian"), (">", "binary_big_endian")):
        data = struct.pack(order + 6 * TYPES[name], *values)
        (tmp_path / "a.ply").write_bytes(header(encoding, *lines) + data)
        assert read_ply(tmp_path / "a.ply").ravel().tolist() == values


def test_a_header_may_be_long(tmp_path):
    (tmp_path / "a.ply").write_bytes(
        header("ascii", "comment " + "x" * 65_000, *XYZ) + b"1 2 3 " * 2
    )
    assert read_ply(tmp_path / "a.ply").tolist() == [[1, 2, 3]] * 2


def test_bool_and_64_bit_properties(tmp_path):
    extra = ["property bool seen", "property uint64 stamp", "property long row"]
    data = struct.pack("<fff?Qq", 1, 2, 3, True, 2**60, -1) * 2
    (tmp_path / "a.ply").write_bytes(header("binary_little_endian", *XYZ, *extra) + data)
    assert read_ply(tmp_path / "a.ply").tolist() == [[1, 2, 3]] * 2


BOMBS = {
    "a long token": header("ascii", *XYZ) + b"1" * (8 << 20),
    "a word of odd numbers": header("ascii", *XYZ) + b"nan(1)." * (1 << 22),
    "many numbers": header("ascii", "element vertex 1100000", *XYZ[1:]) + b"0 0 0\n" * 1_100_000,
    "much text": header("ascii", *XYZ) + b"1 2 3" + b" " * (33 << 20),
    "many points": header("ascii", "element vertex 99999999999", *XYZ[1:]) + b"1 2 3",
    "rows of nothing": header("ascii", "element a 9" + "9" * 4000, *XYZ) + b"1 2 3 4 5 6",
    "rows of lists": header(
        "binary_little_endian", "element a 4000000", "property list uchar char b", *XYZ
    )
    + bytes(4 << 20),
    "a list without end": header("ascii", "element a 1", "property list int int b", *XYZ)
    + b"999999999 1",
}


@pytest.mark.parametrize("case", BOMBS)
def test_bombs_are_refused_at_once(tmp_path, case):
    (tmp_path / "a.ply").write_bytes(BOMBS[case])
    before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    with pytest.raises(RecordingError) as caught:
        read_ply(tmp_path / "a.ply")
    assert len(str(caught.value)) < 500
    assert time.process_time() - began < 1.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100e3  # [KiB]
