"""Bounds of readers from both sides, and whole outputs of small files that were made by hand."""

import io
import json
import os
import struct
import zipfile
from dataclasses import dataclass, field

import numpy as np
import pytest

from datasets.test_clouds import pcd, ply, refusal
from gendom import reading
from gendom.arrays import Array
from gendom.datasets import clouds, npz, read_pcd, read_ply
from gendom.datasets.folder import _misfit, check_named, in_order, read_gripper, read_object
from gendom.datasets.npz import read_npz, read_npz_cloud
from gendom.errors import GendomError, RecordingError

# ---- JSON, TOML and CSV --------------------------------------------------------------------------


def nested(depth):
    return b'{"a": ' + b"[" * (depth - 1) + b"1" + b"]" * (depth - 1) + b"}"


@pytest.mark.parametrize(
    ("name", "within", "beyond", "said"),
    [
        ("a.json", b'{"a": 1}' + b" " * ((1 << 23) - 8), b'{"a": 1}' + b" " * ((1 << 23) - 7),
         "has 8388609 bytes, at most 8388608 are read; check that it is the right file"),
        ("a.toml", b"a = 1" + b"\n" * 65531, b"a = 1" + b"\n" * 65532,
         "has 65537 bytes, at most 65536 are read; check that it is the right file"),
        ("a.json", nested(64), nested(65),
         "is not JSON (it is nested more than 64 times); write the file again"),
        ("a.toml", b"a = 1\na_b = '%s'" % (256 * b"."), b"a = '%s'" % (257 * b"."),
         "is not TOML (a line with more than 256 dots); mend that line"),
        ("a.toml", b"a = %d" % (2**63 - 1), b"a = %d" % 2**63,
         "is not TOML (an integer of 64 bits); mend that line"),
        ("a.json", b'{"a": -%d}' % 2**63, b'{"a": -%d}' % (2**63 + 1),
         "is not JSON (an integer of 64 bits); write the file again"),
        ("a.json", b'{"a": 1e308}', b'{"a": [1e309]}',
         "is not JSON (a number beyond 1e308); write the file again"),
        ("a.json", b"{}", b"[1]", "holds a JSON list, not an object; is it the right file?"),
        ("a.json", b"{}", b'{"a": NaN}',
         "is not JSON (NaN is not a JSON number); write the file again"),
        ("a.json", b"{}", b'{"a":\n1,}', "is not JSON (Illegal trailing comma before end of object "
         "in line 2); write the file again"),
        ("a.csv", b"x\n" * (1 << 15), b"x\n" * ((1 << 15) + 1),
         "has 32769 rows, at most 32768 are read; keep one lift, or every tenth row"),
        ("a.csv", b"x\r" * (1 << 15), b"x\r" * ((1 << 15) + 1),
         "has 32769 rows, at most 32768 are read; keep one lift, or every tenth row"),
        ("a.csv", b"," * 255, b"," * 256 + b"\n1,2", "has 257 columns; write the header x"),
        ("a.csv", b"x", b"\n\n", "is empty; write the header x"),
        ("a.csv", b"x,y\n1;2", b"x;y\n", "is separated by ';'; separate values by commas, and "
         "write decimals with a point"),
    ],
)  # fmt: skip
def test_text_is_read_up_to_its_bound(tmp_path, name, within, beyond, said):
    path = tmp_path / name
    read = {"json": reading.read_json, "toml": reading.read_toml}.get(
        name[2:], lambda path: reading.read_rows(path, header="x")
    )
    path.write_bytes(within)
    assert read(path) is not None
    path.write_bytes(beyond)
    with pytest.raises(GendomError) as caught:
        read(path)
    words = str(caught.value)
    if "trailing comma" in said:  # as Python's version says it
        assert words.startswith(f"{path}: is not JSON (") and "in line 2); write" in words
    else:
        assert words == f"{path}: {said}"


@dataclass
class Inner:
    width: float
    path: str = ""


