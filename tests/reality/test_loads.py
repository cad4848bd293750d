"""Loads on vertices: drag of the air; twist of ropes, and when a twisted rope buckles."""

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.reality import OBJECTS, Air, Layout, RealCloth, Reality, RealRope
from gendom.reality.twist import Twist

ROPE = cast(RealRope, OBJECTS["rope-cotton"])
CLOTH = cast(RealCloth, OBJECTS["cloth-cotton"])

HALF = 0.5**0.5
TURNED = Layout(origin=(0.3, -0.2, 90.0), along=(HALF, HALF, 0.0), across=(-HALF, HALF, 0.0))


def falling(item, density=1.2):
    world = Reality(item, TURNED)
    world.air = Air(item, density)
    return world


@pytest.mark.parametrize("vertices", [5, 16])
@pytest.mark.parametrize("tilt", [0.0, 0.6])
def test_only_what_goes_across_counts(vertices, tilt):
    """A rope and a sheet that are tilted and move as a whole, however finely they are divided."""
    rope, cloth = replace(ROPE, vertices=vertices), replace(CLOTH, vertices=vertices)
    along = np.array([np.cos(tilt), 0.0, np.sin(tilt)])
    normal = np.array([-np.sin(tilt), 0.0, np.cos(tilt)])
    sheet = cloth.sheet[0] @ np.stack([along, [0.0, 1.0, 0.0]])
    for item, x, drag_area in ((rope, sheet[::vertices], 1.1 * rope.diameter * rope.length),
                               (cloth, sheet, 1.2 * cloth.side**2)):  # fmt: skip
        falls, slides = np.zeros_like(x) - [0.0, 0.0, 2.0], np.zeros_like(x) + 3.0 * along
        size = 0.5 * 1.2 * drag_area * (2.0 * np.cos(tilt)) ** 2
        total = Air(item).forces(x, falls).sum(axis=0)
        np.testing.assert_allclose(total, size * normal, atol=1e-12)
        np.testing.assert_allclose(Air(item).forces(x, slides), 0.0, atol=1e-12)


@pytest.mark.parametrize("item", [ROPE, replace(CLOTH, vertices=13)], ids=["rope", "cloth"])
def test_without_air_things_fall_freely(item):
    """Also beside a world that has air, stepped by turns."""
    empty, airy = falling(item, 0.0), falling(item)
    step = empty.model.opt.timestep
    n = round(0.4 / step)
    dofs = airy.model.body_dofadr[airy.model.flex_vertbodyid][:, None] + np.arange(3)
    for k in range(1, n + 1):
        x, v = airy.vertices(), airy.data.qvel[dofs]
        empty.step_to(k * step)
        airy.step_to(k * step)
    assert np.all(empty.data.qfrc_applied == 0.0)
    pull = airy.data.qfrc_applied[dofs]
    np.testing.assert_allclose(pull, Air(item).forces(x, v), atol=1e-6 * np.abs(pull).max())
    fallen = 90.0 - empty.vertices()[:, 2]
    # Symplectic steps: g dt^2 n (n + 1) / 2.
    np.testing.assert_allclose(fallen, 9.81 * step**2 * n * (n + 1) / 2.0, rtol=1e-9)
    assert (90.0 - airy.vertices()[:, 2]).max() < fallen.min()


def crooked(n=9, seed=0):
    """[n, 3] vertices of a rod that bends in all directions."""
    rng = np.random.default_rng(seed)
    return 0.02 * np.cumsum(rng.normal([1.0, 0.0, 0.0], 0.4, (n, 3)), axis=0)


def test_a_straight_rod_s_moment_is_that_of_torsion():
    """GJ angle / L, over several turns, and a damping that is worth its time."""
    n = ROPE.vertices
    x = np.column_stack([np.linspace(0.0, ROPE.length, n), np.zeros(n), np.zeros(n)])
    rod = Twist(ROPE, x, first=0, last=n - 2, rotation=np.eye(3))
    spacing = ROPE.length / (n - 1)
    GJ = ROPE.material.E / (2.0 * (1.0 + ROPE.material.nu)) * np.pi * ROPE.diameter**4 / 32.0
    stiffness = GJ / (ROPE.length - spacing)
    for angle in np.arange(0.0, 10.0, 0.5):
        turned = Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix()
        _, moving = rod.load(x, turned, 1e-3)
        forces, still = rod.load(x, turned, 1e-3)
        assert rod.angle == pytest.approx(angle)
        assert still == pytest.approx([-stiffness * angle, 0.0, 0.0])
        if angle > 0.0:
            rate = -stiffness * ROPE.material.damping * 0.5 / 1e-3
            assert moving[0] - still[0] == pytest.approx(rate)
        np.testing.assert_allclose(forces, 0.0, atol=1e-12)
    # forces neither push nor turn the whole
    x = crooked(ROPE.vertices)
    rod = Twist(ROPE, x, first=1, last=ROPE.vertices - 3, rotation=np.eye(3))
    edges = np.diff(x, axis=0)
    along = edges[ROPE.vertices - 3] / np.linalg.norm(edges[ROPE.vertices - 3])
    turned = Rotation.from_rotvec(0.3 * along).as_matrix()
    rod.load(x, turned, 1e-3)
    forces, moment = rod.load(x, turned, 1e-3)
    assert np.abs(forces[[0, -1]]).max() == 0.0 and np.abs(forces).max() > 1e-3
    np.testing.assert_allclose(forces.sum(axis=0), 0.0, atol=1e-12)
    start = edges[1] / np.linalg.norm(edges[1]) * np.linalg.norm(moment)
    total = np.cross(x, forces).sum(axis=0) + moment + start
    np.testing.assert_allclose(total, 0.0, atol=1e-12)


@pytest.mark.parametrize(("share", "buckles"), [(0.95, False), (1.05, True)])
def test_a_clamped_rod_buckles_at_greenhill_s_moment(share, buckles):
    """Twisted between two clamps a straight rod buckles at M L / (E I) = 8.987.

    Source: Timoshenko and Gere, "Theory of Elastic Stability", section 2.21: tan(x / 2) = x / 2.
    With M = GJ m / L and E I / GJ = 1 + nu that is a twist of 8.987 (1 + nu).
    """
    rope = replace(ROPE, material=replace(ROPE.material, damping=1e-4))
    layout = Layout(origin=(0.0, 0.0, 0.5), clamped=1e-6)
    world = Reality(rope, layout)
    world.model.opt.gravity[:] = 0.0
    world.follow(lambda _: (rope.length, 0.0, 0.5))
    world.step_to(0.01)
    world.attach(1e-3)
    critical = 8.987 * (1.0 + rope.material.nu)
    for angle in np.linspace(0.0, share * critical, 60):
        quat = Rotation.from_rotvec([angle, 0.0, 0.0]).as_quat(scalar_first=True)
        world.data.mocap_quat[0] = quat
        world.step_to(world.time + 0.002)
    assert world._twist is not None
    assert world._twist.angle == pytest.approx(share * critical, rel=1e-3)
    middle = world.model.body_dofadr[world.model.flex_vertbodyid[rope.vertices // 2]]
    world.data.qvel[middle + 1] += 1e-6

    def sideways():
        return np.abs(world.vertices()[:, 1:] - [0.0, 0.5]).max()

    world.step_to(world.time + 0.1)
    before = sideways()
    world.step_to(world.time + 0.4)
    assert (sideways() > 10.0 * before) == buckles
