"""What can be viewed: cases with parameters that are simulated again as these change."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

from gendom.viz.report.quantities import with_minus
from gendom.viz.viewer.scene import ViewerScene

MATERIAL, ACTION, SETUP = "Material", "Action", "Grip and clock"
"""Groups of parameters."""

_SHOWN = {
    "1": (1.0, ""),
    "m": (1e3, "mm"),
    "s": (1e3, "ms"),
    "m^2/s^2": (1.0, "m²/s²"),
    "kg/m^3": (1.0, "kg/m³"),
}
"""SI unit -> what values are multiplied by, and the unit, to be read."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number that a slider changes."""

    name: str
    label: str
    """As people write it."""
    unit: str
    meaning: str
    group: str
    low: float
    high: float
    value: float
    """At first, within the range."""
    log: bool = False
    """Whether its slider is logarithmic."""

    def position(self, value: float) -> float:
        """Where its slider stands for a value: at log10 of a logarithmic one."""
        return math.log10(value) if self.log else value

    def at(self, position: float) -> float:
        """The value of a position of its slider, inverse of `position`."""
        return 10.0**position if self.log else position

    def text(self, value: float) -> str:
        """A value with its unit."""
        factor, unit = _SHOWN.get(self.unit, (1.0, self.unit))
        return with_minus(f"{factor * value:.3g} {unit}".rstrip())


class Model(Protocol):
    """Something to view."""

    @property
    def title(self) -> str:
        """One line."""
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences to be read beside it."""
        ...

    @property
    def cases(self) -> tuple[str, int]:
        """What its cases are, in the singular, and how many there are."""
        ...

    @property
    def initial(self) -> ViewerScene | None:
        """What is known before anything is simulated."""
        ...

    def parameters(self, case: int) -> tuple[Parameter, ...]:
        """Parameters of a case; of the same names in all cases."""
        ...

    def simulate(
        self, case: int, values: Mapping[str, float], go_on: Callable[[], None]
    ) -> Iterator[ViewerScene]:
        """One or more scenes, each more complete than the one before.

        Args:
            case: Its number.
            values: Parameters by name.
            go_on: Called now and then; what it raises ends everything.

        Raises:
            GendomError: It cannot be simulated.
        """
        ...
