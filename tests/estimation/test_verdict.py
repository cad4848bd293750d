"""What no estimate may be read off is refused, and what is good is not."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from experiments.verdict import CORRUPTED
from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.estimation import EstimateSettings, LiftScene, Problem, Theta, estimate
from gendom.estimation.verdict import _blamed_on_cameras, refused_before
from gendom.materials import STANDARD_GRAVITY
from gendom.materials.parameters import bending_length


def still(recording):
    """The first frame, again and again."""
    first, frames = recording.frame(0), recording.num_frames
    return replace(
        recording,
        points=np.concatenate([first] * frames),
        offsets=np.arange(frames + 1) * len(first),
        gripper_position=np.repeat(recording.gripper_position[:1], frames, axis=0),
    )


def test_the_demo_s_lift_is_usable():
    place = str(files("gendom") / "assets" / "demo-rope-lift.npz")
    found = estimate(Recording.read(place), EstimateSettings(starts=1))
    assert found.usable, found.verdict.reasons


def test_a_cloth_that_moves_like_none_is_refused(cloth_lift):
    """One that bulges by 12 mm as it is lifted, more than twice its E would move it."""
    seen = cloth_lift.seen(frames=8)
    clouds = []
    for k in range(seen.num_frames):
        cloud = seen.frame(k).astype(float)
        share = np.sin(np.pi * k / (seen.num_frames - 1)) * np.sin(10.0 * np.pi * cloud[:, 1])
        clouds.append(cloud + 0.012 * share[:, None] * [1.0, 0.0, 1.0])
    settings = EstimateSettings(starts=1, max_iterations=4, scene=cloth_lift.settings)
    found = estimate(cloth_lift.recording(clouds), settings)
    assert any("otherwise than any simulated one" in reason for reason in found.verdict.reasons)


@pytest.mark.parametrize(("share", "usable"), [(0.1, True), (0.4, False)])
def test_a_rope_that_slips_through_the_fingers_is_refused(rope_lift, settings, share, usable):
    """Where it slips by so much of its lift that E suffers; less of it makes no harm."""
    recording = rope_lift.seen(frames=16, noise=2e-3)
    slid = share * rope_lift.rise * np.clip((np.linspace(0.0, 1.0, 16) - 0.3) / 0.5, 0.0, 1.0)
    path = recording.gripper_position.copy()
    path[:, 0, 2] += slid
    settings = replace(settings, max_iterations=25 if usable else 6)
    found = estimate(replace(recording, gripper_position=path), settings)
    assert found.usable is usable, found.verdict.reasons
    if usable:
        modulus = rope_lift.truth.E_over_rho
        truth = bending_length(modulus, 0.012 / 4.0, STANDARD_GRAVITY)
        low, high = found.interval("bending_length") or (0.0, 0.0)
        assert low < truth < high < 1.25 * low
    else:
        assert any("otherwise than any simulated one" in said for said in found.verdict.reasons)


def of_mixed_depth(lift, diameter=0.005):
    """A lift of a thin rope, half of whose points are moved along the cameras' views."""
    thin = replace(
        lift,
        object=replace(lift.object, diameter=diameter, mass=lift.object.mass / 5.76),
        truth=Theta(E_over_rho=5.76 * lift.truth.E_over_rho),
        lying=lift.lying * [1.0, 1.0, diameter / 0.012],
        lowest=diameter / 2.0,
    )
    seen, rng = thin.seen(frames=16, noise=1.5e-3), np.random.default_rng(0)
    views = np.array([0.0, 0.8, -0.6]) * rng.choice([-1.0, 1.0], size=(len(seen.points), 1))
    views[:, 2] = -0.6
    mixed = np.where(rng.random(len(views)) < 0.5, rng.exponential(0.008, len(views)), 0.0)
    return thin, replace(seen, points=seen.points + mixed[:, None] * views)


def test_a_thin_rope_of_mixed_depth_is_usable(rope_lift, settings):
    thin, seen = of_mixed_depth(rope_lift)
    found = estimate(seen, settings)
    assert found.usable, found.verdict.reasons
    low, high = found.record["intervals"]["E_over_rho"]
    assert low < thin.truth.E_over_rho < high < 2.0 * low


@pytest.mark.parametrize("times", [0.5, 2.5])
def test_a_thin_rope_of_another_thickness_is_refused(rope_lift, settings, times):
    """By its breadth across the views: points of such noise lie about any thickness."""
    _, seen = of_mixed_depth(rope_lift)
    described = replace(seen.object, diameter=times * seen.object.diameter, mass=None)
    found = estimate(replace(seen, object=described), settings)
    assert any("cameras see" in said for said in found.verdict.reasons), found.verdict.reasons


def test_the_end_of_a_cloud_is_compared_with_a_line(rope_lift):
    """Not with points of the rod, that are 62 mm apart here."""
    shorter = replace(rope_lift, lying=rope_lift.lying[rope_lift.lying[:, 0] < 0.244])
    settings = replace(rope_lift.settings, points=5)
    scene = LiftScene.of(shorter.at_rest(12), settings)
    problem = Problem([scene], EstimateSettings(starts=1, scene=settings))
    assert not refused_before(problem)


