"""Twins for Genesis 1.4: a rope as a chain of rigid segments, a cloth by its position-based solver.

It has no rods, and its shells by finite elements need CUDA. Two hinges between segments have the
stiffness EI / l of the rope between their middles; there is no torsion. A sheet has springs for
edges: those of a square lattice that is halved by diagonals stretch like a plate of nu = 1/3 if
their stiffness is 3/8 E h along sides and twice that along diagonals; E h is softened as for the
others. Genesis divides the compliance of a hinge by the squared sine of its angle, so that its
moment goes with the cube of that: it is that of the plate at one angle, of a cloth that bends over
its bending length.
"""

import math
from typing import Any

import numpy as np

from gendom.arrays import Array
from gendom.materials import STANDARD_GRAVITY, Item, Rope, size_of
from gendom.twins.lift import Lift, segment_points, sheet_points
from gendom.twins.newton import sheet_of

SCRIPT = "genesis_lift.py"

SEGMENTS, SIDE = 20, 31
"""Segments of a rope, and points along a cloth's side."""

STEP = {"rope": 1e-3, "cloth": 2e-3}
"""[s]."""


def written(item: Item) -> tuple[Lift, dict[str, str], Array, dict[str, Any]]:
    """The lift, text files by name, the places [M, 3] at rest that are compared [m] (middles of a
    rope's segments or a cloth's vertices), and arrays for the script."""
    lift = Lift(item=item, edge=size_of(item) / SEGMENTS)
    common = {"kind": item.kind, "friction": item.friction, "step": STEP[item.kind]}
    if isinstance(item, Rope):
        return lift, {"rope.xml": _chain(item, lift)}, segment_points(lift, SEGMENTS), common
    places, triangles = sheet_points(lift, SIDE)
    obj, arrays = _sheet(item, places, triangles, lift.hold)
    return lift, {"sheet.obj": obj}, places, common | arrays


def _chain(item: Rope, lift: Lift) -> str:
    """MJCF of a rope's segments, of which the hand carries the first ones."""
    m, l, r = item.material, item.length / SEGMENTS, item.diameter / 2.0
    held, mass = round(lift.hold / l + 0.5), m.density * math.pi * r**2 * l
    bends = m.E * math.pi * r**4 / (4.0 * l)
    spring = f'stiffness="{bends!r}" damping="{m.damping * bends!r}" armature="0"'
    turns = f"{mass * (r**2 / 4.0 + l**2 / 12.0)!r}"
    inner = ""
    for k in reversed(range(SEGMENTS)):
        joints = ""
        if k == 0:
            axes = ("1 0 0", "0 1 0", "0 0 1")
            # so heavy that the rope hangs from it: set places alone would let all fall together
            joints = "".join(f'<joint type="slide" axis="{axis}" armature="1e3"/>' for axis in axes)
        elif k >= held:
            joints = "".join(
                f'<joint type="hinge" axis="{axis}" {spring}/>' for axis in ("0 1 0", "0 0 1")
            )
        place = f"0 0 {lift.height!r}" if k == 0 else f"{l!r} 0 0"
        inertia = f"{0.5 * mass * r**2!r} {turns} {turns}"
        inner = (
            f'<body name="s{k}" pos="{place}">{joints}<inertial pos="{l / 2.0!r} 0 0"'
            f' mass="{mass!r}" diaginertia="{inertia}"/><geom type="capsule" size="{r!r}"'
            f' fromto="0 0 0 {l!r} 0 0" friction="{item.friction} 0.005 0.0001"/>{inner}</body>\n'
        )
    return f'<mujoco model="rope"><worldbody>\n{inner}</worldbody></mujoco>\n'


def _sheet(item: Any, places: Array, triangles: Any, hold: float) -> tuple[str, dict[str, Any]]:
    """A sheet's mesh as .obj, and what its springs are."""
    sheet = sheet_of(item, places, triangles, hold)
    m, h = item.material, sheet["spacing"]
    D = m.E * item.thickness**3 / (12.0 * (1.0 - m.nu**2))
    angle = h / (D / (m.density * item.thickness * STANDARD_GRAVITY)) ** (1.0 / 3.0)
    points = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in places.tolist())
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in (np.asarray(triangles) + 1).tolist())
    springs = {
        "stretch_compliance": 8.0 / (3.0 * sheet["stretch"]),
        "bending_compliance": angle**2 / sheet["side_hinge"],
    }
    kept = ("held", "mass_per_area", "spacing")
    return points + faces, springs | {name: sheet[name] for name in kept}
