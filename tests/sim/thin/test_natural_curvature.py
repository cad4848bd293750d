"""Rods that are straight by nature although they begin curved."""

import numpy as np
import pytest

from gendom.errors import ParameterError
from gendom.materials import Material
from gendom.sim import Physics, Simulator, cloth, rope

MATERIAL = Material(E=1e6, nu=0.3, density=1000.0, damping=0.02)


def test_a_rod_takes_on_its_share_of_the_curvature():
    """In free space an arc of 1 rad straightens to half of that, and wholly."""
    turn = np.linspace(0.0, 1.0, 60)
    arc = 0.2 * np.stack([np.sin(turn), 1.0 - np.cos(turn), 0.0 * turn], axis=1)
    simulator = Simulator(
        rope(diameter=0.01, centre_line=arc, points=13),
        [MATERIAL] * 3,
        natural_curvature=[1.0, 0.5, 0.0],
        physics=Physics(gravity=(0.0, 0.0, 0.0), velocity_damping=2.0),
    )
    ahead = np.diff(simulator.run([1.5])[0], axis=1)
    ends = ahead[:, [0, -1]] / np.linalg.norm(ahead[:, [0, -1]], axis=2, keepdims=True)
    turned = np.arccos(np.clip((ends[:, 0] * ends[:, 1]).sum(axis=1), -1.0, 1.0))
    assert turned / turned[0] == pytest.approx([1.0, 0.5, 0.0], abs=0.05)


def test_sheets_have_none():
    with pytest.raises(ParameterError, match="only rods may begin with stress"):
        Simulator(
            cloth(width=0.1, height=0.1, thickness=1e-3, dx=0.01), [MATERIAL], natural_curvature=0.0
        )
