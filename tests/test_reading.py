"""What is read of others: bounds from both sides, nesting, records, and dialects of text."""

import os
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pytest

from gendom import reading
from gendom.arrays import Array
from gendom.errors import GendomError, RecordingError
from gendom.reading import read_bytes, read_json, read_rows, read_toml


def told(read, *given, **options):
    """What a reader refuses with, in one line."""
    with pytest.raises(GendomError) as caught:
        read(*given, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def nested(depth):
    return b'{"a": ' + b"[" * (depth - 1) + b"1" + b"]" * (depth - 1) + b"}"


CASES = [  # name, what is read, what is not, what is said of that
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
    ("a.json", b"{}", b'{"a":\n1,}', "is not JSON ("),  # in words of Python's version
    ("a.json", b"{}", b"\xff\xfe", "is not JSON ("),
    ("a.json", b"{}", '{"a": 1}'.encode("utf-16-le"), "is not JSON ('utf-8' codec can't decode "
     "byte 0x00 in position 1: a zero byte, save it as UTF-8); write the file again"),
    *(("a.json", b"{}", bad, "is not JSON (") for bad in (b"[" * 100_000, b"[" + b"9" * 5000)),
    ("a.toml", b"a = 1", b"length 0.4", "is not TOML ("),
    ("a.toml", b"a = 1", b"x = " + b"[" * 9000, "is not TOML ("),
    ("a.toml", b"a = 1", b"x = " + b"9" * 5000, "is not TOML ("),
    ("a.toml", b"a = 1", b"a" + b".a" * 30_000 + b" = 1", "is not TOML ("),
    ("a.csv", b"x\n" * (1 << 15), b"x\n" * ((1 << 15) + 1),
     "has 32769 rows, at most 32768 are read; keep one lift, or every tenth row"),
    ("a.csv", b"x\r" * (1 << 15), b"x\r" * ((1 << 15) + 1),
     "has 32769 rows, at most 32768 are read; keep one lift, or every tenth row"),
    ("a.csv", b"," * 255, b"," * 256 + b"\n1,2", "has 257 columns; write the header x"),
    ("a.csv", b"x", b"\n\n", "is empty; write the header x"),
    ("a.csv", b"x,y\n1;2", b"x;y\n",
     "is separated by ';'; separate values by commas, and write decimals with a point"),
]  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=[f"{c[0][2:]}: {c[-1][:50]}" for c in CASES])
def test_text_is_read_up_to_its_bound(tmp_path, case):
    name, within, beyond, said = case
    read = {"a.json": read_json, "a.toml": read_toml, "a.csv": partial(read_rows, header="x")}[name]
    path = tmp_path / name
    path.write_bytes(within)
    assert read(path) is not None
    path.write_bytes(beyond)
    words = told(read, path)
    assert words.startswith(f"{path}: {said}") and (said[-1] == "(" or words.endswith(said))


def test_only_regular_files_are_read(tmp_path):
    pipe, zero, large = tmp_path / "pipe", tmp_path / "zero.toml", tmp_path / "large.json"
    os.mkfifo(pipe)
    zero.symlink_to("/dev/zero")
    large.touch()
    os.truncate(large, 1 << 40)
    (tmp_path / "link").symlink_to("nothing")
    (tmp_path / "gripper.csv").touch()
    for name, said in (
        ("pipe", "is a pipe or device"),
        ("zero.toml", "is a pipe or device"),
        ("large.json", "at most"),
        ("", "is a folder"),
        ("a\0b", "cannot be read"),
        ("link", "is a link to a file that is not there; check the path"),
        ("griper.csv", "griper.csv: no such file; did you mean 'gripper.csv'?"),
        ("other.csv", "no such file; check the path"),
    ):
        for read in (read_toml, read_json, read_bytes):
            assert said in told(read, os.path.join(tmp_path, name))


def test_files_that_others_name_lie_in_their_folder():
    assert reading.inside("f", "a/b.png", where="") == "f/a/b.png"
    assert reading.inside("f", r"a\0.png", where="") == "f/a/0.png"
    for bad in ("", "/a", "a/../../x", "..", "C:a", "C:\\x", "a\0b"):
        with pytest.raises(RecordingError, match=r"is not in f; name files below that folder"):
            reading.inside("f", bad, where="")


def test_compressed_data_may_unpack_to_so_much():
    """256 MiB, or 64 times their size."""
    for packed, most in ((1, 1 << 28), (1 << 22, 1 << 28), (1 << 23, 1 << 29)):
        reading.check_unpacked(most, packed, "x")
        words = f"x: unpacks to {most + 1} bytes or more, at most {most} are read; check where"
        assert told(reading.check_unpacked, most + 1, packed, "x").startswith(words)
    assert (reading.MOST_PIXELS, reading.MOST_DEPTHS) == (4096**2, 2048**2)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_byte_order_marks(tmp_path, encoding):
    """And links to files."""
    path = tmp_path / "x"
    path.write_text("x = 1\n", encoding=encoding)
    (tmp_path / "link.toml").symlink_to(path)
    assert read_toml(tmp_path / "link.toml") == {"x": 1}
    path.write_text('{"x": 1}\n', encoding=encoding)
    assert read_json(path) == {"x": 1}
    path.write_text("x,y\n1,2\n", encoding=encoding)
    assert read_rows(path, header="x,y") == [(1, ["x", "y"]), (2, ["1", "2"])]


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
        assert told(read, {**good, **change}) == said
    assert read({**good, "x": 1}, by_hand=False).name == "a"


def table(path, text, **options):
    path.write_text(text)
    return reading.read_number_table(path, header="t,x", check_header=lambda names: None, **options)


def test_rows_that_are_no_numbers_are_named(tmp_path):
    path = tmp_path / "a.csv"
    for text, said in (
        ("t,x\n", ": holds a header and no rows; write one row a frame"),
        ("t,x\n1,2\n3\n", ", line 3: 1 values under 2 column names; give one value a column"),
        ("t,x\n1\n", ", line 2: 1 values under 2 column names; give one value a column"),
        ("t,x\n1,2\n\n3,a\n", ", line 4, column x: 'a' is no number; give seconds and metres"),
        ("t,x\n1_0,2\n", ", line 2, column t: '1_0' is no number; give seconds and metres"),
        ("t,x\nb,2\n", ", line 2, column t: 'b' is no number; give seconds and metres"),
    ):
        assert told(table, path, text) == f"{path}{said}"
    names, found, lines = table(path, "t, x\n1,2\n\n 3 ,4\n")
    assert (names, found.tolist(), lines) == (["t", "x"], [[1.0, 2.0], [3.0, 4.0]], [2, 4])
    # only a last row of several may be cut, where a recording may have been interrupted
    cut = []
    for text, left in (("t,x\n1,2\n3", 1), ("t,x\n1,2\n3,-", 1), ("t,x\n1,2\n3,4", 2)):
        assert len(table(path, text, on_cut=cut.append)[1]) == left
    for text in ("t,x\n1", "t,x\n1,2\n3\n", "t,x\n1,2\n3,4,5"):
        told(table, path, text, on_cut=cut.append)
    told(table, path, "t,x\n1,2\n3")
    assert cut == [3, 3]
