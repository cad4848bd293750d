"""Derivatives through whole simulations against central differences, and the rollout's promises."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.errors import ParameterError, SimulationError
from gendom.materials import Material
from gendom.sim import Gripper, Rollout, Simulator, Solver, Table, cloth, rope
from gendom.sim.mpm import tape as mpm_tape
from gendom.sim.mpm.engine import MpmEngine
from sim.thin.shared import assert_same_derivatives
from validation.bench import flat_simulator

TIMES = [0.015, 0.03]
STEPS = {
    "E": 3e-6, "nu": 3e-6, "density": 3e-6, "friction": 1e-5, "damping": 1e-7,
    "velocity_damping": 1e-4, "air_density": 1e-3, "gravity": 1e-4, "positions": 3e-9,
    "velocities": 1e-6, "stiffness": 1e-5, "gripper_positions": 3e-9, "gripper_rotations": 3e-7,
    "gripper_radius": 3e-8,
}  # fmt: skip
"""Inputs, and steps of differences by them."""
SCALE = {"E": 2.0e5, "density": 1000.0}
TURN = Rotation.from_rotvec([(0.0, 0.0, 0.0), (0.1, 0.3, 0.2), (0.2, -0.1, 0.5)])


def scene(
    *, sheet=False, damped=0.0, dtype="float64", device="cpu", worlds=1, rubs=True, **by
):  # fmt: skip
    """A rope or cloth that slides on its table while a gripper lifts and turns its end, which it
    lets go of; ``by`` moves what goes in."""
    d = {**dict.fromkeys(STEPS, 0.0), **by}
    body = rope(diameter=0.014, length=0.08, start=(0.0, 0.0, 0.0075), cells_across=2.0)
    if sheet:
        body = cloth(width=0.08, height=0.05, thickness=0.004, dx=0.01, corner=(0, -0.02, 0.0025))
    path = np.array([[0.0, 0.0, 0.0072], [0.005, 0.002, 0.02], [0.012, 0.004, 0.03]])
    turned = Rotation.from_rotvec(d["gripper_rotations"] + np.zeros((3, 3))) * TURN
    gripper = Gripper(
        time=[0.0, 0.02, 0.04], position=path + d["gripper_positions"], quat_xyzw=turned.as_quat(),
        radius=0.0132 + d["gripper_radius"], hold_from=0.003, hold_until=0.026,
    )  # fmt: skip
    material = Material(
        E=2.0e5 * (1.0 + d["E"]), nu=0.3 + d["nu"], density=1000.0 * (1.0 + d["density"]),
        damping=damped + d["damping"],
    )  # fmt: skip
    simulator = flat_simulator(
        body, [material] * worlds, grippers=[gripper], stiffness=1.0 + d["stiffness"],
        table=Table(height=0.0, friction=0.3 + d["friction"]) if rubs else None,
        positions=body.x + d["positions"], velocity_damping=2.0 + d["velocity_damping"],
        air_density=30.0 + d["air_density"], gravity=np.array([0.5, 0.2, -9.81]) + d["gravity"],
        engine="mpm", substep=2.0e-4, dtype=dtype, device=device, threads=1,
    )  # fmt: skip
    simulator.set_velocities(np.array([0.3, 0.1, 0.0]) + d["velocities"])
    return simulator


def weights(shape):
    """[...] a fixed random linear loss."""
    return np.random.default_rng(0).standard_normal(shape)


@pytest.mark.parametrize(
    "options",
    [{}, {"damped": 1e-4}, {"sheet": True, "damped": 3e-3}],
    ids=lambda options: " ".join(options) or "elastic",
)
def test_derivatives_by_everything_equal_central_differences(options):
    rollouts = {rubs: Rollout(scene(rubs=rubs, **options)) for rubs in (True, False)}
    bar = weights(rollouts[True].forward(TIMES).shape)
    rollouts[False].forward(TIMES)
    gradients = {rubs: rollout.backward(bar) for rubs, rollout in rollouts.items()}
    r = np.random.default_rng(1)
    for name, h in STEPS.items():
        # a section of the table that begins to slide bends the loss: only friction is asked of it
        rubs = name == "friction"
        found = getattr(gradients[rubs], name)[0]
        if name == "damping" and "damped" not in options:
            assert found == 0.0
            continue
        if name.startswith("gripper"):
            found = found[0]
        direction = r.standard_normal(np.shape(found)) if np.ndim(found) else 1.0
        found = float((found * SCALE.get(name, 1.0) * direction).sum())
        steps = h * np.array([10, 3, 1, 0.3, 0.1, 0.03]) if rubs else (h,)
        errors = []
        for step in steps:
            moved: list[Any] = [{name: sign * step * direction} for sign in (1.0, -1.0)]
            up, down = (
                float((scene(rubs=rubs, **options, **by).run(TIMES) * bar).sum()) for by in moved
            )
            errors.append(found * 2.0 * step / (up - down) - 1.0)
        assert min(map(abs, errors)) < 1e-6, (name, errors)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_segments_of_any_length_recorded_or_repeated_give_the_same_derivatives(dtype, monkeypatch):
    """Repeated substeps to the bit; segments of other lengths are summed in another order."""

    def run():
        one = Rollout(scene(worlds=2, dtype=dtype))
        x = one.forward(TIMES)
        (kept, _), recorded = segments_of(one), [s.recorded for k in segments_of(one) for s in k]
        return x, len(kept), recorded, one.backward(weights(x.shape))

    x, few, recorded, expected = run()
    assert all(recorded) and np.array_equal(x, scene(worlds=2, dtype=dtype).run(TIMES))
    monkeypatch.setattr(mpm_tape, "MEMORY", {"cpu": 0})
    y, _, again, same = run()
    monkeypatch.setattr(mpm_tape, "LONGEST_ON_CPU", 7)
    z, many, _, other = run()
    assert not any(again) and many > 4 * few
    assert np.array_equal(x, y) and np.array_equal(x, z)
    rounding = 1e-5 if dtype == "float32" else 1e-12
    for name in STEPS:
        values = getattr(expected, name)
        assert np.array_equal(getattr(same, name), values), name
        off = np.abs(getattr(other, name) - values).max()
        assert off <= rounding * np.abs(values).max(), name


@pytest.mark.parametrize("engine", ["mpm", "thin"])
def test_a_path_shorter_than_others_keeps_its_derivatives_at_its_own_knots(engine):
    body = rope(diameter=0.014, length=0.05, start=(0.0, 0.0, 0.1), cells_across=2.0)
    short = Gripper(time=[0.0, 0.005], position=[[0.0, 0, 0.1], [0.0, 0, 0.101]], radius=0.01)
    long = Gripper(time=[0.0, 0.01, 0.02, 0.03], position=[[0.05, 0, 0.1]] * 4, radius=0.005)
    made = [Material(E=2e5, nu=0.3, density=1000.0)]
    solver = Solver(engine=engine, dtype="float64")
    rollout = Rollout(Simulator(body, made, grippers=[short, long], solver=solver))
    x = rollout.forward([0.02])
    g = rollout.backward(np.ones_like(x)).gripper_positions
    assert g.shape == (1, 2, 4, 3)
    assert np.all(g[0, 0, 2:] == 0.0)
    assert np.abs(g[0, 0, 1]).max() > 0.1


def test_derivatives_that_overflow_are_an_error():
    rollout = Rollout(scene(dtype="float32"))
    x = rollout.forward([0.03])
    with pytest.raises(SimulationError, match=r"world 0 at 0.03.*derivative by \w+ is not finite"):
        rollout.backward(np.full(x.shape, 1e38))


def test_misuse_is_refused():
    rollout = Rollout(scene())
    with pytest.raises(ParameterError, match="forward before backward"):
        rollout.backward(np.zeros((1, 1, 1, 3)))
    x = rollout.forward([0.001])
    for call, words in (
        (lambda: rollout.forward([0.002]), "make another"),
        (lambda: rollout.backward(x[..., :2]), "positions_bar must be"),
        (lambda: rollout.backward(np.full(x.shape, np.nan)), "positions_bar must be finite"),
        (lambda: Rollout(rollout.simulator), "has not been run"),
    ):
        with pytest.raises(ParameterError, match=words):
            call()


def rollout(*, together=False, **options):
    """A rollout; ``together``: of all worlds at once, as on CUDA."""
    simulator = scene(**options)
    assert isinstance(simulator.engine, MpmEngine)
    simulator.engine.together |= together
    return Rollout(simulator)


def segments_of(rollout):
    return rollout._tape.segments


def test_a_long_rollout_stays_within_its_memory():
    long = rollout()
    x = long.forward([0.4])  # 2,000 substeps
    (kept,) = segments_of(long)
    row = x[0].size // 3 * (15 * 8 + 12)  # x, v, C, and by whom what share is held
    states: list[Any] = [values for segment in kept for values in segment.kept]
    assert sum(values.numpy().nbytes for values in states) == math.ceil(2000 / 64) * row
    assert not any(segment.recorded for segment in kept)


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
@pytest.mark.parametrize(
    "options", [{}, {"sheet": True, "damped": 3e-3}], ids=lambda o: " ".join(o) or "elastic"
)
def test_all_worlds_at_once_have_the_derivatives_of_each(options, device):
    """What a GPU does, which runs on the CPU too, against the CPU's own way."""
    frames, found = [], []
    for where in ({}, {"together": True, "device": device}):
        one = rollout(worlds=2, **where, **options)
        frames.append(one.forward(TIMES))
        found.append(vars(one.backward(weights(frames[0].shape))))
    np.testing.assert_allclose(frames[1], frames[0], rtol=0.0, atol=1e-13)
    assert_same_derivatives(found[1], found[0], rtol=1e-7, atol=1e-9)
