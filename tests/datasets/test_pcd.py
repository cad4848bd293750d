"""PCD: three encodings, other fields skipped, and files that are not whole."""

import struct

import numpy as np
import pytest

from gendom.datasets import read_pcd
from gendom.errors import RecordingError

CLOUD = np.array([[0.1, -2.0, 3.5], [1e-7, 0.0, -0.25], [4.0, 5.0, 6.0]])
FIELDS = np.dtype([("rgb", "<u4"), ("x", "<f8"), ("normal", "<f4", 3), ("y", "<f8"), ("z", "<f4")])


def header(encoding, points=3, **changes):
    entries = {
        "VERSION": "0.7",
        "FIELDS": "rgb x normal y z",
        "SIZE": "4 8 4 8 4",
        "TYPE": "U F F F F",
        "COUNT": "1 1 3 1 1",
        "WIDTH": str(points),
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": str(points),
    } | changes
    lines = [f"{key} {value}" for key, value in entries.items() if value is not None]
    return "\n".join(["# by a test", *lines, f"DATA {encoding}", ""]).encode()


KNOWN = [f"{kind}{n}" for kind in "IUF" for n in (1, 2, 4, 8) if kind != "F" or n > 2]


def rows(cloud):
    table = np.zeros(len(cloud), FIELDS)
    table["rgb"], table["normal"] = 7, 0.5
    table["x"], table["y"], table["z"] = cloud.T
    return table


def text(table):
    lines = [
        " ".join(map(repr, [int(r["rgb"]), *map(float, (r["x"], *r["normal"], r["y"], r["z"]))]))
        for r in table
    ]
    return "\n".join(lines).encode()


def lzf(data):
    """Compressed by the longest copy within reach, as LibLZF does."""
    out, plain, at = bytearray(), bytearray(), 0

    def flush():
        for n in range(0, len(plain), 32):
            part = plain[n : n + 32]
            out.extend([len(part) - 1, *part])
        plain.clear()

    while at < len(data):
        begin = data.rfind(data[at : at + 3], max(0, at - 8191), at + 2) if at else -1
        if begin < 0 or len(data) - at < 3:
            plain.append(data[at])
            at += 1
            continue
        length = 3
        while (
            length < 264
            and data[begin + length : begin + length + 1]
            == data[at + length : at + length + 1]
            != b""
        ):
            length += 1
        flush()
        back = at - begin - 1
        if length - 2 < 7:
            out.append((length - 2) << 5 | back >> 8)
        else:
            out.extend([7 << 5 | back >> 8, length - 9])
        out.append(back & 255)
        at += length
    flush()
    return bytes(out)


def compressed(table):
    data = b"".join(table[name].tobytes() for name in FIELDS.names or ())
    packed = lzf(data)
    return struct.pack("<II", len(packed), len(data)) + packed


ENCODINGS = {"ascii": text, "binary": lambda t: t.tobytes(), "binary_compressed": compressed}


@pytest.fixture(params=ENCODINGS)
def encoding(request):
    return request.param


def test_other_fields_are_skipped(tmp_path, encoding):
    cloud = np.random.default_rng(0).normal(size=(300, 3)).round(3)
    data = ENCODINGS[encoding](rows(cloud))
    (tmp_path / "a.pcd").write_bytes(header(encoding, 300) + data)
    found = read_pcd(tmp_path / "a.pcd")
    assert found.dtype == np.float64
    expected = np.stack([cloud[:, 0], cloud[:, 1], cloud[:, 2].astype(np.float32)], axis=1)
    np.testing.assert_array_equal(found, expected)


def test_compression_shortens_what_repeats():
    assert len(compressed(rows(np.ones((1000, 3))))) < 1000


def test_points_that_were_not_seen_are_left_out(tmp_path, encoding):
    cloud = CLOUD.copy()
    cloud[1] = np.nan
    (tmp_path / "a.pcd").write_bytes(header(encoding) + ENCODINGS[encoding](rows(cloud)))
    np.testing.assert_array_equal(read_pcd(tmp_path / "a.pcd"), CLOUD[[0, 2]])


