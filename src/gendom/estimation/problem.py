"""What every method of estimation is given, and what it gives back."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.errors import ParameterError, SimulationError
from gendom.estimation.likelihood import Comparison, NoiseModel, Observation
from gendom.estimation.replay import replay
from gendom.estimation.scene import Scene
from gendom.estimation.scene_settings import SceneSettings
from gendom.estimation.theta import Prior, Theta

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class EstimateSettings:
    """How parameters are estimated; written into every result."""

    method: str = "gauss-newton"
    """One of `gendom.estimation.METHODS`."""
    starts: int = 3
    """Where a search begins: what a scan finds best, and random places."""
    unknowns: tuple[str, ...] = ()
    """Names of `UNKNOWNS` that are looked for; by default what the recording may show."""
    frames: str = "all"
    """``all`` or ``last``: the frames that are compared."""
    max_iterations: int = 25
    """Batches that a search may simulate."""
    seed: int = 0
    """Of everything that is drawn."""
    level: float = 0.9
    """Probability that the intervals claim."""
    scene: SceneSettings = field(default_factory=SceneSettings)
    noise: NoiseModel = field(default_factory=NoiseModel)

    def __post_init__(self) -> None:
        if self.starts < 1:
            raise ParameterError(f"starts must be at least 1, got {self.starts}")
        if self.frames not in ("all", "last"):
            raise ParameterError(f"frames must be 'all' or 'last', got {self.frames!r}")
        if not 0.0 < self.level < 1.0:
            raise ParameterError(f"level must lie between 0 and 1, got {self.level}")
        if self.max_iterations < 2:
            raise ParameterError(f"max_iterations must be at least 2, got {self.max_iterations}")
        if self.seed < 0:
            raise ParameterError(f"seed must be at least 0, got {self.seed}", fix="give 0 or more")


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress of an estimation."""

    stage: str
    iteration: int
    most: int
    """Iterations that there can be."""
    best: Theta
    rms: float
    """Distance of the clouds from the best fit's skin [m]."""


@dataclass(kw_only=True)
class Start:
    """One place where a search began, and where it has got."""

    initial: Array
    """[P] transformed."""
    vector: Array
    """[P] transformed."""
    comparison: Comparison | None = None
    value: float = math.inf
    """Of what the method makes small."""
    damping: float = 1e-3
    """Levenberg's and Marquardt's."""
    iterations: int = 0
    done: bool = False
    history: list[tuple[int, Array, float]] = field(default_factory=list)
    """Iteration, vector, and root mean square distance [m]."""
    coarse: int | None = None
    """Its last iteration with part of the unknowns or of the clouds; None: there is no such stage.
    """

    def stage(self, iteration: int, method: str) -> str:
        """What an iteration of its history belongs to: the method where it has one stage."""
        if self.coarse is None:
            return method
        return "coarse" if iteration <= self.coarse else "fine"


@dataclass(frozen=True, kw_only=True)
class Found:
    """What a method has found."""

    best: Start
    starts: Sequence[Start]
    noise: NoiseModel
    """With which its comparison is to be read."""
    interrupted: bool = False
    covariance: Array | None = None
    """[P, P] transformed, of methods that state their own; None: that of the likelihood."""
    extra: dict[str, Any] = field(default_factory=dict)
    """More of it, for the result's record."""


