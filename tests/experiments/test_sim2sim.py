"""The paper's lift, made exactly, and what the default method finds in it."""

import json

import numpy as np
import pytest

import experiments.sim2sim as module
from experiments.__main__ import main
from experiments.sim2sim import (
    scene_settings,
    sim2sim,
    sim2sim_problem,
    sim2sim_recording,
    truth_of,
)


@pytest.mark.parametrize("shows", ["all", "last"])
def test_clouds_are_exact(shows):
    """At the truth markers lie on the simulated line, as well as float32 holds them."""
    settings = scene_settings(fast_frames=20)
    recording = sim2sim_recording(3000.0, 0.35, settings=settings, frames=20, rise=0.2, shows=shows)
    assert [f for f in recording.validate() if f.severity == "error"] == []
    problem = sim2sim_problem(recording, settings=settings)
    truth = problem.prior.vector(truth_of(3000.0, 0.35))
    (comparison,) = problem.compare([truth], derivatives=False)
    assert comparison is not None and comparison.rms < 3e-8
    assert np.all((problem.prior.low < truth) & (truth < problem.prior.high))


@pytest.mark.slow
def test_estimates_end_at_the_truth_from_every_start():
    """Where searches end early without leaps (seed 0, the fourth object)."""
    row = sim2sim("gauss-newton", truths=4, starts=5)
    assert row["E_worst"] < 0.01 and row["nu_worst"] < 1e-5 and row["chamfer"] < 1e-6


def test_the_table_has_the_paper_s_numbers_below_ours(monkeypatch, tmp_path, capsys):
    """With errors that are known; the table itself takes minutes."""
    monkeypatch.setattr(module, "sim2sim_recording", lambda *_, **__: None)
    monkeypatch.setattr(module, "_errors", lambda *_: (-2.0, 0.5, 0.25))
    words = ["sim2sim", "--method", "adam", "--seed", "3", "--out", str(tmp_path)]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "adam, last frames, in the paper" in told and "13.74" in told
    result = json.loads((tmp_path / "sim2sim.json").read_text())
    assert result["seed"] == 3 and [row["frames"] for row in result["rows"]] == ["all", "last"]
    (row, _) = result["rows"]
    assert (row["E"], row["nu"], row["chamfer"], row["E_worst"]) == (2.0, 0.5, 0.25, 2.0)
    assert "python -m experiments sim2sim --method adam" in (tmp_path / "sim2sim.txt").read_text()
