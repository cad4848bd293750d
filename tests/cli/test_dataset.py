"""`gendom dataset`: a set on disk, its summary, and faults as one line."""

import errno
import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from gendom import cli
from gendom.tasks.task import Outcome
from gendom.tasks.world import Simulation


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """A world that reaches twice as far as the release; every fifth demonstration fails."""

    def carry_out(self, task, items, actions, **_):
        if self.device == "ctrl-c":
            raise KeyboardInterrupt
        return [
            Outcome(values={"x": 2.0 * a[0], "sideways": 0.0}, fault=None if k % 5 else "diverged")
            for k, a in enumerate(np.asarray(actions))
        ]

    monkeypatch.setattr(Simulation, "carry_out", carry_out)


def test_text(tmp_path, capsys):
    folder = tmp_path / "set"
    assert cli.main(["dataset", "rope-reaching", "--size", "10", "--out", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert out.startswith(f"{folder}: 10 demonstrations of rope-reaching, 2 of them failed\n")
    assert "goal_x" in out and err == ""  # no bar without a terminal


def test_json(tmp_path, capsys):
    words = ["dataset", "rope-reaching", "--size", "10", "--out", str(tmp_path / "set")]
    assert cli.main([*words, "--seed", "3", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["path"] == str(tmp_path / "set")
    assert (summary["size"], summary["failed"], summary["seed"]) == (10, 2, 3)
    goals = summary["goals"]["goal_x"]
    assert 0.1 <= goals["min"] <= goals["median"] <= goals["max"] <= 0.5
    assert len(list((tmp_path / "set").glob("shard-*.parquet"))) == 1
    assert cli.main([*words, "--seed", "4"]) == 2
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


def test_ranges_can_be_chosen(tmp_path, capsys):
    words = ["dataset", "rope-reaching", "--size", "10", "--out", str(tmp_path / "set")]
    assert cli.main([*words, "--range", "E_over_rho", "300", "310", "--json"]) == 0
    about = json.loads((tmp_path / "set" / "dataset.json").read_text())
    assert about["task"]["ranges"]["E_over_rho"] == [300.0, 310.0]
    assert about["task"]["ranges"]["nu"] == [0.2, 0.4]
    assert cli.main([*words, "--range", "mass", "1", "2"]) == 2
    assert "unknown parameter 'mass'" in capsys.readouterr().err


def test_a_full_disk(tmp_path, monkeypatch, capsys):
    def fill(*_, **__):
        raise OSError(errno.ENOSPC, "Error writing bytes to file")

    words = ["dataset", "rope-reaching", "--size", "10", "--out", str(tmp_path / "set")]
    with monkeypatch.context() as full:
        full.setattr(pq, "write_table", fill)
        assert cli.main(words) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "the disk is full; make room" in err
    assert cli.main(words) == 0


def test_a_set_that_is_spoilt(tmp_path, capsys):
    """A damaged shard is simulated again; a set of another format is left alone."""
    folder = tmp_path / "set"
    words = ["dataset", "rope-reaching", "--size", "10", "--out", str(folder)]
    assert cli.main(words) == 0
    whole = (folder / "shard-00000.parquet").read_bytes()
    (folder / "shard-00000.parquet").write_bytes(whole[:200])
    capsys.readouterr()
    assert cli.main(words) == 0
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "is damaged" in err and "simulating it again" in err
    assert (folder / "shard-00000.parquet").read_bytes() == whole
    about = json.loads((folder / "dataset.json").read_text())
    (folder / "dataset.json").write_text(json.dumps(about | {"format": "gendom-demonstrations/9"}))
    assert cli.main(words) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "has the format 'gendom-demonstrations/9'" in err
    assert (folder / "shard-00000.parquet").read_bytes() == whole
