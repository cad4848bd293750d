"""Drag of the air: how fast things fall in the end, and where there is none."""

from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from gendom.reality import OBJECTS, Air, Layout, RealCloth, Reality, RealRope

ROPE = cast(RealRope, OBJECTS["rope-cotton"])
CLOTH = cast(RealCloth, OBJECTS["cloth-cotton"])

HALF = 0.5**0.5
TURNED = Layout(origin=(0.3, -0.2, 90.0), along=(HALF, HALF, 0.0), across=(-HALF, HALF, 0.0))


def stiff(item):
    """So stiff that it falls straight or flat."""
    return replace(item, material=replace(item.material, E=1e3 * item.material.E))


def falling(item, density=1.2):
    world = Reality(item, TURNED)
    world.air = Air(item, density)
    return world


def fall_speed(world, seconds):
    """Mean speed downwards in the 20 ms after it has fallen for some time [m/s]."""
    world.step_to(seconds)
    before = world.vertices()
    world.step_to(seconds + 0.02)
    return (before - world.vertices())[:, 2].mean() / 0.02


@pytest.mark.parametrize(
    ("item", "density", "drag", "area"),
    [
        (replace(CLOTH, vertices=13), 0.4, 1.2, CLOTH.side**2),
        (ROPE, 4.8, 1.1, ROPE.diameter * ROPE.length),
    ],
    ids=["cloth", "rope"],
)
def test_what_lies_level_falls_at_its_terminal_speed(item, density, drag, area):
    """sqrt(2 m g / (rho C A))."""
    expected = np.sqrt(2.0 * item.mass * 9.81 / (density * drag * area))
    world = falling(stiff(item), density)
    assert fall_speed(world, 4.0 * expected / 9.81) == pytest.approx(expected, rel=0.03)
    assert np.ptp(world.vertices()[:, 2]) < 0.02


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
    for k in range(1, n + 1):
        empty.step_to(k * step)
        airy.step_to(k * step)
    assert np.all(empty.data.qfrc_applied == 0.0) and np.any(airy.data.qfrc_applied != 0.0)
    fallen = 90.0 - empty.vertices()[:, 2]
    # Symplectic steps: g dt^2 n (n + 1) / 2.
    np.testing.assert_allclose(fallen, 9.81 * step**2 * n * (n + 1) / 2.0, rtol=1e-9)
    assert (90.0 - airy.vertices()[:, 2]).max() < fallen.min()
