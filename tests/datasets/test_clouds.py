"""Clouds as PLY, PCD and NumPy files: every encoding, bounds from both sides, bombs refused."""

import io
import json
import os
import resource
import struct
import time
import zipfile

import numpy as np
import pytest

from gendom import reading
from gendom.datasets import Recording, read_pcd, read_ply
from gendom.datasets.npz import read_npz, read_npz_cloud
from gendom.errors import RecordingError

CLOUD = np.array([[0.1, -2.0, 3.5], [1e-7, 0.0, -0.25], [4.0, 5.0, 6.0]])


def refusal(read, path, data):
    """What a reader says of bytes after the file's name: one line, quickly, in little memory."""
    path.write_bytes(data)
    before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    with pytest.raises(RecordingError) as caught:
        read(path)
    assert time.process_time() - began < 1.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100e3  # [KiB]
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
    return read_ply(tmp_path / "a.ply")


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
    assert read_as_ply(tmp_path, ply(encoding, *FOREIGN) + data).tolist() == CLOUD.tolist()


PLAIN, SIX = ply("ascii", *XYZ), b"1 2 3\n4 5 6"
LONGEST = ply("ascii", "element vertex 0", *XYZ[1:])[:-11]
LONGEST += b"comment " + b"c" * ((1 << 16) - len(LONGEST) - 20) + b"\n"
BOTH = [[1, 2, 3], [4, 5, 6]]
DIALECTS = {
    "long number": (PLAIN + SIX + b"0" * 40 + b"e-40", BOTH),  # more than a double holds
    "longest number": (PLAIN + b"0." + b"0" * 1097 + b"1 2 3 -nan(ind) 5 6", [[0, 2, 3]]),
    "longest text": (PLAIN + SIX + b" " * ((1 << 25) - 11), BOTH),
    "longest header": (LONGEST + b"end_header\n", []),
    "windows, integers": (
        PLAIN.replace(b"float", b"int").replace(b"\n", b"\r\n") + b"1 2 3\r\n4 5 6\r\n", BOTH
    ),
    "capitals, mark": (b"\xef\xbb\xbf" + PLAIN.upper() + SIX, BOTH),
    # bytes that other encodings take as the end of a line (NEL, FF) end none
    "utf-8": (ply("ascii", "comment \u00c5ngstr\u00f6m \x0b\x0c \u0085", *XYZ) + SIX, BOTH),
    "latin-1": (ply("ascii", "obj_info", *XYZ).replace(b"_info", b"_info \xc5\x85") + SIX, BOTH),
    "unseen": (ply("binary_big_endian", *XYZ) + struct.pack(">6f", *[np.nan] * 3, 1, 2, 3),
               BOTH[:1]),
    **{of: (PLAIN + f"{of} {of} {of}\n1 2 3".encode(), BOTH[:1])
       for of in ("nan", "-nan(ind)", "NaN", "-1.#IND", "1.#QNAN0", "nan(0x1)")},
}  # fmt: skip


@pytest.mark.parametrize("case", DIALECTS)
def test_dialects(tmp_path, case):
    data, expected = DIALECTS[case]
    assert read_as_ply(tmp_path, data).tolist() == expected


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
            found = read_as_ply(tmp_path, data)
            assert found.ravel().tolist() == values
            assert found.dtype == (np.float32 if code == "f" else np.float64)


