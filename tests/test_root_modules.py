"""Arguments, errors, files, progress bars, imports, and what is installed."""

import errno
import importlib
import io
import math
import os
import pickle
import re
import subprocess
import tempfile
import tomllib
from contextlib import nullcontext, redirect_stderr
from dataclasses import dataclass
from datetime import date
from fractions import Fraction
from functools import partial
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from gendom import __version__, installation, progress
from gendom.arguments import (
    check_choice,
    check_integers,
    check_list,
    check_number,
    check_numbers,
    check_type,
    require,
)
from gendom.errors import DatasetError, GendomError, ParameterError, RecordingError, SimulationError
from gendom.files import atomic_folder, atomic_path, check_file, check_folder, write_json
from gendom.installation import clone, how_to_install, version
from gendom.progress import bar, silence
from gendom.reading import read_json

# ---- arguments -----------------------------------------------------------------------------------


def test_numbers_of_many_types_and_arrays_come_back():
    for value in (2, 2.0, np.float32(2.0), np.int64(2), np.array(2.0)):
        assert type(check_number("x", value, above=0.0)) is float
    assert check_numbers("x", [1, 2, 3], (3,), ("K", 3)).dtype == float
    assert check_integers("x", [], ("P",)).shape == (0,)
    assert check_numbers("x", -math.inf, finite=False) == -math.inf


@pytest.mark.parametrize(
    ("check", "message"),
    [
        (lambda: check_number("x", "1.5"), "x must be a number, got '1.5'"),
        (lambda: check_number("x", True), "x must be a number, got True"),
        (lambda: check_number("x", Fraction(1, 2)), "x must be a number, got Fraction(1, 2)"),
        (lambda: check_number("x", -1, above=0.0), "x must be positive and finite, got -1.0"),
        (lambda: check_numbers("x", math.nan, (), finite=False), "x must be a number, got nan"),
        (lambda: check_number("x", 1.0, above=2.0), "x must be finite and above 2.0, got 1.0"),
        (lambda: check_numbers("x", [1.0, -1.0], ("W",), least=0.0),
         "x must be finite and at least 0, got -1.0 at [1]"),
        (lambda: check_numbers("x", [1.0], (3,), ("W", 3)),
         "x must be [3] or [W, 3] numbers, got shape [1]"),
        (lambda: check_numbers("x", [[1], [1, 2]], (), ("W",)),
         "x must be a number or [W] numbers, got [[1], [1, 2]]"),
        (lambda: check_numbers("x", "a" * 99), f"x must be numbers, got '{'a' * 56}..."),
        (lambda: check_integers("x", 1.0, ()), "x must be an integer, got 1.0"),
        (lambda: check_integers("x", [3, 9], ("P",), most=8), "x must be 0 to 8, got 9 at [1]"),
        (lambda: check_integers("x", 0, (), least=1), "x must be at least 1, got 0"),
        (lambda: check_type("x", 1, bool), "x must be True or False, got 1"),
        (lambda: check_type("x", 1, str, optional=True), "x must be a str or None, got 1"),
        (lambda: check_list("x", "ab", str), "x must be a list of str, got 'ab'"),
        (lambda: check_list("x", ["a", 1], str), "x[1] must be a str, got 1"),
    ],
)  # fmt: skip
def test_what_is_refused_is_named(check, message):
    with pytest.raises(ParameterError) as found:
        check()
    assert str(found.value) == message


def test_requirements_and_choices_end_in_one_line():
    require(True, "never said")
    with pytest.raises(DatasetError, match=r"^a file: is empty; fill it$"):
        require(False, "is empty", where="a file", fix="fill it", error=DatasetError)
    check_choice("engine", "thin", ("mpm", "thin"))
    with pytest.raises(ParameterError, match=r"^unknown engine 'thinn'; did you mean 'thin'\?$"):
        check_choice("engine", "thinn", ("mpm", "thin"))
    with pytest.raises(ParameterError, match=r"choose one of mpm, thin$"):
        check_choice("engine", 7, ("mpm", "thin"))


