"""Promises of the MPM: all worlds at once, as a GPU runs them, are each by itself; runs go on where
others ended; failures name their world. Mechanics are the validation's."""

from typing import Any

import numpy as np
import pytest
import warp as wp

from gendom.errors import DeviceError, SimulationError
from gendom.materials import Material
from gendom.sim import Gripper, Table, cloth, list_devices, rope, stable_substep
from gendom.sim.mpm import engine
from validation.bench import flat_simulator, moved

SOFT = Material(E=2.0e4, nu=0.3, density=1000.0)


def simulator(body, materials, **options) -> Any:
    return flat_simulator(
        body, materials, **{"engine": "mpm", "dtype": "float64", "threads": 1, **options}
    )


def together(s):
    """The simulator, which runs all worlds at once as on a GPU."""
    s.engine.together = True
    return s


def scene(**options):
    """Four worlds that differ in all they can; two grippers, a table."""
    body = rope(diameter=0.02, length=0.12, start=(0.0, 0.0, 0.01), cells_across=1.5)
    turn = [(0, 0, 0, 1), (0, 0, 0.2, 1), (0, 0, 0.4, 1)]
    path = [(0.0, 0.0, 0.01), (0.0, 0.01, 0.05), (0.02, 0.0, 0.11)]
    ends = [(0.115, 0, 0.01), (0.11, 0.02, 0.06)]
    materials = [
        SOFT,
        Material(E=5.0e4, nu=0.2, density=1200.0, damping=0.003),
        Material(E=1.0e4, nu=0.4, density=900.0),
        Material(E=1.0e4, nu=0.4, density=900.0, damping=1e-5),
    ]
    return simulator(
        body, materials, velocity_damping=[2.0, 1.0, 0.0, 0.0], air_density=[1.2, 20.0, 0.0, 1.2],
        grippers=[
            Gripper(time=[0, 0.1, 0.3], position=path, quat_xyzw=turn, radius=0.02, hold_until=0.2),
            Gripper(time=[0.0, 0.3], position=ends, radius=0.02, hold_from=0.03),
        ],
        table=Table(height=0.0, friction=[0.2, 0.5, 0.9, 0.3]),
        gravity=[(0, 0, -9.81), (1, 0, -9.81), (0, 2, -5), (0, 2, -5)], **options,
    )  # fmt: skip


def test_two_runs_equal_one():
    """To the bit; no time passes where none does, and chosen particles are those of all."""
    one, two = scene(), scene()
    frames = one.run([0.05, 0.09])
    np.testing.assert_array_equal(scene(threads=4).run([0.05, 0.09]), frames)
    np.testing.assert_array_equal(frames[:1], two.run([0.05]))
    assert two.time == 0.05
    np.testing.assert_array_equal(frames[1:], two.run([0.09]))
    np.testing.assert_array_equal(one.velocities(), two.velocities())
    np.testing.assert_array_equal(two.run([0.09], particles=[7, 3]), frames[1:, :, [7, 3]])


def test_far_from_the_origin_nothing_changes():
    """Started whole cells away, on a table as far up, the answer only moves along."""
    body = cloth(width=0.04, height=0.04, thickness=0.04, dx=0.01, corner=(0.003, 0.001, 0.045))
    swing = np.cross([2.0, 3.0, 5.0], body.x - body.x.mean(axis=0))

    def run(shift):
        s = simulator(moved(body, shift), [SOFT], table=Table(height=float(shift[2])))
        s.set_velocities(swing)
        return s.run([0.1, 0.3]) - shift

    here, away = run(np.zeros(3)), run(0.01 * np.array([-1000, 1000, -1000]))
    assert np.abs(away - here).max() < 1e-11
    assert np.abs(here[1] - here[0]).max() > 1e-3


def test_motion_below_the_last_bit_is_not_lost():
    """In float32 a substep of 1e-8 m vanishes beside 1 m; a hundred together must not."""
    body = rope(diameter=0.02, length=0.06, start=(1.0, 1.0, 1.0), cells_across=1.5)
    s = simulator(body, [SOFT], gravity=(0, 0, 0), dtype="float32")
    drift = np.array([1e-5, -1e-5, 2e-5])
    s.set_velocities(drift)
    x = s.run([0.5])
    assert s.engine.clock.age.numpy()[0] > 100
    moved = x[0, 0].mean(axis=0, dtype=float) - body.x.mean(axis=0)
    np.testing.assert_allclose(moved, 0.5 * drift, rtol=0.02)


@pytest.mark.gpu
@pytest.mark.parametrize(("dtype", "bound"), [("float32", 5e-6), ("float64", 1e-12)])
def test_cuda_moves_worlds_as_the_cpu(dtype, bound):
    times = [0.1, 0.17, 0.25]
    x = scene(dtype=dtype, device="cuda").run(times)
    assert np.abs(x - scene(dtype=dtype).run(times)).max() < bound


