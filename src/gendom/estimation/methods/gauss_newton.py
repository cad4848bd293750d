"""`gauss-newton`: damped Gauss-Newton steps from several starts at once, then the noise.

Steps minimise -2 log of likelihood times prior, all starts in one batch of worlds;
derivatives are differences between worlds side by side, kept while they are accurate enough
(Broyden 1965). The step is Levenberg's and Marquardt's (Nocedal and Wright 2006, chapter 10), of a
cloth with several dampings and once by the object's own unknowns alone: the set of held points
changes in jumps, and those unknowns do not cause any. In the coarse stage only the most influential
unknowns are free, and clouds are not registered. In the fine stage, about the best start's result,
everything is free, and noise and the model's displacement are estimated in turns with steps.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gendom.arrays import Array
from gendom.estimation.methods.search import best_of, estimated_noise, first_starts
from gendom.estimation.observed import NoiseModel
from gendom.estimation.priors import INSTRUMENTED
from gendom.estimation.problem import Found, Problem, Start
from gendom.materials.unknowns import UNKNOWNS

SCANNED = 12
"""Moduli of the scan that precedes the search, over the whole range."""

COARSE_NOISE, COARSE_SHARE = 0.005, 0.6
"""Noise of the coarse stage [m], and its largest share of the iterations."""

PATIENCE = 6
"""Iterations that other starts may still take after the best one has converged."""

DAMPING, DAMPING_RATIO = (1e-3, 1e3), 30.0
"""Levenberg's and Marquardt's: the least, and that at which a start is given up; ratio of two side
by side."""

TRIED = 4
"""Leaps that are simulated as finely as the problem asks for: the nearest ones of a coarse try."""

UNLIKELY = 9.0
"""Fall of -2 log likelihood, that of three deviations, beyond which another end does not count."""

REACHED = 0.3
"""Distance in ln(E) from which Gauss-Newton steps reach a minimum."""

PER_BATCH = 2
"""Iterations for each of `EstimateSettings.max_iterations`: few compute derivatives."""


@dataclass(frozen=True, kw_only=True)
class GaussNewtonSettings:
    """What differs between searches; defaults are those of ropes, `of` has those of cloths."""

    leading: tuple[str, ...] = (
        "E_over_rho", "damping", "grip_turn", "tip_mass", *INSTRUMENTED,
    )  # fmt: skip
    """Unknowns that are free in the coarse stage, so that others do not absorb their effect."""
    gain: tuple[float, float] = (2.0, 0.2)
    """Least gain of a step, in the coarse and in the fine stage, before a start has converged."""
    rugged: bool = False
    """Whether several steps are tried side by side."""
    jumps: tuple[float, ...] = ()
    """Size of trial jumps of the object's unknowns after steps have converged, in deviations."""

    @classmethod
    def of(cls, kind: str, **changes: Any) -> GaussNewtonSettings:
        """For ropes or cloths, of which the grip matters as much as the bending, so all unknowns
        are free; the objective is rugged; and the model's error exceeds the noise of the clouds, so
        small gains do not count."""
        if kind == "cloth":
            own = {"leading": (), "gain": (2.0, 10.0), "rugged": True, "jumps": (3.0, 6.0, 9.0)}
            changes = own | changes
        return cls(**changes)


def gauss_newton(
    problem: Problem,
    settings: GaussNewtonSettings | None = None,
    *,
    initial: Sequence[Array] = (),
) -> Found:
    """Search, and keep the best so far if interrupted.

    Args:
        problem: What is looked for.
        settings: By default those of its kind of object.
        initial: [P] transformed: where to begin instead of at the best of a scan.

    Raises:
        SimulationError: No start can be simulated.
        KeyboardInterrupt: If interrupted before anything was found.
    """
    times, settings = [time.perf_counter()], settings or GaussNewtonSettings.of(problem.scene.kind)
    noise = stated = problem.first_noise()
    most = PER_BATCH * problem.settings.max_iterations
    problem, starts = first_starts(problem, SCANNED, initial)
    times.append(time.perf_counter())
    interrupted, others, best = False, (), None
    try:
        iteration = _coarse_stage(problem, starts, settings, most)
        times.append(time.perf_counter())
        best = best_of(starts)
        if best is None:
            raise problem.nothing_runs()
        rivals = _rivals(problem.coarse, best, starts)
        noise = _fine_stage(problem, best, stated, settings, iteration, most)
        ends = [(s, _fine_stage(problem, s, stated, settings, iteration, most)) for s in rivals]
        best, noise, others = _likeliest(problem, [(best, noise), *ends])
    except KeyboardInterrupt:
        interrupted, best = True, best or best_of(starts)
        if best is None:
            raise
        if best.stage == "coarse":
            _compare_all(problem, best, settings)
        assert best.comparison is not None
        noise = estimated_noise(best.comparison, noise)
    times.append(time.perf_counter())
    parts = zip(("scan", "coarse", "fine"), np.diff(times).tolist(), strict=False)
    return Found(
        problem=problem,
        best=best,
        starts=starts,
        noise=noise,
        interrupted=interrupted,
        others=others,
        seconds=dict(parts),
    )


