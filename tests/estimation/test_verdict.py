"""What no estimate may be read off is refused, and what is good is not.

Each bound stands in `test_exact_verdict.py`; here whole estimates meet them.
"""

from dataclasses import replace
from importlib.resources import files
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.verdict import CORRUPTED
from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.estimation import EstimateSettings, Theta, estimate
from gendom.estimation.methods.search import estimated_noise
from gendom.estimation.problem import Problem
from gendom.estimation.scene import LiftScene


def test_the_demo_s_lift_is_usable():
    place = str(files("gendom") / "assets" / "demo-rope-lift.npz")
    found = estimate(Recording.read(place), EstimateSettings(starts=1))
    assert found.usable, found.verdict.reasons


@pytest.mark.parametrize(
    ("spoiled", "reason"),
    [
        ("mass x 10", "is the mass in kilograms"),
        ("uniform noise", "do not belong to the object"),
        (lambda recording: recording.head(1), "1 of the 4 frames"),
    ],
)
def test_what_cannot_be_used_is_said(lifted, settings, spoiled, reason):
    """With the reason in words, and without intervals."""
    spoil = CORRUPTED[spoiled] if isinstance(spoiled, str) else spoiled
    found = estimate(spoil(lifted), replace(settings, max_iterations=4))
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
    wrong = {"gripper_position": lifted.gripper_position[::-1]}
    if changes is not None:
        wrong = {"object": replace(lifted.object, **changes)}
    with pytest.raises(RecordingError, match=reason):
        estimate(replace(lifted, **wrong), settings)


@pytest.mark.parametrize(("share", "usable"), [(0.1, True), (0.4, False)])
def test_a_rope_that_slips_through_the_fingers_is_refused(rope_lift, settings, share, usable):
    """Where it slips by so much of its lift that E suffers; less of it makes no harm."""
    recording = rope_lift.seen(frames=16, noise=2e-3)
    slid = share * rope_lift.rise * np.clip((np.linspace(0.0, 1.0, 16) - 0.3) / 0.5, 0.0, 1.0)
    path = recording.gripper_position.copy()
    path[:, 0, 2] += slid
    settings = replace(settings, max_iterations=25 if usable else 4)
    found = estimate(replace(recording, gripper_position=path), settings)
    assert found.usable is usable, found.verdict.reasons
    if usable:
        low, high = found.interval("E_over_rho") or (0.0, 0.0)
        assert low < rope_lift.truth.E_over_rho < high < 2.0 * low
    else:
        assert any("otherwise than any simulated one" in said for said in found.verdict.reasons)


def test_a_thin_rope_of_mixed_depth_is_usable(rope_lift, settings):
    """Half of whose points are moved along the cameras' views."""
    diameter = 0.005
    thin = replace(
        rope_lift,
        object=replace(rope_lift.object, diameter=diameter, mass=rope_lift.object.mass / 5.76),
        truth=Theta(E_over_rho=5.76 * rope_lift.truth.E_over_rho),
        lying=rope_lift.lying * [1.0, 1.0, diameter / 0.012],
        lowest=diameter / 2.0,
    )
    seen, rng = thin.seen(frames=16, noise=1.5e-3), np.random.default_rng(0)
    views = np.array([0.0, 0.8, -0.6]) * rng.choice([-1.0, 1.0], size=(len(seen.points), 1))
    views[:, 2] = -0.6
    mixed = np.where(rng.random(len(views)) < 0.5, rng.exponential(0.008, len(views)), 0.0)
    found = estimate(replace(seen, points=seen.points + mixed[:, None] * views), settings)
    assert found.usable, found.verdict.reasons
    low, high = found.record["intervals"]["E_over_rho"]
    assert low < thin.truth.E_over_rho < high < 2.0 * low


