"""`gauss-newton`: damped Gauss-Newton steps from several starts at once, then the noise.

Steps minimise -2 log of likelihood times prior, all starts in one batch of worlds;
derivatives are differences between worlds side by side, kept while they are accurate enough
(Broyden 1965). The step is Levenberg's and Marquardt's (Nocedal and Wright 2006, chapter 10), of a
cloth with several dampings and once by the object's own unknowns alone: the set of held points
changes in jumps, and those unknowns do not cause any. The coarse stage has few unknowns and does
not register clouds; the fine one, about the best start, estimates noise in turns with steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gendom.arrays import Array
from gendom.estimation.likelihood import Comparisons
from gendom.estimation.methods.search import best_of, estimated_noise, first_starts
from gendom.estimation.observed import NoiseModel
from gendom.estimation.priors import INSTRUMENTED
from gendom.estimation.problem import Found, Problem, Start

SCANNED = 12
"""Moduli of the scan that precedes the search, over the whole range."""

COARSE_NOISE, COARSE_SHARE = 0.005, 0.6
"""Noise of the coarse stage [m], and its largest share of the iterations."""

PATIENCE = 6
"""Iterations that other starts may still take after the best one has converged."""

DAMPING, DAMPING_RATIO = (1e-3, 1e3), 30.0
"""Levenberg's and Marquardt's: the least, and that at which a start is given up; ratio of two side
by side."""

STEPS, AT_ONCE = (10, 12, 5), 2
"""Of a thrifty search the most iterations of its coarse and fine stage and where it is refined, and
how many steps it tries side by side at first."""

UNLIKELY = 9.0
"""Fall of -2 log likelihood, that of three deviations, beyond which another end does not count."""

REACHED = 0.3
"""Distance in ln(E) from which Gauss-Newton steps reach a minimum."""

PER_BATCH = 2
"""Iterations for each of `EstimateSettings.max_iterations`: few compute derivatives."""


@dataclass(frozen=True, kw_only=True)
class GaussNewtonSettings:
    """What differs between searches; defaults are those of ropes, `of` has those of cloths."""

    leading: tuple[str, ...] = ("E_over_rho", "damping", "grip_turn", "tip_mass", *INSTRUMENTED)
    """Unknowns that are free in the coarse stage, so that others do not absorb their effect."""
    gain: tuple[float, float] = (2.0, 0.2)
    """Least gain of a step, in the coarse and in the fine stage, before a start has converged."""
    rugged: bool = False
    """Whether several steps are tried side by side."""
    thrifty: bool = False
    """Whether few of them are at first, and none that promise less than the least gain."""
    leap: Callable[[Descent, Start], bool] | None = None
    """Moves a start that has converged to a better point; returns whether there is one."""

    @classmethod
    def of(cls, kind: str) -> GaussNewtonSettings:
        """For ropes or cloths, of which few points do not show the grip as well as recordings state
        it, so what leads are stiffness and friction, or all but damping where they do not; the
        objective is rugged; each step takes long; and the model's error exceeds the noise of the
        clouds, so small gains do not count."""
        if kind != "cloth":
            return cls()
        return cls(leading=("E_over_rho", "friction"), gain=(10.0, 10.0), rugged=True, thrifty=True)


def gauss_newton(
    problem: Problem, settings: GaussNewtonSettings | None = None, *, initial: Sequence[Array] = ()
) -> Found:
    """Search, by default with the settings of its kind of object, and keep the best so far if
    interrupted; ``initial`` [P] are where to begin instead of at the best of a scan.

    Raises:
        SimulationError: No start can be simulated.
        KeyboardInterrupt: If interrupted before anything was found.
    """
    settings = settings or GaussNewtonSettings.of(problem.scene.kind)
    most = PER_BATCH * problem.settings.max_iterations
    problem, starts = first_starts(problem, SCANNED, initial)
    noise, interrupted, others, best = problem.first_noise(), False, (), None
    try:
        coarse = Descent.coarse(problem.coarse, settings)
        iteration = coarse.search(starts, most)
        best = best_of(starts)
        if best is None:
            raise problem.nothing_runs()
        ends, last = [], most
        if settings.thrifty:
            problem = problem.followed(best.vector)
            more = problem.finer(best.vector) is not problem  # points follow
            last = min(most, iteration + STEPS[2 if more else 1])
        for s in (best, *coarse.rivals(best, starts)):
            fine = Descent(problem, settings, noise, settings.gain[1])
            fine.converge(s, iteration, last)
            ends.append((s, fine.noise))
        best, noise, others = _likeliest(fine, ends)
    except KeyboardInterrupt:
        interrupted, best = True, best or best_of(starts)
        if best is None:
            raise
        if best.coarse:
            Descent(problem, settings, noise, settings.gain[1]).begin(best)
        noise = estimated_noise(best.compared, noise)
    said = {"interrupted": interrupted, "others": others}
    return Found(problem=problem, best=best, starts=starts, noise=noise, **said)


def refined(problem: Problem, found: Found) -> Found:
    """The result, refined in a problem of higher resolution.

    Raises:
        SimulationError: It cannot be simulated there.
    """
    settings = GaussNewtonSettings.of(problem.scene.kind)
    fine, best = Descent(problem, settings, found.noise, settings.gain[1]), found.best
    most = max(1, round((1.0 - COARSE_SHARE) * PER_BATCH * problem.settings.max_iterations))
    best.coarse = True
    if settings.thrifty:  # derivatives change little with more points
        most = min(most, STEPS[2])
        fine.carry_on(best)
    try:
        fine.converge(best, 0, most)
    except KeyboardInterrupt:
        return replace(found, problem=problem, interrupted=True)
    return replace(found, problem=problem, noise=fine.noise)


def _likeliest(
    fine: Descent, ends: Sequence[tuple[Start, tuple[NoiseModel, ...]]]
) -> tuple[Start, tuple[NoiseModel, ...], tuple[Array, ...]]:
    """Of starts' ends the most likely one, its noise, and places [P] of others that are apart."""
    if len(ends) == 1:
        return *ends[0], ()
    for s, _ in ends:
        s.value = fine.problem.value(s.vector, s.compared, ends[0][1])
    best, noise = min(ends, key=lambda end: end[0].value)
    others = replace(fine, noise=noise).apart(best, [s for s, _ in ends], 1.0)
    return best, noise, tuple(s.vector for s in others)


