"""The file of an estimate: the numbers in it that follow from others, and how it is read.

Its single source of truth is the posterior; the values beside it follow from that, and a file in
which they do not is refused. Names of earlier versions are mapped by `gendom.materials.names`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.errors import GendomError, ParameterError
from gendom.files import to_json
from gendom.materials import catalogue
from gendom.materials.names import with_current_names
from gendom.materials.objects import KINDS
from gendom.materials.posterior import Posterior, prior_of
from gendom.materials.unknowns import UNKNOWNS, Theta
from gendom.reading import read_json, record_of

FORMAT = "gendom-estimate/1"

LEVEL = 0.9
"""Probability of intervals where an estimate names none."""

HIDDEN = ("damping", "friction")
"""What many recordings do not determine: where one does not, the usual value is taken for it."""

LARGEST_SD = 10.0
"""Of the logarithm of a density in a file: twice that of all matter on Earth."""

SIZES = ("length", "width", "height", "diameter", "thickness", "side")
"""Names of sizes in files [m]."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Whether an estimate is usable."""

    usable: bool = True
    reasons: tuple[str, ...] = ()
    """Why it is not usable, one sentence each."""

    @property
    def text(self) -> str:
        return "usable" if self.usable else "not usable: " + "; ".join(self.reasons)


USABLE = Verdict(usable=True)


@dataclass(frozen=True, kw_only=True)
class Stored:
    """What is read of the file, by its type; an empty entry counts as none."""

    format: str | None = None
    verdict: Verdict | None = None
    object: dict[str, str | float | None] | None = None
    posterior: dict[str, Any] | None = None
    theta: dict[str, float] | None = None
    marker_offsets: list[tuple[float, float, float]] | None = None
    intervals: dict[str, float | tuple[float, float]] | None = None
    density_sd: float | None = None
    simulation: Simulated | None = None
    recordings: list[StoredRecording] | None = None
    executions: dict[str, list[Any]] | None = None
    before_executions: dict[str, Any] | None = None


@dataclass(frozen=True, kw_only=True)
class StoredRecording:
    """What is read of one of its recordings."""

    theta: dict[str, float]
    digest: str | None = None
    begins_with: str | None = None
    compared: list[int] | None = None
    simulation: Simulated | None = None
    calibration: Calibrated | None = None


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """What is read of how it was simulated."""

    engine: str | None = None
    points: int | None = None
    cells_across: float = 1.0
    material: str | None = None


@dataclass(frozen=True, kw_only=True)
class Calibrated:
    """What is read of where cameras were found."""

    registration: tuple[tuple[float, ...], ...] | None = None
    """[4, 4]."""


CHECKSUM, TIMES = "sha256", ("seconds", "stage_seconds")
"""Entry of the file: the checksum of all others but these, which differ from run to run."""


def checksum(record: Mapping[str, Any]) -> str:
    """SHA-256 of a record's entries, however their text is laid out."""
    rest = {name: value for name, value in record.items() if name not in (CHECKSUM, *TIMES)}
    text = json.dumps(json.loads(to_json(rest), parse_int=float), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, kw_only=True)
class Derived:
    """A number of the file that follows from E over density and other numbers."""

    title: str
    unit: str
    form: str = ".4g"
    needs: tuple[str, ...]
    """The other numbers, by name."""
    power: float = 1.0
    """Exponent of E over density in it."""
    thicker: float
    """Exponent of the thickness, over `power`, with E over density as it is."""
    heavier: float = 0.0
    """Exponent of an assumed density."""


def derived(kind: str, *, weighed: bool) -> dict[str, Derived]:
    """The derived numbers of a rope or cloth, by name.

    Args:
        kind: Of the object.
        weighed: Whether its mass is known: a thicker one is then less dense. Else its density is
            assumed, and it is heavier.
    """
    small, volume = KINDS[kind].sizes[1], float(KINDS[kind].thickness_power)
    title, unit = ("bending EI", "N m^2") if kind == "rope" else ("bending D", "N m")
    heavier = 0.0 if weighed else 1.0
    return {
        "E": Derived(
            title="Young's modulus", unit="Pa", needs=("density",),
            thicker=-volume if weighed else 0.0, heavier=heavier,
        ),
        "bending_length": Derived(
            title="bending length", unit="m", form=".4f", needs=(small,),
            power=1.0 / 3.0, thicker=2.0,
        ),
        "bending_stiffness": Derived(
            title=title, unit=unit, needs=("density", "nu", small),
            thicker=2.0 if weighed else 2.0 + volume, heavier=heavier,
        ),
    }  # fmt: skip


NOTHING_ESTIMATED = Posterior(
    prior=prior_of(()), mean=np.empty(0), covariance=np.empty((0, 0)), bases=()
)


def assumed_density_sd(material: str | None) -> float:
    """Of the logarithm of a density that is assumed: that of a listed material, or of any, as ropes
    and cloths have 300 to 2,000 kg/m^3."""
    return 0.5 if material is None else catalogue.get(material).density.log_sd


# ---- reading -----------------------------------------------------------------------------------


def read_record(path: str | Path, *, even_unusable: bool = True) -> dict[str, Any]:
    """The JSON document of an estimate's file, perhaps of an earlier version, with the present
    names of quantities; errors as of `checked`."""
    read = with_current_names(read_json(path))
    checked(read, str(path), even_unusable=even_unusable)
    return read


