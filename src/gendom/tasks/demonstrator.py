"""Demonstrations of a task: drawn objects and actions in, what was reached out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from gendom.datasets.demonstrations import GOAL, Outcomes
from gendom.materials import from_columns, to_columns
from gendom.tasks.task import Task
from gendom.tasks.world import Simulation


@dataclass(frozen=True, kw_only=True)
class Demonstrator:
    """Draws demonstrations of a task and simulates them, see `gendom.datasets.generate`."""

    task: Task
    simulation: Simulation = field(default_factory=Simulation)

    def about(self) -> dict[str, Any]:
        """What all demonstrations have in common, ready for JSON."""
        task, how = self.task, asdict(self.simulation)
        for name in ("device", "threads", "everything"):  # change nothing, or rounding only
            del how[name]
        return {
            "task": {"name": task.name, **task.settings()},
            "kind": task.kind,
            "action_names": [q.name for q in task.actions],
            "action_units": [q.unit for q in task.actions],
            "goal_names": [q.name for q in task.goals],
            "goal_units": [q.unit for q in task.goals],
            "simulation": how,
        }

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """One demonstration's object and action, by column name, in SI units."""
        item = self.task.draw_item(rng)
        action = self.task.sample_actions(item, rng, 1)[0]
        names = [q.name for q in self.task.actions]
        return {**to_columns(item), **dict(zip(names, map(float, action), strict=True))}

    def demonstrate(
        self,
        draws: Sequence[Mapping[str, float]],
        *,
        device: str,
        on_frame: Callable[[int], None] | None = None,
    ) -> Outcomes:
        """Simulate draws side by side; one that diverges is recorded as failed, others go on.

        Returns:
            Columns of the goals (`goal_` and the name), of whatever else the task's outcome has,
            and of its actions where the task searched for them.

        Raises:
            DeviceError: The device is not there.
        """
        task = self.task
        items = [from_columns(task.kind, draw) for draw in draws]
        drawn = np.array([[draw[q.name] for q in task.actions] for draw in draws])
        world = replace(self.simulation, device=device)
        actions, outcomes = task.demonstrate(world, items, drawn, on_frame=on_frame)
        goals = [q.name for q in task.goals]
        done = [o.values for o in outcomes if o.fault is None]
        names = list(done[0]) if done else goals
        columns = {
            GOAL + name if name in goals else name: np.array(
                [o.values.get(name, np.nan) for o in outcomes]
            )
            for name in names
        }
        if actions is not drawn:
            columns |= {q.name: actions[:, k] for k, q in enumerate(task.actions)}
        return Outcomes(columns=columns, faults=tuple(o.fault for o in outcomes))
