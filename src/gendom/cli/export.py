"""`gendom export`: demonstrations or a recording in another project's format."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from gendom.arguments import require
from gendom.datasets import Recording
from gendom.datasets.recording import is_recording
from gendom.errors import printable
from gendom.files import check_folder


@dataclass(frozen=True, kw_only=True)
class Command:
    """Write demonstrations, a recording or depth pictures as a LeRobot data set (format v3.0).

    A demonstration becomes an episode of one frame; those that failed, and those not yet
    simulated, are left out. A recording becomes one episode, which gendom check, estimate and
    import read back without loss. Pictures of cameras, as gendom perceive takes them, become one
    episode with colour and depth.

    For example: gendom export casts --out casts-lerobot
    """

    source: tyro.conf.Positional[Path]
    """Folder written by gendom dataset, a recording, or a folder with cameras/NAME/."""
    out: Path
    """Folder to make."""

    def run(self) -> int:
        from gendom.datasets.lerobot import export_demonstrations, export_recording

        check_folder(self.out)
        if (self.source / "cameras").is_dir():
            info = _export_cameras(self.source, self.out)
        elif is_recording(self.source):
            info = export_recording(Recording.read(self.source), self.out)
        else:
            info = export_demonstrations(self.source, self.out)
        print(info_text(info, self.out))
        return 0


def _export_cameras(folder: Path, out: Path) -> dict[str, Any]:
    """What cameras saw while the gripper's path is known, at the times of the first camera."""
    from gendom.datasets.lerobot import export_pictures
    from gendom.perception import read_cameras

    recorded, pictures = read_cameras(folder), {}
    every = [(source.camera, list(source)) for source in recorded.sources]
    at = {f.time: p[0] for f in every[0][1] if (p := recorded.robot.at(f.time)) is not None}
    fix = "put all times on one clock"
    require(at, "has no picture at a time of the gripper's path", where=str(folder), fix=fix)
    for camera, frames in every:
        near = [min(frames, key=lambda f: abs(f.time - t)).read() for t in at]
        counts = [1e3 * camera.depth_unit * p.depth for p in near]
        depth = [mm.round().clip(0, 65535).astype(np.uint16) for mm in counts]
        pictures[f"observation.depth.{camera.name}"] = depth
        colours = [p.colour for p in near if p.colour is not None]
        if len(colours) == len(near):
            pictures[f"observation.images.{camera.name}"] = colours
    kind = recorded.meta["object"]["kind"]
    about = {"format": "gendom-pictures/1", "meta": recorded.meta}
    time, position = np.array(list(at)), np.stack(list(at.values()))
    return export_pictures(pictures, time, position, out, task=f"move a {kind}", about=about)


def info_text(info: dict[str, Any], out: Path) -> str:
    """What was written."""
    count, version = info["total_episodes"], info["codebase_version"]
    lines = [f"{printable(out)}: {count} episodes, LeRobot {version}"]
    for feature, about in info["features"].items():
        named = zip(about["names"] or (), about.get("units", about["shape"]), strict=False)
        if said := ", ".join(f"{name} [{unit}]" for name, unit in named):
            lines.append(f"  {feature:<17}  {said}")
    return "\n".join(lines)
