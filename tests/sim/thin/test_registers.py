"""Rods whose state CUDA keeps in registers, and those in the lanes of a CPU, move as others."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.materials import Material
from gendom.sim import Cuboid, Gripper, Table, rope
from validation.bench import flat_simulator

TIMES = np.linspace(0.01, 0.2, 20)
TURNS = Rotation.from_rotvec([[0, 0, 0], [0.3, 0.5, 0.1]]).as_quat()


def scene(points, device, dtype, which=(0, 1, 2), boxes=1, **options):
    """A hand that turns and lets go, a later one, a box that turns, and a table; the last of three
    worlds flies apart."""
    body = rope(diameter=0.01, length=0.25, start=(0, 0, 0.03), points=points)
    box = Cuboid(size=(0.15, 0.3, 0.15), friction=0.5, time=[0.05, 0.15], quat_xyzw=TURNS,
                 position=[(0.15, 0, -0.055), (0.12, 0.02, -0.045)])  # fmt: skip
    first = Gripper(time=[0, 0.1], position=[(0.001, 0, 0.03), (0.05, 0.03, 0.1)],
                    quat_xyzw=TURNS, radius=0.03, hold_until=0.12)  # fmt: skip
    later = Gripper(time=[0, 0.05], position=[(0.25, 0, 0.03), (0.24, 0, 0.05)], radius=0.03,
                    hold_from=0.02)  # fmt: skip
    # the second's hand is late: it has other pieces
    early, late = [first, later], [first, replace(later, hold_from=0.026)]
    materials = [Material(E=3e5, damping=0.003), Material(E=8e5, nu=0.2), Material(E=3e5)]
    s = flat_simulator(
        body, [materials[w] for w in which], grippers=[[early, late, early][w] for w in which],
        table=Table(height=0.0, friction=[(0.4, 0.2, 0.4)[w] for w in which]),
        obstacles=[box] * boxes, velocity_damping=1.0, air_density=5.0, engine="thin",
        device=device, dtype=dtype, **options,
    )  # fmt: skip
    v = np.zeros((3, points, 3))
    v[2, :, 0] = np.linspace(-25.0, 25.0, points)
    s.set_velocities(v[list(which)])
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


@pytest.mark.parametrize(("dtype", "bound"), [("float64", 1e-11), ("float32", 2e-5)])
def test_interleaved_rods_move_as_others_whatever_is_beside_them(dtype, bound):
    many = [0, 1, 2, 1, 0, 0, 1] * 3
    one, few = (scene(25, "cpu", dtype, boxes=0, interleaved=of) for of in (False, True))
    together = scene(25, "cpu", dtype, many, boxes=0, interleaved=True)
    x, y, z = (s.run(TIMES, keep_going=True) for s in (one, few, together))
    np.testing.assert_allclose(y, x, rtol=0.0, atol=bound)
    np.testing.assert_array_equal(z, y[:, many])
    assert sorted(together.failures) == [2, 9, 16]
    assert one.failures[2].time == few.failures[2].time == together.failures[9].time
    np.testing.assert_array_equal(together.velocities()[:2], few.velocities()[:2])
    forces = [s.gripper_forces()[:2] for s in (one, few)]
    np.testing.assert_allclose(forces[1], forces[0], rtol=0.0, atol=1e3 * bound)
