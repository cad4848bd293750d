"""Ropes, cables and wires that are held at both ends, and shapes at rest."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gendom.datasets import Recording
from gendom.errors import ParameterError
from gendom.estimation import EstimateSettings, LiftScene, SceneSettings, estimate, replay
from gendom.estimation.markers import aside, axis_beside, material_frames
from gendom.estimation.observed import Observation
from gendom.estimation.placing import lost_time
from gendom.estimation.problem import Problem
from gendom.estimation.replay import replay_axis, with_twist_shown


def markers(scene, x):
    """[T, m, 3] where a scene's markers are on simulated shapes [T, n, 3]."""
    found = Observation(scene).markers
    assert found is not None
    index, weight = found
    return np.einsum("mk,tmka->tma", weight, x[:, index])


def seen_at(recording, points, **changes):
    """With these markers [T, m, 3] or [m, 3] in all frames."""
    frames = np.broadcast_to(points, (recording.num_frames, *np.shape(points)[-2:]))
    own = np.arange(recording.num_frames + 1) * frames.shape[1]
    points = frames.reshape(-1, 3).astype(np.float32)
    return replace(recording, points=points, offsets=own, **changes)


@pytest.fixture(scope="module")
def cable(real_data):
    path = real_data / "cable_dlo3_train_001.npz"
    if not path.is_file():
        pytest.skip(f"no {path.name} in {real_data}")
    return Recording.read(path, on_warning=lambda _: None)


def test_a_cable_in_fast_motion_comes_back(cable):
    """What is simulated with known stiffness, damping, clamps and air, from the real cable's first
    frame and grippers, is found again."""
    recording = cable.head(120)
    every = SceneSettings(fast_frames=200, slow_frames=200)
    scene = LiftScene.of(recording, every)
    assert scene.velocities is not None and np.abs(scene.velocities).max() > 0.3
    prior, base = scene.prior()
    assert "friction" not in prior.names and "damping" in prior.names
    clamps = {"first_clamp_x": -0.1, "last_clamp_y": 0.2, "clamp_twist": 0.8}
    truth = base.with_values({"E_over_rho": 6000.0, "damping": 0.02, "air_drag": 4.0, **clamps})
    made = seen_at(recording, markers(scene, replay(scene, [truth])[:, 0]))
    found = estimate(made, EstimateSettings(starts=1))
    assert found.usable
    assert found.theta.E_over_rho == pytest.approx(6000.0, rel=0.03)
    assert found.theta.damping == pytest.approx(0.02, rel=0.1)
    ends = found.interval("air_drag")  # in 1.2 s it hardly shows
    assert ends is not None and ends[0] < 4.0 < ends[1]
    for name, value in clamps.items():
        assert found.theta[name] == pytest.approx(value, abs=0.1 if "twist" in name else 0.02)


def test_markers_are_beside_the_axis(cable):
    """Cross-sections turn with both hands, and the axis lies where offsets say."""
    scene = LiftScene.of(cable.head(60))
    offsets = 0.005 * np.random.default_rng(1).normal(size=(12, 3))
    offsets[[0, 1, -2, -1]] = 0.0
    axis, _ = axis_beside(scene, tuple(map(tuple, offsets)), 1.0)
    frames = material_frames(scene, axis[None, None], [scene.begins])[0, 0]
    assert frames @ np.swapaxes(frames, 1, 2) == pytest.approx(np.tile(np.eye(3), (49, 1, 1)))
    along = np.gradient(axis, axis=0)[1:-1]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    assert (np.einsum("na,na->n", along, frames[1:-1, :, 2]) > 0.99).all()
    shown = markers(scene, (axis + aside(scene, frames, offsets))[None])[0]
    assert np.linalg.norm(shown - cable.frame(0), axis=1).mean() < 2.5e-3
    assert np.linalg.norm(markers(scene, axis[None])[0] - cable.frame(0), axis=1).mean() > 3e-3
    with pytest.raises(ParameterError, match="the cable has 11 markers, the recording shows 12"):
        aside(scene, frames, offsets[1:])


