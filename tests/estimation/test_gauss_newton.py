"""Gauss-Newton steps on a simulated lift."""

import importlib
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from gendom.estimation import EstimateSettings, LiftScene, Problem, estimate
from gendom.estimation.methods.gauss_newton import GaussNewtonSettings, gauss_newton, refined
from gendom.estimation.replay import replay
from gendom.estimation.scene_settings import SHELL_ERROR
from gendom.estimation.shape import Shape

# the package's own name of the module is the function's
steps = importlib.import_module("gendom.estimation.methods.gauss_newton")

NAMES = ("E_over_rho", "grip_height", "delay")


@pytest.fixture(scope="module")
def problem(rope_lift):
    settings = EstimateSettings(starts=2, unknowns=NAMES, scene=rope_lift.settings)
    return Problem([LiftScene.of(rope_lift.seen(), rope_lift.settings)], settings)


@pytest.fixture(scope="module")
def found(problem):
    return gauss_newton(problem)


def test_it_ends_in_a_minimum(problem, found):
    """Half a deviation to either side of each unknown, clouds and priors are less likely."""
    best, noise = found.best, found.noise
    here = problem.value(best.vector, best.comparison, noise)
    sd = np.sqrt(np.diag(np.linalg.inv(problem.gradient_and_hessian(best, noise)[1])))
    beside = [best.vector + s * 0.5 * d for d in np.diag(sd) for s in (-1.0, 1.0)]
    compared = problem.compare(beside, derivatives=False)
    for vector, comparison in zip(beside, compared, strict=True):
        assert problem.value(vector, comparison, noise) > here - 0.1


def test_its_slope_is_that_of_differences(problem, found):
    """Of the likelihood with the prior, off the minimum, to a tenth of the steepest."""
    noise, best = found.noise, found.best
    sd = np.sqrt(np.diag(np.linalg.inv(problem.gradient_and_hessian(best, noise)[1])))
    at = best.vector + 2.0 * sd
    (comparison,) = problem.compare([at])
    start = type(best)(initial=at, vector=at, comparison=comparison)
    slope = 2.0 * problem.gradient_and_hessian(start, noise)[0] * sd
    ends = [at + s * 0.5 * d for d in np.diag(sd) for s in (-1.0, 1.0)]
    values = [
        problem.value(v, c, noise)
        for v, c in zip(ends, problem.compare(ends, derivatives=False), strict=True)
    ]
    differences = np.diff(np.reshape(values, (-1, 2)), axis=1)[:, 0]
    assert slope == pytest.approx(differences, abs=0.15 * np.abs(differences).max())


def test_it_keeps_what_it_did(rope_lift, problem, found):
    """Both starts, where they began and how near they came; the noise of the clouds."""
    assert len(found.starts) == 2 and not found.interrupted
    assert any(start is found.best for start in found.starts)
    for start in found.starts:
        assert [i for i, *_ in start.history] == sorted({i for i, *_ in start.history})
        assert start.history[-1][2] <= 1.1 * start.history[0][2]
        assert (start.initial >= problem.prior.low).all()
    stages = [[s.stage(i, "other") for i, *_ in s.history] for s in found.starts]
    chosen = stages[[s is found.best for s in found.starts].index(True)]
    assert chosen[-1] == "fine" and sorted(chosen) == chosen
    assert sum(set(names) == {"coarse"} for names in stages) == 1
    assert found.noise[0].sensor == pytest.approx(1e-3, rel=0.2)
    modulus = problem.theta(found.best.vector).E_over_rho
    assert modulus == pytest.approx(rope_lift.truth.E_over_rho, rel=0.05)


@pytest.fixture
def plain_cloth(cloth_lift):
    """Its scene with the engine's own points."""
    return LiftScene.of(cloth_lift.at_rest(8), replace(cloth_lift.settings, points=None))


