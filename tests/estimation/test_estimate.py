"""Known parameters come back from lifts that were simulated with them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from gendom.errors import ParameterError, RecordingError
from gendom.estimation import (
    UNKNOWNS,
    EstimateSettings,
    LiftScene,
    SceneSettings,
    Theta,
    chamfers,
    estimate,
    replay,
)
from gendom.estimation.methods.gauss_newton import PER_BATCH
from gendom.estimation.priors import BENDING_RANGE
from gendom.files import to_json
from gendom.materials.parameters import E_over_rho_of, bending_length
from gendom.observation import chamfer

KEYS = {
    "begins_with", "bending_length", "bending_stiffness", "bounds", "calibration", "chamfer_last",
    "chamfer_last_registered", "chamfer_last_surface", "chamfer_mean", "chamfer_mean_registered",
    "chamfer_mean_surface", "compared", "damping",
    "density", "density_assumed", "density_sd", "device", "digest", "format", "frames",
    "friction", "history",
    "identifiable", "interrupted", "intervals", "iterations", "method", "noise", "notes", "object",
    "nu", "posterior", "recordings", "rms", "rms_by_frame", "rms_registered", "seconds",
    "seed", "sha256", "simulation", "stage_seconds", "E_over_rho", "starts", "stiffness_slope",
    "theta", "thickness", "tip_mass", "verdict", "E", "air_drag", "clamp_twist",
    "first_clamp_x", "first_clamp_y", "last_clamp_x", "last_clamp_y",
    "warp_over_weft", "hem_stiffness", "hem_mass",
}  # fmt: skip


@pytest.fixture(scope="module")
def settings(rope_lift):
    return EstimateSettings(starts=1, scene=rope_lift.settings)


@pytest.fixture(scope="module")
def lifted(rope_lift):
    return rope_lift.seen()


@pytest.fixture(scope="module")
def result(lifted, settings):
    """The estimate from one start, and what was reported on the way."""
    reports = []
    return estimate(lifted, settings, on_progress=reports.append), reports


# ---- recovery --------------------------------------------------------------------------------


def test_known_modulus_comes_back(rope_lift, result):
    """E within 5 %, inside its interval; nu not identifiable, its interval spans the prior's."""
    record, modulus = result[0].record, rope_lift.truth.E_over_rho
    assert result[0].usable
    assert record["E_over_rho"] == pytest.approx(modulus, rel=0.05)
    low, high = record["intervals"]["E_over_rho"]
    assert low < modulus < high
    assert 1.02 < high / low < 2.0
    assert record["identifiable"]["E"] and not record["identifiable"]["nu"]
    low, high = record["intervals"]["nu"]
    assert high - low > 0.1
    theta = result[0].theta
    assert abs(theta.grip_height) < 1e-3 and abs(theta.grip_along) < 2e-3
    assert abs(theta.delay) < 0.02
    # the noise of the clouds is told from the fit
    assert record["noise"]["sensor"] == pytest.approx(1e-3, rel=0.2)


def test_another_seed_finds_the_same(rope_lift, lifted, settings, result):
    """Starts that are drawn elsewhere end at the same modulus within 1 %."""
    changed = EstimateSettings(**vars(settings) | {"starts": 2, "seed": 1})
    other = estimate(lifted, changed).record
    assert other["seed"] == 1
    initial = [start["initial"]["E_over_rho"] for start in other["starts"]]
    assert len(initial) == 2 and abs(math.log(initial[0] / initial[1])) > 0.1
    assert other["E_over_rho"] == pytest.approx(result[0].record["E_over_rho"], rel=0.01)


@pytest.mark.parametrize("share", [0.2, 0.6])
def test_softer_and_stiffer_ropes_come_back(rope_lift, settings, share):
    """Bending over a fifth and over more than half of its length: E within 10 %."""
    size, k = rope_lift.object.length, rope_lift.object.diameter / 4.0
    modulus = E_over_rho_of(share * size, k, 9.81)
    seen = rope_lift.seen(E_over_rho=modulus, seed=3)
    assert estimate(seen, settings).theta.E_over_rho == pytest.approx(modulus, rel=0.1)


