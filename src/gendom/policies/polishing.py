"""Actions polished through the simulator at acting time.

The miss of an action is simulated for plausible objects, and its mean square over them is reduced
by damped Gauss-Newton steps (Levenberg 1944, Marquardt 1963):

    min over a of  sum_k |f(a, object_k) + b(a) - g|^2 / K + sum_k caution(risk_k)^2 / K + s(a)^2,

where f is the simulated result, b the simulator's error as learnt from executions, and s the
standard deviation of b (`gendom.policies.adaptation`). Actions whose outcome depends little on what
is uncertain win. An action has one to three numbers, so its derivatives are central differences of
worlds in one batch.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.errors import ParameterError, SimulationError
from gendom.materials import Item, unit_of
from gendom.policies.rollouts import Asking, Rollouts, around, side_by_side, slopes
from gendom.tasks import Task
from gendom.tasks.task import Outcome, World
from gendom.tasks.world import Simulation

Array = NDArray[np.float64]


class Discrepancy(Protocol):
    """The simulator's error, learnt from executions."""

    def __call__(self, action: Array) -> tuple[Array, float]:
        """Mean [G] and standard deviation of it at an action [A], in SI units."""
        ...


@dataclass(frozen=True, kw_only=True)
class PolishSettings:
    """Limits of the search.

    Raises:
        ParameterError: A number is out of range.
    """

    seconds: float = 10.0
    """Wall time after which the best so far is taken [s]."""
    candidates: int = 48
    """Actions looked at beside the policy's, drawn from all that the task allows."""
    screened: int = 2
    """Objects that these are looked at with."""
    kept: int = 3
    """Of these, how many are polished, the policy's among them."""
    iterations: int = 6
    """Steps of each, at most."""
    step: float = 0.002
    """Of central differences [units of similarity]."""
    enough: float = 1e-4
    """Root mean square of the miss at which polishing ends [units of similarity]."""
    gain: float = 0.02
    """Share of the mean square below which a step gained too little for another."""
    margin: float = 0.7
    """Share of the task's risk limit that is not punished."""
    caution: float = 0.1
    """What a risk beyond that counts, for each of its limit [units of similarity]."""
    seed: int = 0
    """Of the candidates."""

    def __post_init__(self) -> None:
        for name in ("seconds", "step", "enough", "caution"):
            if not getattr(self, name) > 0.0:
                raise ParameterError(f"must be positive, got {getattr(self, name)}", where=name)
        if (
            self.candidates < 0
            or self.kept < 1
            or self.screened < 1
            or self.iterations < 0
            or self.seed < 0
        ):
            raise ParameterError(
                "candidates, iterations and seed must be at least 0, screened and kept at least 1"
            )


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


@dataclass(eq=False)
class _Problem:
    task: Task
    goal: Array
    items: Sequence[Item]
    settings: PolishSettings
    discrepancy: Discrepancy | None
    rollouts: int = 0
    units: Array = field(init=False)
    goal_units: Array = field(init=False)

    def __post_init__(self) -> None:
        first = self.items[0]
        self.units = self.task.action_units(first)
        self.goal_units = self.task.goal_units(first)

    def residuals(self, actions: Sequence[Array]) -> Asking[list[Array]]:
        """Of each action in units of similarity: [K (G or 1, and 1 for the risk) + 1 for the
        discrepancy's deviation], weighted so that their square is the mean over the K objects;
        infinite where a simulation failed."""
        K = len(self.items)
        items = [item for _ in actions for item in self.items]
        rows = np.repeat(np.array(actions) * self.units, K, axis=0)
        # objects of one size may differ in what they allow
        rows = [self.task.nearest(i, a) for i, a in zip(items, rows, strict=True)]
        outcomes = yield Rollouts(items=items, actions=rows)
        self.rollouts += len(items)
        unit = self.goal_units[0] if self.task.goals else 1.0
        found = []
        for n, action in enumerate(actions):
            wrong, deviation = np.zeros(len(self.goal)), 0.0
            if self.discrepancy is not None:
                wrong, deviation = self.discrepancy(action * self.units)
            parts = [
                self._residual(item, outcome, wrong)
                for item, outcome in zip(self.items, outcomes[n * K : (n + 1) * K], strict=True)
            ]
            parts.append(np.array([np.sqrt(K) * deviation / unit]))
            found.append(np.concatenate(parts) / np.sqrt(K))
        return found

    def _residual(self, item: Item, outcome: Outcome, wrong: Array) -> Array:
        """[G or 1, and 1 for the risk] of one object."""
        task, values = self.task, outcome.values
        if outcome.fault is not None:
            return np.full(max(len(task.goals), 1) + 1, np.inf)
        if task.goals:
            reached = np.array([values[q.name] for q in task.goals]) + wrong
            miss = (reached - self.goal) / self.goal_units
        else:
            miss = np.array([task.error(item, self.goal, values)])
        caution = 0.0
        if task.risk is not None:
            share = values[task.risk.name] / (task.risk.limit * unit_of(task.risk.unit, item))
            caution = self.settings.caution * max(0.0, share - self.settings.margin)
        return np.append(miss, caution)

    def points(self, actions: Sequence[Array]) -> Asking[list[_Point]]:
        """Actions with residuals and derivatives, all simulated side by side."""
        ends = around(np.array(actions), self.settings.step)
        allowed = np.array([[self._allowed(a) for a in of_one] for of_one in ends])
        flat = yield from self.residuals(list(allowed.reshape(-1, allowed.shape[-1])))
        r = np.array(flat).reshape(*allowed.shape[:2], -1)
        J = slopes(allowed, r)
        return [_Point(a=a[0], r=x[0], J=j) for a, x, j in zip(allowed, r, J, strict=True)]

    def _allowed(self, a: Array) -> Array:
        return self.task.nearest(self.items[0], a * self.units) / self.units


