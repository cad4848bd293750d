"""The paper's lift, made exactly; what each method finds in it, and Adam's slopes."""

import json
import math
import os
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

import experiments.sim2sim as module
from experiments.adam import DensityGrid, DensityLoss, _Descent, adam
from experiments.evolution import differential_evolution
from experiments.pointnet import grouped, pointnet, read_network
from experiments.sim2sim import (
    paper_E,
    scene_settings,
    sim2sim,
    sim2sim_problem,
    sim2sim_recording,
    truth_of,
)
from gendom.errors import ParameterError
from gendom.estimation import METHODS, estimate
from gendom.estimation.methods.gauss_newton import gauss_newton
from gendom.estimation.problem import Start
from gendom.estimation.scene import LiftScene

E, NU = 4000.0, 0.3
"""E in the paper's units, and nu."""


@pytest.fixture(scope="module")
def short_lift():
    """Makes the problem of a lift of 0.2 m in 20 frames, of the MPM of 0.05 m in 5; keyword
    arguments go to the settings."""
    recordings = {}

    def make(engine: Literal["thin", "mpm"] = "thin", markers=True, **other):
        settings, frames = scene_settings(engine, fast_frames=20), 20 if engine == "thin" else 5
        key = engine, markers
        if key not in recordings:
            how = {"frames": frames, "rise": 0.01 * frames, "markers": markers}
            recordings[key] = sim2sim_recording(E, NU, settings=settings, **how)
        return sim2sim_problem(recordings[key], settings=settings, starts=1, **other)

    return make


def few_members(problem):
    return differential_evolution(problem, members=5)


@pytest.mark.parametrize(
    ("method", "off", "iterations"),
    [(gauss_newton, 1.0, 30), (adam, 40.0, 10), (few_members, 200.0, 12)],
    ids=["gauss-newton", "adam", "differential-evolution"],
)
def test_a_method_brings_back_the_modulus(short_lift, method, off, iterations):
    told = []
    problem = short_lift(max_iterations=iterations)
    problem._on_progress = told.append
    found = method(problem)
    theta = problem.theta(found.best.vector)
    assert paper_E(theta.E_over_rho) == pytest.approx(E, abs=off)
    assert found.best.comparison.parts[0].J.shape[-1] == 2
    assert not found.interrupted
    assert 0 < told[-1].iteration <= told[-1].most
    assert found.noise[0].sensor < 1e-3


@pytest.mark.parametrize(
    ("engine", "markers", "other"),
    [("thin", True, "nu"), ("thin", False, "nu"), ("mpm", False, "nu"),
     ("thin", True, "grip_height")],
)  # fmt: skip
def test_gradients_are_central_differences(short_lift, engine, markers, other):
    """Of markers, and of skins of rods and of particles. That by the grip's height, which has no
    reverse mode, is a difference itself."""
    problem = short_lift(engine, markers)
    settings = replace(problem.settings, unknowns=("E_over_rho", other))
    problem = type(problem)([problem.scene], settings, known=problem.bases[0])
    loss, vector = DensityLoss(problem), problem.prior.vector(truth_of(3300.0, 0.25))
    descent = _Descent(Start(initial=vector, vector=vector), vector)
    loss.evaluate([descent])
    seen = descent.seen or []
    ends = [(1e-5, -1e-5), (1e-7, -1e-7) if other == "nu" else (problem.prior.step[1], 0.0)]
    for k, (ahead, behind) in enumerate(ends):
        x = problem.positions([vector + h * np.eye(2)[k] for h in (ahead, behind)])
        slope = (loss.value(x[:, 0], seen) - loss.value(x[:, 1], seen)) / (ahead - behind)
        assert descent.gradient[k] == pytest.approx(slope, rel=1e-3, abs=1e-6)
    x = problem.positions([vector])[:, 0]
    assert descent.start.value == pytest.approx(loss.value(x, seen), rel=1e-9)


def test_what_adam_cannot_do_is_said(short_lift, monkeypatch):
    """It reads one recording of an object that is as thick as stated."""
    monkeypatch.setitem(METHODS, "adam", adam)
    problem = short_lift(method="adam")
    lift, settings = problem.scene.recording, problem.settings
    with pytest.raises(ParameterError, match="method adam: reads one recording, got 2"):
        estimate([lift, lift], settings)
    with pytest.raises(ParameterError, match="compares objects as thick as stated"):
        estimate(lift, replace(settings, unknowns=("thickness",)))


def test_clouds_are_exact():
    """At the truth markers lie on the simulated line, as well as float32 holds them."""
    settings = scene_settings(fast_frames=20)
    recording = sim2sim_recording(3000.0, 0.35, settings=settings, frames=20, rise=0.2)
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


def test_the_table_has_the_paper_s_numbers_below_ours(monkeypatch, tmp_path, table):
    """With errors that are known; the table itself takes minutes."""
    monkeypatch.setattr(module, "sim2sim_recording", lambda *_, **__: None)
    monkeypatch.setattr(module, "_errors", lambda *_: (-2.0, 0.5, 0.25))
    told = table("sim2sim", "--method", "adam", "--seed", 3)
    assert "adam, last frames, in the paper" in told and "13.74" in told
    result = json.loads((tmp_path / "sim2sim.json").read_text())
    assert result["seed"] == 3 and [row["frames"] for row in result["rows"]] == ["all", "last"]
    (row, _) = result["rows"]
    assert (row["E"], row["nu"], row["chamfer"], row["E_worst"]) == (2.0, 0.5, 0.25, 2.0)
    assert "python -m experiments sim2sim --method adam" in (tmp_path / "sim2sim.txt").read_text()


