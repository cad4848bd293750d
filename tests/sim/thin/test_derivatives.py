"""Derivatives through whole runs of rods and shells against central differences."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.errors import ParameterError, SimulationError
from gendom.materials import Material
from gendom.sim import Gripper, Rollout, Simulator, cloth, rope
from gendom.sim.thin.step import CHECKED
from sim.thin import shared
from sim.thin.shared import assert_same_derivatives, check_derivatives, check_worlds, scene
from validation.bench import flat_simulator

TIMES = [0.01, 0.03, 0.05, 0.06]

ROPE = rope(diameter=0.012, length=0.2, start=(0, 0, 0.1), direction=(1, 0.1, 0), points=12)
BENT = np.array([[0.2 * t, 0.03 * t * (1 - t), 0.1 + 0.01 * t**2] for t in np.linspace(0, 1, 50)])
CURVED = rope(diameter=0.009, centre_line=BENT, points=12)
CLOTH = cloth(
    width=0.12, height=0.1, thickness=0.004, dx=0.02, corner=(0, 0, 0.1), points=(7, 6), yaw=0.1
)
BODIES = pytest.mark.parametrize("body", [ROPE, CURVED, CLOTH], ids=["rope", "curved", "cloth"])


def given(body, seed=0):
    """Everything that a scene depends on; two grippers, the second one closes later and turns."""
    n, sheet = len(body.points), body.kind == "cloth"
    wave = np.linspace(0, 6, n) if not sheet else 40 * body.points[:, 0] + 20 * body.points[:, 1]
    first, last, up = body.points[0], body.points[-1], np.array([0.003, 0.01, 0.015])
    own: dict[str, Any] = {"warp": 1.1, "weft": 0.9, "shear": 0.8} if sheet else {}
    if body is not ROPE:
        own["membrane"] = 1.5e5
    paths = [[first, first + up, first + 2 * up], [last, last + up, last - 2 * up[::-1]]]
    p = shared.given(
        body, seed, **own, gripper_positions=np.array(paths), gripper_rotations=np.zeros((3, 3)),
        gripper_radius=np.array([0.031, 0.035] if sheet else [0.021, 0.025]),
    )  # fmt: skip
    p["E"] *= 2.0 if sheet else 1.0
    p["positions"] = p["positions"] + np.outer(0.006 * np.sin(wave), (0.0, 0.3, 1.0))
    return p


def table_height(body):
    """Just below the scene's first state."""
    return given(body)["positions"][:, 2].min() - body.thickness / 2.0 - 0.0005


def simulator(body, worlds, below=0.0, **options):
    turns = Rotation.from_rotvec([[0, 0, 0], [0.3, 0.5, 0.1], [0.5, 0.6, -0.3]])

    def hands(p):
        (first, second), radius = p["gripper_positions"], p["gripper_radius"]
        turned = (Rotation.from_rotvec(p["gripper_rotations"]) * turns).as_quat()
        knots = [0, 0.02, 0.05]
        return [
            Gripper(time=knots, position=first, radius=radius[0], hold_until=p.get("opens", 0.045)),
            Gripper(time=knots, position=second, quat_xyzw=turned, radius=radius[1],
                    hold_from=p.get("closes", 0.011)),
        ]  # fmt: skip

    height = table_height(body) - below
    return scene(body, worlds, hands, height, **{"substep": 2e-4, **options})


@pytest.mark.parametrize("body", [CURVED, CLOTH], ids=["curved", "cloth"])
def test_every_derivative_is_that_of_central_differences(body):
    """Of a straight rope among obstacles: `test_obstacles`."""
    p = given(body)
    watched = simulator(body, [p]).run(np.linspace(0.001, 0.06, 60))
    lowest = table_height(body) + body.thickness / 2.0
    assert np.abs(watched[..., 2] - lowest).min() < 1e-9  # something touches the table
    check_derivatives(partial(simulator, body), p, dict.fromkeys(p, 2e-6), TIMES, 2e-6)


@pytest.mark.parametrize("damping", [0.0, 0.01])
def test_a_flat_cloth_resists_shear_from_the_start(damping):
    """Derivatives by the positions of a sheet that is flat, and sheared nowhere."""
    body = cloth(width=0.12, height=0.1, thickness=0.004, dx=0.02, points=(7, 6))
    hand = Gripper(time=[0, 0.05], position=[body.points[0], body.points[0] + 0.002], radius=0.025)
    weights = np.random.default_rng(0).normal(size=(1, 1, len(body.points), 3))
    way = np.random.default_rng(1).normal(size=body.points.shape) * [1.0, 1.0, 0.0]

    def run(positions):
        made = [Material(E=2e5, damping=damping)]
        options = {"grippers": [hand], "positions": positions, "gravity": (0, 0, 0)}
        return Rollout(flat_simulator(body, made, **options))

    rollout = run(body.points)
    rollout.forward([0.004])
    by = np.sum(rollout.backward(weights).positions[0] * way)
    up, down = (run(body.points + h * way).forward([0.004]) for h in (1e-8, -1e-8))
    assert by == pytest.approx(float(np.sum((up - down) * weights)) / 2e-8, rel=1e-5)


