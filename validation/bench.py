"""What all cases share: how a simulator is made, rows of results, and the register of cases."""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gendom.arguments import check_choice
from gendom.arrays import Array
from gendom.errors import SimulationError
from gendom.materials import Material
from gendom.sim import Body, Physics, Simulator, Solver, Variation

WEIGHTLESS = (0.0, 0.0, 0.0)


def flat_simulator(body: Body, materials: Sequence[Material], **options: Any) -> Simulator:
    """A simulator; options are its own and those of ``Physics``, ``Solver`` and ``Variation``."""

    for name, kind in (("physics", Physics), ("solver", Solver), ("variation", Variation)):
        taken = {f.name: options.pop(f.name) for f in fields(kind) if f.name in options}
        options[name] = kind(**taken)
    return Simulator(body, materials, **options)


def moved(body: Body, by: ArrayLike) -> Body:
    """The same body shifted by [3] [m]."""
    return replace(body, x=body.x + by, points=body.points + by)


@dataclass(frozen=True, kw_only=True)
class Bench:
    """How a case is run. All simulators of the suite are made here."""

    engine: str = "mpm"
    """``mpm`` or ``thin``; a case sets its own."""
    device: str = "cpu"
    """``cpu``, ``cuda`` or ``cuda:0`` and so on."""
    dtype: str = "float64"
    """``float32`` or ``float64``."""
    quick: bool = False
    """Small sizes: coarser grids, shorter objects, fewer rows."""
    threads: int | None = None
    """Worlds side by side on the CPU (default: all cores)."""

    def simulate(self, body: Body, materials: Sequence[Material], **options: Any) -> Simulator:
        """As ``flat_simulator``, in vacuum unless told otherwise."""
        given: dict[str, Any] = {"engine": self.engine, "device": self.device, "dtype": self.dtype}
        given |= {"threads": self.threads, "air_density": 0.0, **options}
        return flat_simulator(body, materials, **given)

    def settle(
        self, body: Body, materials: Sequence[Material], omega: ArrayLike,
        *, periods: float = 16.0, **options: Any,
    ) -> Array:  # fmt: skip
        """[W, N, 3] where a body comes to rest in ``periods`` / omega; its slowest mode, of angular
        frequency ``omega`` [rad/s], one or [W], is damped critically [m]."""
        damping = 2.0 * np.asarray(omega, dtype=float)
        s = self.simulate(body, materials, velocity_damping=damping, **options)
        return s.run([periods / np.min(omega)])[0].astype(float)

    def round_off(self, double: float, single: float) -> float:
        """The allowed error of a quantity that is exact but for round-off."""
        return double if self.dtype == "float64" else single


@dataclass(frozen=True)
class Row:
    """One measured quantity and its expected value.

    Raises:
        SimulationError: If the measured value is not finite.
    """

    quantity: str
    unit: str
    """Of ``expected`` and ``measured``; ``-`` for a pure number."""
    expected: float
    measured: float
    allowed: float
    """The largest ``error`` with which the row passes."""
    source: str
    """Where the expected value comes from."""
    relative: bool = False
    """Whether ``error`` and ``allowed`` are shares of ``expected`` or have its unit."""

    def __post_init__(self) -> None:
        # A NaN would compare as a mere failure, though nothing was measured.
        if not math.isfinite(self.measured):
            raise SimulationError(f"measured {self.measured}", where=self.quantity)

    @property
    def error(self) -> float:
        """``|measured - expected|``; divided by ``|expected|`` where ``relative``."""
        error = abs(self.measured - self.expected)
        return error / abs(self.expected) if self.relative else error

    @property
    def passed(self) -> bool:
        return self.error <= self.allowed


def absolute(
    quantity: str, unit: str, expected: float, measured: float, allowed: float, source: str
) -> Row:
    """A row whose error has the quantity's own unit."""
    return Row(quantity, unit, float(expected), float(measured), allowed, source)


def relative(*given: Any) -> Row:
    """A row whose error is a share of an expected value that is not zero; as ``absolute``."""
    return replace(absolute(*given), relative=True)


def over_theory(quantity: str, ratio: float, allowed: float, source: str) -> Row:
    """A row of a ratio of measured to expected value."""
    return relative(quantity, "-", 1.0, ratio, allowed, source)


def vanishing(quantity: str, measured: float, allowed: float, source: str, unit: str = "-") -> Row:
    """A row of what ought to be zero."""
    return absolute(quantity, unit, 0.0, measured, allowed, source)


def worst(ratios: Array, theory: float = 1.0) -> float:
    """The value that is farthest from theory."""
    return float(ratios[np.abs(ratios - theory).argmax()])


# ---- cases ---------------------------------------------------------------------------------------

Measure = Callable[..., Iterable[Row]]


@dataclass(frozen=True)
class Case:
    """A named group of rows that share their runs."""

    name: str
    title: str
    engine: str
    """``mpm`` or ``thin``: what its simulators run on."""
    measure: Measure
    """Simulates and measures; what it simulates is in its docstring."""
    given: tuple[Any, ...] = ()
    """What it is given after the bench."""


@dataclass(frozen=True)
class Result:
    """The result of a case."""

    case: Case
    rows: list[Row]
    failure: str | None
    """Why the simulation stopped, or None."""
    seconds: float

    @property
    def passed(self) -> bool:
        return self.failure is None and all(row.passed for row in self.rows)


CASES: dict[str, Case] = {}
"""Every case by its name, in the order in which they run."""


def case(name: str, title: str, engine: str, *given: Any) -> Callable[[Measure], Measure]:
    """Register a function as a case; once for each engine or kind of body that it can measure."""

    def register(measure: Measure) -> Measure:
        CASES[name] = Case(name, title, engine, measure, given)
        return measure

    return register


def choose(names: Sequence[str], engine: str | None = None) -> list[Case]:
    """The cases of these names, in the suite's order; all for no names, or all of an engine.

    Raises:
        ParameterError: If there is no case of a name.
    """
    for name in names:
        check_choice("case", name, CASES, where="--only")
    return [
        case
        for name, case in CASES.items()
        if (name in names or not names) and engine in (None, case.engine)
    ]


def run_case(case: Case, bench: Bench) -> Result:
    """Run a case. A simulation that fails ends it, not the suite.

    Raises:
        ParameterError, DeviceError: If the bench's settings do not make a simulator.
    """
    began, rows, failure = time.monotonic(), [], None
    try:
        rows = list(case.measure(replace(bench, engine=case.engine), *case.given))
    except SimulationError as error:
        failure = str(error)
    return Result(case, rows, failure, time.monotonic() - began)
