"""The second reality: holding, letting go, looking, and what it refuses."""

import math
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from gendom.errors import SimulationError
from gendom.installation import how_to_install
from gendom.materials import STANDARD_GRAVITY
from gendom.reality import OBJECTS, Layout, RealCloth, Reality, RealObject, RealRope

COTTON = cast(RealRope, OBJECTS["rope-cotton"])


def lying(item: RealObject = COTTON) -> Layout:
    return Layout(origin=(0.35, 0.0, item.radius))


def masses(item):
    """[V] what MuJoCo moves [kg]."""
    world = Reality(item, lying(item))
    model, bodies = world.model, world.model.flex_vertbodyid
    assert model.body_subtreemass[0] == pytest.approx(item.mass)
    return model.body_mass[bodies]


def test_vertices_weigh_what_they_stand_for():
    """Inner ones an edge, ends half of one."""
    m = masses(COTTON)
    edge = COTTON.mass / (COTTON.vertices - 1)
    assert m[1:-1] == pytest.approx(edge) and m[[0, -1]] == pytest.approx(edge / 2.0)
    # a third of each triangle's mass sits in each of its vertices
    cloth = replace(cast(RealCloth, OBJECTS["cloth-cotton"]), vertices=13)
    m = masses(cloth)
    points, triangles = cloth.sheet
    a, b, c = points[triangles.T]
    third = np.abs(np.linalg.det(np.stack([b - a, c - a], axis=-1))) / 6.0
    expected = np.zeros(len(points))
    np.add.at(expected, triangles, third[:, None])
    assert m == pytest.approx(cloth.material.density * cloth.thickness * expected)


@pytest.mark.parametrize("name", ["rope-cotton", "cloth-rubber-200mm"])
def test_friction_is_coulombs(name):
    """On a slope objects stick below atan(mu) and slide at g (sin a - mu cos a) above."""
    item = OBJECTS[name]
    ways = []
    for share in (0.8, 1.5):
        slope = share * np.arctan(item.friction)
        with Reality(item, lying(item)) as world:
            world.model.opt.gravity[:] = 9.81 * np.array([np.sin(slope), 0.0, -np.cos(slope)])
            x = world.vertices()
            world.step_to(world.time + 0.2)
            ways.append((world.vertices() - x)[:, 0].mean())
    assert abs(ways[0]) < 5e-4
    expected = 9.81 * (np.sin(slope) - item.friction * np.cos(slope)) * 0.2**2 / 2.0
    assert ways[1] == pytest.approx(expected, rel=0.05)


SAG = 0.02
"""Sag in lengths for which the modulus is chosen: stiff enough for small deflections. A flex's
resistance to bending scales with its modulus, so it is the discretisation that is checked."""


def test_a_rope_sags_as_a_beam():
    """w L^4 / (8 E I) (Timoshenko, "Strength of Materials") of one that is free from half an edge
    before its last pinned vertex: counted from that vertex it would sag by 13 % more than theory,
    from the vertex before by 11 % less."""
    rope = COTTON
    free = rope.length - rope.spacing / 2.0
    rigidity = rope.material.E * math.pi * rope.diameter**4 / 64.0
    soft = rope.mass * STANDARD_GRAVITY / rope.length * free**4 / (8.0 * rigidity)
    # damped, so that the first mode comes to rest within a second or so
    E = rope.material.E * soft / (SAG * rope.length)
    stiff = replace(rope, material=replace(rope.material, E=E, damping=0.02))
    world = Reality(stiff, Layout(origin=(0.0, 0.0, 0.5), clamped=1e-6))
    world.step_to(1.0)
    height = world.vertices()[:, 2]
    # without the rotation of the clamp itself
    turned = (height[1] - height[0]) / rope.spacing * (rope.length - rope.spacing)
    sag = height[1] - height[-1] + turned
    assert sag == pytest.approx(SAG * rope.length, rel=0.005)
    assert np.all(np.diff(height[1:]) < 0.0)


def test_the_hand_is_where_its_path_has_it_at_every_step():
    x = []
    for goes in (1, 50):
        world = Reality(COTTON, lying())
        start = world.vertices()[-1]
        world.follow(lambda t, start=start: start + np.multiply.outer(t, [0.0, 0.0, 0.4]))
        world.step_to(0.001)
        world.attach()
        for time in np.linspace(0.001, 0.0135, goes + 1)[1:]:
            world.step_to(time)
        x.append(world.vertices())
    assert x[0][-1, 2] - start[2] > 0.003
    np.testing.assert_array_equal(*x)


def test_a_hand_that_closes_on_nothing_says_how_far_off_it_is():
    world = Reality(COTTON, lying())
    world.follow(lambda t: (0.35, 0.0, 0.108))
    world.step_to(0.01)
    with pytest.raises(SimulationError, match=r"100\.\d mm away"):
        world.attach()


def test_what_is_not_there_is_named(run_python):
    """A backend, with the reason that it gave when mujoco was imported, and Gymnasium; physics runs
    without them."""
    code = (
        "import os, sys; os.environ['MUJOCO_GL'] = 'nothing'; sys.modules['gymnasium'] = None\n"
        "from gendom.reality import *\n"
        "rope = find_object('rope-cotton')\n"
        "layout = Layout(origin=(0.35, 0.0, rope.radius))\n"
        "world = Reality(rope, layout, cameras=default_cameras())\n"
        "world.step_to(0.01)\n"
        "for of in 'world.render(0)', 'import gendom.reality.envs':\n"
        " try: exec(of)\n except Exception as e: print(type(e).__name__, e)"
    )
    backend, gymnasium = run_python(code).split("\n")
    assert backend.startswith("DeviceError rendering, MUJOCO_GL=nothing: no OpenGL context (")
    assert "invalid value" in backend and "libegl1" in backend and "libosmesa6" in backend
    assert gymnasium.startswith("DeviceError") and how_to_install("reality") in gymnasium


def test_a_world_that_diverges_is_told_and_leaves_no_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    world = Reality(COTTON, lying())
    world.data.qvel[0] = 1e30
    with pytest.raises(SimulationError, match="the second reality diverged"):
        world.step_to(0.01)
    assert list(tmp_path.iterdir()) == []  # MuJoCo would write MUJOCO_LOG.TXT