@dataclass
class Descent:
    """Steps of starts down -2 log of likelihood times prior."""

    problem: Problem
    settings: GaussNewtonSettings
    noise: tuple[NoiseModel, ...]
    """Of each recording."""
    least: float
    """Gain of a step below which a start has converged."""
    free: Sequence[int] | None = None
    """Indices of the unknowns that move; None: all."""

    @classmethod
    def coarse(cls, problem: Problem, settings: GaussNewtonSettings) -> Descent:
        """By the leading unknowns alone, of clouds that are not registered."""
        least = problem.settings.noise.least_model
        own = {"sensor": COARSE_NOISE, "model": 0.0, "beside": least, "rounds": 1}
        own |= {"patch": 1.0} if problem.captured else {}
        leading = {*settings.leading}
        if settings.rugged and any(len(part.scene.guesses) > 1 for part in problem.parts):
            leading = {*problem.prior.names} - {"damping"}
        free = [k for k, name in enumerate(problem.prior.names) if name in leading]
        return cls(problem, settings, problem.first_noise(**own), settings.gain[0], free or None)

    def search(self, starts: Sequence[Start], most: int) -> int:
        """Steps of all starts, in a share of so many iterations. Returns their number."""
        late, iteration, own = 0, 0, STEPS[0] if self.settings.thrifty else most
        own = min(own, max(1, round(COARSE_SHARE * most)))
        while iteration < own:
            going = [s for s in starts if not s.done]
            if not going or late == PATIENCE:
                break
            iteration += 1
            self.step(going)
            leads = best_of(starts)
            late = late + 1 if leads is not None and leads.done else 0
            if leads is not None and (self.settings.rugged or self.problem.captured):
                for s in starts:  # so many steps like its last one would not reach the best
                    s.done |= s.value - leads.value > PATIENCE * s.won
            self.problem.tell("search", iteration, most, leads or starts[0])
        return iteration

    def converge(self, best: Start, iteration: int, most: int) -> None:
        """Steps of a start, in turns with estimates of the noise, up to so many iterations."""
        if best.coarse:
            self.begin(best)
        while iteration < most:
            iteration += 1
            self.noise = estimated_noise(best.compared, self.noise)
            best.value = self.problem.value(best.vector, best.compared, self.noise)
            best.done = False
            self.step([best])
            self.problem.tell("noise", iteration, most, best)
            if best.done and not (self.settings.leap and self.settings.leap(self, best)):
                break
        else:
            self._renew([best])
        self.noise = estimated_noise(best.compared, self.noise)

    def begin(self, start: Start) -> None:
        """Compare a start of the coarse problem in this one, by all unknowns."""
        former, start.damping, start.coarse = start.comparison, DAMPING[0], False
        start.exact, start.renew = not self.settings.rugged, False
        start.precise = self.settings.rugged or self.problem.captured
        (start.comparison,) = self.problem.compare([start.vector], sketched=True)
        if start.comparison is None and former is not None and self.settings.rugged:
            # where a neighbour cannot be simulated, the old derivatives stay
            start.comparison = former
            self.carry_on(start)
        if start.comparison is None:
            raise self.problem.nothing_runs()

    def carry_on(self, start: Start) -> None:
        """Compare a start of a problem with other points in this one, with its derivatives."""
        former, none = start.comparison, np.zeros(len(start.vector))
        (start.comparison,) = self.problem.compare([start.vector], derivatives=False)
        if start.comparison is None or former is None:
            raise self.problem.nothing_runs()
        self.problem.inherit_derivatives(start.comparison, former, none, none)
        start.damping, start.coarse, start.exact, start.renew = DAMPING[0], False, False, False

    def covariance(self, start: Start) -> Array:
        """[P, P] of the unknowns, by the curvature at a start."""
        return np.linalg.inv(self.problem.gradient_and_hessian(start, self.noise)[1])

    def apart(self, best: Start, starts: Sequence[Start], least: float) -> list[Start]:
        """Starts that have ended so many deviations or more from the best one, and from each other,
        in an unknown of the object, and are not much less likely."""
        own, found = self.of_object(), [best]
        sd = np.sqrt(np.diag(self.covariance(best)))
        for s in starts:
            near = s.comparison is not None and s.done and s.value - best.value < UNLIKELY
            off = [(np.abs(s.vector - other.vector) / sd)[own].max(initial=0.0) for other in found]
            if near and min(off) > least:
                found.append(s)
        return found[1:]

    def rivals(self, best: Start, starts: Sequence[Start]) -> list[Start]:
        """Others of which the fine stage is to say whether they are the better ones: those that
        have ended apart, and of a rope two deviations away from the best one, where that is beyond
        what steps reach, in E / density and in what makes up for it, which follows the rope's
        compliance."""
        prior, name, found = self.problem.prior, "E_over_rho", self.apart(best, starts, 3.0)
        if not self.problem.lifted_rope or name not in prior.names:
            return found
        k, covariance = prior.names.index(name), self.covariance(best)
        far = 2.0 * np.sqrt(covariance[k, k])
        for way in (far, -far) if far > REACHED else ():
            share = (1.0 - np.exp(-way)) / covariance[k, k]
            vector = best.vector + share * covariance[k]
            vector[k] = best.vector[k] + way
            if (prior.clipped(vector) == vector).all():
                found.append(Start(initial=vector, vector=vector))
        return found

    def step(self, going: Sequence[Start]) -> None:
        """Proposals of every start, in one batch, of which it takes the best; a start is done where
        it can gain no more than the least. Derivatives are computed again where steps gain less
        than half of what they predict, before a start is given up, and at the end."""
        problem, rugged, thrifty = self.problem, self.settings.rugged, self.settings.thrifty
        self._renew([s for s in going if s.comparison is None or s.renew])
        if thrifty:
            self._renew([s for s in going if not (s.done or s.exact) and self._idle(s)])
            for s in going:
                s.done = s.done or (s.exact and self._idle(s))
        going = [s for s in going if not s.done]
        if not going:
            return
        proposed = [self.propose(s) for s in going]
        tries, once = [found for found, _ in proposed], AT_ONCE if thrifty else None
        tried = self._tried(going, [found[:once] for found in tries])
        for k, s in enumerate(going):
            # others where these win little by derivatives of its own
            if thrifty and s.exact and s.value - min(tried[k][1]) < self.least:
                ((compared, values),) = self._tried([s], [tries[k][once:]])
                tried[k] = tried[k][0] + compared, tried[k][1] + values
        for s, (tries, weight), (compared, values) in zip(going, proposed, tried, strict=True):
            former = s.compared
            s.iterations += 1
            best = int(np.argmin(values))
            (vector, gain, damping), closer = tries[best], compared[best]
            if closer is not None and values[best] < s.value:
                s.won = won = s.value - values[best]
                little = won < self.least or (not rugged and gain < self.least)
                problem.inherit_derivatives(closer, former, vector - s.vector, weight)
                s.done, s.renew = little and s.exact and s.precise, little or won < 0.5 * gain
                s.precise |= little and s.exact
                s.exact, s.damping = False, max(damping / 10.0, DAMPING[0])
                s.vector, s.comparison, s.value = vector, closer, values[best]
            elif s.exact and not s.precise:
                s.precise = s.renew = True
            elif s.exact:
                s.damping *= DAMPING_RATIO ** (2 if rugged else 1)
                s.done = tries[0][1] < self.least or s.damping > DAMPING[1]
            else:
                s.renew = True

    def _idle(self, start: Start) -> bool:
        """Whether no step promises as much as the least gain."""
        return max(gain for _, gain, _ in self.propose(start)[0]) < self.least

    def _tried(
        self, going: Sequence[Start], tries: Sequence[Sequence[tuple[Array, float, float]]]
    ) -> list[tuple[list[Comparisons | None], list[float]]]:
        """Comparisons and values of each start's tries, simulated in one batch."""
        places, rows = [[vector for vector, _, _ in row] for row in tries], []
        found = iter(self.problem.compare([v for row in places for v in row], derivatives=False))
        for s, vectors in zip(going, places, strict=True):
            compared = [next(found) for _ in vectors]
            rows.append((compared, self.problem.values(vectors, compared, self.noise, s)))
        return rows

    def _renew(self, starts: Sequence[Start]) -> None:
        """Compute the derivatives of starts; one that cannot be simulated is done."""
        if not starts:
            return
        few = False if all(s.precise for s in starts) else None
        compared = self.problem.compare([s.vector for s in starts], free=self.free, sketched=few)
        for s, comparison in zip(starts, compared, strict=True):
            former, s.exact, s.renew = s.comparison, True, False
            if comparison is None:
                # where a neighbour cannot be simulated, the old derivatives stay
                s.done = former is None
                continue
            if former is not None:
                if self.settings.rugged:
                    # registered as far as before, or any step would win by a further round
                    self.problem.value(s.vector, former, self.noise)
                comparison.warm_start(former)
            s.comparison, s.value = comparison, self.problem.value(s.vector, comparison, self.noise)

    def propose(self, start: Start) -> tuple[list[tuple[Array, float, float]], Array]:
        """A damped step; on rugged objectives others, too: places [P] with the gain that the
        quadratic model predicts and their damping; and that model's curvature along each unknown
        [P]."""
        prior = self.problem.prior
        gradient, H = self.problem.gradient_and_hessian(start, self.noise)
        # a parameter pressed against its bound is held there
        low, high = start.vector <= prior.low, start.vector >= prior.high
        free = np.isin(np.arange(len(low)), range(len(low)) if self.free is None else self.free)
        free &= ~((low & (gradient > 0)) | (high & (gradient < 0)))
        own = free & self.of_object()
        tries = [(free, start.damping, 1.0)]
        if self.settings.rugged:
            # points that slide along a surface make Gauss-Newton steps too short
            both = own.any() and (own != free).any()
            ways = (free, own) if both else (free,)
            tries = [(way, start.damping, times) for times in (1.0, 3.0) for way in ways]
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
                inside = prior.clipped(start.vector + step) - start.vector
                out = which & (prior.clipped(start.vector + step) != start.vector + step)
                if not out.any():
                    break
                step = np.where(out, inside, step)
                which, at_bound = which & ~out, at_bound | out
            step *= min(1.0, float(np.min(prior.widest / np.maximum(np.abs(step), 1e-300))))
            vector = prior.clipped(start.vector + step)
            step = vector - start.vector
            proposals.append((vector, float(-2.0 * gradient @ step - step @ H @ step), damping))
        return proposals, np.diag(H).copy()

    def of_object(self) -> Array:
        """[P] which unknowns are the object's own."""
        return np.array([u.material for u in self.problem.prior.unknowns], dtype=bool)
