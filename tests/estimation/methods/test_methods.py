"""Each method brings back what a short simulated lift was made with."""

import sys

import numpy as np
import pytest

from experiments.sim2sim import paper_E
from gendom.estimation.methods import METHODS
from gendom.estimation.methods.adam import DensityLoss, adam
from gendom.estimation.methods.differential_evolution import differential_evolution
from gendom.estimation.methods.gauss_newton import gauss_newton

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


@pytest.mark.parametrize("method", [adam, few_members], ids=["adam", "differential-evolution"])
def test_an_interruption_before_anything_was_found_is_passed_on(short_lift, method, monkeypatch):
    problem = short_lift()

    def stop(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(problem, "compare", stop)
    with pytest.raises(KeyboardInterrupt):
        method(problem)


@pytest.mark.slow
def test_evolution_is_seeded(short_lift):
    ends = [few_members(short_lift(max_iterations=3, seed=s)).best.vector for s in (1, 1, 2)]
    np.testing.assert_array_equal(ends[0], ends[1])
    assert (ends[0] != ends[2]).any()


def test_adam_begins_where_it_is_told_and_stays_within_the_prior(short_lift, monkeypatch):
    """Steps far too long end at its bounds."""
    problem, been, own = short_lift(max_iterations=3), [], DensityLoss.evaluate

    def evaluate(self, descents):
        been.extend(d.vector for d in descents)
        own(self, descents)

    monkeypatch.setattr(DensityLoss, "evaluate", evaluate)
    monkeypatch.setattr(sys.modules[adam.__module__], "RATE", 1.0)
    start = problem.prior.vector(*problem.bases)
    found = adam(problem, initial=(start,), steps=1)
    np.testing.assert_array_equal(found.starts[0].initial, start)
    np.testing.assert_array_equal(been[0], start)
    low, high = problem.prior.low, problem.prior.high
    assert all((low <= v).all() and (v <= high).all() for v in been)
    assert any((low == v).any() or (v == high).any() for v in been)


def test_methods_go_by_the_names_of_the_command_line():
    assert list(METHODS) == ["gauss-newton", "adam", "differential-evolution"]
