"""The paper's table real2sim, in the MuJoCo test scene: objects are lifted once and estimated by
each method. The ropes have the names of the paper's, and the lift rises as high as the paper's
simulated one, on which PointNet++ is trained. True parameters serve only for the errors.
"""

from __future__ import annotations

import argparse
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from experiments.adam import adam
from experiments.evolution import differential_evolution
from experiments.lifts import truth_of
from experiments.pointnet import pointnet
from experiments.runs import Result, Runs, Table
from experiments.sim2sim import LENGTH, RISE
from gendom.errors import GendomError
from gendom.estimation import METHODS, EstimateSettings, SceneSettings, estimate
from gendom.robot import LiftMotion, predefined_lift

_log = logging.getLogger(__name__)

OBJECTS = ("rope-cotton", "rope-polyester", "rope-polyethylene", "cloth-cotton", "cloth-rubber")
"""Of the second reality, as the paper's."""

ROWS = {
    "rope": (
        ("gauss-newton", "all"),
        ("gauss-newton", "last"),
        ("adam", "all"),
        ("differential-evolution", "all"),
        ("pointnet", "last"),
    ),
    "cloth": (("gauss-newton", "all"),),
}
"""Rows by kind of object: methods, and the frames that they see."""

BASELINES = {
    "adam": adam,
    "differential-evolution": differential_evolution,
    "pointnet": pointnet,
}
"""Methods beside the estimator's own."""

PAPER = {
    "adam": {"rope-cotton": 0.034, "rope-polyester": 0.060, "rope-polyethylene": 0.053},
    "pointnet": {"rope-cotton": 0.092, "rope-polyester": 0.067, "rope-polyethylene": 0.057},
}
"""Chamfer distances of the paper by method, of clouds that are twice as large as the ropes: adam is
its own, pointnet its PointNet++."""

KEPT = ("E", "chamfer_last", "chamfer_mean", "chamfer_last_surface",
        "chamfer_mean_surface", "rms", "iterations", "seconds")  # fmt: skip
"""Keys of an estimate's record that a row takes over."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Limits of the search."""

    starts: int
    iterations: int
    """Batches that a search may simulate."""


SCALES = {"small": Settings(starts=1, iterations=12), "full": Settings(starts=3, iterations=25)}


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """Lift every object and estimate it by every method; rows that were skipped are tried again.

    The JSON has for each object rows by method: E [Pa], its truth and the error of its logarithm,
    Chamfer distances [m] as in `gendom.estimation.Estimate.record`; or why it was skipped.
    """
    from gendom.reality import find_object

    objects: Sequence[str] = flags.objects or OBJECTS
    for name in objects:
        find_object(name)
    work = partial(_rows, runs, SCALES[flags.scale], flags.method)
    found = dict(zip(objects, runs.each(work, objects, "objects"), strict=True))
    return Result(name="real2sim", figures={"objects": found}, shown=tables_of(found))


def _rows(
    runs: Runs, settings: Settings, methods: Sequence[str], name: str
) -> dict[str, dict[str, Any]]:
    """Rows of one object by name."""
    from gendom.reality import find_object

    item = find_object(name)
    motion = predefined_lift(item.kind)
    if item.kind == "rope":
        motion = replace(motion, rise=RISE / LENGTH)
    truth = truth_of(item)["E_over_rho"] * item.material.density
    rows = {}
    for method, frames in ROWS[item.kind]:
        if methods and method not in methods:
            continue
        label = method if frames == "all" or method == "pointnet" else f"{method}, last frame"
        file = (
            f"{name}, {label}, {settings.starts} starts, {settings.iterations} iterations, "
            f"seed {runs.seed}"
        )
        row = {"method": method, "frames": frames, "truth": truth}
        try:
            make = partial(_estimated, runs, settings, name, motion, method, frames)
            row |= runs.kept(file, make)
        except GendomError as error:
            row["skipped"] = str(error).splitlines()[0]
        else:
            row["error"] = math.log(row["E"] / truth)
        rows[label] = row
    return rows


def _estimated(
    runs: Runs, settings: Settings, name: str, motion: LiftMotion, method: str, frames: str
) -> dict[str, Any]:
    """One row, without the truth."""
    from gendom.reality import find_object

    METHODS.update(BASELINES)
    recording = runs.recorded(f"lift-{name}-seed-{runs.seed}", find_object(name), motion)
    found = estimate(
        recording,
        EstimateSettings(
            method=method,
            frames="last" if frames == "last" else "all",
            starts=settings.starts,
            max_iterations=settings.iterations,
            seed=runs.seed,
            scene=SceneSettings(device=runs.device, threads=1),
        ),
    )
    row: dict[str, Any] = {key: found.record[key] for key in KEPT}
    return {**row, "usable": found.usable, "reasons": list(found.verdict.reasons)}


def tables_of(objects: Mapping[str, Mapping[str, Any]]) -> list[Table]:
    """A table for each object."""
    head = ("E [Pa]", "truth [Pa]", "error of ln E", "Chamfer [mm]", "paper, halved [mm]", "note")
    return [
        Table(title=name, head=head, rows={row: _texts(name, of) for row, of in rows.items()})
        for name, rows in objects.items()
    ]


def _texts(name: str, row: Mapping[str, Any]) -> tuple[str, ...]:
    papers = PAPER.get(row["method"], {}).get(name)
    if row["frames"] == "last" and row["method"] != "pointnet":
        papers = None  # the paper's own fits all frames
    paper = "" if papers is None else f"{1e3 * papers / 2.0:.1f}"
    if "skipped" in row:
        return ("", f"{row['truth']:.3g}", "", "", paper, f"skipped: {row['skipped']}")
    return (
        f"{row['E']:.3g}",
        f"{row['truth']:.3g}",
        f"{row['error']:+.3f}",
        f"{1e3 * row['chamfer_last']:.1f}",
        paper,
        "" if row["usable"] else f"not usable: {row['reasons'][0]}",
    )
