"""Coverage of intervals: random objects of the MuJoCo test scene are lifted, perceived and
estimated. Objects have the seeds from --seed on; every lift and every estimate is kept.

Also writes the factors of the intervals, from which `gendom/assets/calibration.json` is made.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import binom, norm

from experiments.runs import Chart, Result, Runs, Table
from gendom.datasets import Recording
from gendom.errors import GendomError
from gendom.estimation import (
    UNKNOWNS,
    EstimateSettings,
    IntervalCalibration,
    SceneSettings,
    estimate,
)
from gendom.estimation.lift_plan import CLOUD_POINTS
from gendom.files import write_json
from gendom.materials import STANDARD_GRAVITY, Material
from gendom.materials.parameters import E_over_rho_of
from gendom.reality import RealCloth, RealObject, RealRope
from gendom.reality.objects import vertices_of
from gendom.robot import predefined_lift

BAND = 0.95
"""Probability with which all bars of uniform ranks lie within their band."""

BINS, A_BIN = (4, 20), 5
"""Bars of a histogram of ranks, at least and at most, and how many ranks each should hold."""

LEVEL = 0.9
"""Probability that intervals claim."""


@dataclass(frozen=True, kw_only=True)
class Lifts:
    """What is lifted and how; one random object a seed."""

    kind: str = "rope"
    """``rope`` or ``cloth``."""
    end: str = "hold"
    """How lifts end, one of `gendom.robot.LIFT_ENDS`."""

    @property
    def name(self) -> str:
        """Part of the names of files."""
        return f"{self.kind}-{self.end}"

    def recorded(self, runs: Runs, seed: int) -> Recording:
        """The lift of a random object, of twice as many points a frame as estimates compare."""
        item, motion = draw_object(self.kind, seed), predefined_lift(self.kind, self.end)
        own, label = replace(runs, seed=seed), f"{self.name}-{seed:04d}"
        return own.recorded(label, item, motion, CLOUD_POINTS[self.kind])


def estimate_settings(seed: int) -> EstimateSettings:
    """Of a lift: one start on one thread, as processes work side by side."""
    return EstimateSettings(starts=1, seed=seed, level=LEVEL, scene=SceneSettings(threads=1))


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """A row for each lift: what was estimated, without calibration, and what is true."""
    lifts = Lifts(kind=flags.kind, end=flags.end)
    seeds = range(flags.seed, flags.seed + flags.lifts)
    rows = list(runs.each(partial(_row, runs, lifts), seeds, "lifting"))
    table = covered(rows, LEVEL)
    factors = {lifts.kind: calibration_of(rows, table)}
    write_json(runs.folder / f"calibration-{lifts.name}.json", factors)
    settings = {**asdict(lifts), "lifts": flags.lifts, "level": LEVEL}
    return Result(
        name=f"coverage-{lifts.name}",
        figures={**settings, "unknowns": [asdict(c) for c in table], "rows": rows},
        shown=shown_of(rows, table),
        notes=reasons_of(rows),
    )


def draw_object(kind: str, seed: int) -> RealObject:
    """A random rope or square cloth of the second reality.

    Ropes are 0.25 to 0.36 m long, 3.5 to 6 % of that thick and bend over 0.25 to 0.7 lengths;
    cloths are 0.2 to 0.36 m wide, 0.4 to 1.2 mm thick and bend over 14 to 50 mm. Density 500 to
    1,100 (cloths from 300) kg/m^3, nu 0.2 to 0.4, damping log-uniform 1 to 20 ms, friction 0.1 to
    0.8.
    """
    rng = np.random.default_rng([77, seed])

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    nu, friction = between(0.2, 0.4), between(0.1, 0.8)
    damping = math.exp(between(math.log(0.001), math.log(0.02)))
    if kind == "rope":
        length, density = between(0.25, 0.36), between(500.0, 1100.0)
        diameter, bends = length * between(0.035, 0.06), length * between(0.25, 0.7)
        E = density * E_over_rho_of(bends, diameter / 4.0, STANDARD_GRAVITY)
        return RealRope(
            name=f"rope-{seed}",
            length=length,
            diameter=diameter,
            material=Material(E=E, nu=nu, density=density, damping=damping),
            friction=friction,
            colour=(200, 40, 40),
            # MuJoCo wants vertices farther apart than they are thick
            vertices=min(18, int(0.95 * length / diameter)),
        )
    side, thickness, density = between(0.2, 0.36), between(4e-4, 1.2e-3), between(300.0, 1100.0)
    bends = math.exp(between(math.log(0.014), math.log(0.05)))
    k = thickness / math.sqrt(12.0 * (1.0 - nu**2))
    return RealCloth(
        name=f"cloth-{seed}",
        side=side,
        thickness=thickness,
        material=Material(
            E=density * E_over_rho_of(bends, k, STANDARD_GRAVITY),
            nu=nu,
            density=density,
            damping=damping,
        ),
        friction=friction,
        colour=(40, 70, 190),
        vertices=vertices_of(side, bends),
    )


def _row(runs: Runs, lifts: Lifts, seed: int) -> dict[str, Any]:
    return runs.kept(f"{lifts.name}-{seed:04d}", partial(_estimated, runs, lifts, seed))


def _estimated(runs: Runs, lifts: Lifts, seed: int) -> dict[str, Any]:
    row: dict[str, Any] = {"seed": seed, "truth": truth_of(draw_object(lifts.kind, seed))}
    try:
        recording = lifts.recorded(runs, seed)
        found = estimate(recording, estimate_settings(seed), calibration=IntervalCalibration.none())
    except GendomError as error:
        return {**row, "fault": str(error)}
    return {
        **row,
        "verdict": asdict(found.verdict),
        "posterior": found.posterior.to_dict(),
        "rms": found.record["rms"],
        "seconds": found.record["seconds"],
        "displaced": found.record["noise"]["model"] / found.scene.size,
    }


def truth_of(item: RealObject) -> dict[str, float]:
    """By names of `gendom.estimation.UNKNOWNS`. Lifts show a cloth's rigidity
    E t^3 / (12 (1 - nu^2)) alone: its E is the one that gives this with the nu that estimates
    assume."""
    m = item.material
    wide = 1.0 if isinstance(item, RealRope) else (1.0 - m.nu**2) / (1.0 - UNKNOWNS["nu"].mean ** 2)
    return {
        "E_over_rho": m.E_over_rho / wide,
        "nu": m.nu,
        "damping": m.damping,
        "friction": item.friction,
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


def covered(rows: Sequence[dict[str, Any]], level: float) -> list[Covered]:
    """Of all unknowns whose truth is known, over the usable lifts.

    Args:
        rows: Of lifts.
        level: Probability that intervals claim.
    """
    usable = _usable(rows)
    z = float(norm.ppf(0.5 + level / 2.0))
    found = []
    for name in ("E_over_rho", "nu", "damping", "friction"):
        off, sd = [], []
        for row in usable:
            posterior = row["posterior"]
            if name not in posterior["names"]:
                continue
            k = posterior["names"].index(name)
            truth = row["truth"][name]
            off.append(posterior["mean"][k] - (math.log(truth) if posterior["log"][k] else truth))
            sd.append(math.sqrt(posterior["covariance"][k][k]))
        if not off:
            continue
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
                covered=float(np.mean(error < z * deviation)),
                factor=float(np.quantile(error / deviation, level)) / z,
                added=_added(error / z, deviation, level),
                ranks=tuple(map(float, ranks)),
                counts=tuple(map(int, np.histogram(ranks, bins, range=(0.0, 1.0))[0])),
                band=rank_band(len(off), bins),
            )
        )
    return found


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


def shown_of(rows: Sequence[dict[str, Any]], table: Sequence[Covered]) -> list[Table | Chart]:
    """The table of `covered`, and the histogram of each unknown's ranks.

    Where posteriors are right, the truth has any rank among their values as often as any other, and
    bars end within the band. Bars that are high on both sides mean posteriors that are too narrow,
    bars that are high on one side a bias.
    """
    head = ("error, median", "90 % below", "bias", "half width", "covered", "factor", "or added",
            "ranks")  # fmt: skip
    texts = {
        c.name: (
            f"{c.median_error:.4f}",
            f"{c.ninety_error:.4f}",
            f"{c.bias:+.4f}",
            f"{c.half_width:.4f}",
            f"{c.covered:.0%}",
            f"{c.factor:.2f}",
            f"{c.added:.4f}",
            "in the band" if c.uniform else "not uniform",
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
