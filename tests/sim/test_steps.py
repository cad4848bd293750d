"""Steps of a simulation whose grippers are under control."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.errors import ParameterError, SimulationError
from gendom.materials import STANDARD_GRAVITY, Material
from gendom.sim import Gripper, Physics, Simulator, Solver, Table, Targets, cloth, rope
from gendom.viz.simulation import motion_of

ROPE = rope(length=0.2, diameter=0.012)
CLOTH = cloth(width=0.1, height=0.1, thickness=1e-3, dx=0.02, points=(9, 9))
SOFT = Material(E=5e5, nu=0.3, density=800.0, damping=0.005)
END = ROPE.points[0]


def simulator(*grippers: Gripper, worlds: int = 1, body=ROPE, table: bool = False) -> Simulator:
    below = Table(height=float(body.points[:, 2].min()) - body.contact_radius) if table else None
    return Simulator(body, [SOFT] * worlds, grippers=grippers, table=below)


def still(at=END, **hold) -> Gripper:
    return Gripper.still(at, radius=0.01, **hold)


def above(height: float):
    return END + np.array([0.0, 0.0, height])


@pytest.mark.parametrize(("body", "radius"), [(ROPE, 0.01), (CLOTH, 0.02)])
def test_a_led_gripper_moves_the_body_as_a_known_path_does(body, radius):
    start = body.points[0]
    time, ways = np.array([0.0, 0.03, 0.08]), np.array([[0, 0, 0], [0, 0, 0.02], [0.01, 0, 0.04]])
    turns = Rotation.from_rotvec([[0, 0, 0], [0, 0.4, 0], [0.1, 0.6, 0]])
    known = Gripper(time=time, position=start + ways, quat_xyzw=turns.as_quat(), radius=radius)
    run = simulator(known, worlds=2, body=body).run(time[1:])
    led = simulator(Gripper.still(start, radius=radius), worlds=2, body=body)
    for k in (1, 2):
        ends = Targets(position=[start + ways[k]], quat_xyzw=[turns.as_quat()[k]])
        led.step(time[k] - time[k - 1], ends)
        np.testing.assert_allclose(led.positions(), run[k - 1], atol=1e-12)


def test_the_force_at_a_gripper_is_the_weight_that_hangs():
    upright = Rotation.from_euler("y", 90, degrees=True).apply(ROPE.points - END) + END
    body, damped = ROPE, Material(E=5e5, nu=0.3, density=800.0, damping=0.02)
    hangs = Simulator(body, [damped], grippers=[still()], positions=upright)
    hangs.step(1.0, Targets(position=[END]))
    mass = 800.0 * np.pi * 0.006**2 * 0.2
    assert hangs.gripper_forces()[0, 0] == pytest.approx(
        [0, 0, -9.80665 * mass], rel=2e-3, abs=2e-4
    )
    hangs.step(0.01, Targets(position=[END], closed=[False]))
    assert np.all(hangs.gripper_forces() == 0.0)


def test_grippers_open_and_close_again_in_each_world():
    worlds = simulator(still(), worlds=2)
    worlds.step(0.01, Targets(position=[END], closed=[[True], [False]]))
    held, falls = worlds.positions()[:, 0, 2] - END[2]
    assert held == pytest.approx(0.0, abs=1e-9)
    assert falls == pytest.approx(-0.5 * 9.80665 * 0.01**2, rel=0.05)
    at = worlds.positions()[:, :1]
    worlds.step(0.01, Targets(position=[END], closed=[[False], [True]]))
    moved = worlds.positions()[:, 0] - at[:, 0]
    assert moved[0, 2] < -1e-4
    assert np.abs(moved[1]).max() < 1e-9
    at = worlds.positions()[:, 0]
    worlds.step(0.01, Targets(position=[END], closed=[[True], [True]]))
    np.testing.assert_allclose(worlds.positions()[:, 0], at, atol=1e-9)


def test_what_is_let_go_flies_on_with_the_hand():
    thrown = simulator(still())
    for k in range(1, 11):
        thrown.step(0.002, Targets(position=[above(0.002 * k)]))
    thrown.step(0.002, Targets(position=[above(0.02)], closed=[False]))
    assert thrown.velocities()[0, 0, 2] > 0.8
    # a gripper that stood lets go at rest
    stood, turned = simulator(still()), Rotation.from_rotvec([0.0, 0.2, 0.0]).as_quat()
    there = Targets(position=[above(0.01)], quat_xyzw=[turned])
    stood.step(0.01, there)
    stood.step(0.01)
    stood.step(1e-5, replace(there, closed=[False]))
    assert np.abs(stood.velocities()[0, 0]).max() < 0.05


@pytest.mark.parametrize("interleaved", [False, True])
def test_worlds_step_as_each_does_alone_and_go_on_where_another_ends(interleaved):
    """Each with its own substep; the last one's gripper leaves what it holds behind."""
    materials = [replace(SOFT, E=E) for E in (5e5, 2e6, 8e5)]
    solver = Solver(interleaved=interleaved)

    def led(which):
        made = Simulator(ROPE, [materials[w] for w in which], grippers=[still()], solver=solver)
        for k in range(1, 5):
            ways = np.array([[0.001 * k, 0, 0.002 * k], [0, 0, 0.001 * k], [0, 0, 0.3 * (k > 2)]])
            ends = Targets(position=END + ways[which][:, None])
            made.step(0.005 if k % 2 else 0.003, ends, keep_going=True)
        return made

    together = led([0, 1, 2])
    assert list(together.failures) == [2]
    for w in (0, 1):
        alone = led([w])
        np.testing.assert_array_equal(together.positions()[w], alone.positions()[0])
        np.testing.assert_array_equal(together.velocities()[w], alone.velocities()[0])
    with pytest.raises(SimulationError, match="world 2"):
        together.step(0.005)


def test_steps_begin_anew_with_velocities_that_are_set():
    falls = Simulator(ROPE, [SOFT], grippers=[still()], physics=Physics(air_density=0.0))
    falls.step(0.01, Targets(position=[END], closed=[False]))
    falls.set_velocities([0.0, 0.0, 0.0])
    at = falls.positions().mean(axis=1)
    falls.step(0.002)
    fallen = falls.positions().mean(axis=1) - at
    assert fallen[0, 2] == pytest.approx(-0.5 * STANDARD_GRAVITY * 0.002**2, rel=1e-6)


@pytest.mark.parametrize(
    ("targets", "message"),
    [
        ({"position": [END, END]}, r"targets.position"),
        ({"position": [[0.0, np.nan, 0.0]]}, r"targets.position"),
        ({"position": [END], "quat_xyzw": [[0, 0, 0, 0]]}, "must not be zero"),
        ({"position": [END], "closed": [1]}, "true or false"),
        ({"position": [END], "closed": [True, True]}, "true or false"),
    ],
)
def test_what_does_not_fit_is_refused(targets, message):
    made = simulator(still())
    with pytest.raises(ParameterError, match=message):
        made.step(0.01, Targets(**targets))
    particles = Simulator(ROPE, [SOFT], grippers=[still()], solver=Solver(engine="mpm"))
    for call, words in (
        (lambda: made.step(0.0), "dt"),
        (lambda: setattr(made, "grippers", [still()]), "no grippers that can be set"),
        (lambda: particles.step(0.01), "MPM has no steps"),
    ):
        with pytest.raises(ParameterError, match=words):
            call()
    assert len(motion_of(particles).layers) == 2  # its gripper is drawn all the same
