"""What every task offers to those who collect demonstrations and train on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Outcomes:
    """What came of W demonstrations."""

    columns: Mapping[str, NDArray[np.float64]]
    """[W] results by column name, goals first; NaN where a demonstration failed."""
    faults: tuple[str | None, ...]
    """[W] what went wrong, None where nothing did."""


class Task(Protocol):
    """One task: drawn actions and parameters in, reached goals out.

    Demonstrations are rows of named numbers. A demonstration's columns are those that `draw`
    gives and those of `Outcomes.columns`.
    """

    name: ClassVar[str]
    """As on the command line."""
    action_names: ClassVar[tuple[str, ...]]
    """Drawn columns that are the robot's action."""
    goal_names: ClassVar[tuple[str, ...]]
    """Coordinates of a goal; their columns are `goal_` and the name."""

    @property
    def parameter_ranges(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest value that `draw` gives, by column name."""
        ...

    def settings(self) -> dict[str, Any]:
        """The arguments that rebuild this task, ready for JSON."""
        ...

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """One demonstration's action, material and object, by column name, in SI units."""
        ...

    def demonstrate(
        self,
        draws: Sequence[Mapping[str, float]],
        *,
        device: str,
        dtype: str,
        on_frame: Callable[[int], None] | None = None,
    ) -> Outcomes:
        """Simulate draws side by side. One that diverges is recorded as failed, others go on.

        `on_frame` is called now and then; what it raises ends the simulation.
        """
        ...