@pytest.mark.parametrize(("share", "points"), [(0.16, 33), (0.09, 33), (0.07, 44), (0.01, 49)])
def test_limp_cloths_get_points_as_near_as_they_bend(cloth_lift, plain_cloth, share, points):
    """No more than a third of a bending length apart, as far as that goes."""
    modulus = plain_cloth.E_over_rho(share * 0.2)
    finer = plain_cloth.finer(cloth_lift.truth.with_values({"E_over_rho": modulus}))
    assert finer.body.shape == (points, points)
    assert finer.frames == plain_cloth.frames and finer.clock == plain_cloth.clock
    assert (finer is plain_cloth) == (points == 33)
    limper = cloth_lift.truth.with_values({"E_over_rho": plain_cloth.E_over_rho(0.2 * 0.063)})
    assert max(finer.finer(limper).body.shape) == max(points, 49)
    assert len(finer.finer(limper).notes) == len(plain_cloth.notes) + 1
    chosen = LiftScene.of(cloth_lift.at_rest(8), cloth_lift.settings)
    assert chosen.finer(cloth_lift.truth.with_values({"E_over_rho": modulus})) is chosen


def test_a_mesh_blurs_limp_cloths(cloth_lift, plain_cloth):
    """The more, the fewer points there are for each bending length."""
    limp, stiff = (
        cloth_lift.truth.with_values({"E_over_rho": plain_cloth.E_over_rho(share * 0.2)})
        for share in (1.0 / 32.0, 1.0 / 8.0)
    )
    assert plain_cloth.mesh_error(limp) == pytest.approx(SHELL_ERROR)
    assert plain_cloth.mesh_error(stiff) == pytest.approx(SHELL_ERROR / 64.0)


def test_what_was_found_is_searched_once_more_in_a_finer_problem(rope_lift, problem, found):
    """From where a coarser one ended to the end that the finer one's own search finds."""
    coarse = replace(rope_lift.settings, points=7)
    settings = replace(problem.settings, scene=coarse)
    rough = gauss_newton(Problem([LiftScene.of(rope_lift.seen(), coarse)], settings))
    before = rough.best.vector.copy()
    again = refined(problem, rough)
    assert problem.is_as_fine_as(again.best.comparison)
    sd = np.sqrt(np.diag(np.linalg.inv(problem.gradient_and_hessian(found.best, found.noise)[1])))
    off = np.abs(again.best.vector - found.best.vector) / sd
    assert off.max() < 0.2 < (np.abs(before - found.best.vector) / sd).max()


def test_derivatives_are_inherited(problem, found):
    """Changed by the least that agrees with both shapes: along the step they are its difference,
    at right angles to it (in the weight's measure) they are what they were."""
    best = found.best
    sd = np.sqrt(np.diag(np.linalg.inv(problem.gradient_and_hessian(best, found.noise)[1])))
    step, weight = np.array([1.0, -0.5, 0.25]) * sd, sd**-2.0
    (here,) = problem.compare([best.vector])
    (there,) = problem.compare([best.vector + step], derivatives=False)
    there.inherit_derivatives(here, step, weight)
    J, before, moved = (c.parts[0] for c in (there, here, there))
    np.testing.assert_allclose(J.J @ step, moved.here - before.here, atol=1e-12)
    across = np.array([1.0, 2.0, 0.0]) * sd
    assert across @ (weight * step) == pytest.approx(0.0)
    np.testing.assert_allclose(J.J @ across, before.J @ across, atol=1e-12)


def test_derivatives_are_made_anew_only_where_they_must(problem, monkeypatch):
    """Steps follow each other without; the last has its own."""
    asked = []
    compare = Problem.compare

    def counted(self, vectors, *, derivatives=True, free=None):
        asked.append(derivatives)
        return compare(self, vectors, derivatives=derivatives, free=free)

    monkeypatch.setattr(Problem, "compare", counted)
    found = gauss_newton(problem)
    assert found.best.done
    assert sum(asked) >= 2
    assert any(not a and not b for a, b in pairwise(asked))
    # before the last trial
    assert asked[-2:] == [True, False]


