"""Twist of ropes: its angle, its forces, and when a twisted rope buckles."""

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.reality import OBJECTS, Layout, Reality, RealRope
from gendom.reality.twist import Twist, torsion_rigidity

COTTON = cast(RealRope, OBJECTS["rope-cotton"])


def crooked(n=9, seed=0):
    """[n, 3] vertices of a rod that bends in all directions."""
    rng = np.random.default_rng(seed)
    return 0.02 * np.cumsum(rng.normal([1.0, 0.0, 0.0], 0.4, (n, 3)), axis=0)


def test_a_straight_rod_s_moment_is_that_of_torsion():
    """GJ angle / L, over several turns, and a damping that is worth its time."""
    n = COTTON.vertices
    x = np.column_stack([np.linspace(0.0, COTTON.length, n), np.zeros(n), np.zeros(n)])
    rod = Twist(COTTON, x, first=0, last=n - 2, rotation=np.eye(3))
    spacing = COTTON.length / (n - 1)
    stiffness = torsion_rigidity(COTTON) / (COTTON.length - spacing)
    for angle in np.arange(0.0, 10.0, 0.5):
        turned = Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix()
        _, moving = rod.load(x, turned, 1e-3)
        forces, still = rod.load(x, turned, 1e-3)
        assert rod.angle == pytest.approx(angle)
        assert still == pytest.approx([-stiffness * angle, 0.0, 0.0])
        if angle > 0.0:
            rate = -stiffness * COTTON.material.damping * 0.5 / 1e-3
            assert moving[0] - still[0] == pytest.approx(rate)
        np.testing.assert_allclose(forces, 0.0, atol=1e-12)
    # forces neither push nor turn the whole
    x = crooked(COTTON.vertices)
    rod = Twist(COTTON, x, first=1, last=COTTON.vertices - 3, rotation=np.eye(3))
    edges = np.diff(x, axis=0)
    along = edges[COTTON.vertices - 3] / np.linalg.norm(edges[COTTON.vertices - 3])
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
    rope = replace(COTTON, material=replace(COTTON.material, damping=1e-4))
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
