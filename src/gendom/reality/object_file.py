"""An object of your own, as a TOML file:

kind = "rope"                  # or "cloth", with side and thickness
length = 0.28                  # [m]
diameter = 0.012               # [m]
mass = 0.03                    # [kg], or density [kg/m^3]
E = 1.2e6                      # [Pa]
nu = 0.35
damping = 0.004                # [s]; default 0.004
friction = 0.4                 # on the table; default 0.3
colour = [200, 60, 60]         # sRGB; default grey

material = "cotton-rope", a name of `gendom.materials.catalogue`, gives typical values of all but
the length or side and the colour; values in the file replace them.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

from gendom.errors import ParameterError
from gendom.files import read_toml
from gendom.materials import ASSUMED, KINDS, Material, catalogue
from gendom.reality.objects import PLAIN, RealCloth, RealObject, RealRope, vertices_of

DEFAULTS = {name: ASSUMED[name] for name in ("damping", "friction")}
"""Defaults of numbers that a file may leave out."""

LARGEST, THICKEST, DENSEST, STIFFEST = 5.0, 0.2, 2e4, 1e13
"""Sizes [m], densities [kg/m^3] and moduli [Pa] beyond these are taken for a wrong unit."""


def read_object(path: str | os.PathLike) -> RealObject:
    """The object that a file describes, named after the file.

    Raises:
        ParameterError: The file is missing or no TOML, a number is missing, malformed or
        impossible, or a key is unknown.
    """
    where = str(path)
    table = read_toml(path, error=ParameterError)
    kind = table.pop("kind", None)
    if kind not in KINDS:
        raise ParameterError(f"kind is {kind!r}", where=where, fix=f"give {' or '.join(KINDS)}")
    large, small = KINDS[kind].sizes
    colour = table.pop("colour", list(PLAIN))
    usual = _usual(table.pop("material", None), kind, where)
    if "outline" in table:
        raise ParameterError(
            "objects of tasks and of the MuJoCo test scene are squares or ropes, without outline",
            where=where,
            fix="gendom.sim.cloth(outline=...) simulates it; or give its side",
        )
    known = {large, small, "mass", "density", "E", "nu", *DEFAULTS}
    if unknown := [name for name in table if name not in known]:
        raise ParameterError(
            f"{unknown[0]} means nothing",
            where=where,
            fix=f"have material, {', '.join(sorted(known))}",
        )
    number = {name: _number(value, name, where) for name, value in table.items()}
    if "mass" in number:
        usual.pop("density", None)
    number = {**DEFAULTS, **usual, **number}
    missing = [name for name in (large, small, "E", "nu") if name not in number]
    if ("mass" in number) == ("density" in number):
        missing.append("one of mass and density")
    if missing:
        raise ParameterError(f"lacks {', '.join(missing)}", where=where, fix="give it")
    for name, most, unit in (
        (large, LARGEST, "metres"),
        (small, THICKEST, "metres"),
        ("density", DENSEST, "kg/m^3"),
        ("E", STIFFEST, "pascals"),
    ):
        if not 0.0 < number.get(name, most) <= most:
            raise ParameterError(f"{name} is {number[name]:g}", where=where, fix=f"give {unit}")
    good = isinstance(colour, list) and len(colour) == 3
    if not good or not all(isinstance(c, int) and 0 <= c <= 255 for c in colour):
        raise ParameterError(f"colour is {colour}", where=where, fix="give three of 0 to 255")
    area = math.pi / 4.0 * number[small] ** 2 if kind == "rope" else number[large] * number[small]
    density = number.get("density", number.get("mass", 0.0) / (number[large] * area))
    if not 1.0 <= density <= DENSEST:
        raise ParameterError(
            f"its density would be {density:.4g} kg/m^3",
            where=where,
            fix="check the sizes [m] and the mass [kg]",
        )
    item: dict[str, Any] = {
        large: number[large],
        small: number[small],
        "friction": number["friction"],
        "name": Path(path).stem,
        "colour": tuple(colour),
    }
    elastic = {name: number[name] for name in ("E", "nu", "damping")}
    try:
        item["material"] = Material(density=density, **elastic)
        if kind == "rope":
            return RealRope(**item)
        return RealCloth(vertices=vertices_of(item[large]), **item)
    except ParameterError as error:
        raise ParameterError(error.what, where=where, fix=error.fix) from error


def _usual(name: Any, kind: str, where: str) -> dict[str, float]:
    """Typical values of a material of the catalogue; empty for None."""
    if name is None:
        return {}
    try:
        listed = catalogue.get(str(name))
    except ParameterError as error:
        raise ParameterError(error.what, where=where, fix=error.fix) from None
    if listed.kind != kind:
        raise ParameterError(f"{name} is a {listed.kind}, and kind is {kind!r}", where=where)
    return {quantity: found.typical for quantity, (_, found) in listed.ranges().items()}


def _number(value: Any, name: str, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ParameterError(f"{name} is {value!r}", where=where, fix="give a number")
    return float(value)
