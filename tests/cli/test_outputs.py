"""Places for results: refused before the work, and named after it."""

import io
import json
import sys

import pytest

from gendom import cli

FOLDERS = {
    "demo": [],
    "record": ["--reality", "absent"],
    "dataset": ["rope-casting", "--size", "4"],
    "export": ["absent"],
}
FILES = {
    "replay": (["absent.npz", "--params", "absent.json", "--out", "a.json", "--gif"], ".gif"),
    "act": (["rope-casting", "--policy", "absent.onnx", "--out"], ".json"),
    "train": (["rope-casting", "--data", "absent", "--out"], ".onnx"),
    "perceive": (["absent", "--out"], ".npz"),
    "calibrate": (["absent", "--camera", "absent.toml", "--out"], ".toml"),
}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "file"
    path.write_text("here")
    return path


@pytest.mark.parametrize("name", [*FOLDERS, *FILES])
def test_a_place_that_cannot_be_is_refused_before_the_work(name, file, capsys):
    if name in FOLDERS:
        words, not_one = [*FOLDERS[name], "--out"], "is a file, not a folder"
        cases = {file: not_one, file / "below": not_one}
        cases[file.with_name("a.json")] = "is named like a file"
    else:
        words, ending = FILES[name]
        cases = {
            file.with_name("a.mp4"): f"does not end in {ending}, which is what is written",
            file / f"a{ending}": "is a file, not a folder",
        }
    for place, text in cases.items():
        assert cli.main([name, *words, str(place)]) == 2
        printed = capsys.readouterr()
        assert printed.out == "" and text in printed.err


ODD = "a\x1b[31mb\nc\x9b\u202e\udcff"
"""A name that colours a terminal, fills two lines, turns what follows and is not UTF-8."""


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("flags", [[], ["--json"]])
def test_names_are_printed_escaped(tmp_path, capsys, flags):
    """In errors, in results for people, and in JSON, which gives the name back."""
    out = tmp_path / ODD / "set"
    words = ["rope-reaching", "--size", "2", "--out", str(out), *flags]
    assert cli.main(["dataset", *words]) == 0
    printed = capsys.readouterr()
    assert cli.main(["check", str(tmp_path / ODD / "no")]) == 2
    for text in (printed.out, capsys.readouterr().err):
        assert r"a\u001b[31mb\nc\u009b\u202e\udcff" in text
        assert all(c.isprintable() for c in text if c != "\n")
    if flags:
        assert json.loads(printed.out)["path"] == str(out)


@pytest.mark.usefixtures("quick")
def test_what_the_locale_lacks_is_escaped(tmp_path, monkeypatch):
    printed = io.TextIOWrapper(io.BytesIO(), "ascii")
    monkeypatch.setattr(sys, "stdout", printed)
    out = str(tmp_path / "ropes-é")
    assert cli.main(["dataset", "rope-reaching", "--size", "2", "--out", out]) == 0
    printed.seek(0)
    assert r"ropes-\u00e9: 2 demonstrations" in printed.read()
