"""Files are whole or absent, and JSON holds no NaN."""

import errno
import io
import os
import tempfile
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gendom.errors import GendomError
from gendom.files import atomic_folder, atomic_path, check_file, check_folder, write_json
from gendom.reading import read_json


def test_success_replaces_and_leaves_nothing_else(tmp_path):
    path, folder = tmp_path / "new" / "a.txt", tmp_path / "newer" / "set"
    for text in ("one", "two"):
        with atomic_path(path) as temporary:
            assert temporary.parent == path.parent and temporary.suffix == ".txt"
            temporary.write_text(text)
        assert path.read_text() == text
    with atomic_folder(folder) as temporary:
        (temporary / "b.txt").write_text("whole")
        assert not folder.exists()
    assert (folder / "b.txt").read_text() == "whole"
    assert [*path.parent.iterdir(), *folder.parent.iterdir()] == [path, folder]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, PermissionError])
def test_failure_keeps_the_old_file_and_makes_no_folder(tmp_path, error):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(error), atomic_path(path) as temporary:
        temporary.write_text("half")
        raise error
    with pytest.raises(error), atomic_folder(tmp_path / "set") as temporary:
        (temporary / "a").mkdir()
        (temporary / "a" / "b.txt").write_text("half")
        raise error
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("fault", [errno.ENOSPC, errno.EDQUOT])
@pytest.mark.parametrize("whole", [atomic_path, atomic_folder])
def test_a_full_disk_is_told_in_one_line(tmp_path, whole, fault):
    told = pytest.raises(GendomError, match=r"^.*/a\.txt: the disk is full; make room.*$")
    with told, whole(tmp_path / "a.txt"):
        raise OSError(fault, os.strerror(fault))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("use", "place", "said"),
    [
        (atomic_folder, "b.gif", "is there already"),
        (atomic_folder, "file", "is there already"),
        (atomic_path, "b.gif", "is a folder"),
        (atomic_path, "file/a", "cannot make"),
        (check_folder, "", None),
        (check_folder, "new/newer", None),
        (check_folder, "file", "file: is a file, not a folder; name a folder"),
        (check_folder, "file/below", "file: is a file, not a folder; name a folder"),
        (check_folder, "a.json", r"a\.json: is named like a file.*; name a folder"),
        (check_folder, "/proc/nothing", r"/proc: cannot be written \(.*\); choose another place"),
        (partial(check_file, ending=".gif"), "new/a.GIF", None),
        (partial(check_file, ending=".gif"), "a.mp4", r"a\.mp4: does not end in \.gif.*; name a"),
        (partial(check_file, ending=".gif"), "b.gif", r"b\.gif: is a folder; name a file"),
    ],
)
def test_places_are_checked_and_left_alone(tmp_path, use, place, said):
    (tmp_path / "file").touch()
    (tmp_path / "b.gif").mkdir()
    with pytest.raises(GendomError, match=said) if said else nullcontext():
        found = use(tmp_path / place)
        with found or nullcontext():
            pass
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b.gif", "file"]


def test_a_disk_without_room_is_refused_before_the_work(tmp_path, monkeypatch):
    class Full(io.BytesIO):
        def write(self, content):
            if len(content) > 1_000_000:  # less than a report and its estimate take
                raise OSError(errno.ENOSPC, "No space left on device")
            return len(content)

    monkeypatch.setattr(tempfile, "TemporaryFile", lambda dir: Full())
    with pytest.raises(GendomError, match="the disk is full; make room, or choose another place"):
        check_file(tmp_path / "a.json", ".json")


def test_json_round_trip(tmp_path):
    @dataclass
    class Point:
        x: float

    value = {"a": np.float32(0.5), "b": np.arange(3), "c": None, "d": Point(1.0), "e": Path("ü")}
    write_json(tmp_path / "a.json", value)
    expected = {"a": 0.5, "b": [0, 1, 2], "c": None, "d": {"x": 1.0}, "e": "ü"}
    assert read_json(tmp_path / "a.json") == expected


@pytest.mark.parametrize("odd", [float("nan"), np.float64("inf"), set()])
def test_json_refuses_what_it_cannot_hold(tmp_path, odd):
    path = tmp_path / "a.json"
    match = r"a\.json: fit\.E\[1\]: is (nan|inf|a set), which JSON cannot hold"
    with pytest.raises(GendomError, match=match):
        write_json(path, {"fit": {"E": [1.0, odd]}})
    assert not path.exists()