def refused_ply():
    little, kinds = ply("binary_little_endian", *XYZ), "ascii, binary_little_endian, binary_big"
    lines = ["element vertex x", "property half w", "property list half int v"]
    lines += ["property of uchar int v"]
    return [
        (b"plyx", "is not a PLY file (it does not begin with the line 'ply')"),
        (LONGEST.replace(b"cc", b"ccc", 1) + b"end_header\n", "has no end_header"),
        (ply("binary", *XYZ), f"has the format 'binary', not one of {kinds}"),
        (ply("ascii", "element face 2"), "has no element 'vertex'"),
        (ply("ascii", *XYZ) + b"1 2 3 4 5 6 7", "holds more than the 6 numbers that are announced"),
        (little + bytes(24) + b"1", f"holds more than the {len(little) + 24} bytes"),
        (ply("ascii", "element a 1", FOREIGN[-1], *XYZ), "has lists before its vertices or in the"),
        (ply("ascii", *XYZ, "property float x"), "has 2 fields 'x', not one"),
        (ply("ascii", *XYZ[:3]), "has 0 fields 'z', not one"),
        (ply("ascii", "property float x"), "has the header line 'property float x', which is not"),
        *((ply("ascii", *XYZ, x), f"has the header line '{x}', which is not und") for x in lines),
        (ply("ascii", *XYZ) + b"1 2 3 4 5", "is cut short: 5 numbers where 6 are announced"),
        (ply("ascii", *XYZ) + b"1 2 3 4 5 1_0", "has a coordinate that is no number (an undersco"),
        (little + bytes(23), f"is cut short: {len(little) + 23} bytes where {len(little) + 24} a"),
        # what would take long or much memory
        (ply("ascii", "element vertex 1048577", *XYZ[1:]), "is text of 0 bytes and 3145731 "
         "numbers, at most 33554432 and 3145728 are read: have it binary"),
        (ply("ascii", *XYZ) + b"1 2 3" + b" " * ((1 << 25) - 4), "is text of 33554433 bytes and 6"),
        (ply("ascii", *XYZ) + b"1" * (8 << 20), "has a coordinate that is no number (more than 1"),
        (ply("ascii", *XYZ) + b"nan(1)." * (1 << 22), "has a coordinate that is no number (more"),
        (ply("binary_little_endian", "element a 9" + "9" * 4000, "property int b", *XYZ),
         f"is cut short: {len(little) + 4027} bytes where 4"),
    ]  # fmt: skip


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


def literal(data):
    """LZF of runs that are kept as they are."""
    runs = (data[k : k + 32] for k in range(0, len(data), 32))
    return b"".join(bytes([len(run) - 1]) + run for run in runs)


def compressed(table):
    data = b"".join(table[name].tobytes() for name in FIELDS.names or ())
    return struct.pack("<II", len(literal(data)), len(data)) + literal(data)


ENCODINGS = {"ascii": text, "binary": lambda t: t.tobytes(), "binary_compressed": compressed}


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_clouds_in_every_encoding(tmp_path, encoding):
    path = tmp_path / "a.pcd"
    clouds = [np.random.default_rng(0).normal(size=(300, 3)).round(3)]
    clouds += [CLOUD[:0], np.array([CLOUD[0], [np.nan] * 3, CLOUD[2]])]
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
    if encoding != "binary_compressed":  # it need not say its width
        path.write_bytes(pcd(encoding, 1, WIDTH=None) + ENCODINGS[encoding](rows(CLOUD[:1])))
        assert read_pcd(path).shape == (1, 3)


DAMAGED = "has compressed data that is damaged"


