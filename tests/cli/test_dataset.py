"""`gendom dataset`: a set on disk, its summary, and names of places as they are printed."""

import io
import json
import sys

import pytest

from gendom import cli

pytestmark = pytest.mark.usefixtures("quick")
MAKE = ("dataset", "rope-reaching", "--size", "10", "--out")
ODD = "a\x1b[31mb\nc\x9b\u202e\udcff"
"""A name that colours a terminal, fills two lines, turns what follows and is not UTF-8."""


def test_text_and_json(tmp_path, capsys, refused):
    words = [*MAKE, str(tmp_path / "set"), "--range", "E_over_rho", "300", "310", "--seed"]
    assert cli.main([*words, "3"]) == 0
    out, err = capsys.readouterr()
    line = f"{tmp_path / 'set'}: 10 demonstrations of rope-reaching, 2 of them failed\n"
    assert out.startswith(line) and "goal_x" in out and err == ""  # no bar without a terminal
    assert cli.main([*words, "3", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["path"] == str(tmp_path / "set")
    assert (summary["size"], summary["failed"], summary["seed"]) == (10, 2, 3)
    goals = summary["goals"]["goal_x"]
    assert 0.1 <= goals["min"] <= goals["median"] <= goals["max"] <= 0.5
    about = json.loads((tmp_path / "set" / "dataset.json").read_text())
    assert about["task"]["ranges"]["E_over_rho"] == [300.0, 310.0]
    assert about["task"]["ranges"]["nu"] == [0.2, 0.4]
    assert "seed is 3 there and 4 here" in refused(*words, "4")
    told = refused(*MAKE, tmp_path / "other", "--range", "mass", "1", "2")
    assert "unknown parameter 'mass'" in told


def test_interrupted_it_leaves_nothing(tmp_path, capsys):
    assert cli.main([*MAKE, str(tmp_path / "set"), "--device", "ctrl-c"]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert not list(tmp_path.rglob("*.parquet"))


@pytest.mark.parametrize("flags", [[], ["--json"]])
def test_names_are_printed_escaped(tmp_path, capsys, flags):
    """In errors, in results for people, and in JSON, which gives the name back."""
    out = tmp_path / ODD / "set"
    assert cli.main([*MAKE, str(out), *flags]) == 0
    printed = capsys.readouterr()
    assert cli.main(["check", str(tmp_path / ODD / "no")]) == 2
    for text in (printed.out, capsys.readouterr().err):
        assert r"a\u001b[31mb\nc\u009b\u202e\udcff" in text
        assert all(c.isprintable() for c in text if c != "\n")
    if flags:
        assert json.loads(printed.out)["path"] == str(out)


def test_what_the_locale_lacks_is_escaped(tmp_path, monkeypatch):
    printed = io.TextIOWrapper(io.BytesIO(), "ascii")
    monkeypatch.setattr(sys, "stdout", printed)
    assert cli.main([*MAKE, str(tmp_path / "ropes-é")]) == 0
    printed.seek(0)
    assert r"ropes-\u00e9: 10 demonstrations" in printed.read()
