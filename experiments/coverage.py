"""Coverage of intervals: random objects of the MuJoCo test scene are lifted, perceived and
estimated. Objects have the seeds from --seed on; every lift and every estimate is kept.

Reported are the intervals that users get, of lifts that their calibration has not seen. With
--calibrate estimates have their likelihood's own deviations, and the factors are written from which
`gendom/assets/calibration.json` is made.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binom, norm

from experiments.lifts import LEVEL, Lifts, estimate_settings, measured, truth_of
from experiments.runs import Chart, Result, Runs, Table
from gendom.arguments import require
from gendom.datasets import Recording
from gendom.errors import GendomError, ParameterError
from gendom.estimation import IntervalCalibration, estimate
from gendom.files import write_json
from gendom.reading import read_json

REPORTED = ("E", "bending_length", "nu", "damping", "friction")
TOLD = {
    "E": ("E",),
    "bending_length": ("bending_length", "lb", "b"),
    "damping": ("damping", "tau"),
    "friction": ("friction", "mu"),
    "nu": ("nu",),
}
"""What files of truths call what is reported."""

CALIBRATED = ("E_over_rho", "nu", "damping", "friction")

BAND = 0.95
"""Probability with which all bars of uniform ranks lie within their band."""

BINS, A_BIN = (4, 20), 5
"""Bars of a histogram of ranks, at least and at most, and how many ranks each should hold."""


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """A row for each lift: what was estimated and what is true."""
    if flags.given:
        return _of_others(runs, flags)
    lifts, seeds = Lifts.of(flags), range(flags.seed, flags.seed + flags.lifts)
    if flags.calibrate:
        return _calibrated(runs, lifts, seeds)
    check_unseen(lifts, seeds)
    rows = _rows(runs, lifts, seeds, "")
    table = covered(rows, LEVEL, REPORTED)
    by_hand = _rows(runs, lifts, seeds, "-measured") if flags.measured else []
    beside = covered(by_hand, LEVEL, REPORTED)
    return Result(
        name=f"coverage-{lifts.name}",
        figures={
            **_settings(lifts, rows),
            "unknowns": {c.name: asdict(c) for c in table},
            "measured": {c.name: asdict(c) for c in beside},
            "rows": rows,
        },
        shown=shown_of(rows, table, beside),
        notes=reasons_of(rows),
    )


def _of_others(runs: Runs, flags: argparse.Namespace) -> Result:
    """Recordings that were given, of known objects."""
    places = sorted(p for p in flags.given.glob("*.npz") if p.with_suffix(".json").exists())
    require(places, "has no NAME.npz with a NAME.json", where=str(flags.given))
    rows = list(runs.each(partial(_given, runs, flags.seed), places, "estimating"))
    by_kind = {row["kind"]: [r for r in rows if r["kind"] == row["kind"]] for row in rows}
    tables = {kind: covered(own, LEVEL, REPORTED) for kind, own in by_kind.items()}
    shown = [shown_of(own, tables[kind])[0] for kind, own in by_kind.items()]
    return Result(
        name="coverage-given",
        figures={
            "lifts": len(rows),
            "usable": len(_usable(rows)),
            **{kind: {c.name: asdict(c) for c in table} for kind, table in tables.items()},
            "rows": rows,
        },
        shown=shown,
        notes=reasons_of(rows),
    )


def _given(runs: Runs, seed: int, place: Path) -> dict[str, Any]:
    return runs.kept(f"given-{place.stem}", partial(estimated_of, place, seed))


def estimated_of(place: Path, seed: int) -> dict[str, Any]:
    """What is estimated of a recording, beside the truth in the JSON file of its name."""
    told = read_json(place.with_suffix(".json"))
    recording = Recording.read(place, on_warning=lambda _: None)
    truth = {name: told[key] for name, keys in TOLD.items() for key in keys if told.get(key)}
    return {"seed": place.stem, "truth": truth, **_found(recording, seed)}


def _calibrated(runs: Runs, lifts: Lifts, seeds: range) -> Result:
    """Deviations without calibration, and the file of factors."""
    rows = _rows(runs, lifts, seeds, "-raw")
    table = covered(rows, LEVEL, CALIBRATED)
    source = {"drawn": lifts.drawn, "seeds": [seeds[0], seeds[-1]]}
    factors = {lifts.kind: {**source, **calibration_of(rows, table)}}
    write_json(runs.folder / f"calibration-{lifts.name}.json", factors)
    return Result(
        name=f"coverage-{lifts.name}-raw",
        figures={
            **_settings(lifts, rows),
            "unknowns": {c.name: asdict(c) for c in table},
            "rows": rows,
        },
        shown=shown_of(rows, table, calibrate=True),
        notes=reasons_of(rows),
    )


def _settings(lifts: Lifts, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    usable = _usable(rows)
    took = [row["seconds"] for row in usable if "seconds" in row]
    return {
        **asdict(lifts),
        "level": LEVEL,
        "lifts": len(rows),
        "usable": len(usable),
        "median_seconds": float(np.median(took)) if took else None,
    }


def check_unseen(lifts: Lifts, seeds: range) -> None:
    """Refuse lifts that the shipped calibration was made from: their intervals hold by making.

    Raises:
        ParameterError: Some are.
    """
    place = resources.files("gendom") / "assets" / "calibration.json"
    for made in json.loads(place.read_text(encoding="utf-8")).values():
        if made.get("drawn") == lifts.drawn:
            first, last = made["seeds"]
            if seeds[0] <= last and first <= seeds[-1]:
                raise ParameterError(
                    f"the shipped intervals were calibrated on the {lifts.kind}s of seeds {first} "
                    f"to {last}",
                    where=f"seeds {seeds[0]} to {seeds[-1]}",
                    fix=f"take --seed {last + 1} or above, or --calibrate",
                )


def _rows(runs: Runs, lifts: Lifts, seeds: range, which: str) -> list[dict[str, Any]]:
    return list(runs.each(partial(_row, runs, lifts, which), seeds, f"lifting{which}"))


def _row(runs: Runs, lifts: Lifts, which: str, seed: int) -> dict[str, Any]:
    name = f"estimate-{lifts.name}-{seed:04d}{which}"
    return runs.kept(name, partial(_estimated, runs, lifts, which, seed))


def _estimated(runs: Runs, lifts: Lifts, which: str, seed: int) -> dict[str, Any]:
    """What is estimated with the shipped calibration; ``-raw``: with none; ``-measured``: of what
    people measured."""
    row: dict[str, Any] = {"seed": seed, "truth": truth_of(lifts.object(seed))}
    try:
        recording = lifts.recorded(runs, seed)
    except GendomError as error:
        return {**row, "fault": str(error)}
    if which == "-measured":
        recording = measured(recording, seed)
    return row | _found(recording, seed, IntervalCalibration() if which == "-raw" else None)


def _found(
    recording: Recording, seed: int, calibration: IntervalCalibration | None = None
) -> dict[str, Any]:
    """What rows say of an estimate."""
    try:
        found = estimate(recording, estimate_settings(seed), calibration=calibration)
    except GendomError as error:
        return {"fault": str(error), "kind": recording.object.kind}
    return {
        "kind": recording.object.kind,
        "verdict": asdict(found.verdict),
        "values": {name: found.record[name] for name in (*REPORTED, "E_over_rho")},
        "intervals": found.record["intervals"],
        "posterior": found.posterior.to_dict(),
        "rms": found.record["rms"],
        "seconds": found.record["seconds"],
        "displaced": found.record["noise"]["model"] / found.scene.size,
    }


@dataclass(frozen=True, kw_only=True)
class Covered:
    """Errors and intervals of one unknown over N lifts, in transformed units."""

    name: str
    lifts: int
    median_error: float
    ninety_error: float
    """90th percentile of the errors."""
    bias: float
    half_width: float
    """Median half width of the intervals."""
    covered: float
    """Share of intervals that hold the truth."""
    factor: float
    """Factor of deviations with which `level` of the intervals hold the truth; below 1: they are
    too wide."""
    added: float
    """Standard deviation that has the same effect if it is added in squares."""
    ranks: tuple[float, ...]
    """[N] posterior probability below the truth: uniform where posteriors are correct."""
    counts: tuple[int, ...]
    """How many ranks lie in each of equal parts of 0 to 1."""
    band: tuple[int, int]
    """Between which all of those lie with the probability `BAND` where ranks are uniform."""

    @property
    def uniform(self) -> bool:
        """Whether all counts lie in the band that uniform ranks have."""
        return self.band[0] <= min(self.counts) and max(self.counts) <= self.band[1]


def rank_band(count: int, bins: int) -> tuple[int, int]:
    """Least and most of so many uniform ranks that lie in one of several equal parts, for all parts
    together with the probability `BAND` or more.

    After Talts et al. (2018), "Validating Bayesian inference algorithms with simulation-based
    calibration", with the bars' misses shared out among them (Bonferroni).
    """
    miss = (1.0 - BAND) / (2.0 * bins)
    low, high = binom.ppf([miss, 1.0 - miss], count, 1.0 / bins)
    return int(low), int(high)


def covered(
    rows: Sequence[dict[str, Any]], level: float, names: Sequence[str] = CALIBRATED
) -> list[Covered]:
    """Of all that was estimated and whose truth is known, over the usable lifts.

    Args:
        rows: Of lifts.
        level: Probability that intervals claim.
        names: Unknowns, and values of estimates that follow from them.
    """
    usable = _usable(rows)
    z = float(norm.ppf(0.5 + level / 2.0))
    found = []
    for name in names:
        errors = [known for row in usable if (known := _error(row, name, z)) is not None]
        if not errors:
            continue
        off, sd, held = map(list, zip(*errors, strict=True))
        error, deviation = np.abs(off), np.array(sd)
        ranks = norm.cdf(-np.array(off) / deviation)
        bins = min(max(len(off) // A_BIN, BINS[0]), BINS[1])
        found.append(
            Covered(
                name=name,
                lifts=len(off),
                median_error=float(np.median(error)),
                ninety_error=float(np.quantile(error, 0.9)),
                bias=float(np.mean(off)),
                half_width=float(np.median(z * deviation)),
                covered=float(np.mean(held)),
                factor=float(np.quantile(error / deviation, level)) / z,
                added=_added(error / z, deviation, level),
                ranks=tuple(map(float, ranks)),
                counts=tuple(map(int, np.histogram(ranks, bins, range=(0.0, 1.0))[0])),
                band=rank_band(len(off), bins),
            )
        )
    return found


def _error(row: dict[str, Any], name: str, z: float) -> tuple[float, float, bool] | None:
    """Error and standard deviation of what was estimated, in transformed units, and whether its
    interval of so many deviations holds the truth; None where it was not estimated."""
    posterior, intervals = row["posterior"], row.get("intervals") or {}
    measured_thickness = "thickness" in posterior["names"] and "thickness" not in row["truth"]
    if name == "E_over_rho" and measured_thickness and "bending_length" in intervals:
        # E / density is as uncertain as the stated thickness; what is calibrated is the rest
        off, sd, held = _error(row, "bending_length", z) or (0.0, 0.0, False)
        return 3.0 * off, 3.0 * sd, held
    truth, interval = row["truth"].get(name), intervals.get(name)
    if truth is None:
        return None
    if name in posterior["names"]:
        k = posterior["names"].index(name)
        off = posterior["mean"][k] - (math.log(truth) if posterior["log"][k] else truth)
        sd = math.sqrt(posterior["covariance"][k][k])
    elif interval is not None:
        off = math.log(row["values"][name] / truth)
        sd = math.log(interval[1] / interval[0]) / (2.0 * z)
    else:
        return None
    held = abs(off) < z * sd if interval is None else interval[0] <= truth <= interval[1]
    return off, sd, held


def _added(wanted: np.ndarray, deviation: np.ndarray, level: float) -> float:
    """Standard deviation that, added in squares, makes `level` of the intervals hold the truth."""
    missing = np.sqrt(np.maximum(wanted**2 - deviation**2, 0.0))
    return float(np.quantile(missing, level))


def calibration_of(
    rows: Sequence[dict[str, Any]], table: Sequence[Covered]
) -> dict[str, float | dict[str, float]]:
    """What `gendom.estimation.IntervalCalibration` takes for objects of this kind.

    Intervals that are too wide get a factor; to those that are too narrow a deviation is added,
    since what is missing there does not shrink with the noise.
    """
    usable = _usable(rows)
    known = [r["displaced"] for r in usable if "displaced" in r]
    return {
        "lifts": len(usable),
        "displaced": max(known, default=0.0),
        "factor": {c.name: c.factor for c in table if c.factor < 1.0},
        "added": {c.name: c.added for c in table if c.factor >= 1.0},
    }


def shown_of(
    rows: Sequence[dict[str, Any]],
    table: Sequence[Covered],
    beside: Sequence[Covered] = (),
    *,
    calibrate: bool = False,
) -> list[Table | Chart]:
    """The table of `covered`, and the histogram of each unknown's ranks.

    Where posteriors are right, the truth has any rank among their values as often as any other, and
    bars end within the band. Bars that are high on both sides mean posteriors that are too narrow,
    bars that are high on one side a bias.

    Args:
        rows: Of lifts.
        table: Of them.
        beside: Of the same lifts with measured sizes, mass and clamp.
        calibrate: Whether factors are shown.
    """
    by_hand = {c.name: (f"{c.ninety_error:.4f}", f"{c.covered:.0%}") for c in beside}
    head = ("error, median", "90 % below", "bias", "half width", "covered", "ranks")
    head += ("factor", "or added") if calibrate else ()
    head += ("measured: 90 % below", "covered") if beside else ()
    texts = {
        c.name: (
            f"{c.median_error:.4f}",
            f"{c.ninety_error:.4f}",
            f"{c.bias:+.4f}",
            f"{c.half_width:.4f}",
            f"{c.covered:.0%}",
            "in the band" if c.uniform else "not uniform",
            *((f"{c.factor:.2f}", f"{c.added:.4f}") if calibrate else ()),
            *by_hand.get(c.name, ()),
        )
        for c in table
    }
    return [
        Table(title=f"{len(rows)} lifts, {len(_usable(rows))} usable", head=head, rows=texts),
        *(
            Chart(
                title=f"Ranks of {c.name}, and the {100.0 * BAND:g} % band of uniform ranks",
                x="share of the posterior below the truth",
                y="lifts",
                counts=c.counts,
                band=c.band,
            )
            for c in table
        ),
    ]


def reasons_of(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Why lifts are not usable, a line each."""
    found = (
        (r["seed"], r.get("fault") or "; ".join(r.get("verdict", {}).get("reasons", ())))
        for r in rows
    )
    return [f"  seed {seed}: {reasons}" for seed, reasons in found if reasons]


def _usable(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return [row for row in rows if row.get("verdict", {}).get("usable")]
