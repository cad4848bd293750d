"""Each method brings back what a short simulated lift was made with; Adam's slopes are right."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from experiments.adam import DensityLoss, _Descent, adam
from experiments.evolution import differential_evolution
from experiments.sim2sim import (
    paper_E,
    scene_settings,
    sim2sim_problem,
    sim2sim_recording,
    truth_of,
)
from gendom.errors import ParameterError
from gendom.estimation import METHODS, estimate
from gendom.estimation.methods.gauss_newton import gauss_newton
from gendom.estimation.problem import Start

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


def descent_of(problem):
    """The density loss, and its slopes beside the truth."""
    loss, vector = DensityLoss(problem), problem.prior.vector(truth_of(3300.0, 0.25))
    descent = _Descent(Start(initial=vector, vector=vector), vector)
    loss.evaluate([descent])
    assert descent.seen is not None
    return loss, descent, vector


@pytest.mark.parametrize("markers", [True, False])
@pytest.mark.parametrize("engine", ["thin", "mpm"])
def test_gradients_are_central_differences(short_lift, engine, markers):
    problem = short_lift(engine, markers)
    loss, descent, vector = descent_of(problem)
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
    settings = replace(problem.settings, unknowns=("E_over_rho", "grip_height"))
    wide = type(problem)([problem.scene], settings, known=problem.bases[0])
    loss, descent, vector = descent_of(wide)
    h = wide.prior.step[1]
    x = wide.positions([vector, vector + np.array([0.0, h])])
    here, beside = (loss.value(x[:, w], descent.seen) for w in range(2))
    assert descent.gradient[1] == pytest.approx((beside - here) / h, rel=1e-6)
    assert abs(descent.gradient[1]) > 0.1


def test_what_adam_cannot_do_is_said(short_lift, monkeypatch):
    """It reads one recording of an object that is as thick as stated."""
    monkeypatch.setitem(METHODS, "adam", adam)
    problem = short_lift(method="adam")
    lift, settings = problem.scene.recording, problem.settings
    with pytest.raises(ParameterError, match="method adam: reads one recording, got 2"):
        estimate([lift, lift], settings)
    with pytest.raises(ParameterError, match="compares objects as thick as stated"):
        estimate(lift, replace(settings, unknowns=("thickness",)))
