"""How well policies reach their goals, measured in a world on equal cases.

A case is an object and a goal that this object can reach: its parameters and an action are
drawn as for a demonstration and simulated, and its outcome is the goal (hindsight). The policy gets
the true parameters and chooses an action; it is carried out with the same object, and the task's
error is the result. Where a task has a risk, outcomes beyond its limit are not taken as goals.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import PolicyError, SimulationError
from gendom.materials import Item, dimensionless_parameters, unit_of
from gendom.policies.policy import Policy
from gendom.tasks import Task
from gendom.tasks.task import World
from gendom.tasks.world import Simulation

_ROUNDS = 100
"""How often a case whose simulation fails, or that is at risk, is drawn again."""

_STREAM = 1
"""Part of the seed: makes these draws independent of demonstrations with the same seed."""


@dataclass(frozen=True, kw_only=True)
class Cases:
    """W objects, each with a goal that it can reach."""

    task: Task
    items: tuple[Item, ...]
    goal: Array
    """[W, G] in SI units."""

    def __len__(self) -> int:
        return len(self.items)


@dataclass(frozen=True, kw_only=True)
class Score:
    """What a policy did in each of W cases."""

    reached: Array
    """[W, G] in SI units; NaN where it failed."""
    error: Array
    """[W] the task's; NaN where it failed."""
    size: Array
    """[W] reference of relative errors: the object's size [m] where goals are lengths, else 1."""
    outside: NDArray[np.bool_]
    """[W] whether `Policy.act` would refuse the goal as outside the training range."""

    def summary(self) -> dict[str, Any]:
        """Figures ready for JSON: errors in the goal's unit and as shares of the size.

        Cases that failed are counted in `failed` and in no other figure; if all failed, the errors
        are None. Goals outside the policy's range count like all others. `enough_share` is the
        share of all cases in which a task without goals misses nothing.
        """
        done = np.isfinite(self.error)
        enough = (
            {} if self.reached.shape[1] else {"enough_share": float(np.mean(self.error <= 0.0))}
        )
        return {
            **enough,
            "cases": len(self.error),
            "failed": int((~done).sum()),
            "outside_range": int(self.outside.sum()),
            "error": _figures(self.error[done]),
            "error_over_size": _figures(self.error[done] / self.size[done]),
        }


def draw_cases(
    task: Task,
    count: int,
    *,
    seed: int,
    simulation: World | None = None,
    items: Sequence[Item] | None = None,
) -> Cases:
    """Draw objects and goals.

    Case i depends on the seed and i alone. A draw whose simulation fails is replaced.

    Args:
        task: What is done; its `ranges` are those of the objects.
        count: Number of cases.
        seed: Seed of all draws, 0 or more.
        simulation: Where goals are found (default: our simulator).
        items: Objects to take by turns in place of drawn ones.

    Raises:
        ParameterError: A number or range is out of bounds.
        SimulationError: Draws keep failing.
    """
    fix = "give 1 case or more and a seed of 0 or more"
    require(count >= 1 and seed >= 0, f"{count} cases with seed {seed}", fix=fix)
    simulation = simulation or Simulation()
    kept: list[Item] = [task.item] * count
    goal = np.full((count, len(task.goals)), np.nan)
    waiting = np.arange(count)
    for attempt in range(_ROUNDS):
        actions = np.empty((len(waiting), len(task.actions)))
        for k, i in enumerate(map(int, waiting)):
            rng = np.random.default_rng([seed, i, attempt, _STREAM])
            kept[i] = items[i % len(items)] if items else task.draw_item(rng)
            actions[k] = task.sample_actions(kept[i], rng, 1)[0]
        if not task.goals:
            return Cases(task=task, items=tuple(kept), goal=goal)
        outcomes = simulation.carry_out(task, [kept[i] for i in waiting], actions)
        again = []
        for i, outcome in zip(waiting, outcomes, strict=True):
            if outcome.fault is None and task.within_risk(kept[i], outcome.values):
                goal[i] = [outcome.values[q.name] for q in task.goals]
            else:
                again.append(i)
        waiting = np.array(again, dtype=int)
        if not len(waiting):
            return Cases(task=task, items=tuple(kept), goal=goal)
    what = f"{len(waiting)} of {count} cases failed {_ROUNDS} times"
    raise SimulationError(what, fix="choose other ranges")


def score(
    policy: Policy,
    cases: Cases,
    *,
    world: World | None = None,
    on_frame: Callable[[int], None] | None = None,
) -> Score:
    """Let a policy act in all cases, and measure the outcomes.

    Args:
        policy: Who acts.
        cases: Objects and goals.
        world: Where (default: our simulator).
        on_frame: As in `World.carry_out`.

    Raises:
        PolicyError: The policy is for another task.
    """
    found = judge(cases, choose(policy, cases), world=world, on_frame=on_frame)
    ends = np.array([policy.goal_range(item) for item in cases.items]).reshape(len(cases), -1, 2)
    outside = (cases.goal < ends[..., 0]) | (cases.goal > ends[..., 1])
    return replace(found, outside=outside.any(axis=1))


def choose(policy: Policy, cases: Cases, *, known: Sequence[Item] | None = None) -> Array:
    """[W, A] a policy's actions, moved into the task's limits.

    Args:
        policy: Who acts.
        cases: Objects and goals.
        known: W objects as the policy knows them (default: as they are).

    Raises:
        PolicyError: The policy is for another task.
    """
    task, own = cases.task, policy.task()
    what, fix = f"is for {own.name}, the cases are for {task.name}", f"use a policy for {task.name}"
    require(own.name == task.name, what, where=policy.where, fix=fix, error=PolicyError)
    alike = [dimensionless_parameters(item) for item in (known or cases.items)]
    given = {name: np.array([a[name] for a in alike]) for name in alike[0]}
    units = np.array([task.action_units(item) for item in cases.items])
    goal_units = np.array([task.goal_units(item) for item in cases.items])
    asked = policy.actions(cases.goal / goal_units, given) * units
    middle = np.array([column.mean for column in policy.description.outputs])
    moved = zip(cases.items, asked, units, strict=True)
    return np.array([task.nearest(item, a, middle * u) for item, a, u in moved])


def judge(
    cases: Cases,
    action: Array,
    *,
    world: World | None = None,
    on_frame: Callable[[int], None] | None = None,
) -> Score:
    """Outcomes of actions [W, A] in all cases; no goal counts as outside a range."""
    task = cases.task
    outcomes = (world or Simulation()).carry_out(task, cases.items, action, on_frame=on_frame)
    reached = np.full(cases.goal.shape, np.nan)
    error = np.full(len(cases), np.nan)
    for w, (item, outcome) in enumerate(zip(cases.items, outcomes, strict=True)):
        if outcome.fault is None:
            reached[w] = [outcome.values[q.name] for q in task.goals]
            error[w] = task.error(item, cases.goal[w], outcome.values)
    return Score(
        reached=reached,
        error=error,
        size=np.array([unit_of(task.goals[0].unit, i) if task.goals else 1.0 for i in cases.items]),
        outside=np.zeros(len(cases), dtype=bool),
    )


def _figures(error: Array) -> dict[str, float | None]:
    names = ("mean", "std", "median", "p95", "max")
    if not len(error):
        return dict.fromkeys(names)
    found = (error.mean(), error.std(), np.median(error), np.quantile(error, 0.95), error.max())
    return dict(zip(names, map(float, found), strict=True))
