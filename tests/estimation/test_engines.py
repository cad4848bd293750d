"""Lifts that are simulated with rods, and with material points."""

from importlib.resources import files

import numpy as np
import pytest

from gendom.datasets import Recording
from gendom.errors import ParameterError
from gendom.estimation import EstimateSettings, LiftScene, SceneSettings, Theta, estimate, replay
from gendom.estimation.replay import lattice, middle
from gendom.sim import rope

THETA = Theta(E_over_rho=960.0, nu=0.35)


@pytest.fixture(scope="module")
def recording():
    return Recording.read(str(files("gendom") / "assets" / "demo-rope-lift.npz"))


def test_both_engines_lift_a_rope_alike(recording):
    x, scenes = [], []
    for engine in ("thin", "mpm"):
        scene = LiftScene.of(recording, SceneSettings(engine=engine, slow_frames=3, fast_frames=3))
        at = replay(scene, [THETA])[:, 0]
        x.append(middle(scene, at))
        scenes.append(scene)
        assert x[-1].shape == (len(scene.frames), len(lattice(scene)[0]), 3)
    assert scenes[0].frames == scenes[1].frames
    for a, b in zip(*x, strict=True):
        away = np.linalg.norm(a[:, None] - b[None], axis=2).min(axis=1)
        assert away.max() < 0.01


def test_an_unknown_engine_is_named():
    with pytest.raises(ParameterError, match="unknown engine 'fem'"):
        SceneSettings(engine="fem")


@pytest.mark.slow
def test_the_mpm_finds_what_rods_find(recording):
    """E of the demo's lift within a fifth."""
    found = [
        estimate(recording, EstimateSettings(starts=1, scene=SceneSettings(engine=engine)))
        for engine in ("thin", "mpm")
    ]
    assert found[0].usable and found[1].usable
    a, b = (f.theta.E_over_rho for f in found)
    assert b == pytest.approx(a, rel=0.2)


def test_the_skin_of_a_rod_is_half_a_diameter_from_its_centre_line():
    body = rope(diameter=0.01, length=0.2, direction=(1, 2, 0.5))
    skin = body.surface(body.points)
    unit = np.array([1, 2, 0.5]) / np.linalg.norm([1, 2, 0.5])
    across = skin - np.outer(skin @ unit, unit)
    np.testing.assert_allclose(np.linalg.norm(across, axis=1), 0.005, atol=1e-12)
    assert 0.0 < (skin @ unit).min() < 0.005 and 0.195 < (skin @ unit).max() < 0.2
