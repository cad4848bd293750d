"""Files are whole or absent, and JSON holds no NaN."""

import errno
import json
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from gendom.errors import GendomError, RecordingError
from gendom.files import (
    atomic_folder,
    atomic_path,
    check_file,
    check_folder,
    inside,
    read_bytes,
    read_json,
    read_rows,
    read_toml,
    to_json,
    write_json,
)


def test_success_replaces_and_leaves_nothing_else(tmp_path):
    path = tmp_path / "new" / "a.txt"
    for text in ("one", "two"):
        with atomic_path(path) as temporary:
            assert temporary.parent == path.parent and temporary.suffix == ".txt"
            temporary.write_text(text)
        assert path.read_text() == text
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_failure_keeps_the_old_file(tmp_path, error):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(error), atomic_path(path) as temporary:
        temporary.write_text("half")
        raise error
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_places_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    for path, what in ((tmp_path, "is a folder"), (tmp_path / "file" / "a", "cannot make")):
        with pytest.raises(GendomError, match=what), atomic_path(path):
            pass


@pytest.mark.parametrize("fault", [errno.ENOSPC, errno.EDQUOT])
@pytest.mark.parametrize("whole", [atomic_path, atomic_folder])
def test_a_full_disk_is_told_in_one_line(tmp_path, whole, fault):
    told = pytest.raises(GendomError, match=r"a\.txt: the disk is full; make room")
    with told as error, whole(tmp_path / "a.txt"):
        raise OSError(fault, os.strerror(fault))
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_other_faults_of_the_system_are_passed_on(tmp_path):
    with pytest.raises(PermissionError), atomic_path(tmp_path / "a.txt"):
        raise PermissionError(errno.EACCES, "no")


def test_a_folder_is_whole_or_absent(tmp_path):
    folder = tmp_path / "new" / "set"
    with pytest.raises(KeyboardInterrupt), atomic_folder(folder) as temporary:
        (temporary / "a").mkdir()
        (temporary / "a" / "b.txt").write_text("half")
        raise KeyboardInterrupt
    assert list(folder.parent.iterdir()) == []
    with atomic_folder(folder) as temporary:
        (temporary / "b.txt").write_text("whole")
        assert not folder.exists()
    assert (folder / "b.txt").read_text() == "whole"
    assert list(folder.parent.iterdir()) == [folder]


def test_a_folder_that_is_there_is_left_alone(tmp_path):
    for there in (tmp_path / "folder", tmp_path / "file"):
        there.mkdir() if there.name == "folder" else there.write_text("")
        with pytest.raises(GendomError, match="is there already"), atomic_folder(there):
            pass
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder"]


def test_a_folder_is_checked_and_not_made(tmp_path):
    check_folder(tmp_path)
    check_folder(tmp_path / "new" / "newer")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("here")
    for place in ("file", "file/below"):
        with pytest.raises(GendomError, match="file: is a file, not a folder; name a folder"):
            check_folder(tmp_path / place)
    with pytest.raises(GendomError, match=r"a\.json: is named like a file.*; name a folder"):
        check_folder(tmp_path / "a.json")


def test_a_file_is_checked_and_not_made(tmp_path):
    check_file(tmp_path / "new" / "a.GIF", ".gif")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(
        GendomError, match=r"a\.mp4: does not end in \.gif.*; name a file that ends"
    ):
        check_file(tmp_path / "a.mp4", ".gif")
    (tmp_path / "b.gif").mkdir()
    with pytest.raises(GendomError, match=r"b\.gif: is a folder; name a file"):
        check_file(tmp_path / "b.gif", ".gif")


def test_places_that_cannot_be_written_are_refused_before_the_work(tmp_path, monkeypatch):
    with pytest.raises(GendomError, match=r"/proc: cannot be written \(.*\); choose another place"):
        check_folder("/proc/nothing")

    class Full:
        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def write(self, content):
            if len(content) > 1_000_000:  # less than a report and its estimate take
                raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", lambda dir: Full())
    with pytest.raises(GendomError, match="the disk is full; make room, or choose another place"):
        check_file(tmp_path / "a.json", ".json")


def test_json_round_trip(tmp_path):
    @dataclass
    class Point:
        x: float

    value = {"a": np.float32(0.5), "b": np.arange(3), "c": None, "d": Point(1.0), "e": Path("f")}
    write_json(tmp_path / "a.json", value)
    assert read_json(tmp_path / "a.json") == {
        "a": 0.5,
        "b": [0, 1, 2],
        "c": None,
        "d": {"x": 1.0},
        "e": "f",
    }


