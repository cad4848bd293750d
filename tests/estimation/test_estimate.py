"""Known parameters come back from lifts that were simulated with them, and from files."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import ParameterError, RecordingError
from gendom.estimation import (
    UNKNOWNS,
    Estimate,
    EstimateSettings,
    LiftScene,
    Theta,
    chamfers,
    estimate,
)
from gendom.estimation.methods.gauss_newton import PER_BATCH
from gendom.estimation.priors import BENDING_RANGE
from gendom.materials.parameters import bending_length
from gendom.observation import chamfer
from gendom.reading import read_json


def test_known_modulus_comes_back(rope_lift, found):
    """E within 5 %, inside its interval; nu not identifiable, its interval spans the prior's."""
    record, modulus, theta = found.record, rope_lift.truth.E_over_rho, found.theta
    assert found.usable and record["E_over_rho"] == pytest.approx(modulus, rel=0.05)
    low, high = record["intervals"]["E_over_rho"]
    assert low < modulus < high and 1.02 < high / low < 2.0
    assert record["identifiable"]["E"] and not record["identifiable"]["nu"]
    low, high = record["intervals"]["nu"]
    assert high - low > 0.1
    assert abs(theta.grip_height) < 1e-3 and abs(theta.grip_along) < 2e-3
    assert abs(theta.delay) < 0.02
    # the noise of the clouds is told from the fit
    assert record["noise"]["sensor"] == pytest.approx(1e-3, rel=0.2)


def test_what_a_gripper_does_unsaid_is_found(rope_lift, settings):
    """Held higher and farther in than stated, and seen late: E does not suffer. Cameras that are
    5 mm off show in one Chamfer distance and not in the other."""
    told = {"grip_height": 0.004, "grip_along": 0.005, "delay": 0.04}
    off = np.eye(4)
    off[:3, 3] = 0.003, -0.003, 0.003
    found = estimate(rope_lift.seen(frames=20, **told), settings)
    assert found.usable
    for name, most in (("grip_height", 0.0015), ("grip_along", 0.003), ("delay", 0.02)):
        assert found.theta[name] == pytest.approx(told[name], abs=most)
    assert found.theta.E_over_rho == pytest.approx(rope_lift.truth.E_over_rho, rel=0.1)
    record = estimate(rope_lift.seen().moved(off), replace(settings, max_iterations=6)).record
    assert record["chamfer_mean_registered"] < record["chamfer_mean"] - 0.001


def test_what_is_known_is_not_looked_for(rope_lift, lifted, settings):
    """With the material known, only what belongs to the recording is found."""
    known = Theta(**dict(rope_lift.truth) | {"damping": 0.002})
    found = estimate(lifted, replace(settings, unknowns=("grip_height", "delay")), known=known)
    assert found.posterior.names == ("grip_height", "delay")
    for name, u in UNKNOWNS.items():
        if name not in found.posterior.names:
            assert found.theta[name] == known[name], name
        else:
            assert not u.material and abs(found.theta[name]) < 0.02
    assert found.record["intervals"] == {"level": 0.9}


def test_record_is_gendom_estimate_1(rope_lift, found):
    """Its numbers agree with each other."""
    record, density = found.record, 1000.0
    assert record["format"] == "gendom-estimate/1"
    assert record["verdict"] == {"usable": True, "reasons": []} and not record["interrupted"]
    assert record["density"] == pytest.approx(density) and not record["density_assumed"]
    assert record["E"] == pytest.approx(record["E_over_rho"] * density)
    assert record["E_over_rho"] == found.theta.E_over_rho and record["theta"] == dict(found.theta)
    diameter = rope_lift.object.diameter
    bending = bending_length(record["E_over_rho"], diameter / 4.0, 9.81)
    assert record["bending_length"] == pytest.approx(bending, rel=1e-3)
    assert record["bending_stiffness"] == pytest.approx(record["E"] * math.pi / 64.0 * diameter**4)
    intervals = record["intervals"]
    assert intervals["level"] == 0.9
    for name in ("E", "E_over_rho", "bending_length", "nu"):
        for low, high in (intervals[name], record["bounds"][name]):
            assert low < record[name] < high
    # the range is one of bending lengths, in lengths of the rope
    shares = np.array(record["bounds"]["bending_length"]) / found.scene.size
    np.testing.assert_allclose(shares, BENDING_RANGE["rope"])
    (start,) = record["starts"]
    assert start["converged"] and start["loss"] == record["rms"]


