"""`estimate`: the parameters of an object from recordings of it."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from gendom.arguments import check_list
from gendom.arrays import Array
from gendom.datasets import Recording
from gendom.errors import ParameterError, RecordingError, did_you_mean
from gendom.estimation.intervals import IntervalCalibration, posterior_of, told_apart
from gendom.estimation.methods.gauss_newton import gauss_newton, refined
from gendom.estimation.problem import EstimateSettings, Found, Problem, Progress, recording_names
from gendom.estimation.registration import register
from gendom.estimation.result import FittedEstimate, result_of
from gendom.estimation.scene import LiftScene
from gendom.estimation.tip import with_tip
from gendom.estimation.verdict import judge, refused_before
from gendom.materials.posterior import Posterior
from gendom.materials.unknowns import Theta
from gendom.plugins import plugins

METHODS: dict[str, Callable[[Problem], Found]] = {"gauss-newton": gauss_newton}
"""By name; other packages add theirs by entry points of the group ``gendom.methods``."""


def find_method(name: str) -> Callable[[Problem], Found]:
    """The method of a name, those of other packages included.

    Raises:
        ParameterError: There is none of that name.
    """
    known = {**plugins("methods"), **METHODS}
    if name not in known:
        fix = did_you_mean(name, known) or f"choose from {', '.join(known)}"
        raise ParameterError(f"there is no method {name!r}", fix=fix)
    return known[name]


def estimate(
    recordings: Recording | Sequence[Recording],
    settings: EstimateSettings | None = None,
    *,
    names: Sequence[str] = (),
    on_progress: Callable[[Progress], None] | None = None,
    calibration: IntervalCalibration | None = None,
    known: Theta | None = None,
) -> FittedEstimate:
    """Estimate an object's parameters from one or more recordings of it.

    All recordings share the material; every other unknown has a value for each recording. Ctrl-C
    ends the search and keeps the best found so far. The result is usable if all recordings are; its
    ``verdict`` names those that are not.

    Args:
        recordings: Lifts, or any motions with grippers that hold the object.
        settings: Method, starts, frames, seed, resolution.
        names: Of the recordings, for people; by default recording 1 and so on.
        on_progress: Called after each iteration.
        calibration: Of the intervals (default: the shipped one).
        known: Values of what is not estimated; by default the means of the priors.

    Raises:
        RecordingError: If a recording has faults, as of `Recording.read`, or shows too little to
            place the object.
        ParameterError: If there is no such method, it cannot do this, or the recordings are of
            different objects.
        SimulationError: If every start diverges.
        KeyboardInterrupt: If interrupted before anything was found.
    """
    settings = settings or EstimateSettings()
    search, began = find_method(settings.method), clock.perf_counter()
    recordings = [recordings] if isinstance(recordings, Recording) else recordings
    check_list("recordings", recordings, Recording)
    names = names or recording_names(len(recordings))
    for recording, name in zip(recordings, names, strict=True):  # perhaps made, not read
        recording.require_valid(name or "recording", on_warning=lambda _: None)
    # Worlds and clouds go side by side already. Threads of BLAS for matrices this small wait for
    # each other (a search takes 1.6 to 6 times as long), and results would depend on their number.
    with threadpool_limits(limits=1, user_api="blas"):
        scenes = [_scene(r, settings, known, n) for r, n in zip(recordings, names, strict=True)]
        problem = Problem(scenes, settings, on_progress, known, names)
        found, added, said = _searched(problem, search)
        problem = found.problem or problem
        cable = len(problem.scene.held) > 1 and not problem.scene.static
        shown = "cable" if cable else problem.scene.kind
        calibration = calibration or IntervalCalibration.of(shown, settings.frames)
        posterior = posterior_of(problem, found, calibration, added)
        alone = _alone(problem, found, posterior, calibration)
        seconds = clock.perf_counter() - began
        verdict = judge(problem, found, posterior, alone)
        if "E_over_rho" in posterior.names and "thickness" not in posterior.names:
            posterior = posterior.with_assumed(problem.scene.prior(("thickness",))[0])
        if not verdict.usable:
            posterior = replace(posterior, covariance=np.diag(posterior.prior.sd**2))
        said = (*said, *told_apart(problem, found))
        return result_of(problem, found, posterior, alone, verdict, seconds, said)


def _searched(
    problem: Problem, search: Callable[[Problem], Found]
) -> tuple[Found, Array | float, tuple[str, ...]]:
    """`with_tip` of what a method finds, at the resolution that the result needs. A recording that
    is refused whatever is found gets a few iterations, which show where it differs."""
    refused = refused_before(problem)
    if refused:
        problem.settings = replace(problem.settings, starts=1, max_iterations=2)
    found = search(problem)
    while problem.settings.method == "gauss-newton" and not (found.interrupted or refused):
        problem = found.problem or problem
        finer = problem.finer(found.best.vector).beside(found)
        if finer is problem:
            break
        if problem.scene.kind == "cloth":
            finer = finer.followed(found.best.vector)
        limp = finer.scene.limp and not problem.scene.limp
        found = gauss_newton(finer) if limp else refined(finer, found)
        if problem.scene.kind == "cloth":
            break  # once: what its points leave of the error is added to its deviation
    return (found, 0.0, ()) if refused else with_tip(found.problem or problem, found)


def _alone(
    problem: Problem, found: Found, posterior: Posterior, calibration: IntervalCalibration
) -> list[Posterior]:
    """The posterior of each recording alone, searched from the joint result; empty where that was
    interrupted. Noise is estimated again: in the joint fit a recording of another object looks
    noisy."""
    if len(problem.parts) == 1 or found.interrupted:
        return [posterior] if len(problem.parts) == 1 else []
    posteriors = []
    for recording, part in enumerate(problem.parts):
        alone = problem.alone(recording)
        own = gauss_newton(alone, initial=[found.best.vector[part.shown]])
        posteriors.append(posterior_of(own.problem or alone, own, calibration))
    return posteriors


def _scene(
    recording: Recording, settings: EstimateSettings, known: Theta | None, name: str
) -> LiftScene:
    """The scene of a recording, registered where camera poses are unknown; errors name it."""
    said = "stated" if recording.cameras_calibrated else "unknown"
    try:
        unknown = (settings.camera_pose or said) == "unknown"
        registration = register(recording, settings, known) if unknown else None
        return LiftScene.of(recording, settings.scene, registration)
    except RecordingError as error:
        own = {"where": ": ".join(filter(None, (name, error.where))) or None, "fix": error.fix}
        raise RecordingError(error.what, **own, faults=error.faults) from None