def of_bytes(packed, size):
    """Compressed, three numbers of a byte for each point, field after field."""
    names = {"FIELDS": "x y z", "SIZE": "1 1 1", "TYPE": "U U U", "COUNT": "1 1 1"}
    head = pcd("binary_compressed", size // 3, **names)
    return head + struct.pack("<II", len(packed), size) + packed


def test_lzf_is_copied_from_every_distance_and_length(tmp_path):
    """Of literal runs and copies, put together byte by byte."""
    rng, known, packed = np.random.default_rng(0), bytearray(), bytearray()
    for _ in range(700):
        run = bytes(rng.integers(0, 256, int(rng.integers(1, 33)), np.uint8))
        packed += literal(run)
        known += run
    copies = ((3, 1), (8, 2), (9, 255), (10, 256), (264, 257), (5, 8192), (40, 7), (264, 1))
    for length, back in copies:
        far = back - 1
        packed += bytes([min(length - 2, 7) << 5 | far >> 8])
        packed += bytes([length - 9] * (length > 8) + [far & 255])
        for _ in range(length):
            known.append(known[-back])

    path, more = tmp_path / "a.pcd", bytes(-len(known) % 3)
    packed, known = bytes(packed + literal(more)), known + more
    path.write_bytes(of_bytes(packed, len(known)))
    assert read_pcd(path).T.ravel().tolist() == list(known)
    assert refusal(read_pcd, path, of_bytes(packed, len(known) - 3)).startswith(DAMAGED)
    size, said = len(known) + 3, f"unpacks to {len(known)} bytes where {len(known) + 3} are"
    assert refusal(read_pcd, path, of_bytes(packed, size)).startswith(said)
    path.write_bytes(of_bytes(b"\x00a\x20\x00\x01aa", 6))
    assert read_pcd(path).tolist() == [[97.0] * 3] * 2


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


def test_fields_of_every_type(tmp_path):
    path = tmp_path / "a.pcd"
    for kind in (*KNOWN, "I3", "U16", "F2"):
        table = np.array([[1, 2, 3], [-4 if kind[0] != "U" else 4, 100, 6]])
        words = {"SIZE": f"{kind[1:]} " * 3, "TYPE": f"{kind[0]} " * 3, "COUNT": "1 1 1"}
        head = pcd("binary", 2, FIELDS="x y z", **words)
        if kind in KNOWN:
            path.write_bytes(head + table.astype(f"<{kind.lower()}").tobytes())
            np.testing.assert_array_equal(read_pcd(path), table)
        else:
            assert "which there is not" in refusal(read_pcd, path, head + bytes(96))


def of_pcd(**changes):
    """A file with another header."""
    return pcd("binary", **changes) + rows(CLOUD).tobytes()


def refused_pcd():
    packed, needed = pcd("binary_compressed"), 3 * FIELDS.itemsize
    good, size = packed + compressed(rows(CLOUD)), (1 << 22) * (4 + 8 + 999 * 4 + 8 + 4)
    vast = pcd("binary_compressed", 1 << 22, COUNT="1 1 999 1 1")
    kinds, many = "ascii, binary, binary_compressed", 1 << 22
    return [
        (b"ply\n", "is not a PCD file, or has no line DATA"),
        (pcd("zip"), f"has DATA zip, not one of {kinds}"),
        (pcd("ascii") + b"1 2 3 4 5 6 seven\n" * 3, "has a coordinate that is no number (could n"),
        (packed + bytes(7), f"is cut short: {len(packed) + 7} bytes where {len(packed) + 8} are"),
        (good[:-1], f"is cut short: {len(good) - 1} bytes where {len(good)} are announced"),
        (packed + struct.pack("<II", 9, needed + 1), f"unpacks to {needed + 1} bytes where"),
        (vast + struct.pack("<II", 9, size & 0xFFFFFFFF) + bytes(9), "unpacks to "),
        (of_pcd(SIZE="4 8 4 8"), "has 5 fields, but not as many of SIZE, TYPE and COUNT"),
        (of_pcd(SIZE="4 2 4 8 4"), "has a field of TYPE F and SIZE 2, which there is not"),
        (of_pcd(COUNT="1 1 0 1 1"), "has fields of 0 numbers a point"),
        (of_pcd(COUNT="1 2 3 1 1"), "has more than one number in x, y or z of a point"),
        (of_pcd(WIDTH="2"), "has POINTS 3, but WIDTH 2 and HEIGHT 1"),
        (of_pcd(POINTS=None, WIDTH=None), "does not say how many points it has"),
        (of_pcd(WIDTH="many"), "has WIDTH 'many', which is no whole number"),
        (of_pcd(POINTS="1" * 19, WIDTH=None), f"has POINTS '{'1' * 19}', which is no whole number"),
        (of_pcd(WIDTH=0, POINTS=0, HEIGHT=10**18), f"has HEIGHT '{10**18}', which is no whole"),
        (of_pcd(SCALE="1"), "has the header line 'SCALE 1', which is not understood"),
        *((of_bytes(bad, 3), DAMAGED) for bad in
          (b"\x01a", b"\0", b"\0a\x20\1", b"\0a\xe0", b"\0a\xe0\0", b"\0a\x20")),
        (of_bytes(bytes((1 << 23) + 1), 3), "has 8388609 bytes that unpack to 3, too many: use DA"),
        # bounds are exact
        (of_pcd(WIDTH=many, POINTS=many), "is cut short: "),
        (of_pcd(WIDTH=many + 1, POINTS=many + 1), f"announces {many + 1} points, at most"),
        (of_pcd(COUNT="1 1 65536 1 1"), "is cut short: "),
        (of_pcd(COUNT="1 1 65537 1 1"), "has fields of 65537 numbers a point"),
    ]  # fmt: skip


# ---- NumPy's files -------------------------------------------------------------------------------


OTHER = np.zeros((1, 3))


def saved(path, **arrays):
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    ("arrays", "expected"),
    [
        ({"xyz": OTHER, "points": CLOUD}, CLOUD),
        ({"colour": OTHER, "xyz": CLOUD.astype(np.float32)}, CLOUD.astype(np.float32)),
        ({"anything": np.arange(6, dtype=np.int16).reshape(2, 3)}, np.arange(6.0).reshape(2, 3)),
        ({"points": np.array([*CLOUD, [np.nan] * 3])}, CLOUD),
        ({"points": np.zeros((0, 3))}, np.zeros((0, 3))),
        ({"points": np.tile(CLOUD, (2, 1, 1))}, np.tile(CLOUD, (2, 1))),  # pixel by pixel
    ],
)
def test_clouds(tmp_path, arrays, expected):
    found = read_npz_cloud(saved(tmp_path / "a.npz", **arrays))
    assert found.dtype == expected.dtype
    np.testing.assert_array_equal(found, expected)


