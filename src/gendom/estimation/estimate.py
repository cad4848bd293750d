"""From one recorded lift to Young's modulus and Poisson's ratio, with intervals."""

import math
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from gendom.datasets import Recording
from gendom.errors import ParameterError, SimulationError
from gendom.estimation.gauss_newton import (
    Bounds,
    Normal,
    Start,
    descend,
    noise_variance,
    posterior_covariance,
)
from gendom.estimation.hold import Held
from gendom.estimation.lift import Lift, ReplaySettings, Theta
from gendom.estimation.placing import ASSUMED_THICKNESS
from gendom.estimation.priors import (
    BENDING_RANGE,
    FRICTION_PRIOR,
    FRICTION_RANGE,
    NU_PRIOR,
    NU_RANGE,
    OFFSET_PRIOR,
    START_RANGE,
)
from gendom.materials.parameters import bending_length, specific_modulus_of
from gendom.observation import DensityGrid, chamfer

GRAVITY = 9.81
"""[m/s^2]."""

COARSE = 2.0 / 3.0
"""Grid cells of the first, cheap stage for each cell of the last."""

HURRY = 2.0
"""How much faster the first stage replays quasi-static motion."""

COARSE_LEVELS = (8, 16)
"""Resolutions of the density grids compared in the first stage: wide cells pull from afar."""

FINE_LEVELS = (16, 32, 64)
"""Resolutions of the density grids compared in the last stage; 64 is the paper's."""

COARSE_FRAMES = 30
"""Frames compared in the first stage."""

COARSE_ITERATIONS = 8
"""Evaluations a start may spend in the first stage, at most."""

CLOTH_ITERATIONS = 8
"""Evaluations a start may spend on a cloth in the last stage, at most."""

LEAST_GAIN = {"coarse": 1e-2, "fine": 1e-3}
"""Share of the loss that a step must still win for a start to go on."""

SAME = np.array([0.1, 1.0, 1e-3, 1.0])
"""Starts nearer to each other than this after the first stage (log E, nu, grip offset [m],
friction) go on as one: nu and friction are not told apart there."""

STEPS = {
    "rope": np.array([0.03, 0.01, 5e-4, 0.02]),
    "cloth": np.array([0.15, 0.03, 2e-3, 0.05]),
}
"""Differences for the Jacobian in log E, nu, grip offset [m] and friction: a sheet that buckles
answers small ones with noise."""

FRAME_EFFECT = 4
"""Independent figures that one independent frame contributes (shapes are smooth)."""

INDEPENDENT_FRAMES = 12
"""Frames of a lift that differ enough to count as independent."""

GRID_ERROR = 0.15
"""Standard deviation of log E that one grid cell across the object adds, falling as 1 / cells.

Measured once: a lift simulated with 2.5 cells across, estimated with 1.5, came out 0.12 high.
"""

ROD_ERROR = 0.02
"""Standard deviation of log E that a rod's points add: sags of held rods are right to 1 %."""

CLOTH_GRID_ERROR = 0.5
"""Standard deviation of log E that a grid adds: this times a cell over the cloth's bending length.

Measured once: lifts of cloths that bend over 12 to 45 mm, simulated with 3 cells, were nearest to
those with 1.5 cells (21 mm) at 0.4 to 0.8 of E, the less the further they bend.
"""

HOLD_SHARE = 0.6
"""Share of the work on a cloth that goes into finding how it is held."""

IDENTIFIABLE = 0.5
"""A parameter counts as identifiable when the data cut its prior deviation at least this far."""

LOG_MODULUS, NU, OFFSET, FRICTION = range(4)
"""Places in a vector of parameters: log E / density, nu, grip offset [m], friction."""


