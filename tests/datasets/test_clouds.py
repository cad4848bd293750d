"""Clouds as PLY, PCD and NumPy files: every encoding, foreign fields skipped, bombs refused."""

import resource
import struct
import time
import zipfile

import numpy as np
import pytest

from gendom import reading
from gendom.datasets import read_pcd, read_ply
from gendom.datasets.npz import read_npz_cloud
from gendom.errors import RecordingError
from written import write_ply

CLOUD = np.array([[0.1, -2.0, 3.5], [1e-7, 0.0, -0.25], [4.0, 5.0, 6.0]])


def refusal(read, path, data):
    """The one line that a reader says of bytes, after the file's name."""
    path.write_bytes(data)
    with pytest.raises(RecordingError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)
    return str(caught.value)[len(f"{path}: ") :]


# ---- PLY -----------------------------------------------------------------------------------------

XYZ = ["element vertex 2", *(f"property float {axis}" for axis in "xyz")]
# An element before the vertices, vertex properties before, between and after x, y, z, lists behind.
FOREIGN = [
    "element camera 2", "property short id", "property float gain",
    "element vertex 3", "property bool red", "property double x", "property double y",
    "property uint64 confidence", "property double z",
    "element face 1", "property list uchar int vertex_indices",
]  # fmt: skip


def ply(encoding, *lines):
    text = "\n".join(["ply", f"format {encoding} 1.0", "comment by a test", *lines, "end_header"])
    return text.encode() + b"\n"


def read_as_ply(tmp_path, data):
    (tmp_path / "a.ply").write_bytes(data)
    return read_ply(tmp_path / "a.ply").tolist()


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize(("dtype", "count"), [(np.float32, 50), (np.float64, 50), (np.float32, 0)])
def test_reading_is_exact(tmp_path, dtype, count, text):
    points = np.random.default_rng(0).normal(size=(count, 3)).astype(dtype)
    write_ply(tmp_path / "a.ply", points, text=text)
    again = read_ply(tmp_path / "a.ply")
    assert again.dtype == dtype
    np.testing.assert_array_equal(again, points)


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_foreign_properties_are_skipped(tmp_path, encoding):
    rows = [(7, 0.5), (8, 0.25)]
    if encoding == "ascii":
        lines = [*rows, *((1, x, y, 9, z) for x, y, z in CLOUD.tolist()), (3, 0, 1, 1)]
        data = "\r\n".join(" ".join(map(str, line)) for line in lines).encode()
    else:
        order = "<" if "little" in encoding else ">"
        data = b"".join(struct.pack(f"{order}hf", *row) for row in rows)
        data += b"".join(struct.pack(f"{order}?ddQd", True, x, y, 2**60, z) for x, y, z in CLOUD)
        data += struct.pack(f"{order}B3i", 3, 0, 1, 1)
    assert read_as_ply(tmp_path, ply(encoding, *FOREIGN) + data) == CLOUD.tolist()


@pytest.mark.parametrize(
    "data",
    [
        ply("ascii", *XYZ) + b"1 2 3\n4 5 6" + b"0" * 40 + b"e-40",  # more than a double holds
        ply("ascii", "comment " + "x" * 65_000, *XYZ) + b"1 2 3 4 5 6",
        ply("ascii", *(x.replace("float", "int") for x in XYZ)).replace(b"\n", b"\r\n")
        + b"1 2 3\r\n4 5 6\r\n",
        ply("ascii", *XYZ).upper() + b"1 2 3 4 5 6",
        ply("ascii", "comment \u00c5ngstr\u00f6m \x0b\x0c \u0085", *XYZ) + b"1 2 3 4 5 6",
        ply("ascii", "obj_info", *XYZ).replace(b"_info", b"_info \xc5\x85") + b"1 2 3 4 5 6",
    ],
    ids=["long numbers", "long header", "windows, integers", "capitals", "utf-8", "latin-1"],
)
def test_dialects(tmp_path, data):
    """Bytes that other encodings take as the end of a line (NEL, FF) end none."""
    assert read_as_ply(tmp_path, data) == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize("nan", ["nan", "-nan(ind)", "NaN", "-1.#IND", "1.#QNAN0", "nan(0x1)"])
def test_points_that_were_not_seen_are_left_out(tmp_path, nan):
    data = ply("ascii", *XYZ) + f"{nan} {nan} {nan}\n1 2 3".encode()
    assert read_as_ply(tmp_path, data) == [[1, 2, 3]]
    data = ply("binary_big_endian", *XYZ) + struct.pack(">6f", *[np.nan] * 3, 1, 2, 3)
    assert read_as_ply(tmp_path, data) == [[1, 2, 3]]