def test_what_is_assumed_counts_in_intervals(lifted, settings, found):
    """Without diameter and mass E may be anything, and the bending length is known as before."""
    described = replace(lifted.object, diameter=None, mass=None)
    without = estimate(replace(lifted, object=described), settings)

    def width(one, key):
        low, high = one.record["intervals"][key]
        return np.log(high / low)

    assert without.record["density_assumed"] and "the mass is unknown" in repr(without)
    assert width(without, "E") > 2.0 > 2.0 * width(found, "E")
    assert width(without, "bending_length") < 1.5 * width(found, "bending_length")
    low, high = without.record["intervals"]["E_over_rho"]
    assert low < found.theta.E_over_rho < high


@pytest.fixture(scope="module")
def sheet(cloth_lift):
    """Each half of the points by a camera."""
    lift = cloth_lift.seen(frames=8, points=1500)
    return replace(lift, seen_by=np.where(np.arange(len(lift.points)) % 2, 1, 2))


def bulging(sheet):
    """By 12 mm as it is lifted, more than twice its E would move it."""
    frame = np.repeat(np.arange(sheet.num_frames), np.diff(sheet.offsets))
    share = np.sin(np.pi * frame / (sheet.num_frames - 1)) * np.sin(
        10.0 * np.pi * sheet.points[:, 1]
    )
    return replace(sheet, points=sheet.points + 0.012 * share[:, None] * [1.0, 0.0, 1.0])


def drifted(sheet):
    """The second camera is off by 17 mm from the middle of the lift on."""
    late = np.arange(len(sheet.points)) >= sheet.offsets[sheet.num_frames // 2]
    off = np.outer(late & (sheet.seen_by == 2), (0.0, 0.009, 0.015))
    return replace(sheet, points=sheet.points + off)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (bulging, "otherwise than any simulated one"),
        (drifted, "in frames 4 to 5 two cameras place the object 1"),
    ],
)  # fmt: skip
def test_a_cloth_that_cannot_be_used_is_refused(cloth_lift, sheet, spoil, reason):
    """One that moves like none, or seen by a camera that drifts."""
    settings = EstimateSettings(
        starts=1, max_iterations=2, unknowns=("E_over_rho", "grip_tilt"), scene=cloth_lift.settings
    )
    found = estimate(spoil(sheet), settings, known=cloth_lift.truth)
    assert any(reason in said for said in found.verdict.reasons), found.verdict.reasons


def test_cameras_that_are_apart_are_not_noise_of_a_cloth(cloth_lift, sheet):
    """One is off by 5 mm throughout."""
    apart = replace(sheet, points=sheet.points + np.outer(sheet.seen_by == 2, (0.0, 0.003, 0.004)))
    settings, noise = EstimateSettings(scene=cloth_lift.settings), []
    for seen in (sheet, apart):
        problem = Problem([LiftScene.of(seen, settings.scene)], settings)
        vector = problem.prior.vector(cloth_lift.truth)
        (compared,) = problem.compare([vector], derivatives=False)
        assert compared is not None
        noise.append(estimated_noise(compared, problem.first_noise())[0])
    assert noise[1].sensor < 1.1 * noise[0].sensor
    assert noise[1].model < 1.5 * noise[0].model


@pytest.mark.parametrize(
    ("bends", "far", "kept"), [(0.01, 5, 5), (0.01, 4, 6), (0.01, 6, 6), (0.03, 5, 6)]
)
def test_a_limp_cloth_is_followed_until_it_buckles(
    cloth_lift, sheet, monkeypatch, bends, far, kept
):
    """Not where it does so at once; a stiff one throughout."""
    settings = EstimateSettings(scene=cloth_lift.settings)
    problem = Problem([LiftScene.of(sheet, settings.scene)], settings)
    scene, off = problem.scene, np.where(np.arange(6) < far, 0.002, 0.006)
    assert len(scene.frames) == 6
    seen = SimpleNamespace(parts=[SimpleNamespace(rms_by_frame=lambda: list(off))])
    monkeypatch.setattr(problem, "compare", lambda vectors, derivatives: [seen])
    theta = cloth_lift.truth.with_values({"E_over_rho": scene.E_over_rho(bends)})
    found = problem.followed(problem.prior.vector(theta)).scene
    assert found.frames == scene.frames[:kept]
    assert ("buckled" in " ".join(found.notes)) == (kept < 6)
