"""Levenberg-Marquardt for many starts at once, on functions that are cheap in batches."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

TOO_FAR = 1e12
"""Damping at which a start is given up: no step makes it better."""


@dataclass(frozen=True, kw_only=True)
class Normal:
    """Local quadratic model of the data's sum of squares at one point."""

    sse: float
    """Sum of squared residuals."""
    gradient: NDArray[np.floating]
    """[P] J^T r."""
    hessian: NDArray[np.floating]
    """[P, P] J^T J."""


@dataclass(kw_only=True)
class Start:
    """One start on its way down."""

    initial: NDArray[np.floating]
    theta: NDArray[np.floating]
    model: Normal | None = None
    damping: float = 1e-2
    iterations: int = 0
    done: bool = False
    history: list[tuple[int, NDArray[np.floating], float]] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Where parameters may go, and what was believed before seeing data."""

    low: NDArray[np.floating]
    high: NDArray[np.floating]
    mean: NDArray[np.floating]
    sd: NDArray[np.floating]
    largest_step: NDArray[np.floating]
    tolerance: NDArray[np.floating]
    """A start has arrived when its step is below this in every parameter."""


def noise_variance(sse: float, effective: float) -> float:
    """Variance of one of ``effective`` independent residuals, from their sum of squares."""
    return max(sse / max(effective, 1.0), 1e-30)


def descend(
    evaluate: Callable[[list[NDArray[np.floating]]], list[Normal | None]],
    starts: list[Start],
    bounds: Bounds,
    *,
    effective: float,
    max_iterations: int,
    least_gain: float,
    least_damping: float = 1e-9,
) -> Iterator[int]:
    """Run all starts to convergence; yields the number of the iteration just finished.

    Each iteration evaluates one proposal of every start in one batch, with its Jacobian, so an
    accepted proposal costs nothing more. The objective is the negative log posterior: squared
    residuals over their variance, which is estimated from the start's own best fit, plus the
    Gaussian prior. Source: Nocedal and Wright (2006), chapter 10.

    Args:
        evaluate: For a list of parameter vectors [P], their quadratic models (None: diverged).
        starts: Modified in place; a caller that stops early finds the best so far in them.
        bounds: Limits and prior.
        effective: Number of independent residuals.
        max_iterations: Evaluations a start may spend.
        least_gain: A start has arrived when an accepted step lowers its sum of squares by less
            than this share.
        least_damping: Damping below which none falls: where pairs or contacts change with each
            step, a first refusal should shorten the next one.
    """
    precision = 1.0 / bounds.sd**2
    for iteration in range(1, max_iterations + 1):
        going = [s for s in starts if not s.done]
        if not going:
            return
        proposals = [_propose(s, bounds, precision, effective) for s in going]
        for start, theta, model in zip(going, proposals, evaluate(proposals), strict=True):
            start.iterations += 1
            first = start.model is None
            step = np.abs(theta - start.theta)
            if model is not None and (first or _better(start, theta, model, bounds, effective)):
                gain = 1.0 if start.model is None else 1.0 - model.sse / start.model.sse
                start.theta, start.model = theta, model
                start.damping = max(start.damping / 8.0, least_damping)
                start.done = not first and (
                    gain < least_gain or bool(np.all(step < bounds.tolerance))
                )
            else:
                start.damping *= 8.0
                start.done = start.damping > TOO_FAR or bool(np.all(step < bounds.tolerance))
            if start.model is not None:
                start.history.append((start.iterations, start.theta.copy(), start.model.sse))
        yield iteration


def posterior_covariance(
    model: Normal, bounds: Bounds, *, effective: float
) -> NDArray[np.floating]:
    """[P, P] covariance of the parameters: inverse of data information plus prior (Laplace)."""
    variance = noise_variance(model.sse, effective)
    return np.linalg.inv(model.hessian / variance + np.diag(1.0 / bounds.sd**2))


def _propose(start: Start, bounds: Bounds, precision, effective: float) -> NDArray[np.floating]:
    if start.model is None:
        return np.clip(start.theta, bounds.low, bounds.high)
    variance = noise_variance(start.model.sse, effective)
    H = start.model.hessian / variance + np.diag(precision)
    g = start.model.gradient / variance + precision * (start.theta - bounds.mean)
    # a parameter pressed against its bound is held there
    free = ~(((start.theta <= bounds.low) & (g > 0)) | ((start.theta >= bounds.high) & (g < 0)))
    step = np.zeros(len(start.theta))
    if free.any():
        Hf = H[np.ix_(free, free)]
        step[free] = -np.linalg.solve(Hf + start.damping * np.diag(np.diag(Hf)), g[free])
    step *= min(1.0, float(np.min(bounds.largest_step / np.maximum(np.abs(step), 1e-300))))
    return np.clip(start.theta + step, bounds.low, bounds.high)


def _better(start: Start, theta, model: Normal, bounds: Bounds, effective: float) -> bool:
    assert start.model is not None
    variance = noise_variance(start.model.sse, effective)

    def objective(sse: float, at) -> float:
        return sse / variance + float(np.sum(((at - bounds.mean) / bounds.sd) ** 2))

    return objective(model.sse, theta) < objective(start.model.sse, start.theta)
