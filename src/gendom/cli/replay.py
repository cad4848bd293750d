"""`gendom replay`: simulate a recorded motion with given parameters."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from gendom.cli.arguments import Device, Json, Recorded, iterations_shown
from gendom.cli.outputs import check_places, tell_written, write_result
from gendom.datasets import Recording
from gendom.files import to_json
from gendom.progress import bar


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
        from gendom.estimation.replayed import replay_setup
        from gendom.materials.estimate_file import read_record
        from gendom.sim import open_device

        check_places((self.out, ".json"), (self.gif, ".gif"))
        open_device(self.device)
        recording = Recording.read(self.recording)
        params = read_record(self.params, even_unusable=self.force)
        with iterations_shown() as show:
            of = str(self.params), self.device, self.engine
            scene, theta = replay_setup(recording, params, *of, on_progress=show)
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
            from gendom.viz import write_film
            from gendom.viz.layers import lift_animation

            write_film(self.gif, lift_animation(scene, x, theta, distance=("Chamfer", whole)))
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