@pytest.mark.parametrize("number", [float("nan"), np.float64("inf")])
def test_json_refuses_what_is_not_finite(tmp_path, number):
    path = tmp_path / "a.json"
    with pytest.raises(GendomError, match=r"a\.json: fit\.E\[1\]: is (nan|inf), which JSON cannot"):
        write_json(path, {"fit": {"E": np.array([1.0, number])}})
    assert not path.exists()


def test_json_refuses_unknown_types():
    with pytest.raises(GendomError, match="a: is a set, which JSON cannot hold"):
        to_json({"a": set()})


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (b"{", r"is not JSON \(.* in line 1\)"),
        (b"[1]", "holds a JSON list, not an object"),
        (b'{"a": NaN}', "NaN is not a JSON number"),
        (b"\xff\xfe", "is not JSON"),
    ],
)
def test_json_that_cannot_be_used(tmp_path, content, what):
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(GendomError, match=what) as caught:
        read_json(tmp_path / "a.json")
    assert "\n" not in str(caught.value)


def test_missing_json(tmp_path):
    with pytest.raises(GendomError, match=r"absent\.json: no such file; check the path"):
        read_json(tmp_path / "absent.json")


def test_json_text_is_strict():
    assert json.loads(to_json({"a": True, "b": "ü"})) == {"a": True, "b": "ü"}


def test_toml_is_read_or_refused_in_one_line(tmp_path):
    path = tmp_path / "object.toml"
    with pytest.raises(RecordingError, match=r"object\.toml: no such file; measure it"):
        read_toml(path, fix="measure it", error=RecordingError)
    path.write_text("length = 0.4")
    assert read_toml(path) == {"length": 0.4}
    path.write_text("length 0.4")
    with pytest.raises(GendomError, match=r"object\.toml: is not TOML"):
        read_toml(path)
    with pytest.raises(GendomError, match="is a folder"):
        read_toml(tmp_path)


def test_only_regular_files_of_some_size_are_read(tmp_path):
    pipe, zero, large = tmp_path / "pipe", tmp_path / "zero.toml", tmp_path / "large.json"
    os.mkfifo(pipe)
    zero.symlink_to("/dev/zero")
    with open(large, "wb") as file:
        file.truncate(1 << 40)
    for path, what in ((pipe, "pipe"), (zero, "device"), (large, "bytes, at most")):
        for read in (read_toml, read_json, read_bytes):
            with pytest.raises(GendomError, match=what):
                read(path)
    with pytest.raises(GendomError, match="cannot be read"):
        read_bytes("a\0b")


def test_a_link_to_a_file_is_read(tmp_path):
    (tmp_path / "real").write_text("x = 1")
    (tmp_path / "link.toml").symlink_to(tmp_path / "real")
    assert read_toml(tmp_path / "link.toml") == {"x": 1}


@pytest.mark.parametrize("name", ["/etc/passwd", "../x.png", "a/../../x.png", "C:\\x", "a\0b"])
def test_names_that_lead_out_of_a_folder(tmp_path, name):
    with pytest.raises(RecordingError, match=r"^line 3: .* is not in"):
        inside(tmp_path, name, where="line 3")


def test_names_of_windows_stay_inside(tmp_path):
    assert inside(tmp_path, r"depth\0.png", where="") == tmp_path / "depth" / "0.png"


@pytest.mark.parametrize(
    "content",
    [
        "[" * 100_000,
        '{"a":' * 100 + "1" + "}" * 100,
        '{"a": ' + "9" * 401 + "}",
        '{"a": [1e400]}',
        '{"a": ' + "9" * 5000 + "}",
    ],
    ids=["deep list", "deep object", "long integer", "overflow", "too many digits"],
)
def test_json_beyond_bounds(tmp_path, content):
    path = tmp_path / "x.json"
    path.write_text(content)
    with pytest.raises(GendomError, match=r"x\.json: is not JSON \("):
        read_json(path)


@pytest.mark.parametrize(
    "content",
    ["x = " + "[" * 9000, "x = " + "9" * 400, "x = " + "9" * 5000, "a" + ".a" * 30_000 + " = 1"],
    ids=["deep", "long integer", "too many digits", "long key"],
)
def test_toml_beyond_bounds(tmp_path, content):
    path = tmp_path / "x.toml"
    path.write_text(content)
    with pytest.raises(GendomError, match=r"x\.toml: is not TOML \("):
        read_toml(path)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_byte_order_marks(tmp_path, encoding):
    path = tmp_path / "x"
    path.write_text("x = 1\n", encoding=encoding)
    assert read_toml(path) == {"x": 1}
    path.write_text('{"x": 1}\n', encoding=encoding)
    assert read_json(path) == {"x": 1}
    path.write_text("x,y\n1,2\n", encoding=encoding)
    assert read_rows(path, header="x,y") == [(1, ["x", "y"]), (2, ["1", "2"])]