def test_what_a_gripper_does_unsaid_is_found(rope_lift, settings):
    """Held higher and farther in than stated, and seen late: all three come back, E does not
    suffer."""
    told = {"grip_height": 0.004, "grip_along": 0.005, "delay": 0.04}
    found = estimate(rope_lift.seen(frames=20, **told), settings)
    assert found.usable
    assert found.theta.grip_height == pytest.approx(told["grip_height"], abs=0.0015)
    assert found.theta.grip_along == pytest.approx(told["grip_along"], abs=0.003)
    assert found.theta.delay == pytest.approx(told["delay"], abs=0.02)
    modulus = rope_lift.truth.E_over_rho
    assert found.theta.E_over_rho == pytest.approx(modulus, rel=0.1)


@pytest.mark.slow
def test_a_cloth_s_modulus_comes_back(cloth_lift):
    """Within a third: of a limp cloth a lift tells less."""
    seen = cloth_lift.seen(points=400)
    found = estimate(seen, EstimateSettings(starts=1, scene=cloth_lift.settings))
    assert found.usable
    modulus = cloth_lift.truth.E_over_rho
    assert abs(math.log(found.theta.E_over_rho / modulus)) < math.log(4.0 / 3.0)


def test_what_is_known_is_not_looked_for(rope_lift, lifted, settings):
    """With the material known, only what belongs to the recording is found."""
    known = Theta(**dict(rope_lift.truth) | {"damping": 0.002})
    changed = EstimateSettings(**vars(settings) | {"unknowns": ("grip_height", "delay")})
    found = estimate(lifted, changed, known=known)
    assert found.posterior.names == ("grip_height", "delay")
    for name, u in UNKNOWNS.items():
        if name not in found.posterior.names:
            assert getattr(found.theta, name) == getattr(known, name), name
        else:
            assert not u.material and abs(getattr(found.theta, name)) < 0.02
    assert found.record["intervals"] == {"level": 0.9}


# ---- the result ------------------------------------------------------------------------------


def test_record_is_gendom_estimate_1(rope_lift, result):
    """All keys are there, it has a JSON form, and its numbers agree with each other."""
    estimated = result[0]
    record, density = estimated.record, 1000.0
    assert record["format"] == "gendom-estimate/1"
    assert set(record) == KEYS
    assert to_json(record)
    assert record["verdict"] == {"usable": True, "reasons": []}
    assert record["density"] == pytest.approx(density) and not record["density_assumed"]
    assert record["E"] == pytest.approx(record["E_over_rho"] * density)
    assert record["E_over_rho"] == estimated.theta.E_over_rho
    assert record["theta"] == dict(estimated.theta)
    k = rope_lift.object.diameter / 4.0
    bending = bending_length(record["E_over_rho"], k, 9.81)
    assert record["bending_length"] == pytest.approx(bending, rel=1e-3)
    EI = record["E"] * math.pi / 64.0 * rope_lift.object.diameter**4
    assert record["bending_stiffness"] == pytest.approx(EI)
    intervals = record["intervals"]
    assert intervals["level"] == 0.9
    for name in ("E", "E_over_rho", "bending_length", "nu"):
        assert intervals[name][0] < record[name] < intervals[name][1]
        low, high = record["bounds"][name]
        assert low < record[name] < high
    # the range is one of bending lengths, in lengths of the rope
    shares = np.array(record["bounds"]["bending_length"]) / estimated.scene.size
    np.testing.assert_allclose(shares, BENDING_RANGE["rope"])
    assert record["simulation"]["engine"] == "thin" and record["simulation"]["clock"] == 1.0
    assert record["simulation"]["points_simulated"] == 15
    assert not record["interrupted"]
    most = PER_BATCH * EstimateSettings.max_iterations
    assert 2 <= record["iterations"] <= most
    assert [h["iteration"] for h in record["history"]] == sorted(
        {h["iteration"] for h in record["history"]}
    )
    assert record["history"][-1]["E_over_rho"] == record["E_over_rho"]


def test_chamfer_is_that_of_the_best_fit(lifted, result):
    """The reported distances are those of the positions handed out, frame by frame."""
    estimated = result[0]
    record, scene = estimated.record, estimated.scene
    skin = scene.body.surface(estimated.positions[3])
    assert estimated.chamfer[3] == pytest.approx(chamfer(lifted.frame(scene.frames[3]), skin))
    whole, surface = chamfers(scene, estimated.positions, estimated.theta)
    assert np.array_equal(whole, estimated.chamfer)
    assert len(whole) == len(record["rms_by_frame"]) == len(record["compared"])
    assert record["chamfer_last"] == whole[-1]
    assert record["chamfer_mean"] == pytest.approx(whole.mean())
    assert record["chamfer_last_surface"] == surface[-1]
    assert surface.mean() < whole.mean() < 0.01  # noise and the unseen lower side
    assert np.allclose(replay(scene, [estimated.theta])[:, 0], estimated.positions)


