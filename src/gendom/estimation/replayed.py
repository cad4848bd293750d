"""An estimate and a recording brought together: which one is its own, and what is replayed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from gendom.arguments import check_numbers, require
from gendom.arrays import Array
from gendom.datasets import Recording
from gendom.datasets.recording import is_recording
from gendom.errors import GendomError, ParameterError
from gendom.estimation.estimate import estimate
from gendom.estimation.placing import with_points
from gendom.estimation.priors import thickness_stated
from gendom.estimation.problem import EstimateSettings, Progress, check_object
from gendom.estimation.scene import LiftScene, SceneSettings
from gendom.materials import KINDS
from gendom.materials.estimate import Estimate
from gendom.materials.unknowns import UNKNOWNS, Theta


def replay_setup(
    recording: Recording,
    params: Mapping[str, Any],
    where: str,
    device: str = "cpu",
    engine: Literal["thin", "mpm"] | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> tuple[LiftScene, Theta]:
    """The scene of all frames of a recording, and an estimate's parameters for it.

    For the recording of the estimate, however long, all parameters are taken over. For another
    one, those that do not belong to the material are estimated again. ``params`` are an estimate's
    JSON, ``where`` is its file; engine None: that of the estimate.

    Raises:
        ParameterError: The parameters cannot be used, or are of another object.
        RecordingError: The recording shows too little to place the object.
        SimulationError: None of the parameters that are estimated again can be simulated.
    """
    found = Estimate.from_dict(params, where)
    stated = {size: found.known.get(size) for size in ("length", "width", "height", "mass")}
    if thickness_stated(recording.object):
        small = KINDS[found.kind].sizes[1]
        stated[small] = found.known.get(small)
    check_object(recording, found.kind, stated, where="the recording", of=where)
    every = list(params.get("recordings") or ())
    what, fix = "is of no recording, or of an earlier version", "run gendom estimate again"
    require(every and found.posterior.bases, what, where=where, fix=fix)
    own, first, said = of_recording(params, recording), recording, ()
    theta, registration = found.theta, None
    try:
        made = (own or every[0])["simulation"]
        engine = engine or made["engine"]
        # another engine has its own number
        points = made["points"] if engine == made["engine"] else None
        like = {"engine": engine, "points": points, "cells_across": made["cells_across"]}
        if own is not None:
            # the object lies as it was taken to lie from the frames that were fitted
            first = recording.head(min(1 + max(own["compared"]), recording.num_frames))
            theta = theta.with_values(own["theta"])
            registration = own["calibration"]["registration"]
        settings = SceneSettings(**like, device=device)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        what = f"cannot be used: {type(error).__name__} {error}"
        raise ParameterError(what, where=where, fix=fix) from None
    if own is None:
        theta, said, registration = _found_anew(LiftScene.of(first, settings), theta, on_progress)
    if registration is not None:
        registration = check_numbers("calibration.registration", registration, (4, 4))
        recording = recording.moved(registration)
    scene = LiftScene.of(first, settings, registration).finer(theta)
    return of_all_frames(replace(scene, notes=scene.notes + said), recording), theta


def of_recording(params: Mapping[str, Any], recording: Recording) -> Mapping[str, Any] | None:
    """What an estimate says of a recording alone; None where it is of others."""
    own = (r for r in params.get("recordings", ()) if r.get("begins_with") == recording.begins_with)
    return next(own, None)


def _found_anew(
    scene: LiftScene, theta: Theta, on_progress: Callable[[Progress], None] | None
) -> tuple[Theta, tuple[str, ...], Array | None]:
    """Parameters for another recording of the same object, what there is to say of them, and its
    `LiftScene.registration`."""
    prior, base = scene.prior()
    material = {n: getattr(theta, n) for n, u in UNKNOWNS.items() if u.material}
    known = base.with_values(material).with_offsets(theta.offsets)
    own = tuple(n for n in prior.names if not UNKNOWNS[n].material)
    if not own:
        return known, (), None
    settings = EstimateSettings(unknowns=own, starts=1, scene=scene.settings)
    found = estimate(scene.recording, settings, on_progress=on_progress, known=known)
    listed = ", ".join(own).replace("_", " ")
    said = [f"found anew in this recording: {listed}"]
    said += [f"not as this recording shows it: {reason}" for reason in found.verdict.reasons]
    return found.theta, tuple(said), found.fits[0].scene.registration


def of_all_frames(scene: LiftScene, recording: Recording) -> LiftScene:
    """A scene with every frame of its recording, or of a longer one of the same motion."""
    return replace(scene, recording=recording, frames=with_points(recording))


def find_recording(params: Mapping[str, Any], where: Path) -> Path:
    """The recording of an estimate's JSON in a file, by its `Recording.digest`: a file or folder
    beside it, or one folder above.

    Raises:
        GendomError: It is not there.
    """
    folder, similar, every = where.absolute().parent, "", params.get("recordings", ())
    right = isinstance(every, (list, tuple)) and all(isinstance(own, Mapping) for own in every)
    fix = "run gendom estimate again"
    require(right, "does not say which recordings it is of", where=str(where), fix=fix)
    inside = (p for f in (folder, folder.parent) for p in sorted([*f.glob("*.npz"), *f.glob("*/")]))
    for path in filter(is_recording, inside):
        try:
            recording = Recording.read(path, on_warning=lambda _: None)
        except GendomError:  # another kind of file
            continue
        if any(own.get("digest") == recording.digest for own in every):
            return path
        if not similar and of_recording(params, recording) is not None:
            similar = f"; {path} begins like it, but is cut or changed"
    raise GendomError(
        f"its recording is neither beside it nor in the folder above{similar}",
        where=str(where),
        fix=f"name it: gendom view RECORDING --params {where}",
    )