def checked(read: Mapping[str, Any], where: str, *, even_unusable: bool = True) -> Stored:
    """What is read of an estimate's record with present names, by its type.

    Raises:
        ParameterError: It has another format or odd types, holds no numbers, or is not usable,
            unless such are wanted, too.
    """
    form, fix = read.get("format"), "give a file written by gendom estimate"
    require(form == FORMAT, f"has format {form!r}, not {FORMAT!r}", where=where, fix=fix)
    fix = "give the file as gendom estimate wrote it"
    stored = record_of(Stored, read, where=where, fix=fix, error=ParameterError)
    verdict = stored.verdict or USABLE
    why, again = ", ".join(verdict.reasons), "record the object again, or"
    usable, fix = even_unusable or verdict.usable, f"{again} add --force"
    require(usable, f"is not usable: {why}", where=where, fix=fix)
    numbers, fix = not read.keys() <= {"format", "verdict"}, f"{again} give flags such as --E"
    what = f"holds no numbers, since nothing was estimated: {why}"
    require(numbers, what, where=where, fix=fix)
    what = "has no posterior: is of a version before 0.2"
    require(stored.posterior is not None, what, where=where, fix="run gendom estimate again")
    return stored


def fields_of(
    read: Mapping[str, Any], stored: Stored, kind: str | None, where: str
) -> tuple[dict[str, Any], dict[str, float]]:
    """Fields of the estimate of a record that was `checked`, and the values that its posterior must
    have. `kind` is of the object, for files that do not say it.

    Raises:
        KeyError, IndexError, TypeError, ValueError, GendomError: The record cannot be used.
    """
    of = (stored.object or {}).get("kind", kind)
    if not isinstance(of, str) or of not in KINDS:
        raise ValueError(f"there is no kind of object {of!r}")
    known = _numbers(read, stored, where)
    level = (stored.intervals or {}).get("level", LEVEL)
    if not isinstance(level, float) or not 0.0 < level < 1.0:
        raise ParameterError(f"level is {level}", where="intervals", fix="estimate again")
    base = Theta(**stored.theta) if stored.theta else None
    base = base and base.with_offsets(stored.marker_offsets or ())
    # files of earlier versions are of one recording
    own = [{}] if stored.recordings is None else [r.theta for r in stored.recordings]
    bases = [base.with_values(theta) for theta in own] if base else []
    posterior = Posterior.from_dict(stored.posterior or {}, bases)
    stated = _stated(known, posterior, of)
    material = None if stored.simulation is None else stored.simulation.material
    sd = 0.0 if "mass" in known else assumed_density_sd(material)
    density_sd = float(read.get("density_sd", sd))
    what = f"density_sd is {density_sd:g}"
    require(0.0 <= density_sd <= LARGEST_SD, what, fix="estimate again")
    about = {k: v for k, v in read.items() if k not in _OWN}
    fields = {"kind": of, "known": known, "posterior": posterior, "about": about}
    return {**fields, "level": level, "density_sd": density_sd}, stated


def _stated(known: dict[str, float], posterior: Posterior, kind: str) -> dict[str, float]:
    """Take out of a record's numbers those that the posterior has, and return them. What is left
    is of an object as thick as stated."""
    owners = zip(posterior.names, posterior.prior.owners, strict=True)
    names = [name for name, owner in owners if owner is None]
    stated = {n: known.pop(n) for n in ("E", *names) if n in known and n != "thickness"}
    if "thickness" not in names:
        return stated
    small, power = KINDS[kind].sizes[1], KINDS[kind].thickness_power
    r = UNKNOWNS["thickness"].value(float(posterior.mean[posterior.names.index("thickness")]))
    if small in known:
        stated["thickness"] = known[small]
        known[small] /= r
    if "mass" in known and "density" in known:
        known["density"] *= r**power
    return stated


_OWN = (
    "format", "theta", "marker_offsets", "E", "bending_length", "bending_stiffness", "density",
    "density_assumed", "density_sd", "verdict", "intervals", "bounds", "identifiable", "posterior",
    "object", CHECKSUM,
)  # fmt: skip
"""Entries of the file that `Estimate.record` computes, beside values of unknowns."""


def _numbers(read: Mapping[str, Any], stored: Stored, where: str) -> dict[str, float]:
    """The file's numbers of the object.

    Raises:
        GendomError: One is none, or not positive.
    """
    names = {n for n, u in UNKNOWNS.items() if u.material and n != "thickness"}
    numbers = {n: read.get(n) for n in ("E", *names, "density")}
    numbers |= {n: (stored.object or {}).get(n) for n in (*SIZES, "mass")}
    fix = "estimate again, or give the number by a flag"
    for name, value in numbers.items():
        least = isinstance(value, (int, float)) and (value > 0.0 or (not value and name in HIDDEN))
        right = value is None or least or (name in UNKNOWNS and UNKNOWNS[name].low <= 0)
        what = f"{name} must be a positive number, got {value!r}"
        require(right, what, where=where, fix=fix, error=GendomError)
    return {n: float(v) for n, v in numbers.items() if v is not None}
