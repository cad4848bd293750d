"""Each method brings back what a short simulated lift was made with; Adam's slopes are right; and
when an estimate searches the whole prior."""

import importlib
from dataclasses import replace

import numpy as np
import pytest

from experiments.sim2sim import paper_E, truth_of
from gendom.estimation import EstimateSettings, LiftScene, estimate
from gendom.estimation.likelihood import Comparisons
from gendom.estimation.methods.adam import DensityLoss, _Descent, adam
from gendom.estimation.methods.differential_evolution import (
    differential_evolution,
    distance,
    nearest,
)
from gendom.estimation.methods.gauss_newton import gauss_newton
from gendom.estimation.methods.search import finished
from gendom.estimation.problem import Problem, Start

E, NU = 4000.0, 0.3


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


@pytest.mark.parametrize("method", [adam, few_members], ids=["adam", "differential-evolution"])
def test_an_interrupted_method_keeps_its_best(short_lift, method):
    problem = short_lift()

    def stop(progress):
        if progress.iteration == 2:
            raise KeyboardInterrupt

    problem._on_progress = stop
    found = method(problem)
    assert found.interrupted
    assert found.best.iterations == 2
    assert found.best.comparison is not None


@pytest.mark.slow
def test_evolution_is_seeded(short_lift):
    ends = [few_members(short_lift(max_iterations=3, seed=s)).best.vector for s in (1, 1, 2)]
    np.testing.assert_array_equal(ends[0], ends[1])
    assert (ends[0] != ends[2]).any()


# ---- slopes of the density loss -----------------------------------------------------------------


@pytest.mark.parametrize("markers", [True, False])
@pytest.mark.parametrize("engine", ["thin", "mpm"])
def test_gradients_are_central_differences(short_lift, engine, markers):
    problem = short_lift(engine, markers)
    loss = DensityLoss(problem)
    vector = problem.prior.vector(truth_of(3300.0, 0.25))
    descent = _Descent(Start(initial=vector, vector=vector), vector)
    loss.evaluate([descent])
    assert descent.seen is not None
    for k, h in enumerate((1e-5, 1e-7)):
        x = problem.positions([vector + s * h * np.eye(2)[k] for s in (1.0, -1.0)])
        ahead, behind = (loss.value(x[:, w], descent.seen) for w in range(2))
        assert descent.gradient[k] == pytest.approx(
            (ahead - behind) / (2.0 * h), rel=1e-3, abs=1e-6
        )
    assert descent.start.value == pytest.approx(
        loss.value(problem.positions([vector])[:, 0], descent.seen), rel=1e-9
    )


def test_gradients_by_how_it_is_held_are_differences(short_lift):
    """Unknowns without a reverse mode, here the grip's height."""
    problem = short_lift()
    wide = type(problem)(
        [problem.scene],
        type(problem.settings)(
            unknowns=("E_over_rho", "grip_height"), scene=problem.settings.scene
        ),
        known=problem.bases[0],
    )
    loss = DensityLoss(wide)
    vector = wide.prior.vector(truth_of(3300.0, 0.25))
    descent = _Descent(Start(initial=vector, vector=vector), vector)
    loss.evaluate([descent])
    assert descent.seen is not None
    h = wide.prior.step[1]
    x = wide.positions([vector, vector + np.array([0.0, h])])
    here, beside = (loss.value(x[:, w], descent.seen) for w in range(2))
    assert descent.gradient[1] == pytest.approx((beside - here) / h, rel=1e-6)
    assert abs(descent.gradient[1]) > 0.1


# ---- a search that went astray -------------------------------------------------------------------


estimation = importlib.import_module("gendom.estimation.estimate")


def test_the_nearest_replay_comes_near(cloth_lift):
    """Of a cloth held far from where its prior says."""
    held = {"grip_along": 0.03, "grip_height": -0.03, "grip_tilt": 1.4, "yaw": 0.2}
    seen = cloth_lift.seen(frames=8, points=100, **held)
    scene = replace(LiftScene.of(seen, cloth_lift.settings), frames=(3, 5, 7), calm=(3, 5, 7))
    problem = Problem([scene], EstimateSettings(starts=1, scene=cloth_lift.settings))
    began = problem.compare([problem.prior.mean], derivatives=False)[0]
    found = nearest(problem, generations=5).best
    assert began is not None and found.comparison is not None
    assert found.value < 0.5 * distance(began.parts[0])
    assert (np.abs(found.vector - problem.prior.mean) <= 3.0 * problem.prior.sd + 1e-12).all()
    assert found.comparison.parts[0].J.size  # for uncertainties


def drifting(cloth_lift, by):
    """A recording of a cloth that leaves its gripper, by so much in the end [m]."""
    seen = cloth_lift.seen(frames=5)
    away = np.linspace(0.0, by, seen.num_frames)[:, None] * [0.0, 1.0, 0.0]
    clouds = [seen.frame(k).astype(float) + away[k] for k in range(seen.num_frames)]
    return cloth_lift.recording(clouds)


@pytest.mark.parametrize(("rms", "by"), [(0.0, 0.15), (9.0, 0.15), (0.0, 0.0)])
def test_an_estimate_that_went_astray_is_the_nearest_replay(cloth_lift, monkeypatch, rms, by):
    """Where that is nearer; for one that did not, none is looked for."""
    asked = []

    def told(problem):
        asked.append(problem)
        mean = problem.prior.mean
        found = finished(
            problem,
            [Start(initial=mean, vector=mean, comparison=problem.compare([mean])[0])],
            False,
        )
        c = found.best.comparison
        assert c is not None
        found.best.comparison = type("Made", (Comparisons,), {"rms": rms})(c.parts)
        return found

    monkeypatch.setattr(estimation, "nearest", told)
    settings = EstimateSettings(starts=1, max_iterations=2, scene=cloth_lift.settings)
    found = estimate(drifting(cloth_lift, by), settings)
    assert len(asked) == (1 if by else 0)
    if asked:
        prior = asked[0].prior
        assert np.allclose(prior.vector(found.theta), prior.mean) == (rms == 0.0)
        assert not found.usable
