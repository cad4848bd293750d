"""Derivatives through contact of rods and shells with themselves against central differences.

A difference is right where each contact begins, sticks and ends in the same step on both its sides.
The scenes are therefore irregular and short, 200 steps with contact in the last 100 of them, and
changes small. How small depends on what is changed, see ``shared``.
"""

from functools import partial

import numpy as np
import pytest

from gendom.sim import Gripper, cloth, rope
from sim.thin import shared
from sim.thin.shared import check_derivatives, check_worlds, scene

TIMES = [0.01, 0.02, 0.025, 0.03]
FIRST = [0.00415, 0.0043]
"""When a faster cloth has been in contact for a few steps."""


def crossed_rope():
    """A loop whose ends cross, one above the other."""
    turn = np.linspace(-1.3, 1.3, 300) * np.pi
    line = np.stack([0.05 * np.sin(turn), 0.05 * np.cos(turn), 0.0018 * turn + 0.1], axis=1)
    return rope(diameter=0.01, centre_line=line, points=26)


def folded_cloth(skew, slide):
    """A sheet, and its points when it is bent by half a turn, with its upper half slid aside."""
    body = cloth(
        width=0.13, height=0.1, thickness=0.005, dx=0.02, corner=(0, 0, 0.1), points=(12, 9)
    )
    x, radius = body.points.copy(), 0.0075
    n = np.array([np.cos(skew), np.sin(skew), 0.0])
    beyond = (x - x.mean(axis=0)) @ n
    on = np.clip(beyond / radius, 0.0, np.pi)
    along = np.where(beyond > np.pi * radius, np.pi * radius - beyond, radius * np.sin(on))
    bent = x + np.where(beyond > 0.0, along - beyond, 0.0)[:, None] * n
    bent[:, 2] += radius * (1.0 - np.cos(on))
    bent[:, 1] += slide * on / np.pi
    return body, bent


ROPE = crossed_rope()
CLOTH, FOLDED = folded_cloth(0.23, 0.0)


def given(body, self_friction, seed=0, points=None, noise=2e-4):
    """Everything that a scene depends on; the first gripper stays and lets go while
    the second pushes down."""
    sheet = body.kind == "cloth"
    p = shared.given(body, seed, noise, self_friction=self_friction)
    if sheet:
        p["positions"] = p["positions"] - body.points + (FOLDED if points is None else points)
    x = p["positions"]
    p["velocities"] *= noise / 8e-4
    p["velocities"][:, 2] -= 0.6 * (x[:, 2] > x[:, 2].mean())
    low, high = (x[0], x[11]) if sheet else (x[0], x[-1])
    down, on = np.array([[0.004, 0.006, -0.009], [0.006, 0.01, -0.01]])
    paths = [[low, low + 0.1 * down, low], [high, high + down, high + on]]
    return p | {"gripper_positions": np.array(paths), "gripper_radius": np.array([0.021, 0.017])}


def simulator(body, worlds, **options):
    lowest = (FOLDED if body.kind == "cloth" else body.points)[:, 2].min()

    def hands(p):
        given = zip(p["gripper_positions"], p["gripper_radius"], (0.0213, 1.0), strict=True)
        return [
            Gripper(time=[0, 0.025, 0.05], position=path, radius=radius, hold_until=until)
            for path, radius, until in given
        ]

    options = {"self_contact": True, "substep": 1.5e-4, **options}
    return scene(body, worlds, hands, lowest - body.thickness / 2.0 - 0.002, **options)


STEPS = {"thickness": 2e-8, "positions": 2e-8, "gripper_positions": 2e-8, "self_friction": 2e-5}
"""Relative steps where they are not 2e-6: shorter where they move points at once."""


def check(body, p, names, times=TIMES, rel=1e-6, **options):
    steps = {name: STEPS.get(name, 2e-6) for name in names}
    check_derivatives(partial(simulator, body, **options), p, steps, times, rel, of_lengths=None)


SCENES = pytest.mark.parametrize(
    ("body", "self_friction"), [(ROPE, 0.2), (ROPE, 3.0), (CLOTH, 0.2)],
    ids=["rope-slides", "rope-sticks", "cloth-slides"],
)  # fmt: skip
BY = ("density", "self_friction", "velocities", "positions")
"""What moves contacts in each way; the other inputs are known from scenes that slide or stick."""


@SCENES
def test_derivatives_are_those_of_central_differences(body, self_friction):
    p = given(body, self_friction)
    check(body, p, p if self_friction > 1.0 else BY)


def touching(self_friction, skew, slide, noise):
    """A faster cloth: deep contacts of many points at once."""
    _, x = folded_cloth(skew, slide)
    p = given(CLOTH, self_friction, points=x, noise=noise)
    p["velocities"] += 2.0 * np.outer(x[:, 2] > x[:, 2].mean(), [0.1, 0.05, -1.0])
    return p


@pytest.mark.parametrize("self_friction", [0.2, 5.0])
@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def test_first_touches_are_differentiated(self_friction, device):
    p, rel = touching(self_friction, 0.23, 0.0, 2e-4), 1e-6 if device == "cpu" else 1e-5
    check(CLOTH, p, BY, times=FIRST, rel=rel, device=device)


def test_nearly_parallel_edges_are_differentiated():
    p = touching(5.0, 0.0, 0.0041, 2e-6) | {"stiffness": np.ones(len(CLOTH.points))}
    check(CLOTH, p, BY, times=FIRST)


@pytest.mark.gpu
@SCENES
def test_cuda_differentiates_its_own_contacts(body, self_friction):
    """They are added up in any order there, so that runs differ by rounding."""
    p = given(body, self_friction)
    check(body, p, p, device="cuda", rel=1e-4)


@SCENES
def test_these_scenes_have_contact_with_friction(body, self_friction):
    p = given(body, self_friction)
    x = simulator(body, [p, p | {"self_friction": 0.0}, p | {"self_friction": 1e9}]).run(TIMES)[2]
    passes = simulator(body, [p], self_contact=False).run(TIMES)[2]
    for other, least in ((passes[0], 1e-5), (x[1], 1e-5), (x[2], 1e-6)):
        assert np.abs(other - x[0]).max() > least


def test_worlds_do_not_see_each_others_contacts():
    """Worlds of one launch share memory for their contacts."""
    worlds = [given(ROPE, mu, seed) for seed, mu in enumerate((0.2, 5.0, 0.0))]
    check_worlds(partial(simulator, ROPE), worlds, TIMES)
