"""What every task offers to those who collect demonstrations and train on them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from gendom.errors import SimulationError

T = TypeVar("T")


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
        self, draws: Sequence[Mapping[str, float]], *, device: str, dtype: str
    ) -> Outcomes:
        """Simulate draws side by side. One that diverges is recorded as failed, others go on."""
        ...


def surviving(
    run: Callable[[list[int]], T], count: int
) -> Iterator[tuple[list[int], T | SimulationError]]:
    """Simulate worlds in batches as large as divergence allows.

    A batch in which a world diverges is simulated again without it, in two halves: should
    several worlds diverge, each of them then costs only a part of the batch.

    Args:
        run: Simulates the worlds of the given indices together.
        count: Number of worlds W.

    Yields:
        Indices and what `run` returned for them, or a single index and its error. Every index
        comes once, in no particular order.
    """
    waiting = [list(range(count))] if count else []
    while waiting:
        batch = waiting.pop()
        try:
            result = run(batch)
        except SimulationError as error:
            if len(batch) == 1:
                yield batch, error
                continue
            if error.world is not None:
                yield [batch.pop(error.world)], error
            middle = len(batch) // 2
            waiting += [half for half in (batch[middle:], batch[:middle]) if half]
        else:
            yield batch, result