@dataclass
class Outer:
    name: str
    cameras: list[Inner]
    one: Inner | None = None
    matrix: Array = field(default_factory=lambda: np.zeros(0))


def test_records_of_people_have_known_keys_at_every_depth():
    """Others may hold more; arrays are lists of numbers."""
    good = {"name": "a", "cameras": [{"width": 1}], "one": {"width": 2.0}, "matrix": [[1, 2]]}

    def read(value, by_hand=True):
        return reading.record_of(Outer, value, where="f", fix="mend it", by_hand=by_hand)

    found = read(good)
    assert (found.cameras, found.one) == ([Inner(1.0)], Inner(2.0))
    assert found.matrix.dtype == np.float64 and found.matrix.tolist() == [[1.0, 2.0]]
    for change, said in (
        ({"nam": 1}, "f: has the unknown key 'nam'; did you mean 'name'?"),
        ({"x": 1}, "f: has the unknown key 'x'; known are name, cameras, one, matrix"),
        ({"cameras": [{"width": 1}, {"width": 1, "q": 2}]},
         "f: cameras[1]: has the unknown key 'q'; known are width"),
        ({"one": {"width": 1, "wdth": 2}},
         "f: one: has the unknown key 'wdth'; did you mean 'width'?"),
        ({"one": {"width": 1, "path": "p"}}, "f: one: has the unknown key 'path'; known are width"),
        ({"cameras": [{"width": "a"}]}, "f: cameras[0].width: expected float, got str; mend it"),
        ({"matrix": "a"}, "f: matrix: expected an array of numbers; mend it"),
        ({"cameras": 3}, "f: cameras: expected array, got int; mend it"),
    ):  # fmt: skip
        with pytest.raises(GendomError) as caught:
            read({**good, **change})
        assert str(caught.value) == said
    assert read({**good, "x": 1}, by_hand=False).name == "a"


def test_compressed_data_may_unpack_to_so_much():
    """256 MiB, or 64 times their size."""
    for packed, most in ((1, 1 << 28), (1 << 22, 1 << 28), (1 << 23, 1 << 29)):
        reading.check_unpacked(most, packed, "x")
        words = f"x: unpacks to {most + 1} bytes or more, at most {most} are read; check where"
        with pytest.raises(GendomError, match=words):
            reading.check_unpacked(most + 1, packed, "x")
    assert (reading.MOST_PIXELS, reading.MOST_DEPTHS) == (4096**2, 2048**2)
    assert reading.LARGEST_CSV == reading.LARGEST_JSON


def test_names_lead_into_a_folder_or_are_near_to_one(tmp_path):
    (tmp_path / "gripper.csv").write_text("x")
    with pytest.raises(GendomError, match=r"griper\.csv: no such file; did you mean 'gripper"):
        reading.read_bytes(tmp_path / "griper.csv")
    with pytest.raises(GendomError, match="no such file; check the path"):
        reading.read_bytes(tmp_path / "other.csv")
    assert reading.inside("f", "a/b.png", where="") == "f/a/b.png"
    assert reading.inside("f", r"a\0.png", where="") == "f/a/0.png"
    for bad in ("", "/a", "a/../../x", "..", "C:a", "C:\\x", "a\0b"):
        with pytest.raises(RecordingError, match=r"is not in f; name files below that folder"):
            reading.inside("f", bad, where="")


