"""Demonstrations of a task: drawn objects and actions in, what was reached out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gendom.arrays import Array
from gendom.datasets.demonstrations import GOAL, Outcomes
from gendom.materials import Item, items_from_columns, to_columns
from gendom.tasks.cases import Cases, draw_cases
from gendom.tasks.task import Task, World, numbers_of
from gendom.tasks.world import Simulation

ACTION_NOISE = 0.03
"""Standard deviation of what demonstrations differ by from actions that were chosen [units of
similarity]."""


@dataclass(frozen=True, kw_only=True)
class Demonstrator:
    """Draws demonstrations of a task and carries them out, see `gendom.datasets.generate`."""

    task: Task
    world: World = field(default_factory=lambda: Simulation(interleaved=True))
    items: tuple[Item, ...] = ()
    """Objects to draw from in place of the task's own."""
    acts: Callable[[Cases], Array] | None = None
    """Chooses an action [1, A] for a goal that the object reaches, as one would in a laboratory:
    what is done differs from it by `ACTION_NOISE`. None: actions are random."""

    @property
    def cost(self) -> float:
        """As that of the task."""
        return self.task.cost

    def about(self) -> dict[str, Any]:
        """What all demonstrations have in common, ready for JSON."""
        task = self.task
        objects = {"objects": [to_columns(i) for i in self.items]} if self.items else {}
        return {
            "task": {"name": task.name, **task.settings()},
            "kind": task.kind,
            "action_names": [q.name for q in task.actions],
            "action_units": [q.unit for q in task.actions],
            "goal_names": [q.name for q in task.goals],
            "goal_units": [q.unit for q in task.goals],
            "simulation": self.world.settings(),
            **({} if self.acts is None else {"action_noise": ACTION_NOISE}),
            **objects,
        }

    def draw(self, rngs: Sequence[np.random.Generator]) -> dict[str, Array]:
        """Objects and actions of W demonstrations, by column name [W], in SI units."""
        task = self.task
        if self.items:
            items = [self.items[rng.integers(len(self.items))] for rng in rngs]
            rows = [to_columns(item) for item in items]
            columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        else:
            columns = task.draw_columns(rngs)
            items = items_from_columns(task.kind, columns, like=task.item)
        acts = task.draw_actions if self.acts is None else self._acted
        actions = acts(items, rngs)
        return {**columns, **{q.name: actions[:, k] for k, q in enumerate(task.actions)}}

    def _acted(self, items: Sequence[Item], rngs: Sequence[np.random.Generator]) -> Array:
        """[W, A] what is chosen for goals, with some noise."""
        task, rows = self.task, []
        assert self.acts is not None
        for item, rng in zip(items, rngs, strict=True):
            case = draw_cases(task, 1, seed=int(rng.integers(2**31)), items=[item])
            noise = ACTION_NOISE * task.action_units(item) * rng.normal(size=len(task.actions))
            rows.append(task.nearest(item, self.acts(case)[0] + noise))
        return np.array(rows)

    def demonstrate(
        self,
        draws: Mapping[str, Array],
        *,
        device: str,
        on_frame: Callable[[int], None] | None = None,
    ) -> Outcomes:
        """Simulate draws side by side; one that diverges is recorded as failed, others go on.

        Returns:
            Columns of the goals (`goal_` and the name) and of the outcome's other numbers.

        Raises:
            DeviceError: The device is not there.
        """
        task = self.task
        items = items_from_columns(task.kind, draws)
        drawn = np.stack([draws[q.name] for q in task.actions], axis=1)
        outcomes = self.world.on(device).carry_out(task, items, drawn, on_frame=on_frame)
        every = (*task.goals, *task.outcomes)
        names = [GOAL + q.name if q in task.goals else q.name for q in every]
        columns = dict(zip(names, numbers_of(outcomes, every).T, strict=True))
        return Outcomes(columns=columns, faults=tuple(o.fault for o in outcomes))
