"""Recordings of the second reality: what is written, and that perception can read it."""

import shutil
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra reality")

from gendom.errors import GendomError, ParameterError, RobotError
from gendom.perception import PerceptionSettings, perceive, read_cameras
from gendom.reading import read_json
from gendom.reality import (
    OBJECTS,
    RealRope,
    RecordSettings,
    RigErrors,
    TrialRun,
    lift,
    lift_cameras,
    record,
)
from gendom.reality.recording import record_and_perceive
from gendom.reality.world import FINGER_WIDTH
from gendom.robot import XARM7, tcp_pose

ROPE = cast(RealRope, OBJECTS["rope-polyester"])
RATE = 4.0


def recorded(folder, *, noise=True, rate=RATE, seed=0, rise=0.04, end="hold", **kwargs):
    """A short lift by a free hand, from the closing of the hand on."""
    trial = lift(ROPE, rise=rise, end=end)
    run = TrialRun(trial, robot=False, cameras=lift_cameras(ROPE))
    run.step_to(run.closes)
    with run.world:
        record(
            run,
            folder,
            RecordSettings(frame_rate=rate, seed=seed, noisy=noise),
            errors=None if noise else RigErrors.none(),
            **kwargs,
        )
    return run


def perceived(folder, warnings=None):
    warnings = [] if warnings is None else warnings
    sighting = read_cameras(folder, on_warning=warnings.append)
    return perceive(
        sighting, PerceptionSettings(colour=ROPE.colour), on_warning=warnings.append
    ).recording


@pytest.fixture(scope="module")
def clean(rendering, tmp_path_factory):
    """A recording without faults."""
    folder = tmp_path_factory.mktemp("clean") / "recording"
    recorded(folder, noise=False)
    return folder


@pytest.fixture(scope="module")
def noisy(rendering, tmp_path_factory):
    """A recording with the usual faults."""
    folder = tmp_path_factory.mktemp("noisy") / "recording"
    recorded(folder)
    return folder


def files(folder, pattern):
    found = {p.relative_to(folder): p.read_bytes() for p in sorted(folder.glob(pattern))}
    assert found
    return found


def distance_to_rope(points, vertices):
    """[P] from points [P, 3] to the rope's surface [m], below 0 inside."""
    a, b = vertices[:-1], vertices[1:]
    along = b - a
    share = np.einsum("pvk,vk->pv", points[:, None] - a, along) / (along**2).sum(axis=1)
    nearest = a + np.clip(share, 0.0, 1.0)[..., None] * along
    off = np.linalg.norm(points[:, None] - nearest, axis=2).min(axis=1)
    return off - ROPE.diameter / 2.0


def test_what_is_recorded_is_where_it_truly_is(clean):
    """Clouds of the exact cameras lie on the rope's surface, in every frame and to its ends."""
    recording = perceived(clean)
    with np.load(clean / "truth" / "truth.npz") as truth:
        time, vertices = truth["time"], truth["vertices"].astype(float)
    # 0.5 s wait, 0.8 s rise, 0.5 s after
    assert len(time) == recording.num_frames == int(1.8 * RATE) + 1
    np.testing.assert_allclose(recording.time, time, atol=1e-9)
    for k in range(recording.num_frames):
        points = recording.frame(k).astype(float)
        assert len(points) > 300
        assert np.median(np.abs(distance_to_rope(points, vertices[k]))) < 1e-3
        # Its lower side is out of view, its ends are not.
        assert np.ptp(points[:, 0]) > 0.8 * np.ptp(vertices[k, :, 0])
    path = recording.gripper_position[:, 0]
    # Half a finger's breadth from the rope's end, which lies 0.32 m in front of the base.
    assert path[0] == pytest.approx([0.3325, 0.0, ROPE.diameter / 2.0], abs=1e-3)
    assert path[-1] - path[0] == pytest.approx([0.0, 0.0, 0.04], abs=1e-3)


@pytest.mark.parametrize("end", ["swing", pytest.param("drop", marks=pytest.mark.slow)])
def test_a_lift_that_ends_in_motion_is_perceived_to_its_end(rendering, tmp_path, end):
    """Cameras are synchronised, so that a falling rope is seen once, not twice."""
    folder = tmp_path / end
    recorded(folder, rate=12.0, end=end)
    warnings = []
    recording = perceived(folder, warnings)
    assert warnings == [] and not recording.quasi_static
    with np.load(folder / "truth" / "truth.npz") as truth:
        time, vertices = truth["time"], truth["vertices"].astype(float)
    np.testing.assert_allclose(recording.time, time, atol=1e-3)
    # 0.5 s wait, 0.8 s rise, 0.5 s wait; the swing's 10 mm take 20 ms
    closed = recording.holds[:, 0]
    if end == "drop":
        np.testing.assert_array_equal(closed, time < 1.8 - 1e-3)
    else:
        assert closed.all()
        path = recording.gripper_position[:, 0, 0]
        assert path[-1] - path[0] == pytest.approx(0.01, abs=1e-3)
    assert time[-1] > 2.7
    for k in range(int(np.argmax(time > 1.7)), len(time)):
        off = np.abs(distance_to_rope(recording.frame(k).astype(float), vertices[k]))
        assert len(off) > 300 and np.median(off) < 4e-3 and np.quantile(off, 0.95) < 0.012