TYPES = dict(zip(["char", "short", "int", "long", "float", "double"], "bhiqfd", strict=True))
TYPES |= dict(zip(["uchar", "ushort", "uint", "ulong", "bool"], "BHIQB", strict=True))
TYPES |= {f"int{8 * n}": "bhiq"[k] for k, n in enumerate((1, 2, 4, 8))}
TYPES |= {f"uint{8 * n}": "BHIQ"[k] for k, n in enumerate((1, 2, 4, 8))}
TYPES |= {"float32": "f", "float64": "d"}


def test_numbers_of_every_type(tmp_path):
    for name, code in TYPES.items():
        lines = ["element vertex 2", *(f"property {name} {axis}" for axis in "xyz")]
        values = [1, 2, 3, 4, 5, 100 if code.isupper() else -100]
        for order, encoding in (("<", "binary_little_endian"), (">", "binary_big_endian")):
            data = ply(encoding, *lines) + struct.pack(order + 6 * code, *values)
            assert np.ravel(read_as_ply(tmp_path, data)).tolist() == values


def test_no_ply(tmp_path):
    for data, said in (
        (b"solid cube\n", "does not begin with the line 'ply'"),
        (b"ply\nformat ascii 1.0\n", "has no end_header"),
        (ply("ebcdic", *XYZ), "has the format 'ebcdic'"),
        (ply("ascii", "element face 0"), "has no element 'vertex'"),
        (ply("ascii", *XYZ[:3]), "has 0 fields 'z'"),
        (ply("ascii", *XYZ, "property half w"), "'property half w'"),
        (ply("ascii", *XYZ, "property list half int v"), "'property list half int v'"),
        (ply("ascii", *XYZ, "property of uchar int v"), "'property of uchar int v'"),
        (ply("ascii", *XYZ, "property list uchar int v"), "has lists before its vertices or in"),
        (ply("ascii", "element a 1", FOREIGN[-1], *XYZ), "has lists before its vertices or in"),
        (ply("ascii", "comment " + "x" * 66_000, *XYZ), "has no end_header"),
        (ply("ascii", *XYZ) + b"1 2 3 4", "cut short: 4 numbers"),
        (ply("binary_big_endian", *XYZ) + bytes(20), "is cut short"),
        (ply("ascii", *XYZ) + b"1 2 3 4 five 6", "a coordinate that is no number"),
    ):
        assert said in refusal(read_ply, tmp_path / "a.ply", data)


BOMBS = {
    "a long token": ply("ascii", *XYZ) + b"1" * (8 << 20),
    "a word of odd numbers": ply("ascii", *XYZ) + b"nan(1)." * (1 << 22),
    "many numbers": ply("ascii", "element vertex 1100000", *XYZ[1:]) + b"0 0 0\n" * 1_100_000,
    "much text": ply("ascii", *XYZ) + b"1 2 3" + b" " * (33 << 20),
    "many points": ply("ascii", "element vertex 99999999999", *XYZ[1:]) + b"1 2 3",
    "many rows": ply("binary_little_endian", "element a 9" + "9" * 4000, "property int b", *XYZ),
}


@pytest.mark.parametrize("case", BOMBS)
def test_bombs_are_refused_at_once(tmp_path, case):
    before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    assert len(refusal(read_ply, tmp_path / "a.ply", BOMBS[case])) < 500
    assert time.process_time() - began < 1.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100e3  # [KiB]


# ---- PCD -----------------------------------------------------------------------------------------

FIELDS = np.dtype([("rgb", "<u4"), ("x", "<f8"), ("normal", "<f4", 3), ("y", "<f8"), ("z", "<f4")])
KNOWN = [f"{kind}{n}" for kind in "IUF" for n in (1, 2, 4, 8) if kind != "F" or n > 2]


def pcd(encoding, points=3, **changes):
    entries = {"VERSION": "0.7", "FIELDS": "rgb x normal y z", "SIZE": "4 8 4 8 4"}
    entries |= {"TYPE": "U F F F F", "COUNT": "1 1 3 1 1", "WIDTH": str(points), "HEIGHT": "1"}
    entries |= {"VIEWPOINT": "0 0 0 1 0 0 0", "POINTS": str(points), **changes}
    lines = [f"{key} {value}" for key, value in entries.items() if value is not None]
    return "\n".join(["# by a test", *lines, f"DATA {encoding}", ""]).encode()


def rows(cloud):
    table = np.zeros(len(cloud), FIELDS)
    table["rgb"], table["normal"] = 7, 0.5
    table["x"], table["y"], table["z"] = cloud.T
    return table


def text(table):
    numbers = ([7, *map(float, (r["x"], *r["normal"], r["y"], r["z"]))] for r in table)
    return "\n".join(" ".join(map(repr, row)) for row in numbers).encode()


