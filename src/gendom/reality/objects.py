"""The objects of the MuJoCo test scene (the second reality): three ropes and two cloths, these
in two sizes.

They carry the names of the paper's, whose cloths have sides of 0.2 m. Where their
numbers come from:

Ropes. E / density and nu are the paper's estimates for its three real ropes (table "real2sim":
1779, 3276 and 8000 with nu 0.35, 0.346, 0.36), which hold for a rope 0.5 long under gravity 12,
brought to metres by the similarity of `gendom.tasks.rope_reaching`: times g L / (12 * 0.5), and for
their diameter such that the bending length over the length is the same: 0.39, 0.47 and 0.64. E is
an effective modulus of bending: fibres slide on each other, so a rope in bending is softer by
orders than its fibres. Densities are those of the fibres (cotton 1.54, polyester 1.38,
polyethylene 0.95 g/cm^3; Morton and Hearle, "Physical Properties of Textile Fibres", 2008) times
the share of the section that they fill in a braid, 0.5 to 0.65.

Cloths. Cotton: bending rigidity of a shirting, 0.07 gf cm^2/cm = 7e-6 N m (Kawabata, "The
Standardization and Analysis of Hand Evaluation", 1980, has 0.03 to 0.15 for cotton), 0.2 kg/m^2,
0.5 mm thick; E is the modulus that gives a plate of that thickness this rigidity. Rubber: a
sheet of soft vulcanised natural rubber, E 2 MPa, 1100 kg/m^3 (Treloar, "The Physics of Rubber
Elasticity", 1975), 1 mm thick; nu 0.45 in place of 0.5, which no compressible plate can have.

Coefficients of friction are for a smooth table, damping is a time: the stress of a rate of strain
is damping times that of the strain. Both are chosen, within what such things show: 0.25 for
polyethylene to 0.7 for rubber, and loss factors of 0.15 to 0.25 where ropes vibrate, at 8 Hz.

Triangles of a cloth: docs/reality.md derives how they are cut and how stiff their hinges are.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from gendom.arrays import Array
from gendom.materials import STANDARD_GRAVITY, Cloth, Item, Material, Rope, size_of

LEAST_RADIUS = 0.0005
"""The least of a cloth's `RealCloth.radius` [m]."""

POINT_SPACING = 0.0075
"""Between a cloth's points [m]. With 10 mm lifts show bending lengths that are 4 % longer for the
rubber cloth, a lift takes half the time."""

POINTS_A_BEND = 3.0
"""Least number of points in a bending length. The lift of a cloth that bends over 12.6 mm shows 1.8
times its E with points 7.5 mm apart, 1.09 times with 4.4 mm."""

SHEET_NU = -1.0 / 3.0
"""Poisson's ratio of bending; that of the material counts in a sheet's rigidity and its plane."""


def grid(along: int, across: int, spacing: float) -> tuple[Array, npt.NDArray[np.intp]]:
    """A flat rectangle.

    Args:
        along: Vertices along its first side.
        across: Vertices along its second side.
        spacing: Between neighbours [m].

    Returns:
        Vertices [along * across, 2] [m], those of the second side one after another, and
        triangles [F, 3].
    """
    at = np.arange(along * across).reshape(along, across)
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    even = np.indices(a.shape).sum(axis=0) % 2 == 0
    first = np.stack([a, b, np.where(even, c, d)], axis=-1)
    second = np.stack([np.where(even, a, b), c, d], axis=-1)
    triangles = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    points = spacing * np.indices((along, across)).reshape(2, -1).T.astype(np.float64)
    return points, triangles


def vertices_of(side: float, bends: float = math.inf) -> int:
    """Points along a side of a cloth [m] that are `POINT_SPACING` apart, nearer if it is lifted to
    show a bending length [m] that asks for it; 21 to 49."""
    spacing = min(POINT_SPACING, bends / POINTS_A_BEND)
    return min(max(round(side / spacing) + 1, 21), 49)


@dataclass(frozen=True, kw_only=True)
class _Meshed:
    """What objects of the scene have in common."""

    name: str
    """As on the command line."""
    colour: tuple[int, int, int]
    """sRGB."""
    vertices: int
    """Points along a rope, or a side of a cloth."""

    @property
    def spacing(self) -> float:
        """Between points [m]."""
        return size_of(self) / (self.vertices - 1)  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True, kw_only=True)
