"""`gendom dataset`: a set on disk, its summary, and faults as one line."""

import json
from dataclasses import dataclass

import numpy as np
import pytest

from gendom import cli, tasks
from gendom.tasks.base import Outcomes


@dataclass(frozen=True, kw_only=True)
class Quick:
    """Reaches half of its release; every fifth demonstration fails."""

    name = "rope-reaching"
    action_names = ("release_x",)
    goal_names = ("x",)
    parameter_ranges = {"poissons_ratio": (0.2, 0.4)}  # noqa: RUF012

    def settings(self):
        return {"length": 0.25}

    def draw(self, rng):
        return {"release_x": rng.uniform(0.1, 0.2)}

    def demonstrate(self, draws, *, device, dtype, on_frame=None):
        if device == "ctrl-c":
            raise KeyboardInterrupt
        goal = np.array([draw["release_x"] / 2.0 for draw in draws])
        faults: list[str | None] = [None] * len(draws)
        for i in range(0, len(draws), 5):
            goal[i], faults[i] = np.nan, "diverged"
        return Outcomes(columns={"goal_x": goal}, faults=tuple(faults))


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setitem(tasks.TASKS, "rope-reaching", Quick)


def test_text(tmp_path, capsys):
    folder = tmp_path / "set"
    assert cli.main(["dataset", "rope-reaching", "--size", "10", "--out", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert out.startswith(f"{folder}: 10 demonstrations of rope-reaching, 2 of them failed\n")
    assert "goal_x" in out and "0/10" in err


def test_json(tmp_path, capsys):
    words = ["dataset", "rope-reaching", "--size", "10", "--out", str(tmp_path / "set")]
    assert cli.main([*words, "--seed", "3", "--shard-size", "5", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["path"] == str(tmp_path / "set")
    assert (summary["size"], summary["failed"], summary["seed"]) == (10, 2, 3)
    goals = summary["goals"]["goal_x"]
    assert 0.05 <= goals["min"] <= goals["median"] <= goals["max"] <= 0.1
    assert len(list((tmp_path / "set").glob("shard-*.parquet"))) == 2
    assert cli.main([*words, "--seed", "4", "--shard-size", "5"]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("gendom dataset: ") and "seed is 3 there and 4 here" in line


def test_interrupted(tmp_path, capsys):
    words = ["dataset", "rope-reaching", "--size", "3", "--out", str(tmp_path / "set")]
    assert cli.main([*words, "--device", "ctrl-c"]) == 130
    assert capsys.readouterr().err.strip().endswith("gendom dataset: interrupted")


@pytest.mark.parametrize("words", [[], ["rope-reaching"], ["knitting", "--size", "3"]])
def test_words_that_are_not_understood(tmp_path, words, capsys):
    assert cli.main(["dataset", *words, "--out", str(tmp_path / "set")]) == 2
    assert capsys.readouterr().err
    assert not (tmp_path / "set").exists()
