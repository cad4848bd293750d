"""What rods and shells are made of: threads, masses of points, curvature that is free of stress."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gendom.materials import Material
from gendom.sim import Gripper, cloth, rope
from gendom.sim.thin.engine import ThinEngine
from validation.bench import flat_simulator
from validation.readings import bending_energy, membrane_energy

MATERIAL = Material(E=1.0e6, nu=0.0)
SIZES: dict[str, Any] = {"width": 0.2, "height": 0.15, "thickness": 0.002, "dx": 0.02}


def energies(material=MATERIAL, axis=0, **options):
    """Of a cloth: membrane energy stretched and sheared in its plane, bending energy on a cylinder
    about the other axis [J], and its longest step [s]."""
    R, body = 0.4, cloth(**SIZES, points=(15, 12))
    found = []
    for gradient in ([[1e-4, 0.0], [0.0, 2e-4]], [[0.0, 1e-4], [0.0, 0.0]]):
        x = body.points.copy()
        x[:, :2] += body.points[:, :2] @ np.transpose(gradient)
        found.append(membrane_energy(flat_simulator(body, [material], positions=x, **options)))
    u, x = body.points[:, axis] / R, body.points.copy()
    x[:, axis], x[:, 2] = R * np.sin(u), R * (1.0 - np.cos(u))
    s = flat_simulator(body, [material], positions=x, **options)
    assert isinstance(s.engine, ThinEngine)
    return np.array([*found, bending_energy(s), s.engine.model.longest_step()[0]])


SOFT = replace(MATERIAL, membrane=0.25 * MATERIAL.E)
THREADS = replace(MATERIAL, warp=0.1, weft=2.0)


@pytest.mark.parametrize(
    ("material", "axis", "options", "factors"),
    [
        (replace(MATERIAL, shear=0.3), 0, {}, [1.0, 0.3, 1.0, 1.0]),
        (THREADS, 0, {}, [1.0, 1.0, 0.1, 1.0]),
        (THREADS, 1, {}, [1.0, 1.0, 2.0, 1.0]),
        # a softer plane takes longer steps; a hem does not change it
        (SOFT, 0, {}, [0.25, 0.25, 1.0, 2.0]),
        (SOFT, 0, {"stiffness": 3.0 * np.ones(15 * 12)}, [0.25, 0.25, 3.0]),
    ],
    ids=["shear", "warp", "weft", "membrane", "hem"],
)
def test_each_modulus_is_that_of_its_own_deformation(material, axis, options, factors):
    found = energies(material, axis, **options) / energies(axis=axis)
    assert found[: len(factors)] == pytest.approx(factors, rel=1e-3)


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
    s = flat_simulator(body, [limp], positions=x, gravity=(0, 0, 0), air_density=0.0, cfl=0.2)
    bending = bending_energy(s)
    assert membrane_energy(s) < 1e-6 * bending
    assert isinstance(s.engine, ThinEngine)
    mass, most = s.engine.model.mass[0], 0.0
    for t in np.linspace(0.002, 0.06, 30):
        s.run([t])
        most = max(most, 0.5 * float(mass @ np.sum(s.velocities()[0].astype(float) ** 2, axis=1)))
    assert 0.05 * bending < most < bending


LIGHT = Material(E=1e6, nu=0.3, density=500.0)
ROPE = rope(length=0.3, diameter=0.01)


@pytest.mark.parametrize("body", [ROPE, cloth(**SIZES)], ids=["rope", "cloth"])
def test_points_are_as_much_heavier_as_is_told(body):
    factors = np.linspace(0.8, 2.0, len(body.points))
    light, heavy = (flat_simulator(body, [LIGHT], mass=m).engine for m in (1.0, factors))
    assert isinstance(light, ThinEngine) and isinstance(heavy, ThinEngine)
    np.testing.assert_allclose(heavy.model.mass / light.model.mass, factors[None])


def test_a_small_sphere_between_points_of_a_cloth_holds_the_nearest_one():
    body = cloth(**SIZES, points=(15, 12))
    hand = Gripper.still(body.points[20] + [0.004, 0.005, 0.0], radius=0.0015)
    s = flat_simulator(body, [LIGHT], grippers=[hand])
    s.run([1e-4])
    assert isinstance(s.engine, ThinEngine)
    np.testing.assert_array_equal(np.flatnonzero(s.engine.holds[0, 0]), [20])