def test_what_is_held_is_described(clean):
    meta = read_cameras(clean).meta
    assert meta["object"]["kind"] == "rope" and meta["object"]["grasp"] == "end"
    assert meta["object"]["length"] == ROPE.length
    assert meta["object"]["grasp_inset"] == FINGER_WIDTH / 2.0
    # the rope bends from half an edge before the last vertex that is held
    edge = 0.3 / 17
    held = FINGER_WIDTH / 2.0 + meta["object"]["grasp_radius"]
    assert (held / edge - 0.5) % 1.0 < 1e-9 and abs(held - FINGER_WIDTH) < edge / 2.0 + 1e-9
    assert meta["object"]["mass"] == pytest.approx(ROPE.mass)
    # A recording does not give away what is to be estimated.
    given = (clean / "object.toml").read_text().lower()
    assert not any(word in given for word in ("young", "poisson", "density", "polyester"))


def test_noise_and_errors_leave_all_frames_perceivable(noisy):
    """Twenty milliseconds between the cameras are just what matching tolerates."""
    warnings = []
    recording = perceived(noisy, warnings)
    frames = int(1.8 * RATE) + 1
    assert recording.num_frames >= frames - 1
    with np.load(noisy / "truth" / "truth.npz") as truth:
        vertices = truth["vertices"].astype(float)
    for k in (0, recording.num_frames - 1):
        off = np.abs(distance_to_rope(recording.frame(k).astype(float), vertices[k]))
        assert np.median(off) < 6e-3
    assert not [w for w in warnings if w.severity == "error"]


def test_the_faults_are_there(clean, noisy):
    """The believed poses differ from the true ones, and clocks by 20 ms."""
    truth = {c.name: c for c in lift_cameras(ROPE)}
    for folder, moved in ((clean, False), (noisy, True)):
        for source in read_cameras(folder).sources:
            off = np.linalg.norm(source.camera.position - truth[source.camera.name].position)
            assert (off > 1e-4) == moved
    first, second = (next(iter(s)).time for s in read_cameras(noisy).sources)
    assert abs(second - first) == pytest.approx(0.02)


def test_a_seed_repeats_a_recording(noisy, tmp_path):
    recorded(tmp_path / "again")
    again = tmp_path / "again"
    for pattern in ("cameras/*/*/*.png", "cameras/*/*.*", "*.csv", "*.toml"):
        assert files(again, pattern) == files(noisy, pattern)


def test_another_seed_gives_other_noise_and_more_frames_no_other_calibration(noisy, tmp_path):
    other, longer = tmp_path / "other", tmp_path / "longer"
    recorded(other, seed=1, rate=1.0)
    recorded(longer, rate=2.0)
    first = "cameras/left/depth/000000.png"
    assert (other / first).read_bytes() != (noisy / first).read_bytes()
    camera = "cameras/*/camera.toml"
    assert files(other, camera) != files(noisy, camera)
    assert files(longer, camera) == files(noisy, camera)


def test_perception_never_reads_the_truth(noisy, tmp_path):
    blind = tmp_path / "blind"
    shutil.copytree(noisy, blind, ignore=shutil.ignore_patterns("truth"))
    assert (noisy / "truth").is_dir() and not (blind / "truth").exists()
    seen, unaided = perceived(noisy), perceived(blind)
    assert seen.num_frames == unaided.num_frames
    np.testing.assert_array_equal(seen.points, unaided.points)
    np.testing.assert_array_equal(seen.gripper_position, unaided.gripper_position)


def test_truth_says_what_was_true(clean, noisy):
    truth = read_json(noisy / "truth" / "truth.json")
    assert truth["object"]["name"] == ROPE.name
    assert truth["E"] == ROPE.material.E
    assert truth["nu"] == ROPE.material.nu
    assert truth["errors"]["clock_offset"] == 0.02
    assert truth["noisy"] and not read_json(clean / "truth" / "truth.json")["noisy"]


def test_an_interrupted_recording_can_be_perceived(rendering, tmp_path):
    folder = tmp_path / "cut"
    frames = []

    def interrupt(moment):
        frames.append(moment)
        if len(frames) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        recorded(folder, noise=False, on_frame=interrupt)
    recording = perceived(folder)
    np.testing.assert_allclose(recording.time, frames)
    with np.load(folder / "truth" / "truth.npz") as truth:
        np.testing.assert_allclose(truth["time"], frames)


