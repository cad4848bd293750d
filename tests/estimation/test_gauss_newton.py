"""The descent and its covariance, on problems whose answers are known."""

import numpy as np
import pytest

from gendom.estimation.gauss_newton import (
    Bounds,
    Normal,
    Start,
    descend,
    noise_variance,
    posterior_covariance,
)

T = np.linspace(0.0, 3.0, 60)
TRUTH = np.array([2.0, 0.8])


def curve(theta):
    """a exp(-b t) [60]."""
    return theta[0] * np.exp(-theta[1] * T)


def slopes(theta):
    """d curve / d theta [60, 2]."""
    e = np.exp(-theta[1] * T)
    return np.stack([e, -theta[0] * T * e], axis=1)


def fit_to(data, log=None):
    """evaluate() of the curve's fit to data; ``log`` gathers what was asked."""

    def evaluate(thetas):
        if log is not None:
            log.extend(theta.copy() for theta in thetas)
        made = []
        for theta in thetas:
            r, J = curve(theta) - data, slopes(theta)
            made.append(Normal(sse=float(r @ r), gradient=J.T @ r, hessian=J.T @ J))
        return made

    return evaluate


def bounds(**changes):
    """Wide limits and a prior that says next to nothing."""
    wide = {
        "low": np.array([0.1, 0.05]),
        "high": np.array([10.0, 5.0]),
        "mean": np.array([1.0, 1.0]),
        "sd": np.array([1e6, 1e6]),
        "largest_step": np.array([1.0, 0.5]),
        "tolerance": np.array([1e-9, 1e-9]),
    }
    return Bounds(**{**wide, **changes})


def fitted(s):
    """The model at the end of a start that was evaluated."""
    assert s.model is not None
    return s.model


def start(*theta):
    return Start(initial=np.array(theta), theta=np.array(theta))


def run(evaluate, starts, limits, *, effective=60.0, max_iterations=60, least_gain=0.0):
    """All starts to their end; returns the numbers that descend() yielded."""
    return list(
        descend(
            evaluate,
            starts,
            limits,
            effective=effective,
            max_iterations=max_iterations,
            least_gain=least_gain,
        )
    )


NOISE = 0.02 * np.random.default_rng(0).normal(size=len(T))


def test_every_start_finds_the_least_squares_fit():
    """From near and far the fit ends where J^T r = 0, the same for all starts."""
    data = curve(TRUTH) + NOISE
    starts = [start(1.0, 1.0), start(8.0, 0.1), start(0.3, 3.0), start(5.0, 2.0)]
    run(fit_to(data), starts, bounds())
    for s in starts:
        assert s.done
        assert s.theta == pytest.approx(starts[0].theta, abs=1e-6)
        assert s.theta == pytest.approx(TRUTH, abs=0.05)
        assert np.abs(slopes(s.theta).T @ (curve(s.theta) - data)).max() < 1e-6
    assert starts[1].initial == pytest.approx([8.0, 0.1])


def test_losses_in_the_history_only_fall():
    """Each accepted step lowers the loss; the history ends at the result."""
    s = start(8.0, 0.1)
    run(fit_to(curve(TRUTH) + NOISE), [s], bounds())
    numbers, thetas, losses = zip(*s.history, strict=True)
    assert list(numbers) == list(range(1, s.iterations + 1))
    assert np.all(np.diff(losses) <= 0.0)
    assert np.array_equal(thetas[-1], s.theta)
    assert losses[-1] == fitted(s).sse


def test_no_proposal_leaves_the_bounds_or_takes_a_longer_step():
    """All points asked for lie within the limits, each at most largest_step from the last best."""
    asked = []
    s = start(4.0, 4.0)
    limits = bounds(high=np.array([10.0, 4.5]), largest_step=np.array([0.7, 0.3]))
    evaluate = fit_to(curve(TRUTH) + NOISE, asked)
    best = s.theta.copy()
    for _ in descend(evaluate, [s], limits, effective=60.0, max_iterations=60, least_gain=0.0):
        assert np.all(asked[-1] >= limits.low) and np.all(asked[-1] <= limits.high)
        assert np.all(np.abs(asked[-1] - best) <= limits.largest_step * (1 + 1e-12))
        best = s.theta.copy()
    assert len(asked) > 10
    assert s.theta == pytest.approx(TRUTH, abs=0.05)


def test_a_bound_holds_one_parameter_and_frees_the_other():
    """With b kept below 0.5 the fit ends there, and a is the best for b = 0.5."""
    data = curve(TRUTH) + NOISE
    limits = bounds(high=np.array([10.0, 0.5]))
    starts = [start(1.0, 0.2), start(6.0, 0.5)]
    run(fit_to(data), starts, limits)
    e = np.exp(-0.5 * T)
    for s in starts:
        assert s.theta == pytest.approx([e @ data / (e @ e), 0.5], abs=1e-6)


def linear(A, y):
    """evaluate() of |A theta - y|^2."""

    def evaluate(thetas):
        made = []
        for theta in thetas:
            r = A @ theta - y
            made.append(Normal(sse=float(r @ r), gradient=A.T @ r, hessian=A.T @ A))
        return made

    return evaluate