@dataclass(frozen=True, kw_only=True)
class EstimateSettings:
    """How parameters are estimated."""

    starts: int = 3
    """Random starts."""
    frames: str = "all"
    """``all`` or ``last``: the frames whose densities are compared."""
    max_iterations: int = 12
    """Evaluations a start may spend in each stage."""
    seed: int = 0
    level: float = 0.9
    """Probability that the intervals claim."""
    replay: ReplaySettings = field(default_factory=ReplaySettings)

    def __post_init__(self) -> None:
        if self.starts < 1:
            raise ParameterError(f"starts must be at least 1, got {self.starts}")
        if self.frames not in ("all", "last"):
            raise ParameterError(f"frames must be 'all' or 'last', got {self.frames!r}")
        if not 0.0 < self.level < 1.0:
            raise ParameterError(f"level must lie between 0 and 1, got {self.level}")
        if self.max_iterations < 2:
            raise ParameterError(f"max_iterations must be at least 2, got {self.max_iterations}")


@dataclass(frozen=True, kw_only=True)
class Progress:
    """What an estimation has done so far."""

    stage: str
    iteration: int
    done: float
    """Share of the largest possible work, 0 to 1."""
    best: Theta
    loss: float


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """The result, as ``estimate.json`` has it."""

    theta: Theta
    lift: Lift = field(repr=False)
    positions: NDArray[np.floating] = field(repr=False)
    """[T, N, 3] particles of the best fit at ``lift.frames`` [m]."""
    chamfer: NDArray[np.floating] = field(repr=False)
    """[T] distance to all particles [m]."""
    record: dict[str, Any] = field(repr=False)
    """The JSON document, format ``gendom-estimate/1``: SI units; ``intervals`` and ``bounds``, the
    range that was searched, hold [low, high] by the names of the values. Files of older versions
    have no ``bounds``."""


