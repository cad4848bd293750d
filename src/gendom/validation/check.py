"""What a case of the validation suite is given and what it returns."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from gendom.errors import SimulationError
from gendom.materials import Material
from gendom.sim import Body, Simulator


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How all cases are run."""

    device: str = "cpu"
    """``cpu``, ``cuda`` or ``cuda:0`` and so on."""
    dtype: str = "float64"
    """``float32`` or ``float64``."""
    quick: bool = False
    """Small sizes: coarser grids, shorter objects, fewer rows."""
    threads: int | None = None
    """Worlds side by side on the CPU (default: all cores)."""
    simulators: ClassVar[type[Simulator]] = Simulator
    """Class of all simulators."""

    def simulator(self, body: Body, materials: Sequence[Material], **options: Any) -> Simulator:
        """A simulator, by default the MPM; ``options`` are those of ``Simulator``.

        Raises:
            ParameterError, DeviceError: As ``Simulator``.
        """
        given: dict[str, Any] = {"device": self.device, "dtype": self.dtype}
        given |= {"threads": self.threads, "engine": "mpm"}
        return self.simulators(body, materials, **(given | options))

    def round_off(self, double: float, single: float) -> float:
        """The allowed error of a quantity that is exact but for round-off."""
        return double if self.dtype == "float64" else single


@dataclass(frozen=True, kw_only=True)
class Check:
    """One measured quantity and its expected value."""

    quantity: str
    unit: str
    """Of ``expected`` and ``measured``; ``-`` for a pure number."""
    expected: float
    measured: float
    error: float
    """``|measured - expected|``; divided by ``|expected|`` where ``relative``."""
    allowed: float
    """The largest ``error`` with which the row passes."""
    relative: bool
    """Whether ``error`` and ``allowed`` are shares of ``expected`` or have its unit."""
    source: str
    """Where the expected value comes from."""

    @property
    def passed(self) -> bool:
        return self.error <= self.allowed

    @classmethod
    def within_share(
        cls, quantity: str, unit: str, expected: float, measured: float, allowed: float, source: str
    ) -> Check:
        """A check whose error is relative to an expected value that is not zero.

        Raises:
            SimulationError: If the measured value is not finite.
        """
        return cls._compared(quantity, unit, expected, measured, allowed, source, relative=True)

    @classmethod
    def within(
        cls, quantity: str, unit: str, expected: float, measured: float, allowed: float, source: str
    ) -> Check:
        """A check whose error has the quantity's own unit.

        Raises:
            SimulationError: If the measured value is not finite.
        """
        return cls._compared(quantity, unit, expected, measured, allowed, source, relative=False)

    @classmethod
    def _compared(
        cls,
        quantity: str,
        unit: str,
        expected: float,
        measured: float,
        allowed: float,
        source: str,
        *,
        relative: bool,
    ) -> Check:
        # A NaN would compare as a mere failure, though nothing was measured.
        if not math.isfinite(measured):
            raise SimulationError(f"measured {measured}", where=quantity)
        error = abs(float(measured) - float(expected))
        return cls(
            quantity=quantity,
            unit=unit,
            expected=float(expected),
            measured=float(measured),
            error=error / abs(float(expected)) if relative else error,
            allowed=allowed,
            relative=relative,
            source=source,
        )


@dataclass(frozen=True, kw_only=True)
class Case:
    """A named group of checks that share their runs."""

    name: str
    title: str
    run: Callable[[Settings], list[Check]]
    """Simulates and measures; what it simulates is in its docstring."""
    engine: str = "mpm"
    """Of the simulator."""
