"""`gendom replay`: simulate a recorded motion with given parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import tyro
from numpy.typing import NDArray

from gendom.arguments import check_numbers, require
from gendom.cli.arguments import iterations_shown
from gendom.cli.outputs import tell_written
from gendom.datasets import Recording
from gendom.errors import ParameterError
from gendom.files import check_file, to_json, write_json
from gendom.progress import bar
from gendom.viz.sources import clouds_of

if TYPE_CHECKING:
    from gendom.estimation import LiftScene, SceneSettings, Theta


@dataclass(frozen=True, kw_only=True)
class Command:
    """Simulate a recorded gripper motion and compare it with the recording, frame by frame.

    The recording may be longer than the one that was fitted, or another one of the same object. In
    another one, how the object is held and when it moves are estimated again, and the material is
    kept.

    For example: gendom replay lift.npz --params lift/estimate.json --gif lift.gif
    """

    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")]
    """A gendom-recording/1 file (.npz), or a folder: clouds (.ply, .pcd, .npz), gripper.csv and
    object.toml (docs/data.md)."""
    params: Path
    """Parameters: an estimate.json."""
    out: Path | None = None
    """JSON file for the distances."""
    json: bool = False
    """Print JSON."""
    gif: Path | None = None
    """GIF file: recorded and simulated clouds."""
    engine: Literal["thin", "mpm"] | None = None
    """Of the simulator; by default the one that the parameters were estimated with."""
    device: str = "cpu"
    """cpu, cuda or cuda:0 and so on."""
    force: bool = False
    """Take parameters whose verdict is not usable, too."""

    def run(self) -> int:
        from gendom.estimation import chamfers, replay
        from gendom.materials.estimate_file import read_record
        from gendom.sim import open_device

        if self.out is not None:
            check_file(self.out, ".json")
        if self.gif is not None:
            check_file(self.gif, ".gif")
        open_device(self.device)
        recording = Recording.read(self.recording)
        scene, theta = replay_setup(
            recording,
            read_record(self.params, even_unusable=self.force),
            str(self.params),
            self.device,
            self.engine,
        )
        frames = list(scene.frames)
        with bar("replaying", len(frames), "frame", even=True) as show:
            x = replay(scene, [theta], on_frame=show)[:, 0]
        whole, surface = chamfers(scene, x, theta)
        record: dict[str, Any] = {
            "format": "gendom-replay/1",
            "recording": str(self.recording),
            "frame": frames,
            "time": recording.time[frames].tolist(),
            "chamfer": whole.tolist(),
            "chamfer_last": float(whole[-1]),
            "chamfer_mean": float(whole.mean()),
            "chamfer_surface": surface.tolist(),
            "chamfer_last_surface": float(surface[-1]),
            "chamfer_mean_surface": float(surface.mean()),
            "clock": scene.clock,
            "notes": list(scene.notes),
        }
        if self.json:
            print(to_json(record))
        else:
            print(
                f"Chamfer distance: mean {1e3 * whole.mean():.1f} mm, last frame "
                f"{1e3 * whole[-1]:.1f} mm (seen surface: {1e3 * surface.mean():.1f} and "
                f"{1e3 * surface[-1]:.1f} mm)"
            )
            for note in scene.notes:
                print(f"note: {note}")
        if self.out is not None:
            write_json(self.out, record)
            tell_written(self.out, json=self.json)
        if self.gif is not None:
            from gendom.viz import write_gif

            write_gif(self.gif, clouds_of(scene, x, theta, whole))
            tell_written(self.gif, json=self.json)
        return 0


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
        params: An estimate's JSON, perhaps of an older version.
        where: Its file, for error messages.
        device: That simulates.
        engine: None: that of the estimate.

    Raises:
        ParameterError: The parameters are no estimate, or of another kind of object.
        RecordingError: The recording shows too little to place the object.
        SimulationError: None of the parameters that are estimated again can be simulated.
    """
    from gendom.estimation import LiftScene

    try:
        own = of_recording(params, recording)
        same = own is not None and "theta" in own
        own = own or params
        theta = _theta(params, own)
        settings = _settings(own, device, engine)
        kind = params["object"]["kind"]
        fitted = 1 + max(0, *own["compared"]) if same else recording.num_frames
        registration = (own.get("calibration") or {}).get("registration") if same else None
    except (KeyError, TypeError, ValueError) as error:
        raise ParameterError(
            f"cannot be used: {type(error).__name__} {error}",
            where=where,
            fix="give a file that gendom estimate --out wrote",
        ) from None
    shown = recording.object.kind
    what = f"the parameters are of a {kind}, the recording shows a {shown}"
    fix = "estimate from a recording of the same object"
    require(kind == shown, what, where=where, fix=fix)
    # the object lies as it was taken to lie from the frames that were fitted
    first = recording.head(min(fitted, recording.num_frames))
    said: tuple[str, ...] = ()
    if not same:
        theta, said, registration = _found_anew(LiftScene.of(first, settings), theta)
    if registration is not None:
        registration = check_numbers("calibration.registration", registration, (4, 4))
        recording = recording.moved(registration)
    scene = LiftScene.of(first, settings, registration)
    notes = scene.notes + said
    return of_all_frames(replace(scene, notes=notes), recording), theta


def of_recording(params: Mapping[str, Any], recording: Recording) -> Mapping[str, Any] | None:
    """What an estimate says of a recording alone; None where it is of others."""
    # files of older versions are of one
    for own in params.get("recordings", [params]):
        if own.get("begins_with") == recording.begins_with:
            return own
    return None


def of_all_frames(scene: LiftScene, recording: Recording) -> LiftScene:
    """A scene with every frame of its recording, or of a longer one of the same motion."""
    every = tuple(t for t in range(recording.num_frames) if recording.frame_valid[t])
    return replace(scene, recording=recording, frames=every)


def _theta(params: Mapping[str, Any], own: Mapping[str, Any]) -> Theta:
    """An estimate's material, and how one of its recordings was held and when."""
    from gendom.estimation import UNKNOWNS, Estimate, Theta

    found = Estimate.from_dict(params)
    if found.posterior.bases:
        return found.theta.with_values(own.get("theta") or {})
    values = params.get("theta")
    if values is None:  # files of earlier versions
        numbers = {n: found.value(n) for n, u in UNKNOWNS.items() if u.material}
        values = {n: v for n, v in numbers.items() if v is not None and n != "thickness"}
    values = {**values, **(own.get("theta") or {})}
    return Theta(**{name: float(value) for name, value in values.items()})


def _settings(params: Mapping[str, Any], device: str, engine: str | None) -> SceneSettings:
    """As the estimate was made; another engine has its own number of points."""
    from gendom.estimation import SceneSettings

    made = params.get("simulation") or {}
    used = str(made.get("engine", "mpm"))  # what older versions had
    points = made.get("points")
    return SceneSettings(
        engine=engine or used,
        points=int(points) if points is not None and engine in (None, used) else None,
        cells_across=float(made.get("cells_across", 1.5)),
        device=device,
    )


def _found_anew(
    scene: LiftScene, theta: Theta
) -> tuple[Theta, tuple[str, ...], NDArray[np.floating] | None]:
    """Parameters for another recording of the same object, what there is to say of them, and its
    `LiftScene.registration`."""
    from gendom.estimation import UNKNOWNS, EstimateSettings, estimate

    prior, base = scene.prior()
    material = {n: getattr(theta, n) for n, u in UNKNOWNS.items() if u.material}
    known = base.with_values(material)
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