def estimate(
    recording: Recording,
    settings: EstimateSettings | None = None,
    *,
    on_progress: Callable[[Progress], None] | None = None,
) -> Estimate:
    """Estimate an object's elastic parameters from one recorded lift.

    Every start first descends on a coarse grid, then on the full one. Ctrl-C ends the search
    and keeps the best found so far.

    Args:
        recording: The lift.
        settings: Starts, frames, seed, resolution.
        on_progress: Called after each iteration.

    Raises:
        RecordingError: If the recording shows too little to place the object.
        SimulationError: If every start diverges.
        KeyboardInterrupt: If interrupted before anything was found.
    """
    settings = settings or EstimateSettings()
    began = clock.perf_counter()
    fine = Lift(recording, settings.replay, on_hold=_holding(recording, on_progress))
    before = 0.0 if fine.held is None else HOLD_SHARE
    coarse = fine.coarser(COARSE, hurry=HURRY)
    bounds, starts = _starts(fine, settings)
    interrupted = False
    history: list[dict[str, Any]] = []
    finished: list[Start] = []
    effective = FRAME_EFFECT * min(len(_compared(fine, settings)), INDEPENDENT_FRAMES)
    frames = _compared(fine, settings)
    few = frames[:: -(-len(frames) // COARSE_FRAMES)]
    free, most_fine = (LOG_MODULUS, NU, OFFSET, FRICTION), settings.max_iterations
    if fine.body.kind == "cloth":
        # nu does not show in how a cloth hangs: it stays where its prior has it
        free, most_fine = (LOG_MODULUS, OFFSET, FRICTION), min(most_fine, CLOTH_ITERATIONS)
    if fine.table_height is None:
        free = tuple(k for k in free if k != FRICTION)
    stages = (
        (
            "coarse",
            _Comparison(coarse, few, COARSE_LEVELS, (LOG_MODULUS, OFFSET)),
            COARSE_ITERATIONS,
        ),
        ("fine", _Comparison(fine, frames, FINE_LEVELS, free), most_fine),
    )
    spent = 0
    heirs = list(range(settings.starts))
    initial = [s.initial for s in starts]
    try:
        for number, (stage, comparison, most) in enumerate(stages):
            for iteration in descend(
                comparison.models,
                starts,
                bounds,
                effective=effective,
                max_iterations=min(most, settings.max_iterations),
                least_gain=LEAST_GAIN[stage],
            ):
                alive = [s for s in starts if s.model is not None]
                if on_progress is not None and alive:
                    best = min(alive, key=lambda s: s.model.sse)  # pyright: ignore
                    on_progress(
                        Progress(
                            stage=stage,
                            iteration=iteration,
                            done=before
                            + (1.0 - before) * (number + iteration / most) / len(stages),
                            best=_theta(best.theta),
                            loss=best.model.sse,  # pyright: ignore
                        )
                    )
            finished = [s for s in starts if s.model is not None]
            history += _history(starts, stage, fine.density, spent)
            spent += max(s.iterations for s in starts)
            if not finished:
                raise SimulationError(
                    "no start could be simulated",
                    where=f"{stage} stage",
                    fix="check the recording's units and gripper path",
                )
            if stage == "coarse":
                starts, heirs = _merge(starts)
    except KeyboardInterrupt:
        interrupted = True
        tried = [s for s in starts if s.model is not None]
        history += _history(tried, "interrupted", fine.density, spent)
        finished = tried or finished
        if not finished:
            raise
    return _result(
        fine, finished, bounds, settings, history, initial, heirs,
        effective=effective, seconds=clock.perf_counter() - began, interrupted=interrupted,
    )  # fmt: skip


def replay_chamfer(
    lift: Lift, positions: NDArray[np.floating], frames: Sequence[int] | None = None
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Chamfer distance a frame, to all particles and to those the cameras could see [T] [m].

    Particles outside the recorded space (``Lift.floor``) cannot have points near them and do not
    count on their side.

    Args:
        lift: The recording's lift.
        positions: [T, N, 3] simulated particles at these frames [m].
        frames: Recorded frames (default: all with points).
    """
    chosen = lift.frames if frames is None else frames
    whole, surface = [], []
    for t, x in zip(chosen, positions, strict=True):
        cloud = lift.recording.frame(t)
        skin = lift.body.surface(x)
        all_of_it = skin if lift.thin else x
        whole.append(chamfer(cloud, all_of_it, of_b=lift.inside(all_of_it)))
        skin = skin[lift.visible(skin)]
        surface.append(chamfer(cloud, skin, of_b=lift.inside(skin)))
    return np.array(whole), np.array(surface)


def _holding(
    recording: Recording, on_progress: Callable[[Progress], None] | None
) -> Callable[[float, Held, float], None] | None:
    """Reports the search for a hold as the first part of the estimate."""
    if on_progress is None:
        return None
    iteration = 0
    k = (recording.object.thickness or ASSUMED_THICKNESS) / math.sqrt(12.0)

    def report(done: float, held: Held, loss: float) -> None:
        nonlocal iteration
        iteration += 1
        modulus = specific_modulus_of(held.bending, k, GRAVITY)
        best = Theta(specific_modulus=modulus, friction=held.friction)
        on_progress(
            Progress(
                stage="hold", iteration=iteration, done=HOLD_SHARE * done, best=best, loss=loss
            )
        )

    return report


class _Comparison:
    """Densities of a recording, and how a lift's simulated densities differ from them."""

    def __init__(
        self, lift: Lift, frames: Sequence[int], levels: Sequence[int], free: Sequence[int]
    ):
        """Prepare the recorded side.

        Args:
            lift: How to simulate.
            frames: Recorded frames to compare.
            levels: Resolutions of the density grids.
            free: Parameters that get a Jacobian; the others stay where their prior pulls them.
        """
        self.lift = lift
        self.free = list(free)
        self.frames = list(frames)
        clouds = [lift.recording.frame(t).astype(float) for t in self.frames]
        around = np.concatenate([*clouds, lift.body.x, lift.recording.gripper_position[:, 0]])
        self.grids = [
            DensityGrid.around(around, margin=0.05 * lift.size, resolution=level)
            for level in levels
        ]
        self.seen = [np.stack([grid.splat(c) for c in clouds]) for grid in self.grids]
        # residuals relative to the recorded density; slopes grow with 1 / cell, so that this
        # weight lets each level pull alike
        weight = np.array([grid.cell**2 for grid in self.grids])
        weight /= weight.sum()
        self.scales = [w / (d**2).sum() for w, d in zip(weight, self.seen, strict=True)]

    def models(self, thetas: list[NDArray[np.floating]]) -> list[Normal | None]:
        """Quadratic models at parameter vectors, from one batch of worlds."""
        h = STEPS[self.lift.body.kind]
        most = np.full(len(h), np.inf)
        most[NU] = NU_RANGE[1]
        steps = [np.where(theta + h > most, -h, h) for theta in thetas]
        worlds = [
            [theta] + [theta + np.eye(len(h))[k] * step[k] for k in self.free]
            for theta, step in zip(thetas, steps, strict=True)
        ]
        size = 1 + len(self.free)
        alive = list(range(len(thetas)))
        positions = None
        while alive:
            batch = [_theta(v) for n in alive for v in worlds[n]]
            try:
                positions = self.lift.simulate(batch, frames=self.frames)
                break
            except SimulationError as error:
                assert error.world is not None
                del alive[error.world // size]
        models: list[Normal | None] = [None] * len(thetas)
        if positions is not None:
            for m, n in enumerate(alive):
                models[n] = self._model(positions[:, size * m : size * (m + 1)], steps[n])
        return models

    def _model(self, x: NDArray[np.floating], step: NDArray[np.floating]) -> Normal:
        """From particles [T, 1 + free, N, 3] of a point and its neighbours."""
        free = np.ix_(self.free, self.free)
        sse, gradient, hessian = 0.0, np.zeros(len(step)), np.zeros((len(step),) * 2)
        for t in range(len(x)):
            # neighbours show the same points: who is seen must not change within a difference
            skin = self.lift.body.surface(x[t])
            shown = skin[:, self.lift.visible(skin[0]) & self.lift.inside(skin[0])]
            for grid, seen, scale in zip(self.grids, self.seen, self.scales, strict=True):
                density = grid.splat(shown)
                r = density[0] - seen[t]
                J = (density[1:] - density[0]) / step[self.free, None]
                sse += scale * float(r @ r)
                gradient[self.free] += scale * (J @ r)
                hessian[free] += scale * (J @ J.T)
        return Normal(sse=sse, gradient=gradient, hessian=hessian)


def _theta(vector: NDArray[np.floating]) -> Theta:
    return Theta(
        specific_modulus=math.exp(vector[LOG_MODULUS]),
        nu=float(vector[NU]),
        grip_offset=float(vector[OFFSET]),
        friction=float(vector[FRICTION]),
    )


def _compared(lift: Lift, settings: EstimateSettings) -> list[int]:
    return lift.frames[-1:] if settings.frames == "last" else lift.frames


def _starts(lift: Lift, settings: EstimateSettings) -> tuple[Bounds, list[Start]]:
    def log_modulus(length: float) -> float:
        return math.log(specific_modulus_of(length, lift.radius_of_gyration, GRAVITY))

    low, high = (log_modulus(share * lift.size) for share in BENDING_RANGE[lift.body.kind])
    near, far = (math.log(share) for share in START_RANGE[lift.body.kind])
    offset = OFFSET_PRIOR.get(lift.recording.gripper_source, OFFSET_PRIOR["commanded"])
    bounds = Bounds(
        low=np.array([low, NU_RANGE[0], -5.0 * offset, FRICTION_RANGE[0]]),
        high=np.array([high, NU_RANGE[1], 5.0 * offset, FRICTION_RANGE[1]]),
        # the modulus is searched over this range without preference: a very wide Gaussian
        mean=np.array([(low + high) / 2.0, NU_PRIOR[0], 0.0, FRICTION_PRIOR[0]]),
        sd=np.array([(high - low) / 2.0, NU_PRIOR[1], offset, FRICTION_PRIOR[1]]),
        largest_step=np.array([1.0, 0.05, offset, FRICTION_PRIOR[1]]),
        tolerance=np.array([5e-3, 2e-3, 2e-4, 5e-3]),
    )
    rng = np.random.default_rng(settings.seed)
    starts = []
    for number in range(settings.starts):
        length = math.exp(rng.uniform(near, far)) * lift.size
        friction = FRICTION_PRIOR[0]
        if lift.held is not None:
            friction = lift.held.friction
            length = lift.held.bending if number == 0 else length
        theta = np.array([log_modulus(length), rng.uniform(0.2, 0.4), 0.0, friction])
        starts.append(Start(initial=theta, theta=theta))
    return bounds, starts


def _merge(starts: Sequence[Start]) -> tuple[list[Start], list[int]]:
    """Starts of the next stage, the best of each group, and for each old start its heir's number.

    A start that was never simulated goes on with the best of all.
    """
    order = sorted(
        (n for n, s in enumerate(starts) if s.model is not None),
        key=lambda n: starts[n].model.sse,  # pyright: ignore
    )
    kept: list[int] = []
    heirs = [0] * len(starts)
    for n in order:
        for number, k in enumerate(kept):
            if np.all(np.abs(starts[n].theta - starts[k].theta) < SAME):
                heirs[n] = number
                break
        else:
            heirs[n] = len(kept)
            kept.append(n)
    return [Start(initial=starts[k].initial, theta=starts[k].theta) for k in kept], heirs


def _history(starts: Sequence[Start], stage: str, density: float, after: int) -> list[dict]:
    """Iterations of one stage, numbered on from those before it."""
    return [
        {
            "stage": stage,
            "start": number,
            "iteration": after + iteration,
            **_named(theta, density),
            "loss": sse,
        }
        for number, start in enumerate(starts)
        for iteration, theta, sse in start.history
    ]


def _result(
    lift: Lift,
    starts: list[Start],
    bounds: Bounds,
    settings: EstimateSettings,
    history: list[dict[str, Any]],
    initial: list[NDArray[np.floating]],
    heirs: list[int],
    *,
    effective: float,
    seconds: float,
    interrupted: bool,
) -> Estimate:
    def objective(s: Start) -> float:
        assert s.model is not None
        prior = float(np.sum(((s.theta - bounds.mean) / bounds.sd) ** 2))
        return s.model.sse + prior * noise_variance(s.model.sse, effective)

    best = min(starts, key=objective)
    assert best.model is not None
    theta = _theta(best.theta)
    covariance = posterior_covariance(best.model, bounds, effective=effective)
    sd = np.sqrt(np.diag(covariance))
    # E goes with the bending length cubed
    doubt = 0.0 if lift.held is None else 3.0 * lift.held.doubt
    sd[LOG_MODULUS] = math.hypot(sd[LOG_MODULUS], _grid_error(lift, theta), doubt)
    z = float(norm.ppf(0.5 + settings.level / 2.0))
    positions = lift.simulate([theta])[:, 0]
    whole, surface = replay_chamfer(lift, positions)
    specific = [
        theta.specific_modulus * math.exp(sign * z * sd[LOG_MODULUS]) for sign in (-1.0, 1.0)
    ]
    density = lift.density
    k = lift.radius_of_gyration

    def bends(s: float) -> float:
        return bending_length(s, k, GRAVITY)

    def plausible(value: float, k: int) -> list[float]:
        ends = [value - z * sd[k], value + z * sd[k]]
        return [float(x) for x in np.clip(ends, bounds.low[k], bounds.high[k])]

    searched = [math.exp(bounds.low[LOG_MODULUS]), math.exp(bounds.high[LOG_MODULUS])]

    described = lift.recording.object
    record: dict[str, Any] = {
        "format": "gendom-estimate/1",
        "youngs_modulus": theta.specific_modulus * density,
        "poissons_ratio": theta.nu,
        "density": density,
        "density_assumed": lift.density_assumed,
        "specific_modulus": theta.specific_modulus,
        "bending_length": bends(theta.specific_modulus),
        "grip_offset": theta.grip_offset,
        "friction": theta.friction,
        "hold": None if lift.hold is None else asdict(lift.hold),
        "intervals": {
            "level": settings.level,
            "youngs_modulus": [s * density for s in specific],
            "specific_modulus": specific,
            "bending_length": [bends(s) for s in specific],
            "poissons_ratio": plausible(theta.nu, NU),
            "friction": plausible(theta.friction, FRICTION),
        },
        "bounds": {
            "youngs_modulus": [s * density for s in searched],
            "specific_modulus": searched,
            "bending_length": [bends(s) for s in searched],
            "poissons_ratio": [float(bounds.low[NU]), float(bounds.high[NU])],
            "friction": [float(bounds.low[FRICTION]), float(bounds.high[FRICTION])],
        },
        "identifiable": {
            "youngs_modulus": bool(sd[LOG_MODULUS] < IDENTIFIABLE * bounds.sd[LOG_MODULUS]),
            "poissons_ratio": bool(sd[NU] < IDENTIFIABLE * bounds.sd[NU]),
            "friction": bool(sd[FRICTION] < IDENTIFIABLE * bounds.sd[FRICTION]),
        },
        "chamfer_last": float(whole[-1]),
        "chamfer_mean": float(whole.mean()),
        "chamfer_last_surface": float(surface[-1]),
        "chamfer_mean_surface": float(surface.mean()),
        "loss": best.model.sse,
        "iterations": sum(s.iterations for s in starts),
        "seconds": seconds,
        "method": "gauss-newton",
        "frames": settings.frames,
        "seed": settings.seed,
        "device": lift.settings.device,
        "interrupted": interrupted,
        "object": {
            "kind": described.kind,
            "length": described.length,
            "width": described.width,
            "height": described.height,
            "diameter": lift.body.thickness if described.kind == "rope" else None,
            "thickness": lift.body.thickness if described.kind == "cloth" else None,
            "mass": described.mass,
        },
        "begins_with": lift.recording.begins_with,
        "simulation": {
            "engine": lift.settings.engine,
            "particles": len(lift.rest_points),
            "dx": lift.body.dx,
            "cells_across": lift.settings.cells_across,
            "clock": lift.clock,
            "damping": lift.damping,
            "law": lift.settings.law,
            "dtype": lift.settings.dtype,
        },
        "notes": lift.notes,
        "starts": [
            {
                "initial": _named(theta0, density),
                "final": _named(starts[heir].theta, density),
                "bending_length": bends(math.exp(starts[heir].theta[LOG_MODULUS])),
                "loss": starts[heir].model.sse,  # pyright: ignore
                "converged": bool(starts[heir].done),
                "descent": heir,
            }
            for theta0, heir in zip(initial, heirs, strict=True)
            if heir < len(starts)
        ],
        "history": history,
    }
    return Estimate(theta=theta, lift=lift, positions=positions, chamfer=whole, record=record)


def _grid_error(lift: Lift, theta: Theta) -> float:
    """Standard deviation of log E that the grid, or a rod's points, add."""
    if lift.thin:
        return ROD_ERROR
    if lift.body.kind == "rope":
        return GRID_ERROR / lift.settings.cells_across
    bends = bending_length(theta.specific_modulus, lift.radius_of_gyration, GRAVITY)
    return CLOTH_GRID_ERROR * lift.body.dx / bends


def _named(vector: NDArray[np.floating], density: float) -> dict[str, float]:
    return {
        "youngs_modulus": math.exp(vector[LOG_MODULUS]) * density,
        "specific_modulus": math.exp(vector[LOG_MODULUS]),
        "poissons_ratio": float(vector[NU]),
        "grip_offset": float(vector[OFFSET]),
        "friction": float(vector[FRICTION]),
    }
