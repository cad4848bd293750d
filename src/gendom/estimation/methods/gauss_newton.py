"""`gauss-newton`: damped Gauss-Newton steps from several starts at once, then the noise.

Parameters go down on -2 log of likelihood times prior, all starts in one batch of worlds;
derivatives are differences between worlds side by side. The step is Levenberg's and Marquardt's
(Nocedal and Wright 2006, chapter 10). From afar only what moves shapes most is free, and clouds are
compared as they are, those in which nothing moves fast where there are enough; about the best
start's end everything is free, the model's displacement is registered, and noise and displacement
are estimated in turns with steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gendom.estimation.likelihood import NoiseModel
from gendom.estimation.methods.search import best_of, estimated_noise, first_starts
from gendom.estimation.problem import Found, Problem, Start

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class GaussNewtonSettings:
    """Bounds of the search."""

    scanned: int = 12
    """Moduli of the scan that precedes the search, over the whole range."""
    initial: tuple[Array, ...] = ()
    """[P] transformed: where to begin instead of there."""
    leading: tuple[str, ...] = ("specific_modulus", "damping")
    """Unknowns of ropes that are free from afar: others would take on what is not theirs. How a
    cloth is held shows as much as how it bends, so all of its are."""
    afar: float = 0.005
    """Noise with which clouds are compared from afar [m]."""
    share_afar: float = 0.6
    """Share of the iterations that may be spent there."""
    gain: tuple[float, float] = (2.0, 0.2)
    """A start has arrived when a step can win no more than this, afar and near."""
    damping: tuple[float, float] = (1e-3, 1e3)
    """Levenberg's and Marquardt's: the least, and that at which a start is given up."""
    expectations: int = 6
    """Rounds of expectation and maximisation between two steps."""


def gauss_newton(problem: Problem, settings: GaussNewtonSettings | None = None) -> Found:
    """Search, and keep the best so far if interrupted.

    Raises:
        SimulationError: No start can be simulated.
        KeyboardInterrupt: If interrupted before anything was found.
    """
    settings = settings or GaussNewtonSettings()
    stated = problem.first_noise()
    afar = problem.first_noise(
        sensor=settings.afar, model=problem.settings.noise.least_model, rounds=1
    )
    noise, most = afar, problem.settings.max_iterations
    names = problem.prior.names
    free = [k for k, name in enumerate(names) if name in settings.leading] or None
    if problem.scene.kind == "cloth":
        free = None
    starts = first_starts(problem, settings.scanned, settings.initial)
    interrupted, iteration = False, 0
    try:
        while iteration < max(1, round(settings.share_afar * most)):
            going = [s for s in starts if not s.done]
            if not going:
                break
            iteration += 1
            _step(problem.easier, going, noise, settings.gain[0], settings, free)
            problem.tell("search", iteration, most, best_of(starts) or starts[0])
        best = best_of(starts)
        if best is None:
            raise problem.nothing_runs()
        noise, best.damping = stated, settings.damping[0]
        for start in starts:
            start.coarse = start.iterations
        if free is not None or problem.easier is not problem:
            _compare_all(problem, best)
        noise = _near(problem, best, noise, settings, iteration, most)
    except KeyboardInterrupt:
        interrupted = True
        best = best_of(starts)
        if best is None:
            raise
        if best.comparison is None or not problem.compares(best.comparison):
            _compare_all(problem, best)
        assert best.comparison is not None
        noise = estimated_noise(best.comparison, noise, settings.expectations)
    return Found(best=best, starts=starts, noise=noise, interrupted=interrupted)


def refined(problem: Problem, found: Found, settings: GaussNewtonSettings | None = None) -> Found:
    """What was found, searched once more about its end in a finer problem.

    Raises:
        SimulationError: It cannot be simulated there.
    """
    settings = settings or GaussNewtonSettings()
    best, noise = found.best, found.noise
    _compare_all(problem, best)
    best.damping = settings.damping[0]
    most = max(1, round((1.0 - settings.share_afar) * problem.settings.max_iterations))
    try:
        noise = _near(problem, best, noise, settings, 0, most)
    except KeyboardInterrupt:
        found = replace(found, interrupted=True)
    return replace(found, best=best, noise=noise)


def _near(
    problem: Problem,
    best: Start,
    noise: tuple[NoiseModel, ...],
    settings: GaussNewtonSettings,
    iteration: int,
    most: int,
) -> tuple[NoiseModel, ...]:
    """Steps of a start by all unknowns, in turns with the noise, which is returned."""
    # a simulated cloth is farther from a real one than its clouds' noise: little gains are none
    least = settings.gain[0 if problem.scene.kind == "cloth" else 1]
    while iteration < most:
        iteration += 1
        assert best.comparison is not None
        noise = estimated_noise(best.comparison, noise, settings.expectations)
        best.value = problem.value(best.vector, best.comparison, noise)
        best.done = False
        _step(problem, [best], noise, least, settings)
        problem.tell("noise", iteration, most, best)
        if best.done:
            break
    assert best.comparison is not None
    return estimated_noise(best.comparison, noise, settings.expectations)


def _compare_all(problem: Problem, start: Start) -> None:
    """Compare a start of an easier problem with all there is, by all unknowns."""
    start.comparison = problem.compare([start.vector])[0]
    if start.comparison is None:
        raise problem.nothing_runs()


def _step(
    problem: Problem,
    going: Sequence[Start],
    noise: Sequence[NoiseModel],
    least: float,
    settings: GaussNewtonSettings,
    free: Sequence[int] | None = None,
) -> None:
    """One proposal of every start, in one batch; a start is done where it can win no more than
    ``least``."""
    proposals, gains = [], []
    for s in going:
        proposal, gain = (
            (s.vector, np.inf) if s.comparison is None else _propose(problem, s, noise, free)
        )
        proposals.append(proposal)
        gains.append(gain)
    compared = problem.compare(proposals, free=free)
    for s, proposal, gain, comparison in zip(going, proposals, gains, compared, strict=True):
        s.iterations += 1
        value = np.inf
        if comparison is not None:
            if s.comparison is not None:
                comparison.follow(s.comparison)
            value = problem.value(proposal, comparison, noise)
        if comparison is not None and value < s.value:
            s.done = gain < least or s.value - value < least
            s.vector, s.comparison, s.value = proposal, comparison, value
            s.damping = max(s.damping / 10.0, settings.damping[0])
            s.history.append((s.iterations, proposal.copy(), comparison.rms))
        else:
            s.damping *= 10.0
            s.done = gain < least or s.comparison is None or s.damping > settings.damping[1]


def _propose(
    problem: Problem, start: Start, noise: Sequence[NoiseModel], among: Sequence[int] | None
) -> tuple[Array, float]:
    """Where to try next, and what the quadratic model says is to be won there."""
    prior = problem.prior
    gradient, H = problem.slopes(start, noise)
    # a parameter pressed against its bound is held there
    low, high = start.vector <= prior.low, start.vector >= prior.high
    free = np.isin(np.arange(len(low)), range(len(low)) if among is None else among)
    free &= ~((low & (gradient > 0)) | (high & (gradient < 0)))
    step = np.zeros(len(free))
    if free.any():
        Hf = H[np.ix_(free, free)]
        damped = Hf + start.damping * np.diag(np.diag(Hf))
        step[free] = -np.linalg.solve(damped, gradient[free])
    step *= min(1.0, float(np.min(prior.widest / np.maximum(np.abs(step), 1e-300))))
    proposal = prior.clipped(start.vector + step)
    step = proposal - start.vector
    return proposal, float(-2.0 * gradient @ step - step @ H @ step)