def table(path, text, **options):
    path.write_text(text)
    return reading.read_number_table(path, header="t,x", check_header=lambda names: None, **options)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t,x\n", "holds a header and no rows; write one row a frame"),
        ("t,x\n1,2\n3\n", ", line 3: 1 values under 2 column names; give one value a column"),
        ("t,x\n1\n", ", line 2: 1 values under 2 column names; give one value a column"),
        ("t,x\n1,2\n\n3,a\n", ", line 4, column x: 'a' is no number; give seconds and metres"),
        ("t,x\nb,2\n", ", line 2, column t: 'b' is no number; give seconds and metres"),
    ],
)
def test_rows_that_are_no_numbers_are_named(tmp_path, text, said):
    with pytest.raises(RecordingError) as caught:
        table(tmp_path / "a.csv", text)
    path = str(tmp_path / "a.csv")
    assert str(caught.value) == f"{path}{said if said[0] == ',' else f': {said}'}"
    names, found, lines = table(tmp_path / "a.csv", "t, x\n1,2\n\n 3 ,4\n")
    assert (names, found.tolist(), lines) == (["t", "x"], [[1.0, 2.0], [3.0, 4.0]], [2, 4])


def test_only_a_last_row_of_several_may_be_cut(tmp_path):
    told = []
    for text, left in (("t,x\n1,2\n3", 1), ("t,x\n1,2\n3,-", 1), ("t,x\n1,2\n3,4", 2)):
        assert len(table(tmp_path / "a.csv", text, on_cut=told.append)[1]) == left
    assert told == [3, 3]
    for text in ("t,x\n1", "t,x\n1,2\n3\n", "t,x\n1,2\n3,4,5"):
        with pytest.raises(RecordingError):
            table(tmp_path / "a.csv", text, on_cut=told.append)
    with pytest.raises(RecordingError):
        table(tmp_path / "a.csv", "t,x\n1,2\n3")
    assert told == [3, 3]


# ---- clouds --------------------------------------------------------------------------------------


def test_lzf_is_copied_from_every_distance_and_length():
    """Of literal runs and copies, put together byte by byte."""
    rng = np.random.default_rng(0)
    known, packed = bytearray(), bytearray()
    for _ in range(700):
        run = bytes(rng.integers(0, 256, int(rng.integers(1, 33)), np.uint8))
        packed += bytes([len(run) - 1]) + run
        known += run
    for length, back in (
        (3, 1),
        (8, 2),
        (9, 255),
        (10, 256),
        (264, 257),
        (5, 8192),
        (40, 7),
        (264, 1),
    ):
        far = back - 1
        packed += bytes([min(length - 2, 7) << 5 | far >> 8])
        packed += bytes([length - 9] * (length > 8) + [far & 255])
        for _ in range(length):
            known.append(known[-back])
    assert clouds._lzf(bytes(packed), len(known)) == known
    for size in (len(known) - 1, len(known) + 1):
        with pytest.raises(clouds._CloudError, match=r"damaged|unpacks to \d+ bytes where \d+"):
            clouds._lzf(bytes(packed), size)
    for bad in (b"\x01a", b"\x00", b"\x00a\x20\x01", b"\x00a\xe0", b"\x00a\xe0\x00", b"\x00a\x20"):
        with pytest.raises(clouds._CloudError, match="damaged"):
            clouds._lzf(bad, 1)
    assert clouds._lzf(b"\x00a\x20\x00", 4) == b"aaaa"


