"""Recordings of the second reality: what is written, and that perception can read it."""

import shutil
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from gendom.errors import GendomError, ParameterError
from gendom.perception import PerceptionSettings, perceive, read_cameras
from gendom.reading import read_json
from gendom.reality import OBJECTS, RealRope, TrialRun, lift, lift_cameras, record
from gendom.reality.world import FINGER_WIDTH
from gendom.robot import XARM7, LiftMotion, predefined_lift, tcp_pose

ROPE = cast(RealRope, OBJECTS["rope-polyester"])
RATE = 2.5


def small(camera):
    """With half the pixels along each side, which are drawn in a third of the time."""
    K = camera.K * 0.5 - np.array([[0, 0, 0.25], [0, 0, 0.25], [0, 0, -0.5]])
    return replace(camera, width=320, height=240, K=K)


CAMERAS = [small(camera) for camera in lift_cameras(ROPE)]


def recorded(folder, *, noise=True, end="hold", cameras=CAMERAS, **kwargs):
    """A short lift by a free hand, from the closing of the hand on."""
    motion = replace(predefined_lift("rope", end), rise=0.04 / ROPE.length)
    trial = replace(lift(ROPE, motion), timestep=1e-3)
    run = TrialRun(trial, robot=False, cameras=cameras)
    run.step_to(run.closes)
    with run.world:
        record(run, folder, frame_rate=RATE, exact=not noise, **kwargs)
    return run


def perceived(folder):
    cameras = read_cameras(folder, on_warning=print)
    return perceive(cameras, PerceptionSettings(colour=ROPE.colour), on_warning=print).recording


def truth_of(folder):
    """Times [M] and vertices [M, V, 3]."""
    with np.load(folder / "truth" / "truth.npz") as truth:
        return truth["time"], truth["vertices"].astype(float)


@pytest.fixture(scope="module")
def recordings(rendering, tmp_path_factory):
    """Folders of a recording without faults and one with the usual ones."""
    folders = [tmp_path_factory.mktemp("recordings") / name for name in ("clean", "noisy")]
    for folder in folders:
        recorded(folder, noise=folder.name == "noisy")
    return folders


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


def test_what_is_recorded_is_where_it_truly_is(recordings):
    """Clouds of the exact cameras lie on the rope's surface, in every frame and to its ends."""
    clean, _ = recordings
    recording = perceived(clean)
    time, vertices = truth_of(clean)
    # 0.5 s wait, 0.8 s rise, 0.5 s after
    assert len(time) == recording.num_frames == int(1.8 * RATE) + 1
    np.testing.assert_allclose(recording.time, time, atol=1e-9)
    assert recording.quasi_static and recording.holds.all()
    for k in range(recording.num_frames):
        points = recording.frame(k).astype(float)
        assert len(points) > 80
        assert np.median(np.abs(distance_to_rope(points, vertices[k]))) < 1e-3
        # Its lower side is out of view, its ends are not.
        assert np.ptp(points[:, 0]) > 0.8 * np.ptp(vertices[k, :, 0])
    path = recording.gripper_position[:, 0]
    # Half a finger's breadth from the rope's end, which lies 0.32 m in front of the base.
    assert path[0] == pytest.approx([0.3325, 0.0, ROPE.diameter / 2.0], abs=1e-3)
    assert path[-1] - path[0] == pytest.approx([0.0, 0.0, 0.04], abs=1e-3)
    said, edge = read_cameras(clean).meta["object"], 0.3 / 17
    held = FINGER_WIDTH / 2.0 + said.pop("grasp_radius")
    assert said == {"kind": "rope", "grasp": "end", "length": ROPE.length, "mass": ROPE.mass,
                    "diameter": ROPE.diameter, "grasp_inset": FINGER_WIDTH / 2.0}  # fmt: skip
    # the rope bends from half an edge before the last vertex that is held
    assert (held / edge - 0.5) % 1.0 < 1e-9 and abs(held - FINGER_WIDTH) < edge / 2.0 + 1e-9
    # A recording does not give away what is to be estimated.
    given = (clean / "object.toml").read_text().lower()
    assert not any(word in given for word in ("young", "poisson", "density", "polyester"))