def test_no_points(tmp_path, encoding):
    (tmp_path / "a.pcd").write_bytes(header(encoding, 0) + ENCODINGS[encoding](rows(CLOUD[:0])))
    assert read_pcd(tmp_path / "a.pcd").shape == (0, 3)


def test_an_old_and_short_header(tmp_path):
    head = b"COLUMNS x y z\r\nSIZE 4 4 4\r\nTYPE F F F\r\nPOINTS 1\r\nDATA ascii\r\n"
    (tmp_path / "a.pcd").write_bytes(head + b"1 2 3\r\n")
    found = read_pcd(tmp_path / "a.pcd")
    assert found.dtype == np.float32 and found.tolist() == [[1.0, 2.0, 3.0]]


def test_a_cut_file(tmp_path, encoding):
    path = tmp_path / "a.pcd"
    head = header(encoding)
    whole = head + ENCODINGS[encoding](rows(CLOUD))
    ends = range(0, len(whole) - (8 if encoding == "ascii" else 1), 5)
    for end in ends:
        path.write_bytes(whole[:end])
        with pytest.raises(
            RecordingError, match="is cut short" if end >= len(head) else "PCD file"
        ):
            read_pcd(path)


@pytest.mark.parametrize("at", range(8, 60, 3))
def test_damaged_compression_is_told_or_harmless(tmp_path, at):
    data = bytearray(compressed(rows(np.ones((50, 3)))))
    data[at % len(data)] ^= 0xFF
    (tmp_path / "a.pcd").write_bytes(header("binary_compressed", 50) + data)
    try:
        assert read_pcd(tmp_path / "a.pcd").shape[1] == 3
    except RecordingError as error:
        assert "\n" not in str(error)


BAD_HEADERS = {
    "no z": ({"FIELDS": "rgb x normal y w"}, "has 0 fields 'z', not one"),
    "two x": ({"FIELDS": "rgb x normal x z"}, "has 2 fields 'x', not one"),
    "a size less": ({"SIZE": "4 8 4 8"}, "has 5 fields, but not as many of SIZE, TYPE and COUNT"),
    "an odd size": ({"SIZE": "4 2 4 8 4"}, "has a field of TYPE F and SIZE 2, which there is not"),
    "an odd type": ({"TYPE": "U C F F F"}, "has a field of TYPE C and SIZE 8"),
    "other points": ({"POINTS": "4"}, "has POINTS 4, but WIDTH 3 and HEIGHT 1"),
    "no points": ({"POINTS": None, "WIDTH": None}, "does not say how many points it has"),
    "a word": ({"WIDTH": "many"}, "has WIDTH 'many', which is no whole number"),
    "two numbers in x": ({"COUNT": "1 2 3 1 1"}, "has more than one number in x, y or z"),
    "no end of numbers": ({"COUNT": "1 1 99999999999 1 1"}, "has fields of 99999999999 numbers"),
    "a strange line": ({"SCALE": "1"}, "has the header line 'SCALE 1', which is not understood"),
}


@pytest.mark.parametrize("case", BAD_HEADERS)
def test_bad_headers(tmp_path, case):
    changes, said = BAD_HEADERS[case]
    (tmp_path / "a.pcd").write_bytes(header("binary", **changes) + rows(CLOUD).tobytes())
    with pytest.raises(RecordingError) as caught:
        read_pcd(tmp_path / "a.pcd")
    assert str(caught.value).startswith(f"{tmp_path / 'a.pcd'}: {said}")
    assert str(caught.value).endswith("; export the point cloud again as PCD")


