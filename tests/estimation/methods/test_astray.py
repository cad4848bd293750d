"""When an estimate looks for the nearest replay in the whole prior."""

import importlib

import numpy as np
import pytest

from gendom.estimation import EstimateSettings, estimate
from gendom.estimation.likelihood import Comparisons
from gendom.estimation.methods.search import finished
from gendom.estimation.problem import Start

estimation = importlib.import_module("gendom.estimation.estimate")


def drifting(cloth_lift, by):
    """A recording of a cloth that leaves its gripper, by so much in the end [m]."""
    seen = cloth_lift.seen(frames=6, points=60)
    away = np.linspace(0.0, by, seen.num_frames)[:, None] * [0.0, 1.0, 0.0]
    clouds = [seen.frame(k).astype(float) + away[k] for k in range(seen.num_frames)]
    return cloth_lift.recording(clouds)


@pytest.mark.parametrize(("rms", "by"), [(0.0, 0.15), (9.0, 0.15), (0.0, 0.0)])
def test_an_estimate_that_went_astray_is_the_nearest_replay(cloth_lift, monkeypatch, rms, by):
    """Where that is nearer; for one that did not, none is looked for."""
    asked = []

    def told(problem, **how):
        assert how["coarse"]
        asked.append(problem)
        mean = problem.prior.mean
        found = finished(
            problem,
            [Start(initial=mean, vector=mean, comparison=problem.compare([mean])[0])],
            False,
        )
        c = found.best.comparison
        found.best.comparison = type("Made", (Comparisons,), {"rms": rms})(
            parts=c.parts, shown=c.shown, unknowns=c.unknowns
        )
        return found

    monkeypatch.setattr(estimation, "differential_evolution", told)
    settings = EstimateSettings(starts=1, max_iterations=2, scene=cloth_lift.settings)
    found = estimate(drifting(cloth_lift, by), settings)
    assert len(asked) == (1 if by else 0)
    if asked:
        prior = asked[0].prior
        assert np.allclose(prior.vector(found.theta), prior.mean) == (rms == 0.0)
        assert not found.usable
