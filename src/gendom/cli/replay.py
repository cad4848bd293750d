"""`gendom replay`: simulate a recorded motion with given parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from tqdm import tqdm

from gendom.datasets import Recording
from gendom.errors import ParameterError
from gendom.files import read_json, to_json, write_json

if TYPE_CHECKING:
    from gendom.estimation import Lift, Theta


@dataclass(frozen=True, kw_only=True)
class Command:
    """Simulate a recorded gripper motion and compare it with the recording, frame by frame.

    The recording may be longer than the one that was fitted, or another one of the same object.
    """

    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")]
    """A gendom-recording/1 file (.npz), or a folder of .ply files, gripper.csv, object.toml."""
    params: Path
    """Parameters: an estimate.json."""
    out: Path | None = None
    """File for the JSON."""
    json: bool = False
    """Print JSON."""
    gif: Path | None = None
    """Animation of recorded and simulated clouds."""
    engine: Literal["mpm", "thin"] | None = None
    """Of the simulator; by default the one that the parameters were estimated with."""
    device: str = "cpu"
    """cpu, cuda or cuda:0 and so on."""

    def run(self) -> int:
        from gendom.estimation import replay_chamfer
        from gendom.sim import open_device

        open_device(self.device)
        recording = Recording.read(self.recording)
        lift, theta = replay_setup(
            recording, read_json(self.params), str(self.params), self.device, self.engine
        )
        with tqdm(
            total=len(lift.frames), desc="replaying", unit="frame", leave=False, disable=None
        ) as bar:

            def show(done: int) -> None:
                bar.update(done - bar.n)

            x = lift.simulate([theta], on_frame=show)[:, 0]
        whole, surface = replay_chamfer(lift, x)
        record: dict[str, Any] = {
            "format": "gendom-replay/1",
            "recording": str(self.recording),
            "frame": lift.frames,
            "time": recording.time[lift.frames].tolist(),
            "chamfer": whole.tolist(),
            "chamfer_last": float(whole[-1]),
            "chamfer_mean": float(whole.mean()),
            "chamfer_surface": surface.tolist(),
            "chamfer_last_surface": float(surface[-1]),
            "chamfer_mean_surface": float(surface.mean()),
            "clock": lift.clock,
            "notes": lift.notes,
        }
        if self.out is not None:
            write_json(self.out, record)
        if self.gif is not None:
            from gendom.viz import CloudSequence, write_gif

            clouds = CloudSequence(
                recorded=[recording.frame(t) for t in lift.frames],
                simulated=list(x),
                times=recording.time[lift.frames],
                table_height=recording.table_height,
                gripper=recording.gripper_position[lift.frames],
                chamfer=whole,
            )
            view = "oblique" if recording.object.kind == "cloth" else "auto"
            write_gif(self.gif, clouds, view=view)
        if self.json:
            print(to_json(record))
        else:
            print(
                f"Chamfer distance: mean {1e3 * whole.mean():.1f} mm, last frame "
                f"{1e3 * whole[-1]:.1f} mm (seen surface: {1e3 * surface.mean():.1f} and "
                f"{1e3 * surface[-1]:.1f} mm)"
            )
            for note in lift.notes:
                print(f"note: {note}")
        return 0


def replay_setup(
    recording: Recording,
    params: dict[str, Any],
    where: str,
    device: str,
    engine: str | None = None,
) -> tuple[Lift, Theta]:
    """The lift and the parameters that an estimate's JSON stands for.

    How a cloth's corner is held belongs to one lift: in the lift of the estimate, however long, it
    is held as the estimate says; in another one that is found anew.

    Raises:
        ParameterError: If the parameters are not an estimate or belong to another kind of object.
    """
    from gendom.estimation import Hold, Lift, ReplaySettings, Theta

    if params.get("format") != "gendom-estimate/1":
        raise ParameterError(
            f"format is {params.get('format')!r}, not 'gendom-estimate/1'",
            where=where,
            fix="give a file that gendom estimate --out wrote",
        )
    try:
        theta = Theta(
            specific_modulus=float(params["specific_modulus"]),
            nu=float(params["poissons_ratio"]),
            grip_offset=float(params.get("grip_offset", 0.0)),
            friction=float(params.get("friction", 0.3)),
        )
        kind = params["object"]["kind"]
        simulation = params.get("simulation", {})
        settings = ReplaySettings(
            engine=engine or str(simulation.get("engine", "mpm")),
            cells_across=float(simulation.get("cells_across", 1.5)),
            law=str(simulation.get("law", "neo-hookean")),
            device=device,
        )
        same = params.get("begins_with") == recording.begins_with and params.get("hold")
        hold = Hold(**params["hold"]) if same else None
    except (KeyError, TypeError, ValueError) as error:
        raise ParameterError(
            f"cannot be used: {type(error).__name__} {error}",
            where=where,
            fix="give a file that gendom estimate --out wrote",
        ) from None
    if kind != recording.object.kind:
        raise ParameterError(
            f"the parameters are of a {kind}, the recording shows a {recording.object.kind}",
            where=where,
            fix="estimate from a recording of the same object",
        )
    lift = Lift(recording, settings, hold=hold, known=theta)
    if lift.held is not None:
        # the offset belongs to the estimate's own lift; how this corner is held was just found
        theta = replace(theta, grip_offset=0.0)
    return lift, theta
