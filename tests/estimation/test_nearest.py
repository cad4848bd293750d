"""A search that went astray, and the nearest replay that takes its place."""

import importlib
from dataclasses import replace

import numpy as np
import pytest

from gendom.estimation import EstimateSettings, LiftScene, estimate
from gendom.estimation.likelihood import Comparisons
from gendom.estimation.methods.nearest import distance, nearest
from gendom.estimation.methods.search import finished
from gendom.estimation.problem import Problem, Start

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
