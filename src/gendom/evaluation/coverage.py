"""Coverage of intervals: random objects of the MuJoCo test scene are lifted, perceived and
estimated.

Every lift and every estimate is kept in a folder, so that an interrupted run continues.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.stats import binom, norm

from gendom.datasets import Recording
from gendom.errors import GendomError, ParameterError
from gendom.estimation import EstimateSettings, IntervalCalibration, SceneSettings, Theta, estimate
from gendom.evaluation.sheet import Ranks, Sheet
from gendom.files import write_json
from gendom.materials import STANDARD_GRAVITY, Material
from gendom.materials.parameters import E_over_rho_of
from gendom.reality import RealCloth, RealObject, RealRope
from gendom.reality.chain import record_and_perceive
from gendom.reality.objects import vertices_of

CLOUD_POINTS = {"rope": 320, "cloth": 1400}
"""Points of a frame that are kept, twice what an estimate compares."""

FRAME_RATE = {"hold": 10.0, "swing": 30.0, "drop": 30.0}
"""Of the cameras by how a lift ends [1/s]."""


BAND = 0.95
"""Probability with which all bars of uniform ranks lie within their band."""

BINS, A_BIN = (4, 20), 5
"""Bars of a histogram of ranks, at least and at most, and how many ranks each should hold."""


@dataclass(frozen=True, kw_only=True)
class CoverageSettings:
    """Kinds and numbers of lifts."""

    kind: str = "rope"
    """``rope`` or ``cloth``."""
    end: str = "hold"
    """How lifts end, one of `gendom.robot.LIFT_ENDS`."""
    lifts: int = 40
    seed: int = 0
    """Of the first object; each further one has the next number."""
    level: float = 0.9
    jobs: int = 1
    """Processes."""

    def __post_init__(self) -> None:
        if self.kind not in CLOUD_POINTS:
            raise ParameterError(f"is {self.kind!r}", where="kind", fix="give rope or cloth")
        if self.end not in FRAME_RATE:
            raise ParameterError(f"is {self.end!r}", where="end", fix="give hold, swing or drop")
        if self.lifts < 1 or self.jobs < 1 or self.seed < 0:
            raise ParameterError("lifts and jobs must be at least 1, the seed at least 0")

    def estimate_settings(self, seed: int) -> EstimateSettings:
        """Of the lift with this seed: one start on one thread, as processes work side by side."""
        return EstimateSettings(
            starts=1, seed=seed, level=self.level, scene=SceneSettings(threads=1)
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
        vertices=vertices_of(side),
    )


def coverage(
    folder: str | Path,
    settings: CoverageSettings,
    *,
    on_done: Callable[[int], None] | None = None,
) -> list[dict[str, Any]]:
    """A row for each lift: what was estimated, without calibration, and what is true.

    Args:
        folder: Keeps recordings and rows; existing ones are kept.
        settings: Which lifts.
        on_done: Called with the number of lifts done.

    Raises:
        DeviceError: The second reality cannot be simulated or rendered here.
        GendomError: The folder cannot be written.
    """
    return of_each_lift(partial(_row, Path(folder), settings), settings, on_done)


def of_each_lift(
    work: Callable[[int], Any],
    settings: CoverageSettings,
    on_done: Callable[[int], None] | None = None,
) -> list[Any]:
    """What a function gives for the seed of each lift, by processes side by side.

    Args:
        work: The function; it can be pickled.
        settings: Which lifts, and the number of processes.
        on_done: Called with the number of lifts done.
    """
    seeds = range(settings.seed, settings.seed + settings.lifts)
    done = []
    with ExitStack() as stack:
        made = map(work, seeds)
        if settings.jobs > 1:
            pool = stack.enter_context(get_context("spawn").Pool(settings.jobs))
            made = pool.imap(work, seeds)
        for one in made:
            done.append(one)
            if on_done is not None:
                on_done(len(done))
    return done


def _row(folder: Path, settings: CoverageSettings, seed: int) -> dict[str, Any]:
    name = f"{settings.kind}-{settings.end}-{seed:04d}"
    kept = folder / f"{name}.json"
    if kept.exists():
        return json.loads(kept.read_text(encoding="utf-8"))
    item = draw_object(settings.kind, seed)
    row: dict[str, Any] = {"seed": seed, "truth": truth_of(item)}
    try:
        found = estimate(
            recorded(folder, settings, seed),
            settings.estimate_settings(seed),
            calibration=IntervalCalibration.none(),
        )
    except GendomError as error:
        row["fault"] = str(error)
    else:
        row["verdict"] = asdict(found.verdict)
        row["posterior"] = found.posterior.to_dict()
        row["rms"], row["seconds"] = found.record["rms"], found.record["seconds"]
        row["displaced"] = found.record["noise"]["model"] / found.scene.size
    write_json(kept, row)
    return row


def recorded(folder: Path, settings: CoverageSettings, seed: int) -> Recording:
    """The lift of a random object, from the folder where it is kept there."""
    path = folder / f"{settings.kind}-{settings.end}-{seed:04d}.npz"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        item = draw_object(settings.kind, seed)
        with TemporaryDirectory(dir=folder) as pictures:
            made, _ = record_and_perceive(
                item, pictures, frame_rate=FRAME_RATE[settings.end], seed=seed, end=settings.end
            )
        _thinned(made, CLOUD_POINTS[settings.kind], seed).write(path)
    return Recording.read(path, on_warning=lambda _: None)


def _thinned(recording: Recording, most: int, seed: int) -> Recording:
    """With at most twice as many points a frame as an estimate compares."""
    rng = np.random.default_rng(seed)
    clouds = []
    for t in range(recording.num_frames):
        cloud = recording.frame(t)
        if len(cloud) > most:
            cloud = cloud[np.sort(rng.choice(len(cloud), most, replace=False))]
        clouds.append(cloud)
    return replace(
        recording,
        points=np.concatenate(clouds),
        offsets=np.cumsum([0, *map(len, clouds)]),
    )


def truth_of(item: RealObject) -> dict[str, float]:
    """By names of `gendom.estimation.UNKNOWNS`. Lifts show a cloth's rigidity
    E t^3 / (12 (1 - nu^2)) alone: its E is the one that gives this with the nu that estimates
    assume."""
    m = item.material
    wide = 1.0 if isinstance(item, RealRope) else (1.0 - m.nu**2) / (1.0 - Theta.nu**2)
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
        rows: Of `coverage`.
        level: Probability that intervals claim.
    """
    usable = [r for r in rows if r.get("verdict", {}).get("usable")]
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
    """What `gendom.estimation.Calibration` takes for objects of this kind, as its file has it.

    Intervals that are too wide get a factor; to those that are too narrow a deviation is added,
    since what is missing there does not shrink with the noise.
    """
    usable = [r for r in rows if r.get("verdict", {}).get("usable")]
    known = [r["displaced"] for r in usable if "displaced" in r]
    return {
        "lifts": len(usable),
        "displaced": max(known, default=0.0),
        "factor": {c.name: c.factor for c in table if c.factor < 1.0},
        "added": {c.name: c.added for c in table if c.factor >= 1.0},
    }


def coverage_sheets(
    rows: Sequence[dict[str, Any]], table: Sequence[Covered]
) -> list[Sheet | Ranks]:
    """The table of `covered`, and the histogram of each unknown's ranks."""
    usable = sum(bool(r.get("verdict", {}).get("usable")) for r in rows)
    sheet = Sheet(
        title=f"{len(rows)} lifts, {usable} usable",
        head=(
            "error, median",
            "90 % below",
            "bias",
            "half width",
            "covered",
            "factor",
            "or added",
            "ranks",
        ),
        rows={
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
        },
    )
    ranks = [
        Ranks(
            title=f"Ranks of {c.name}",
            counts=c.counts,
            band=c.band,
            band_label=f"{100.0 * BAND:g} % band of uniform ranks",
        )
        for c in table
    ]
    return [sheet, *ranks]


def coverage_text(rows: Sequence[dict[str, Any]], table: Sequence[Covered]) -> str:
    """For people."""
    lines = [str(coverage_sheets(rows, table)[0])]
    for row in rows:
        reasons = row.get("fault") or "; ".join(row.get("verdict", {}).get("reasons", ()))
        if reasons:
            lines.append(f"  seed {row['seed']}: {reasons}")
    return "\n".join(lines)