def _coarse_noise(problem: Problem) -> tuple[NoiseModel, ...]:
    """That of the coarse stage, in which clouds are not registered."""
    least, alone = problem.settings.noise.least_model, {"patch": 1.0} if problem.captured else {}
    return problem.first_noise(sensor=COARSE_NOISE, model=0.0, beside=least, rounds=1, **alone)


def _coarse_stage(
    problem: Problem, starts: Sequence[Start], settings: GaussNewtonSettings, most: int
) -> int:
    """Steps of all starts by the leading unknowns alone. Returns their number."""
    coarse, noise, late, iteration = problem.coarse, _coarse_noise(problem.coarse), 0, 0
    names = problem.prior.names
    free = [k for k, name in enumerate(names) if name in settings.leading] or None
    for start in starts:
        start.stage = "coarse"
    while iteration < max(1, round(COARSE_SHARE * most)):
        going = [s for s in starts if not s.done]
        if not going or late == PATIENCE:
            break
        iteration += 1
        _step(coarse, going, noise, settings.gain[0], settings, free)
        leads = best_of(starts)
        late = late + 1 if leads is not None and leads.done else 0
        if settings.rugged and leads is not None:
            for s in starts:  # so many steps like its last one would not reach the best
                s.done |= s.value - leads.value > PATIENCE * s.won
        problem.tell("search", iteration, most, leads or starts[0])
    return iteration


def refined(problem: Problem, found: Found) -> Found:
    """The result, refined in a problem of higher resolution.

    Raises:
        SimulationError: It cannot be simulated there.
    """
    settings, noise = GaussNewtonSettings.of(problem.scene.kind), found.noise
    found.best.stage = "coarse"
    most = max(1, round((1.0 - COARSE_SHARE) * PER_BATCH * problem.settings.max_iterations))
    try:
        noise = _fine_stage(problem, found.best, noise, settings, 0, most)
    except KeyboardInterrupt:
        found = replace(found, interrupted=True)
    return replace(found, problem=problem, noise=noise)


def _fine_stage(
    problem: Problem,
    best: Start,
    noise: tuple[NoiseModel, ...],
    settings: GaussNewtonSettings,
    iteration: int,
    most: int,
) -> tuple[NoiseModel, ...]:
    """Steps of a start by all unknowns, in turns with estimates of the noise. Returns the noise."""
    if best.stage == "coarse":
        _compare_all(problem, best, settings)
    while iteration < most:
        iteration += 1
        assert best.comparison is not None
        noise = estimated_noise(best.comparison, noise)
        best.value = problem.value(best.vector, best.comparison, noise)
        best.done = False
        _step(problem, [best], noise, settings.gain[1], settings)
        problem.tell("noise", iteration, most, best)
        if best.done and not _jump(problem, best, noise, settings):
            break
    else:
        _renew(problem, [best], noise, None)
    assert best.comparison is not None
    return estimated_noise(best.comparison, noise)


def _apart(
    problem: Problem,
    best: Start,
    starts: Sequence[Start],
    noise: Sequence[NoiseModel],
    least: float,
) -> list[Start]:
    """Starts that have ended so many deviations or more from the best one, and from each other, in
    an unknown of the object, and are not much less likely."""
    own, found = [UNKNOWNS[name].material for name in problem.prior.names], [best]
    sd = np.sqrt(np.diag(np.linalg.inv(problem.gradient_and_hessian(best, noise)[1])))
    for s in starts:
        near = s.comparison is not None and s.done and s.value - best.value < UNLIKELY
        off = [(np.abs(s.vector - other.vector) / sd)[own].max(initial=0.0) for other in found]
        if near and min(off) > least:
            found.append(s)
    return found[1:]


