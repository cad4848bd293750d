"""What is read of others: bounds, nesting, and dialects of text."""

import os

import pytest

from gendom.errors import GendomError
from gendom.reading import read_bytes, read_json, read_rows, read_toml


@pytest.mark.parametrize(
    ("name", "content", "what"),
    [
        ("a.json", b"{", r"is not JSON \(.* in line 1\)"),
        ("a.json", b"[1]", "holds a JSON list, not an object"),
        ("a.json", b'{"a": NaN}', "NaN is not a JSON number"),
        ("a.json", b"\xff\xfe", "is not JSON"),
        ("a.json", '{"a": 1}'.encode("utf-16-le"), "a zero byte, save it as UTF-8"),
        ("a.json", b"[" * 100_000, r"is not JSON \("),
        ("a.json", b'{"a":' * 100 + b"1" + b"}" * 100, r"is not JSON \(it is nested"),
        ("a.json", b'{"a": ' + b"9" * 401 + b"}", r"is not JSON \(an integer of"),
        ("a.json", b'{"a": [1e400]}', r"is not JSON \(a number beyond"),
        ("a.json", b'{"a": ' + b"9" * 5000 + b"}", r"is not JSON \("),
        ("a.json", b'{"x": [[9223372036854775808]]}', "an integer of 64 bits"),
        ("a.json", None, "no such file; check the path"),
        ("a.toml", b"length 0.4", r"is not TOML \("),
        ("a.toml", b"x = " + b"[" * 9000, r"is not TOML \("),
        ("a.toml", b"x = " + b"9" * 400, r"is not TOML \("),
        ("a.toml", b"x = " + b"9" * 5000, r"is not TOML \("),
        ("a.toml", b"a" + b".a" * 30_000 + b" = 1", r"is not TOML \("),
    ],
)
def test_text_that_cannot_be_used(tmp_path, name, content, what):
    path, read = tmp_path / name, read_json if name == "a.json" else read_toml
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(GendomError, match=what) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def test_only_regular_files_of_some_size_are_read(tmp_path):
    pipe, zero, large = tmp_path / "pipe", tmp_path / "zero.toml", tmp_path / "large.json"
    os.mkfifo(pipe)
    zero.symlink_to("/dev/zero")
    with open(large, "wb") as file:
        file.truncate(1 << 40)
    kinds = ((pipe, "pipe"), (zero, "device"), (large, "at most"), (tmp_path, "is a folder"))
    for path, what in kinds:
        for read in (read_toml, read_json, read_bytes):
            with pytest.raises(GendomError, match=what):
                read(path)
    (tmp_path / "link").symlink_to("nothing")
    for path, what in (
        ("a\0b", "cannot be read"),
        (tmp_path / "link", "not there; check the path"),
    ):
        with pytest.raises(GendomError, match=what):
            read_bytes(path)


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