def test_registered_chamfer_is_free_of_the_cameras_motion(lifted, settings):
    """Cameras that are 5 mm off, as badly calibrated ones are."""
    off = np.eye(4)
    off[:3, 3] = 0.003, -0.003, 0.003
    record = estimate(lifted.moved(off), settings).record
    assert record["chamfer_mean_registered"] < record["chamfer_mean"] - 0.001


def test_progress_is_reported(result):
    """Iterations go up by one to no more than there can be, distances are finite."""
    reports = result[1]
    assert [p.iteration for p in reports] == list(range(1, len(reports) + 1))
    most = PER_BATCH * EstimateSettings.max_iterations
    assert {p.most for p in reports} == {most}
    assert reports[-1].iteration <= reports[-1].most
    assert all(p.stage and np.isfinite(p.rms) for p in reports)
    assert all(p.best.E_over_rho > 0.0 for p in reports)


def test_blas_takes_one_thread_while_it_searches(lifted, settings):
    """Results do not depend on the number of cores, and its threads do not wait for each other."""
    seen = set()

    def threads():
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        estimate(lifted, settings, on_progress=lambda _: seen.update(threads()))
        assert threads() == before
    assert seen == {1}


def test_ctrl_c_keeps_the_best_so_far(lifted, settings):
    """An interrupt after the first iteration gives a whole result that says so."""

    best = []

    def interrupt(progress):
        best.append(progress.best)
        raise KeyboardInterrupt

    record = estimate(lifted, settings, on_progress=interrupt).record
    assert record["interrupted"]
    assert set(record) == KEYS
    assert record["iterations"] == 1
    assert record["E_over_rho"] == pytest.approx(best[0].E_over_rho)


def test_ctrl_c_on_the_way_from_calm_to_fast_frames(rope_lift, settings):
    """The search begins with the calm frames; what it is left with is compared with all."""
    lifted = rope_lift.seen(frames=24, swing=0.05)
    scene = LiftScene.of(lifted, settings.scene)
    assert 6 <= len(scene.calm) < len(scene.frames)

    def interrupt(progress):
        raise KeyboardInterrupt

    record = estimate(lifted, settings, on_progress=interrupt).record
    assert record["interrupted"]
    assert len(record["rms_by_frame"]) == len(record["compared"]) == len(scene.frames)


def test_only_the_last_frame_may_be_compared(rope_lift, lifted, settings):
    """As in the paper: the modulus comes back from it too."""
    found = estimate(lifted, EstimateSettings(**vars(settings) | {"frames": "last"}))
    assert found.record["compared"] == [lifted.num_frames - 1]
    assert found.chamfer is not None and found.chamfer.shape == (1,)
    modulus = rope_lift.truth.E_over_rho
    assert found.theta.E_over_rho == pytest.approx(modulus, rel=0.2)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"starts": 0}, "starts"),
        ({"seed": -1}, "seed"),
        ({"frames": "first"}, "'all' or 'last'"),
        ({"max_iterations": 1}, "max_iterations"),
        ({"level": 1.0}, "level"),
        ({"level": 0.0}, "level"),
    ],
)
def test_bad_settings_are_refused(changes, words):
    """The error names the setting."""
    with pytest.raises(ParameterError, match=words):
        EstimateSettings(**changes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"method": "guess"}, "no method 'guess'; choose from gauss-newton"),
        ({"unknowns": ("colour",)}, "no unknown 'colour'; choose from E_over_rho"),
        ({"unknowns": ("yaw",)}, "a rope has no yaw"),
    ],
)
def test_what_there_is_not_is_refused(lifted, changes, words):
    """Before anything is simulated."""
    with pytest.raises(ParameterError, match=words):
        estimate(lifted, EstimateSettings(**changes))


# ---- scenes and replays ------------------------------------------------------------------------


def test_grip_height_raises_the_object(rope_lift):
    """What hangs 5 mm higher than stated is held 5 mm higher, once off the table."""
    scene = LiftScene.of(rope_lift.at_rest(5), rope_lift.settings)
    thetas = [rope_lift.truth.with_values({"grip_height": h}) for h in (0.0, 0.005)]
    x = replay(scene, thetas)
    held = int(np.linalg.norm(scene.body.points - scene.held[0], axis=1).argmin())
    rise = x[:, 1, held, 2] - x[:, 0, held, 2]
    assert rise[1:] == pytest.approx(0.005, abs=5e-4)


