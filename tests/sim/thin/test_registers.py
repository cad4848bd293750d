"""Rods whose state CUDA keeps in registers move as those in memory."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.materials import Material
from gendom.sim import Cuboid, Gripper, Table, rope
from validation.bench import flat_simulator

TIMES = np.linspace(0.01, 0.2, 20)
TURNS = Rotation.from_rotvec([[0, 0, 0], [0.3, 0.5, 0.1]]).as_quat()


def scene(points, device, dtype):
    """A hand that turns and lets go, a later one, a box that turns, and a table; the last of three
    worlds flies apart."""
    body = rope(diameter=0.01, length=0.25, start=(0, 0, 0.03), points=points)
    box = Cuboid(size=(0.15, 0.3, 0.15), friction=0.5, time=[0.05, 0.15], quat_xyzw=TURNS,
                 position=[(0.15, 0, -0.055), (0.12, 0.02, -0.045)])  # fmt: skip
    first = Gripper(time=[0, 0.1], position=[(0.001, 0, 0.03), (0.05, 0.03, 0.1)],
                    quat_xyzw=TURNS, radius=0.03, hold_until=0.12)  # fmt: skip
    later = Gripper(time=[0, 0.05], position=[(0.25, 0, 0.03), (0.24, 0, 0.05)], radius=0.03,
                    hold_from=0.02)  # fmt: skip
    s = flat_simulator(
        body, [Material(E=3e5, damping=0.003), Material(E=8e5, nu=0.2), Material(E=3e5)],
        grippers=[first, later], table=Table(height=0.0, friction=0.4), obstacles=[box],
        velocity_damping=1.0, air_density=5.0, engine="thin", device=device, dtype=dtype,
    )  # fmt: skip
    v = np.zeros((3, points, 3))
    v[2, :, 0] = np.linspace(-25.0, 25.0, points)
    s.set_velocities(v)
    return s


@pytest.mark.gpu
@pytest.mark.parametrize("points", [8, 25, 64, 100])
@pytest.mark.parametrize(("dtype", "bound"), [("float64", 1e-9), ("float32", 2e-4)])
def test_rods_in_registers_move_as_those_in_memory(points, dtype, bound):
    expected, found = scene(points, "cpu", dtype), scene(points, "cuda", dtype)
    engine: Any = found.engine
    assert engine.held > 0
    x, y = (s.run(TIMES, keep_going=True)[:, :2] for s in (expected, found))
    np.testing.assert_allclose(y, x, rtol=0.0, atol=bound)
    assert list(found.failures) == list(expected.failures) == [2]
    assert found.failures[2].time == pytest.approx(expected.failures[2].time, abs=1e-3)
