"""Several recordings of one object give one estimate of its material."""

import re
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
    """The interval is narrower than either one's, and holds the truth."""
    assert together.usable, together.verdict.reasons
    low, high = together.record["intervals"]["E_over_rho"]
    assert low < rope_lift.truth.E_over_rho < high
    # of E, which goes with the third power of the bending length
    ends = [r["alone"]["interval"] for r in together.record["recordings"]]
    alone = np.array([np.log(high / low) / 3.0 for low, high in ends])
    # independent clouds: precisions add up
    assert width(together) == pytest.approx((alone**-2.0).sum() ** -0.5, rel=0.15)
    assert width(together) < 0.9 * alone.min()


def test_the_material_is_one_and_the_grip_each_one_s(together):
    one, other = together.posterior.thetas
    for name, u in UNKNOWNS.items():
        if u.material:
            assert getattr(one, name) == getattr(other, name), name
    for theta, height in zip((one, other), GRIPS, strict=True):
        assert theta.grip_height == pytest.approx(height, abs=0.0015)
    assert together.theta == one
    sd = [together.posterior.sd("grip_height", k) for k in (0, 1)]
    assert max(sd) < 0.002


def test_the_file_has_each_recording_s_own(together, lifts, tmp_path):
    together.save(tmp_path / "estimate.json")
    again = Estimate.load(tmp_path / "estimate.json")
    own = again.record["recordings"]
    assert [r["name"] for r in own] == ["recording 1", "recording 2"]
    assert [r["begins_with"] for r in own] == [lift.begins_with for lift in lifts]
    assert again.posterior.thetas == together.posterior.thetas
    assert again.posterior.sd("delay", 1) == together.posterior.sd("delay", 1)
    for lift, theta in zip(lifts, together.posterior.thetas, strict=True):
        assert replay_setup(lift, again.record, "here", "cpu")[1] == theta
    for r in own:
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
    shown = [[problem.prior.names[k] for k in part.shown] for part in problem.parts]
    assert "damping" not in shown[0] and "damping" in shown[1]
    assert problem.prior.names.count("damping") == 1
    assert problem.prior.names.count("grip_height") == 2
    k = problem.prior.names.index("damping")
    vector = problem.prior.vector(*problem.bases)
    comparison = problem.compare([vector])[0]
    assert comparison is not None
    assert comparison.parts[0].J.shape[-1] == len(shown[0])
    # both are simulated with what is one
    vector[k] += 0.5
    assert problem.theta(vector, 0).damping == problem.theta(vector, 1).damping


@pytest.mark.slow
def test_a_hold_and_a_swing_give_modulus_and_damping(rope_lift, lifts, settings):
    """The hold says nothing of damping; with the swing, both come back, the modulus better than
    from either."""
    truth = rope_lift.truth
    swinging = rope_lift.seen(frames=60, swing=0.06, seed=8, damping=0.02)
    # beside damping a lift shows no more than its prior
    hold = estimate(lifts[0], settings)
    assert not hold.posterior.determined("damping")
    found = estimate([lifts[0], swinging], settings)
    assert found.usable, found.verdict.reasons
    assert found.posterior.determined("damping")
    for name, true in (("E_over_rho", truth.E_over_rho), ("damping", 0.02)):
        low, high = found.posterior.interval(name, 0.95)
        assert low < true < high, name
    assert found.theta.damping == pytest.approx(0.02, rel=0.3)
    assert width(found) < width(hold)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"length": 0.26}, "recording 2: length is 0.26, in recording 1 0.25"),
        ({"diameter": None}, "recording 2: diameter is not stated, in recording 1 0.012"),
        ({"mass": 0.03}, "recording 2: mass is 0.03, in recording 1 0.02"),
    ],
)
def test_objects_that_differ_are_refused(lifts, settings, changes, words):
    other = replace(lifts[1], object=replace(lifts[1].object, **changes))
    with pytest.raises(ParameterError, match=words):
        estimate([lifts[0], other], settings)


def test_a_rope_and_a_cloth_are_refused(lifts, cloth_lift, settings):
    with pytest.raises(ParameterError, match=r"b\.npz: shows a cloth, a\.npz a rope"):
        estimate([lifts[0], cloth_lift.at_rest()], settings, names=("a.npz", "b.npz"))
    with pytest.raises(ParameterError, match="there is no recording"):
        estimate([], settings)


def test_a_recording_that_is_not_usable_is_named(rope_lift, lifts, settings):
    """It is not left out silently: the result is not usable."""
    found = estimate([lifts[0], lifts[1].head(1)], settings)
    assert not found.usable and found.record["intervals"] is None
    assert any(r.startswith("recording 2: 1 of the 4 frames") for r in found.verdict.reasons)
    assert not any(r.startswith("recording 1") for r in found.verdict.reasons)
    empty = replace(lifts[1], points=np.zeros((0, 3)), offsets=np.zeros(13, dtype=int))
    with pytest.raises(RecordingError, match="recording 2: points: all frames are empty"):
        estimate([lifts[0], empty], settings)


@pytest.mark.slow
def test_lifts_of_two_ropes_are_told_apart(rope_lift, lifts, settings):
    """A rope three times as stiff, of the same sizes, is none that both could be."""
    modulus = 3.0 * rope_lift.truth.E_over_rho
    other = rope_lift.seen(seed=4, E_over_rho=modulus)
    found = estimate([lifts[0], other], settings)
    assert not found.usable
    said = [r for r in found.verdict.reasons if "do not show one object" in r]
    assert said and said[0].startswith("recording 1 and recording 2")
    by_itself = [float(x) for x in re.findall(r"(\S+) (?:and|m\^2)", said[0].partition(" is ")[2])]
    assert by_itself == pytest.approx([modulus / 3.0, modulus], rel=0.1)
    assert [r["alone"] for r in found.record["recordings"]] == [None, None]  # none is usable


def test_ctrl_c_ends_all_of_the_search(lifts, settings):
    """What each recording says by itself is then not looked for."""

    def interrupt(progress):
        raise KeyboardInterrupt

    record = estimate(lifts, settings, on_progress=interrupt).record
    assert record["interrupted"]
    assert [own["alone"] for own in record["recordings"]] == [None, None]
