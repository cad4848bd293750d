"""Actions polished through the simulator at acting time.

The miss of an action is simulated for plausible objects, and its mean square over them is reduced
by damped Gauss-Newton steps (Levenberg 1944, Marquardt 1963):

    min over a of  sum_k |f(a, object_k) + b(a) - g|^2 / K + sum_k caution(risk_k)^2 / K + s(a)^2,

where f is the simulated result, b the simulator's error as learnt from executions, and s the
standard deviation of b (`gendom.policies.adaptation`). Actions whose outcome depends little on what
is uncertain win. An action has one to three numbers, so its derivatives are central differences of
worlds in one batch. The search begins at the policy's action and does not leave its neighbourhood:
elsewhere the simulator may hold a release for good that in reality sways (docs/notes/policies.md).

A task without goals has no such residuals: a share that is enough or not has no derivative. There
the best of the known actions is varied by chance, ever less, and the best so far is kept.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import SimulationError
from gendom.materials import Item, unit_of
from gendom.policies.rollouts import Asking, central_differences, side_by_side, stencil
from gendom.tasks import Task
from gendom.tasks.task import Outcome, World
from gendom.tasks.world import Simulation


class Discrepancy(Protocol):
    """The simulator's error, learnt from executions."""

    def __call__(self, action: Array) -> tuple[Array, float]:
        """Mean [G] and standard deviation of it at an action [A], in SI units."""
        ...


MAX_ITERATIONS = 6
"""Steps, or rounds of variations, at most."""

VARIATION, VARIATIONS = 0.08, 12
"""Standard deviation of the first variations of an action of a task without goals [of its limits'
width], and how many there are in each of `MAX_ITERATIONS` rounds."""

STEP = 0.002
"""Of central differences [units of similarity]."""

TOLERANCE = 1e-4
"""Root mean square of the miss at which polishing ends [units of similarity]."""

LEAST_GAIN = 0.02
"""Share of the mean square below which a step gained too little for another."""