VERTEX = ["element vertex 2", *(f"property float {axis}" for axis in "xyz")]
TWO = struct.pack("<6f", *range(6))


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"plx\n", "is not a PLY file (it does not begin with the line 'ply')"),
        (b"plyx", "is not a PLY file (it does not begin with the line 'ply')"),
        (b"ply\nformat ascii 1.0\n", "has no end_header"),
        (b"ply\n" + b"comment\n" * 8191 + b"end_header\n", "has no end_header"),
        (ply("ascii", "element face 2"), "has no element 'vertex'"),
        (ply("ascii", "element vertex x"),
         "has the header line 'element vertex x', which is not understood"),
        (ply("ascii", "property float x"),
         "has the header line 'property float x', which is not understood"),
        (ply("binary", *VERTEX),
         "has the format 'binary', not one of ascii, binary_little_endian, binary_big_endian"),
        (ply("ascii", "element vertex 2", "property list uchar int x"),
         "has lists before its vertices or in them, which are not read"),
        (ply("ascii", *VERTEX, "property float x"), "has 2 fields 'x', not one"),
        (ply("ascii", *VERTEX[:3]), "has 0 fields 'z', not one"),
        (ply("ascii", *VERTEX) + b"1 2 3 4 5", "is cut short: 5 numbers where 6 are announced"),
        (ply("ascii", *VERTEX) + b"1 2 3 4 5 a", "has a coordinate that is no number (could not "
         "convert string to float: b'a')"),
        (ply("binary_little_endian", *VERTEX) + TWO[:-1],
         "is cut short: {} bytes where {} are announced"),
        (ply("ascii", "element vertex 4194305", *VERTEX[1:]),
         "announces 4194305 points, at most 4194304 are read"),
        (ply("ascii", "element vertex 1048577", *VERTEX[1:]), "is text of 0 bytes and 3145731 "
         "numbers, at most 33554432 and 3145728 are read: have it binary"),
    ],
)  # fmt: skip
def test_what_a_ply_file_is_refused_for(tmp_path, data, said):
    words = refusal(read_ply, tmp_path / "a.ply", data)
    there = len(data)
    assert words == f"{said.format(there, there + 1)}; export the point cloud again as PLY"


def test_clouds_at_their_bounds(tmp_path):
    """Headers of 64 KiB, a million points as text, four million as bytes; numbers of 1,100
    characters."""
    path = tmp_path / "a.ply"
    head, end = b"ply\nformat ascii 1.0\nelement vertex 0\n", b"end_header\n"
    xyz = b"".join(b"property double %c\n" % axis for axis in b"xyz")
    fill = (1 << 16) - len(head + xyz + end)
    for more, there in ((0, True), (1, False)):
        path.write_bytes(head + xyz + b"comment " + b"c" * (fill - 9 + more) + b"\n" + end)
        if there:
            assert read_ply(path).shape == (0, 3)
        else:
            with pytest.raises(RecordingError, match="has no end_header"):
                read_ply(path)
    path.write_bytes(ply("ascii", *VERTEX) + b"1 2 3 4 5 0." + b"0" * 6000)
    with pytest.raises(RecordingError, match=r"is no number .more than 1100 characters"):
        read_ply(path)
    number = b"0." + b"0" * 1097 + b"1"
    path.write_bytes(ply("ascii", *VERTEX) + number + b" 2 3 -nan(ind) 5 6")
    assert read_ply(path).tolist() == [[0.0, 2.0, 3.0]]
    for kind, code in (("binary_little_endian", "<"), ("binary_big_endian", ">")):
        lines = ["element a 2", "property short s", *VERTEX, "property uchar c"]
        rows = [struct.pack(f"{code}3fB", *v, 7) for v in ((1, 2, 3), (4, 5, 6))]
        path.write_bytes(ply(kind, *lines) + struct.pack(f"{code}2h", 5, 6) + b"".join(rows))
        assert read_ply(path).tolist() == [[1, 2, 3], [4, 5, 6]]
    path.write_bytes(ply("ascii", "element a 1", "property short s", *VERTEX, "property uchar c")
                     + b"9 1 2 3 7 4 5 6 7 junk")  # fmt: skip
    assert read_ply(path).tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"SIZE": "4 8 4 8"}, "has 5 fields, but not as many of SIZE, TYPE and COUNT"),
        ({"SIZE": "4 8 4 8 3"}, "has a field of TYPE F and SIZE 3, which there is not"),
        ({"TYPE": "U F F F X"}, "has a field of TYPE X and SIZE 4, which there is not"),
        ({"COUNT": "1 1 0 1 1"}, "has fields of 0 numbers a point"),
        ({"COUNT": "1 1 65537 1 1"}, "has fields of 65537 numbers a point"),
        ({"COUNT": "1 2 3 1 1"}, "has more than one number in x, y or z of a point"),
        ({"WIDTH": "2"}, "has POINTS 3, but WIDTH 2 and HEIGHT 1"),
        ({"HEIGHT": "2"}, "has POINTS 3, but WIDTH 3 and HEIGHT 2"),
        ({"POINTS": None, "WIDTH": None}, "does not say how many points it has"),
        ({"POINTS": "x"}, "has POINTS 'x', which is no whole number"),
        ({"POINTS": "1" * 19, "WIDTH": None},
         f"has POINTS {'1' * 19!r}, which is no whole number"),
        ({"VERSIO": "1"}, "has the header line 'VERSIO 1', which is not understood"),
    ],
)  # fmt: skip
def test_what_a_pcd_file_is_refused_for(tmp_path, changes, said):
    words = refusal(read_pcd, tmp_path / "a.pcd", pcd("binary", **changes))
    assert words == f"{said}; export the point cloud again as PCD"


