"""The paper's table real2sim, in the MuJoCo test scene: objects are lifted once and estimated by
each method. The ropes have the names of the paper's, and the lift rises as high as the paper's
simulated one, on which its network is trained. True parameters serve only for the errors.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from typing import Any

from gendom.errors import GendomError
from gendom.estimation import EstimateSettings, SceneSettings, estimate
from gendom.estimation.sim2sim import LENGTH, RISE
from gendom.evaluation.coverage import FRAME_RATE, truth_of
from gendom.evaluation.tables.lifted import recorded
from gendom.evaluation.tables.rope_real import ROPES
from gendom.evaluation.tables.workbench import Workbench
from gendom.installation import how_to_install
from gendom.robot import LiftMotion

CLOTHS = ("cloth-cotton", "cloth-rubber")
"""Of the second reality, as the paper's."""

METHODS = {
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

KEPT = ("E", "chamfer_last", "chamfer_mean", "chamfer_last_surface",
        "chamfer_mean_surface", "rms", "iterations", "seconds")  # fmt: skip
"""Keys of an estimate's record that a row takes over."""


@dataclass(frozen=True, kw_only=True)
class Real2SimSettings:
    """Objects and methods, and limits of the search."""

    objects: tuple[str, ...] = (*ROPES, *CLOTHS)
    methods: tuple[str, ...] = ()
    """Only these; by default all of `METHODS`."""
    starts: int = 3
    iterations: int = 25
    """Batches that a search may simulate."""


def real2sim(bench: Workbench, settings: Real2SimSettings) -> dict[str, Any]:
    """Lift every object and estimate it by every method.

    Args:
        bench: Where everything is kept; rows that were skipped are tried again.
        settings: How much.

    Returns:
        JSON: for each object, rows by method. E [Pa], its truth and the error of its logarithm,
        Chamfer distances [m] as in `gendom.estimation.Estimate.record`; or why it was skipped.

    Raises:
        DeviceError: The second reality cannot be simulated or rendered here.
        ParameterError: There is no such object.
    """
    from gendom.reality import find_object

    for name in settings.objects:
        find_object(name)
    # the progress callback stays in this process
    own = {"folder": bench.folder, "device": bench.device, "seed": bench.seed}
    work = partial(_rows, own, settings)
    found: dict[str, Any] = {}

    def gather(made: Iterable[dict[str, Any]]) -> dict[str, Any]:
        for name, rows in zip(settings.objects, made, strict=True):
            bench.on_stage(f"{name}: {len(rows)} estimates")
            found[name] = rows
        return {"objects": found}

    jobs = min(bench.jobs, len(settings.objects))
    if jobs == 1:
        return gather(map(work, settings.objects))
    with get_context("spawn").Pool(jobs) as pool:
        return gather(pool.imap(work, settings.objects))


def _rows(own: dict[str, Any], settings: Real2SimSettings, name: str) -> dict[str, Any]:
    """Rows of one object by name."""
    from gendom.reality import find_object, predefined_lift

    bench, item = Workbench(**own), find_object(name)
    motion = predefined_lift(item.kind)
    if item.kind == "rope":
        motion = replace(motion, rise=RISE / LENGTH)
    truth = truth_of(item)["E_over_rho"] * item.material.density
    rows = {}
    for method, frames in METHODS[item.kind]:
        if settings.methods and method not in settings.methods:
            continue
        label = method if frames == "all" or method == "pointnet" else f"{method}, last frame"
        row = {"method": method, "frames": frames, "truth": truth}
        make = partial(_estimated, bench, settings, name, motion, method, frames)
        try:
            row |= bench.kept(
                f"{name}, {label}, {settings.starts} starts, {settings.iterations} iterations, "
                f"seed {bench.seed}",
                make,
            )
        except GendomError as error:
            row["skipped"] = str(error).splitlines()[0]
        except ModuleNotFoundError as error:
            row["skipped"] = f"needs {error.name}; install it with: {how_to_install('train')}"
        else:
            row["error"] = math.log(row["E"] / truth)
        rows[label] = row
    return rows


def _estimated(
    bench: Workbench,
    settings: Real2SimSettings,
    name: str,
    motion: LiftMotion,
    method: str,
    frames: str,
) -> dict[str, Any]:
    """One row, without the truth."""
    from gendom.reality import find_object

    recording = recorded(
        bench,
        f"lift-{name}-seed-{bench.seed}",
        find_object(name),
        frame_rate=FRAME_RATE[motion.end],
        motion=motion,
    )
    found = estimate(
        recording,
        EstimateSettings(
            method=method,
            frames=frames,
            starts=settings.starts,
            max_iterations=settings.iterations,
            seed=bench.seed,
            scene=SceneSettings(device=bench.device, threads=1),
        ),
    )
    row: dict[str, Any] = {key: found.record[key] for key in KEPT}
    reasons: Sequence[str] = found.verdict.reasons
    return {**row, "usable": found.usable, "reasons": list(reasons)}