def test_a_delay_shows_the_motion_late(rope_lift):
    """What is seen a frame late is where the gripper was a frame before."""
    scene = LiftScene.of(rope_lift.at_rest(21), rope_lift.settings)
    step = float(scene.recording.time[1])
    x = replay(scene, [rope_lift.truth.with_values({"delay": d}) for d in (0.0, step)])
    top = x[..., 2].max(axis=2)
    assert top[5:, 1] == pytest.approx(top[4:-1, 0], abs=1e-3)
    assert (top[8:14, 0] - top[8:14, 1]).min() > 0.005


def test_worlds_of_one_call_are_as_each_alone(cloth_lift):
    """Of a cloth, whose worlds differ in how they lie and are held."""
    scene = LiftScene.of(cloth_lift.at_rest(4), cloth_lift.settings)
    changes = [{}, {"yaw": 0.2}, {"grip_along": 0.01, "grip_tilt": 0.3}, {"grip_reach": 0.01}]
    thetas = [cloth_lift.truth.with_values(c) for c in changes]
    both = replay(scene, thetas)
    for w, theta in enumerate(thetas):
        np.testing.assert_allclose(both[:, w], replay(scene, [theta])[:, 0], atol=1e-6)
    assert min(np.abs(both[:, w] - both[:, 0]).max() for w in (1, 2, 3)) > 2e-3


def test_a_held_corner_hangs_as_steep_as_told(cloth_lift):
    """Lifted level, a corner's surroundings stay level; tilted, they do not."""
    scene = LiftScene.of(cloth_lift.at_rest(6), cloth_lift.settings)
    changes = [{"grip_tilt": 0.0}, {"grip_tilt": 1.2}]
    x = replay(scene, [cloth_lift.truth.with_values(c) for c in changes])[-1]
    corner, next_to_it = 0, scene.body.shape[1] + 1
    drop = x[:, corner, 2] - x[:, next_to_it, 2]
    assert drop[1] > drop[0] + 0.005


def test_a_held_corner_turns_as_its_axis(cloth_lift):
    """By an axis that turns down by half a radian, and not by one that stays level."""
    frames, held = 6, replace(cloth_lift.object, grasp_radius=0.06)
    turns = []
    for angle in (0.0, 0.5):
        down = np.linspace(0.0, angle, frames)[:, None]
        axes = np.cos(down) * [0.5**0.5, 0.5**0.5, 0.0] - np.sin(down) * [0.0, 0.0, 1.0]
        scene = LiftScene.of(
            cloth_lift.at_rest(frames, object=held, gripper_axis=axes), cloth_lift.settings
        )
        x = replay(scene, [cloth_lift.truth.with_values({"grip_tilt": 0.0})])[-1, 0]
        along = x[scene.body.shape[1] + 1] - x[0]
        turns.append(math.atan2(-along[2], math.hypot(along[0], along[1])))
    assert turns == pytest.approx([0.0, 0.5], abs=0.01)


def test_a_dynamic_recording_keeps_its_clock(rope_lift):
    """Only quasi-static recordings are replayed faster than they were made."""
    slow = 20.0 * rope_lift.at_rest().time
    for quasi_static in (False, True):
        seen = rope_lift.at_rest(quasi_static=quasi_static)
        seen = type(seen)(**vars(seen) | {"time": slow})
        assert (LiftScene.of(seen).clock == 1.0) == (not quasi_static)
    assert LiftScene.of(seen, SceneSettings(clock=2.0)).clock == 2.0


@pytest.mark.parametrize(
    ("clock", "quasi_static", "words"),
    [
        (500.0, True, "the object would swing; give .* or less"),
        (1e-6, True, "longer than the 300 s"),
        (2.0, False, "is not of a quasi-static motion"),
    ],
)
def test_a_clock_that_makes_another_motion_is_refused(rope_lift, clock, quasi_static, words):
    with pytest.raises(ParameterError, match=words):
        LiftScene.of(rope_lift.at_rest(quasi_static=quasi_static), SceneSettings(clock=clock))


def test_an_unknown_is_named_once(rope_lift, settings):
    twice = replace(settings, unknowns=("nu", "nu"))
    with pytest.raises(ParameterError, match="nu is named twice"):
        estimate(rope_lift.seen(), twice)