def test_a_killed_recording_can_be_perceived(rendering, tmp_path):
    """What is on disk in the middle, where nothing could be tidied up."""
    folder, killed = tmp_path / "going", tmp_path / "killed"

    def kill(moment):
        if moment > 0.0 and not killed.exists():
            shutil.copytree(folder, killed)

    recorded(folder, noise=False, on_frame=kill)
    assert not (killed / "truth").exists()
    recording = perceived(killed)
    assert 2 <= recording.num_frames < perceived(folder).num_frames


def test_a_recording_is_not_overwritten(noisy):
    before = files(noisy, "**/*.*")
    with pytest.raises(GendomError, match="holds a recording already; name another folder"):
        recorded(noisy)
    assert files(noisy, "**/*.*") == before


def test_a_folder_that_cannot_be_made(rendering, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(GendomError, match="file: is a file, not a folder"):
        recorded(tmp_path / "file")


def with_arm(folder, **errors):
    """A short lift by the arm: its motion, and what it measured of its joints and its hand."""
    run = TrialRun(lift(ROPE, rise=0.02), cameras=lift_cameras(ROPE)[:1])
    run.step_to(run.closes)
    with run.world:
        record(run, folder, RecordSettings(frame_rate=1.0), errors=RigErrors(**errors))
    tables = (folder / "joints.csv", folder / "gripper.csv")
    return run, *(np.loadtxt(t, delimiter=",", skiprows=1) for t in tables)


def test_the_arms_joints_are_recorded(rendering, tmp_path):
    run, joints, hand = with_arm(tmp_path / "arm")
    # 1.4 s, and a tenth for cameras whose clocks are ahead
    assert joints.shape[1] == 8 and len(joints) == len(hand) == 151
    assert run.motion is not None
    ideal = run.motion.at(run.closes + joints[:, 0])
    assert np.abs(joints[:, 1:] - ideal).max() < 2e-3
    np.testing.assert_allclose(np.linalg.norm(hand[:, 4:7], axis=1), 1.0, atol=1e-5)


def test_a_robots_clock_and_encoders_are_wrong_where_asked_for(rendering, tmp_path):
    """By what was asked for; the hand is where wrong joints have it, pictures are as they were."""
    _, joints, hand = with_arm(tmp_path / "right")
    _, off, moved = with_arm(tmp_path / "wrong", robot_clock=-0.03, encoders=1e-3)
    np.testing.assert_allclose(off[:, 0], joints[:, 0] - 0.03, atol=2e-6)
    np.testing.assert_array_equal(moved[:, 0], off[:, 0])
    noise = off[:, 1:] - joints[:, 1:]
    assert noise.std() == pytest.approx(1e-3, rel=0.1) and abs(noise.mean()) < 1e-4
    wrong = tcp_pose(XARM7, off[:, 1:]) - tcp_pose(XARM7, joints[:, 1:])
    np.testing.assert_allclose(moved[:, 1:4] - hand[:, 1:4], wrong[:, :3, 3], atol=5e-6)
    assert np.abs(moved[:, 1:4] - hand[:, 1:4]).max() > 3e-4
    times = [
        [frame.time for frame in source] for source in read_cameras(tmp_path / "wrong").sources
    ]
    assert times == [[0.0, 1.0]]
    assert files(tmp_path / "wrong", "cameras/*/*/*.png") == files(
        tmp_path / "right", "cameras/*/*/*.png"
    )


@pytest.mark.parametrize("wrong", [{"robot_clock": 0.2}, {"encoders": -1.0}, {"encoders": np.nan}])
def test_errors_that_cannot_be(wrong):
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        RigErrors(**wrong)


def test_recordings_need_cameras(tmp_path):
    run = TrialRun(lift(ROPE, rise=0.02), robot=False)
    with pytest.raises(ParameterError, match="record: there is no camera"):
        record(run, tmp_path / "none")
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf, 200.0])
def test_bad_frame_rates(rate):
    with pytest.raises(ParameterError, match="frame_rate: is"):
        replace(RecordSettings(), frame_rate=rate)


def test_bad_seeds():
    with pytest.raises(ParameterError, match="seed: is -1; give 0 or more"):
        RecordSettings(seed=-1)


# ---- recorded and perceived in one call ----------------------------------------------------------


@pytest.mark.slow
def test_a_drop_is_recorded_and_perceived_in_one_call(rendering, tmp_path):
    recording, sights = record_and_perceive(ROPE, tmp_path, frame_rate=5.0, seed=3, end="drop")
    assert (tmp_path / "recording.npz").is_file() and len(sights) == 2
    assert not recording.quasi_static
    # It opens 0.5 s after a rise that takes 4.5 s, begun 0.5 s after it closed.
    np.testing.assert_array_equal(recording.holds[:, 0], recording.time < 5.49)
    assert recording.frame(-1)[:, 2].max() < 0.03 < recording.gripper_position[-1, 0, 2]


def test_an_unknown_end_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(RobotError, match="end is 'throw'; choose hold, swing, drop"):
        record_and_perceive(ROPE, tmp_path, end="throw")
    assert list(tmp_path.iterdir()) == []
