"""The suite passes where the simulator is right, fails where it is not, and fails when misled."""

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.materials import Material
from gendom.sim import CFL, Gripper, cloth
from gendom.validation import CASES, Settings, choose, run_cases
from gendom.validation.stability import _diverged

QUICK = Settings(quick=True, threads=1)


@functools.cache
def failing(name, settings):
    """Quantities of a case that are not within what is allowed."""
    (result,) = run_cases(choose([name]), settings)
    assert result.failure is None
    assert result.checks
    return {check.quantity for check in result.checks if not check.passed}


@pytest.mark.parametrize("name", CASES)
def test_quick_suite(name):
    """Everything passes."""
    assert failing(name, QUICK) == set()


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_full_suite(name):
    """The same at the sizes that `gendom validate` runs."""
    assert failing(name, Settings(threads=1)) == set()


@pytest.mark.parametrize(
    "name", ["free-fall", "free-flight", "objectivity", "tension", "layers", "batch"]
)
def test_quick_suite_in_single_precision(name):
    """The bounds for float32 hold too."""
    assert failing(name, replace(QUICK, dtype="float32")) == set()


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


def softer_in_torsion(_, materials, options):
    """G is smaller by a tenth, E the same."""
    return [replace(m, nu=(1.0 + m.nu) / 0.9 - 1.0) for m in materials], options


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


def rubbing_more(_, materials, options):
    return materials, options | {"self_friction": 1.2 * np.asarray(options["self_friction"])}


def rubbing_less(_, materials, options):
    return materials, options | {"self_friction": 0.8 * np.asarray(options["self_friction"])}


def damped(_, materials, options):
    return materials, options | {"velocity_damping": 0.5}


def undamped(_, materials, options):
    return [replace(m, damping=0.0) for m in materials], options


def stiffer_where_damped(_, materials, options):
    return [replace(m, E=(1.001 if m.damping else 1.0) * m.E) for m in materials], options


def without_air(_, materials, options):
    return materials, options | {"air_density": 0.0}


def braked(_, materials, options):
    return materials, options | {"velocity_damping": 10.0}


def in_short_substeps(_, materials, options):
    return materials, options | {"cfl": 0.2}


def in_odd_substeps(_, materials, options):
    """Where substeps ought to be halved they shrink by sqrt(2)."""
    cfl = 0.2 * (options["cfl"] / 0.2) ** 0.5 if "cfl" in options else CFL
    return materials, options | {"cfl": cfl}


def on_a_high_table(_, materials, options):
    table = options["table"]
    return materials, options | {"table": replace(table, height=table.height + 0.002)}


