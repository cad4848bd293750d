"""Elastic parameters as estimated, simulated and shown to policies."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import check_number, require
from gendom.arrays import Array

WEAVE = ("warp", "weft", "shear")
"""A shell's stiffness over that of an isotropic sheet, see `Material`."""

OF_THIN = ("membrane", *WEAVE)
"""Parameters that only rods and shells have."""

FIELDS = ("E", "nu", "density", "damping", *OF_THIN)
"""Of a material."""

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Material:
    """An elastic material, isotropic but for the threads of a shell.

    Motion under gravity depends on E / density, so two materials of equal ``E_over_rho``
    and ``nu`` move alike.

    Raises:
        ParameterError: If a value lies outside its physical range.
    """

    E: float = 1.0e6
    """Young's modulus [Pa]."""
    nu: float = 0.3
    """Poisson's ratio [-], in (-1, 0.5)."""
    density: float = 1000.0
    """Mass density [kg/m^3]."""
    damping: float = 0.0
    """Viscous over elastic stress in slow motion [s]: the time tau of a standard linear solid whose
    Maxwell branch is as stiff as the elastic law. Free motion at a frequency w well below 1 / tau
    is damped at the ratio w tau / 2; static shapes are not changed."""
    membrane: float | None = None
    """Young's modulus of a shell in its plane, or of a rod along it [Pa]; E is then that of bending
    (and twisting). None: E."""
    warp: float = 1.0
    """Bending stiffness of a shell along its first side, over that of an isotropic one."""
    weft: float = 1.0
    """The same along its second side; that of twist is their geometric mean."""
    shear: float = 1.0
    """In-plane shear stiffness of a shell, likewise."""

    def __post_init__(self) -> None:
        check_number("Young's modulus E", self.E, above=0.0)
        for name in ("density", *OF_THIN):
            if name != "membrane" or self.membrane is not None:
                check_number(name, getattr(self, name), above=0.0)
        in_range = -1.0 < check_number("nu", self.nu) < 0.5
        require(in_range, f"Poisson's ratio nu must lie in (-1, 0.5), got {self.nu}")
        check_number("damping", self.damping, least=0.0)

    @property
    def in_plane(self) -> float:
        """Young's modulus of a shell in its plane, of a rod along it [Pa]."""
        return self.E if self.membrane is None else self.membrane

    @property
    def lame(self) -> tuple[float, float]:
        """Lamé parameters (mu, lam) [Pa]."""
        return self.lame_of(2.0)

    def lame_of(self, lateral_constraint: float) -> tuple[float, float]:
        """Parameters (mu, lam = 2 mu nu / (1 - k nu)) of a section that follows its contraction
        only in part [Pa]: k = 2 where it is free to (or a solid), 1 in plane stress; see
        ``Body.lateral_constraint``."""
        mu = self.E / (2.0 * (1.0 + self.nu))
        return mu, 2.0 * mu * self.nu / (1.0 - lateral_constraint * self.nu)

    @property
    def E_over_rho(self) -> float:
        """E / density [m^2/s^2]."""
        return self.E / self.density

    @property
    def wave_speed(self) -> float:
        """Speed of the fastest pressure waves sqrt((lam + 2 mu) / density) [m/s]; with damping
        they meet twice the stiffness."""
        mu, lam = self.lame
        stiffness = (2.0 if self.damping > 0.0 else 1.0) * (lam + 2.0 * mu)
        return math.sqrt(stiffness / self.density)


class Columnar(Sequence[T]):
    """N things as columns [N] by name; one is made of its numbers when it is looked at."""

    def __init__(self, columns: Mapping[str, Array], make: Callable[[dict[str, float]], T]):
        self.columns, self._make = columns, make

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def __getitem__(self, n: Any) -> Any:
        if isinstance(n, slice):
            return self.some(np.arange(len(self))[n])
        return self._make({name: float(values[n]) for name, values in self.columns.items()})

    def some(self, which: NDArray[np.intp]) -> Self:
        """Those at places [k]."""
        made = copy.copy(self)
        made.columns = {name: values[which] for name, values in self.columns.items()}
        return made


def parameters_of(materials: Sequence[Material]) -> Mapping[str, Array]:
    """[W] parameters of W materials by name; a ``membrane`` that is not a number is that of E."""
    if isinstance(materials, Columnar):
        return materials.columns
    of = np.array(list(map(attrgetter(*FIELDS), materials)), dtype=float).reshape(-1, len(FIELDS))
    return dict(zip(FIELDS, of.T, strict=True))


def material_of(row: Mapping[str, float]) -> Material:
    """The material of parameters that are in their ranges, as of `parameters_of`."""
    of = {name: row[name] for name in FIELDS}
    return unchecked(Material, of | {"membrane": of["membrane"] if of["membrane"] > 0.0 else None})


def unchecked(of: type, values: dict[str, Any]) -> Any:
    """A frozen dataclass of these values, all that it has."""
    made = object.__new__(of)
    vars(made).update(values)
    return made


def bending_length(E_over_rho: float, radius_of_gyration: float, gravity: float) -> float:
    """Length scale on which gravity bends a rod, (E I / (linear density g))^(1/3) [m].

    With I / A = k^2 this is (E / density k^2 / g)^(1/3). Source: Wang (1986), "A critical
    review of the heavy elastica".

    Args:
        E_over_rho: E / density [m^2/s^2].
        radius_of_gyration: k of the section, sqrt(I / A) [m]; d / 4 for a round section.
        gravity: Magnitude of gravity [m/s^2].
    """
    return (E_over_rho * radius_of_gyration**2 / gravity) ** (1.0 / 3.0)


def E_over_rho_of(length: float, radius_of_gyration: float, gravity: float) -> float:
    """E / density [m^2/s^2] of a rod with this bending length [m]; inverse of the above."""
    return length**3 * gravity / radius_of_gyration**2