def test_packed_clouds_say_how_long_they_are(tmp_path):
    path, head = tmp_path / "a.pcd", pcd("binary_compressed", 3)
    needed = 3 * (4 + 8 + 12 + 8 + 4)
    plain = b"".join(bytes([31]) + bytes(32) for _ in range(3)) + bytes([11]) + bytes(12)
    good = head + struct.pack("<II", len(plain), needed) + plain
    path.write_bytes(good)
    assert read_pcd(path).tolist() == [[0.0] * 3] * 3
    for data, said in (
        (head + bytes(7), f"is cut short: {len(head) + 7} bytes where {len(head) + 8} are"),
        (good[:-1], f"is cut short: {len(good) - 1} bytes where {len(good)} are announced"),
        (head + struct.pack("<II", 9, needed + 1) + plain,
         f"unpacks to {needed + 1} bytes where {needed} are announced"),
    ):  # fmt: skip
        assert said in refusal(read_pcd, path, data)
    for encoding, data in (("ascii", b"7 1 0 0 0 2 3"), ("binary", bytes(36))):
        path.write_bytes(pcd(encoding, 1, WIDTH=None) + data)
        assert read_pcd(path).shape == (1, 3)
    assert "has DATA packed, not one of ascii, binary, binary_compressed" in refusal(
        read_pcd, path, pcd("packed")
    )


# ---- NumPy ---------------------------------------------------------------------------------------


def static(loops, **changes):
    told = {"kind": "wire", "length": 0.5, "mass_per_length": 0.02, "diameter": 0.001, **changes}
    meta = {"format": "gendom-static/1", "object": told, "source": "here"}
    return {"loops": loops, "meta": json.dumps(meta)}


def saved(path, **arrays):
    np.savez(path, **arrays)
    return path


def test_a_shape_at_rest_becomes_a_recording(tmp_path):
    loops = np.arange(2 * 5 * 3).reshape(2, 5, 3) ** 2.0
    path = saved(tmp_path / "a.npz", **static(loops))
    arrays, meta = read_npz(path)
    ends, inner = loops[:, [0, 4]].mean(axis=0), loops[:, [1, 3]].mean(axis=0)
    axes = (inner - ends) / np.linalg.norm(inner - ends, axis=1)[:, None]
    wanted = {"points": loops.reshape(10, 3), "offsets": [0, 5, 10], "time": [0, 1],
              "gripper_position": [ends, ends], "gripper_axis": [axes, axes]}  # fmt: skip
    assert arrays.keys() == wanted.keys() and arrays["points"].dtype == np.float32
    for name, values in wanted.items():
        np.testing.assert_allclose(arrays[name], values, rtol=1e-6)
    told = {"kind": "rope", "length": 0.5, "mass_per_length": 0.02, "diameter": 0.001}
    assert meta == {
        "table_height": None, "gripper_source": "measured", "quasi_static": True, "static": True,
        "ordered_markers": True, "format": "gendom-recording/1", "source": "here",
        "object": {**told, "grasp": "both ends", "mass": 0.01},
    }  # fmt: skip
    for bad in (loops[:, :4], loops[0], loops[..., :2], np.where(loops > 9.0, np.nan, loops),
                loops.astype(str)):  # fmt: skip
        with pytest.raises(RecordingError, match=r"loops: has shape .* 5 or more"):
            read_npz(saved(path, **static(bad)))
    for name in ("length", "mass_per_length"):
        for value in (0.0, -1.0):
            with pytest.raises(RecordingError, match=f"object.{name}: is {value}; give a number"):
                read_npz(saved(path, **static(loops, **{name: value})))
    with pytest.raises(RecordingError, match="mass_per_length"):
        told = static(loops)["meta"].replace("mass_per_length", "mass")
        read_npz(saved(path, loops=loops, meta=told))


