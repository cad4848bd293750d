"""`gendom estimate`: what it prints and writes, and its exit codes."""

import json
import re
import shlex
from dataclasses import replace

import numpy as np
import pytest

from gendom import cli, estimation
from gendom.errors import RecordingError, SimulationError
from gendom.estimation import Estimate
from gendom.reading import read_json

QUICK = ("--starts", "1", "--points", "15")


@pytest.fixture(scope="module")
def lift(rope_lift, tmp_path_factory):
    """A simulated lift's file."""
    path = tmp_path_factory.mktemp("lift") / "lift.npz"
    rope_lift.seen().write(path)
    return path


def test_a_good_lift(lift, tmp_path, capsys):
    """Values with intervals on stdout, and what was written; a report of one file."""
    out, report = tmp_path / "out", tmp_path / "pages" / "report.html"
    words = ["estimate", str(lift), *QUICK, "--out", str(out), "--report", str(report)]
    assert cli.main(words) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    lines = printed.out.splitlines()
    assert lines[0].split() == ["verdict", "usable"]
    assert re.search(r"Young's modulus +7\.\d+e\+05 Pa, 90% in \[", printed.out)
    assert lines[-2:] == [f"written: {out / 'estimate.json'}", f"written: {report}"]
    found = Estimate.load(out / "estimate.json")
    assert found.usable and found.record["simulation"]["points"] == 15
    page = report.read_text(encoding="utf-8")
    assert "The recording and the fit pass every check" in page and "Grip height" in page
    assert "The action" not in page and shlex.join(["gendom", *words]) in page
    # what the page says to try next works
    steps = re.findall("<pre>gendom (.*)</pre>", page[page.index('id="what-to-try-next"') :])
    assert [step.split()[0] for step in steps] == ["check", "replay", "act"]
    for step in steps:
        assert cli.main(shlex.split(step)) == 0, step


def test_two_lifts(rope_lift, lift, tmp_path, capsys):
    """One estimate, with what each says by itself."""
    other, out, report = tmp_path / "other.npz", tmp_path / "out", tmp_path / "report.html"
    rope_lift.seen(seed=1, grip_height=0.004).write(other)
    words = ["estimate", str(lift), str(other), *QUICK, "--out", str(out), "--report", str(report)]
    assert cli.main(words) == 0
    printed = capsys.readouterr().out
    lines = [line.split(maxsplit=1) for line in printed.splitlines()]
    assert [line[1] for line in lines if line[0] == "recording"] == [str(lift), str(other)]
    assert len(re.findall(r"^by itself +E / density [67]\d\d", printed, re.M)) == 2
    page = report.read_text(encoding="utf-8")
    assert f"The first of 2: {lift}." in page and "lift.npz, other.npz" in page
    assert "Grip height, recording 2" in page


def test_json_is_all_of_stdout(lift, tmp_path, capsys, monkeypatch):
    """Results are printed though they cannot be written, where a place is spoiled meanwhile."""
    found = []

    def kept(*given, estimate=estimation.estimate, **others):
        found.append(estimate(*given, **others))
        return found[0]

    monkeypatch.setattr(estimation, "estimate", kept)
    words = ["estimate", str(lift), *QUICK, "--unknowns", "E_over_rho", "--level", "0.5", "--out"]
    assert cli.main([*words, str(tmp_path), "--json"]) == 0
    printed = capsys.readouterr()
    record = json.loads(printed.out)
    assert record == read_json(tmp_path / "estimate.json")
    assert record["posterior"]["names"] == ["E_over_rho", "thickness"]
    assert record["intervals"]["level"] == 0.5
    assert printed.err == f"written: {tmp_path / 'estimate.json'}\n"
    monkeypatch.setattr(estimation, "estimate", lambda *_, **__: found[0])
    (tmp_path / "out" / "estimate.json").mkdir(parents=True)
    assert cli.main([*words, str(tmp_path / "out")]) == 2
    printed = capsys.readouterr()
    assert "Young's modulus" in printed.out and "written" not in printed.out
    assert "estimate.json: is a folder" in printed.err


def test_what_is_not_usable_has_exit_code_3(rope_lift, tmp_path, capsys):
    seen, still = rope_lift.at_rest(5), tmp_path / "still.npz"
    replace(seen, gripper_position=np.repeat(seen.gripper_position[:1], 5, axis=0)).write(still)
    words = ["estimate", str(still), *QUICK, "--out", str(tmp_path)]
    assert cli.main([*words, "--report", str(tmp_path / "report.html")]) == 3
    printed = capsys.readouterr()
    assert "gendom estimate: not usable: the gripper moves by 0 m" in printed.err
    assert printed.out.splitlines()[0].split() == ["verdict", "not", "usable"]
    assert " in [" not in printed.out
    assert read_json(tmp_path / "estimate.json")["intervals"] is None
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Not usable." in page and "the gripper moves by 0 m" in page


@pytest.mark.parametrize("error", [RecordingError("shows too little"), SimulationError("diverged")])
def test_what_cannot_be_simulated_is_not_usable(lift, tmp_path, capsys, monkeypatch, error):
    def estimate(*_, **__):
        raise error

    monkeypatch.setattr("gendom.estimation.estimate", estimate)
    report, file = tmp_path / "report.html", tmp_path / "estimate.json"
    words = ["estimate", str(lift), "--out", str(tmp_path), "--report", str(report), "--json"]
    assert cli.main(words) == 3
    printed = capsys.readouterr()
    assert json.loads(printed.out) == read_json(file)
    assert f"gendom estimate: not usable: {error}\n" in printed.err
    assert read_json(file)["verdict"] == {"usable": False, "reasons": [str(error)]}
    page = report.read_text(encoding="utf-8")
    assert "Not usable." in page and str(error) in page and "The estimate" not in page
