"""`gendom import`: a recording of another format, or a ROS 2 bag, as a gendom-recording/1 file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from gendom.arguments import require
from gendom.cli.arguments import Json
from gendom.cli.check import summarize, summary_text
from gendom.cli.outputs import print_result, tell_written
from gendom.datasets import Fault, Recording
from gendom.files import check_file
from gendom.perception import RosSettings, bag_files, read_ros_bag


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
    bag: RosSettings = field(default_factory=RosSettings)
    object: Path | None = None
    """Of a bag: what is held, a TOML file; by default object.toml in the bag's folder."""
    json: Json = False

    def run(self) -> int:
        check_file(self.out, ".npz")
        warnings: list[Fault] = []
        # no recording beside which a bag lies
        bag = bag_files(self.source) and not (self.source / "gripper.csv").exists()
        if bag:
            fix = "name a frame of TF, or a topic of poses"
            require(self.bag.gripper, "is missing", where="--gripper", fix=fix)
            folder = self.source if self.source.is_dir() else self.source.parent
            held = self.object or folder / "object.toml"
            recording = read_ros_bag(self.source, held, self.bag, on_warning=warnings.append)
        else:
            flags = {**vars(self.bag), "object": self.object}
            given = [f"--{flag}" for flag, value in flags.items() if value]
            what, where = f"{self.source} is no ROS 2 bag", next(iter(given), None)
            require(not given, what, where=where, fix="leave it out")
            recording = Recording.read(self.source, on_warning=warnings.append)
        summary = summarize(recording)
        text = summary_text(str(self.source), summary)
        print_result({"out": self.out, **summary}, text, warnings, json=self.json)
        recording.write(self.out)
        tell_written(self.out, json=self.json)
        return 0
