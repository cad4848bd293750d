"""The promises of the simulator; mechanics are the validation's (``tests/validation``)."""

import numpy as np
import pytest
import warp as wp

from gendom.errors import DeviceError, ParameterError, SimulationError
from gendom.materials import Material
from gendom.sim import (
    Gripper,
    Simulator,
    Solver,
    Table,
    cloth,
    list_devices,
    rope,
    stable_substep,
)
from validation.bench import flat_simulator

SOFT = Material(E=2.0e4, nu=0.3, density=1000.0)
G = 9.81
DX = 0.01


def block(size=(0.04, 0.04, 0.04), corner=(0.003, 0.001, 0.022)):
    """A solid block on cells of 1 cm; ``corner`` is the middle of its edge along z."""
    return cloth(width=size[0], height=size[1], thickness=size[2], dx=DX, corner=corner)


def simulator(body, materials=(SOFT,), **options):
    """A simulator in float64 on one thread and without air, unless told otherwise."""
    defaults = {"dtype": "float64", "threads": 1, "air_density": 0.0, "engine": "mpm"}
    return flat_simulator(body, materials, **{**defaults, **options})


def lifted_rope(materials=(SOFT,), *, cells=1.5, **options):
    """A rope that starts on a table and whose one end is lifted by 10 cm in 0.3 s."""
    body = rope(diameter=0.02, length=0.12, start=(0.0, 0.0, 0.01), cells_across=cells)
    grip = Gripper(time=[0.0, 0.3], position=[(0, 0, 0.01), (0, 0, 0.11)], radius=0.02)
    table = options.pop("table", Table(height=0.0))
    return simulator(body, materials, grippers=[grip], table=table, velocity_damping=2.0, **options)


# ---- equal problems have equal answers -------------------------------------------------------


DIFFERENT = tuple(
    Material(E=E, nu=nu) for E, nu in ((1e4, 0.3), (3e4, 0.2), (1e5, 0.4), (2e4, 0.1), (5e3, 0.0))
)
"""Worlds whose substeps differ, so that they take turns at being the slowest."""


@pytest.mark.gpu
def test_cuda_agrees_with_cpu():
    """A short lift of five worlds on cuda equals the CPU's: 10 um in float32, 1e-9 m in float64."""
    for dtype, bound in (("float32", 1e-5), ("float64", 1e-9)):
        cpu = lifted_rope(DIFFERENT, dtype=dtype).run([0.1, 0.3])
        cuda = lifted_rope(DIFFERENT, dtype=dtype, device="cuda").run([0.1, 0.3])
        assert np.abs(cuda - cpu).max() < bound


def test_two_runs_equal_one():
    """run() to two times equals two run() to one each, bit for bit, time kept."""
    one, two = lifted_rope(), lifted_rope()
    frames = one.run([0.1, 0.17])
    assert np.array_equal(frames[:1], two.run([0.1]))
    assert two.time == 0.1
    assert np.array_equal(frames[1:], two.run([0.17]))
    assert np.array_equal(one.velocities(), two.velocities())
    assert np.array_equal(two.run([0.17]), frames[1:])  # no time passes
    # chosen particles are those of all
    counts = []
    part = lifted_rope().run([0.05, 0.1], particles=[7, 3], on_frame=counts.append)
    assert np.array_equal(part, lifted_rope().run([0.05, 0.1])[:, :, [7, 3]])
    assert counts[-1] == 2 and counts == sorted(counts)


# ---- grid ------------------------------------------------------------------------------------


@pytest.mark.parametrize("cells", [200, -1000])
def test_far_from_the_origin_nothing_changes(cells):
    """Started whole cells away, on a table as far up, the answer only moves along."""
    body = block(corner=(0.003, 0.001, 0.045))
    swing = np.cross([2.0, 3.0, 5.0], body.x - body.x.mean(axis=0))

    def run(shift):
        s = simulator(body.moved(shift), table=Table(height=float(shift[2])))
        s.set_velocities(swing)
        return s.run([0.1, 0.3]) - shift

    here = run(np.zeros(3))
    away = run(DX * np.array([cells, -cells, cells]))
    assert np.abs(away - here).max() < 1e-11
    assert np.abs(here[1] - here[0]).max() > 1e-3


