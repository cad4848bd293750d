"""Ropes and cloths: sizes, material, friction; and the numbers by which they are alike.

Similarity. Measured in the object's size L and, in time, in sqrt(L / g), its motion under gravity
depends only on numbers without a unit. The equation of motion rho x_tt = div P(F; E, nu) + rho g,
divided by rho g, leaves E / (rho g L), nu and thickness / L. A slender body is hardly stretched by
its weight, it bends, and then E and thickness count only together, as bending length over size
(`bending_length`). Damping is a time; the air's drag counts by its density over the object's
weight. So objects of any size share one task and one policy, as far as only `PARAMETERS` count.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from gendom.arguments import check_choice
from gendom.arrays import Array
from gendom.errors import ParameterError
from gendom.materials.names import with_current_names
from gendom.materials.parameters import (
    FIELDS,
    Columnar,
    E_over_rho_of,
    Material,
    bending_length,
    material_of,
    parameters_of,
    unchecked,
)

STANDARD_GRAVITY = 9.81
"""[m/s^2]."""

AIR_DENSITY = 1.2
"""Of air at 20 C and sea level [kg/m^3]."""

ASSUMED = {"nu": 0.35, "density": 1000.0, "damping": 0.004, "friction": 0.3}
"""What is assumed for a number that is not given, by column name: about the middle of what ropes
and cloths have."""


@dataclass(frozen=True)
class Parameter:
    """One of the dimensionless numbers that determine an object's motion."""

    name: str
    column: str
    """Of a demonstration that holds the quantity it comes from; empty: it comes from sizes."""
    unit: str
    """Of that quantity, SI."""
    meaning: str
    """Of the number without a unit."""
    log: bool
    """Whether ratios of it count, not differences."""


PARAMETERS: dict[str, Parameter] = {
    row[0]: Parameter(*row)
    for row in (
        ("bending_ratio", "E_over_rho", "m^2/s^2", "bending length over size", True),
        ("nu", "nu", "1", "Poisson's ratio", False),
        ("damping", "damping", "s", "damping time over sqrt(size / g)", True),
        ("friction", "friction", "1", "coefficient of friction", False),
        ("density", "density", "kg/m^3", "density of air times size over mass per area", True),
        ("thickness_ratio", "", "", "thickness over size", True),
    )
}
"""What policies can be conditioned on, by name."""

QUANTITIES: dict[str, Parameter] = {p.column: p for p in PARAMETERS.values() if p.column}
"""The same by the quantities in SI units that they come from, which tasks draw objects by."""


@dataclass(frozen=True, kw_only=True)
class _Thing:
    """What ropes and cloths have in common."""

    kind: ClassVar[str]
    sizes: ClassVar[tuple[str, str]]
    """Names of its sizes, the larger one first [m]."""
    thickness_power: ClassVar[int]
    """Exponent of the smaller one in its volume."""

    material: Material = field(default_factory=Material)
    friction: float = 0.3
    """Coefficient of friction on the table, and of a cloth on itself [-]."""

    def __post_init__(self) -> None:
        _check_units(self)  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True, kw_only=True)
class Rope(_Thing):
    """A round rope.

    Raises:
        ParameterError: A size is not positive and at most `LARGEST`, it is thicker than a fifth of
            its length, friction is negative, or a number was given in another unit.
    """

    kind = "rope"
    sizes = ("length", "diameter")
    thickness_power = 2

    length: float
    """[m]."""
    diameter: float
    """[m]."""

    @property
    def radius_of_gyration(self) -> float:
        """Of its section, sqrt(I / A) [m]."""
        return self.diameter / 4.0

    @property
    def mass(self) -> float:
        """[kg]."""
        return math.pi / 4.0 * self.diameter**2 * self.length * self.material.density

    @property
    def mass_per_area(self) -> float:
        """Mass over what faces the air across it [kg/m^2]."""
        return self.mass / (self.length * self.diameter)


@dataclass(frozen=True, kw_only=True)
class Cloth(_Thing):
    """A square cloth.

    Raises:
        ParameterError: As of `Rope`.
    """

    kind = "cloth"
    sizes = ("side", "thickness")
    thickness_power = 1

    side: float
    """[m]."""
    thickness: float
    """[m]."""

    @property
    def radius_of_gyration(self) -> float:
        """Of its section, sqrt(I / A / (1 - nu^2)): a sheet is kept from widening [m]."""
        return self.thickness / math.sqrt(12.0 * (1.0 - self.material.nu**2))

    @property
    def mass(self) -> float:
        """[kg]."""
        return self.side**2 * self.mass_per_area

    @property
    def mass_per_area(self) -> float:
        """[kg/m^2]."""
        return self.thickness * self.material.density


