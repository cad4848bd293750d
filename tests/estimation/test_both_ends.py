"""Ropes, cables and wires that are held at both ends, and shapes at rest."""

from dataclasses import replace

import numpy as np
import pytest

from gendom.datasets import Recording
from gendom.estimation import EstimateSettings, LiftScene, SceneSettings, estimate, replay
from gendom.estimation.likelihood import Observation


def markers(scene, x):
    """[T, m, 3] where a scene's markers are on simulated shapes [T, n, 3]."""
    found = Observation(scene).markers
    assert found is not None
    index, weight = found
    return np.einsum("mk,tmka->tma", weight, x[:, index])


@pytest.fixture(scope="module")
def cable(real_data):
    path = real_data / "cable_dlo3_train_001.npz"
    if not path.is_file():
        pytest.skip(f"no {path.name} in {real_data}")
    return Recording.read(path, on_warning=lambda _: None)


def test_a_cable_in_fast_motion_comes_back(cable):
    """What is simulated with known stiffness and damping, from the real cable's first frame and
    grippers, is found again."""
    recording = cable.head(120)
    every = SceneSettings(fast_frames=200, slow_frames=200)
    scene = LiftScene.of(recording, every)
    assert scene.velocities is not None and np.abs(scene.velocities).max() > 0.3
    prior, base = scene.prior()
    assert "friction" not in prior.names and "damping" in prior.names
    truth = base.with_values({"E_over_rho": 6000.0, "damping": 0.02, "nu": 0.3})
    seen = markers(scene, replay(scene, [truth])[:, 0]).astype(np.float32)
    made = replace(recording, points=seen.reshape(-1, 3))
    found = estimate(made, EstimateSettings(starts=1))
    assert found.usable
    assert found.theta.E_over_rho == pytest.approx(6000.0, rel=0.03)
    assert found.theta.damping == pytest.approx(0.02, rel=0.1)


@pytest.mark.slow
def test_a_cable_is_predicted_from_one_sequence(cable, real_data):
    """Better than a network that was trained on 56 sequences (0.0099 m)."""
    theta = estimate(cable, EstimateSettings(starts=1)).theta
    for name in ("eval_004", "eval_010"):
        other = Recording.read(real_data / f"cable_dlo3_{name}.npz", on_warning=lambda _: None)
        scene = LiftScene.of(other, SceneSettings(fast_frames=500, slow_frames=500))
        x = markers(scene, replay(scene, [theta])[:, 0])
        assert np.abs(x - other.points.reshape(x.shape)).mean() < 0.0099


def test_a_wire_at_rest(real_data):
    """Its authors found 1.22e-4 N m^2 in another way, an elastica with free ends has 0.98e-4."""
    path = real_data / "wire_white_loop.npz"
    if not path.is_file():
        pytest.skip(f"no {path.name} in {real_data}")
    found = estimate(Recording.read(path, on_warning=lambda _: None), EstimateSettings(starts=1))
    assert found.usable
    assert found.record["bending_stiffness"] == pytest.approx(1.2166e-4, rel=0.15)
    ends = found.interval("bending_stiffness")
    assert ends is not None and ends[0] < 0.98e-4 < 1.2166e-4 < ends[1]
    # it is as long as it is
    x = found.positions[0]
    assert np.linalg.norm(np.diff(x, axis=0), axis=1).sum() == pytest.approx(1.5, rel=0.002)
    assert np.abs(found.record["calibration"]["shift"]).max() < 0.003
    assert found.record["rms"] < 0.003