class Problem:
    """A scene with unknowns, as a function to minimise.

    Args:
        scene: What was recorded.
        settings: How it is estimated.
        on_progress: Called by methods after each iteration.
        known: Values of everything that is not looked for; by default those of the priors.

    Raises:
        ParameterError: The scene has none of the wanted unknowns.
    """

    def __init__(
        self,
        scene: Scene,
        settings: EstimateSettings,
        on_progress: Callable[[Progress], None] | None = None,
        known: Theta | None = None,
    ):
        if settings.frames == "last":
            scene = replace(scene, frames=scene.frames[-1:], calm=scene.frames[-1:])
        self.scene = scene
        self.settings = settings
        self.prior: Prior
        self.prior, self.base = scene.prior(settings.unknowns)
        if known is not None:
            self.base = self.prior.theta(self.prior.mean, known)
        self._on_progress = on_progress

    @cached_property
    def easier(self) -> Problem:
        """The same to begin with: of a rope the frames alone in which nothing moves fast, where
        there are enough (what it does fast depends on the way that it was before); a cloth with
        fewer points."""
        scene, settings = self.scene, self.scene.settings
        if scene.kind == "cloth" and scene.thin and settings.points is None:
            coarse = Scene.of(scene.recording, replace(settings, points=settings.coarse_points))
            return self._with(replace(coarse, frames=scene.frames, calm=scene.calm))
        if len(scene.calm) == len(scene.frames) or len(scene.calm) < 6:
            return self
        return self._with(replace(scene, frames=scene.calm))

    def _with(self, scene: Scene) -> Problem:
        part = copy.copy(self)
        for cached in ("observation", "easier"):
            part.__dict__.pop(cached, None)
        part.scene = scene
        return part

    @cached_property
    def observation(self) -> Observation:
        return Observation(self.scene, self.settings.noise)

    def theta(self, vector: Sequence[float] | Array) -> Theta:
        return self.prior.theta(vector, self.base)

    def tell(self, stage: str, iteration: int, most: int, best: Start) -> None:
        """Report progress."""
        if self._on_progress is not None:
            rms = math.nan if best.comparison is None else best.comparison.rms
            self._on_progress(
                Progress(
                    stage=stage,
                    iteration=iteration,
                    most=most,
                    best=self.theta(best.vector),
                    rms=rms,
                )
            )

    def positions(self, vectors: Sequence[Array]) -> Array:
        """[T, W, N, 3] positions at transformed parameters, NaN where a world diverges [m]."""
        return replay(self.scene, [self.theta(v) for v in vectors], keep_going=True)

    def compare(
        self,
        vectors: Sequence[Array],
        *,
        derivatives: bool = True,
        free: Sequence[int] | None = None,
    ) -> list[Comparison | None]:
        """Comparisons at transformed parameters, None where a world diverges, from one batch.

        Args:
            vectors: [P] each.
            derivatives: Whether they know how shapes change with parameters.
            free: Indices of the parameters that matter (default: all); shapes are taken not to
                change with the others.
        """
        P = len(self.prior.names)
        moved = [] if not derivatives else list(range(P) if free is None else free)
        steps = [
            np.where(v + self.prior.step > self.prior.high, -self.prior.step, self.prior.step)
            for v in vectors
        ]
        worlds = [
            v if k < 0 else v + np.eye(P)[k] * h[k]
            for v, h in zip(vectors, steps, strict=True)
            for k in (-1, *moved)
        ]
        x = self.positions(worlds)
        found: list[Comparison | None] = []
        each = 1 + len(moved)
        for n, h in enumerate(steps):
            own = x[:, n * each : (n + 1) * each]
            if not np.isfinite(own).all():
                found.append(None)
                continue
            every = own[:, :1]
            if derivatives:
                every = np.repeat(own[:, :1], 1 + P, axis=1)
                every[:, [1 + k for k in moved]] = own[:, 1:]
            found.append(self.observation.compare(every, h if derivatives else None))
        return found

    def value(self, vector: Array, comparison: Comparison, noise: NoiseModel) -> float:
        """-2 log of likelihood times prior, up to what the noise alone says."""
        off = (vector - self.prior.mean) / self.prior.sd
        return comparison.fit(noise).value + float(off @ off)

    def slopes(self, start: Start, noise: NoiseModel) -> tuple[Array, Array]:
        """Half of that value's slope [P] and curvature [P, P]."""
        assert start.comparison is not None
        fit, precision = start.comparison.fit(noise), self.prior.sd**-2.0
        off = start.vector - self.prior.mean
        return fit.gradient + precision * off, fit.hessian + np.diag(precision)

    def nothing_runs(self) -> SimulationError:
        return SimulationError(
            "no start could be simulated",
            where=f"{self.settings.method}, {len(self.scene.frames)} frames",
            fix="check the recording's units and gripper path with gendom check",
        )
