"""Twins for Newton 1.8: a rope as a rod of rigid segments, a cloth as a shell, by its VBD solver.

A sheet's hinges. With squares halved along one diagonal and the other by turns, a hinge of energy
k l theta^2 / 2 over a side of length h sees the angle h w_xx, one over a diagonal sqrt(2) h w_xy.
In the terms of `gendom.reality.objects` that is a = k_side h and g a / 2 = sqrt(2) k_diagonal h; a
plate's rigidity D in every direction needs g = 2 and a = 4 D / 3, so k_side = 4 D / (3 h) and
k_diagonal = k_side / sqrt(2).
"""

import math
from typing import Any

import numpy as np

from gendom.arrays import Array
from gendom.materials import STANDARD_GRAVITY, Cloth, Item, size_of
from gendom.reality.model import SHEET_STRETCH
from gendom.twins.lift import Lift, segment_points, sheet_points

SCRIPT = "newton_lift.py"

SEGMENTS, SIDE = 16, 33
"""Segments of a rope, and points along a cloth's side. VBD's iterations do not reach what 32 stiff
segments need: a rope of polyethylene then bends as if it were softer."""

STEP, ITERATIONS = 1e-3, 20
"""Time step [s] and iterations a step of the solver."""


def written(item: Item) -> tuple[Lift, dict[str, str], Array, dict[str, Any]]:
    """The lift, text files by name, the places [M, 3] at rest that are compared [m] (middles of a
    rope's segments or a cloth's vertices), and arrays for the script."""
    lift, m = Lift(item=item, edge=size_of(item) / SEGMENTS), item.material
    common = {"kind": item.kind, "friction": item.friction, "damping": m.damping}
    common |= {"step": STEP, "iterations": ITERATIONS}
    if isinstance(item, Cloth):
        places, triangles = sheet_points(lift, SIDE)
        return lift, {}, places, common | sheet_of(item, places, triangles, lift.hold)
    places, length = segment_points(lift, SEGMENTS), item.length / SEGMENTS
    along = np.linspace(0.0, item.length, SEGMENTS + 1)
    nodes = along[:, None] * [1.0, 0.0, 0.0] + [0.0, 0.0, lift.height]
    area, second = math.pi * item.diameter**2 / 4.0, math.pi * item.diameter**4 / 64.0
    rod = {
        "nodes": nodes,
        "held": round(lift.hold / length + 0.5),
        "radius": item.diameter / 2.0,
        "mass": m.density * area * length,
        "EI": m.E * second,
        "GJ": m.E / (1.0 + m.nu) * second,
        "EA": m.E * area,
    }
    return lift, {}, places, common | rod


def sheet_of(item: Cloth, places: Array, triangles: Any, hold: float) -> dict[str, Any]:
    """A sheet of triangles over a square lattice, and how stiff it is in its plane and at its
    hinges."""
    m, h = item.material, item.side / (math.isqrt(len(places)) - 1)
    D = m.E * item.thickness**3 / (12.0 * (1.0 - m.nu**2))
    weight = m.density * item.thickness * STANDARD_GRAVITY * item.side
    stretch = min(m.E * item.thickness, weight / (2.0 * SHEET_STRETCH))
    return {
        "triangles": triangles,
        "held": np.flatnonzero(np.linalg.norm(places[:, :2], axis=1) <= hold + 1e-9),
        "radius": item.thickness / 2.0,
        "mass_per_area": m.density * item.thickness,
        "stretch": stretch,
        "mu": stretch / (2.0 * (1.0 + m.nu)),
        "lam": stretch * m.nu / (1.0 - m.nu**2),
        "side_hinge": 4.0 * D / (3.0 * h),
        "diagonal_hinge": 4.0 * D / (3.0 * math.sqrt(2.0) * h),
        "spacing": h,
    }