@pytest.mark.parametrize("kind", [*KNOWN, "I3", "U16", "F2"])
def test_numbers_of_every_type(tmp_path, kind):
    table = np.array([[1, 2, 3], [-4 if kind[0] != "U" else 4, 100, 6]])
    words = {"SIZE": f"{kind[1:]} " * 3, "TYPE": f"{kind[0]} " * 3, "COUNT": "1 1 1"}
    head, known = header("binary", 2, FIELDS="x y z", **words), kind in KNOWN
    data = table.astype(f"<{kind.lower()}").tobytes() if known else bytes(96)
    (tmp_path / "a.pcd").write_bytes(head + data)
    if known:
        assert read_pcd(tmp_path / "a.pcd").tolist() == table.tolist()
        return
    with pytest.raises(RecordingError, match="which there is not"):
        read_pcd(tmp_path / "a.pcd")


@pytest.mark.parametrize(
    ("largest", "change"),
    [
        (1 << 22, lambda n: {"WIDTH": n, "POINTS": n, "HEIGHT": 1}),
        (1 << 16, lambda n: {"COUNT": f"1 1 {n} 1 1"}),
        (10**18 - 1, lambda n: {"WIDTH": 0, "POINTS": 0, "HEIGHT": n}),
    ],
)
def test_bounds_are_exact(tmp_path, largest, change):
    for n in (largest, largest + 1):
        (tmp_path / "a.pcd").write_bytes(header("binary", **change(n)))
        if largest > 1 << 22 and n == largest:
            assert len(read_pcd(tmp_path / "a.pcd")) == 0
            continue
        with pytest.raises(RecordingError) as caught:
            read_pcd(tmp_path / "a.pcd")
        assert ("is cut short" in str(caught.value)) == (n == largest)


def test_other_bad_files(tmp_path):
    path = tmp_path / "a.pcd"
    for data, said in (
        (b"ply\n", "is not a PCD file"),
        (header("zip"), "has DATA zip, not one of ascii, binary, binary_compressed"),
        (header("ascii") + b"1 2 3 4 5 6 seven\n" * 3, "has a coordinate that is no number"),
        (header("binary_compressed") + struct.pack("<II", 0, 5), "unpacks to 5 bytes where"),
    ):
        path.write_bytes(data)
        with pytest.raises(RecordingError, match=said):
            read_pcd(path)
    with pytest.raises(RecordingError, match="no such file"):
        read_pcd(tmp_path / "none.pcd")


def test_capital_and_small_letters(tmp_path):
    head = header("BINARY", FIELDS="rgb X normal Y Z", TYPE="u f f F f")
    (tmp_path / "a.pcd").write_bytes(head + rows(CLOUD).tobytes())
    expected = np.stack([CLOUD[:, 0], CLOUD[:, 1], CLOUD[:, 2].astype(np.float32)], axis=1)
    np.testing.assert_array_equal(read_pcd(tmp_path / "a.pcd"), expected)


def test_a_comment_in_any_encoding(tmp_path):
    head = header("ascii").replace(b"# by", "# \u00c5ngstr\u00f6m\x0b\x0c \u0085by".encode())
    (tmp_path / "a.pcd").write_bytes(head + text(rows(CLOUD)).replace(b"5.0", b"-nan(ind)"))
    np.testing.assert_array_equal(read_pcd(tmp_path / "a.pcd")[:, :2], CLOUD[:2, :2])


def test_a_cloud_that_would_unpack_to_gigabytes(tmp_path):
    head = header("binary_compressed", 1 << 22, COUNT="1 1 999 1 1")
    size = (1 << 22) * (4 + 8 + 999 * 4 + 8 + 4)
    (tmp_path / "a.pcd").write_bytes(head + struct.pack("<II", 9, size & 0xFFFFFFFF) + bytes(9))
    with pytest.raises(RecordingError, match="unpacks to"):
        read_pcd(tmp_path / "a.pcd")
    (tmp_path / "a.pcd").write_bytes(header("binary_compressed", 10**17) + bytes(9))
    with pytest.raises(RecordingError, match="announces 1000"):
        read_pcd(tmp_path / "a.pcd")