def _rivals(problem: Problem, best: Start, starts: Sequence[Start]) -> list[Start]:
    """Others of which the fine stage is to say whether they are the better ones: those that have
    ended apart, and of a rope two deviations away from the best one, where that is beyond what
    steps reach, in E / density and in what makes up for it, which follows the rope's compliance."""
    prior, name, noise = problem.prior, "E_over_rho", _coarse_noise(problem)
    found = _apart(problem, best, starts, noise, 3.0)
    if not problem.lifted_rope or name not in prior.names:
        return found
    k = prior.names.index(name)
    covariance = np.linalg.inv(problem.gradient_and_hessian(best, noise)[1])
    far = 2.0 * np.sqrt(covariance[k, k])
    for way in (far, -far) if far > REACHED else ():
        share = (1.0 - np.exp(-way)) / covariance[k, k]
        vector = best.vector + share * covariance[k]
        vector[k] = best.vector[k] + way
        if (prior.clipped(vector) == vector).all():
            found.append(Start(initial=vector, vector=vector, stage="coarse"))
    return found


def _likeliest(
    problem: Problem, ends: Sequence[tuple[Start, tuple[NoiseModel, ...]]]
) -> tuple[Start, tuple[NoiseModel, ...], tuple[Array, ...]]:
    """Of starts' ends the most likely one, its noise, and places [P] of others that are apart."""
    if len(ends) == 1:
        return *ends[0], ()
    for s, _ in ends:
        assert s.comparison is not None
        s.value = problem.value(s.vector, s.comparison, ends[0][1])
    best, noise = min(ends, key=lambda end: end[0].value)
    others = _apart(problem, best, [s for s, _ in ends], noise, 1.0)
    return best, noise, tuple(s.vector for s in others)


def _jump(
    problem: Problem,
    start: Start,
    noise: Sequence[NoiseModel],
    settings: GaussNewtonSettings,
) -> bool:
    """Move a start to a better point some deviations away, each of the object's unknowns in both
    directions and the others by their conditional means. Returns whether there is one."""
    prior = problem.prior
    if not settings.jumps or not any(UNKNOWNS[name].material for name in prior.names):
        return False
    covariance = np.linalg.inv(problem.gradient_and_hessian(start, noise)[1])
    places = [
        prior.clipped(start.vector + way * far * covariance[k] / np.sqrt(covariance[k, k]))
        for k, name in enumerate(prior.names)
        if UNKNOWNS[name].material
        for far in settings.jumps
        for way in (-1.0, 1.0)
    ]
    former = start.comparison
    assert former is not None
    # those that are nearest with few points
    coarse = problem.coarse.compare(places, derivatives=False)
    rms = [np.inf if c is None else c.rms for c in coarse]
    places = [places[k] for k in np.argsort(rms, kind="stable")[:TRIED]]
    compared = problem.compare(places, derivatives=False)
    values = problem.values(places, compared, noise, former)
    best = int(np.argmin(values))
    closer = compared[best]
    if closer is None or start.value - values[best] < settings.gain[1]:
        return False
    problem.inherit_derivatives(closer, former, *np.zeros((2, len(prior.names))))
    start.iterations += 1
    start.take(places[best], closer, values[best])
    start.done, start.renew, start.damping = False, True, DAMPING[0]
    return True


