"""A catalogue of materials: parameters of ropes, cables and cloths, each with its basis.

>>> from gendom.materials import catalogue
>>> rope = catalogue.get("cotton-rope")
>>> rope.material().E, rope.E.low, rope.E.source
(1000000.0, 200000.0, 'kuroki-2023')

The numbers are in catalogue.toml beside this file. E is an effective modulus of bending: that of a
solid round rope, or of a sheet, which bends as the thing does. That of its fibres is larger by
orders, and so is that of the rope when it is pulled.

Other packages add materials by an entry point of the group ``gendom.materials`` whose object is a
mapping with the sections of catalogue.toml. Its materials may name our sources and shared ranges.
"""

import logging
import math
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from gendom.arguments import require
from gendom.errors import ParameterError, did_you_mean
from gendom.materials.objects import KINDS
from gendom.materials.parameters import Material
from gendom.materials.posterior import half_width
from gendom.plugins import plugins
from gendom.shown import Shown

_log = logging.getLogger(__name__)

BASES = ("measured", "computed", "estimate")
"""Where a range comes from: measurements of such things; what its source says; or a guess, for
which a source, where there is one, has the method or numbers near it."""

UNITS = {"E": "Pa", "nu": "1", "density": "kg/m^3", "damping": "s", "friction": "1"}
"""Quantities of every material, SI; a rope has a ``diameter``, a cloth a ``thickness`` [m]."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """A publication or a public table."""

    text: str
    """Authors, title and place."""
    says: str = ""
    """The numbers in it that ranges rest on; empty where they have not been checked."""


@dataclass(frozen=True, kw_only=True)
class Range:
    """What things of one material have of a quantity, in its SI unit.

    Raises:
        ParameterError: The numbers are not finite, not above 0 or not in order, the basis is none
            of `BASES`, or what was measured or computed has no source.
    """

    low: float
    typical: float
    high: float
    """Nine of ten such things lie between `low` and `high`."""
    basis: str
    """One of `BASES`."""
    how: str
    """How the numbers come about, in a few words."""
    source: str = ""
    """A key of `sources`; empty where there is none."""

    @property
    def log_sd(self) -> float:
        """Standard deviation of the logarithm of a log-normal quantity with these ends."""
        return math.log(self.high / self.low) / 2.0 / half_width(0.9)

    def __post_init__(self) -> None:
        numbers = (self.low, self.typical, self.high)
        require(all(map(math.isfinite, numbers)), f"has {numbers}, which are not all finite")
        ordered = 0.0 < self.low <= self.typical <= self.high
        require(ordered, f"has {numbers}, not above 0 and in order")
        fix = f"give {', '.join(BASES)}"
        require(self.basis in BASES, f"has the basis {self.basis!r}", fix=fix)
        sourced = self.basis == "estimate" or self.source
        require(sourced, f"is {self.basis}, and has no source", fix="name it")


@dataclass(frozen=True, kw_only=True, repr=False)
class Listed(Shown):
    """A material of the catalogue."""

    name: str
    kind: str
    """``rope`` (cables are ropes) or ``cloth``."""
    about: str
    E: Range
    """Young's modulus in bending [Pa]; see the module."""
    nu: Range
    """Poisson's ratio [-]."""
    density: Range
    """Mass over the volume of the solid rope or sheet, air in between included [kg/m^3]."""
    damping: Range
    """As `Material.damping` [s]."""
    friction: Range
    """Coefficient of friction on a smooth table [-]."""
    across: Range
    """Usual diameter of a rope, or thickness of a cloth [m]."""

    @property
    def size(self) -> str:
        """The name of `across`: ``diameter`` or ``thickness``."""
        return KINDS[self.kind].sizes[1]

    def material(self) -> Material:
        """What is typical, for a simulation."""
        names = ("E", "nu", "density", "damping")
        return Material(**{name: getattr(self, name).typical for name in names})

    def ranges(self) -> dict[str, tuple[str, Range]]:
        """Unit and range by quantity."""
        named = {name: (unit, getattr(self, name)) for name, unit in UNITS.items()}
        return {**named, self.size: ("m", self.across)}

    def _shown(self) -> tuple[str, list[tuple[str, ...]]]:
        rows = [
            (name, *(f"{x:.4g}" for x in (r.low, r.typical, r.high)), unit, r.basis, r.source)
            for name, (unit, r) in self.ranges().items()
        ]
        return f"{self.name}: {self.about} ({self.kind})", rows


def get(name: str) -> Listed:
    """The material of a name.

    Raises:
        ParameterError: There is none; the message has the nearest names.
    """
    known = materials()
    fix = did_you_mean(name, known) or "gendom materials lists them"
    require(name in known, f"there is no material {name!r}", fix=fix)
    return known[name]


def materials() -> dict[str, Listed]:
    """All materials by name."""
    return _read()[0]


def sources() -> dict[str, Source]:
    """Sources by their keys."""
    return _read()[1]


@cache
def _read() -> tuple[dict[str, Listed], dict[str, Source]]:
    ours = tomllib.loads(files("gendom.materials").joinpath("catalogue.toml").read_text("utf-8"))
    found, cited = parse(ours)
    for name, theirs in plugins("materials").items():
        try:
            listed, more = parse({key: {**theirs.get(key, {}), **ours[key]} for key in ours})
        except (ParameterError, AttributeError, KeyError, TypeError) as error:
            _log.warning("gendom.materials %r is left out: %s", name, error)
            continue
        found, cited = listed | found, more | cited
    return found, cited


def parse(table: dict[str, Any]) -> tuple[dict[str, Listed], dict[str, Source]]:
    """Materials and sources of a catalogue's TOML: ``sources`` (``text`` and ``says`` by key),
    ``shared`` (ranges by name) and ``materials``: ``kind``, ``about`` and ranges, or names of
    shared ones, of `UNITS` and of the size across.

    Raises:
        ParameterError: Something is missing, unknown or out of its range.
    """
    cited = {key: Source(**source) for key, source in table["sources"].items()}
    shared = {name: _range(row, f"shared.{name}", cited) for name, row in table["shared"].items()}
    found: dict[str, Listed] = {}
    for name, row in table["materials"].items():
        kind = row.get("kind")
        fix = f"give {', '.join(KINDS)}"
        require(kind in KINDS, f"has kind {kind!r}", where=name, fix=fix)
        across = KINDS[kind].sizes[1]
        wanted = {"kind", "about", *UNITS, across}
        odd = wanted ^ set(row)
        verb = "lacks" if odd <= wanted else "has unknown"
        require(not odd, f"{verb} {', '.join(sorted(odd))}", where=name)
        ranges = {
            "across" if quantity == across else quantity: shared[stated]
            if isinstance(stated := row[quantity], str)
            else _range(stated, f"{name}.{quantity}", cited)
            for quantity in (*UNITS, across)
        }
        found[name] = Listed(name=name, kind=kind, about=row["about"], **ranges)
        found[name].material()  # which refuses what is impossible
    return found, cited


def _range(row: dict[str, Any], where: str, cited: dict[str, Source]) -> Range:
    try:
        made = Range(**row)
    except TypeError as error:
        raise ParameterError(f"is no range ({error})", where=where) from None
    except ParameterError as error:
        raise ParameterError(error.what, where=where, fix=error.fix) from None
    listed = not made.source or made.source in cited
    require(listed, f"has the source {made.source!r}, which is not listed", where=where)
    stated = made.basis == "estimate" or cited[made.source].says
    what = f"is {made.basis} from {made.source!r}, and what that says is not stated"
    require(stated, what, where=where, fix="add what it says, or make it an estimate")
    return made