class RealRope(_Meshed, Rope):
    """A rope of the MuJoCo test scene, whose points are farther apart than it is thick; its E is
    that of bending."""

    vertices: int = 18

    @property
    def radius(self) -> float:
        """[m]."""
        return self.diameter / 2.0

    @property
    def vertex_masses(self) -> Array:
        """[V] half of the edges that meet there [kg]."""
        masses = np.full(self.vertices, self.mass / (self.vertices - 1))
        masses[[0, -1]] /= 2.0
        return masses


@dataclass(frozen=True, kw_only=True)
class RealCloth(_Meshed, Cloth):
    """A cloth of the MuJoCo test scene; its E is that of bending."""

    vertices: int = 41

    @property
    def sheet(self) -> tuple[Array, npt.NDArray[np.intp]]:
        """Vertices [V, 2] of the flat cloth [m] and triangles [F, 3]."""
        return grid(self.vertices, self.vertices, self.spacing)

    @property
    def radius(self) -> float:
        """Distance from its middle surface of contacts and of the visible skin [m]: half its
        thickness, or the least that contacts need."""
        return max(LEAST_RADIUS, self.thickness / 2.0)

    @property
    def vertex_masses(self) -> Array:
        """[V] a third of the triangles that meet there, which are halves of squares [kg]."""
        triangles = self.sheet[1]
        meeting = np.bincount(triangles.ravel()).astype(np.float64)
        return meeting * (self.mass / (3.0 * len(triangles)))


RealObject = RealRope | RealCloth


def description(item: Item) -> dict[str, Any]:
    """An object's part of a recording's meta, without the grasp."""
    sizes = {name: getattr(item, name) for name in item.sizes}
    if "side" in sizes:
        sizes = {"width": sizes["side"], "height": sizes.pop("side"), **sizes}
    return {"kind": item.kind, **sizes, "mass": item.mass}


_ROPES = {
    # E of the paper, nu, density, damping, friction, colour
    "rope-cotton": (1779.38, 0.35, 800.0, 0.005, 0.45, (190, 45, 40)),
    "rope-polyester": (3276.12, 0.346, 900.0, 0.004, 0.35, (35, 85, 170)),
    "rope-polyethylene": (8000.31, 0.36, 600.0, 0.003, 0.25, (225, 190, 30)),
}

_CLOTHS = {
    # thickness, E, nu, density, damping, friction, colour
    "cloth-cotton": (
        0.5e-3, 7e-6 * 12.0 * (1.0 - 0.3**2) / 0.5e-3**3, 0.3, 400.0, 0.01, 0.5, (40, 70, 150),
    ),
    "cloth-rubber": (1e-3, 2e6, 0.45, 1100.0, 0.004, 0.7, (30, 130, 70)),
}  # fmt: skip


def _objects() -> Iterator[RealObject]:
    length, diameter = 0.3, 0.016
    for name, (E, nu, density, damping, friction, colour) in _ROPES.items():
        E = E * STANDARD_GRAVITY * length / (12.0 * 0.5) * density
        # The paper's rope is 0.056 lengths thick: equal bending at another thickness.
        E *= (0.028 / 0.5 * length / diameter) ** 2
        material = Material(E=E, nu=nu, density=density, damping=damping)
        yield RealRope(name=name, length=length, diameter=diameter, material=material,
                       friction=friction, colour=colour)  # fmt: skip
    for suffix, side, vertices in (("", 0.3, 41), ("-200mm", 0.2, 21)):
        for name, (thickness, E, nu, density, damping, friction, colour) in _CLOTHS.items():
            material = Material(E=E, nu=nu, density=density, damping=damping)
            yield RealCloth(name=name + suffix, side=side, thickness=thickness, material=material,
                            friction=friction, colour=colour, vertices=vertices)  # fmt: skip


OBJECTS: dict[str, RealObject] = {item.name: item for item in _objects()}
"""The objects by name."""


PLAIN = (150, 150, 150)
"""Default colour (sRGB)."""


def as_real(item: Item) -> RealObject:
    """An object as one of the MuJoCo test scene."""
    if isinstance(item, RealRope | RealCloth):
        return item
    own: dict[str, Any] = {f.name: getattr(item, f.name) for f in fields(item)}
    own |= {"name": f"a {item.kind}", "colour": PLAIN}
    if isinstance(item, Rope):
        # as many vertices as the diameter allows
        most = 1 + int(item.length / (1.02 * item.diameter))
        return RealRope(vertices=min(RealRope.vertices, most), **own)
    return RealCloth(vertices=vertices_of(item.side), **own)