def test_the_prior_pulls_as_bayes_says():
    """A linear fit ends at (A^T A / s^2 + P)^-1 (A^T y / s^2 + P m), s^2 its own residual's."""
    rng = np.random.default_rng(1)
    A = rng.normal(size=(30, 2)) * [1.0, 0.05]
    y = A @ [1.0, 2.0] + 0.3 * rng.normal(size=30)
    limits = bounds(
        low=np.full(2, -10.0), high=np.full(2, 10.0), mean=np.zeros(2), sd=np.array([3.0, 0.5])
    )
    s = start(0.0, -4.0)
    run(linear(A, y), [s], limits, effective=30.0)
    P = np.diag(1.0 / limits.sd**2)
    variance = fitted(s).sse / 30.0
    expected = np.linalg.solve(A.T @ A / variance + P, A.T @ y / variance)
    assert s.theta == pytest.approx(expected, abs=1e-5)
    free = np.linalg.lstsq(A, y, rcond=None)[0]
    assert abs(s.theta[1]) < 0.7 * abs(free[1])


def test_covariance_of_a_linear_problem():
    """(A^T A / s^2 + P)^-1 where residuals have exactly the variance s^2."""
    rng = np.random.default_rng(2)
    A = rng.normal(size=(50, 2))
    r = rng.normal(size=50)
    s = 0.3
    r *= s * np.sqrt(50.0) / np.linalg.norm(r)
    model = Normal(sse=float(r @ r), gradient=A.T @ r, hessian=A.T @ A)
    limits = bounds(sd=np.array([0.02, 5.0]))
    expected = np.linalg.inv(A.T @ A / s**2 + np.diag([2500.0, 0.04]))
    assert np.allclose(posterior_covariance(model, limits, effective=50.0), expected, rtol=1e-12)
    assert noise_variance(model.sse, 50.0) == pytest.approx(s**2)


def test_covariance_is_the_scatter_of_repeated_fits():
    """Over 300 data sets the fits scatter as the covariance says, within 15 %."""
    rng = np.random.default_rng(3)
    starts, stated = [], []
    for _ in range(300):
        s = start(1.5, 1.0)
        run(fit_to(curve(TRUTH) + 0.05 * rng.normal(size=len(T))), [s], bounds())
        starts.append(s.theta)
        stated.append(posterior_covariance(fitted(s), bounds(), effective=60.0))
    scatter, mean = np.cov(np.array(starts).T), np.mean(stated, axis=0)
    assert np.sqrt(np.diag(scatter)) == pytest.approx(np.sqrt(np.diag(mean)), rel=0.15)
    assert scatter[0, 1] == pytest.approx(mean[0, 1], rel=0.3)


def test_fewer_independent_residuals_widen_the_covariance():
    """Half as many independent residuals: twice the variance, without a prior."""
    s = start(1.5, 1.0)
    run(fit_to(curve(TRUTH) + NOISE), [s], bounds())
    all_, half = (posterior_covariance(fitted(s), bounds(), effective=n) for n in (60.0, 30.0))
    assert np.allclose(half, 2.0 * all_, rtol=1e-6)


def test_a_failing_evaluation_shortens_the_step():
    """Where the model cannot be evaluated the start stays, tries nearer and nearer, goes on."""
    asked = []
    fit = fit_to(curve(TRUTH))
    failures = iter([False] + [True] * 6)

    def evaluate(thetas):
        asked.append(thetas[0].copy())
        failed = next(failures, False)
        return [None if failed else model for model in fit(thetas)]

    s = start(1.0, 1.0)
    for number in descend(
        evaluate, [s], bounds(), effective=60.0, max_iterations=60, least_gain=0.0
    ):
        if 2 <= number <= 7:
            assert np.array_equal(s.theta, [1.0, 1.0])
    lengths = [np.linalg.norm(a - asked[0]) for a in asked[1:8]]
    assert np.all(np.diff(lengths) < 0.0)
    assert lengths[-1] < 0.1 * lengths[0]
    assert s.theta == pytest.approx(TRUTH, abs=1e-5)


def test_a_wall_of_failures_is_not_crossed():
    """A fit whose optimum cannot be evaluated ends before it, with a model, and stops."""
    fit = fit_to(curve(TRUTH))

    def evaluate(thetas):
        return [m if t[0] < 1.5 else None for t, m in zip(thetas, fit(thetas), strict=True)]

    s = start(1.0, 1.0)
    run(evaluate, [s], bounds(tolerance=np.array([1e-4, 1e-4])), max_iterations=200)
    assert s.done and s.model is not None
    assert 1.0 < s.theta[0] < 1.5


def test_a_start_that_never_works_is_given_up():
    """It has no model and no history, and does not hold up the others."""
    fit = fit_to(curve(TRUTH))
    bad, good = start(9.0, 1.0), start(1.0, 1.0)

    def evaluate(thetas):
        return [m if t[0] < 8.5 else None for t, m in zip(thetas, fit(thetas), strict=True)]

    run(evaluate, [bad, good], bounds())
    assert bad.model is None and bad.history == []
    assert good.theta == pytest.approx(TRUTH, abs=1e-5)


def test_evaluations_are_counted_and_limited():
    """Every start spends at most max_iterations, and a start at its optimum stops at once."""
    s = start(8.0, 0.1)
    assert run(fit_to(curve(TRUTH) + NOISE), [s], bounds(), max_iterations=4) == [1, 2, 3, 4]
    assert s.iterations == 4 and not s.done
    there = start(*TRUTH)
    assert len(run(fit_to(curve(TRUTH)), [there], bounds())) <= 3


def test_least_gain_ends_a_descent_early():
    """A start that wins less than the asked share of its loss is done."""
    data = curve(TRUTH) + NOISE
    patient, hasty = start(4.0, 0.3), start(4.0, 0.3)
    run(fit_to(data), [patient], bounds())
    run(fit_to(data), [hasty], bounds(), least_gain=0.5)
    assert hasty.done
    assert hasty.iterations < patient.iterations
    last, before = hasty.history[-1][2], hasty.history[-2][2]
    assert last > 0.5 * before