def test_the_delay_of_slow_frames_is_less_sure(rope_lift):
    """Of a quasi-static recording the times may be those of the nearest frame."""
    seen = rope_lift.at_rest(quasi_static=True)
    slow = replace(seen, time=100.0 * seen.time)
    sd = [float(LiftScene.of(r).prior(("delay",))[0].sd[0]) for r in (seen, slow)]
    assert sd[1] == pytest.approx(np.median(np.diff(slow.time)) / np.sqrt(12.0))
    assert sd[0] < 0.02 * sd[1]


def test_a_cloth_is_held_as_far_inside_its_corner_as_stated(cloth_lift):
    inset = 0.015
    inside = replace(cloth_lift.object, grasp_inset=inset)
    scene = LiftScene.of(cloth_lift.at_rest(object=inside), cloth_lift.settings)
    to_grip = scene.held[0] - scene.body.points[0]
    np.testing.assert_allclose(to_grip, inset * scene.inwards[0], atol=1e-9)
    corner = LiftScene.of(cloth_lift.at_rest(), cloth_lift.settings)
    np.testing.assert_allclose(corner.held[0], corner.body.points[0], atol=1e-9)


def test_rope_is_placed_where_it_is_seen(rope_lift):
    """The body lies along the cloud on the table, from half a diameter behind the gripper on."""
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    cloud = rope_lift.lying.copy()
    cloud[:, :2] = cloud[:, :2] @ turn.T
    scene = LiftScene.of(rope_lift.recording([cloud] * 3))
    x, diameter = scene.body.points, rope_lift.object.diameter
    along, across = x[:, :2] @ turn[:, 0], x[:, :2] @ turn[:, 1]
    assert along.min() == pytest.approx(-diameter / 2.0, abs=0.002)
    assert np.ptp(along) == pytest.approx(rope_lift.object.length, abs=0.004)
    assert np.abs(across).max() < 1e-3
    assert x[:, 2] == pytest.approx(diameter / 2.0)
    assert scene.held[0] == pytest.approx([0.0, 0.0, diameter / 2.0], abs=1e-3)


def test_unknown_mass_assumes_a_density(rope_lift):
    """Without a mass the density is assumed and said to be; motion depends on it by the air
    alone."""
    x = []
    for mass, density in ((None, 1000.0), (0.1, 0.1 / (math.pi / 4 * 0.012**2 * 0.25))):
        described = type(rope_lift.object)(**vars(rope_lift.object) | {"mass": mass})
        scene = LiftScene.of(rope_lift.at_rest(object=described), rope_lift.settings)
        assert scene.density == pytest.approx(density)
        assert any("mass not stated" in note for note in scene.notes) == (mass is None)
        x.append(replay(scene, [rope_lift.truth]))
    assert np.abs(x[0] - x[1]).max() < 1e-3


def test_the_record_says_that_a_density_is_assumed(rope_lift, lifted, settings):
    described = type(rope_lift.object)(**vars(rope_lift.object) | {"mass": None})
    seen = type(lifted)(**vars(lifted) | {"object": described})
    fewer = EstimateSettings(**vars(settings) | {"max_iterations": 2})
    found = estimate(seen, fewer)
    assert found.record["density_assumed"] and "assumed: the mass is unknown" in repr(found)


def test_a_recording_without_points_cannot_be_lifted(rope_lift):
    """The error is the recording's, not one of array shapes."""
    with pytest.raises(RecordingError, match="no frame holds a point"):
        LiftScene.of(rope_lift.recording([np.zeros((0, 3))] * 3))


@pytest.mark.parametrize(
    "setting",
    [
        {"clock": 0.0},
        {"clock": np.nan},
        {"cells_across": -1.0},
        {"cells_across": 0.2},
        {"points": 3},
    ],
)
def test_bad_scene_settings_are_refused(setting):
    """Numbers that make no replay raise before anything is simulated."""
    with pytest.raises(ParameterError, match=next(iter(setting))):
        SceneSettings(**setting)


@pytest.mark.parametrize("bad", [{"friction": -0.1}, {"damping": -1e-3}, {"delay": np.nan}])
def test_bad_parameters_are_refused(bad):
    """The error names the value."""
    with pytest.raises(ParameterError, match=next(iter(bad))):
        Theta(E_over_rho=700.0, **bad)
