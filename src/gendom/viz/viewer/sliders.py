"""Numbers that sliders change, and what a viewer asks of what it shows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from gendom.viz.animation import Animation
from gendom.viz.quantities import SHOWN_UNITS, with_minus

MATERIAL, SETUP = "Material", "Grip and clock"
"""Groups of parameters."""

POSITIONS = 200
"""Of a parameter's slider."""


@dataclass(frozen=True, kw_only=True)
class SliderParameter:
    """One number that a slider changes. The slider of a logarithmic one stands at its log10."""

    name: str
    label: str
    """As people write it."""
    unit: str
    meaning: str
    group: str
    ends: tuple[float, float]
    """Its usual range."""
    value: float
    """At first; the range has room for it."""
    log: bool = False

    def position(self, value: float) -> float:
        """Where its slider stands for a value."""
        return math.log10(value) if self.log else value

    def at(self, position: float) -> float:
        """The value at a position of its slider: exactly the first one where that began."""
        if position == self.start:
            return self.value
        return 10.0**position if self.log else position

    @property
    def start(self) -> float:
        """Where its slider stands at first."""
        return self.position(self.value)

    @property
    def range(self) -> tuple[float, float, float]:
        """Lowest and highest position of its slider, and the step."""
        low, high = (self.position(end) for end in self.ends)
        low, high = min(low, self.start), max(high, self.start, low + 1e-9)
        return low, high, (high - low) / POSITIONS

    @property
    def shown(self) -> tuple[float, str]:
        """What its value is multiplied by, and the unit, to be read."""
        return SHOWN_UNITS.get(self.unit, (1.0, self.unit))

    def text(self, value: float) -> str:
        """Its label, and a value with its unit."""
        factor, unit = self.shown
        return f"{self.label} " + with_minus(f"{factor * value:.3g} {unit}".rstrip())


@dataclass(kw_only=True)
class ViewerModel:
    """Something to view."""

    title: str
    initial: Animation
    """What is known before anything is simulated."""
    notes: tuple[str, ...] = ()
    """Sentences to be read beside it."""
    parameters: tuple[SliderParameter, ...] = ()
    """What sliders change."""
    simulate: Callable[[Mapping[str, float], Callable[[], None]], Iterator[Animation]] | None = None
    """From parameters by name to animations, each more complete than the one before; its second
    argument is called now and then, and what that raises ends everything. It may raise a
    `GendomError`. None: there is the initial one alone."""

    def animations(
        self, values: Mapping[str, float], go_on: Callable[[], None]
    ) -> Iterator[Animation]:
        """What `simulate` gives."""
        if self.simulate is not None:
            return self.simulate(values, go_on)
        return iter([self.initial])

    def complete(self) -> Animation:
        """The most complete one with the first values; errors as of `simulate`."""
        *_, last = self.animations({p.name: p.value for p in self.parameters}, lambda: None)
        return last
