"""The paper's test of estimators: lifts of our own simulator, with exact clouds.

The authors' scene is a cube of 1 m with density 1 and gravity 12. Here it is
the same lift at standard gravity: lengths as they are, times longer by sqrt(12 / g), E over density
smaller by g / 12. E is stated in the paper's units throughout. Their rope's square section is round
here, and their floor's and gripper's details are ours. There is no plasticity. Clouds are exact and
made by the estimator's own simulator: the test measures the method, not the model. Source: Kuroki
et al. (2024), section IV-A.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from experiments.adam import adam
from experiments.evolution import differential_evolution
from experiments.pointnet import pointnet
from experiments.runs import Result, Runs, Table
from gendom.arguments import require
from gendom.datasets import ObjectDescription, Recording
from gendom.estimation.methods.gauss_newton import (
    DAMPING as LEAST_DAMPING,
)
from gendom.estimation.methods.gauss_newton import (
    Descent,
    GaussNewtonSettings,
    gauss_newton,
)
from gendom.estimation.observed import NoiseModel
from gendom.estimation.problem import EstimateSettings, Found, Problem, Start
from gendom.estimation.replay import middle, replay
from gendom.estimation.scene import LiftScene, SceneSettings
from gendom.materials import STANDARD_GRAVITY
from gendom.materials.unknowns import Theta
from gendom.observation import chamfer
from gendom.progress import bar
from gendom.sim import open_device

Array = NDArray[np.floating]

E_RANGE, NU_RANGE = (500.0, 10500.0), (0.2, 0.4)
"""Of the paper's truths; E in its units."""

E_STARTS = (2000.0, 8000.0)
"""Of its starts."""

LENGTH, DIAMETER, RISE, SECONDS = 0.5, 0.028, 0.45, 0.285
"""Of the authors' rope and lift: [m], and [s] of their clock."""

FRAMES = 150
"""Steps of their lift, each with a cloud."""

PAPER_DENSITY, PAPER_GRAVITY, PAPER_FRICTION = 1.0, 12.0, 0.5
"""Of the authors' scene, in their units."""

GRAVITY_SHARE = STANDARD_GRAVITY / PAPER_GRAVITY
"""Our gravity over theirs."""

CELLS_ACROSS = DIAMETER * 64.0
"""Cells of their grid across the rope."""

EXACT = NoiseModel(
    sensor=1e-4, model=1e-9, least_sensor=1e-10, least_model=1e-10, shift=1e-9, turn=1e-9, skin=1e-9
)
"""Noise of clouds that have none: float32 rounds them by some 1e-8 m."""

DAMPING = 0.0045
"""Of the rope [s], in the middle of what ropes have. Their particles lose energy on the grid; a rod
without any damping, jerked into motion, rings, and its motion depends on E irregularly."""

STEPS = np.array([2e-3, 0.05])
"""Of differences in ln E and nu."""

SUBSTEP = 1.12e-4
"""Of all rods [s], below the limit of the stiffest (1.14e-4 s), see `SceneSettings.substep`."""

JUMPS = (-30.0, -10.0, -3.0, -1.0, 1.0, 3.0, 10.0, 30.0)
"""Of Gauss-Newton, in deviations: where points come to rest or leave the table a substep earlier or
later, positions jump by some 1e-7 m. Without jumps a third of the searches ends at such places."""

TRIED = 4
"""Jumps that are simulated with all points: the nearest ones with few."""

ITERATIONS = 50
"""Batches that a search may simulate; three of Adam's steps each make the authors' 150."""

SCALES = {"small": (2, 1), "full": (5, 5)}
"""Objects, and starts of each."""

ROWS = (
    ("gauss-newton", "all"),
    ("gauss-newton", "last"),
    ("adam", "all"),
    ("adam", "last"),
    ("pointnet", "last"),
)
"""Methods, and the frames that they see."""

PAPER_ERRORS = {
    ("adam", "all"): {"E": 11.69, "nu": 0.0032, "chamfer": 0.0004},
    ("adam", "last"): {"E": 13.74, "nu": 0.0067, "chamfer": 0.0004},
    ("pointnet", "last"): {"E": 173.51, "nu": 0.029, "chamfer": 0.0025},
}
"""Mean absolute errors of the paper's table, by method and frames; adam is theirs."""


def leap(descent: Descent, start: Start) -> bool:
    """Move a start to a better point some deviations away, each of the object's unknowns in both
    directions and the others by their conditional means. Returns whether there is one."""
    problem, former = descent.problem, start.comparison
    assert former is not None
    covariance = descent.covariance(start)
    places = [
        problem.prior.clipped(start.vector + far * covariance[k] / np.sqrt(covariance[k, k]))
        for k in np.flatnonzero(descent.of_object())
        for far in JUMPS
    ]
    coarse = problem.coarse.compare(places, derivatives=False)
    rms = [np.inf if c is None else c.rms for c in coarse]
    places = [places[k] for k in np.argsort(rms, kind="stable")[:TRIED]]
    compared = problem.compare(places, derivatives=False)
    values = problem.values(places, compared, descent.noise, start)
    best = int(np.argmin(values))
    closer = compared[best]
    if closer is None or start.value - values[best] < descent.least:
        return False
    problem.inherit_derivatives(closer, former, *np.zeros((2, len(start.vector))))
    start.iterations += 1
    start.vector, start.comparison, start.value = places[best], closer, values[best]
    start.done, start.renew, start.damping = False, True, LEAST_DAMPING[0]
    return True


