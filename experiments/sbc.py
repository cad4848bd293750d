"""Simulation-based calibration of the default posterior: are truths drawn from the prior anywhere
in it equally often?

Each lift is our simulator's, of an object that is drawn, like how it is held and how the cameras
are off, from the priors that estimates have; its clouds have noise of 2 mm. The rank of a truth is
the share of the posterior below it. Uniform ranks (Talts et al. 2018, "Validating Bayesian
inference algorithms with simulation-based calibration") are tested by chi-square over the bars
that the picture shows, and by the largest distance of their empirical distribution from the
diagonal (Kolmogorov and Smirnov), beside the 95 % band of both. The reality is the simulator's:
`coverage` says the same of another one.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial.transform import Rotation

from experiments.coverage import LEVEL, Covered, covered, reasons_of, shown_of
from experiments.lifts import Lifts, estimate_settings
from experiments.runs import Result, Runs, Table
from gendom.arguments import require
from gendom.arrays import Array
from gendom.datasets import Recording
from gendom.errors import GendomError, RobotError
from gendom.estimation import LiftScene, estimate
from gendom.estimation.intervals import IntervalCalibration
from gendom.estimation.lift_plan import ObjectClass, drawn, imagined, recorded_lift
from gendom.estimation.observed import NoiseModel
from gendom.materials import Item
from gendom.reality import arm_motion, as_real, lift, lift_cameras
from gendom.robot import predefined_lift
from gendom.robot.motions import LIFT_FRAME_RATE

SIZES = {"rope": ((0.2, 0.5), (0.008, 0.02)), "cloth": ((0.2, 0.36), (0.0004, 0.0012))}
"""Of ropes' lengths and diameters, of cloths' sides and thicknesses [m]."""

NAMES = ("bending_length", "E_over_rho", "nu", "damping", "friction", "thickness", "grip_height",
         "grip_along", "grip_turn", "warp_over_weft", "delay")  # fmt: skip


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """A row for each unknown: error, coverage and the tests of its ranks."""
    lifts = Lifts.of(flags)
    seeds = range(flags.seed, flags.seed + flags.lifts)
    which = "-raw" if flags.calibrate else ""
    work = partial(_row, runs, lifts, which)
    rows = list(runs.each(work, seeds, "imagining"))
    table = covered(rows, LEVEL, NAMES)
    tests = {c.name: uniformity(c) for c in table}
    return Result(
        name=f"sbc-{lifts.name}{which}",
        figures={
            "lifts": len(rows),
            "unknowns": {c.name: {**asdict(c), **tests[c.name]} for c in table},
            "rows": rows,
        },
        shown=[*shown_of(rows, table), tests_of(table, tests)],
        notes=reasons_of(rows),
    )


def uniformity(c: Covered) -> dict[str, float]:
    """How probable ranks as uneven as these are where posteriors are right, by chi-square and by
    Kolmogorov and Smirnov, and the latter's distance and 95 % band."""
    ks = stats.kstest(c.ranks, "uniform")
    return {
        "chi_square_p": float(stats.chisquare(c.counts).pvalue),
        "ecdf_p": float(ks.pvalue),
        "ecdf_distance": float(ks.statistic),
        "ecdf_band": float(stats.kstwo.ppf(0.95, len(c.ranks))),
    }


def tests_of(table: Sequence[Covered], tests: dict[str, dict[str, float]]) -> Table:
    """The table of `uniformity`."""
    texts = {
        c.name: (
            f"{c.lifts}",
            f"{tests[c.name]['chi_square_p']:.3f}",
            f"{tests[c.name]['ecdf_p']:.3f}",
            f"{tests[c.name]['ecdf_distance']:.3f}",
            f"{tests[c.name]['ecdf_band']:.3f}",
        )
        for c in table
    }
    head = ("lifts", "p, chi-square", "p, distribution", "its distance", "95 % below")
    return Table(title="Are ranks uniform?", head=head, rows=texts)


def _row(runs: Runs, lifts: Lifts, which: str, seed: int) -> dict[str, Any]:
    return runs.kept(f"sbc-{lifts.name}-{seed:04d}{which}", partial(_estimated, lifts, which, seed))


def _estimated(lifts: Lifts, which: str, seed: int) -> dict[str, Any]:
    row: dict[str, Any] = {"seed": seed, "truth": dict.fromkeys(NAMES, 0.0)}
    try:
        recording, row["truth"] = imagined_lift(lifts, seed)
        calibration = IntervalCalibration() if which else None
        found = estimate(recording, estimate_settings(seed), calibration=calibration)
    except GendomError as error:
        return {**row, "fault": str(error)}
    return {
        **row,
        "verdict": asdict(found.verdict),
        "values": {"bending_length": found.record["bending_length"]},
        "intervals": {"bending_length": (found.record["intervals"] or {}).get("bending_length")},
        "posterior": found.posterior.to_dict(),
        "seconds": found.record["seconds"],
    }


