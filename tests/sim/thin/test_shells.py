"""What cloths are made of: threads, natural curvature, free edges."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.materials import Material
from gendom.sim import Simulator, Weave, cloth, rope
from gendom.sim.thin.shells import Shells
from validation.readings import bending_energy, membrane_energy

MATERIAL = Material(E=1.0e6, nu=0.0)
SIZES: dict[str, Any] = {"width": 0.2, "height": 0.15, "thickness": 0.002, "dx": 0.02}


def stretched(weave, gradient, material=MATERIAL):
    """Membrane energy of a plane deformation [J]."""
    body = cloth(**SIZES, points=(9, 7), weave=weave)
    x = body.points.copy()
    x[:, :2] += body.points[:, :2] @ np.asarray(gradient).T
    return membrane_energy(Simulator(body, [material], positions=x))


@pytest.mark.parametrize(
    ("name", "gradient"),
    [
        ("warp", [[1e-4, 0.0], [0.0, 0.0]]),
        ("weft", [[0.0, 0.0], [0.0, 1e-4]]),
        ("shear", [[0.0, 1e-4], [0.0, 0.0]]),
    ],
)
def test_threads_have_their_own_stiffness(name, gradient):
    plain, stiffer = stretched(Weave(), gradient), stretched(Weave(**{name: 3.0}), gradient)
    assert stiffer == pytest.approx(3.0 * plain, rel=1e-3)
    for other in {"warp", "weft", "shear"} - {name}:
        assert stretched(Weave(**{other: 3.0}), gradient) == pytest.approx(plain, rel=1e-3)


def rolled(weave=None, material=MATERIAL):
    """Membrane and bending energy of a cloth on a cylinder [J], and its longest step [s]."""
    R, body = 0.4, cloth(**SIZES, points=(15, 12), weave=weave)
    u = body.points[:, 0] / R
    x = np.stack([R * np.sin(u), body.points[:, 1], R * (1.0 - np.cos(u))], axis=1)
    s = Simulator(body, [material], positions=x)
    assert isinstance(s.engine, Shells)
    return (
        membrane_energy(s),
        bending_energy(s),
        s.engine.model.longest_step([material], np.ones((1, 1))),
    )


def test_bending_is_independent_of_the_plane():
    plain, pliant = rolled(Weave()), rolled(Weave(bending=0.1))
    assert pliant[0] == plain[0]
    assert pliant[1] == pytest.approx(0.1 * plain[1])


def test_the_membrane_may_have_a_modulus_of_its_own():
    """It then takes longer steps, and the bending stays."""
    soft, gradient = replace(MATERIAL, membrane=0.25 * MATERIAL.E), [[1e-4, 2e-5], [0.0, 5e-5]]
    assert stretched(Weave(), gradient, soft) == pytest.approx(0.25 * stretched(Weave(), gradient))
    plain, softer = rolled(), rolled(material=soft)
    assert softer[0] == pytest.approx(0.25 * plain[0])
    assert softer[1] == plain[1]
    assert softer[2] == pytest.approx(2.0 * plain[2])


@pytest.mark.parametrize("body", ["rope", "cloth"])
def test_only_shells_have_a_membrane(body):
    made = cloth(**SIZES) if body == "cloth" else rope(diameter=0.01, length=0.2)
    engine = "mpm" if body == "cloth" else "thin"
    with pytest.raises(ParameterError, match="only shells have a membrane"):
        Simulator(made, [replace(MATERIAL, membrane=1e5)], engine=engine)
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
    s = Simulator(body, [limp], positions=x, gravity=(0, 0, 0), air_density=0.0, cfl=0.2)
    bending = bending_energy(s)
    assert membrane_energy(s) < 1e-6 * bending
    assert isinstance(s.engine, Shells)
    mass, most = s.engine.mass[0], 0.0
    for t in np.linspace(0.002, 0.06, 30):
        s.run([t])
        most = max(most, 0.5 * float(mass @ np.sum(s.velocities()[0].astype(float) ** 2, axis=1)))
    assert 0.05 * bending < most < bending


@pytest.mark.parametrize("axis", [0, 1])
def test_a_cloth_takes_the_curvature_that_it_has_by_nature(axis):
    """In space a strip rolls up until it is free of stress: arched towards the third axis."""
    kappa = np.zeros((2, 2))
    kappa[axis, axis] = 4.0
    size: dict[str, Any] = {"width": 0.02, "height": 0.02, "thickness": 0.002, "dx": 0.02}
    size["height" if axis else "width"] = 0.2
    points = (3, 21) if axis else (21, 3)
    body = cloth(**size, points=points, natural_curvature=kappa)
    s = Simulator(body, [MATERIAL], gravity=(0, 0, 0), air_density=0.0, velocity_damping=20.0)
    x = s.run([3.0])[0, 0].reshape(*body.shape, 3)
    line = x[:, 1] if axis else x[1]
    second = np.diff(line, 2, axis=0) / 0.01**2
    assert np.linalg.norm(second, axis=1) == pytest.approx(4.0, rel=0.02)
    assert second[len(second) // 2, 2] < 0.0  # its middle stands highest


def test_bad_input_is_named():
    with pytest.raises(ParameterError, match="warp must be positive"):
        Weave(warp=0.0)
    with pytest.raises(ParameterError, match="natural_curvature must be"):
        cloth(**SIZES, natural_curvature=[[1.0, 2.0], [0.0, 1.0]])
    with pytest.raises(ParameterError, match="points must be at least 2"):
        cloth(**SIZES, points=(1, 5))