SEARCHES: dict[str, Callable[[Problem, Array], Found]] = {
    "gauss-newton": lambda problem, start: gauss_newton(
        problem,
        replace(GaussNewtonSettings.of(problem.scene.kind), rugged=True, leap=leap),
        initial=(start,),
    ),
    "adam": lambda problem, start: adam(problem, initial=(start,), steps=3),
    "differential-evolution": lambda problem, start: differential_evolution(problem),
    "pointnet": lambda problem, start: pointnet(problem),
}
"""Methods, each from a start [P]; the last two take none."""


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """A row for each method and frames."""
    open_device(runs.device)
    settings = scene_settings(flags.engine, device=runs.device)
    truths, starts = SCALES[flags.scale]
    chosen = [(m, f) for m, f in ROWS if not flags.method or m in flags.method]
    chosen += [(m, "all") for m in flags.method if m not in dict(ROWS)]
    rows = [
        sim2sim(
            method, truths=truths, starts=starts, frames=frames, settings=settings, seed=runs.seed
        )
        for method, frames in chosen
    ]
    title = f"{truths} objects, {starts} starts each, seed {runs.seed}, engine {flags.engine}"
    return Result(
        name="sim2sim",
        figures={"engine": flags.engine, "rows": rows},
        shown=[table_of(f"Mean absolute errors: {title}", rows)],
    )


def E_over_rho(E: float) -> float:
    """E / density [m^2/s^2] at our gravity of E in the paper's units."""
    return E * GRAVITY_SHARE / PAPER_DENSITY


def paper_E(E_over_rho: float) -> float:
    """E in the paper's units; inverse of the above."""
    return E_over_rho * PAPER_DENSITY / GRAVITY_SHARE


def truth_of(E: float, nu: float) -> Theta:
    """All settings of the paper's lift."""
    return Theta(E_over_rho=E_over_rho(E), nu=nu, damping=DAMPING, friction=PAPER_FRICTION)


def scene_settings(engine: Literal["thin", "mpm"] = "thin", **changes: Any) -> SceneSettings:
    """How the lift is simulated: on the authors' grid, every frame compared."""
    own: dict[str, Any] = {"engine": engine, "fast_frames": FRAMES, "dtype": "float64"}
    of_engine = {"substep": SUBSTEP} if engine == "thin" else {"cells_across": CELLS_ACROSS}
    return SceneSettings(**{**own, **of_engine, **changes})


def sim2sim_recording(
    E: float,
    nu: float,
    *,
    settings: SceneSettings | None = None,
    frames: int = FRAMES,
    rise: float = RISE,
    markers: bool = True,
    shows: str = "all",
) -> Recording:
    """The lift of a rope with exact clouds.

    Args:
        E: In the paper's units.
        nu: Poisson's ratio.
        settings: Of the simulation.
        frames: Number of frames of the lift.
        rise: How far it goes, at the authors' speed [m].
        markers: Whether clouds are points of the centre line, in order; else all of the skin.
        shows: ``all`` frames, or the ``last`` and, at rest, the first.

    Raises:
        ParameterError: There are fewer than two frames.
        SimulationError: It diverges.
    """
    require(frames >= 2, f"a lift has at least two frames, got {frames}")
    settings = settings or scene_settings()
    seconds = SECONDS * rise / RISE / math.sqrt(GRAVITY_SHARE)
    time = np.linspace(0.0, seconds, frames)
    grip = np.zeros((frames, 1, 3))
    grip[:, 0, 0] = 0.745
    grip[:, 0, 2] = DIAMETER / 2.0 + rise * time / seconds
    lying = np.zeros((64, 3))
    lying[:, 0] = np.linspace(0.25, 0.75, 64)
    lying[:, 2] = DIAMETER / 2.0

    shown = np.ones(frames, dtype=bool) if shows == "all" else np.arange(frames) % (frames - 1) == 0

    def recorded(clouds: Array) -> Recording:
        return Recording(
            points=clouds.reshape(-1, 3),
            offsets=np.concatenate([[0], np.cumsum(shown * clouds.shape[1])]),
            time=time,
            gripper_position=grip,
            object=ObjectDescription(
                kind="rope",
                length=LENGTH,
                diameter=DIAMETER,
                mass=1000.0 * math.pi / 4.0 * DIAMETER**2 * LENGTH,
                grasp_inset=0.005,
                grasp_radius=0.03,
            ),
            table_height=0.0,
            gripper_source="measured",
            source="experiments.sim2sim",
            extra={"ordered_markers": markers},
        )

    scene = LiftScene.of(recorded(np.tile(lying, (int(shown.sum()), 1, 1))), settings)
    scene = replace(scene, frames=tuple(map(int, np.flatnonzero(shown))))
    x = replay(scene, [truth_of(E, nu)])[:, 0]
    return recorded(middle(scene, x) if markers else np.asarray(scene.body.surface(x), float))


