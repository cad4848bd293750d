"""Cases of a task: objects, each with a goal that it can reach.

Parameters and an action are drawn as for a demonstration and simulated, and the outcome is the goal
(hindsight). Where a task has a risk, outcomes beyond its limit are not taken as goals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import SimulationError
from gendom.materials import Item
from gendom.tasks.task import Task, World
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
        rngs = [np.random.default_rng([seed, int(i), attempt, _STREAM]) for i in waiting]
        drawn = [items[int(i) % len(items)] for i in waiting] if items else task.draw_items(rngs)
        for i, item in zip(waiting.tolist(), drawn, strict=True):
            kept[i] = item
        if not task.goals:
            break
        outcomes = simulation.carry_out(task, drawn, task.draw_actions(drawn, rngs))
        again = []
        for i, outcome in zip(waiting, outcomes, strict=True):
            if outcome.fault is None and task.within_risk(kept[i], outcome.values):
                goal[i] = [outcome.values[q.name] for q in task.goals]
            else:
                again.append(i)
        waiting = np.array(again, dtype=int)
        if not again:
            break
    else:
        what = f"{len(waiting)} of {count} cases failed {_ROUNDS} times"
        raise SimulationError(what, fix="choose other ranges")
    return Cases(task=task, items=tuple(kept), goal=goal)