# ---- errors --------------------------------------------------------------------------------------


def test_message_parts():
    assert str(GendomError("is odd")) == "is odd"
    assert str(GendomError("is odd", where="a.json", fix="mend it")) == "a.json: is odd; mend it"
    error = GendomError("is cut short", where="a\nb\x1b[31m.ply", fix="copy it")
    assert str(error) == r"a\nb\u001b[31m.ply: is cut short; copy it"
    assert len(str(GendomError("x" * 10**6))) < 5000
    # of several faults, and between processes
    simulation = SimulationError("x", fix="y", world=1, time=0.5, parameters={"E": 1.0}, particle=7)
    recording = RecordingError(where="a.npz", faults=["one", "two"])
    assert str(recording) == "a.npz: one\na.npz: two"
    for error in (simulation, recording):
        again = pickle.loads(pickle.dumps(error))
        assert (type(again), str(again)) == (type(error), str(error))
        assert again.__dict__ == error.__dict__


# ---- files ---------------------------------------------------------------------------------------


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


FULL = r"^.*/(a\.txt|set): the disk is full; make room.*$"


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (KeyboardInterrupt(), pytest.raises(KeyboardInterrupt)),
        (PermissionError(), pytest.raises(PermissionError)),
        *((OSError(fault, os.strerror(fault)), pytest.raises(GendomError, match=FULL))
          for fault in (errno.ENOSPC, errno.EDQUOT)),
    ],
    ids=["ctrl-c", "no permission", "no space", "no quota"],
)  # fmt: skip
def test_failure_keeps_the_old_file_and_makes_no_folder(tmp_path, error, told):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with told, atomic_path(path) as temporary:
        temporary.write_text("half")
        raise error
    with told, atomic_folder(tmp_path / "set") as temporary:
        (temporary / "a").mkdir()
        (temporary / "a" / "b.txt").write_text("half")
        raise error
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


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
    value |= {"f": date(2026, 1, 2)}
    write_json(tmp_path / "a.json", value)
    expected = {"a": 0.5, "b": [0, 1, 2], "c": None, "d": {"x": 1.0}, "e": "ü", "f": "2026-01-02"}
    assert read_json(tmp_path / "a.json") == expected


@pytest.mark.parametrize("odd", [float("nan"), np.float64("inf"), set()])
def test_json_refuses_what_it_cannot_hold(tmp_path, odd):
    path = tmp_path / "a.json"
    match = r"a\.json: fit\.E\[1\]: is (nan|inf|a set), which JSON cannot hold"
    with pytest.raises(GendomError, match=match):
        write_json(path, {"fit": {"E": [1.0, odd]}})
    assert not path.exists()


# ---- progress ------------------------------------------------------------------------------------


class Terminal(io.StringIO):
    """Stderr as a terminal; `lines` are what stood there one after the other."""

    def isatty(self):
        return True

    @property
    def lines(self):
        return [line for line in re.split("[\r\n]", self.getvalue()) if line.strip()]


def test_iterations_are_counted_and_the_last_line_is_full():
    with redirect_stderr(Terminal()) as file, bar("estimating", 1, "iteration") as show:
        for n in range(5):
            show(n, 12, "12.3 mm off")
    assert " 0%|" in file.lines[0]
    assert any(re.match(r"estimating: 100%.* 4/4, 00:00, 12.3 mm off", x) for x in file.lines)


@pytest.mark.parametrize(
    ("file", "within", "shown"),
    [(Terminal(), silence, True), (Terminal(), nullcontext, False),
     (io.StringIO(), nullcontext, True)],
)  # fmt: skip
def test_nothing_shows_where_it_is_not_wanted(file, within, shown):
    with redirect_stderr(file), within(), bar("acting", 3, "action", shown=shown) as show:
        show(3)
    assert file.getvalue() == "" and not progress._silent