def polish(
    task: Task,
    goal: ArrayLike,
    items: Sequence[Item],
    start: ArrayLike,
    *,
    world: World | None = None,
    settings: PolishSettings | None = None,
    discrepancy: Discrepancy | None = None,
) -> Polished:
    """The action whose miss is smallest over objects that are plausible.

    Args:
        task: What is done.
        goal: [G] in SI units.
        items: K objects of one size: one that is known, or draws of an `Estimate`.
        start: [A] where to begin, such as a policy's action, in SI units.
        world: Where it is simulated (default: our simulator).
        settings: How long and how far to look.
        discrepancy: What is added to what the simulator says is reached.

    Raises:
        ParameterError: Numbers do not agree, or the start is not allowed.
        SimulationError: No action could be simulated.
    """
    search = polishing(task, goal, items, start, settings=settings, discrepancy=discrepancy)
    return side_by_side(task, world or Simulation(), [search])[0]


def polishing(
    task: Task,
    goal: ArrayLike,
    items: Sequence[Item],
    start: ArrayLike,
    *,
    settings: PolishSettings | None = None,
    discrepancy: Discrepancy | None = None,
) -> Asking[Polished]:
    """`polish` as a search that asks for rollouts, for many at once (`side_by_side`)."""
    began = time.monotonic()
    settings = settings or PolishSettings()
    wanted = np.atleast_1d(np.asarray(goal, dtype=float)) if task.goals else np.empty(0)
    if wanted.shape != (len(task.goals),) or not np.isfinite(wanted).all():
        raise ParameterError(f"is {wanted.tolist()}", where="goal")
    if not items:
        raise ParameterError("no object to polish for", fix="give one or more")
    problem = _Problem(
        task=task, goal=wanted, items=items, settings=settings, discrepancy=discrepancy
    )
    first = task.check_action(items[0], start) / problem.units
    rng = np.random.default_rng(settings.seed)
    others = task.sample_actions(items[0], rng, settings.candidates) / problem.units
    tried = [first, *others]
    few = replace(problem, items=items[: settings.screened])
    r = yield from few.residuals(tried)
    problem.rollouts = few.rollouts
    costs = np.array([float(x @ x) for x in r])
    if not np.isfinite(costs).any():
        raise SimulationError(
            f"no action of {task.name} can be simulated with this {task.kind}",
            fix="check the object's numbers",
        )
    order = [int(k) for k in np.argsort(costs, kind="stable")[: settings.kept]]
    # the start is polished too: the policy may know better than a few draws
    chosen = [tried[k] for k in [0, *(k for k in order if k)][: settings.kept]]
    if task.goals:
        points = yield from problem.points(chosen)
    else:  # a share that is met or not has no derivative
        r = yield from problem.residuals(chosen)
        flat = np.zeros((len(r[0]), len(first)))
        points = [_Point(a=a, r=x, J=flat, done=True) for a, x in zip(chosen, r, strict=True)]
    before = points[0].cost
    round_seconds = 0.0
    for _ in range(settings.iterations):
        going = [k for k, p in enumerate(points) if not p.done]
        left = settings.seconds - (time.monotonic() - began)
        if not going or left < round_seconds:
            break
        starts = time.monotonic()
        steps = [_step(points[k]) for k in going]
        new = yield from problem.points(
            [points[k].a + s for k, s in zip(going, steps, strict=True)]
        )
        for k, found in zip(going, new, strict=True):
            points[k] = _better(points[k], found, settings)
        round_seconds = time.monotonic() - starts
    best = min(points, key=lambda p: p.cost)
    unit = float(problem.goal_units[0]) if task.goals else 1.0
    return Polished(
        action=task.check_action(items[0], best.a * problem.units),
        expected=float(np.sqrt(best.cost)) * unit,
        before=float(np.sqrt(before)) * unit,
        rollouts=problem.rollouts,
        seconds=time.monotonic() - began,
    )


def _step(p: _Point) -> Array:
    H = p.J.T @ p.J
    D = np.maximum(np.diag(H), 1e-6 * max(float(np.trace(H)), 1e-12))
    damped = H + p.damping * np.diag(D) + 1e-15 * np.eye(len(H))
    return np.asarray(np.linalg.solve(damped, -p.J.T @ p.r), dtype=float)


def _better(old: _Point, new: _Point, settings: PolishSettings) -> _Point:
    """Whichever costs less, with the damping of its next step."""
    if not new.cost < old.cost:
        old.damping = max(10.0 * old.damping, 1e-2)
        old.done = old.damping > 1e4 or old.cost < settings.enough**2
        return old
    gained = (old.cost - new.cost) / old.cost
    new.damping = max(0.1 * old.damping, 1e-6)
    new.done = new.cost < settings.enough**2 or gained < settings.gain
    return new
