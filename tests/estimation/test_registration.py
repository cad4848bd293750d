"""Cameras of which nobody knows where they are."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.errors import RecordingError
from gendom.estimation import Estimate, estimate
from gendom.estimation.registration import first_shift
from gendom.estimation.replayed import replay_setup


def off(recording, degrees=4.0):
    """As cameras see it that are off by 3 cm and 4 degrees, about the middle of the clouds."""
    T, middle = np.eye(4), recording.points.mean(axis=0, dtype=float)
    T[:3, :3] = Rotation.from_rotvec(np.radians(degrees) * np.array([0.6, 0.8, 0.0])).as_matrix()
    T[:3, 3] = middle + np.array([0.02, -0.02, 0.01]) - T[:3, :3] @ middle
    return replace(recording.moved(T), cameras_calibrated=False)


def test_what_cameras_of_unknown_poses_see_is_moved_to_the_robot(rope_lift, settings, tmp_path):
    """E within its interval, which is hardly wider than with calibrated cameras; points to within
    what is known of the grip, several millimetres of 30 and more. Replays use the motion that was
    found; another uncalibrated recording is registered anew."""
    lifted = rope_lift.seen(frames=14)
    uncalibrated = off(lifted)
    found = estimate(uncalibrated, settings)
    assert found.usable, found.verdict.reasons
    low, high = found.record["intervals"]["E_over_rho"]
    assert low < rope_lift.truth.E_over_rho < high < 1.5 * low
    calibration = found.record["calibration"]
    T = np.array(calibration["registration"])
    back = uncalibrated.points @ T[:3, :3].T + T[:3, 3]
    assert np.linalg.norm(uncalibrated.points - lifted.points, axis=1).mean() > 0.03
    assert np.linalg.norm(back - lifted.points, axis=1).mean() < 0.008
    # what is left for the likelihood is little
    assert np.abs(calibration["shift"]).max() < 0.002
    assert np.abs(calibration["turn"]).max() < 0.005
    assert any(note.startswith("camera poses unknown: clouds moved") for note in found.scene.notes)

    found.save(tmp_path / "estimate.json")
    again = Estimate.load(tmp_path / "estimate.json")
    assert again.record["begins_with"] == uncalibrated.begins_with
    scene, theta = replay_setup(uncalibrated, again.record, "here", "cpu")
    assert theta == found.theta
    np.testing.assert_allclose(scene.recording.points, back, atol=1e-5)
    np.testing.assert_allclose(scene.initial, found.scene.initial, atol=1e-6)
    other = rope_lift.seen(seed=6)
    scene, theta = replay_setup(off(other, -3.0), found.record, "here", "cpu")
    assert theta.E_over_rho == found.theta.E_over_rho
    assert np.linalg.norm(scene.recording.points - other.points, axis=1).mean() < 0.01


def test_the_first_shift_brings_the_top_to_the_gripper(rope_lift):
    """To within the rope's own sizes; of a lift that is too low there is none."""
    lifted = rope_lift.seen(frames=20)
    assert np.linalg.norm(first_shift(lifted)[:3, 3]) < 0.025
    with pytest.raises(RecordingError, match="need a gripper that lifts the object by 30%"):
        first_shift(lifted.head(6))
