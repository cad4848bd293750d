"""`gendom replay`: simulate a recorded motion with given parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import check_numbers, require
from gendom.cli.arguments import Device, Json, Recorded, iterations_shown
from gendom.cli.outputs import check_places, tell_written, write_result
from gendom.datasets import Recording
from gendom.errors import ParameterError
from gendom.files import to_json
from gendom.progress import bar
from gendom.viz.sources import clouds_of, of_all_frames

if TYPE_CHECKING:
    from gendom.estimation import LiftScene, Theta


@dataclass(frozen=True, kw_only=True)
class Command:
    """Simulate a recorded gripper motion and compare it with the recording, frame by frame.

    The recording may be longer than the one that was fitted, or another one of the same object. In
    another one, how the object is held and when it moves are estimated again, and the material is
    kept.

    For example: gendom replay lift.npz --params lift/estimate.json --gif lift.gif
    """

    recording: Recorded
    params: Path
    """Parameters: an estimate.json."""
    out: Path | None = None
    """JSON file for the distances."""
    json: Json = False
    gif: Path | None = None
    """GIF file: recorded and simulated clouds."""
    engine: Literal["thin", "mpm"] | None = None
    """Of the simulator; by default the one that the parameters were estimated with."""
    device: Device = "cpu"
    force: bool = False
    """Take parameters whose verdict is not usable, too."""

    def run(self) -> int:
        from gendom.estimation import chamfers, replay
        from gendom.materials.estimate_file import read_record
        from gendom.sim import open_device

        check_places((self.out, ".json"), (self.gif, ".gif"))
        open_device(self.device)
        recording = Recording.read(self.recording)
        params = read_record(self.params, even_unusable=self.force)
        scene, theta = replay_setup(recording, params, str(self.params), self.device, self.engine)
        frames = list(scene.frames)
        with bar("replaying", len(frames), "frame", even=True) as show:
            x = replay(scene, [theta], on_frame=show)[:, 0]
        record: dict[str, Any] = {
            "format": "gendom-replay/1",
            "recording": str(self.recording),
            "frame": frames,
            "time": recording.time[frames].tolist(),
            "clock": scene.clock,
            "notes": list(scene.notes),
        }
        whole, surface = chamfers(scene, x, theta)
        for name, distance in (("", whole), ("_surface", surface)):
            record[f"chamfer{name}"] = distance.tolist()
            record[f"chamfer_last{name}"] = float(distance[-1])
            record[f"chamfer_mean{name}"] = float(distance.mean())
        print(to_json(record) if self.json else _text(record))
        write_result(self.out, record, json=self.json)
        if self.gif is not None:
            from gendom.viz import write_gif

            write_gif(self.gif, clouds_of(scene, x, theta, whole))
            tell_written(self.gif, json=self.json)
        return 0


def _text(record: Mapping[str, Any]) -> str:
    """For people."""
    names = [f"chamfer_{of}{part}" for of in ("mean", "last") for part in ("", "_surface")]
    mm = {name: f"{1e3 * record[name]:.1f}" for name in names}
    lines = [
        f"Chamfer distance: mean {mm['chamfer_mean']} mm, last frame {mm['chamfer_last']} mm (seen "
        f"surface: {mm['chamfer_mean_surface']} and {mm['chamfer_last_surface']} mm)"
    ]
    return "\n".join([*lines, *(f"note: {note}" for note in record["notes"])])


def replay_setup(
    recording: Recording,
    params: Mapping[str, Any],
    where: str,
    device: str,
    engine: str | None = None,
) -> tuple[LiftScene, Theta]:
    """The scene of all frames of a recording, and an estimate's parameters for it.

    For the recording of the estimate, however long, all parameters are taken over. For another
    one, those that do not belong to the material are estimated again.

    Args:
        recording: What is replayed.
        params: An estimate's JSON.
        where: Its file, for error messages.
        device: That simulates.
        engine: None: that of the estimate.

    Raises:
        ParameterError: The parameters cannot be used, or are of the other kind of object.
        RecordingError: The recording shows too little to place the object.
        SimulationError: None of the parameters that are estimated again can be simulated.
    """
    from gendom.estimation import Estimate, LiftScene, SceneSettings

    found = Estimate.from_dict(params, where)
    shown = recording.object.kind
    what = f"the parameters are of a {found.kind}, the recording shows a {shown}"
    fix = "estimate from a recording of the same object"
    require(found.kind == shown, what, where=where, fix=fix)
    every = list(params.get("recordings") or ())
    what, fix = "is of no recording, or of an earlier version", "run gendom estimate again"
    require(every and found.posterior.bases, what, where=where, fix=fix)
    own = of_recording(params, recording)
    try:
        made = (own or every[0])["simulation"]
        points = made["points"] if engine in (None, made["engine"]) else None
        settings = SceneSettings(
            engine=engine or made["engine"],
            points=points,  # another engine has its own number
            cells_across=made["cells_across"],
            device=device,
        )
        # the object lies as it was taken to lie from the frames that were fitted
        fitted = recording.num_frames if own is None else 1 + max(own["compared"])
        theta = found.theta.with_values({} if own is None else own["theta"])
        registration = None if own is None else own["calibration"]["registration"]
    except (KeyError, TypeError, ValueError) as error:
        raise ParameterError(
            f"cannot be used: {type(error).__name__} {error}", where=where, fix=fix
        ) from None
    first = recording.head(min(fitted, recording.num_frames))
    said: tuple[str, ...] = ()
    if own is None:
        theta, said, registration = _found_anew(LiftScene.of(first, settings), theta)
    if registration is not None:
        registration = check_numbers("calibration.registration", registration, (4, 4))
        recording = recording.moved(registration)
    scene = LiftScene.of(first, settings, registration)
    return of_all_frames(replace(scene, notes=scene.notes + said), recording), theta


def of_recording(params: Mapping[str, Any], recording: Recording) -> Mapping[str, Any] | None:
    """What an estimate says of a recording alone; None where it is of others."""
    own = (r for r in params.get("recordings", ()) if r.get("begins_with") == recording.begins_with)
    return next(own, None)


def _found_anew(
    scene: LiftScene, theta: Theta
) -> tuple[Theta, tuple[str, ...], NDArray[np.floating] | None]:
    """Parameters for another recording of the same object, what there is to say of them, and its
    `LiftScene.registration`."""
    from gendom.estimation import UNKNOWNS, EstimateSettings, estimate

    prior, base = scene.prior()
    material = {n: getattr(theta, n) for n, u in UNKNOWNS.items() if u.material}
    known = base.with_values(material).with_offsets(theta.offsets)
    own = tuple(n for n in prior.names if not UNKNOWNS[n].material)
    if not own:
        return known, (), None
    settings = EstimateSettings(unknowns=own, starts=1, scene=scene.settings)
    with iterations_shown() as show:
        found = estimate(scene.recording, settings, on_progress=show, known=known)
    listed = ", ".join(own).replace("_", " ")
    said = [f"found anew in this recording: {listed}"]
    said += [f"not as this recording shows it: {reason}" for reason in found.verdict.reasons]
    return found.theta, tuple(said), found.fits[0].scene.registration
