"""The suite passes where the simulator is right, and fails where it is not."""

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from gendom.materials import Material
from gendom.sim import CFL, GRAVITY, Gripper, cloth
from validation import CASES, Bench, run_case
from validation.stability import diverged

QUICK = Bench(quick=True, threads=1)


@functools.cache
def failing(name, bench):
    """Quantities of a case that are not within what is allowed."""
    result = run_case(CASES[name], bench)
    assert result.failure is None
    assert result.rows
    return {row.quantity for row in result.rows if not row.passed}


@pytest.mark.parametrize("name", CASES)
def test_quick_suite(name):
    assert failing(name, QUICK) == set()


@pytest.mark.parametrize("name", ["objectivity", "tension"])
def test_quick_suite_in_single_precision(name):
    """The bounds for float32 hold too."""
    assert failing(name, replace(QUICK, dtype="float32")) == set()


# ---- a wrong simulator -----------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Misled(Bench):
    """A bench whose simulators are given other values than the case believes."""

    change: Callable

    def simulate(self, body, materials, **options):
        materials, options = self.change(self, list(materials), options)
        return super().simulate(body, materials, **options)


def made(change):
    """Materials of which some fields are others."""
    return lambda _, materials, options: ([replace(m, **change(m)) for m in materials], options)


def given(change):
    """Options of which some are others."""
    return lambda _, materials, options: (materials, options | change(options))


def odd(options):
    """Where substeps ought to be halved they shrink by sqrt(2)."""
    return {"cfl": 0.2 * (options["cfl"] / 0.2) ** 0.5 if "cfl" in options else CFL}


def stiffer_in_single(bench, materials, options):
    return (stiffer if bench.dtype == "float32" else made(lambda _: {}))(bench, materials, options)


stiffer = made(lambda m: {"E": 1.25 * m.E})
more_lateral = made(lambda m: {"nu": m.nu + 0.05})
softer_in_torsion = made(lambda m: {"nu": (1.0 + m.nu) / 0.9 - 1.0})  # G by a tenth, E the same
undamped = made(lambda m: {"damping": 0.0})
heavier = given(lambda o: {"gravity": 1.1 * np.asarray(o.get("gravity", GRAVITY))})
always_down = given(lambda _: {"gravity": GRAVITY})
without_air = given(lambda _: {"air_density": 0.0})
rubbing_more, rubbing_less = (
    given(lambda o, f=f: {"self_friction": f * np.asarray(o["self_friction"])}) for f in (1.2, 0.8)
)
on_a_high_table = given(lambda o: {"table": replace(o["table"], height=0.002 + o["table"].height)})


@pytest.mark.parametrize(
    ("name", "change", "quantities"),
    [
        (name, change, quantities)
        for name, change, *quantities in (
            ("free-flight", heavier, "centre's distance from its path", "drift of momentum"),
            ("objectivity", always_down, "largest difference after 90 degrees about x, over the"),
            ("torsion", stiffer, "torsional stiffness, 1 cell", "torsional stiffness, 2"),
            ("ring-down", undamped, "decay rate, damping 10 ms"),
            ("terminal-speed", without_air, "a sheet's terminal speed"),
            ("resting", on_a_high_table,
                "height of a rope's axis", "height of the middle of a cloth"),
            ("tension", more_lateral, "nu read back, 2 cells across"),
            ("order", given(odd), "exponent of dt in what halved substeps change"),
            ("precision", stiffer_in_single, "largest difference of float32 from float64"),
            ("shell-cantilever", heavier, "sag of strips over theory"),
            ("rod-ring", softer_in_torsion, "critical twist of a ring"),
            ("rod-order", stiffer,
                "order of a rope's sag, from 1", "order of a rope's sag, from 3"),
            ("rod-layers", rubbing_more, "deceleration of", "stopping distance of"),
            ("shell-layers", rubbing_less,
                "acceleration of a cloth's layer on another at 0.95",
                "acceleration of a cloth's layer on another at 1.25"),
        )
    ],
)  # fmt: skip
def test_a_wrong_simulator_fails(name, change, quantities):
    """One of each kind of fault is noticed by rows that are there for it."""
    short = failing(name, Misled(quick=True, threads=1, change=change))
    assert [q for q in quantities if not any(one.startswith(q) for one in short)] == []


def test_worlds_that_diverge_are_counted():
    """At eight times the substep none of three lasts, and none stops the count."""
    body = cloth(width=0.04, height=0.04, thickness=0.04, dx=0.01, corner=(0.0, 0.0, 0.02))
    materials = [Material(E=E, nu=0.3, density=1000.0) for E in (1e4, 2e4, 3e4)]
    held = [Gripper.still((0.0, 0.0, 0.02), radius=0.02)] * 3
    assert diverged(QUICK, body, materials, held, 0.3, 8.0) == 3
    assert diverged(QUICK, body, materials, held, 0.05, 1.0) == 0