def test_clouds_and_recordings_of_numpy(tmp_path):
    path = tmp_path / "a.npz"
    organised = np.arange(24.0).reshape(2, 4, 3)
    assert read_npz_cloud(saved(path, xyz=organised)).tolist() == organised.reshape(8, 3).tolist()
    both = {"a": np.zeros(3), "points": np.ones((2, 3)), "xyz": np.zeros((1, 3))}
    assert read_npz_cloud(saved(path, **both)).tolist() == [[1.0] * 3] * 2
    found = read_npz_cloud(saved(path, only=np.array([[1, 2, 3]], np.int16)))
    assert found.dtype == np.float64 and found.tolist() == [[1.0, 2.0, 3.0]]
    for bad in (np.zeros((2, 4)), np.zeros(3), np.zeros((2, 2, 2)), np.zeros((1, 3), complex)):
        with pytest.raises(RecordingError, match=r"points is \w+ \[[\d, ]+\]; give numbers"):
            read_npz_cloud(saved(path, points=bad))
    with pytest.raises(RecordingError, match="has the arrays a, b; call the cloud 'points'"):
        read_npz_cloud(saved(path, a=np.zeros((1, 3)), b=np.zeros((1, 3))))
    for meta, said in (
        ("{}", "meta.format: is None; only 'gendom-recording/1' can be read here"),
        ('{"format": "gendom-recording/0"}', "is 'gendom-recording/0'; only"),
        ('{"format": "gendom-recording/2"}', "is 'gendom-recording/2'; only"),
        (["{}", "{}"], "meta: is missing, or no JSON text"),
        (3, "meta: is missing, or no JSON text"),
    ):
        with pytest.raises(RecordingError, match=said.replace(".", r"\.")):
            read_npz(saved(path, meta=np.array(meta)))
    with pytest.raises(RecordingError, match="is missing, or no JSON text"):
        read_npz(saved(path, points=np.zeros((1, 3))))
    for data, said in (
        (b"PQ", "is no .npz file; write it with numpy.savez"),
        (b"PK", "is damaged"),
        (b"QK", "is no .npz file"),
    ):
        assert said in refusal(read_npz_cloud, path, data)
    np.save(file := io.BytesIO(), np.array([{}]), allow_pickle=True)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("points.npy", file.getvalue())
    with pytest.raises(RecordingError, match=r"pickles.*numbers and meta as JSON"):
        read_npz_cloud(path)
    for size, said in ((1 << 31, "is no .npz file"), ((1 << 31) + 1, "most 2147483648 are read")):
        path.write_bytes(b"")
        os.truncate(path, size)
        with pytest.raises(RecordingError, match=said):
            read_npz_cloud(path)
    for size, said in ((1 << 23, "meta.format: is None"), ((1 << 23) + 1, "or no JSON text")):
        with pytest.raises(RecordingError, match=said):
            read_npz(saved(path, meta=np.array("{}".ljust(size))))
    assert npz.short(ValueError("a" * 130 + "\nb")) == "a" * 120
    assert npz.short(KeyError()) == "KeyError"


# ---- folders -------------------------------------------------------------------------------------