# ---- time steps and failures -----------------------------------------------------------------


def test_substep_is_a_share_of_the_courant_limit():
    """cfl * dx / sqrt((lam + 2 mu) / density), for every world; a given substep overrides it."""
    stiff = Material(E=9.0e4, nu=0.0, density=900.0)  # 10 m/s
    assert stable_substep(stiff, 0.02, cfl=0.3) == pytest.approx(0.3 * 0.02 / 10.0)
    s = Simulator(block(), [stiff, SOFT], solver=Solver(engine="mpm", cfl=0.2))
    assert s.substep[0] == pytest.approx(0.2 * DX / 10.0)
    assert s.substep[1] == pytest.approx(0.2 * DX / SOFT.wave_speed)
    assert Simulator(
        block(), [stiff], solver=Solver(engine="mpm", substep=1e-5)
    ).substep == pytest.approx([1e-5])


def failing(E=1.0e6, substep=1e-3):
    """Two worlds of which the second takes substeps far beyond its limit."""
    body = rope(diameter=0.02, length=0.12, start=(0, 0, 0.05), cells_across=1.5)
    grip = Gripper(time=[0, 0.3], position=[(0, 0, 0.05), (0, 0, 0.15)], radius=0.02)
    materials = [SOFT, Material(E=E, nu=0.4, density=1000.0)]
    return simulator(body, materials, grippers=[grip], substep=substep)


@pytest.mark.parametrize(
    ("E", "substep", "what"),
    [(1.0e6, 1e-3, "velocities grew"), (1.0e5, 1.5e-3, "turned inside out")],
)
def test_divergence_names_its_world(E, substep, what):
    """The error says which world failed, how, when and with what, and which particle if one."""
    s = failing(E, substep)
    with pytest.raises(SimulationError, match=rf"world 1 at 0\.\d+ s .*nu 0\.4.*{what}") as e:
        s.run(np.linspace(0.01, 0.2, 20))
    assert e.value.world == 1
    assert e.value.parameters == {"E": E, "nu": 0.4, "density": 1000.0}
    assert e.value.time is not None and 0.0 < e.value.time < 0.2
    if "particle" not in str(e.value):
        assert e.value.particle is None
    else:
        assert e.value.particle in range(s.body.num_particles)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"materials": []}, "at least one material"),
        ({"table": Table(height=0.0, friction=[0.1, 0.2])}, "friction"),
        ({"positions": np.full((512, 3), np.nan)}, "positions must be finite"),
        ({"materials": [SOFT] * 2, "grippers": [[Gripper.still((0, 0, 0), radius=1)], []]}, "same"),
        ({"materials": [SOFT] * 2, "grippers": [[Gripper.still((0, 0, 0), radius=1)]]}, "world 1"),
    ],
)
def test_arguments_that_do_not_fit(options, words):
    """The error names the argument."""
    body = block()
    assert body.num_particles == 512
    with pytest.raises(ParameterError, match=words):
        simulator(body, options.pop("materials", [SOFT]), **options)


def test_devices():
    """One, names with commas between them, or all GPUs; an error says what to use instead."""
    with pytest.raises(DeviceError, match=r"'cuda:77'.*--device cpu"):
        simulator(block(), device="cuda:77")
    assert list_devices("cpu, cpu") == ["cpu", "cpu"]
    with pytest.raises(DeviceError, match="'cuda:77'"):
        list_devices("cpu,cuda:77")
    if not wp.is_cuda_available():
        with pytest.raises(DeviceError, match="--device cpu"):
            list_devices("all")