def slipping(_, materials, options):
    """Grippers sink slowly."""
    down = np.array([0.0, 0.0, -1e-4])
    sinking = [
        [Gripper(time=[0.0, 9.0], position=[g.position[0], g.position[0] + down], radius=g.radius)]
        for (g,) in options["grippers"]
    ]
    return materials, options | {"grippers": sinking}


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
        ("grip", stiffer, "least sag at 2 phases of the grid, 1 cell across"),
        ("grip", stiffer, "largest sag at 2 phases of the grid, 1.5 cells across"),
        ("grip", slipping, "creep between 2 and 3 s over the sag, 1.5 cells across"),
        ("torsion", stiffer, "torsional stiffness, 1 cell across"),
        ("torsion", stiffer, "torsional stiffness, 2 cells across"),
        ("ring-down", undamped, "decay rate, damping 10 ms"),
        ("ring-down", stiffer, "frequency, damping 10 ms"),
        ("ring-down", in_short_substeps, "the grid's own damping, 1.5 cells across"),
        ("damped-sag", stiffer_where_damped, "sag of a tip with damping 10 ms"),
        ("terminal-speed", without_air, "a sheet's terminal speed"),
        ("terminal-speed", heavier, "a level rope's terminal speed"),
        ("resting", on_a_high_table, "height of a rope's axis, 1.5 cells across"),
        ("resting", on_a_high_table, "height of the middle of a cloth 0.2 cells thick"),
        ("layers", damped, "share of the speed left after 0.1 s at a gap of 3 cells"),
        ("layers", braked, "share of the speed left after 0.1 s at a gap of 2 cells"),
        ("axial-vibration", stiffer, "first axial frequency, 2 cells across"),
        ("tension", stiffer, "E read back, 2 cells across"),
        ("tension", more_lateral, "nu read back, 2 cells across"),
        ("hanging-chain", heavier, "period of a chain, 1 cell across"),
        ("hanging-chain", heavier, "period with bending stiffness and stretch, 1 cell across"),
        ("sliding", rougher, "stopping distance at mu = 0.2"),
        ("sticking", rougher, "acceleration of a block at 1.1 atan(mu)"),
        ("sticking", rougher, "acceleration of a rope at 1.1 atan(mu)"),
        ("sticking", rougher, "acceleration of a cloth at 1.1 atan(mu)"),
        ("sticking", slippery, "way of a block in 0.5 s at 0.95 atan(mu)"),
        ("sticking", slippery, "way of a rope in 0.5 s at 0.95 atan(mu)"),
        ("sticking", slippery, "way of a cloth in 0.5 s at 0.95 atan(mu)"),
        ("order", heavier, "order in dt, fall of a block"),
        ("order", stiffer, "order in dx with dt / dx fixed"),
        ("order", in_odd_substeps, "exponent of dt in what halved substeps change"),
        ("energy", heavier, "growth of energy, free fall of a wobbling block"),
        ("energy", heavier, "growth of energy, free fall of a bent rope, 1 cell across"),
        ("energy", lifted, "growth of energy, swinging rope, 1 cell across"),
        ("batch", crowded, "largest difference of a batch of 5 from single worlds"),
        ("precision", stiffer_in_single, "largest difference of float32 from float64"),
        ("rod-cantilever", heavier, "sag of rods over theory"),
        ("shell-cantilever", heavier, "sag of strips over theory"),
        ("shell-lateral", heavier, "critical weight of a standing strip"),
        ("rod-bend-twist", softer_in_torsion, "weight at which a curl of 5 rad"),
        ("rod-stick-slip", rougher, "H / V where tips slip over mu"),
        ("rod-ring", softer_in_torsion, "critical twist of a ring"),
        ("rod-order", stiffer, "order of a rope's sag, from 16"),
        ("rod-order", stiffer, "order of a rope's sag, from 32"),
        ("rod-batch", crowded, "largest difference of a batch of 5 ropes"),
        ("rod-falls", heavier, "a level rope's terminal speed"),
        ("rod-swing", lifted, "growth of the mean energy in 40 s, a swinging rope"),
        ("rod-graded", stiffer, "sag over theory of a rope ten times as stiff"),
        ("rod-graded", stiffer, "sag over theory of a rope ten times as soft"),
        ("rod-layers", rubbing_more, "deceleration of a rope's layer"),
        ("rod-layers", rubbing_more, "stopping distance of a rope's layer"),
        ("rod-layers", rubbing_less, "acceleration of a rope's layer on another at 0.95"),
        ("rod-layers", rubbing_less, "acceleration of a rope's layer on another at 1.25"),
        ("shell-precision", stiffer_in_single, "root mean square difference of float32"),
        ("shell-precision", stiffer_in_single, "largest difference of float32"),
        ("shell-order", stiffer, "order of a strip's sag, from 16"),
        ("shell-order", stiffer, "order of a strip's sag, from 32"),
        ("shell-batch", crowded, "largest difference of a batch of 5 cloths"),
        ("shell-swing", lifted, "growth of the mean energy in 20 s, a swinging sheet, half"),
        ("shell-swing", lifted, "growth of the mean energy in 20 s, a swinging sheet, the def"),
        ("shell-layers", rubbing_more, "deceleration of a cloth's layer"),
        ("shell-layers", rubbing_more, "stopping distance of a cloth's layer"),
        ("shell-layers", rubbing_less, "acceleration of a cloth's layer on another at 0.95"),
        ("shell-layers", rubbing_less, "acceleration of a cloth's layer on another at 1.25"),
        ("shell-plates", more_lateral, "curvature across over that along a bent strip"),
        ("shell-plates", heavier, "sag over theory of a square held at its corners, in the"),
        ("shell-plates", heavier, "sag over theory of a square held at its corners, halfway"),
        ("shell-weave", heavier, "sag over theory of a level strip along the weft"),
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
