"""What a policy learns from, free of the object's size."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.arrays import Array
from gendom.datasets.demonstrations import GOAL, load, read_description, succeeded
from gendom.errors import DatasetError
from gendom.materials import KINDS, PARAMETERS, dimensionless_columns, unit_of_size
from gendom.tasks import rebuild

SMALLEST = 20
"""Fewer demonstrations than this cannot be split and standardised sensibly."""


@dataclass(frozen=True, kw_only=True)
class Demonstrations:
    """Actions, the objects they were done to, and what they reached.

    Raises:
        DatasetError: Fewer than `SMALLEST` demonstrations, or numbers that are not finite.
    """

    task: dict[str, Any]
    """`name` and settings of the task."""
    action_names: tuple[str, ...]
    goal_names: tuple[str, ...]
    goal: Array
    """[N, G] what was reached [units of similarity, see `unit_of`]."""
    action: Array
    """[N, A] what was done [the same]."""
    parameters: Mapping[str, Array]
    """[N] each of `PARAMETERS` [-], see `dimensionless_parameters`."""
    risk: Array | None = None
    """[N] the task's `risk`, if it has one [units of similarity]."""
    failed: int = 0
    """How many more of the set could not be simulated."""
    where: str | None = None
    """The folder they were read from."""

    def __post_init__(self) -> None:
        what = f"holds {len(self)} usable demonstrations, training needs {SMALLEST} or more"
        fix = "simulate more with gendom dataset"
        require(len(self) >= SMALLEST, what, where=self.where, fix=fix, error=DatasetError)
        for name, values in {"goal": self.goal, "action": self.action, **self.parameters}.items():
            what, finite = f"{name} holds numbers that are not finite", np.isfinite(values).all()
            fix = "simulate the demonstrations again"
            require(finite, what, where=self.where, fix=fix, error=DatasetError)

    def __len__(self) -> int:
        return len(self.action)

    @property
    def varying(self) -> tuple[str, ...]:
        """Parameters that differ between demonstrations."""
        return tuple(n for n in PARAMETERS if np.ptp(self.parameters[n]) > 0.0)

    def first(self, count: int) -> Demonstrations:
        """The first `count` of them."""
        return self.chosen(np.arange(min(count, len(self))))

    def chosen(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Demonstrations:
        """Some of them."""
        return replace(
            self,
            goal=self.goal[rows],
            action=self.action[rows],
            parameters={name: values[rows] for name, values in self.parameters.items()},
            risk=None if self.risk is None else self.risk[rows],
        )

    @classmethod
    def read(cls, folder: str | os.PathLike) -> Demonstrations:
        """Demonstrations from a folder that `gendom dataset` wrote, as far as it is finished.

        Those whose simulation failed are left out.

        Raises:
            DatasetError: The folder holds no set, or one that no policy can be trained on.
        """
        where = str(folder)
        about = read_description(folder)
        task = rebuild(about["task"])
        kind = task.kind
        actions, goals = (tuple(q.name for q in own) for own in (task.actions, task.goals))
        said = tuple(about.get("action_names", ())), tuple(about.get("goal_names", ()))
        what, fix = f"holds no actions and goals of {task.name}", "make it again"
        require((actions, goals) == said, what, where=where, fix=fix, error=DatasetError)
        table = load(folder, part=True)
        risk = [task.risk.name] if task.risk else []
        sizes = KINDS[kind].sizes
        objects = ("E", "nu", "density", "damping", "friction", *sizes)
        names = (*(GOAL + name for name in goals), *actions, *objects, *risk)
        column = succeeded(table, names, where=where)
        size = column[sizes[0]]

        def alike(columns: tuple[str, ...], units: list[str]) -> Array:
            found = [column[c] / unit_of_size(u, size) for c, u in zip(columns, units, strict=True)]
            return np.stack(found, axis=1) if found else np.empty((len(size), 0))

        return cls(
            task=dict(about["task"]),
            action_names=actions,
            goal_names=goals,
            goal=alike(tuple(GOAL + name for name in goals), [q.unit for q in task.goals]),
            action=alike(actions, [q.unit for q in task.actions]),
            parameters=dimensionless_columns(kind, {name: column[name] for name in objects}),
            risk=alike(tuple(risk), [task.risk.unit])[:, 0] if task.risk else None,
            failed=len(table) - len(size),
            where=where,
        )


def joined(first: Demonstrations, second: Demonstrations) -> Demonstrations:
    """Both, one after the other; of the first's task."""

    def both(a: Any, b: Any) -> Any:
        return None if a is None or b is None else np.concatenate([a, b])

    return replace(
        first,
        goal=both(first.goal, second.goal),
        action=both(first.action, second.action),
        parameters={n: both(a, second.parameters[n]) for n, a in first.parameters.items()},
        risk=both(first.risk, second.risk),
    )