def test_launches_may_end_anywhere(monkeypatch):
    """A run in many launches is that in one launch."""
    times = [0.0, *np.linspace(0.01, 0.12, 12), 0.12]
    s, alone = together(scene()), scene()
    whole = s.run(times)
    assert np.abs(whole - alone.run(times)).max() < 1e-12
    assert len(set(s.engine.clock.age.numpy())) == 3 and np.ptp(whole[-1], axis=0).max() > 1e-3
    monkeypatch.setattr(engine, "SUBSTEPS_A_SLICE", 5)
    monkeypatch.setattr(engine, "SLICES", 2)
    s, counts = together(scene()), []
    parts = s.run(times, on_frame=counts.append)
    assert np.abs(parts - whole).max() < 1e-12
    assert counts == [14]
    assert np.abs(s.run([0.15]) - alone.run([0.15])).max() < 1e-12


def test_the_grid_grows():
    body = rope(diameter=0.02, length=0.4, start=(0, 0, -0.2), direction=(0, 0, 1))

    def tipping():
        s = simulator(body, [SOFT], gravity=(0, 0, 0))
        s.engine.room = (8, 8, 400)
        s.set_velocities(np.cross([3.0, 4.0, 0.0], body.x))
        return s

    s = together(tipping())
    x = s.run([0.15, 0.3])
    assert s.engine.room[0] > 20 and s.engine.room[2] > 400
    assert np.abs(x - tipping().run([0.15, 0.3])).max() < 1e-12


@pytest.mark.parametrize("what", ["closed on nothing", "turned inside out"])
def test_a_world_that_fails_leaves_the_others_alone(what):
    """Its time and positions are those at which the substep began that could not be done; later
    runs leave it there."""
    body = rope(diameter=0.02, length=0.06, start=(0.0, 0.0, 0.0), cells_across=1.5)
    bad = Gripper(time=[0.0, 0.1], position=[(0.06, 0, 0), (-0.44, 0, 0)], radius=0.015)
    if what == "closed on nothing":
        bad = Gripper.still((0.5, 0.0, 0.0), radius=0.01, hold_from=0.0051)
    good, jelly = Gripper.still((0.06, 0, 0), radius=0.015), Material(E=1.0, nu=0.3, density=1e3)
    hands, options = [[good], [bad], [good]], {"substep": 1e-3, "gravity": (0, 0, 1)}
    alone, s = (simulator(body, [jelly] * 3, grippers=hands, **options) for _ in range(2))
    x, y = (one.run([0.002, 0.03], keep_going=True) for one in (alone, together(s)))
    assert list(s.failures) == [1] and what in str(s.failures[1])
    assert str(s.failures[1]) == str(alone.failures[1])
    assert np.isnan(y[-1, 1]).all() and np.abs(y - x)[:, [0, 2]].max() < 1e-12
    assert np.ptp(y[:, 0], axis=0).max() > 1e-4
    stopped = s.positions()
    assert np.abs(stopped - alone.positions()).max() < 1e-12
    if what == "closed on nothing":
        assert s.failures[1].time == pytest.approx(0.006)
    s.run([0.04], keep_going=True)
    assert np.array_equal(s.positions()[1], stopped[1])


@pytest.mark.parametrize(
    ("E", "substep", "what"),
    [(1.0e6, 1e-3, "velocities grew"), (1.0e5, 1.5e-3, "turned inside out")],
)
def test_divergence_names_its_world(E, substep, what):
    """The error says which world failed, how, when and with what, and which particle if one."""
    body = rope(diameter=0.02, length=0.12, start=(0, 0, 0.05), cells_across=1.5)
    grip = Gripper(time=[0, 0.3], position=[(0, 0, 0.05), (0, 0, 0.15)], radius=0.02)
    worlds = [SOFT, Material(E=E, nu=0.4, density=1000.0)]
    s = simulator(body, worlds, grippers=[grip], substep=substep, air_density=0.0)
    with pytest.raises(SimulationError, match=rf"world 1 at 0\.\d+ s .*nu 0\.4.*{what}") as e:
        s.run(np.linspace(0.01, 0.2, 20))
    assert e.value.world == 1 and e.value.time is not None and 0.0 < e.value.time < 0.2
    assert e.value.parameters == {"E": E, "nu": 0.4, "density": 1000.0}
    inside_out = what.startswith("turned")
    assert e.value.particle in (range(body.num_particles) if inside_out else [None])


def test_substep_is_a_share_of_the_courant_limit():
    """cfl * dx / sqrt((lam + 2 mu) / density), for every world; a given substep overrides it."""
    stiff = Material(E=9.0e4, nu=0.0, density=900.0)  # 10 m/s
    assert stable_substep(stiff, 0.02, cfl=0.3) == pytest.approx(0.3 * 0.02 / 10.0)
    body = cloth(width=0.04, height=0.04, thickness=0.04, dx=0.01)
    found = simulator(body, [stiff, SOFT], cfl=0.2).substep
    assert found == pytest.approx([0.2 * 0.01 / 10.0, 0.2 * 0.01 / SOFT.wave_speed])


def test_devices():
    """One, names with commas between them, or all GPUs; an error says what to use instead."""
    with pytest.raises(DeviceError, match=r"'cuda:77'.*--device cpu"):
        simulator(rope(diameter=0.02, length=0.06), [SOFT], device="cuda:77")
    assert list_devices("cpu, cpu") == ["cpu", "cpu"]
    for names in ("cpu,cuda:77", *(["all"] if not wp.is_cuda_available() else [])):
        with pytest.raises(DeviceError, match="--device cpu"):
            list_devices(names)
