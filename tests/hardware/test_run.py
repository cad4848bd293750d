"""`gendom run`: steps that are skipped and done again; and all of it on simulated devices."""

import json

import numpy as np
import pytest

from gendom import cli
from gendom.cli.run import _Steps
from gendom.hardware.execution import read_log
from gendom.reading import read_json
from simulated_cell import write_cell


def test_finished_steps_are_skipped_and_those_of_changed_inputs_are_not(tmp_path):
    done, start = [], tmp_path / "input.txt"
    start.write_text("one")

    def run(breaks=""):
        done.clear()
        steps = _Steps(tmp_path)

        def made(to, inputs, text, within=""):
            def do(place):
                done.append(to)
                if to == breaks:
                    raise KeyboardInterrupt
                (place / within).parent.mkdir(exist_ok=True)
                (place / within).write_text(text)

            return steps.do(to, to, inputs, do)

        first = made("first", [start], start.read_text()[:3])
        folder = made("folder", [first], first.read_text(), "inside.txt")
        made("last", [folder], "x")
        return list(done)

    with pytest.raises(KeyboardInterrupt):
        run(breaks="folder")
    assert done == ["first", "folder"]
    assert run() == ["folder", "last"]
    assert run() == []
    start.write_text("one, more")  # the first step makes the same of it
    assert run() == ["first"]
    start.write_text("two")
    assert run() == ["first", "folder", "last"]
    assert (tmp_path / "folder.before-1" / "inside.txt").read_text() == "one"
    (tmp_path / "last").unlink()
    assert run() == ["last"]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["record", "--yes"], "has no camera; add two"),
        (["run", "cloth-spreading"], "rope-cotton: is a rope, cloth-spreading takes a cloth"),
        (["run", "rope-reaching"], "--goal: has 0 numbers; give 1"),
        (["run", "rope-reaching", "--goal", "0.45", "--executions", "0"], "--executions: is 0"),
    ],
)
def test_what_cannot_be_run(tmp_path, refused, words, line):
    cell = write_cell(tmp_path, cameras=False)
    assert line in refused(*words, "--cell", cell, "--out", tmp_path / "run")


@pytest.mark.slow
def test_from_lift_to_adapted_second_execution(tmp_path, monkeypatch, capsys):
    """On simulated devices, with the noise of cameras and the errors of their calibration."""
    pytest.importorskip("mujoco", reason="needs mujoco: the extra reality")
    asked = []
    monkeypatch.setattr("builtins.input", lambda question: asked.append(question) or "move")
    cell, out = write_cell(tmp_path), tmp_path / "run"
    words = ["run", "rope-reaching", "--goal", "0.45", "--cell", str(cell), "--out", str(out)]
    assert cli.main(words) == 0, capsys.readouterr().err
    assert len(asked) == 3  # the lift and two executions
    found = [read_json(out / f"reached-{k}.json")["executions"][0] for k in (1, 2)]
    misses = [abs(f["reached"][0] - 0.45) for f in found]
    assert max(misses) < 0.015
    best = read_json(out / "best.json")["action"]
    assert best == read_json(out / f"action-{1 + int(np.argmin(misses))}.json")["action"]
    said = read_json(out / "lift" / "recording.json")
    assert said["ended"] == "done" and all(c["missing"] == 0 for c in said["cameras"].values())
    assert all(abs(offset) < 3.0 * sd + 2e-3 for offset, sd in said["clocks"].values())
    estimate = read_json(out / "estimate.json")
    assert estimate["verdict"]["usable"]
    assert np.log(estimate["E_over_rho"] / 962.5) == pytest.approx(0.0, abs=0.2)
    learnt = read_json(out / "adapted-2.json")["executions"]["rope-reaching"]
    assert [e["action"] for e in learnt] == [f["action"] for f in found]
    logs = sorted((out / "executions").glob("*.jsonl"))
    assert len(logs) == 3 and all(read_log(log).end == "done" for log in logs)
    capsys.readouterr()
    assert cli.main(words) == 0 and len(asked) == 3  # nothing is done twice
    assert json.loads((out / "run.json").read_text()).keys() >= {"lift", "observe 2", "adapt 2"}
