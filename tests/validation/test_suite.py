"""The suite passes where the simulator is right, fails where it is not, and fails when misled."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.materials import Material
from gendom.sim import Gripper, cloth
from gendom.validation import CASES, Settings, choose, run_cases
from gendom.validation.stability import _diverged

QUICK = Settings(quick=True, threads=1)

FALLS_SHORT = {"order": {"order in dt with dx fixed, bar of 16 cells"}}
"""Checks that the simulator fails, as docs/validation.md says and explains."""


def failing(name, settings):
    """Quantities of a case that are not within what is allowed."""
    (result,) = run_cases(choose([name]), settings)
    assert result.failure is None
    assert result.checks
    return {check.quantity for check in result.checks if not check.passed}


@pytest.mark.parametrize("name", CASES)
def test_quick_suite(name):
    """Everything passes but what is listed; what is mended must leave the list and the page."""
    assert failing(name, QUICK) == FALLS_SHORT.get(name, set())


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_full_suite(name):
    """The same at the sizes that `gendom validate` runs."""
    assert failing(name, Settings(threads=1)) == FALLS_SHORT.get(name, set())


@pytest.mark.parametrize("name", ["free-fall", "free-flight", "objectivity", "tension", "batch"])
def test_quick_suite_in_single_precision(name):
    """The bounds for float32 hold too."""
    short = failing(name, replace(QUICK, dtype="float32"))
    assert short <= FALLS_SHORT.get(name, set())


# ---- a wrong simulator -----------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Misled(Settings):
    """Settings whose simulators are given other values than the case believes."""

    change: Callable

    def simulator(self, body, materials, **options):
        materials, options = self.change(self, list(materials), options)
        return super().simulator(body, materials, **options)


def stiffer(_, materials, options):
    return [replace(m, E=1.25 * m.E) for m in materials], options


def more_lateral(_, materials, options):
    return [replace(m, nu=m.nu + 0.05) for m in materials], options


def heavier(_, materials, options):
    pull = np.asarray(options.get("gravity", (0.0, 0.0, -9.81)))
    return materials, options | {"gravity": 1.1 * pull}


def always_down(_, materials, options):
    return materials, options | {"gravity": (0.0, 0.0, -9.81)}


def rougher(_, materials, options):
    table = options["table"]
    return materials, options | {"table": replace(table, friction=1.2 * np.asarray(table.friction))}


def slippery(_, materials, options):
    table = options["table"]
    return materials, options | {"table": replace(table, friction=0.8 * np.asarray(table.friction))}


def damped(_, materials, options):
    return materials, options | {"damping": 0.5}


def lifted(_, materials, options):
    """Grippers rise: they do work that the case knows nothing of."""
    up = np.array([0.0, 0.0, 0.1])
    rising = [
        Gripper(time=[0.0, 1.0], position=[g.position[0], g.position[0] + up], radius=g.radius)
        for g in options.get("grippers", ())
    ]
    return materials, options | {"grippers": rising}


def crowded(_, materials, options):
    """Worlds of a batch fall differently from single ones."""
    return materials, options | {"gravity": (0.0, 0.0, -9.81 - 1e-9 * len(materials))}


def stiffer_in_single(settings, materials, options):
    return (
        stiffer(settings, materials, options)
        if settings.dtype == "float32"
        else (
            materials,
            options,
        )
    )


@pytest.mark.parametrize(
    ("name", "change", "quantity"),
    [
        ("free-fall", heavier, "worst particle's distance from its path, over the path"),
        ("free-fall", damped, "worst particle's velocity beside v0 + g t, over |g| t"),
        ("free-flight", heavier, "linear momentum beside P0 + M g t, relative"),
        ("free-flight", damped, "change of angular momentum, relative"),
        ("free-flight", damped, "angle turned about a principal axis"),
        ("objectivity", always_down, "largest difference after 90 degrees about x, over the"),
        ("cantilever", stiffer, "sag of the tip, 2 cells across"),
        ("elastica", stiffer, "largest distance from the elastica / L, L = 2 bending lengths"),
        ("axial-vibration", stiffer, "first axial frequency, 2 cells across"),
        ("tension", stiffer, "E read back, 2 cells across"),
        ("tension", more_lateral, "nu read back, 2 cells across"),
        ("hanging-chain", heavier, "period of a chain, 1 cell across"),
        ("hanging-chain", heavier, "period with bending stiffness and stretch, 1 cell across"),
        ("sliding", rougher, "stopping distance at mu = 0.2"),
        ("sticking", rougher, "acceleration at 1.1 atan(mu)"),
        ("sticking", slippery, "way in 0.5 s at 0.95 atan(mu)"),
        ("order", heavier, "order in dt, fall of a block"),
        ("order", stiffer, "order in dx with dt / dx fixed"),
        ("energy", lifted, "growth of energy, swinging rope, 1 cell across"),
        ("batch", crowded, "largest difference of a batch of 5 from single worlds"),
        ("precision", stiffer_in_single, "largest difference of float32 from float64"),
    ],
)
def test_a_wrong_simulator_fails(name, change, quantity):
    """Each check notices what it is there for."""
    short = failing(name, Misled(quick=True, threads=1, change=change))
    assert any(one.startswith(quantity) for one in short)


def test_unknown_case():
    """The error names the case and those there are."""
    with pytest.raises(ParameterError, match=r"'bending'.*cantilever"):
        choose(["bending"])


def test_cases_run_in_the_suites_order():
    assert [case.name for case in choose(["energy", "free-fall"])] == ["free-fall", "energy"]
    assert [case.name for case in choose([])] == list(CASES)


def test_worlds_that_diverge_are_counted():
    """At eight times the substep none of three lasts, and none stops the count."""
    body = cloth(width=0.04, height=0.04, thickness=0.04, dx=0.01, corner=(0.0, 0.0, 0.02))
    materials = [Material(E=E, nu=0.3, density=1000.0) for E in (1e4, 2e4, 3e4)]
    held = [[Gripper.still((0.0, 0.0, 0.02), radius=0.02)] for _ in materials]
    assert _diverged(QUICK, body, materials, held, None, 0.3, 8.0) == 3
    assert _diverged(QUICK, body, materials, held, None, 0.05, 1.0) == 0
