"""Cloths of any outline: what their cells and points are, how they bend, are held and meet."""

import math
from typing import Any

import numpy as np
import pytest

from gendom.errors import ParameterError, SimulationError
from gendom.materials import Material
from gendom.sim import Gripper, Simulator, cloth
from gendom.sim.outlines import Outline
from gendom.sim.thin.engine import ThinEngine
from validation.readings import bending_energy, membrane_energy
from validation.specimens import circle

SHEET: dict[str, Any] = {"thickness": 0.002, "dx": 0.02}
MATERIAL = Material(E=1.0e6, nu=0.3, density=500.0)
SHIRT = [
    (-0.06, 0), (0.06, 0), (0.06, 0.1), (0.12, 0.06), (0.15, 0.1), (0.08, 0.17), (0.03, 0.17),
    (0, 0.15), (-0.03, 0.17), (-0.08, 0.17), (-0.15, 0.1), (-0.12, 0.06), (-0.06, 0.1),
]  # fmt: skip
RING = [circle(0.1), circle(0.035) + np.array([0.02, 0.01])]
L = [(0, 0), (0.3, 0), (0.3, 0.1), (0.1, 0.1), (0.1, 0.3), (0, 0.3)]
SQUARE = [(0, 0), (0.2, 0), (0.2, 0.2), (0, 0.2)]
OUTLINES = pytest.mark.parametrize("outline", [SHIRT, RING, L], ids=["shirt", "ring", "L"])


def part_of(body):
    assert body.cut is not None
    return body.cut


def engine_of(s) -> ThinEngine:
    assert isinstance(s.engine, ThinEngine)
    return s.engine


# ---- cells and points ----------------------------------------------------------------------------


@OUTLINES
@pytest.mark.parametrize("points", [(17, 13), (28, 31)])
def test_mass_and_its_centre_are_those_of_the_outline(outline, points):
    body, shape = cloth(outline=outline, points=points, **SHEET), Outline.of(outline)
    area = part_of(body).area
    assert area.sum() == pytest.approx(shape.area, rel=1e-12)
    assert (area > 0.0).all()
    np.testing.assert_allclose(area @ body.points[:, :2] / shape.area, shape.centre, atol=1e-13)


def test_the_skin_ends_at_the_outline():
    body = cloth(outline=RING, points=(15, 15), **SHEET)
    part, x = part_of(body), body.surface(body.points)
    inside = part.outline.contains(x[:, :2])
    off = np.linalg.norm(part.outline.nearest(x[:, :2]) - x[:, :2], axis=1)
    assert (inside | (off < 1e-12)).all()
    stay = part.outline.contains(body.points[:, :2])
    np.testing.assert_array_equal(x[stay], body.points[stay])
    a, b, c = (x[part.triangles[:, k], :2] for k in range(3))
    areas = 0.5 * np.linalg.det(np.stack([b - a, c - a], axis=1))
    assert areas.min() > 0.0 and areas.sum() == pytest.approx(part.outline.area, rel=0.03)


# ---- mechanics -----------------------------------------------------------------------------------


@OUTLINES
def test_a_sheet_has_the_energies_of_a_plate_and_a_membrane(outline):
    """Rolled about three directions, and stretched."""
    R, body, strain = 0.5, cloth(outline=outline, points=(25, 25), **SHEET), 1e-4
    area, E = part_of(body).outline.area, MATERIAL.E
    for a in np.radians([0.0, 30.0, 45.0]):
        turn = np.array([[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]])
        along, across = turn @ body.points[:, :2].T
        flat = np.stack([R * np.sin(along / R), across], axis=1) @ turn
        x = np.column_stack([flat, R * (1.0 - np.cos(along / R))])
        D = E * 0.002**3 / (12.0 * (1.0 - MATERIAL.nu**2))
        found = bending_energy(Simulator(body, [MATERIAL], positions=x))
        assert found == pytest.approx(0.5 * D * area / R**2, rel=0.01)
    x = body.points * [1.0 + strain, 1.0 - 0.3 * strain, 1.0]
    found = membrane_energy(Simulator(body, [MATERIAL], positions=x))
    assert found == pytest.approx(0.5 * E * strain**2 * area * 0.002, rel=1e-3)