def test_chamfer_is_that_of_the_best_fit(lifted, found):
    """The reported distances are those of the positions handed out, frame by frame."""
    record, scene, fit = found.record, found.scene, found.fits[0]
    skin = scene.body.surface(fit.positions[3])
    assert fit.chamfer[3] == pytest.approx(chamfer(lifted.frame(scene.frames[3]), skin))
    whole, surface = chamfers(scene, fit.positions, found.theta)
    assert np.array_equal(whole, fit.chamfer)
    assert len(whole) == len(record["rms_by_frame"]) == len(record["compared"])
    assert record["chamfer_last"] == whole[-1] and record["chamfer_last_surface"] == surface[-1]
    assert record["chamfer_mean"] == pytest.approx(whole.mean())
    assert surface.mean() < whole.mean() < 0.01  # noise and the unseen lower side


def test_an_estimate_comes_back_from_its_file(found, tmp_path):
    """And shows itself on a screen at most, with units and intervals."""
    path = tmp_path / "estimate.json"
    found.save(path)
    again = Estimate.load(path)
    assert again.theta == found.theta and again.verdict == found.verdict
    assert again.record == read_json(path) == found.record
    for key in ("E", "E_over_rho", "friction", "colour"):
        assert again.interval(key) == found.interval(key)
    text = repr(found)
    assert repr(again) == text and len(text) < 1200 and text.count("\n") < 15
    assert "Young's modulus" in text and "Pa" in text and "90% in [" in text
    with pytest.raises(ParameterError, match="is of a rope"):
        found.cloth()
    table = found._repr_html_()
    assert table.count("<tr>") == len(found.rows()) and "usable" in table


def test_progress_is_reported(watched):
    """Iterations go up by one to no more than there can be, distances are finite. Meanwhile BLAS
    takes one thread, so that results do not depend on the number of cores."""
    reports = watched.reports
    assert [p.iteration for p in reports] == list(range(1, len(reports) + 1))
    assert {p.most for p in reports} == {PER_BATCH * EstimateSettings.max_iterations}
    assert reports[-1].iteration <= reports[-1].most
    assert all(p.stage and np.isfinite(p.rms) and p.best.E_over_rho > 0.0 for p in reports)
    before, during, after = watched.threads
    assert during == {1} and before == after


@pytest.mark.parametrize("swing", [0.0, 0.05])
def test_ctrl_c_keeps_the_best_so_far(rope_lift, settings, found, swing):
    """An interrupt after the first iteration gives a whole result that says so; if the search has
    only compared the calm frames by then, what it is left with is compared with all."""
    lifted = rope_lift.seen(frames=24 if swing else 12, swing=swing)
    scene, best = LiftScene.of(lifted, settings.scene), []
    assert not swing or 6 <= len(scene.calm) < len(scene.frames)

    def interrupt(progress):
        best.append(progress.best)
        raise KeyboardInterrupt

    record = estimate(lifted, settings, on_progress=interrupt).record
    assert record["interrupted"] and set(record) == set(found.record) and record["iterations"] == 1
    assert record["E_over_rho"] == pytest.approx(best[0].E_over_rho, rel=1e-3)
    assert len(record["rms_by_frame"]) == len(record["compared"]) == len(scene.frames)


def test_only_the_last_frame_may_be_compared(rope_lift, lifted, settings):
    """As in the paper: the modulus comes back from it too."""
    found = estimate(lifted, replace(settings, frames="last"))
    assert found.record["compared"] == [lifted.num_frames - 1]
    assert found.theta.E_over_rho == pytest.approx(rope_lift.truth.E_over_rho, rel=0.2)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"starts": 0}, "starts must be at least 1, got 0"),
        ({"seed": -1}, "seed must be at least 0, got -1"),
        ({"max_iterations": 1}, "max_iterations must be at least 2, got 1"),
        ({"level": 0.0}, "level must lie between 0 and 1, got 0.0"),
        ({"frames": "first"}, "unknown frames 'first'; choose one of all, last"),
        ({"camera_pose": "guessed"}, "unknown camera_pose 'guessed'; choose one of stated, unkn"),
        ({"method": "guess"}, "no method 'guess'; choose from gauss-newton"),
        ({"unknowns": ("colour",)}, "no unknown 'colour'; choose from E_over_rho"),
        ({"unknowns": ("yaw",)}, "a rope has no yaw"),
        ({"unknowns": ("nu", "nu")}, "nu is named twice"),
    ],
)
def test_bad_settings_are_refused(lifted, settings, changes, words):
    """Before anything is searched; the error names the setting."""
    with pytest.raises(ParameterError, match=words):
        estimate(lifted, replace(settings, **changes))


def test_recordings_are_checked_wherever_they_are_from(lifted):
    broken = replace(lifted, time=lifted.time[::-1].copy())
    with pytest.raises(RecordingError, match="recording 2: time"):
        estimate([lifted, broken])
    with pytest.raises(ParameterError, match="recordings"):
        estimate([lifted, "lift.npz"])  # type: ignore[list-item]
