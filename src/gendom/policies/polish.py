"""Actions polished through the simulator at acting time.

The miss of an action is simulated for objects that are plausible, and its mean square over them is
brought down by damped Gauss-Newton steps (Levenberg 1944, Marquardt 1963):

    min over a of  sum_k |f(a, object_k) + b(a) - g|^2 / K  +  sum_k caution(risk_k)^2 / K,

where f is what the simulator says is reached and b what executions have shown it to be wrong by
(`gendom.policies.adapt`). Actions whose outcome hardly depends on what is uncertain win. An action
has one to three numbers, so its derivatives are central differences of worlds side by side.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.errors import ParameterError, SimulationError
from gendom.materials import Item, unit_of
from gendom.tasks import Task
from gendom.tasks.world import Simulation, World

Array = NDArray[np.float64]

Offset = Callable[[Array], Array]
"""From an action [A] to what the simulator is wrong by there [G], in SI units."""


@dataclass(frozen=True, kw_only=True)
class PolishSettings:
    """How long and how far to look.

    Raises:
        ParameterError: A number is out of range.
    """

    seconds: float = 10.0
    """Wall time after which the best so far is taken [s]."""
    candidates: int = 48
    """Actions looked at beside the policy's, drawn from all that the task allows."""
    kept: int = 3
    """Of these, how many are polished."""
    iterations: int = 6
    """Steps of each, at most."""
    step: float = 0.002
    """Of central differences [units of similarity]."""
    enough: float = 1e-4
    """Root mean square of the miss at which polishing ends [units of similarity]."""
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
        if self.candidates < 0 or self.kept < 1 or self.iterations < 0 or self.seed < 0:
            raise ParameterError(
                "candidates, iterations and seed must be at least 0, kept at least 1"
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
    world: World
    settings: PolishSettings
    offset: Offset | None
    rollouts: int = 0
    units: Array = field(init=False)
    goal_units: Array = field(init=False)

    def __post_init__(self) -> None:
        first = self.items[0]
        self.units = self.task.action_units(first)
        self.goal_units = self.task.goal_units(first)

    def residuals(self, actions: Sequence[Array]) -> list[Array]:
        """Of each action in units of similarity: [K (G or 1, and 1 for the risk)], weighted so
        that their square is the mean over the K objects; infinite where a simulation failed."""
        task, K = self.task, len(self.items)
        items = [item for _ in actions for item in self.items]
        rows = np.repeat(np.array(actions) * self.units, K, axis=0)
        # differences may look a little beyond the limits
        rows = np.array([task.nearest(i, a) for i, a in zip(items, rows, strict=True)])
        outcomes = self.world.carry_out(task, items, rows)
        self.rollouts += len(items)
        found = []
        for n, action in enumerate(actions):
            wrong = 0.0 if self.offset is None else self.offset(action * self.units)
            parts = []
            for item, outcome in zip(self.items, outcomes[n * K : (n + 1) * K], strict=True):
                if outcome.fault is not None:
                    parts.append(np.full(len(self.goal) + 1, np.inf))
                    continue
                values = outcome.values
                if task.goals:
                    reached = np.array([values[q.name] for q in task.goals]) + wrong
                    miss = (reached - self.goal) / self.goal_units
                else:
                    miss = np.array([task.error(item, self.goal, values)])
                parts.append(np.append(miss, self._caution(item, values)))
            found.append(np.concatenate(parts) / np.sqrt(K))
        return found

    def _caution(self, item: Item, values: dict[str, float]) -> float:
        risk = self.task.risk
        if risk is None:
            return 0.0
        share = values[risk.name] / (risk.limit * unit_of(risk.unit, item))
        return self.settings.caution * max(0.0, share - self.settings.margin)

    def points(self, actions: Sequence[Array]) -> list[_Point]:
        """Actions with residuals and derivatives, all simulated side by side."""
        h, A = self.settings.step, len(self.units)
        ends = []
        for a in actions:
            ends += [a] + [a + sign * h * e for e in np.eye(A) for sign in (1.0, -1.0)]
        allowed = [self._allowed(a) for a in ends]
        r = self.residuals(allowed)
        found = []
        for n in range(len(actions)):
            at = n * (2 * A + 1)
            J = np.zeros((len(r[at]), A))
            for k in range(A):
                plus, minus = at + 1 + 2 * k, at + 2 + 2 * k
                width = allowed[plus][k] - allowed[minus][k]
                if width > 0.0:
                    J[:, k] = (r[plus] - r[minus]) / width
            J[~np.isfinite(J)] = 0.0
            found.append(_Point(a=allowed[at], r=r[at], J=J))
        return found

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
    offset: Offset | None = None,
) -> Polished:
    """The action whose miss is smallest over objects that are plausible.

    Args:
        task: What is done.
        goal: [G] in SI units.
        items: K objects of one size: one that is known, or draws of a `Belief`.
        start: [A] where to begin, such as a policy's action, in SI units.
        world: Where it is simulated (default: our simulator).
        settings: How long and how far to look.
        offset: What is added to what the simulator says is reached.

    Raises:
        ParameterError: Numbers do not agree, or the start is not allowed.
        SimulationError: No action could be simulated.
    """
    began = time.monotonic()
    settings = settings or PolishSettings()
    wanted = np.atleast_1d(np.asarray(goal, dtype=float)) if task.goals else np.empty(0)
    if wanted.shape != (len(task.goals),) or not np.isfinite(wanted).all():
        raise ParameterError(f"is {wanted.tolist()}", where="goal")
    if not items:
        raise ParameterError("no object to polish for", fix="give one or more")
    problem = _Problem(
        task=task,
        goal=wanted,
        items=items,
        world=world or Simulation(),
        settings=settings,
        offset=offset,
    )
    first = task.check_action(items[0], start) / problem.units
    rng = np.random.default_rng(settings.seed)
    others = task.sample_actions(items[0], rng, settings.candidates) / problem.units
    tried = [first, *others]
    costs = np.array([float(r @ r) for r in problem.residuals(tried)])
    if not np.isfinite(costs).any():
        raise SimulationError(
            f"no action of {task.name} can be simulated with this {task.kind}",
            fix="check the object's numbers",
        )
    before = costs[0]
    # the start has first call: another must be clearly better
    order = [0, *(1 + np.argsort(costs[1:], kind="stable")[: settings.kept - 1])]
    if not np.isfinite(before):
        order = list(np.argsort(costs, kind="stable")[: settings.kept])
    points = problem.points([tried[k] for k in order])
    if not task.goals:  # differences of a share that is met or not tell no direction
        points = [_Point(a=tried[k], r=np.array([np.sqrt(costs[k])]), J=np.zeros((1, 1)), done=True)
                  for k in [int(np.argmin(costs))]]  # fmt: skip
    a_round = (time.monotonic() - began) / (len(tried) / (len(points) * (2 * len(first) + 1)))
    for _ in range(settings.iterations):
        going = [k for k, p in enumerate(points) if not p.done]
        left = settings.seconds - (time.monotonic() - began)
        if not going or left < a_round:
            break
        starts = time.monotonic()
        steps = [_step(points[k]) for k in going]
        new = problem.points([points[k].a + s for k, s in zip(going, steps, strict=True)])
        for k, found in zip(going, new, strict=True):
            points[k] = _better(points[k], found, settings)
        a_round = time.monotonic() - starts
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
    new.done = new.cost < settings.enough**2 or gained < 1e-3
    return new
