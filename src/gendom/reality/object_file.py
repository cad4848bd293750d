"""An object of your own, as a TOML file; docs/reality.md has its keys.

``material``, a name of `gendom.materials.catalogue`, gives typical values of all but the length or
side and the colour; values in the file replace them.
"""

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gendom.arguments import require
from gendom.errors import ParameterError
from gendom.materials import ASSUMED, KINDS, Material, catalogue, dimensionless_parameters
from gendom.reading import read_toml
from gendom.reality.objects import OBJECTS, PLAIN, RealObject, RealRope, as_real, vertices_of

DEFAULTS = {name: ASSUMED[name] for name in ("damping", "friction")}
"""Defaults of numbers that a file may leave out."""

DENSEST = 2e4
"""Densities beyond this are taken for a wrong unit [kg/m^3]."""


def find_object(name: str) -> RealObject:
    """The object with a given name, or from a TOML file (`read_object`).

    Raises:
        ParameterError: There is no such object, or the file does not describe one.
    """
    if name.endswith(".toml"):
        return read_object(name)
    fix = f"choose {', '.join(OBJECTS)}, or give a .toml file"
    require(name in OBJECTS, f"there is no object {name!r}", where="reality", fix=fix)
    return OBJECTS[name]


def read_object(path: str | os.PathLike) -> RealObject:
    """The object that a file describes, named after the file.

    Raises:
        ParameterError: The file is missing or no TOML, a number is missing, malformed or
        impossible, or a key is unknown.
    """
    where = str(path)
    table = read_toml(path, error=ParameterError)
    kind = table.pop("kind", None)
    known, fix = isinstance(kind, str) and kind in KINDS, f"give {' or '.join(KINDS)}"
    require(known, f"kind is {kind!r}", where=where, fix=fix)
    colour, material = table.pop("colour", list(PLAIN)), table.pop("material", None)
    good = isinstance(colour, list) and len(colour) == 3
    good = good and all(isinstance(c, int) and 0 <= c <= 255 for c in colour)
    require(good, f"colour is {colour}", where=where, fix="give three of 0 to 255")
    made = KINDS[kind]
    try:
        usual = {} if material is None else _usual(str(material), kind)
        number = _numbers(table, usual, kind)
        elastic = {name: number[name] for name in ("E", "nu", "damping", "density")}
        own: dict[str, Any] = {name: number[name] for name in (*made.sizes, "friction")}
        item = as_real(made(material=Material(**elastic), **own))
    except ParameterError as error:
        raise ParameterError(error.what, where=where, fix=error.fix) from error
    item = replace(item, name=Path(path).stem, colour=tuple(colour))
    if isinstance(item, RealRope):
        return item
    bends = dimensionless_parameters(item)["bending_ratio"] * item.side
    return replace(item, vertices=vertices_of(item.side, bends))


def _numbers(given: Mapping[str, Any], usual: Mapping[str, float], kind: str) -> dict[str, float]:
    """Sizes, E, nu, damping, friction and density: a file's, its material's, or defaults.

    Raises:
        ParameterError: One is missing, malformed or impossible, or a key is unknown.
    """
    large, small = KINDS[kind].sizes
    known = {large, small, "mass", "density", "E", "nu", *DEFAULTS}
    for name, value in given.items():
        fix = f"have material, {', '.join(sorted(known))}"
        require(name in known, f"{name} means nothing", fix=fix)
        good = isinstance(value, int | float) and not isinstance(value, bool)
        require(good and math.isfinite(value), f"{name} is {value!r}", fix="give a number")
    number: dict[str, float] = {**DEFAULTS, **usual, **given}
    if "mass" in given and "density" not in given:
        number.pop("density", None)
    missing = [name for name in (large, small, "E", "nu") if name not in number]
    if ("mass" in number) == ("density" in number):
        missing.append("one of mass and density")
    require(not missing, f"lacks {', '.join(missing)}", fix="give it")
    across = math.pi / 4.0 * number[small] if kind == "rope" else number[large]
    volume = number[large] * number[small] * across or 1e-300
    density = number.get("density", number.get("mass", 0.0) / volume)
    what, fix = f"its density would be {density:.4g} kg/m^3", "check sizes [m] and mass [kg]"
    require(1.0 <= density <= DENSEST, what, fix=fix)
    return {**number, "density": density}


def _usual(name: str, kind: str) -> dict[str, float]:
    """Typical values of a material of the catalogue."""
    listed = catalogue.get(name)
    require(listed.kind == kind, f"{name} is a {listed.kind}, and kind is {kind!r}")
    return {quantity: found.typical for quantity, (_, found) in listed.ranges().items()}
