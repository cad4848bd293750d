"""Actions polished through the simulator at acting time.

The miss of an action, simulated, is reduced by damped Gauss-Newton steps (Levenberg 1944, Marquardt
1963) from the policy's action on:

    min over a and v of  |f(a, object(v)) + b(a) - g|^2 + caution(risk)^2 + s(a)^2 + (S |v|)^2,

where f is the simulated result, g the goal, b the simulator's error as learnt from executions, s
the standard deviation of b (`gendom.policies.adaptation`), and v what the object differs by from
the most likely one, in standard deviations of its estimate. Where a goal has no more numbers than
an action, v is 0: the most likely object counts. Where it has more, as in casting, few goals can be
reached with an object, and that this one is asked for tells of the object: it is looked for
together with the action. For the most likely object alone the nearest that it can reach would be
taken, which lies beside the goal of the true one (docs/notes/policies.md).

An action has one to three numbers, so derivatives are central differences of worlds in one batch.
The search does not leave the neighbourhood of the start: elsewhere the simulator may hold a release
for good that in reality sways.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import SimulationError
from gendom.materials import Item, unit_of
from gendom.materials.estimate import Estimate
from gendom.policies.rollouts import Asking, central_differences, side_by_side, stencil
from gendom.tasks import Task
from gendom.tasks.task import Outcome, World
from gendom.tasks.world import Simulation

Discrepancy = Callable[[Array], tuple[Array, float]]
"""Mean [G] and standard deviation of the simulator's error at an action [A], in SI units."""

MAX_ITERATIONS = 6
"""Steps at most."""

STEP = 0.002
"""Of central differences by an action [units of similarity]."""

OBJECT_STEP, DEVIATIONS = 0.1, 2.0
"""Of those by an object, and how far from the most likely one it is looked for in the first place
[standard deviations]."""

SIMULATOR_ERROR = 0.001
"""What an object reaches beside what is simulated for it: how near a goal counts as much as an
object one standard deviation off [units of similarity]."""

TOLERANCE = 1e-4
"""Root mean square of the miss at which polishing ends [units of similarity]."""

LEAST_GAIN = 0.02
"""Share of the mean square below which a step gained too little for another."""