# ---- imports -------------------------------------------------------------------------------------


PACKAGES = ("gendom", "gendom.datasets", "gendom.policies", "gendom.tasks")


HEAVY = {
    "gendom.cli": "numpy torch mujoco warp scipy tyro",
    "gendom.viz": "torch warp gendom.estimation gendom.policies gendom.sim gendom.datasets",
    "gendom.cli.estimate, gendom.cli.replay": "torch warp matplotlib",
    "gendom.policies, gendom.tasks": "torch onnx onnxruntime warp",
    ", ".join(PACKAGES): "torch pyarrow",
}
"""Modules, and what must not have been imported once they and those before them are."""


@pytest.mark.parametrize(
    "heavy", [HEAVY, {"gendom.cli.dataset, gendom.tasks.world": "scipy.spatial scipy.sparse warp"}]
)
def test_nothing_heavy_is_imported_before_it_is_needed(heavy, run_python):
    lines = [f"import {m}; found += {{*{h.split()}}} & {{*sys.modules}}" for m, h in heavy.items()]
    assert run_python("\n".join(["import sys", "found = []", *lines, "print(found)"])) == "[]"


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_there_and_no_other(package):
    for extra in ("torch", "onnx", "pyarrow"):
        pytest.importorskip(extra)
    module = importlib.import_module(package)
    assert all(getattr(module, name) is getattr(module, name) for name in module.__all__)
    with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'nothing'"):
        _ = module.nothing


# ---- installation --------------------------------------------------------------------------------


def test_a_clone_tells_its_commit(tmp_path, monkeypatch):
    """An installed package has none."""
    monkeypatch.setattr(installation, "__file__", str(tmp_path / "src" / "gendom" / "file.py"))
    assert clone() is None and version() == __version__
    assert how_to_install("train") == "pip install 'gendom[train]'"
    (tmp_path / "pyproject.toml").touch()
    who = ["-c", "user.name=a", "-c", "user.email=a@b"]
    for words in (["init"], ["add", "."], [*who, "commit", "-m", "First"]):
        subprocess.run(["git", "-C", str(tmp_path), *words], check=True, capture_output=True)
    assert re.fullmatch(rf"{re.escape(__version__)} \([0-9a-f]{{7,}}\)", version())
    (tmp_path / "pyproject.toml").write_text("[project]")
    assert version().endswith("+)") and clone() == tmp_path
    assert how_to_install("train") == f"pip install -e '{tmp_path}[train]'"


ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_every_extra_is_imported_somewhere():
    from gendom.cli import _EXTRAS

    assert set(_EXTRAS.values()) == set(PROJECT["optional-dependencies"]) - {"dev", "docs"}
    source = "".join(p.read_text(encoding="utf-8") for p in (ROOT / "src").rglob("*.py"))
    for name in _EXTRAS:
        assert re.search(rf"^\s*(import|from) {name}\b", source, re.MULTILINE), name


def test_every_place_states_one_version():
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert cited is not None and PROJECT["version"] == cited[1] == __version__
    assert f"## [{__version__}]" in (ROOT / "CHANGELOG.md").read_text()
    try:
        assert metadata.version("gendom") == __version__
    except metadata.PackageNotFoundError:
        pytest.skip("gendom is not installed")


def test_the_oldest_versions_are_those_that_are_tested():
    """Lower bounds of `pyproject.toml`, but for extras that `make test-lowest` leaves out."""
    extras = PROJECT["optional-dependencies"]
    bounds = [*PROJECT["dependencies"]]
    bounds += [b for extra in ("data", "reality", "camera", "viz", "ros") for b in extras[extra]]
    tested = dict(
        line.split("==")
        for line in (ROOT / "constraints-lowest.txt").read_text().splitlines()
        if "==" in line
    )
    for bound in bounds:
        name, lowest = bound.partition(";")[0].partition(",")[0].split(">=")
        assert f"{tested[name]}.".startswith(f"{lowest}."), bound
