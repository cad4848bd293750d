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
        steps = _Steps(tmp_path)

        def work(name, text):
            def do(to):
                done.append(name)
                if name == breaks:
                    raise KeyboardInterrupt
                file = to / "inside.txt" if name == "folder" else to
                file.parent.mkdir(exist_ok=True)
                file.write_text(text)

            return do

        first = steps.do("first", "first.txt", [start], work("first", start.read_text()[:3]))
        folder = steps.do("folder", "folder", [first], work("folder", first.read_text()))
        steps.do("last", "last.txt", [folder], work("last", "x"))
        return [done.pop(0) for _ in list(done)]

    with pytest.raises(KeyboardInterrupt):
        run(breaks="folder")
    assert done == ["first", "folder"]
    done.clear()
    assert run() == ["folder", "last"]
    assert run() == []
    start.write_text("one, more")  # the first step makes the same of it
    assert run() == ["first"]
    start.write_text("two")
    assert run() == ["first", "folder", "last"]
    assert (tmp_path / "folder.before-1" / "inside.txt").read_text() == "one"
    (tmp_path / "last.txt").unlink()
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


@pytest.mark.slow
def test_a_lift_is_recorded_in_a_cell(tmp_path, monkeypatch, capsys):
    pytest.importorskip("mujoco", reason="needs mujoco: the extra reality")
    monkeypatch.setattr("builtins.input", lambda _: "no")
    words = ["record", "--cell", str(write_cell(tmp_path)), "--rise", "0.05", "--out"]
    assert cli.main([*words, str(tmp_path / "none")]) == 2
    assert "was not confirmed; nothing moved" in capsys.readouterr().err
    lift = tmp_path / "lift"
    assert cli.main([*words, str(lift), "--yes"]) == 0
    said = read_json(lift / "recording.json")
    assert said["ended"] == "done" and all(c["missing"] == 0 for c in said["cameras"].values())
    assert all(abs(offset) < 3.0 * sd + 2e-3 for offset, sd in said["clocks"].values())
    (log,) = (tmp_path / "executions").glob("*.jsonl")
    joints = np.loadtxt(lift / "joints.csv", delimiter=",", skiprows=1)
    assert read_log(log).end == "done" and len(joints) == len(read_log(log).time)
    assert cli.main(["perceive", str(lift), "--out", str(tmp_path / "lift.npz")]) in (0, 2)