LARGEST = 10.0
"""Size that no object exceeds [m]: a larger number was not given in metres."""

Item = Rope | Cloth

KINDS: dict[str, type[Rope] | type[Cloth]] = {c.kind: c for c in (Rope, Cloth)}
"""Classes of objects by kind."""


def size_of(item: Item) -> float:
    """The larger size L [m]."""
    return getattr(item, item.sizes[0])


def sizes_of(items: Sequence[Item]) -> Array:
    """[N] larger sizes of objects of one kind [m]."""
    items = Items.of(items)
    return items.columns[KINDS[items.kind].sizes[0]]


def thickness_of(item: Item) -> float:
    """The smaller size [m]."""
    return getattr(item, item.sizes[1])


def unit_of(unit: str, item: Item) -> float:
    """`unit_of_size` of an object."""
    return float(unit_of_size(unit, np.array(size_of(item))))


def unit_of_size(unit: str, L: Array) -> Array:
    """The factor from a dimensionless number to SI units (``m``, ``s``, ``m/s`` or ``1``), for
    objects of sizes L [...] [m].

    Raises:
        ParameterError: There is no such unit.
    """
    powers = {"m": (1.0, 0.0), "s": (0.5, -0.5), "m/s": (0.5, 0.5), "1": (0.0, 0.0)}
    check_choice("unit", unit, powers)
    of_size, of_gravity = powers[unit]
    return L**of_size * STANDARD_GRAVITY**of_gravity


def dimensionless_parameters(item: Item) -> dict[str, float]:
    """The dimensionless numbers of an object, by names of `PARAMETERS`."""
    material = item.material
    L = size_of(item)
    bending = bending_length(material.E_over_rho, item.radius_of_gyration, STANDARD_GRAVITY)
    return {
        "bending_ratio": bending / L,
        "nu": material.nu,
        "damping": material.damping / unit_of("s", item),
        "friction": item.friction,
        "density": AIR_DENSITY * L / item.mass_per_area,
        "thickness_ratio": thickness_of(item) / L,
    }


def with_dimensionless(item: Item, parameters: Mapping[str, float]) -> Item:
    """An object of the same size with other `dimensionless_parameters`; those that are not given
    stay.

    Raises:
        ParameterError: There is no such object.
    """
    alike = {**dimensionless_parameters(item), **parameters}
    if not math.isclose(alike["thickness_ratio"], thickness_of(item) / size_of(item), rel_tol=1e-6):
        item = replace(item, **{item.sizes[1]: alike["thickness_ratio"] * size_of(item)})
    own = dimensionless_parameters(item)
    density = item.material.density * own["density"] / alike["density"]
    # the bending length depends on nu, so the modulus that it stands for is asked of this one
    same = replace(item, material=replace(item.material, nu=alike["nu"], density=density))
    bending = alike["bending_ratio"] * size_of(item)
    specific = E_over_rho_of(bending, same.radius_of_gyration, STANDARD_GRAVITY)
    damping = alike["damping"] * unit_of("s", item)
    material = replace(same.material, E=specific * density, damping=damping)
    return replace(same, material=material, friction=alike["friction"])


def to_columns(item: Item) -> dict[str, float]:
    """Numbers of an object in SI units by column name, as demonstrations hold them."""
    material = item.material
    return {
        "E": material.E,
        "nu": material.nu,
        "density": material.density,
        "E_over_rho": material.E_over_rho,
        "damping": material.damping,
        "friction": item.friction,
        **{name: getattr(item, name) for name in item.sizes},
    }


def from_columns(kind: str, columns: Mapping[str, float]) -> Item:
    """The object of a demonstration's columns; inverse of `to_columns`.

    Raises:
        ParameterError: A number is out of its range.
        KeyError: One is missing.
    """
    return items_from_columns(kind, {name: [x] for name, x in columns.items()})[0]