RISK_MARGIN, RISK_WEIGHT = 0.7, 0.1
"""Share of the task's risk limit that is not punished, and what a risk beyond that counts, for each
of its limit [units of similarity]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Polished:
    """A better action."""

    action: Array
    """[A] in SI units."""
    expected: float
    """Root mean square of its miss over the objects [goal's unit]."""
    before: float
    """That of the action polishing began with."""
    rollouts: int
    seconds: float


@dataclass(eq=False)
class _Point:
    """An action, its residuals and their derivatives, in units of similarity."""

    a: Array
    r: Array
    J: Array
    damping: float = 1e-3
    done: bool = False

    @property
    def cost(self) -> float:
        return float(self.r @ self.r)


class PolishingProblem:
    """What is minimised, for K objects; actions and goals in units of similarity."""

    def __init__(
        self, task: Task, goal: Array, items: Sequence[Item], discrepancy: Discrepancy | None
    ):
        self.task, self.goal, self.items, self.discrepancy = task, goal, items, discrepancy
        self.units = task.action_units(items[0])
        self.goal_units = task.goal_units(items[0])
        self.goal_unit = float(self.goal_units[0]) if task.goals else 1.0
        self.rollouts = 0

    def residuals(
        self, actions: Sequence[Array], items: Sequence[Item] | None = None
    ) -> Asking[list[Array]]:
        """Of each action with K objects (default: all): [K (G or 1, and 1 for the risk) + 1 for the
        discrepancy's deviation], weighted so that their square is the mean over the objects;
        infinite where a simulation failed."""
        items = self.items if items is None else items
        K, each = len(items), [item for _ in actions for item in items]
        rows = np.repeat(np.array(actions) * self.units, K, axis=0)
        # objects of one size may differ in what they allow
        rows = [self.task.nearest(i, a) for i, a in zip(each, rows, strict=True)]
        outcomes = yield each, rows
        self.rollouts += len(each)
        found = []
        for n, action in enumerate(actions):
            wrong, deviation = np.zeros(len(self.goal)), 0.0
            if self.discrepancy is not None:
                wrong, deviation = self.discrepancy(action * self.units)
            own = zip(items, outcomes[n * K : (n + 1) * K], strict=True)
            parts = [self._residual(item, outcome, wrong) for item, outcome in own]
            parts.append(np.array([np.sqrt(K) * deviation / self.goal_unit]))
            found.append(np.concatenate(parts) / np.sqrt(K))
        return found

    def _residual(self, item: Item, outcome: Outcome, wrong: Array) -> Array:
        """[G or 1, and 1 for the risk] of one object."""
        task, values = self.task, outcome.values
        if outcome.fault is not None:
            return np.full(max(len(task.goals), 1) + 1, np.inf)
        miss = np.array([values[q.name] for q in task.goals]) + wrong - self.goal
        miss = miss / self.goal_units if task.goals else task.error(item, self.goal, values)
        caution = 0.0
        if task.risk is not None:
            share = values[task.risk.name] / (task.risk.limit * unit_of(task.risk.unit, item))
            caution = RISK_WEIGHT * max(0.0, share - RISK_MARGIN)
        return np.append(miss, caution)

    def nearest(self, action: Array) -> Array:
        """[A] the nearest action that is allowed."""
        return self.task.nearest(self.items[0], action * self.units) / self.units

    def flat(self, actions: Sequence[Array]) -> Asking[list[_Point]]:
        """Actions with residuals alone."""
        r = yield from self.residuals(actions)
        return [
            _Point(a=a, r=x, J=np.zeros((len(x), len(a)))) for a, x in zip(actions, r, strict=True)
        ]

    def point(self, action: Array) -> Asking[_Point]:
        """An action with residuals and derivatives, simulated side by side."""
        allowed = np.array([self.nearest(a) for a in stencil(action, STEP)])
        r = np.array((yield from self.residuals(list(allowed))))
        return _Point(a=allowed[0], r=r[0], J=central_differences(allowed, r))


def polish(
    task: Task,
    goal: ArrayLike,
    items: Sequence[Item],
    start: ArrayLike,
    *,
    world: World | None = None,
    **how: Any,
) -> Polished:
    """The action whose miss is smallest over plausible objects, found in a world (default: our
    simulator); other arguments and errors as of `polishing`."""
    search = polishing(task, goal, items, start, **how)
    return side_by_side(task, world or Simulation(), [search])[0]


def polishing(
    task: Task,
    goal: ArrayLike,
    items: Sequence[Item],
    start: ArrayLike,
    *,
    seconds: float = 10.0,
    seed: int = 0,
    discrepancy: Discrepancy | None = None,
) -> Asking[Polished]:
    """`polish` as a search that asks for rollouts, for many at once (`side_by_side`).

    Args:
        task: What is done.
        goal: [G] in SI units.
        items: K objects of one size: one that is known, or draws of an `Estimate`.
        start: [A] where to begin, such as a policy's action, in SI units.
        seconds: Wall time after which the best so far is taken [s].
        seed: Of variations.
        discrepancy: What is added to what the simulator says is reached.

    Raises:
        ParameterError: Numbers do not agree, or the start is not allowed.
        SimulationError: No action could be simulated.
    """
    began = time.monotonic()
    wanted = np.atleast_1d(np.asarray(goal, dtype=float)) if task.goals else np.empty(0)
    fits = wanted.shape == (len(task.goals),) and np.isfinite(wanted).all()
    require(fits, f"is {wanted.tolist()}", where="goal")
    require(seconds > 0.0, f"must be positive, got {seconds}", where="seconds")
    require(items, "no object to polish for", fix="give one or more")
    problem = PolishingProblem(task, wanted, items, discrepancy)
    first = task.check_action(items[0], start) / problem.units
    rng, deadline = np.random.default_rng(seed), began + seconds
    if task.goals:
        points = [(yield from problem.point(first))]
    else:
        points = yield from problem.flat([first, *map(np.array, task.candidates)])
    what = f"no action of {task.name} can be simulated with this {task.kind}"
    fix = "check the object's numbers"
    require(min(p.cost for p in points) < np.inf, what, fix=fix, error=SimulationError)
    if task.goals:
        best = yield from _improved(problem, points[0], deadline)
    else:
        best = yield from _varied(problem, points, rng, deadline)
    return Polished(
        action=task.check_action(items[0], best.a * problem.units),
        expected=float(np.sqrt(best.cost)) * problem.goal_unit,
        before=float(np.sqrt(points[0].cost)) * problem.goal_unit,
        rollouts=problem.rollouts,
        seconds=time.monotonic() - began,
    )


def _varied(
    problem: PolishingProblem, points: Sequence[_Point], rng: np.random.Generator, deadline: float
) -> Asking[_Point]:
    """The best that variations of the best lead to from some points until a time [s]."""
    best = min(points, key=lambda p: p.cost)
    low, high = (problem.task.limits(problem.items[0]) / problem.units[:, None]).T
    round_seconds = 0.0
    for k in range(MAX_ITERATIONS):
        starts = time.monotonic()
        if best.cost < TOLERANCE**2 or deadline - starts < round_seconds:
            break
        away = VARIATION * 0.7**k * (high - low) * rng.normal(size=(VARIATIONS, len(low)))
        found = yield from problem.flat([problem.nearest(best.a + one) for one in away])
        best = min([best, *found], key=lambda p: p.cost)
        round_seconds = time.monotonic() - starts
    return best


def _improved(problem: PolishingProblem, best: _Point, deadline: float) -> Asking[_Point]:
    """What damped Gauss-Newton steps lead to until a time [s]."""
    round_seconds = 0.0
    for _ in range(MAX_ITERATIONS):
        starts = time.monotonic()
        if best.done or deadline - starts < round_seconds:
            break
        new = yield from problem.point(best.a + _step(best))
        best = _better(best, new)
        round_seconds = time.monotonic() - starts
    return best


def _step(p: _Point) -> Array:
    H = p.J.T @ p.J
    D = np.maximum(np.diag(H), 1e-6 * max(float(np.trace(H)), 1e-12))
    damped = H + p.damping * np.diag(D) + 1e-15 * np.eye(len(H))
    return np.asarray(np.linalg.solve(damped, -p.J.T @ p.r), dtype=float)


def _better(old: _Point, new: _Point) -> _Point:
    """Whichever costs less, with the damping of its next step."""
    if not new.cost < old.cost:
        old.damping = max(10.0 * old.damping, 1e-2)
        old.done = old.damping > 1e4 or old.cost < TOLERANCE**2
        return old
    gained = (old.cost - new.cost) / old.cost
    new.damping = max(0.1 * old.damping, 1e-6)
    new.done = new.cost < TOLERANCE**2 or gained < LEAST_GAIN
    return new