def imagined_lift(lifts: Lifts, seed: int) -> tuple[Recording, dict[str, float]]:
    """A lift of a drawn object, and the truth by names of `gendom.estimation.UNKNOWNS`.

    Raises:
        GendomError: The arm cannot carry it out, or it cannot be simulated.
    """
    rng = np.random.default_rng([90, seed])
    size, thickness = SIZES[lifts.kind]
    item = ObjectClass(kind=lifts.kind, size=size, thickness=thickness).at(*rng.random(3))
    made = drawn_lifts(item, lifts.end, rng, 1)
    require(made, "it could not be simulated", where=f"seed {seed}")
    return made[0][:2]


def drawn_lifts(
    item: Item,
    end: str,
    rng: np.random.Generator,
    count: int,
    *,
    frames: int | None = None,
    exact: bool = False,
) -> list[tuple[Recording, dict[str, float], dict[str, float]]]:
    """Lifts of an object whose unknowns are drawn, without those that cannot be simulated; their
    truths by name, and transformed. With `frames`, clouds of these alone, as `seen` takes them;
    `exact` ones have no noise, of cameras that are where they should be.

    Raises:
        RobotError: The arm cannot carry the lift out.
    """
    motion = predefined_lift(item.kind, end)
    trial = lift(as_real(item), motion)
    arm = arm_motion(trial, lift_cameras(trial.item))
    if isinstance(arm, RobotError):
        raise arm
    settings = estimate_settings(0)
    scene = LiftScene.of(recorded_lift(trial, arm, LIFT_FRAME_RATE[motion.end]), settings.scene)
    if frames is not None:
        scene = replace(scene, frames=evenly(scene.frames, frames))
    prior, base = scene.prior(also=("thickness",))
    vectors = [drawn(prior, rng) for _ in range(count)]
    thetas = [prior.theta(v, base) for v in vectors]
    # as finely as an estimate of it will be simulated, those of as many points side by side
    noise = 0.0 if exact else settings.noise.sensor
    finer = [scene.finer(theta) for theta in thetas]
    points = [len(one.initial) for one in finer]
    shown: list[Recording | None] = [None] * count
    for n in sorted(set(points)):
        own = [k for k in range(count) if points[k] == n]
        made = imagined(finer[own[0]], [thetas[k] for k in own], noise, rng)
        for k, recording in zip(own, made, strict=True):
            shown[k] = recording
    if item.kind == "cloth":
        both = zip(shown, thetas, strict=True)
        shown = [r and turned(r, scene.frames[0], theta["yaw"]) for r, theta in both]
    found = []
    for recording, theta, v in zip(shown, thetas, vectors, strict=True):
        if recording is not None:
            bends = scene.bending_length(theta.E_over_rho, theta.thickness)
            truth = {**dict(theta.items()), "bending_length": bends}
            drawn_at = dict(zip(prior.names, v.tolist(), strict=True))
            seen_as = recording if exact else misplaced(recording, settings.noise, rng)
            found.append((seen_as, truth, drawn_at))
    return found


def turned(recording: Recording, before: int, yaw: float) -> Recording:
    """The recording with what lies in the frames before one turned about the gripper [rad]."""
    points, rest = recording.points.astype(float), slice(0, int(recording.offsets[before]))
    grip = recording.gripper_position[0, 0]
    points[rest] = Rotation.from_euler("z", yaw).apply(points[rest] - grip) + grip
    return replace(recording, points=points.astype(recording.points.dtype))


def evenly(frames: Sequence[int] | NDArray[np.intp], count: int) -> tuple[int, ...]:
    """So many of some frames, from the first to the last."""
    return tuple(int(frames[k]) for k in np.linspace(0, len(frames) - 1, count).round().astype(int))


def seen(recording: Recording, frames: Sequence[int], points: int) -> Array:
    """[frames, points, 3] clouds from the first place of the gripper [0.1 m]."""
    rng, clouds = np.random.default_rng(0), [recording.frame(t) for t in frames]
    chosen = np.array([cloud[rng.choice(len(cloud), points)] for cloud in clouds])
    return 10.0 * (chosen - recording.gripper_position[frames[0], 0])


def misplaced(recording: Recording, noise: NoiseModel, rng: np.random.Generator) -> Recording:
    """The recording of cameras whose calibration is off, by a draw from its prior."""
    points: NDArray[Any] = recording.points.astype(float)
    turn = Rotation.from_rotvec(noise.turn * rng.standard_normal(3))
    centre = points.mean(axis=0)
    moved = turn.apply(points - centre) + centre + noise.shift * rng.standard_normal(3)
    return replace(recording, points=moved.astype(recording.points.dtype))
