"""Tables of policies, in worlds solved in closed form."""

import json
from dataclasses import dataclass

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra `train`")
pytest.importorskip("onnx", reason="needs the extra `train`")

from experiments import ablation as ablation_module
from experiments import rope_real as rope_real_module
from experiments.ablation import ablation, curves_of
from experiments.generalization import PAPER, generalization, table_of
from experiments.r2s2r import identify
from experiments.rope_real import rope_real, shown_of
from experiments.runs import Chart, Runs, TrainingJob
from gendom.errors import ParameterError, SimulationError
from gendom.materials import with_dimensionless
from gendom.materials.estimate import Estimate
from gendom.policies.adaptation import Execution
from gendom.policies.belief import believed
from gendom.policies.fitting import Training
from gendom.reality import find_object
from gendom.tasks import RopeReaching
from gendom.tasks.demonstrator import Demonstrator
from policies.conftest import ROPE, TASK, Throws


@dataclass(frozen=True, kw_only=True)
class Thrown(Throws):
    """Takes what worlds of tables are made with."""

    robot: bool = True
    jobs: int = 1


@pytest.fixture(autouse=True)
def in_closed_form(monkeypatch):
    monkeypatch.setattr(Runs, "training_world", lambda *_: Thrown())
    monkeypatch.setattr(ablation_module, "simulation", lambda *_: Thrown())
    monkeypatch.setattr(rope_real_module, "Simulation", lambda **_: Thrown())


@pytest.fixture
def runs(tmp_path) -> Runs:
    return Runs(folder=tmp_path / "table")


def test_policies_are_trained_unless_they_are_there(runs):
    data = runs.demonstrations("set", Demonstrator(task=RopeReaching(), world=Thrown()), 200)

    def job(epochs):
        return TrainingJob(demonstrations=data, training=Training(epochs=epochs))

    made = []
    for epochs in (1, 1, 2):
        (policy,) = runs.policies({"a": job(epochs)}).values()
        made.append((policy.description, (runs.folder / "a.onnx").stat().st_mtime_ns))
    assert made[0] == made[1] and made[2][0].training["epochs"] == 2


@pytest.mark.slow
def test_ablation_has_all_rows_and_parameters_that_count_help(runs):
    settings = ablation_module.Settings(
        demonstrations=400, epochs=25, goals=(5, 20), seeds=1, curve=(25, 500), steps=20, refine=4
    )
    result = ablation(runs, settings)
    rows, curve = result["rows"], result["by_demonstrations"]
    assert set(rows) == {f"{m}, {s}" for m in ("inverse", "distal", "refined")
                         for s in ("both", "E", "nu", "none")} | {"polished, both"}  # fmt: skip
    assert set(curve) == {"inverse, 25", "distal, 25"}  # no more than there are
    error = {name: row["20"]["mean"] for name, row in rows.items()}
    assert error["distal, both"] < 0.5 * curve["distal, 25"]["20"]["mean"]
    assert error["polished, both"] < 1e-4 < 1.5 * error["distal, both"] < error["distal, none"]
    low, high = rows["distal, both"]["20"]["interval_95"]
    assert low < error["distal, both"] < high
    x, y = (curves_of(result).lines or {})["distal"]
    assert list(x) == [25.0, 400.0] and y[1] == error["distal, both"]


def test_generalization_has_both_domains_and_what_r2s2r_found(runs, monkeypatch):
    monkeypatch.setattr("experiments.generalization.IDENTIFIED_FROM", 6)
    settings = ablation_module.Settings(
        demonstrations=100, epochs=3, goals=(6,), seeds=1, steps=20, refine=1
    )
    result = generalization(runs, settings)
    for domain in ("in domain", "outside"):
        rows = result["rows"][domain]
        assert rows["ours, polished"]["6"]["mean"] < 1e-3
        assert {"ours", "R2S2R, three ropes, inverse", "R2S2R, cotton rope, refined"} <= set(rows)
        assert "0.0" in str(table_of(domain, rows, PAPER[domain]))
    assert result["identified"]["R2S2R, cotton rope"]["misfit"] < 1e-3
    assert result["identified"]["R2S2R, three ropes"]["misfit"] > 1e-3


