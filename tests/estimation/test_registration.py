"""Cameras of which nobody knows where they are."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.errors import RecordingError
from gendom.estimation import Estimate, estimate
from gendom.estimation.registration import first_shift
from gendom.estimation.replayed import replay_setup


def off(recording, axis=(0.6, 0.8, 0.0), degrees=4.0, shift=(0.02, -0.02, 0.01)):
    """As cameras see it that are off by 3 cm and 4 degrees, about the middle of the clouds."""
    T, middle = np.eye(4), recording.points.mean(axis=0, dtype=float)
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array(axis) / np.linalg.norm(axis))
    T[:3, :3] = turn.as_matrix()
    T[:3, 3] = middle + shift - T[:3, :3] @ middle
    return recording.moved(T)


def back(recording, found):
    """[S, 3] its points where an estimate has them."""
    T = np.array(found.record["calibration"]["registration"])
    return recording.points @ T[:3, :3].T + T[:3, 3]


@pytest.fixture(scope="module")
def lifted(rope_lift):
    return rope_lift.seen(frames=20)


@pytest.fixture(scope="module")
def uncalibrated(lifted):
    return replace(off(lifted), cameras_calibrated=False)


@pytest.fixture(scope="module")
def found(uncalibrated, settings):
    return estimate(uncalibrated, settings)


def test_modulus_and_motion_come_back(rope_lift, lifted, uncalibrated, found):
    """E within its interval, which is hardly wider than with calibrated cameras; points to within
    what is known of the grip, several millimetres of 30 and more."""
    assert found.usable, found.verdict.reasons
    low, high = found.record["intervals"]["E_over_rho"]
    assert low < rope_lift.truth.E_over_rho < high < 1.5 * low
    lost = np.linalg.norm(uncalibrated.points - lifted.points, axis=1)
    left = np.linalg.norm(back(uncalibrated, found) - lifted.points, axis=1)
    assert lost.mean() > 0.03 and left.mean() < 0.008
    # what is left for the likelihood is little
    calibration = found.record["calibration"]
    assert np.abs(calibration["shift"]).max() < 0.002
    assert np.abs(calibration["turn"]).max() < 0.005
    assert any(note.startswith("camera poses unknown: clouds moved") for note in found.scene.notes)


def test_replays_use_the_motion_that_was_found(found, uncalibrated, rope_lift, tmp_path):
    """Another uncalibrated recording is registered anew."""
    found.save(tmp_path / "estimate.json")
    again = Estimate.load(tmp_path / "estimate.json")
    assert again.record["begins_with"] == uncalibrated.begins_with
    scene, theta = replay_setup(uncalibrated, again.record, "here", "cpu")
    assert theta == found.theta
    np.testing.assert_allclose(scene.recording.points, back(uncalibrated, found), atol=1e-5)
    np.testing.assert_allclose(scene.initial, found.scene.initial, atol=1e-6)
    other = rope_lift.seen(seed=6)
    moved = replace(off(other, degrees=-3.0), cameras_calibrated=False)
    scene, theta = replay_setup(moved, found.record, "here", "cpu")
    assert theta.E_over_rho == found.theta.E_over_rho
    assert np.linalg.norm(scene.recording.points - other.points, axis=1).mean() < 0.01


def test_the_first_shift_brings_the_top_to_the_gripper(lifted):
    """To within the rope's own sizes; of a lift that is too low there is none."""
    assert np.linalg.norm(first_shift(lifted)[:3, 3]) < 0.025
    aside = np.eye(4)
    aside[:3, 3] = 0.05, 0.0, -0.04
    change = first_shift(lifted.moved(aside))[:3, 3] - first_shift(lifted)[:3, 3]
    assert change == pytest.approx([-0.05, 0.0, 0.04], abs=1e-4)
    with pytest.raises(RecordingError, match="need a gripper that lifts the object by 30%"):
        first_shift(lifted.head(6))
