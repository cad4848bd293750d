"""Places for results: refused before the work, and named after it."""

import json
from pathlib import Path

import pytest

from gendom import cli
from gendom.cli.outputs import tell_written

FOLDERS = {
    "estimate": ["absent.npz"],
    "demo": [],
    "record": ["--reality", "absent"],
    "dataset": ["rope-casting", "--size", "4"],
    "export": ["absent"],
}
FILES = {
    "replay": (["absent.npz", "--params", "absent.json"], ".json"),
    "act": (["rope-casting", "--policy", "absent.onnx"], ".json"),
    "train": (["rope-casting", "--data", "absent"], ".onnx"),
    "perceive": (["absent"], ".npz"),
    "calibrate": (["absent", "--camera", "absent.toml"], ".toml"),
}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "file"
    path.write_text("here")
    return path


@pytest.mark.parametrize("name", FOLDERS)
def test_a_folder_that_cannot_be_is_refused_before_the_work(name, file, capsys):
    for place, text in (
        (file, "is a file, not a folder"),
        (file / "below", "is a file, not a folder"),
        (file.with_name("a.json"), "is named like a file"),
    ):
        assert cli.main([name, *FOLDERS[name], "--out", str(place)]) == 2
        printed = capsys.readouterr()
        assert printed.out == "" and text in printed.err


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_cannot_be_is_refused_before_the_work(name, file, capsys):
    words, ending = FILES[name]
    for place, text in (
        (file.with_name("a.mp4"), f"does not end in {ending}, which is what is written"),
        (file / f"a{ending}", "is a file, not a folder"),
    ):
        assert cli.main([name, *words, "--out", str(place)]) == 2
        printed = capsys.readouterr()
        assert printed.out == "" and text in printed.err


def test_animations_are_gif(capsys):
    words = ["replay", "absent.npz", "--params", "absent.json", "--gif", "lift.mp4"]
    assert cli.main(words) == 2
    assert "lift.mp4: does not end in .gif" in capsys.readouterr().err


@pytest.mark.parametrize("as_json", [False, True])
def test_act_prints_then_writes_and_says_so(as_json, tmp_path, capsys):
    out = tmp_path / "action.json"
    words = ["act", "rope-casting", "--goal", "0.35", "0.07", "--no-prediction", "--out", str(out)]
    words += ["--E", "8e5", "--nu", "0.3", "--density", "800", "--length", "0.3"]
    assert cli.main([*words, "--diameter", "0.016", *["--json"] * as_json]) == 0
    printed = capsys.readouterr()
    said = f"written: {out}\n"
    assert (printed.err == said) if as_json else printed.out.endswith(said)
    assert json.loads(out.read_text())["task"] == "rope-casting"
    if as_json:
        assert json.loads(printed.out) == json.loads(out.read_text())


def test_names_that_cannot_be_printed_are_escaped(capsys):
    tell_written(Path("a\nb\x1b[2J.npz"), json=False)
    assert capsys.readouterr().out == "written: a\\nb\\x1b[2J.npz\n"
