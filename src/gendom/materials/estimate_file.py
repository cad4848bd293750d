"""The file of an estimate: the numbers in it that follow from others, and how it is read.

Its single source of truth is the posterior; the values beside it follow from that. A file that was
changed after it was written is refused.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.files import to_json
from gendom.materials.objects import KINDS
from gendom.materials.posterior import Posterior, prior_of
from gendom.materials.unknowns import UNKNOWNS, Theta
from gendom.reading import read_json

FORMAT = "gendom-estimate/1"
_GIVE = "give a file written by gendom estimate"

LEVEL = 0.9
"""Probability of intervals where an estimate names none."""

HIDDEN = ("damping", "friction")
"""What many recordings do not determine: where one does not, the usual value is taken for it."""

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


# ---- reading -----------------------------------------------------------------------------------


def read_record(path: str | Path, *, even_unusable: bool = True) -> dict[str, Any]:
    """The JSON document of an estimate's file; errors as of `check_record`."""
    read = read_json(path, fix=_GIVE)
    check_record(read, str(path), even_unusable=even_unusable)
    return read


def check_record(read: Mapping[str, Any], where: str, *, even_unusable: bool = True) -> None:
    """Refuse what is not an estimate's record as it was written.

    Raises:
        ParameterError: It has another format or no checksum, was changed, holds no numbers, or is
            not usable, unless such are wanted, too.
    """
    form = read.get("format")
    require(form == FORMAT, f"has format {form!r}, not {FORMAT!r}", where=where, fix=_GIVE)
    verdict, again = read.get("verdict"), "record the object again, or"
    reasons = verdict.get("reasons") if isinstance(verdict, dict) else None
    why = ", ".join(map(str, reasons if isinstance(reasons, list) else ()))
    numbers, fix = not read.keys() <= {"format", "verdict"}, f"{again} give flags such as --E"
    what = f"holds no numbers, since nothing was estimated: {why}"
    require(numbers, what, where=where, fix=fix)
    what = "has no checksum: is of a version before 0.2"
    require(CHECKSUM in read, what, where=where, fix="run gendom estimate again")
    fix = "leave the file as it was written; give another number by a flag such as --E"
    whole = read[CHECKSUM] == checksum(read)
    require(whole, "was changed after it was written", where=where, fix=fix)
    usable = even_unusable or not isinstance(verdict, dict) or verdict.get("usable")
    require(usable, f"is not usable: {why}", where=where, fix=f"{again} add --force")


_OWN = (
    "format", "theta", "marker_offsets", "E", "bending_length", "bending_stiffness", "density",
    "density_assumed", "density_sd", "verdict", "intervals", "bounds", "identifiable", "posterior",
    "object", CHECKSUM,
)  # fmt: skip
"""Entries of the file that `Estimate.record` computes, beside values of unknowns."""


def fields_of(read: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of the estimate of a record that was checked.

    Raises:
        KeyError, TypeError, ValueError, GendomError: An unknown of another package is missing here.
    """
    stated, verdict = read["object"], read["verdict"]
    bases = []
    if "theta" in read:
        base = Theta(**read["theta"]).with_offsets(read.get("marker_offsets") or ())
        bases = [base.with_values(r["theta"]) for r in read.get("recordings") or [{"theta": {}}]]
    posterior = Posterior.from_dict(read["posterior"], bases)
    owners = zip(posterior.names, posterior.prior.owners, strict=True)
    estimated = {name for name, owner in owners if owner is None}
    names = {n for n, u in UNKNOWNS.items() if u.material} - estimated - {"thickness"}
    known = {n: read.get(n) for n in (*sorted(names), "density")}
    known |= {n: stated.get(n) for n in (*SIZES, "mass")}
    known = {n: float(v) for n, v in known.items() if v is not None}
    if "thickness" in estimated:
        # what is known is of an object as thick as stated
        kind = KINDS[stated["kind"]]
        k = posterior.names.index("thickness")
        times = UNKNOWNS["thickness"].value(float(posterior.mean[k]))
        if kind.sizes[1] in known:
            known[kind.sizes[1]] /= times
        if "mass" in known and "density" in known:
            known["density"] *= times**kind.thickness_power
    return {
        "kind": stated["kind"],
        "known": known,
        "posterior": posterior,
        "verdict": Verdict(usable=verdict["usable"], reasons=tuple(verdict["reasons"])),
        "level": (read["intervals"] or {"level": LEVEL})["level"],
        "density_sd": read["density_sd"],
        "about": {k: v for k, v in read.items() if k not in _OWN},
    }