@pytest.mark.parametrize("twist", [-1.5, 1.0])
def test_twist_is_read_from_the_first_motion(cable, twist):
    """However hands are turned about an instrumented cable, it begins to the right side."""
    scene = LiftScene.of(cable.head(20))
    known = scene.prior()[1].with_values({"E_over_rho": 7000.0}).with_offsets(np.zeros((12, 3)))
    truth = known.with_values({"clamp_twist": twist})
    seen = markers(scene, replay_axis(scene, [truth])[:, 0])
    other = LiftScene.of(seen_at(scene.recording, seen))
    assert with_twist_shown(other, known).clamp_twist == pytest.approx(twist, abs=0.35)
    assert with_twist_shown(other, known.with_offsets(())) == known  # of a cable unseen before


def test_lost_frames_are_told_from_leaping_hands(cable):
    assert not lost_time(cable).any()
    kept = np.delete(np.arange(cable.num_frames), [100, 101, 300])
    leaps = replace(
        cable.head(len(kept)),
        points=cable.points.reshape(cable.num_frames, -1, 3)[kept].reshape(-1, 3),
        gripper_position=cable.gripper_position[kept],
        gripper_axis=cable.gripper_axis[kept],
    )
    late = lost_time(leaps)
    assert np.flatnonzero(np.diff(late)).tolist() == [99, 297]
    assert late[-1] == pytest.approx(0.03)
    scene = LiftScene.of(leaps)
    assert scene.sim_time(leaps.time[-1]) == pytest.approx(cable.time[-1])
    assert any("frames were lost" in note for note in scene.notes)
    # a hand that starts, waits or stops at once loses nothing, nor does one with times of a clock
    at = np.cumsum(np.repeat([0.0, 0.01, 0.0, 0.02, 0.0], 20))
    path = np.zeros((100, 2, 3))
    path[..., 0] = at[:, None]
    assert not lost_time(replace(cable.head(100), gripper_position=path)).any()
    clock = leaps.time + 0.003 * np.random.default_rng(0).random(len(leaps.time))
    assert not lost_time(replace(leaps, time=clock)).any()


@pytest.mark.parametrize("angle", [40.0, 90.0, 150.0])
def test_a_bent_cable_begins_as_long_as_it_is(cable, angle):
    """Also where it bends sharply between two markers, which are then nearer than along it."""
    s = np.linspace(0.0, 0.97, 400)
    turn = np.radians(angle) * np.clip((s - 0.45) / 0.03, 0.0, 1.0)
    line = np.cumsum(np.stack([np.cos(turn), np.zeros_like(s), np.sin(turn)], axis=1), axis=0)
    line *= s[1]
    frame = line[np.linspace(0, 399, 12).round().astype(int)]
    made = seen_at(cable.head(20), frame, gripper_position=np.tile(frame[[0, -1]], (20, 1, 1)))
    scene = LiftScene.of(made)
    edges = np.linalg.norm(np.diff(scene.initial, axis=0), axis=1)
    assert np.abs(edges * (len(edges) / scene.size) - 1.0).max() < 0.05
    assert np.linalg.norm(markers(scene, scene.initial[None])[0] - frame, axis=1).max() < 0.02


def test_recordings_of_different_cables_are_refused(cable):
    fewer = seen_at(cable, np.delete(cable.points.reshape(-1, 12, 3), 5, axis=1))
    scenes = [LiftScene.of(r) for r in (cable, fewer)]
    with pytest.raises(ParameterError, match="shows 11 markers in order, recording 1 12"):
        Problem(scenes, EstimateSettings())
    near = replace(cable, object=replace(cable.object, length=1.004 * cable.object.length))
    Problem([scenes[0], LiftScene.of(near)], EstimateSettings())  # as it is measured


def test_a_wire_at_rest():
    """Its authors found 1.22e-4 N m^2 in another way, an elastica with free ends has 0.98e-4."""
    path = Path(__file__).parents[2] / "benchmarks" / "recordings" / "wire_white_loop.npz"
    recording = Recording.read(path, on_warning=lambda _: None)
    found = estimate(recording, EstimateSettings(starts=1, max_iterations=10))
    assert found.usable
    assert found.record["bending_stiffness"] == pytest.approx(1.2166e-4, rel=0.15)
    ends = found.interval("bending_stiffness")
    assert ends is not None and ends[0] < 0.98e-4 < 1.2166e-4 < ends[1]
    # it is as long as it is
    x = found.fits[0].positions[0]
    assert np.linalg.norm(np.diff(x, axis=0), axis=1).sum() == pytest.approx(1.5, rel=0.002)
    assert np.abs(found.record["calibration"]["shift"]).max() < 0.003
    assert found.record["rms"] < 0.003