def sim2sim_problem(
    recording: Recording, *, settings: SceneSettings | None = None, **other: Any
) -> Problem:
    """The problem: E and nu are unknown in the paper's ranges, all else is known.

    Args:
        recording: Of `sim2sim_recording`.
        settings: Of the simulation.
        other: Of `EstimateSettings`.
    """
    scene = LiftScene.of(recording, settings or scene_settings())
    chosen = EstimateSettings(
        unknowns=("E_over_rho", "nu"),
        noise=EXACT,
        scene=scene.settings,
        **{"max_iterations": ITERATIONS, **other},
    )
    problem = Problem([scene], chosen, known=truth_of(float(np.mean(E_RANGE)), 0.3))
    logs = np.log([E_over_rho(E) for E in E_RANGE])
    low, high = np.array([logs, NU_RANGE]).T
    # the paper's prior is these ranges; without noise differences may be small
    problem.prior = replace(
        problem.prior,
        low=low,
        high=high,
        mean=(low + high) / 2.0,
        sd=high - low,
        step=STEPS,
    )
    return problem


def sim2sim(
    method: str,
    *,
    truths: int = 5,
    starts: int = 5,
    frames: str = "all",
    settings: SceneSettings | None = None,
    seed: int = 0,
) -> dict[str, Any]:
    """A row of the paper's table.

    Args:
        method: A key of `SEARCHES`.
        truths: Drawn at random from `E_RANGE` and `NU_RANGE`.
        starts: Estimates of each, from one random place each.
        frames: ``all`` or ``last``.
        settings: Of the simulation (default: `scene_settings`).
        seed: Of truths and starts.

    Returns:
        Mean absolute errors of E (in the paper's units), nu and the Chamfer distance of the last
        frame [m], their deviations and, of E and nu, the largest ones; the mean time of an estimate
        [s]; what the paper has there, or None.

    Raises:
        ParameterError: There is no such method.
        SimulationError: A lift diverges.
    """
    check = f"there is no method {method!r}"
    require(method in SEARCHES, check, fix=f"use {', '.join(SEARCHES)}")
    settings = settings or scene_settings()
    errors, began = [], perf_counter()
    with bar(f"{method}, {frames} frames", truths * starts, "estimate") as show:
        for n in range(truths):
            rng = np.random.default_rng([seed, n])
            E, nu = rng.uniform(*E_RANGE), rng.uniform(*NU_RANGE)
            # the network sees clouds, as it was trained
            markers = method != "pointnet"
            recording = sim2sim_recording(E, nu, settings=settings, markers=markers, shows=frames)
            for k in range(starts):
                # trailing zeros of a seed do not count
                start = np.random.default_rng([seed, n, k + 1])
                errors.append(_errors(method, recording, settings, (E, nu), start, k))
                show(len(errors))
    size = np.abs(errors)
    mean, sd, worst = size.mean(axis=0), size.std(axis=0), size.max(axis=0)
    return {
        "method": method, "frames": frames, "engine": settings.engine,
        "truths": truths, "starts": starts,
        "E": mean[0], "nu": mean[1], "chamfer": mean[2],
        "E_sd": sd[0], "nu_sd": sd[1], "chamfer_sd": sd[2],
        "E_worst": worst[0], "nu_worst": worst[1],
        "seconds": (perf_counter() - began) / len(errors),
        "paper": PAPER_ERRORS.get((method, frames)),
    }  # fmt: skip


def _errors(
    method: str,
    recording: Recording,
    settings: SceneSettings,
    true: tuple[float, float],
    rng: np.random.Generator,
    seed: int,
) -> tuple[float, float, float]:
    """Of E and nu of one estimate, and the Chamfer distance."""
    problem = sim2sim_problem(recording, settings=settings, seed=seed)
    start = problem.prior.vector(truth_of(rng.uniform(*E_STARTS), rng.uniform(*NU_RANGE)))
    found = problem.theta(SEARCHES[method](problem, start).best.vector)
    x = replay(problem.scene, [truth_of(*true), found])[-1]
    return paper_E(found.E_over_rho) - true[0], found.nu - true[1], chamfer(x[0], x[1])


def table_of(title: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    """Rows with the paper's numbers below them."""
    texts = {}
    for row in rows:
        name = f"{row['method']}, {row['frames']} frames, {row['engine']}"
        figures = tuple(f"{row[key]:.2g}" for key in ("nu", "chamfer", "seconds"))
        texts[name] = (f"{row['E']:.3g}", *figures)
        if row["paper"] is not None:
            E, nu, c = (row["paper"][k] for k in ("E", "nu", "chamfer"))
            texts[f"  {row['method']}, {row['frames']} frames, in the paper"] = (
                f"{E:.4g}", f"{nu:.2g}", f"{c:.2g}", ""
            )  # fmt: skip
    return Table(title=title, head=("E", "nu", "Chamfer [m]", "s"), rows=texts)