def test_the_file_gives_what_torch_gives(tmp_path):
    torch = pytest.importorskip("torch", reason="training needs torch")
    from experiments.pointnet_training import INPUTS, Training, simulated_lifts, train

    settings = scene_settings()
    scene = LiftScene.of(sim2sim_recording(4000.0, 0.3, frames=10), settings)
    thetas = [truth_of(E, nu) for E, nu in ((600.0, 0.2), (2000.0, 0.4), (9000.0, 0.3))]
    clouds, targets = simulated_lifts(scene, thetas)
    assert targets[0, 0] == pytest.approx(
        math.log(scene.bending_length(thetas[0].E_over_rho) / 0.5)
    )
    path, training = tmp_path / "net.onnx", Training(epochs=3)
    network = train(scene, clouds, targets, path, training)
    session, said = read_network(path)
    assert said["lift"] == pytest.approx({"rise": 0.9, "thickness": 0.056})
    made = grouped(clouds)
    with torch.no_grad():
        expected = network(*(torch.from_numpy(made[name]) for name in INPUTS))
    for a, b in zip(session.run(None, made), expected, strict=True):
        np.testing.assert_allclose(a, b.numpy(), atol=1e-5)


def test_the_shipped_network_reads_a_lift(tmp_path):
    problem = sim2sim_problem(sim2sim_recording(E, NU, markers=False, shows="last"))
    found = pointnet(problem)
    off = math.log(paper_E(problem.theta(found.best.vector).E_over_rho) / E)
    assert found.covariance is not None
    sd = math.sqrt(found.covariance[0, 0])
    assert abs(off) < 0.1 and 0.0 < sd < 0.3 and abs(off) < 4.0 * sd
    # a file that is no network is refused
    path = tmp_path / "net.onnx"
    path.write_bytes(os.urandom(100))
    for place in (path, tmp_path / "missing.onnx"):
        with pytest.raises(ParameterError, match="is no network of this method"):
            read_network(place)


GRID = DensityGrid(origin=np.array([-1.0, 0.5, 2.0]), cell=0.1, shape=(20, 12, 16))


def cloud(n, seed=0, *, margin=0.25):
    """[n, 3] points that stay ``margin`` away from the sides of GRID."""
    size = GRID.cell * (np.array(GRID.shape) - 1)
    u = np.random.default_rng(seed).uniform(size=(n, 3))
    return GRID.origin + margin + u * (size - 2.0 * margin)


def shaped(density):
    """Densities on the grid's own axes."""
    return density.reshape(*density.shape[:-1], *GRID.shape)


@pytest.mark.parametrize("n", [1, 200])
def test_density_has_the_clouds_mean(n):
    """Weights of 3 nodes an axis sum to one, the density's centre is the cloud's, and each axis'
    variance is cell^2 / 4 wider. A cloud moved by one cell has the same density one node further.
    Points off the grid count, and weigh nothing."""
    p = cloud(n)
    d = shaped(GRID.splat(p))
    assert d.sum() == pytest.approx(1.0, abs=1e-12) and d.min() >= 0.0
    assert np.count_nonzero(d > 1e-15) <= 27 * n
    for axis in range(3):
        along = d.sum(axis=tuple(a for a in range(3) if a != axis))
        at = GRID.origin[axis] + GRID.cell * np.arange(GRID.shape[axis])
        mean = along @ at
        assert mean == pytest.approx(p[:, axis].mean())
        variance = along @ (at - mean) ** 2
        assert variance == pytest.approx(p[:, axis].var() + GRID.cell**2 / 4.0)
        there = shaped(GRID.splat(p + GRID.cell * np.eye(3)[axis]))
        assert np.allclose(np.roll(d, 1, axis=axis), there, atol=1e-12)
        for away in (GRID.origin, GRID.origin + GRID.cell * (np.array(GRID.shape) - 1)):
            beyond = p.mean(axis=0)
            beyond[axis] = away[axis] + np.sign(away[axis] - beyond[axis]) * 0.5
            with_it = shaped(GRID.splat(np.concatenate([p, beyond[None]])))
            assert np.allclose(with_it, d * n / (n + 1), atol=1e-12)


def test_a_grid_around_points_holds_them():
    """No weight of the points, nor of any within the margin, is lost; the longest side is full."""
    p = np.random.default_rng(3).uniform(size=(40, 3)) * [2.0, 1.0, 0.5]
    grid = DensityGrid.around(p, margin=0.07, resolution=24)
    corners = np.array([p.min(axis=0) - 0.07, p.max(axis=0) + 0.07])
    assert max(grid.shape) == 24 and grid.splat(corners).sum() == pytest.approx(1.0, abs=1e-9)
    assert grid.cell == pytest.approx(np.ptp(corners, axis=0).max() / 21.0)
