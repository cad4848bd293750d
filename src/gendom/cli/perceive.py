"""`gendom perceive`: from depth pictures or a ROS bag to a recording."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from gendom.cli.arguments import Json, ObjectFile, beside_bag, refuse_bag_flags
from gendom.cli.outputs import columns, print_result, tell_written
from gendom.cli.summary import spread
from gendom.datasets import Fault
from gendom.datasets.folder import bag_files
from gendom.files import check_file
from gendom.perception import (
    STAGES,
    Perceived,
    PerceptionSettings,
    RosSettings,
    perceive,
    read_cameras,
    read_ros_cameras,
)
from gendom.robot import find_arm


@dataclass(frozen=True, kw_only=True)
class Command:
    """Turn depth pictures of cameras into a recording of the object's clouds.

    The folder's layout is described in docs/perception.md; bags of ROS 1 and 2 are taken, too, with
    depth or clouds of one camera or several. Prints how many points each stage kept. Frames that
    cannot be used are left out, with a warning.

    For example: gendom perceive lift --colour 180 30 35 --out lift.npz
    """

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """Folder with object.toml, gripper.csv and cameras/NAME/, or a ROS bag."""
    out: Path = Path("recording.npz")
    """The gendom-recording/1 file to write."""
    cameras: tuple[str, ...] = ()
    """Cameras to use; by default all."""
    arm: str = ""
    """The robot of joints.csv: a name, or a URDF or MJCF file; by default object.toml names it."""
    perception: PerceptionSettings = field(default_factory=PerceptionSettings)
    bag: RosSettings = field(default_factory=RosSettings)
    object: ObjectFile = None
    json: Json = False

    def run(self) -> int:
        check_file(self.out, ".npz")
        warnings: list[Fault] = []
        arm = find_arm(self.arm, files=True) if self.arm else None
        if bag_files(self.folder) and not (self.folder / "cameras").is_dir():
            held = beside_bag(self.folder, self.object, self.bag)
            recorded = read_ros_cameras(self.folder, held, self.bag, cameras=self.cameras, arm=arm)
        else:
            refuse_bag_flags(self.folder, self.bag, object=self.object)
            recorded = read_cameras(
                self.folder, cameras=self.cameras, arm=arm, on_warning=warnings.append
            )
        perceived = perceive(recorded, self.perception, on_warning=warnings.append)
        summary = _summary(perceived)
        print_result({"out": self.out, **summary}, _text(summary), warnings, json=self.json)
        perceived.recording.write(self.out)
        tell_written(self.out, json=self.json)
        return 0


def _summary(perceived: Perceived) -> dict[str, Any]:
    counts, recording = perceived.counts, perceived.recording
    seen_by = recording.seen_by
    assert seen_by is not None
    return {
        "frames": len(counts),
        "cameras": perceived.cameras,
        "points": {stage: spread(of) for stage, of in zip(STAGES, counts.T, strict=True)},
        "points_by_frame": [
            {"time": time, **dict(zip(STAGES, row, strict=True))}
            for time, row in zip(recording.time.tolist(), counts.tolist(), strict=True)
        ],
        "seen_by": {n: float(((seen_by >> k) & 1).mean()) for k, n in enumerate(perceived.cameras)},
        "seen_share": perceived.seen_share,
        "disagreement": perceived.disagreement,
        "levelled": recording.extra["perception"]["levelled"],
    }


def _text(summary: dict[str, Any]) -> str:
    rows = [
        (f"  {stage}", str(of["min"]), f"{of['median']:.0f}", str(of["max"]))
        for stage, of in summary["points"].items()
    ]
    shares = ", ".join(f"{name} {100 * s:.0f} %" for name, s in summary["seen_by"].items())
    lines = [
        f"{summary['frames']} frames; points a frame after each stage",
        columns(("", "min", "median", "max"), rows),
        f"  points seen by: {shares}",
    ]
    by = [f"{name} {1e3 * m['rise']:+.1f} mm, {math.degrees(m['turn']):.2f} degrees"
          for name, m in summary["levelled"].items()]  # fmt: skip
    lines += [f"  levelled by the table: {'; '.join(by)}"] if by else []
    if (apart := summary["disagreement"]) is not None:
        lines.append(f"  cameras place the object {1e3 * apart:.1f} mm apart")
    lines.append(f"  about {100 * summary['seen_share']:.0f} % of the object is seen")
    return "\n".join(lines)
