"""`gendom perceive`: from depth pictures to a recording."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from gendom.cli.arguments import settings_of
from gendom.cli.check import fault_entry
from gendom.cli.outputs import tell_written
from gendom.datasets import Fault
from gendom.files import check_file, to_json
from gendom.perception import (
    STAGES,
    FusedCloud,
    Perceived,
    PerceptionSettings,
    perceive,
    read_cameras,
)


@dataclass(frozen=True, kw_only=True)
class Command:
    """Turn depth pictures of cameras into a recording of the object's clouds.

    The folder's layout is described in docs/perception.md. Prints how many points each stage
    kept. Frames that cannot be used are left out, with a warning.

    For example: gendom perceive lift --colour 180 30 35 --out lift.npz
    """

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """Folder with object.toml, gripper.csv and cameras/NAME/."""
    out: Path = Path("recording.npz")
    """The gendom-recording/1 file to write."""
    cameras: tuple[str, ...] = ()
    """Cameras to use; by default all."""
    workspace: tuple[float, float, float, float, float, float] | None = None
    """x0 y0 z0 x1 y1 z1 in metres; by default what the object can reach."""
    colour: tuple[int, int, int] | None = None
    """The object's colour: R G B, 0 to 255."""
    pick: tuple[str, int, int] | None = None
    """Or CAMERA U V: a pixel on the object in the first frame."""
    box: tuple[str, int, int, int, int] | None = None
    """Or CAMERA U0 V0 U1 V1: a box around the object in the first frame."""
    colour_tolerance: float = PerceptionSettings.colour_tolerance
    """Largest distance from that colour in L*a*b*."""
    lightness_weight: float = PerceptionSettings.lightness_weight
    """Weight of lightness in it; 1 for a black, grey or white object."""
    no_table: bool = False
    """Do not look for a table and remove it."""
    no_level: bool = False
    """Leave cameras where their calibration says, though the table they see is not level."""
    sync_tolerance: float = PerceptionSettings.sync_tolerance
    """Largest difference of the time stamps of frames that belong together, in seconds."""
    voxel: float = PerceptionSettings.voxel
    """Edge in metres of the cubes that give one point each; 0 keeps all points."""
    min_cluster: int = PerceptionSettings.min_cluster
    """Connected points fewer than this are dropped."""
    frames: bool = False
    """Print the counts of every frame."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        check_file(self.out, ".npz")
        warnings: list[Fault] = []
        settings = settings_of(
            PerceptionSettings, self, find_table=not self.no_table, level=not self.no_level
        )
        recorded = read_cameras(self.folder, cameras=self.cameras, on_warning=warnings.append)
        show = self.frames and not self.json
        if show:
            print(_row("time", STAGES))
        perceived = perceive(
            recorded,
            settings,
            on_warning=warnings.append,
            on_frame=_print_frame if show else lambda _time, _cloud: None,
        )
        if self.json:
            entries = [fault_entry(w) for w in warnings]
            print(to_json({"out": self.out, **_summary(perceived), "warnings": entries}))
        else:
            print(_text(perceived, warnings))
        perceived.write(self.out)
        tell_written(self.out, json=self.json)
        return 0


def _print_frame(time: float, cloud: FusedCloud) -> None:
    print(_row(f"{time:.3f}", cloud.counts.tolist()))


def _row(head: str, cells: Any) -> str:
    return f"{head:>9}" + "".join(f"{cell:>11}" for cell in cells)


def _summary(perceived: Perceived) -> dict[str, Any]:
    counts = perceived.counts
    seen_by = perceived.seen_by
    return {
        "frames": len(counts),
        "cameras": perceived.cameras,
        "points": {
            stage: {
                "min": int(column.min()),
                "median": float(np.median(column)),
                "max": int(column.max()),
            }
            for stage, column in zip(STAGES, counts.T, strict=True)
        },
        "points_by_frame": [
            {"time": time, **dict(zip(STAGES, row, strict=True))}
            for time, row in zip(perceived.recording.time.tolist(), counts.tolist(), strict=True)
        ],
        "seen_by": {
            name: float(((seen_by >> k) & 1).mean()) for k, name in enumerate(perceived.cameras)
        },
        "seen_share": perceived.seen_share,
        "disagreement": perceived.disagreement,
        "levelled": perceived.recording.extra["perception"]["levelled"],
    }


def _text(perceived: Perceived, warnings: list[Fault]) -> str:
    summary = _summary(perceived)
    lines = [f"{summary['frames']} frames; points a frame after each stage"]
    lines.append(f"  {'':<10}{'min':>9}{'median':>9}{'max':>9}")
    for stage, row in summary["points"].items():
        lines.append(f"  {stage:<10}{row['min']:>9}{row['median']:>9.0f}{row['max']:>9}")
    shares = ", ".join(f"{name} {100 * s:.0f} %" for name, s in summary["seen_by"].items())
    lines.append(f"  points seen by: {shares}")
    if moved := summary["levelled"]:
        by = (
            f"{name} {1e3 * m['rise']:+.1f} mm, {math.degrees(m['turn']):.2f} degrees"
            for name, m in moved.items()
        )
        lines.append(f"  levelled by the table: {'; '.join(by)}")
    if perceived.disagreement is not None:
        lines.append(f"  cameras place the object {1e3 * perceived.disagreement:.1f} mm apart")
    lines.append(f"  about {100 * perceived.seen_share:.0f} % of the object is seen")
    lines += [f"  warning   {warning}" for warning in warnings]
    return "\n".join(lines)