class Items(Columnar[Item]):
    """N objects of one kind as columns [N]: sizes, friction and parameters of the materials."""

    def __init__(self, kind: str, columns: Mapping[str, Array]):
        super().__init__(columns, self._made)
        self.kind = kind

    @classmethod
    def of(cls, items: Sequence[Item]) -> Items:
        """Objects of one kind that are there already, one at least."""
        if isinstance(items, cls):
            return items
        own = {n: np.array([getattr(item, n) for item in items]) for n in _own(items[0].kind)}
        return cls(items[0].kind, {**own, **parameters_of([item.material for item in items])})

    @property
    def materials(self) -> Columnar[Material]:
        return Columnar({name: self.columns[name] for name in FIELDS}, material_of)

    def _made(self, row: dict[str, float]) -> Item:
        of = {name: row[name] for name in _own(self.kind)}
        return unchecked(KINDS[self.kind], {**of, "material": material_of(row)})

    def check(self) -> None:
        """Refuse what is out of its range, as one object does."""
        for item in self:
            replace(item, material=replace(item.material))


def _own(kind: str) -> tuple[str, ...]:
    """What an object has besides its material."""
    return (*KINDS[kind].sizes, "friction")


def items_from_columns(
    kind: str, columns: Mapping[str, ArrayLike], *, like: Item | None = None
) -> Items:
    """N objects at once from columns [N], each as of `from_columns`; what no column has is as of
    the object that they are ``like``, if one is given."""
    columns, usual = with_current_names(columns), like.material if like else Material()
    own = (*_own(kind), "E", "nu", "density", "damping")
    numbers = {name: np.array(columns[name], dtype=float) for name in own}
    count = len(numbers["E"])
    numbers |= {n: np.repeat(parameters_of([usual])[n], count) for n in FIELDS if n not in own}
    items = Items(kind, numbers)
    if not count:
        return items
    # what is checked are ranges, and thickness over size: all is right if the extremes are
    large, small = (numbers[name] for name in KINDS[kind].sizes)
    thickest = np.argmax(small - 0.2 * large)
    try:
        ends = {n: np.array([x.min(), x.max(), x[thickest]]) for n, x in numbers.items()}
        Items(kind, ends).check()
    except ParameterError:
        items.check()  # tells which
    return items


def dimensionless_columns(kind: str, columns: Mapping[str, Array]) -> dict[str, Array]:
    """`dimensionless_parameters` of N objects at once, from columns [N]."""
    found = [dimensionless_parameters(item) for item in items_from_columns(kind, columns)]
    return {name: np.array([row[name] for row in found]) for name in PARAMETERS}


# ranges that no such number leaves, its unit, and the one in which it then was given, with a factor
_MISREAD = (
    ("E", 10.0, math.inf, "Pa", "MPa", 1e6),
    ("density", 2.0, math.inf, "kg/m^3", "g/cm^3", 1e3),
    ("density", 0.0, 25e3, "kg/m^3", "g/m^3", 1e-3),
    ("damping", 0.0, 0.5, "s", "ms", 1e-3),
)
_SMALLER = {"cm": 1e-2, "mm": 1e-3}  # units in which sizes are given by mistake [m]


def _in_metres(value: float, item: Item) -> str:
    """What a size that is too large is in metres if it was given in `_SMALLER` units; those are
    left out that the object's larger size, where it is plausible, rules out."""
    large = size_of(item)
    if large > LARGEST:
        units = ["cm" if large < 100.0 else "mm"]
    else:
        units = [unit for unit, metres in _SMALLER.items() if metres * value <= 0.2 * large]
    told = [f"{value:g} {unit} are {_SMALLER[unit] * value:g} m" for unit in units or _SMALLER]
    return f"give metres: {', '.join(told)}"


def _check_units(item: Item) -> None:
    for name, low, high, unit, other, factor in _MISREAD:
        value = getattr(item.material, name)
        if not low <= value <= high:
            fix = f"give {unit}: {value:g} {other} are {factor * value:g} {unit}"
            raise ParameterError(f"{name} is {value:g} {unit}", fix=fix)
    for name in item.sizes:
        value = getattr(item, name)
        if not 0.0 < value < math.inf:
            what = f"{name} must be positive and finite, got {value}"
            raise ParameterError(what, fix="give metres")
        if value > LARGEST:
            raise ParameterError(f"{name} is {value:g} m", fix=_in_metres(value, item))
    (large, small), (L, h) = item.sizes, (size_of(item), thickness_of(item))
    if not h <= 0.2 * L:
        fix = _in_metres(h, item) if h > L else f"give a {small} of at most 0.2 of its {large}"
        what = f"a {item.kind} with {small} {h} m and {large} {L} m is no {item.kind}"
        raise ParameterError(what, fix=fix)
    if not 0.0 <= item.friction < math.inf:
        fix = "most things have 0.1 to 0.8 on a table"
        what = f"friction must be finite and not negative, got {item.friction}"
        raise ParameterError(what, fix=fix)
