"""Implicit steps of rods: against explicit ones, mechanics on paper, and what they cannot do."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.errors import ParameterError, SimulationError
from gendom.materials import Material
from gendom.sim import Box, Gripper, Rollout, Simulator, Table, cloth, rope

ROPE = rope(diameter=0.01, length=0.3, start=(0, 0, 0.2), points=21)
SOFT = Material(E=2e6, damping=0.005)


def swing(h=None, material=SOFT, body=ROPE, times=(0.1, 0.2, 0.3), **options):
    """By a hand that turns and pulls sideways: bent in two planes, and twisted; positions."""
    t = np.linspace(0.0, 0.5, 11)[:, None]
    hand = Gripper(
        time=t[:, 0],
        position=body.points[0] + np.sin(6.0 * t) * [0.02, 0.05, 0.03],
        quat_xyzw=Rotation.from_rotvec(np.sin(5.0 * t) * [0.8, 0.5, 0.3]).as_quat(),
        radius=0.02,
    )
    if h is not None:
        options |= {"integrator": "implicit", "substep": h}
    given: dict[str, Any] = {"grippers": [hand]} | options
    s = Simulator(body, [material], **given)
    return s, s.run(times)


def test_a_steel_wire_moves_as_in_steps_hundreds_of_times_shorter():
    wire = rope(diameter=0.002, length=0.3, start=(0, 0, 0.2), points=21)
    steel = Material(E=2e11, density=7800.0, damping=2e-4)
    explicit, exact = swing(material=steel, body=wire, times=[0.05, 0.1])
    _, x = swing(0.001, material=steel, body=wire, times=[0.05, 0.1])
    assert explicit.substep[0] < 2e-6
    assert np.abs(x - exact).max() < 1e-4


def test_a_dropped_rope_comes_to_rest_on_table_and_wall():
    line = [(0, 0, 0.1), (0.1, 0.05, 0.12), (0.3, 0, 0.1)]
    body = rope(diameter=0.01, centre_line=line, points=25)
    s = Simulator(
        body, [SOFT], table=Table(height=0.0, friction=0.3), integrator="implicit",
        box=Box(lower=(-0.1, -0.1, 0.0), upper=(0.32, 0.1, 1.0)),
    )  # fmt: skip
    s.set_velocities((1.0, 0.0, 0.0))
    x = s.run(np.linspace(0.02, 1.0, 50))[:, 0]
    assert x[..., 2].min() > 0.005 - 1e-9
    assert x[..., 0].max() < 0.315 + 1e-9 and x[..., 0].max() > 0.3149
    assert np.abs(s.velocities()).max() < 1e-4
    np.testing.assert_allclose(x[-1, :, 2], 0.005, atol=1e-9)


def test_what_a_hand_lets_go_flies_on():
    hand = Gripper(
        time=[0, 0.2], position=[ROPE.points[0], ROPE.points[0] + [0.1, 0, 0.2]], radius=0.02,
        hold_until=0.15,
    )  # fmt: skip
    _, exact = swing(grippers=[hand], cfl=0.1)
    _, x = swing(0.0005, grippers=[hand])
    assert np.abs(x - exact).max() < 5e-4
    assert np.abs(exact[-1] - exact[0]).max() > 0.1


def test_worlds_of_a_batch_do_not_see_each_other():
    worlds = [replace(SOFT, E=E) for E in (1e6, 5e6, 1e9)]
    hand = Gripper(time=[0, 1], position=[(0, 0, 0.2), (0.2, 0, 0.3)], radius=0.02)

    def run(some):
        s = Simulator(ROPE, some, grippers=[hand], integrator="implicit", table=Table(height=0.0))
        return s.run([0.1, 0.4])

    together = run(worlds)
    for w, material in enumerate(worlds):
        np.testing.assert_array_equal(together[:, w], run([material])[:, 0])


def test_what_implicit_steps_cannot_do_is_said():
    def make(body=ROPE, **options):
        return Simulator(body, [SOFT], integrator="implicit", **options)

    with pytest.raises(ParameterError, match="no limit of stability"):
        make(cfl=0.5)
    with pytest.raises(ParameterError, match="contact of a rod with itself"):
        make(self_contact=True)
    with pytest.raises(ParameterError, match="solved in float64"):
        make(dtype="float32")
    with pytest.raises(ParameterError, match="MPM has no implicit steps"):
        make(engine="mpm")
    with pytest.raises(ParameterError, match="shells have no implicit steps"):
        make(cloth(width=0.1, height=0.1, thickness=0.002, dx=0.02))
    with pytest.raises(ParameterError, match="unknown integrator 'midpoint'"):
        Simulator(ROPE, [SOFT], integrator="midpoint")


def test_a_recording_that_is_too_large_is_refused():
    s = Simulator(ROPE, [SOFT] * 40, integrator="implicit", substep=1e-4)
    with pytest.raises(ParameterError, match="the steps of 40 worlds would be recorded in"):
        Rollout(s).forward([10.0])


def test_a_rope_pulled_apart_ends_with_an_error():
    hands = [
        Gripper.still(ROPE.points[0], radius=0.01),
        Gripper(
            time=[0, 1], position=[ROPE.points[-1], ROPE.points[-1] + [0.3, 0, 0]], radius=0.01
        ),
    ]
    s = Simulator(ROPE, [SOFT], grippers=hands, integrator="implicit")
    with pytest.raises(SimulationError, match="grippers 0 and 1 pull the body apart") as e:
        s.run([1.0])
    assert e.value.time == pytest.approx(0.2 * 0.28 / 0.3, abs=0.01)