@pytest.mark.slow
def test_real_ropes_have_all_rows_and_go_on(runs, monkeypatch):
    """The second reality reaches farther by 0.02: executions teach that."""
    real = Thrown(off=0.02)
    monkeypatch.setattr("gendom.reality.RealWorld", lambda **_: real)

    def lifted(self, name, task):
        m = (rope := find_object(name)).material
        posterior = {"names": ["E_over_rho", "damping"],
                     "mean": np.log([1.03 * m.E_over_rho, m.damping]).tolist(),
                     "covariance": [[0.04**2, 0.0], [0.0, 0.1**2]]}  # fmt: skip
        return believed(Estimate.of(rope, posterior), task)

    def demonstrator(world=None, **given):
        return Demonstrator(world=world or Thrown(), **given)

    monkeypatch.setattr(Runs, "lifted", lifted)
    monkeypatch.setattr(rope_real_module, "Demonstrator", demonstrator)
    settings = rope_real_module.Settings(
        goals=3, demonstrations=200, real=20, epochs=3, steps=30, executions=2, refine=4
    )
    result = rope_real(runs, settings)
    rows = result["errors"]
    assert {"ours", "shipped", "sim+real", "sim+real, few", "pi_RD", "pi_RD, inverse", "R2S2R",
            "R2S2R, inverse", "inverse", "polished"} <= set(rows)  # fmt: skip
    assert all(len(errors) == 9 for errors in rows.values())
    here = result["simulated"]  # where nothing is off
    assert "R2S2R" in here and np.median(here["ours"]) < np.median(rows["ours"])
    # some of the goals lie beyond the reach of these ropes
    middle = {name: np.median(errors) for name, errors in rows.items()}
    assert middle["polished, 2 executions"] < middle["polished, 1 execution"] < middle["polished"]
    assert middle["polished, no lift"] > 2.0 * middle["polished"]  # knows no rope
    assert middle["polished"] == pytest.approx(0.02 * 0.3, rel=0.5)
    assert result["made_of"]["simulator"] == pytest.approx(0.02 * 0.3, rel=1e-3)
    goals = np.ravel(result["goals"])
    assert (np.diff(goals[::3]) > 0.0).all()  # evenly over the reach of each rope
    # the best of each search is taken, and all are told
    assert all(len(result["searches"][f"{row}, inverse"]) == 8 for row in ("pi_RD", "R2S2R"))
    *shown, after = shown_of(json.loads(json.dumps(result)))
    assert isinstance(after, Chart) and after.lines is not None
    assert after.lines["median"][0] == [0, 1, 2]
    assert after.lines["median"][1][0] == pytest.approx(1e3 * middle["polished"])
    lines = "\n".join(map(str, shown))
    assert "polished, 1 execution" in lines and "0.112" in lines


def test_r2s2r_explains_one_object():
    there = with_dimensionless(ROPE, {"bending_ratio": 0.5, "damping": 0.03})
    actions = TASK.sample_actions(there, np.random.default_rng(0), 8)
    outcomes = Throws().carry_out(TASK, [there] * 8, actions)
    seen = [
        (ROPE, Execution(action=a, reached=np.array([o.values["x"]])))
        for a, o in zip(actions, outcomes, strict=True)
    ]
    found = identify(TASK, seen, world=Throws())
    # E and damping move the reach alike: what they reach is found, not each of them
    E, damping = (found.parameters[n] for n in ("bending_ratio", "damping"))
    value = 0.6 * np.log(E / 0.4) - 6.0 * (damping - 0.02)
    assert value == pytest.approx(0.6 * np.log(0.5 / 0.4) - 6.0 * 0.01, abs=1e-3)
    assert found.misfit < 1e-4 and found.executions == 8
    assert identify(TASK, seen, world=Throws()) == found
    # nothing to learn from is told
    with pytest.raises(ParameterError, match="no executions"):
        identify(TASK, [], world=Throws())
    with pytest.raises(SimulationError, match="no parameters could be simulated"):
        identify(TASK, seen, world=Throws(fails=True), generations=1)
