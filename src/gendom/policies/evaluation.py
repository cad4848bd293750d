"""How well policies reach their goals, measured in a world on equal cases.

In a case (`gendom.tasks.cases`) the policy gets the true parameters and chooses an action; it is
carried out with the same object, and the task's error is the result.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import PolicyError
from gendom.materials import Item, dimensionless_parameters, unit_of
from gendom.policies.policy import Policy
from gendom.tasks.cases import Cases
from gendom.tasks.task import World, numbers_of
from gendom.tasks.world import Simulation


@dataclass(frozen=True, kw_only=True)
class Score:
    """What a policy did in each of W cases."""

    reached: Array
    """[W, G] in SI units; NaN where it failed."""
    error: Array
    """[W] the task's; NaN where it failed."""
    size: Array
    """[W] reference of relative errors: the object's size [m] where goals are lengths, else 1."""

    def summary(self) -> dict[str, Any]:
        """Figures ready for JSON: errors in the goal's unit and as shares of the size.

        Cases that failed are counted in `failed` and in no other figure; if all failed, the errors
        are None. `enough_share` is the share of all cases in which a task without goals misses
        nothing.
        """
        done = np.isfinite(self.error)
        enough = float(np.mean(self.error <= 0.0))
        return {
            **({} if self.reached.shape[1] else {"enough_share": enough}),
            "cases": len(self.error),
            "failed": int((~done).sum()),
            "error": _figures(self.error[done]),
            "error_over_size": _figures(self.error[done] / self.size[done]),
        }


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
    return judge(cases, choose(policy, cases), world=world, on_frame=on_frame)


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
    """Outcomes of actions [W, A] in all cases."""
    task = cases.task
    outcomes = (world or Simulation()).carry_out(task, cases.items, action, on_frame=on_frame)
    done = zip(cases.items, cases.goal, outcomes, strict=True)
    error = [np.nan if o.fault else task.error(item, goal, o.values) for item, goal, o in done]
    return Score(
        reached=numbers_of(outcomes, task.goals),
        error=np.array(error),
        size=np.array([unit_of(task.goals[0].unit, i) if task.goals else 1.0 for i in cases.items]),
    )


def _figures(error: Array) -> dict[str, float | None]:
    names = ("mean", "std", "median", "p95", "max")
    if not len(error):
        return dict.fromkeys(names)
    found = (error.mean(), error.std(), np.median(error), np.quantile(error, 0.95), error.max())
    return dict(zip(names, map(float, found), strict=True))