def packed(shape, written):
    """A zip file of one array that says it has a shape, and has so many bytes."""
    header = {"descr": "<f4", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(member := io.BytesIO(), header)
    return zipped({"points.npy": member.getvalue() + bytes(written)})


def archive(**arrays):
    np.savez(file := io.BytesIO(), allow_pickle=True, **arrays)
    return file.getvalue()


def zipped(members):
    with zipfile.ZipFile(file := io.BytesIO(), "w", zipfile.ZIP_DEFLATED, compresslevel=1) as made:
        for name, content in members.items():
            made.writestr(name, content)
    return file.getvalue()


def refused_npz():
    return [
        (b"PQ", "is no .npz file; write it with numpy.savez"),
        (b"PK", "is damaged ("),
        (archive(a=OTHER, b=OTHER), "has the arrays a, b; call the cloud 'points'"),
        (archive(), "has the arrays "),
        *((archive(points=of), f"points is {of.dtype} {list(of.shape)}; give numbers [n, 3] in met")
          for of in (np.zeros((2, 4)), np.zeros(3), np.zeros((2, 2, 2)), np.zeros((1, 3), complex),
                     np.array([["a", "b", "c"]]))),
        (archive(points=np.array([[None] * 3])),
         "holds Python objects (pickles), which are never loaded; write its arrays as numbers"),
        (packed((10**6, 3), 12 * 10**6), "unpacks to 12"),
        (packed((2**33, 3), 1 << 20), "is damaged"),
        (zipped({f"{k}.npy": b"" for k in range(3000)}), "has an index of "),
    ]  # fmt: skip


AGAIN = "; export the point cloud again as "
REFUSED = {
    "PLY": (read_ply, refused_ply, f"{AGAIN}PLY"),
    "PCD": (read_pcd, refused_pcd, f"{AGAIN}PCD"),
    "NPZ": (read_npz_cloud, refused_npz, ""),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_no_cloud(tmp_path, kind, monkeypatch):
    """It is said what is wrong, and what to do."""
    read, cases, end = REFUSED[kind]
    assert reading.LARGEST_FILE == 1 << 28
    if kind == "NPZ":
        monkeypatch.setattr(reading, "LARGEST_FILE", 1 << 22)
    for data, said in cases():
        told = refusal(read, tmp_path / "a", data)
        assert told.startswith(said) and told.endswith(end) and "; " in told, told


def test_bounds(tmp_path):
    """Of a file, which need not be written to be tried, and of the text in it."""
    path = tmp_path / "a.npz"
    path.write_bytes(b"")
    for size, said in ((1 << 31, "is no .npz file"), ((1 << 31) + 1, "most 2147483648 are read")):
        os.truncate(path, size)
        with pytest.raises(RecordingError, match=said):
            read_npz_cloud(path)
    for size, said in ((1 << 23, "meta.format: is None"), ((1 << 23) + 1, "or no JSON text")):
        with pytest.raises(RecordingError, match=said):
            read_npz(saved(path, meta=np.array("{}".ljust(size))))


# ---- shapes at rest ------------------------------------------------------------------------------

WIRE = {"kind": "wire", "length": 0.5, "mass_per_length": 0.02, "diameter": 0.01}
LOOPS = np.arange(2 * 5 * 3).reshape(2, 5, 3) ** 2.0


def at_rest(path, loops=LOOPS, **changes):
    """A file of shapes; what is None is left out."""
    told = {name: value for name, value in {**WIRE, **changes}.items() if value is not None}
    meta = {"format": "gendom-static/1", "object": told, "source": "here"}
    return saved(path, loops=loops, meta=json.dumps(meta))


def test_a_shape_at_rest_becomes_a_recording(tmp_path):
    """Held at both ends, where the repeats are in the mean, along their first and last piece."""
    arrays, meta, _ = read_npz(at_rest(tmp_path / "a.npz"))
    ends, inner = LOOPS[:, [0, 4]].mean(axis=0), LOOPS[:, [1, 3]].mean(axis=0)
    axes = (inner - ends) / np.linalg.norm(inner - ends, axis=1)[:, None]
    wanted = {"points": LOOPS.reshape(10, 3), "offsets": [0, 5, 10], "time": [0, 1],
              "gripper_position": [ends, ends], "gripper_axis": [axes, axes]}  # fmt: skip
    assert arrays.keys() == wanted.keys() and arrays["points"].dtype == np.float32
    for name, values in wanted.items():
        np.testing.assert_allclose(arrays[name], values, rtol=1e-6)
    assert meta == {
        "table_height": None, "gripper_source": "measured", "quasi_static": True, "static": True,
        "ordered_markers": True, "format": "gendom-recording/1", "source": "here",
        "object": {**WIRE, "kind": "rope", "grasp": "both ends", "mass": 0.01},
    }  # fmt: skip
    angle = np.linspace(0.0, np.pi, 21)
    line = 0.16 * np.stack([-np.cos(angle), 0.0 * angle, -np.sin(angle)], axis=1)
    path = at_rest(tmp_path / "b.npz", np.stack([line, line + np.array([1e-3, 0.0, 0.0])]))
    found = Recording.read(path, on_warning=lambda _: None)
    assert (found.num_frames, found.num_grippers, found.quasi_static) == (2, 2, True)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        *(({"loops": of}, "loops: has shape .*, or numbers that are not finite; give .* 5 points")
          for of in (LOOPS[:, :4], LOOPS[0], LOOPS[..., :2], LOOPS.astype(str),
                     np.where(LOOPS > 9.0, np.nan, LOOPS))),
        *(({name: value}, f"object.{name}: is {value}; give a number above 0, in SI")
          for name in ("length", "mass_per_length") for value in (0.0, -1.0)),
        ({"kind": "cloth"}, "object: kind: invalid enum value 'cloth'"),
        ({"mass_per_length": "much"}, "object: mass_per_length: expected float"),
        ({"mass_per_length": None}, "object: object missing required field mass_per_length"),
    ],
)  # fmt: skip
def test_what_is_no_shape_is_refused(tmp_path, changes, said):
    with pytest.raises(RecordingError, match=said):
        Recording.read(at_rest(tmp_path / "bad.npz", **changes))
