"""`gendom import`: a recording of another format, or a ROS 2 bag, as a gendom-recording/1 file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gendom.arguments import require
from gendom.cli.arguments import settings_of
from gendom.cli.check import fault_entry, summarize, summary_text
from gendom.cli.outputs import tell_written
from gendom.datasets import Fault, Recording
from gendom.files import check_file, to_json
from gendom.perception import RosSettings, is_ros_bag, read_ros_bag


@dataclass(frozen=True, kw_only=True)
class Command:
    """Turn another format into a recording, check it and say what is in it.

    Read are ROS 2 bags (PointCloud2 and TF or PoseStamped; .db3 and .mcap), folders of clouds
    (.ply, .pcd, .npz) and LeRobot data sets that gendom export wrote: see docs/data.md.

    For example: gendom import lift-bag --gripper tool0 --object object.toml --out lift.npz
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE")]
    """A bag's folder or file, or a folder."""
    out: Path = Path("recording.npz")
    """The gendom-recording/1 file to write."""
    gripper: str | None = None
    """Of a bag: frame of the point between the fingertips, or topic of its poses."""
    points: str | None = None
    """Of a bag: topic of the clouds, if there are several."""
    world: str | None = None
    """Of a bag: frame of the recording, z up; by default the root of TF."""
    workspace: tuple[float, float, float, float, float, float] | None = None
    """Of a bag: x, y and z from and to in the world, in metres; points elsewhere are left out."""
    object: Path | None = None
    """Of a bag: what is held, a TOML file; by default object.toml in the bag's folder."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        check_file(self.out, ".npz")
        warnings: list[Fault] = []
        recording = self._read(warnings)
        summary = summarize(recording)
        if self.json:
            entries = [fault_entry(w) for w in warnings]
            print(to_json({"out": self.out, **summary, "warnings": entries}))
        else:
            print(summary_text(str(self.source), summary, warnings))
        recording.write(self.out)
        tell_written(self.out, json=self.json)
        return 0

    def _read(self, warnings: list[Fault]) -> Recording:
        if not is_ros_bag(self.source):
            flags = ("gripper", "points", "world", "workspace", "object")
            given = [f"--{flag}" for flag in flags if getattr(self, flag) is not None]
            what, where = f"{self.source} is no ROS 2 bag", next(iter(given), None)
            require(not given, what, where=where, fix="leave it out")
            return Recording.read(self.source, on_warning=warnings.append)
        fix = "name a frame of TF, or a topic of poses"
        require(self.gripper is not None, "is missing", where="--gripper", fix=fix)
        folder = self.source if self.source.is_dir() else self.source.parent
        held = self.object or folder / "object.toml"
        settings = settings_of(RosSettings, self)
        return read_ros_bag(self.source, held, settings, on_warning=warnings.append)
