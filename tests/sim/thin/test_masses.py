"""Points that are heavier than their material says."""

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.materials import Material
from gendom.sim import Gripper, Simulator, Solver, cloth, rope

LIGHT, DENSE = (Material(E=1e6, nu=0.3, density=density) for density in (500.0, 1000.0))


@pytest.mark.parametrize(
    "body",
    [rope(length=0.3, diameter=0.01), cloth(width=0.2, height=0.2, thickness=0.001, dx=0.025)],
)
def test_twice_the_mass_is_twice_the_density(body):
    held = Gripper(time=[0.0], position=[body.points[0]], radius=0.015)
    x = [
        Simulator(body, [material], grippers=[held], mass=mass).run([0.1])[0, 0]
        for material, mass in ((LIGHT, 2.0), (DENSE, 1.0), (LIGHT, 1.0))
    ]
    assert np.abs(x[0] - x[1]).max() < 2e-4
    assert np.abs(x[2] - x[1]).max() > 5e-4


def test_a_heavy_end_hangs_lower():
    body = rope(length=0.3, diameter=0.01)
    held = Gripper(time=[0.0], position=[body.points[0]], radius=0.015)
    n = len(body.points)
    mass = np.ones((2, n))
    mass[1, -1] = n / 5.0
    stiff = Material(E=2e7, density=1000.0, damping=0.02)
    end = Simulator(body, [stiff] * 2, grippers=[held], mass=mass).run([0.3])[0, :, -1, 2]
    assert end[1] < end[0] - 1e-3


def test_particles_have_their_materials_mass():
    with pytest.raises(ParameterError, match="mass: only rods and shells have points"):
        Simulator(rope(length=0.3, diameter=0.02), [DENSE], mass=2.0, solver=Solver(engine="mpm"))
