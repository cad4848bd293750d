"""Scenes that depend on everything, and central differences of losses of them, which jump where a
contact begins or ends in another step."""

from dataclasses import replace

import numpy as np
import pytest

from gendom.materials import Material
from gendom.materials.parameters import OF_THIN
from gendom.sim import Rollout, Simulator, Table
from gendom.sim.thin.engine import ThinEngine
from validation.bench import flat_simulator

SIZES = (0.01, 0.1, 1.0)

OF_MATERIAL = ("E", "nu", "density", "damping", *OF_THIN)
OF_WORLD = ("gravity", "velocity_damping", "air_density", "self_friction", "stiffness", "positions")


def given(body, seed=0, noise=3e-4, **own):
    """Everything that a scene of a body depends on but for grippers."""
    rng, n = np.random.default_rng(seed), len(body.points)
    x, v = body.points + noise * rng.normal(size=(n, 3)), 0.2 * rng.normal(size=(n, 3))
    return {
        "thickness": body.thickness,
        "E": 1e5 if body.kind == "cloth" else 1e6,
        "nu": 0.3,
        "density": 900.0,
        "damping": 0.003,
        "friction": 0.3,
        "gravity": np.array([0.3, 0.2, -30.0]),
        "velocity_damping": 2.0,
        "air_density": 40.0,
        "stiffness": 1.0 + 0.2 * rng.normal(size=n) ** 2,
        "positions": x,
        "velocities": v,
        **own,
    }


def scene(body, worlds, hands, height, **options):
    """A simulator of worlds that depend on dictionaries each: all with the first one's thickness,
    grippers ``hands(world)`` and a table at a height."""

    def every(name):
        values = [world[name] for world in worlds]
        if all(value is values[0] for value in values):  # so that it is looked at once
            return np.broadcast_to(values[0], (len(worlds), *np.shape(values[0])))
        return np.array(values)

    s = flat_simulator(
        replace(body, thickness=float(worlds[0]["thickness"])),
        [Material(**{n: float(w[n]) for n in OF_MATERIAL if n in w}) for w in worlds],
        engine="thin",
        grippers=[hands(world) for world in worlds],
        table=Table(height=height, friction=every("friction")),
        **{name: every(name) for name in OF_WORLD if name in worlds[0]},
        **options,
    )
    s.set_velocities(every("velocities"))
    return s


LENGTHS = ("positions", "gripper_positions", "gripper_radius", "thickness")


def check_derivatives(simulator, p, steps, times, rel, of_lengths: float | None = 2e-8):
    """Assert that derivatives of a random loss are those of central differences.

    Args:
        simulator: Makes a simulator of dictionaries of inputs.
        p: Inputs.
        steps: Of differences by the names of inputs, relative to these.
        times: Of frames [s].
        rel: Allowed relative error.
        of_lengths: Steps of lengths [m], within which nothing may begin to touch or slide in
            another step; None: relative as of others.
    """
    rng, rollout = np.random.default_rng(1), Rollout(simulator([p]))
    x0 = rollout.forward(times)
    weights = rng.normal(size=x0.shape)
    found = rollout.backward(weights)
    for name, share in steps.items():
        h = share * max(np.abs(p[name]).max(), 1e-2)
        h = of_lengths if of_lengths and name in LENGTHS else h
        way = rng.normal(size=np.shape(p[name])) if np.ndim(p[name]) else np.array(1.0)
        changed = lambda by, name=name, way=way: p | {name: p[name] + by * way}  # noqa: E731

        def losses(by, name=name, changed=changed):
            """Of displacements, which are rounded less than positions are."""
            every = [changed(b) for b in by]
            batches = [[one] for one in every] if name == "thickness" else [every]
            x = np.concatenate([simulator(batch).run(times) for batch in batches], axis=1)
            return np.sum((x - x0) * weights, axis=(0, 2, 3))

        by = getattr(found, name)[0]
        by = by[-1] if name == "gripper_rotations" else by  # of the gripper that turns
        expected, rounded = difference(losses, h)
        # differences must tell to 0.1 %
        assert rounded <= 1e-3 * abs(expected), name
        allowed = rounded + rel * abs(expected)
        assert np.sum(by * way) == pytest.approx(expected, abs=allowed), name


def difference(losses, h):
    """Derivative at 0 of losses [S] of changes [S] by central differences, and its uncertainty by
    rounding.

    Short steps are rounded, in inverse proportion; how much is seen where next to nothing changes.
    Long ones cross jumps: the longest, up to 2 h, is taken that differs from all shorter ones by no
    more than those are rounded.
    """
    at = 1e-3 * SIZES[0] * h * np.arange(-3.0, 4.0)
    steps = h * np.outer(SIZES, [1.0, -1.0, 2.0, -2.0])
    loss = losses(np.concatenate([at, steps.ravel()]))
    near = loss[: len(at)]
    noise = 6.0 * np.std(near - np.polyval(np.polyfit(at / h, near, 1), at / h)) / h
    found = []
    for size, (up, down, up2, down2) in zip(SIZES, loss[len(at) :].reshape(-1, 4), strict=True):
        value = (8.0 * (up - down) - (up2 - down2)) / (12.0 * size * h)
        rounded = noise / size
        if any(abs(value - other) > rounded + other_rounded for other, other_rounded in found):
            break
        found.append((value, rounded))
    return found[-1]


def check_worlds(simulator, worlds, times):
    """Assert that each world of a batch moves as it does alone, bit for bit, and has its
    derivatives."""

    def run(chosen):
        rollout = Rollout(simulator(chosen))
        x = rollout.forward(times)
        weights = np.random.default_rng(1).normal(size=(len(times), 1, *x.shape[2:]))
        return x, rollout.backward(np.repeat(weights, len(chosen), axis=1))

    x, together = run(worlds)
    for k, world in enumerate(worlds):
        y, alone = run([world])
        np.testing.assert_array_equal(x[:, k], y[:, 0])
        one = {n: v[k : k + 1] for n, v in vars(together).items() if v is not None}
        assert_same_derivatives(one, vars(alone), rtol=1e-12, atol=0.0)


def assert_same_derivatives(found, expected, rtol, atol):
    """Of dictionaries by inputs; ``atol`` for the largest derivative by each."""
    for name, values in expected.items():
        if values is not None:
            allowed = 1e-20 + atol * np.abs(values).max(initial=0.0)
            np.testing.assert_allclose(found[name], values, rtol, allowed, err_msg=name)


def model_of(body):
    """The shell model of a cloth."""
    engine = Simulator(body, [Material()]).engine
    assert isinstance(engine, ThinEngine)
    return engine.model
