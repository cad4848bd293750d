"""What cloths are made of: threads, free edges."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.materials import Material
from gendom.sim import Physics, Simulator, Solver, cloth, rope
from gendom.sim.thin.shells import Shells
from validation.readings import bending_energy, membrane_energy

MATERIAL = Material(E=1.0e6, nu=0.0)
SIZES: dict[str, Any] = {"width": 0.2, "height": 0.15, "thickness": 0.002, "dx": 0.02}


def stretched(gradient, material=MATERIAL):
    """Membrane energy of a plane deformation [J]."""
    body = cloth(**SIZES, points=(9, 7))
    x = body.points.copy()
    x[:, :2] += body.points[:, :2] @ np.asarray(gradient).T
    return membrane_energy(Simulator(body, [material], positions=x))


def test_shear_has_its_own_stiffness():
    loose = replace(MATERIAL, shear=0.3)
    shear, stretch = [[0.0, 1e-4], [0.0, 0.0]], [[1e-4, 0.0], [0.0, 2e-4]]
    assert stretched(shear, loose) == pytest.approx(0.3 * stretched(shear), rel=1e-3)
    assert stretched(stretch, loose) == pytest.approx(stretched(stretch), rel=1e-3)


def rolled(material=MATERIAL, axis=0, **options):
    """Membrane and bending energy of a cloth on a cylinder [J], and its longest step [s]."""
    R, body = 0.4, cloth(**SIZES, points=(15, 12))
    u, x = body.points[:, axis] / R, body.points.copy()
    x[:, axis], x[:, 2] = R * np.sin(u), R * (1.0 - np.cos(u))
    s = Simulator(body, [material], positions=x, **options)
    assert isinstance(s.engine, Shells)
    longest = s.engine.model.longest_step()
    return membrane_energy(s), bending_energy(s), longest


@pytest.mark.parametrize("axis", [0, 1], ids=["warp", "weft"])
def test_bending_along_threads_is_independent_of_the_plane(axis):
    threads = replace(MATERIAL, warp=0.1, weft=2.0)
    plain, woven = (rolled(material, axis=axis) for material in (MATERIAL, threads))
    assert woven[0] == plain[0]
    assert woven[1] == pytest.approx((0.1, 2.0)[axis] * plain[1])


def test_the_membrane_may_have_a_modulus_of_its_own():
    """It then takes longer steps, and the bending stays."""
    soft, gradient = replace(MATERIAL, membrane=0.25 * MATERIAL.E), [[1e-4, 2e-5], [0.0, 5e-5]]
    assert stretched(gradient, soft) == pytest.approx(0.25 * stretched(gradient))
    plain, softer = rolled(), rolled(soft)
    assert softer[0] == pytest.approx(0.25 * plain[0])
    assert softer[1] == plain[1]
    assert softer[2] == pytest.approx(2.0 * plain[2])


@pytest.mark.parametrize("body", ["rope", "cloth"])
def test_particles_have_no_modulus_of_their_own_along(body):
    made = cloth(**SIZES) if body == "cloth" else rope(diameter=0.01, length=0.2)
    with pytest.raises(ParameterError, match="only rods and shells have a modulus"):
        Simulator(made, [replace(MATERIAL, membrane=1e5)], solver=Solver(engine="mpm"))
    with pytest.raises(ParameterError, match="membrane must be positive"):
        replace(MATERIAL, membrane=0.0)


@pytest.mark.parametrize("diagonal", [False, True])
def test_a_sharp_bend_about_the_diagonal_is_no_shear(diagonal):
    """A limp sheet that is rolled up, its edges as long as at rest, springs open with the energy of
    its bending; with cells that resist bends about their diagonals, with a multiple of it."""
    n, spacing, kink = 21, 0.01, 0.35
    limp = Material(E=6e5, nu=0.3, density=400.0)
    body = cloth(width=0.2, height=0.2, thickness=5e-4, dx=0.02, points=(n, n))
    i, j = (body.points[:, :2] / spacing).round().T
    # a polygon of equal sides, which lattice lines or diagonals of cells go around
    side = spacing / np.sqrt(2.0) if diagonal else spacing
    turn, along = (kink * (i + j), side * (i - j)) if diagonal else (kink * i, spacing * j)
    R = side / (2.0 * np.sin(kink / 2.0))
    x = np.stack([R * np.sin(turn), along, -R * np.cos(turn)], axis=1)
    s = Simulator(
        body,
        [limp],
        positions=x,
        physics=Physics(gravity=(0, 0, 0), air_density=0.0),
        solver=Solver(cfl=0.2),
    )
    bending = bending_energy(s)
    assert membrane_energy(s) < 1e-6 * bending
    assert isinstance(s.engine, Shells)
    mass, most = s.engine.model.mass[0], 0.0
    for t in np.linspace(0.002, 0.06, 30):
        s.run([t])
        most = max(most, 0.5 * float(mass @ np.sum(s.velocities()[0].astype(float) ** 2, axis=1)))
    assert 0.05 * bending < most < bending


def test_points_bend_and_weigh_as_those_of_a_hem():
    """In its plane a cloth with a modulus of its own there does not change."""
    soft, points = replace(MATERIAL, membrane=0.25 * MATERIAL.E), 15 * 12
    plain, hemmed = rolled(soft), rolled(soft, stiffness=3.0 * np.ones(points))
    assert hemmed[0] == plain[0]
    assert hemmed[1] == pytest.approx(3.0 * plain[1])
    body, factors = cloth(**SIZES, points=(15, 12)), np.linspace(0.8, 2.0, points)
    light, heavy = (Simulator(body, [MATERIAL], mass=m).engine for m in (1.0, factors))
    assert isinstance(light, Shells) and isinstance(heavy, Shells)
    np.testing.assert_allclose(heavy.model.mass / light.model.mass, factors[None])
    with pytest.raises(ParameterError, match="mass"):
        Simulator(body, [MATERIAL], mass=0.0)