def test_a_cloth_leaps_out_of_a_hollow(cloth_lift):
    """Steps that ended 6 deviations off go on from where a leap has come nearest."""
    settings = EstimateSettings(
        starts=1, unknowns=("E_over_rho", "grip_height"), scene=cloth_lift.settings
    )
    problem = Problem([LiftScene.of(cloth_lift.at_rest(8), cloth_lift.settings)], settings)
    truth = problem.prior.vector(cloth_lift.truth)
    noise = problem.first_noise()
    start = steps.Start(initial=truth, vector=truth, comparison=problem.compare([truth])[0])
    covariance = np.linalg.inv(problem.gradient_and_hessian(start, noise)[1])
    off = truth - 6.0 * covariance[0] / np.sqrt(covariance[0, 0])
    start = steps.Start(initial=off, vector=off, comparison=problem.compare([off])[0])
    start.value, start.done = problem.value(off, start.comparison, noise), True
    # the deviation there is not that at the truth
    there = np.linalg.inv(problem.gradient_and_hessian(start, noise)[1])
    back = off + 6.0 * there[0] / np.sqrt(there[0, 0])
    settled = GaussNewtonSettings.of("cloth", jumps=(6.0,), gain=(2.0, 1.0))
    assert steps._jump(problem, start, noise, settled)
    assert not start.done and start.renew
    np.testing.assert_allclose(start.vector, back)
    assert abs(start.vector[0] - truth[0]) < abs(off[0] - truth[0])
    assert start.value == pytest.approx(problem.value(start.vector, start.comparison, noise))
    before = start.vector.copy()
    settled = replace(settled, gain=(2.0, 1e9))
    assert not steps._jump(problem, start, noise, settled)
    np.testing.assert_array_equal(start.vector, before)


def test_derivatives_of_a_coarser_sheet_are_those_between_its_points(cloth_lift):
    """Linear ones exactly."""
    shapes = [
        Shape(LiftScene.of(cloth_lift.at_rest(8), replace(cloth_lift.settings, points=n)))
        for n in (9, 15)
    ]
    fields = []
    for shape in shapes:
        a, b = (k - k[0] for k in shape.lattice)
        x, y = np.meshgrid(a, b)
        fields.append(np.stack([x.ravel(), y.ravel(), 2.0 * x.ravel() - y.ravel()], axis=1)[None])
    np.testing.assert_allclose(shapes[1].taken_from(shapes[0], fields[0]), fields[1], atol=1e-12)


def test_cloths_are_simulated_in_single_precision(cloth_lift):
    """Unless told otherwise; the same to 20 um."""
    recording, truth = cloth_lift.at_rest(8), cloth_lift.truth
    shapes = []
    for dtype in (None, "float64"):
        scene = LiftScene.of(recording, replace(cloth_lift.settings, dtype=dtype))
        assert scene.dtype == (dtype or "float32")
        shapes.append(replay(scene, [truth]))
    assert 0.0 < np.abs(shapes[0] - shapes[1]).max() < 2e-5


def test_a_cloth_of_known_material_is_placed(cloth_lift):
    """Leaps are by the object's unknowns, of which there are none."""
    settings = EstimateSettings(
        starts=1, unknowns=("grip_height", "yaw"), scene=cloth_lift.settings
    )
    found = estimate(cloth_lift.seen(frames=8), settings, known=cloth_lift.truth)
    assert found.posterior.names == ("grip_height", "yaw") and found.record["rms"] < 3e-3


def test_frames_before_the_lift_are_no_calm_ones(rope_lift):
    """Of a fast lift they are the only slow ones, and say nothing."""
    path = np.zeros((24, 1, 3))
    path[:, 0, 2] = rope_lift.lowest + 0.4 * np.clip(np.arange(24) / 30.0 - 0.4, 0.0, 0.25)
    fast = replace(rope_lift.at_rest(24), time=np.arange(24) / 30.0, gripper_position=path)
    problem = Problem([LiftScene.of(fast, rope_lift.settings)], EstimateSettings())
    assert problem.scene.calm == () and problem.coarse is problem
