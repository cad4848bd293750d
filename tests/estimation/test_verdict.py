"""What no estimate may be read off is refused, and what is good is not."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from experiments.verdict import CORRUPTED
from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.estimation import EstimateSettings, LiftScene, Problem, Theta, estimate
from gendom.estimation.placing import lying_rectangle
from gendom.estimation.verdict import recording_faults, refused_before
from gendom.materials import STANDARD_GRAVITY
from gendom.materials.parameters import bending_length


@pytest.fixture(scope="module")
def settings(rope_lift):
    return EstimateSettings(starts=1, max_iterations=10, scene=rope_lift.settings)


@pytest.fixture(scope="module")
def lifted(rope_lift):
    return rope_lift.seen()


def still(recording):
    """The first frame, again and again."""
    first, frames = recording.frame(0), recording.num_frames
    return replace(
        recording,
        points=np.concatenate([first] * frames),
        offsets=np.arange(frames + 1) * len(first),
        gripper_position=np.repeat(recording.gripper_position[:1], frames, axis=0),
    )


def y_up(recording):
    return replace(
        recording,
        points=recording.points[:, [0, 2, 1]],
        gripper_position=recording.gripper_position[..., [0, 2, 1]],
    )


def uniform_noise(recording):
    """As many points anywhere in the box of all clouds."""
    low, high = recording.points.min(axis=0), recording.points.max(axis=0)
    points = np.random.default_rng(0).uniform(low, high, size=recording.points.shape)
    return replace(recording, points=points)


def in_grams(recording):
    described = recording.object
    return replace(recording, object=replace(described, mass=1e3 * described.mass))


def backwards(recording):
    return replace(recording, gripper_position=recording.gripper_position[::-1])


def scaled(recording):
    return replace(recording, points=1.43 * recording.points)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_good_lift_is_usable(rope_lift, settings, seed):
    found = estimate(rope_lift.seen(seed=seed, noise=2e-3), settings)
    assert found.usable, found.verdict.reasons
    assert found.verdict.text == "usable" and found.interval("E") is not None


def test_the_demo_s_lift_is_usable():
    place = str(files("gendom") / "assets" / "demo-rope-lift.npz")
    found = estimate(Recording.read(place), EstimateSettings(starts=1))
    assert found.usable, found.verdict.reasons


@pytest.mark.slow
def test_a_good_lift_of_a_cloth_is_usable(cloth_lift):
    settings = EstimateSettings(starts=1, scene=cloth_lift.settings)
    found = estimate(cloth_lift.seen(points=400), settings)
    assert found.usable, found.verdict.reasons


def test_a_cloth_that_moves_like_none_is_refused(cloth_lift):
    """One that bulges by 12 mm as it is lifted, more than twice its E would move it."""
    seen = cloth_lift.seen()
    clouds = []
    for k in range(seen.num_frames):
        cloud = seen.frame(k).astype(float)
        share = np.sin(np.pi * k / (seen.num_frames - 1)) * np.sin(10.0 * np.pi * cloud[:, 1])
        clouds.append(cloud + 0.012 * share[:, None] * [1.0, 0.0, 1.0])
    found = estimate(
        cloth_lift.recording(clouds), EstimateSettings(starts=1, scene=cloth_lift.settings)
    )
    assert any("otherwise than any simulated one" in reason for reason in found.verdict.reasons)


@pytest.mark.parametrize(("share", "usable"), [(0.0, True), (0.1, True), (0.4, False)])
def test_a_rope_that_slips_through_the_fingers_is_refused(rope_lift, share, usable):
    """Where it slips by so much of its lift that E suffers; less of it makes no harm."""
    settings = EstimateSettings(starts=1, scene=rope_lift.settings)
    recording = rope_lift.seen(frames=24, noise=2e-3)
    slid = share * rope_lift.rise * np.clip((np.linspace(0.0, 1.0, 24) - 0.3) / 0.5, 0.0, 1.0)
    path = recording.gripper_position.copy()
    path[:, 0, 2] += slid
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


def test_a_thin_rope_of_mixed_depth_is_usable(rope_lift):
    thin, seen = of_mixed_depth(rope_lift)
    found = estimate(seen, EstimateSettings(starts=1, scene=rope_lift.settings))
    assert found.usable, found.verdict.reasons
    low, high = found.record["intervals"]["E_over_rho"]
    assert low < thin.truth.E_over_rho < high < 2.0 * low


def test_the_end_of_a_cloud_is_compared_with_a_line(rope_lift):
    """Not with points of the rod, that are 62 mm apart here."""
    shorter = replace(rope_lift, lying=rope_lift.lying[rope_lift.lying[:, 0] < 0.244])
    settings = replace(rope_lift.settings, points=5)
    scene = LiftScene.of(shorter.at_rest(12), settings)
    problem = Problem([scene], EstimateSettings(starts=1, scene=settings))
    assert not refused_before(problem)


def one_frame(recording):
    return replace(recording.head(1), quasi_static=True)


@pytest.mark.parametrize(
    ("spoiled", "reason"),
    [
        ("mass / 10", "is the mass in kilograms"),
        ("mass x 10", "is the mass in kilograms"),
        ("time in minutes", "are times in seconds"),
        ("frame numbers as time", "are times frame numbers"),
        ("size / 1.25", "beyond the end of an object"),
        ("size x 1.25", "before the end of an object"),
        ("thickness x 2", "its diameter is 24 mm"),
        ("gripper 5 cm along", "before the end of an object"),
        (lambda recording: recording.head(1), "1 of the 4 frames"),
        (one_frame, "1 of the 4 frames"),
        (still, "the gripper moves by 0 m"),
        (y_up, "under the table"),
        (uniform_noise, "do not belong to the object"),
        (scaled, "otherwise than any simulated one"),
    ],
)
def test_what_cannot_be_used_is_said(lifted, settings, spoiled, reason):
    """With the reason in words, and without intervals."""
    spoil = CORRUPTED[spoiled] if isinstance(spoiled, str) else spoiled
    found = estimate(spoil(lifted), settings)
    assert not found.usable
    assert any(reason in said for said in found.verdict.reasons), found.verdict.reasons
    assert found.record["verdict"] == {"usable": False, "reasons": list(found.verdict.reasons)}
    assert found.record["intervals"] is None and found.interval("E") is None
    assert "not usable" in repr(found) and "90%" not in repr(found)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [(in_grams, "it looks like grams"), (backwards, "lie at its place of another time")],
)
def test_what_reading_would_refuse_is_refused(lifted, settings, spoil, reason):
    with pytest.raises(RecordingError, match=reason):
        estimate(spoil(lifted), settings)


def test_times_in_milliseconds_are_told_from_the_speed(lifted):
    slow = replace(lifted, time=1e3 * lifted.time)
    assert any("are times in seconds" in said for said in recording_faults(slow, 1000.0))
    assert recording_faults(lifted, 1000.0) == []


def test_a_refused_recording_tells_nothing(lifted, settings):
    """No interval is left in the file or the posterior, by itself or together."""
    found = estimate(scaled(lifted), settings)
    assert np.array_equal(found.posterior.covariance, np.diag(found.posterior.prior.sd**2))
    assert found.record["recordings"][0]["alone"] is None
    assert not any(found.record["identifiable"].values())


def test_what_is_assumed_counts_in_intervals(lifted, settings):
    """Without diameter and mass E may be anything, and the bending length is known as before."""
    described = replace(lifted.object, diameter=None, mass=None)
    without = estimate(replace(lifted, object=described), settings)
    measured = replace(lifted.object, diameter_sd=1e-5)
    found = estimate(replace(lifted, object=measured), settings)

    def ends(one, key):
        found = one.interval(key)
        assert found is not None
        return found

    def width(one, key):
        low, high = ends(one, key)
        return np.log(high / low)

    assert width(without, "E") > 2.0 > 10.0 * width(found, "E")
    assert width(without, "bending_length") < 1.5 * width(found, "bending_length")
    low, high = ends(without, "E_over_rho")
    assert low < found.theta.E_over_rho < high


@pytest.mark.parametrize("yaw", [0.0, 0.3, 1.2])
def test_sides_of_a_cloth_that_lies_flat(yaw):
    rng = np.random.default_rng(0)
    points = rng.uniform(0.0, 1.0, (4000, 2)) * [0.3, 0.2]
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    seen = lying_rectangle((points + 0.001 * rng.standard_normal(points.shape)) @ turn.T)
    assert seen == pytest.approx((0.3, 0.2), abs=0.004)
    folded = points[points.sum(axis=1) < 0.3]
    assert lying_rectangle(folded @ turn.T) is None


def test_a_cloth_of_another_size_is_refused(cloth_lift):
    """It lies flat before it is lifted, so that its sides are seen."""
    seen = cloth_lift.seen(points=1500)
    described = replace(
        seen.object, width=1.15 * seen.object.width, height=1.15 * seen.object.height
    )
    settings = EstimateSettings(starts=1, max_iterations=2, scene=cloth_lift.settings)
    found = estimate(replace(seen, object=described), settings)
    assert any("fills a rectangle" in reason for reason in found.verdict.reasons)


def test_a_rope_ten_times_as_long_as_seen_is_refused(lifted, settings):
    longer = replace(lifted, object=replace(lifted.object, length=2.5))
    with pytest.raises(RecordingError, match="is its length in metres"):
        estimate(longer, settings)
