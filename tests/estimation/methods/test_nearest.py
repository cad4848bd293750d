"""The nearest replay, and when an estimate looks for it."""

import importlib
from dataclasses import replace

import numpy as np
import pytest

from gendom.estimation import EstimateSettings, LiftScene, estimate
from gendom.estimation.likelihood import Comparisons
from gendom.estimation.methods.nearest import NearestSettings, adapted, nearest
from gendom.estimation.problem import Problem, Start

estimation = importlib.import_module("gendom.estimation.estimate")


def test_it_follows_a_narrow_valley():
    """Of an ellipsoid with axes of 1 to 1000 that no unknown lies along, and with dents."""
    rng = np.random.default_rng(1)
    axes = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    least = rng.standard_normal(6)

    def value(tried):
        along = (tried - least) @ axes * np.logspace(0.0, 3.0, 6)
        return (along**2).sum(axis=1) + 0.1 * (1.0 - np.cos(along)).sum(axis=1)

    found = adapted(value, np.ones(6), population=18, generations=200, rng=rng)
    assert value(found[None])[0] < 1e-3


def test_what_cannot_be_simulated_is_passed_by():
    """A place on the border, with half of all places beyond it."""

    def value(tried):
        return np.where(tried[:, 0] > 0.0, (tried**2).sum(axis=1), np.inf)

    rng = np.random.default_rng(0)
    found = adapted(value, np.ones(3), population=12, generations=60, rng=rng)
    assert np.linalg.norm(found) < 0.1


@pytest.fixture(scope="module")
def problem(cloth_lift):
    """Of a cloth held far from where its prior says."""
    held = {"grip_along": 0.03, "grip_height": -0.03, "grip_tilt": 1.4, "yaw": 0.2}
    seen = cloth_lift.seen(frames=8, points=100, **held)
    scene = replace(LiftScene.of(seen, cloth_lift.settings), frames=(3, 5, 7), calm=(3, 5, 7))
    return Problem([scene], EstimateSettings(starts=1, scene=cloth_lift.settings))


def test_it_comes_near(problem):
    settings = NearestSettings(generations=12, finalists=3)
    began = problem.compare([problem.prior.mean], derivatives=False)[0]
    best = nearest(problem, settings)
    assert began is not None and best.comparison is not None
    assert best.value == pytest.approx(best.comparison.distance, rel=0.05)
    assert best.value < 0.4 * began.distance
    assert len(best.history) == 12
    assert (np.abs(best.vector - problem.prior.mean) <= 3.0 * problem.prior.sd + 1e-12).all()
    # with derivatives, of all frames and points
    assert problem.is_as_fine_as(best.comparison) and best.comparison.parts[0].J.shape[3] > 0


def test_a_distance_is_that_of_both_ways(problem):
    """A cloud moved by 1 m is 1 m from the cloth, and the cloth 1 m from it."""
    scene = problem.scene
    aside = np.eye(4)
    aside[0, 3] = 1.0
    far = replace(scene, recording=scene.recording.moved(aside))
    other = Problem([far], problem.settings).compare([problem.prior.mean], derivatives=False)[0]
    assert other is not None and 1.6 < other.distance < 2.2


def drifting(cloth_lift, by):
    """A recording of a cloth that leaves its gripper, by so much in the end [m]."""
    seen = cloth_lift.seen(frames=8)
    away = np.linspace(0.0, by, seen.num_frames)[:, None] * [0.0, 1.0, 0.0]
    clouds = [seen.frame(k).astype(float) + away[k] for k in range(seen.num_frames)]
    return cloth_lift.recording(clouds)


class Near(Comparisons):
    @property
    def distance(self) -> float:
        return 0.0


class Far(Comparisons):
    @property
    def distance(self) -> float:
        return 9.0


@pytest.mark.parametrize(("kind", "by"), [(Near, 0.15), (Far, 0.15), (Near, 0.0)])
def test_an_estimate_that_went_astray_is_the_nearest_replay(cloth_lift, monkeypatch, kind, by):
    """Where that is nearer; for one that did not, none is looked for."""
    asked = []

    def told(problem):
        asked.append(problem)
        mean = problem.prior.mean
        found = problem.compare([mean])[0]
        comparison = kind(parts=found.parts, shown=found.shown, unknowns=found.unknowns)
        return Start(initial=mean, vector=mean, comparison=comparison)

    monkeypatch.setattr(estimation, "nearest", told)
    settings = EstimateSettings(starts=1, max_iterations=2, scene=cloth_lift.settings)
    found = estimate(drifting(cloth_lift, by), settings)
    assert len(asked) == (1 if by else 0)
    if asked:
        prior = asked[0].prior
        assert np.allclose(prior.vector(found.theta), prior.mean) == (kind is Near)
        assert not found.usable
