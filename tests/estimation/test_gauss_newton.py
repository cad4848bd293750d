"""Gauss-Newton steps on a simulated lift."""

from types import SimpleNamespace

import numpy as np
import pytest

from gendom.estimation import EstimateSettings, LiftScene, Problem
from gendom.estimation.likelihood import Comparisons
from gendom.estimation.methods.gauss_newton import (
    Descent,
    GaussNewtonSettings,
    _likeliest,
    gauss_newton,
)
from gendom.estimation.problem import Start
from gendom.materials.posterior import prior_of

NAMES = ("E_over_rho", "grip_height", "delay")


@pytest.fixture(scope="module")
def problem(rope_lift):
    settings = EstimateSettings(starts=2, unknowns=NAMES, scene=rope_lift.settings)
    return Problem([LiftScene.of(rope_lift.seen(), rope_lift.settings)], settings)


@pytest.fixture(scope="module")
def found(problem):
    return gauss_newton(problem)


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


def test_it_keeps_what_it_did(found):
    """Both starts, of which the better one went on; the noise of the clouds."""
    assert len(found.starts) == 2 and not found.interrupted
    assert abs(found.starts[0].initial[0] - found.starts[1].initial[0]) > 0.1
    assert [s.coarse for s in found.starts] == [s is not found.best for s in found.starts]
    assert found.noise[0].sensor == pytest.approx(1e-3, rel=0.2)


def test_a_step_that_meets_a_bound_goes_along_it():
    """Rather than where only both unknowns together would have been better."""
    prior = prior_of(("E_over_rho", "grip_turn"), {"E_over_rho": {"sd": 3.0}})
    at = np.array([6.5, 0.002])  # the turn is not negative
    H, gradient = np.array([[100.0, 990.0], [990.0, 1e4]]), np.array([20.0, 300.0])
    alone = SimpleNamespace(prior=prior, gradient_and_hessian=lambda start, noise: (gradient, H))
    descent = Descent(alone, GaussNewtonSettings(), (), 0.2)  # type: ignore[arg-type]
    start = Start(initial=at, vector=at, damping=0.0)
    ((place, gain, _),), _ = descent.propose(start)
    turned = -0.002
    expected = -(gradient[0] + H[0, 1] * turned) / H[0, 0]
    assert place - at == pytest.approx([expected, turned])
    assert gain > 0.0  # the step of both, cut off, would have lost


@pytest.mark.parametrize(
    ("ends", "values", "rival", "apart"),
    [
        ((6.0, 6.31), (0.0, 8.9), True, True),
        ((6.0, 6.31), (2.0, 0.0), True, True),  # the second one is the more likely one
        ((6.0, 6.29), (0.0, 2.0), False, True),  # within three deviations
        ((6.0, 6.09), (0.0, 2.0), False, False),
        ((6.0, 6.8), (0.0, 9.1), False, False),  # far less likely
    ],
)
def test_ends_apart_are_kept(ends, values, rival, apart):
    """By deviations, here 0.1, of the object's unknowns; how it is held does not count."""
    vectors = [np.array([x, 0.1 * k]) for k, x in enumerate(ends)]
    starts = [Start(initial=v, vector=v, done=True, comparison=Comparisons(())) for v in vectors]
    starts[0].value, starts[1].value = values
    alone = SimpleNamespace(
        prior=prior_of(("E_over_rho", "grip_height"), {"E_over_rho": {"sd": 3.0}}),
        gradient_and_hessian=lambda start, noise: (np.zeros(2), np.diag([100.0, 1e4])),
        value=lambda vector, comparison, noise: values[round(10.0 * vector[1])] + 5.0 * noise,
    )
    descent = Descent(alone, GaussNewtonSettings(), (), 0.2)  # type: ignore[arg-type]
    best, other = sorted(starts, key=lambda s: s.value)
    assert descent.apart(best, [other], 3.0) == [other] * rival
    found, noise, away = _likeliest(descent, [(s, k) for k, s in enumerate(starts)])  # type: ignore
    assert found is best and noise == np.argmin(values) and best.value == min(values)
    assert [list(v) for v in away] == [list(other.vector)] * apart


def test_renewed_derivatives_leave_a_cloth_as_registered_as_it_was(cloth_lift):
    """Else any step, even none, would win by what another round of the registration brings."""
    names, T = ("E_over_rho", "grip_tilt"), np.eye(4)
    T[:3, 3] = 0.0, 0.006, 0.004  # cameras are off
    lifted = cloth_lift.seen(frames=8, points=300).moved(T)
    scene = LiftScene.of(lifted, cloth_lift.settings)
    problem = Problem([scene], EstimateSettings(unknowns=names), known=cloth_lift.truth)
    descent = Descent.coarse(problem, GaussNewtonSettings.of("cloth"))
    vector = problem.prior.vector(cloth_lift.truth) + np.array([0.6, -0.2])
    start = Start(initial=vector, vector=vector)
    for _ in range(5):
        descent.step([start])
        start.done = start.renew = False
    reached = start.value
    descent._renew([start])
    assert start.exact and start.value <= reached + 0.1


def test_a_step_of_a_cloth_that_promises_little_is_not_simulated(monkeypatch):
    """Its derivatives are computed again first; then it is done."""
    tried, renewed = [], []
    descent = Descent(SimpleNamespace(), GaussNewtonSettings.of("cloth"), (), 10.0)  # type: ignore
    start = Start(initial=np.zeros(1), vector=np.zeros(1), comparison=Comparisons(()))

    def renew(self, starts):
        renewed.extend(starts)
        for s in starts:
            s.exact = True

    monkeypatch.setattr(Descent, "_renew", renew)
    monkeypatch.setattr(Descent, "_tried", lambda *_: tried.append(1))
    monkeypatch.setattr(Descent, "propose", lambda *_: ([(np.zeros(1), 9.0, 1e-3)] * 5, None))
    descent.step([start])
    assert renewed == [start] and start.done and not tried