def _compare_all(problem: Problem, start: Start, settings: GaussNewtonSettings) -> None:
    """Compare a start of the coarse problem in the full one, by all unknowns."""
    former, start.damping, start.stage = start.comparison, DAMPING[0], "fine"
    start.exact, start.renew = not settings.rugged, False
    start.precise = settings.rugged or problem.captured
    (start.comparison,) = problem.compare([start.vector], sketched=True)
    if start.comparison is None and former is not None and not settings.leading:
        # where a neighbour cannot be simulated, the old derivatives stay
        (start.comparison,) = problem.compare([start.vector], derivatives=False)
        if start.comparison is not None:
            none = np.zeros(len(start.vector))
            problem.inherit_derivatives(start.comparison, former, none, none)
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
    """Proposals of every start, in one batch, of which it takes the best; a start is done where it
    can gain no more than ``least``. Derivatives are computed again where steps gain less than half
    of what they predict, before a start is given up, and at the end."""
    _renew(problem, [s for s in going if s.comparison is None or s.renew], noise, free)
    going = [s for s in going if not s.done]
    if not going:
        return
    proposed = [_propose(problem, s, noise, settings, free) for s in going]
    places = [[vector for vector, _, _ in tries] for tries, _ in proposed]
    tried = iter(problem.compare([v for row in places for v in row], derivatives=False))
    for s, vectors, (tries, weight) in zip(going, places, proposed, strict=True):
        former = s.comparison
        assert former is not None
        s.iterations += 1
        compared = [next(tried) for _ in vectors]
        values = problem.values(vectors, compared, noise, former)
        best = int(np.argmin(values))
        (vector, gain, damping), closer = tries[best], compared[best]
        if closer is not None and values[best] < s.value:
            s.won = won = s.value - values[best]
            little = won < least or (not settings.rugged and gain < least)
            problem.inherit_derivatives(closer, former, vector - s.vector, weight)
            s.done, s.renew = little and s.exact and s.precise, little or won < 0.5 * gain
            s.precise |= little and s.exact
            s.exact, s.damping = False, max(damping / 10.0, DAMPING[0])
            s.take(vector, closer, values[best])
        elif s.exact and not s.precise:
            s.precise = s.renew = True
        elif s.exact:
            s.damping *= DAMPING_RATIO ** (2 if settings.rugged else 1)
            s.done = tries[0][1] < least or s.damping > DAMPING[1]
        else:
            s.renew = True


def _renew(
    problem: Problem,
    starts: Sequence[Start],
    noise: Sequence[NoiseModel],
    free: Sequence[int] | None,
) -> None:
    """Compute the derivatives of starts; one that cannot be simulated is done."""
    if not starts:
        return
    few = None if any(not s.precise for s in starts) else False
    compared = problem.compare([s.vector for s in starts], free=free, sketched=few)
    for s, comparison in zip(starts, compared, strict=True):
        former, s.exact, s.renew = s.comparison, True, False
        if comparison is None:
            # where a neighbour cannot be simulated, the old derivatives stay
            s.done = former is None
            continue
        if former is not None:
            comparison.warm_start(former)
        s.comparison, s.value = comparison, problem.value(s.vector, comparison, noise)
        if former is None:
            s.noted()


def _propose(
    problem: Problem,
    start: Start,
    noise: Sequence[NoiseModel],
    settings: GaussNewtonSettings,
    among: Sequence[int] | None,
) -> tuple[list[tuple[Array, float, float]], Array]:
    """A damped step; on rugged objectives others, too: places [P] with the gain that the quadratic
    model predicts and their damping; and that model's curvature along each unknown [P]."""
    prior = problem.prior
    gradient, H = problem.gradient_and_hessian(start, noise)
    # a parameter pressed against its bound is held there
    low, high = start.vector <= prior.low, start.vector >= prior.high
    free = np.isin(np.arange(len(low)), range(len(low)) if among is None else among)
    free &= ~((low & (gradient > 0)) | (high & (gradient < 0)))
    own = free & np.array([UNKNOWNS[name].material for name in prior.names])
    tries = [(free, start.damping, 1.0)]
    if settings.rugged:
        # points that slide along a surface make Gauss-Newton steps too short
        tries.append((free, start.damping, 3.0))
        if own.any() and (own != free).any():
            tries += [(own, start.damping, 1.0), (own, start.damping, 3.0)]
        tries.append((free, DAMPING_RATIO * start.damping, 1.0))
    proposals = []
    for which, damping, times in tries:
        step, at_bound = np.zeros(len(free)), np.zeros(len(free), dtype=bool)
        while which.any():
            pull = gradient + H[:, at_bound] @ step[at_bound]
            Hf = H[np.ix_(which, which)]
            damped = Hf + damping * np.diag(np.diag(Hf))
            step[which] = -times * np.linalg.solve(damped, pull[which])
            # what would leave the range goes to its end, and the others follow that
            out = which & (prior.clipped(start.vector + step) != start.vector + step)
            if not out.any():
                break
            step = np.where(out, prior.clipped(start.vector + step) - start.vector, step)
            which, at_bound = which & ~out, at_bound | out
        step *= min(1.0, float(np.min(prior.widest / np.maximum(np.abs(step), 1e-300))))
        vector = prior.clipped(start.vector + step)
        step = vector - start.vector
        proposals.append((vector, float(-2.0 * gradient @ step - step @ H @ step), damping))
    return proposals, np.diag(H).copy()