RISK_MARGIN, RISK_WEIGHT = 0.7, 0.003
"""Share of the task's risk limit that is not punished, and what a risk beyond that counts, for each
of its limit [units of similarity]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Polished:
    """A better action."""

    action: Array
    """[A] in SI units."""
    expected: float
    """Root of what is minimised [goal's unit]."""
    before: float
    """That of the action polishing began with."""
    rollouts: int
    seconds: float


@dataclass(eq=False)
class _Point:
    """An action and an object z, residuals and their derivatives, in units of similarity."""

    z: Array
    r: Array
    J: Array

    @property
    def cost(self) -> float:
        return float(self.r @ self.r)


class PolishingProblem:
    """What is minimised over z [A + P]: an action in units of similarity and, where the goal tells
    of the object, its P unknowns' distance from the most likely ones in standard deviations."""

    def __init__(self, task: Task, goal: Array, belief: Estimate, discrepancy: Discrepancy | None):
        self.task, self.goal, self.discrepancy = task, goal, discrepancy
        self.belief, self.item = belief, belief.most_likely
        self.units = task.action_units(self.item)
        self.goal_units = task.goal_units(self.item)
        self.goal_unit = float(self.goal_units[0])
        A, P = len(self.units), len(belief.mean) if len(task.goals) > len(task.actions) else 0
        self.spread = np.linalg.cholesky(belief.covariance) if P else np.zeros((0, 0))
        low, high = task.limits(self.item).T / self.units
        self.low = np.r_[low, np.full(P, -DEVIATIONS)]
        self.high = np.r_[high, np.full(P, DEVIATIONS)]
        self.step = np.r_[np.full(A, STEP), np.full(P, OBJECT_STEP)]
        self.rollouts = 0

    def start(self, action: Array) -> Array:
        """[A + P] an action [SI] with the most likely object."""
        return np.r_[action / self.units, np.zeros(len(self.spread))]

    def action(self, z: Array) -> Array:
        """[A] in SI units."""
        return z[: len(self.units)] * self.units

    def nearest(self, z: Array) -> Array:
        """[A + P] with the nearest action that is allowed."""
        A = len(self.units)
        return np.r_[self.task.nearest(self.item, self.action(z)) / self.units, z[A:]]

    def residuals(self, points: Sequence[Array]) -> Asking[list[Array]]:
        """Of each z [G or 1, 1 for the risk, 1 for the discrepancy's deviation, P]; infinite where
        a simulation failed."""
        v = [z[len(self.units) :] for z in points]
        items = [
            self.belief.at(self.belief.mean + self.spread @ d) if len(d) else self.item for d in v
        ]
        # objects of one size may differ in what they allow
        rows = [self.task.nearest(i, self.action(z)) for i, z in zip(items, points, strict=True)]
        outcomes = yield items, rows
        self.rollouts += len(items)
        made = zip(rows, items, outcomes, v, strict=True)
        return [np.r_[self._residual(a, item, o), SIMULATOR_ERROR * d] for a, item, o, d in made]

    def _residual(self, action: Array, item: Item, outcome: Outcome) -> Array:
        task, values = self.task, outcome.values
        if outcome.fault is not None:
            return np.full(len(task.goals) + 2, np.inf)
        wrong, deviation = np.zeros(len(self.goal)), 0.0
        if self.discrepancy is not None:
            wrong, deviation = self.discrepancy(action)
        miss = np.array([values[q.name] for q in task.goals]) + wrong - self.goal
        caution = 0.0
        if task.risk is not None:
            share = values[task.risk.name] / (task.risk.limit * unit_of(task.risk.unit, item))
            caution = RISK_WEIGHT * max(0.0, share - RISK_MARGIN)
        return np.r_[miss / self.goal_units, caution, deviation / self.goal_unit]

    def point(self, z: Array) -> Asking[_Point]:
        """With residuals and derivatives, simulated side by side."""
        allowed = np.array([self.nearest(one) for one in stencil(z, self.step)])
        r = np.array((yield from self.residuals(list(allowed))))
        return _Point(z=allowed[0], r=r[0], J=central_differences(allowed, r))


def polish(
    task: Task,
    goal: ArrayLike,
    belief: Estimate,
    start: ArrayLike,
    *,
    world: World | None = None,
    **how: Any,
) -> Polished:
    """The action whose miss is smallest in a world (default: our simulator); other arguments and
    errors as of `polishing`."""
    search = polishing(task, goal, belief, start, **how)
    return side_by_side(task, world or Simulation(), [search])[0]


def polishing(
    task: Task,
    goal: ArrayLike,
    belief: Estimate,
    start: ArrayLike,
    *,
    seconds: float = 10.0,
    discrepancy: Discrepancy | None = None,
) -> Asking[Polished]:
    """`polish` as a search that asks for rollouts, for many at once (`side_by_side`).

    Args:
        task: What is done.
        goal: [G] in SI units.
        belief: The object, as `gendom.policies.belief.believed` gives it, or `Estimate.of` one.
        start: [A] where to begin, such as a policy's action, in SI units.
        seconds: Wall time after which the best so far is taken [s].
        discrepancy: Of the simulator, as learnt from executions.

    Raises:
        ParameterError: An argument has the wrong shape, the start is out of its limits, or the task
            has no goals: a share that is enough or not has no derivative.
        SimulationError: The start cannot be simulated.
    """
    began = time.monotonic()
    require(task.goals, f"{task.name} has no goal by which actions can be polished")
    wanted = np.atleast_1d(np.asarray(goal, dtype=float))
    fits = wanted.shape == (len(task.goals),) and np.isfinite(wanted).all()
    require(fits, f"is {wanted.tolist()}", where="goal")
    require(seconds > 0.0, f"must be positive, got {seconds}", where="seconds")
    problem = PolishingProblem(task, wanted, belief, discrepancy)
    first = problem.start(task.check_action(problem.item, start))
    start_point = yield from problem.point(first)
    what = f"no action of {task.name} can be simulated with this {task.kind}"
    fix = "check the object's numbers"
    require(start_point.cost < np.inf, what, fix=fix, error=SimulationError)
    best = yield from _improved(problem, start_point, began + seconds)
    return Polished(
        action=task.check_action(problem.item, problem.action(best.z)),
        expected=float(np.sqrt(best.cost)) * problem.goal_unit,
        before=float(np.sqrt(start_point.cost)) * problem.goal_unit,
        rollouts=problem.rollouts,
        seconds=time.monotonic() - began,
    )


def _improved(problem: PolishingProblem, best: _Point, deadline: float) -> Asking[_Point]:
    """What damped Gauss-Newton steps lead to until a time [s]."""
    damping, round_seconds = 1e-3, 0.0
    for _ in range(MAX_ITERATIONS):
        starts = time.monotonic()
        if deadline - starts < round_seconds:
            break
        H = best.J.T @ best.J
        D = np.maximum(np.diag(H), 1e-6 * max(float(np.trace(H)), 1e-12))
        H = H + damping * np.diag(D) + 1e-15 * np.eye(len(H))
        new = yield from problem.point(best.z + np.linalg.solve(H, -best.J.T @ best.r))
        round_seconds = time.monotonic() - starts
        better = new.cost < best.cost
        gained = 1.0 - new.cost / best.cost if better else 1.0
        best = new if better else best
        damping = max(0.1 * damping, 1e-6) if better else max(10.0 * damping, 1e-2)
        if best.cost < TOLERANCE**2 or gained < LEAST_GAIN or damping > 1e4:
            break
    return best