# ---- grippers ------------------------------------------------------------------------------------


def held(body, centre, radius):
    s = Simulator(body, [MATERIAL], grippers=[Gripper.still(centre, radius=radius)])
    s.run([1e-4])
    return np.flatnonzero(engine_of(s).holds[0, 0])


def test_grippers_hold_cloth_only():
    body = cloth(outline=RING, points=(14, 14), **SHEET)
    part, h = part_of(body), part_of(body).spacing[0]
    skin = body.surface(body.points)
    beyond = ~part.outline.contains(body.points[:, :2])
    far = np.argmax(beyond * np.linalg.norm(skin - body.points, axis=1))
    gap = float(np.linalg.norm(skin[far] - body.points[far]))
    assert gap > 0.4 * h
    with pytest.raises(SimulationError, match="closed on nothing"):
        held(body, body.points[far], 0.9 * gap)  # around a point, but not on cloth
    assert far in held(body, body.points[far], 1.2 * gap)
    s = Simulator(body, [MATERIAL], grippers=[Gripper.still(body.points[0], radius=2.5 * h)])
    s.run([1e-4])
    e = engine_of(s)
    # joints at its border are those of points with neighbours on both sides
    assert np.any(e.stiffer[0, 0] != 1.0)
    assert np.all(e.stiffer[0, 0][e.model.shares[4:6] == 0.0] == 1.0)
    for centre, radius in (((0.02, 0.01, 0.0), 0.03), ((0.02, 0.01 + 0.027, 0.0), 0.007)):
        with pytest.raises(SimulationError, match="closed on nothing"):
            held(body, centre, radius)  # in the hole
    # a small sphere on cloth between points holds the nearest one
    for centre in ((-0.05, 0.003, 0.0), (0.0, -0.0995, 0.0), (0.1 + 0.001, 0.0, 0.0)):
        assert 1 <= len(held(body, centre, 0.0015)) <= 2


# ---- outlines -------------------------------------------------------------------------


def test_what_the_lattice_cannot_resolve_is_named():
    neck = [(0, 0), (0.1, 0), (0.1, 0.05), (0.2, 0.05), (0.2, 0), (0.3, 0), (0.3, 0.1), (0.2, 0.1),
            (0.2, 0.056), (0.1, 0.056), (0.1, 0.1), (0, 0.1)]  # fmt: skip
    with pytest.raises(
        ParameterError, match=r"a part of the cloth is only 6.* mm wide, and points are 11.1 mm "
        r"apart; give it 1 spacings: points=\(51, 18\)"
    ):  # fmt: skip
        cloth(outline=neck, **SHEET)
    assert cloth(outline=neck, points=(51, 18), **SHEET).shape == (18, 51)
    legs = [(0, 0), (0.1, 0), (0.1, 0.2), (0.12, 0.2), (0.12, 0), (0.22, 0), (0.22, 0.3), (0, 0.3)]
    with pytest.raises(ParameterError, match="parts of the cloth are only 20 mm apart"):
        cloth(outline=legs, points=(15, 20), **SHEET)
    body = cloth(outline=legs, points=(34, 46), **SHEET)
    assert not np.any((np.abs(body.points[:, 0] - 0.11) < 0.004) & (body.points[:, 1] < 0.19))
    with pytest.raises(ParameterError, match=r"nu of at least -0.67"):
        Simulator(body, [Material(nu=-0.8)])
    # corners and small holes are no narrow parts
    cloth(outline=[[(0, 0), (0.3, 0), (0.15, 0.2)], circle(0.005) + np.array([0.15, 0.1])], **SHEET)