@pytest.mark.parametrize(
    ("spoiled", "reason"),
    [
        ("mass x 10", "is the mass in kilograms"),
        ("time in minutes", "are times in seconds"),
        ("frame numbers as time", "are times frame numbers"),
        ("size / 1.25", "beyond the end of an object"),
        ("size x 1.25", "before the end of an object"),
        ("thickness x 2", "its diameter is 24 mm"),
        ("gripper 5 cm along", "before the end of an object"),
        (lambda recording: recording.head(1), "1 of the 4 frames"),
        (still, "the gripper moves by 0 m"),
        ("y up", "under the table"),
        ("uniform noise", "do not belong to the object"),
        ("clouds x 1.43", "otherwise than any simulated one"),
    ],
)
def test_what_cannot_be_used_is_said(lifted, settings, spoiled, reason):
    """With the reason in words, and without intervals."""
    spoil = CORRUPTED[spoiled] if isinstance(spoiled, str) else spoiled
    found = estimate(spoil(lifted), replace(settings, max_iterations=10))
    assert not found.usable
    assert any(reason in said for said in found.verdict.reasons), found.verdict.reasons
    assert found.record["verdict"] == {"usable": False, "reasons": list(found.verdict.reasons)}
    assert found.record["intervals"] is None and found.interval("E") is None
    assert "not usable" in repr(found) and "90%" not in repr(found)
    assert np.array_equal(found.posterior.covariance, np.diag(found.posterior.prior.sd**2))
    assert found.record["recordings"][0]["alone"] is None
    assert not any(found.record["identifiable"].values())


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"mass": 28.0}, "it looks like grams"),
        ({"length": 2.5}, "is its length in metres"),
        (None, "lie at its place of another time"),
    ],
)
def test_what_cannot_be_read_or_placed_is_refused(lifted, settings, changes, reason):
    wrong = replace(lifted, gripper_position=lifted.gripper_position[::-1])
    if changes is not None:
        wrong = replace(lifted, object=replace(lifted.object, **changes))
    with pytest.raises(RecordingError, match=reason):
        estimate(wrong, settings)


def test_what_is_assumed_counts_in_intervals(lifted, settings):
    """Without diameter and mass E may be anything, and the bending length is known as before."""
    described = replace(lifted.object, diameter=None, mass=None)
    without = estimate(replace(lifted, object=described), settings)
    measured = replace(lifted.object, diameter_sd=1e-5)
    found = estimate(replace(lifted, object=measured), settings)

    def width(one, key):
        low, high = one.record["intervals"][key]
        return np.log(high / low)

    assert without.record["density_assumed"] and "the mass is unknown" in repr(without)
    assert width(without, "E") > 2.0 > 10.0 * width(found, "E")
    assert width(without, "bending_length") < 1.5 * width(found, "bending_length")
    low, high = without.record["intervals"]["E_over_rho"]
    assert low < found.theta.E_over_rho < high


def test_a_cloth_of_another_size_is_refused(cloth_lift):
    """It lies flat before it is lifted, so that its sides are seen."""
    seen = cloth_lift.seen(frames=6, points=1500)
    described = replace(seen.object, width=0.23, height=0.23)
    settings = EstimateSettings(starts=1, max_iterations=2, scene=cloth_lift.settings)
    found = estimate(replace(seen, object=described), settings)
    assert any("fills a rectangle" in reason for reason in found.verdict.reasons)


@pytest.fixture(scope="module")
def seen(cloth_lift):
    """Each half of the points by a camera."""
    lift = cloth_lift.seen(points=400)
    return replace(lift, seen_by=np.where(np.arange(len(lift.points)) % 2, 1, 2))


def compared(cloth_lift, recording):
    settings = EstimateSettings(scene=cloth_lift.settings)
    problem = Problem([LiftScene.of(recording, cloth_lift.settings)], settings)
    truth = problem.prior.vector(cloth_lift.truth)
    comparisons = problem.compare([truth], derivatives=False)[0]
    assert comparisons is not None
    return problem.parts[0], comparisons.parts[0]


def drifted(recording, by):
    """The second camera is off from the middle of the lift on."""
    points, half = recording.points.copy(), recording.offsets[recording.num_frames // 2]
    late = (np.arange(len(points)) >= half) & (recording.seen_by == 2)
    return replace(recording, points=points + np.outer(late, by))


def test_a_camera_that_drifts_is_named(cloth_lift, seen):
    part, comparison = compared(cloth_lift, drifted(seen, (0.0, 0.006, 0.01)))
    far, first, last = comparison.cameras_apart()
    assert far == pytest.approx(0.0117, abs=0.004)
    assert seen.num_frames // 2 <= first < last < seen.num_frames
    thick = "points lie 4.0 mm outside an object 2 mm thick: is its thickness right?"
    (said,) = _blamed_on_cameras([thick], part, comparison)
    assert f"frames {first} to {last} two cameras place the object {1e3 * far:.0f} mm" in said
