"""Every runner against a twin of the substep in NumPy, which is written to be read."""

from typing import Any

import numpy as np
import pytest

from gendom.materials import Material
from gendom.sim import Gripper, Table, cloth, rope
from sim.numpy_mpm import NumpyMPM
from validation.bench import flat_simulator

TIMES, SUBSTEP, UP = [0.006, 0.02], 2.0e-4, 0.25


def scene(sheet):
    """A body just above its table, which is gripped, turned and let go."""
    body = rope(diameter=0.014, length=0.08, start=(0.0, 0.0, UP + 0.0071), cells_across=1.5)
    if sheet:
        corner = (0.0, -0.025, UP + 0.0021)
        body = cloth(width=0.08, height=0.05, thickness=0.004, dx=0.01, corner=corner)
    path = np.array([[0.0, 0.0, 0.008], [0.002, 0.002, 0.014], [0.004, 0.004, 0.02]])
    turns = [(0, 0, 0, 1), (-0.05, -0.1, 0.0, -1), (0.0, 0.1, 0.1, 1)]  # of any length and sign
    first = Gripper(
        time=[0.0, 0.01, 0.02], position=path + np.array([0.0, 0.0, UP]), quat_xyzw=turns,
        radius=0.017, hold_from=0.0021, hold_until=0.0151,
    )  # fmt: skip
    other = Gripper.still((0.08, 0.0, UP + 0.007), radius=0.012, hold_from=0.0101)
    return body, {
        "grippers": [first, other], "table": Table(height=UP, friction=0.4),
        "gravity": (0.5, 0.2, -9.81), "velocity_damping": 2.0, "air_density": 30.0,
    }  # fmt: skip


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
@pytest.mark.parametrize(
    ("sheet", "damping"), [(False, 0.0), (False, 3e-3), (True, 1e-4), (True, 3e-3)]
)
def test_every_runner_does_what_the_twin_does(device, sheet, damping):
    body, given = scene(sheet)
    made = Material(E=2.0e5, nu=0.3, density=900.0, damping=damping)
    s = flat_simulator(
        body, [made], engine="mpm", substep=SUBSTEP, dtype="float64", threads=1, device=device,
        **given,
    )  # fmt: skip
    engine: Any = s.engine
    twin = NumpyMPM(body, made, **given)
    v = np.array([0.6, 0.1, -0.2])
    s.set_velocities(v)
    twin.state.v[:] = v
    x, expected = s.run(TIMES)[:, 0], twin.run(TIMES, SUBSTEP)
    assert np.abs(x - expected).max() < 1e-12
    assert np.abs(s.velocities()[0] - twin.state.v).max() < 1e-9
    assert np.abs(engine.state.C.numpy()[0] - twin.state.C).max() < 1e-6
    # the scene has it all: a body that was lifted, touched, rubbed and let go
    assert np.ptp(expected[-1, :, 2]) > np.ptp(body.x[:, 2]) + 1e-4