@BODIES
def test_worlds_of_a_batch_do_not_see_each_other(body):
    """Grippers close and open at different times, in groups that run in threads."""
    times = [{"closes": 0.004 * seed, "opens": 0.02 + 0.01 * seed} for seed in range(3)]
    worlds = [given(body, seed) | times[seed] for seed in range(3)]
    check_worlds(partial(simulator, body, below=0.02, threads=2), worlds, TIMES)


SHEET = cloth(width=0.2, height=0.2, thickness=0.002, dx=0.02, points=(15, 15))


@pytest.mark.parametrize(
    ("body", "far", "to", "time", "off"),
    [
        # 22 of a rope's 24 edges are between what they hold
        (rope(diameter=0.01, length=0.2), (0.2, 0, 0), (0.4, 0, 0), 22 / 24 * 0.2, 3e-4),
        # mean stretch stays far below 20 %
        (SHEET, (0.2, 0.2, 0), (0.28, 0.28, 0), 0.53, 0.12),
    ],
    ids=["rope", "diagonal of a cloth"],
)
def test_grippers_that_pull_a_body_apart_are_found_at_the_moment(body, far, to, time, off):
    """Though they come back; worlds in which they stay, or let go in time, go on."""
    hold = Gripper.still((0, 0, 0), radius=0.01)
    away = Gripper(time=[0, 1, 1.2], position=[far, to, far], radius=0.01)
    others = [replace(away, hold_until=0.05), Gripper.still(far, radius=0.01)]
    hands = [[hold, other] for other in (away, *others)]
    s = flat_simulator(body, [Material()] * 3, grippers=hands, gravity=(0, 0, 0))
    x = s.run([0.1, 1.2], keep_going=True)
    assert set(s.failures) == {0}
    error = s.failures[0]
    assert "grippers 0 and 1 pull the body apart" in str(error)
    assert error.parameters["E"] == 1e6 and error.time == pytest.approx(time, abs=off)
    assert np.isnan(x[-1, 0]).all() and np.isfinite(x[0]).all() and np.isfinite(x[-1, 1:]).all()
    with pytest.raises(SimulationError, match="pull the body apart"):
        s.run([1.3])


def test_a_stretch_without_grippers_that_pull_is_found_within_a_frame():
    body = rope(diameter=0.01, length=0.2)
    with pytest.raises(ParameterError, match="begins stretched by"):
        Simulator(body, [Material()], positions=1.5 * body.points)
    s = flat_simulator(body, [Material()], gravity=(0, 0, 0), air_density=0.0)
    s.set_velocities(np.linspace([-25, 0, 0], [25, 0, 0], len(body.points)))
    with pytest.raises(SimulationError, match="stretched or compressed by more than 20 %") as e:
        s.run([1.0])
    assert e.value.time is not None and e.value.time < 1.01 * CHECKED * s.engine.setting.substep[0]


@pytest.mark.gpu
@BODIES
def test_cuda_runs_and_differentiates_as_the_cpu_does(body):
    weights = np.random.default_rng(1).normal(size=(len(TIMES), 1, len(body.points), 3))
    found = []
    for device in ("cpu", "cuda"):
        rollout = Rollout(simulator(body, [given(body)], device=device))
        found.append((rollout.forward(TIMES), rollout.backward(weights)))
    np.testing.assert_allclose(found[1][0], found[0][0], rtol=0.0, atol=1e-12)
    assert_same_derivatives(vars(found[1][1]), vars(found[0][1]), rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("body", [ROPE, CLOTH], ids=["rope", "cloth"])
def test_velocities_of_held_points_are_those_of_the_hand(body):
    """A hand that moves and turns; a still one; at last one that has let go."""
    first, last = body.points[0], body.points[-1]
    turns = Rotation.from_rotvec([[0, 0, 0], [0.3, 0.5, 0.1]]).as_quat()
    hands = [
        Gripper(
            time=[0, 0.05], position=[first, first + 0.01], quat_xyzw=turns, radius=0.025,
            hold_until=0.04,
        ),
        Gripper.still(last, radius=0.025),
    ]  # fmt: skip
    s = Simulator(body, [Material(E=3e5, damping=0.002)] * 2, grippers=hands)
    before = s.run([0.02 - 1e-6])
    after = s.run([0.02])
    v = s.velocities()
    engine: Any = s.engine
    moved, still = (engine.holds[:, g] & 1 > 0 for g in (0, 1))
    np.testing.assert_allclose(v[moved], ((after - before)[0] / 1e-6)[moved], rtol=1e-5, atol=1e-6)
    assert np.linalg.norm(v[moved], axis=-1).min() > 0.1
    np.testing.assert_array_equal(v[still], 0.0)
    s.run([0.05])
    assert not engine.holds[:, 0].any() and np.isfinite(s.velocities()).all()
