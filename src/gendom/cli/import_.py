"""`gendom import`: a recording of another format, or a ROS bag, as a gendom-recording/1 file."""

import operator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from gendom.arguments import require
from gendom.cli.arguments import Json, ObjectFile, beside_bag, refuse_bag_flags
from gendom.cli.outputs import print_result, tell_written
from gendom.cli.summary import rows_text, summarize, summary_rows
from gendom.datasets import Fault, Recording
from gendom.datasets.folder import bag_files
from gendom.files import check_file
from gendom.perception import RosSettings, read_ros_bag


@dataclass(frozen=True, kw_only=True)
class Command:
    """Turn another format into a recording, check it and say what is in it.

    Read are bags of ROS 1 and 2 (clouds or depth as they are: gendom perceive takes table and robot
    out of them), folders of clouds (.ply, .pcd, .npz) and LeRobot data sets that gendom export
    wrote: see docs/data.md.

    For example: gendom import lift-bag --gripper tool0 --object object.toml --out lift.npz
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE")]
    """A bag's folder or file, or a folder."""
    out: Path = Path("recording.npz")
    """The gendom-recording/1 file to write."""
    bag: RosSettings = field(default_factory=RosSettings)
    workspace: tuple[float, float, float, float, float, float] | None = None
    """Of a bag: x0 y0 z0 x1 y1 z1 in the world, in metres; points elsewhere are left out."""
    object: ObjectFile = None
    json: Json = False

    def run(self) -> int:
        check_file(self.out, ".npz")
        warnings: list[Fault] = []
        # no recording beside which a bag lies
        if bag_files(self.source) and not (self.source / "gripper.csv").exists():
            held, box = beside_bag(self.source, self.object, self.bag), self.workspace
            ordered = box is None or all(map(operator.lt, box[:3], box[3:]))
            fix = "give x0 y0 z0 x1 y1 z1, each lower value first"
            require(ordered, f"is {box}", where="--workspace", fix=fix)
            recording = read_ros_bag(
                self.source, held, self.bag, workspace=box, on_warning=warnings.append
            )
        else:
            refuse_bag_flags(self.source, self.bag, object=self.object, workspace=self.workspace)
            recording = Recording.read(self.source, on_warning=warnings.append)
        summary = summarize(recording)
        text = rows_text(self.source, "can be used", summary_rows(summary))
        print_result({"out": self.out, **summary}, text, warnings, json=self.json)
        recording.write(self.out)
        tell_written(self.out, json=self.json)
        return 0
