"""Several recordings of one object give one estimate of its material."""

from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import ParameterError, RecordingError
from gendom.estimation import Estimate, LiftScene, Problem, estimate
from gendom.estimation.replayed import replay_setup
from gendom.materials.unknowns import UNKNOWNS

GRIPS = (0.004, -0.003)
"""How much higher than stated the rope is held in each lift [m]."""


@pytest.fixture(scope="module")
def lifts(rope_lift):
    """Two lifts, held at other heights."""
    return [rope_lift.seen(seed=seed, grip_height=height) for seed, height in enumerate(GRIPS)]


@pytest.fixture(scope="module")
def together(lifts, settings):
    return estimate(lifts, settings)


def width(found):
    low, high = found.record["intervals"]["bending_length"]
    return np.log(high / low)


def test_two_lifts_tell_more_than_one(rope_lift, together):
    """The interval is narrower than either one's, and holds the truth. The material is one, the
    grip each one's."""
    assert together.usable, together.verdict.reasons
    low, high = together.record["intervals"]["E_over_rho"]
    assert low < rope_lift.truth.E_over_rho < high
    # of E, which goes with the third power of the bending length
    ends = [r["alone"]["interval"] for r in together.record["recordings"]]
    alone = np.array([np.log(high / low) / 3.0 for low, high in ends])
    # independent clouds: precisions add up
    assert width(together) == pytest.approx((alone**-2.0).sum() ** -0.5, rel=0.15)
    assert width(together) < 0.9 * alone.min()
    one, other = together.posterior.thetas
    for name, u in UNKNOWNS.items():
        assert not u.material or getattr(one, name) == getattr(other, name), name
    for k, theta in enumerate((one, other)):
        assert theta.grip_height == pytest.approx(GRIPS[k], abs=0.0015)
        assert together.posterior.sd("grip_height", k) < 0.002
    assert together.theta == one


def test_the_file_has_each_recording_s_own(together, lifts, tmp_path):
    together.save(tmp_path / "estimate.json")
    again = Estimate.load(tmp_path / "estimate.json")
    own = again.record["recordings"]
    assert [r["name"] for r in own] == ["recording 1", "recording 2"]
    assert [r["begins_with"] for r in own] == [lift.begins_with for lift in lifts]
    for lift, theta, r in zip(lifts, together.posterior.thetas, own, strict=True):
        assert replay_setup(lift, again.record, "here", "cpu")[1] == theta
        low, high = r["alone"]["interval"]
        assert low < r["alone"]["E_over_rho"] < high
    assert again.record["rms"] == own[0]["rms"] != own[1]["rms"]
    assert own[1]["chamfer_mean"] == pytest.approx(together.fits[1].chamfer.mean())


def test_what_one_recording_cannot_show_the_other_may(rope_lift, settings):
    """A lift on another clock says nothing of damping: that is the other's, and has no second
    owner."""
    slow = replace(rope_lift.seen(), quasi_static=True)
    slow = replace(slow, time=10.0 * slow.time)
    scenes = [LiftScene.of(r, settings.scene) for r in (slow, rope_lift.seen(seed=1))]
    problem = Problem(scenes, settings)
    names = problem.prior.names
    shown = [[names[k] for k in part.shown] for part in problem.parts]
    assert "damping" not in shown[0] and "damping" in shown[1]
    assert names.count("damping") == 1 and names.count("grip_height") == 2
    vector = problem.prior.vector(*problem.bases)
    comparison = problem.compare([vector])[0]
    assert comparison is not None
    assert comparison.parts[0].J.shape[-1] == len(shown[0])
    # both are simulated with what is one
    vector[names.index("damping")] += 0.5
    assert problem.theta(vector, 0).damping == problem.theta(vector, 1).damping


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"length": 0.26}, "recording 2: length is 0.26, in recording 1 0.25"),
        ({"diameter": None}, "recording 2: diameter is not stated, in recording 1 0.012"),
        ({"mass": 0.03}, "recording 2: mass is 0.03, in recording 1 0.02"),
        (None, "recording 2: shows a cloth, recording 1 a rope"),
        ([], "there is no recording"),
    ],
)
def test_objects_that_differ_are_refused(lifts, cloth_lift, settings, changes, words):
    other = cloth_lift.at_rest()
    if changes:
        other = replace(lifts[1], object=replace(lifts[1].object, **changes))
    with pytest.raises(ParameterError, match=words):
        estimate([] if changes == [] else [lifts[0], other], settings)


def test_a_recording_that_is_not_usable_is_named(lifts, settings):
    """It is not left out silently: the result is not usable. After Ctrl-C, too, what each recording
    says by itself is not looked for."""
    empty = replace(lifts[1], points=np.zeros((0, 3)), offsets=np.zeros(13, dtype=int))
    with pytest.raises(RecordingError, match=r"b\.npz: points: all frames are empty"):
        estimate([lifts[0], empty], settings, names=("a.npz", "b.npz"))

    def interrupt(progress):
        raise KeyboardInterrupt

    found = estimate([lifts[0], lifts[1].head(1)], settings, on_progress=interrupt)
    assert found.record["interrupted"]
    assert not found.usable and found.record["intervals"] is None
    assert any(r.startswith("recording 2: 1 of the 4 frames") for r in found.verdict.reasons)
    assert not any(r.startswith("recording 1") for r in found.verdict.reasons)
    assert [own["alone"] for own in found.record["recordings"]] == [None, None]