def test_numbers_fit_times_in_their_best_unit_or_evenly():
    time = np.array([5.0, 5.1, 5.3, 5.4])
    for unit in (1.0, 1e3, 1e6, 1e9):
        as_times, evenly = _misfit(unit * (time - 5.0), time)
        assert as_times == pytest.approx(0.0, abs=1e-9) and evenly == pytest.approx(0.0, abs=1e-9)
    as_times, evenly = _misfit(np.arange(4.0), time)
    # 0, 1/3, 2/3 and 1 of 0.4 s beside 0, 0.1, 0.3 and 0.4 s; in milliseconds nearly nothing
    assert evenly == pytest.approx(0.4 / 3.0 - 0.1)
    off = np.arange(4.0) * 1e-3 - (time - 5.0)
    assert as_times == pytest.approx(np.abs(off - np.median(off)).max(), rel=0.01)
    for numbers, at in (
        (None, time),
        (np.zeros(1), time[:1]),
        (np.zeros(2), np.array([0, np.nan])),
    ):
        assert _misfit(numbers, at) == (np.inf, np.inf)
    assert _misfit(np.zeros(4), time)[1] == np.inf


@pytest.mark.parametrize(("off", "right"), [(0.099, True), (0.101, False)])
def test_names_that_are_times_may_be_off_by_a_frame(off, right):
    """Those since 1970 as times; most of them."""
    time = 0.1 * np.arange(11)
    seconds = time + np.where(np.arange(11) == 5, off, 0.0)
    names = [f"f{1700000000 + t:.4f}" for t in seconds]
    if right:
        check_named(names, time, where="lift")
    else:
        said = r"lift: times in names, as 'f1700000000\.0000', are up to 0\.101 s from those of the"
        with pytest.raises(RecordingError, match=said):
            check_named(names, time, where="lift")
    check_named([n[1:4] + n[12:] for n in names], time, where="")  # no time since 1970
    counters = [f"a{k}" for k in range(11)]
    assert in_order(counters[::-1], time, where="") == counters
    mixed = [*names[:5], *counters[5:]]
    check_named(mixed, time, where="")
    assert in_order(["b2", "B10", "a3"], np.arange(3.0), where="") == ["a3", "b2", "B10"]


def test_columns_of_grippers_in_any_order(tmp_path):
    path = tmp_path / "gripper.csv"
    names = "closed1,z1,y1,x1,az1,ay1,ax1,time,x0,y0,z0,ax0,ay0,az0,closed0"
    path.write_text(f"{names}\n0,13,12,11,16,15,14,0.5,1,2,3,4,5,6,1\n")
    found = read_gripper(path)
    assert {name: value.tolist() for name, value in found.items()} == {
        "time": [0.5], "gripper_position": [[[1, 2, 3], [11, 12, 13]]],
        "gripper_axis": [[[4, 5, 6], [14, 15, 16]]], "gripper_closed": [[True, False]],
    }  # fmt: skip
    for header, row, said in (
        ("time,x,y", "0,0,0", "the header lacks 'z'"),
        ("time,x,y,z,w", "0,0,0,0,0", "the header has unknown 'w'"),
        ("time,x,y,z,z", "0,0,0,0,0", "the header repeats 'z'"),
        ("time,x,y,z,ax", "0,0,0,0,0", "the header lacks 'ay', 'az'"),
        ("time,x,y,z,closed", "0,0,0,0,2", ", line 2, column closed: is '2'; give 1 where"),
    ):
        path.write_text(f"{header}\n{row}\n")
        with pytest.raises(RecordingError, match=said):
            read_gripper(path)
    toml = tmp_path / "object.toml"
    toml.write_text(
        "notes = 'a'\n[object]\nkind = 'rope'\nnotes = 'b'\nsource = 'c'\ngrasp = 'd'\n"
    )
    told = {"kind": "rope", "notes": "b", "grasp": "d"}
    assert read_object(toml) == {"notes": "a", "source": "c", "object": told}
