"""What a policy learns from, free of the rope's size."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.datasets.demonstrations import load, read_description
from gendom.errors import DatasetError

SMALLEST = 20
"""Fewer demonstrations than this cannot be split and standardised sensibly."""


@dataclass(frozen=True, kw_only=True)
class Demonstrations:
    """Actions, the objects they were done to, and what they reached.

    Raises:
        DatasetError: Fewer than `SMALLEST` demonstrations, or numbers that are not finite.
    """

    task: dict[str, Any]
    """`name` and settings of the task, among them length [m], diameter [m], gravity [m/s^2]."""
    action_names: tuple[str, ...]
    goal: NDArray[np.float64]
    """[N] what was reached [rope lengths]."""
    action: NDArray[np.float64]
    """[N, A] what was done [rope lengths]."""
    specific_modulus: NDArray[np.float64]
    """[N] E / density [m^2/s^2]."""
    poissons_ratio: NDArray[np.float64]
    """[N] [-]."""
    where: str | None = None
    """The folder they were read from."""

    def __post_init__(self) -> None:
        if len(self) < SMALLEST:
            raise DatasetError(
                f"holds {len(self)} usable demonstrations, training needs {SMALLEST} or more",
                where=self.where,
                fix="simulate more with gendom dataset",
            )
        for name in ("goal", "action", "specific_modulus", "poissons_ratio"):
            if not np.isfinite(getattr(self, name)).all():
                raise DatasetError(
                    f"{name} holds numbers that are not finite",
                    where=self.where,
                    fix="simulate the demonstrations again",
                )

    def __len__(self) -> int:
        return len(self.goal)

    def first(self, count: int) -> Demonstrations:
        """The first `count` of them."""
        columns = ("goal", "action", "specific_modulus", "poissons_ratio")
        return replace(self, **{name: getattr(self, name)[:count] for name in columns})

    @classmethod
    def read(cls, folder: str | os.PathLike) -> Demonstrations:
        """Demonstrations from a folder that `gendom dataset` wrote.

        Those whose simulation failed are left out.

        Raises:
            DatasetError: The folder holds no whole set, or one that no policy can be trained on.
        """
        where = str(folder)
        description = read_description(folder)
        table = load(folder)
        task = description["task"]
        action_names = tuple(description["action_names"])
        goal_columns = [f"goal_{name}" for name in description["goal_names"]]
        if len(goal_columns) != 1:
            raise DatasetError(
                f"has goals of {len(goal_columns)} numbers, policies are trained for one",
                where=where,
                fix="use a set of another task",
            )
        names = (*goal_columns, *action_names, "specific_modulus", "poissons_ratio", "length")
        missing = [name for name in (*names, "ok") if name not in table.column_names]
        if missing:
            raise DatasetError(
                f"lacks the columns {', '.join(missing)}",
                where=where,
                fix="make it again with this version of gendom dataset",
            )
        kept = table.filter(table["ok"])
        column = {name: kept[name].to_numpy().astype(float) for name in names}
        length = float(task["length"])
        if not np.allclose(column["length"], length):
            raise DatasetError(
                "mixes ropes of several lengths",
                where=where,
                fix="make a set with one rope; policies scale to other lengths by themselves",
            )
        return cls(
            task=dict(task),
            action_names=action_names,
            goal=column[goal_columns[0]] / length,
            action=np.stack([column[name] for name in action_names], axis=1) / length,
            specific_modulus=column["specific_modulus"],
            poissons_ratio=column["poissons_ratio"],
            where=where,
        )