def lzf(data, back=8):
    """Compressed by copies of what stands so many bytes before."""
    out, at = bytearray(), 0
    while at < len(data):
        n = 0
        while n < 264 and at >= back and data[at + n - back] == (*data[at + n : at + n + 1], -1)[0]:
            n += 1
        if n < 3:
            out += bytes([0, data[at]])
        elif n < 9:
            out += bytes([n - 2 << 5 | back - 1 >> 8, back - 1 & 255])
        else:
            out += bytes([7 << 5 | back - 1 >> 8, n - 9, back - 1 & 255])
        at += n if n > 2 else 1
    return bytes(out)


def compressed(table):
    data = b"".join(table[name].tobytes() for name in FIELDS.names or ())
    packed = lzf(data, back=8 if len(table) < 100 else 264)  # overlapping copies, and far ones
    return struct.pack("<II", len(packed), len(data)) + packed


ENCODINGS = {"ascii": text, "binary": lambda t: t.tobytes(), "binary_compressed": compressed}


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_clouds_in_every_encoding(tmp_path, encoding):
    path = tmp_path / "a.pcd"
    clouds = [np.random.default_rng(0).normal(size=(300, 3)).round(3)]
    clouds += [np.ones((99, 3)), np.ones((200, 3)), CLOUD[:0]]
    clouds.append(np.array([CLOUD[0], [np.nan] * 3, CLOUD[2]]))
    for cloud in clouds:
        path.write_bytes(pcd(encoding, len(cloud)) + ENCODINGS[encoding](rows(cloud)))
        found = read_pcd(path)
        assert found.dtype == np.float64
        expected = np.stack([cloud[:, 0], cloud[:, 1], cloud[:, 2].astype(np.float32)], axis=1)
        np.testing.assert_array_equal(found, expected[~np.isnan(cloud[:, 0])])
    whole = pcd(encoding) + ENCODINGS[encoding](rows(CLOUD))
    for end in range(0, len(whole) - (8 if encoding == "ascii" else 1), 5):
        said = "is cut short" if end >= len(pcd(encoding)) else "PCD file"
        assert said in refusal(read_pcd, path, whole[:end])


def test_an_old_and_short_header(tmp_path):
    head = b"COLUMNS x y z\r\nSIZE 4 4 4\r\nTYPE F F F\r\nPOINTS 1\r\nDATA ascii\r\n"
    (tmp_path / "a.pcd").write_bytes(head + b"1 2 3\r\n")
    found = read_pcd(tmp_path / "a.pcd")
    assert found.dtype == np.float32 and found.tolist() == [[1.0, 2.0, 3.0]]
    # capital and small letters and comments in any encoding
    head = pcd("ASCII", FIELDS="rgb X normal Y Z", TYPE="u f f F f")
    head = head.replace(b"# by", "# \u00c5ngstr\u00f6m\x0b\x0c \u0085by".encode())
    (tmp_path / "a.pcd").write_bytes(head + text(rows(CLOUD)).replace(b"5.0", b"-nan(ind)"))
    np.testing.assert_array_equal(read_pcd(tmp_path / "a.pcd")[:, :2], CLOUD[:2, :2])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"FIELDS": "rgb x normal y w"}, "has 0 fields 'z', not one"),
        ({"FIELDS": "rgb x normal x z"}, "has 2 fields 'x', not one"),
        ({"SIZE": "4 8 4 8"}, "has 5 fields, but not as many of SIZE, TYPE and COUNT"),
        ({"SIZE": "4 2 4 8 4"}, "has a field of TYPE F and SIZE 2, which there is not"),
        ({"TYPE": "U C F F F"}, "has a field of TYPE C and SIZE 8"),
        ({"POINTS": "4"}, "has POINTS 4, but WIDTH 3 and HEIGHT 1"),
        ({"POINTS": None, "WIDTH": None}, "does not say how many points it has"),
        ({"WIDTH": "many"}, "has WIDTH 'many', which is no whole number"),
        ({"COUNT": "1 2 3 1 1"}, "has more than one number in x, y or z"),
        ({"COUNT": "1 1 99999999999 1 1"}, "has fields of 99999999999 numbers"),
        ({"SCALE": "1"}, "has the header line 'SCALE 1', which is not understood"),
        # bounds are exact
        ({"WIDTH": 1 << 22, "POINTS": 1 << 22}, "is cut short"),
        ({"WIDTH": (1 << 22) + 1, "POINTS": (1 << 22) + 1}, "announces 4194305 points"),
        ({"COUNT": f"1 1 {1 << 16} 1 1"}, "is cut short"),
        ({"COUNT": f"1 1 {(1 << 16) + 1} 1 1"}, "has fields of 65537 numbers"),
        ({"WIDTH": 0, "POINTS": 0, "HEIGHT": 10**18}, "has HEIGHT '1000000000000000000', which"),
    ],
)
def test_bad_headers(tmp_path, changes, said):
    told = refusal(read_pcd, tmp_path / "a.pcd", pcd("binary", **changes) + rows(CLOUD).tobytes())
    assert told.startswith(said) and told.endswith("; export the point cloud again as PCD")


