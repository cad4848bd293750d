"""`gendom dataset`: a set on disk, its summary, and faults as one line."""

import json

import pytest

from gendom import cli

pytestmark = pytest.mark.usefixtures("quick")


def test_text_and_json(tmp_path, capsys):
    folder = tmp_path / "set"
    words = ["dataset", "rope-reaching", "--size", "10", "--out", str(folder), "--seed"]
    assert cli.main([*words, "3"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith(f"{folder}: 10 demonstrations of rope-reaching, 2 of them failed\n")
    assert "goal_x" in out and err == ""  # no bar without a terminal
    assert cli.main([*words, "3", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["path"] == str(folder)
    assert (summary["size"], summary["failed"], summary["seed"]) == (10, 2, 3)
    goals = summary["goals"]["goal_x"]
    assert 0.1 <= goals["min"] <= goals["median"] <= goals["max"] <= 0.5
    assert cli.main([*words, "4"]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("gendom dataset: ") and "seed is 3 there and 4 here" in line


def test_interrupted_it_leaves_nothing(tmp_path, capsys):
    words = ["dataset", "rope-reaching", "--size", "3", "--device", "ctrl-c", "--out"]
    assert cli.main([*words, str(tmp_path / "set")]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert not list(tmp_path.rglob("*.parquet"))


def test_ranges_can_be_chosen(tmp_path, capsys):
    words = ["dataset", "rope-reaching", "--size", "10", "--out", str(tmp_path / "set")]
    assert cli.main([*words, "--range", "E_over_rho", "300", "310", "--json"]) == 0
    about = json.loads((tmp_path / "set" / "dataset.json").read_text())
    assert about["task"]["ranges"]["E_over_rho"] == [300.0, 310.0]
    assert about["task"]["ranges"]["nu"] == [0.2, 0.4]
    assert cli.main([*words, "--range", "mass", "1", "2"]) == 2
    assert "unknown parameter 'mass'" in capsys.readouterr().err