def test_a_noisy_recording_is_perceived_without_its_truth_and_repeats(recordings, tmp_path):
    """Twenty milliseconds between the cameras are just what matching tolerates."""
    clean, noisy = recordings
    recording, vertices = perceived(noisy), truth_of(noisy)[1]
    assert recording.num_frames >= int(1.8 * RATE)
    for k in (0, recording.num_frames - 1):
        off = np.abs(distance_to_rope(recording.frame(k).astype(float), vertices[k]))
        assert np.median(off) < 6e-3
    # the faults are there
    said = read_json(noisy / "truth" / "truth.json")
    assert said["noisy"] and not read_json(clean / "truth" / "truth.json")["noisy"]
    assert (said["E"], said["errors"]["clock_offset"]) == (ROPE.material.E, 0.02)
    truth = {c.name: c for c in lift_cameras(ROPE)}
    for folder, moved in ((clean, False), (noisy, True)):
        for source in read_cameras(folder).sources:
            off = np.linalg.norm(source.camera.position - truth[source.camera.name].position)
            assert (off > 1e-4) == moved
    first, second = (next(iter(s)).time for s in read_cameras(noisy).sources)
    assert abs(second - first) == pytest.approx(0.02)
    # a seed repeats a recording
    again = tmp_path / "again"
    recorded(again)
    for pattern in ("cameras/*/*/*.png", "cameras/*/*.*", "*.csv", "*.toml"):
        assert files(again, pattern) == files(noisy, pattern)
    # perception never reads the truth
    shutil.rmtree(again / "truth")
    unaided = perceived(again)
    np.testing.assert_array_equal(recording.points, unaided.points)
    np.testing.assert_array_equal(recording.gripper_position, unaided.gripper_position)


def test_an_interrupted_recording_can_be_perceived(rendering, tmp_path):
    """Also what is on disk in the middle, where nothing can be tidied up after a kill."""
    folder, killed = tmp_path / "cut", tmp_path / "killed"
    frames = []

    def interrupt(moment):
        frames.append(moment)
        if len(frames) == 3:
            shutil.copytree(folder, killed)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        recorded(folder, noise=False, on_frame=interrupt)
    assert not (killed / "truth").exists()
    assert 2 <= perceived(killed).num_frames <= 3
    recording = perceived(folder)
    np.testing.assert_allclose(recording.time, frames)
    np.testing.assert_allclose(truth_of(folder)[0], frames)


def test_places_that_cannot_be_written(recordings, tmp_path):
    _, noisy = recordings
    before = files(noisy, "**/*.*")
    with pytest.raises(GendomError, match="holds a recording already; name another folder"):
        recorded(noisy)
    assert files(noisy, "**/*.*") == before
    (tmp_path / "file").write_text("")
    with pytest.raises(GendomError, match="file: is a file, not a folder"):
        recorded(tmp_path / "file")


def test_the_arms_joints_are_recorded(rendering, tmp_path):
    """As the motion has them, and a tenth of a second longer than the pictures."""
    motion = LiftMotion(kind="rope", rise=0.01 / ROPE.length, speed=0.05)
    run = TrialRun(replace(lift(ROPE, motion), timestep=1e-3), cameras=CAMERAS[:1])
    run.step_to(run.closes)
    with run.world:
        record(run, tmp_path, frame_rate=1.0)
    joints, hand = (
        np.loadtxt(tmp_path / f"{name}.csv", delimiter=",", skiprows=1)
        for name in ("joints", "gripper")
    )
    assert joints.shape[1] == 8 and len(joints) == len(hand) == 131
    assert run.motion is not None
    ideal = run.motion.at(run.closes + joints[:, 0])
    assert np.abs(joints[:, 1:] - ideal).max() < 2e-3
    np.testing.assert_allclose(np.linalg.norm(hand[:, 4:7], axis=1), 1.0, atol=1e-5)
    np.testing.assert_allclose(hand[:, 1:4], tcp_pose(XARM7, joints[:, 1:])[:, :3, 3], atol=5e-6)
    (source,) = read_cameras(tmp_path).sources
    assert [frame.time for frame in source] == [0.0, 1.0]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        *(({"frame_rate": rate}, "frame_rate: is") for rate in (0.0, np.nan, np.inf, 200.0)),
        ({"seed": -1}, "seed: is -1; give 0 or more"),
        ({}, "record: there is no camera"),
    ],
)
def test_what_cannot_be_recorded(tmp_path, given, said):
    with pytest.raises(ParameterError, match=said):
        record(TrialRun(lift(ROPE), robot=False), tmp_path / "none", **given)
    assert not (tmp_path / "none").exists()