def test_fields_of_every_type(tmp_path):
    path = tmp_path / "a.pcd"
    for kind in (*KNOWN, "I3", "U16", "F2"):
        table = np.array([[1, 2, 3], [-4 if kind[0] != "U" else 4, 100, 6]])
        words = {"SIZE": f"{kind[1:]} " * 3, "TYPE": f"{kind[0]} " * 3, "COUNT": "1 1 1"}
        head = pcd("binary", 2, FIELDS="x y z", **words)
        if kind in KNOWN:
            path.write_bytes(head + table.astype(f"<{kind.lower()}").tobytes())
            assert read_pcd(path).tolist() == table.tolist()
        else:
            assert "which there is not" in refusal(read_pcd, path, head + bytes(96))


def test_no_pcd(tmp_path):
    size = (1 << 22) * (4 + 8 + 999 * 4 + 8 + 4) & 0xFFFFFFFF
    vast = pcd("binary_compressed", 1 << 22, COUNT="1 1 999 1 1")
    for data, said in (
        (b"ply\n", "is not a PCD file"),
        (pcd("zip"), "has DATA zip, not one of ascii, binary, binary_compressed"),
        (pcd("ascii") + b"1 2 3 4 5 6 seven\n" * 3, "has a coordinate that is no number"),
        (pcd("binary_compressed") + struct.pack("<II", 0, 5), "unpacks to 5 bytes where"),
        (vast + struct.pack("<II", 9, size) + bytes(9), "unpacks to"),
        (pcd("binary_compressed", 10**17) + bytes(9), "announces 1000"),
    ):
        assert said in refusal(read_pcd, tmp_path / "a.pcd", data)
    with pytest.raises(RecordingError, match="no such file"):
        read_pcd(tmp_path / "none.pcd")


# ---- NumPy ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arrays", "expected"),
    [
        ({"points": CLOUD, "colour": np.zeros((2, 3))}, CLOUD),
        ({"colour": np.zeros((2, 3)), "xyz": CLOUD.astype(np.float32)}, CLOUD.astype(np.float32)),
        ({"anything": np.arange(6).reshape(2, 3)}, np.arange(6.0).reshape(2, 3)),
        ({"points": np.array([*CLOUD, [np.nan] * 3])}, CLOUD),
        ({"points": np.zeros((0, 3))}, np.zeros((0, 3))),
        ({"points": np.tile(CLOUD, (2, 1, 1))}, np.tile(CLOUD, (2, 1))),
    ],
)
def test_clouds_of_numpy(tmp_path, arrays, expected):
    np.savez(tmp_path / "a.npz", **arrays)
    found = read_npz_cloud(tmp_path / "a.npz")
    assert found.dtype == expected.dtype
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"a": CLOUD, "b": CLOUD}, "has the arrays a, b; call the cloud 'points'"),
        ({"points": CLOUD[:, :2]}, r"points is float64 \[3, 2\]; give numbers \[n, 3\] in metres"),
        ({"points": np.array([["a", "b", "c"]])}, r"points is <U1 \[1, 3\]"),
        ({"points": np.array([[None] * 3])}, "holds Python objects .*, which are never loaded"),
        ({}, "has the arrays "),
    ],
)
def test_no_cloud_of_numpy(tmp_path, arrays, said):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(RecordingError, match=said):
        read_npz_cloud(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("shape", "said"), [((10**6, 3), "unpacks to 12"), ((2**33, 3), "is damaged")]
)
def test_a_file_that_unpacks_to_too_much(tmp_path, shape, said, monkeypatch):
    """Members that are large, and members that say they are."""
    assert reading.LARGEST_FILE == 1 << 28
    monkeypatch.setattr(reading, "LARGEST_FILE", 1 << 22)
    path = tmp_path / "a.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("points.npy", "w", force_zip64=True) as member,
    ):
        header = {"descr": "<f4", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(member, header)
        member.write(bytes(12 * 10**6 if shape[0] == 10**6 else 1 << 20))
    with pytest.raises(RecordingError, match=said):
        read_npz_cloud(path)


def test_an_index_without_end(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for k in range(3000):
            archive.writestr(f"{k}.npy", b"")
    with pytest.raises(RecordingError, match="has an index of"):
        read_npz_cloud(tmp_path / "a.npz")
