"""From one recording to the object's parameters: `estimate`."""

from __future__ import annotations

import time as clock
from collections.abc import Callable

import numpy as np

from gendom.datasets import Recording
from gendom.errors import ParameterError
from gendom.estimation.methods import METHODS
from gendom.estimation.posterior import Calibration, Posterior
from gendom.estimation.problem import EstimateSettings, Problem, Progress
from gendom.estimation.result import Estimate, result_of
from gendom.estimation.scene import Scene
from gendom.estimation.theta import Theta
from gendom.estimation.verdict import judge


def estimate(
    recording: Recording,
    settings: EstimateSettings | None = None,
    *,
    on_progress: Callable[[Progress], None] | None = None,
    calibration: Calibration | None = None,
    known: Theta | None = None,
) -> Estimate:
    """Estimate an object's parameters from one recording.

    Ctrl-C ends the search and keeps the best found so far. Whether the result is of any use is in
    its ``verdict``.

    Args:
        recording: A lift, or any motion with grippers that hold the object.
        settings: Method, starts, frames, seed, resolution.
        on_progress: Called after each iteration.
        calibration: Of the intervals (default: the shipped one).
        known: Values of everything that is not looked for; by default those of the priors.

    Raises:
        RecordingError: If the recording shows too little to place the object.
        ParameterError: If there is no such method, or it cannot do this.
        SimulationError: If every start diverges.
        KeyboardInterrupt: If interrupted before anything was found.
    """
    settings = settings or EstimateSettings()
    if settings.method not in METHODS:
        raise ParameterError(
            f"there is no method {settings.method!r}", fix=f"choose one of {', '.join(METHODS)}"
        )
    began = clock.perf_counter()
    problem = Problem(Scene.of(recording, settings.scene), settings, on_progress, known)
    found = METHODS[settings.method](problem)
    covariance = found.covariance
    if covariance is None:
        covariance = np.linalg.inv(problem.slopes(found.best, found.noise)[1])
    posterior = Posterior.calibrated(
        problem.prior,
        found.best.vector,
        covariance,
        problem.base,
        calibration or Calibration.of(problem.scene.kind),
    )
    verdict = judge(problem, found)
    return result_of(problem, found, posterior, verdict, clock.perf_counter() - began)
