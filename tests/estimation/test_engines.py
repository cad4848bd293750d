"""Lifts that are simulated with rods."""

from importlib.resources import files

import numpy as np
import pytest

from gendom.cli.replay import replay_setup
from gendom.datasets import Recording
from gendom.errors import ParameterError
from gendom.estimation import Lift, ReplaySettings, Theta
from gendom.sim import rope

THETA = Theta(specific_modulus=960.0, nu=0.35)


@pytest.fixture(scope="module")
def recording():
    return Recording.read(str(files("gendom") / "assets" / "demo-rope-lift.npz"))


def test_both_engines_lift_a_rope_alike(recording):
    frames = [0, 40, 80]
    rod, grid = (Lift(recording, ReplaySettings(engine=e)) for e in ("thin", "mpm"))
    x, y = (lift.simulate([THETA], frames=frames)[:, 0].astype(float) for lift in (rod, grid))
    assert x.shape == (3, len(rod.body.points), 3)
    for a, b in zip(rod.body.surface(x), grid.body.surface(y), strict=True):
        away = np.linalg.norm(a[:, None] - b[None], axis=2).min(axis=1)
        assert away.max() < 0.01


def test_a_replay_takes_the_estimates_engine_or_another(recording):
    params = {
        "format": "gendom-estimate/1",
        "specific_modulus": 960.0,
        "poissons_ratio": 0.35,
        "object": {"kind": "rope"},
        "simulation": {"engine": "thin"},
    }
    assert replay_setup(recording, params, "here", "cpu")[0].thin
    assert not replay_setup(recording, params, "here", "cpu", "mpm")[0].thin


def test_an_unknown_engine_is_named():
    with pytest.raises(ParameterError, match="unknown engine 'fem'"):
        ReplaySettings(engine="fem")


def test_the_skin_of_a_rod_is_half_a_diameter_from_its_centre_line():
    body = rope(diameter=0.01, length=0.2, direction=(1, 2, 0.5))
    skin = body.surface(body.points)
    unit = np.array([1, 2, 0.5]) / np.linalg.norm([1, 2, 0.5])
    across = skin - np.outer(skin @ unit, unit)
    np.testing.assert_allclose(np.linalg.norm(across, axis=1), 0.005, atol=1e-12)
    assert 0.0 < (skin @ unit).min() < 0.005 and 0.195 < (skin @ unit).max() < 0.2
