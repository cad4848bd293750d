"""`gendom export`: demonstrations or a recording in another project's format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from gendom.datasets import Recording
from gendom.datasets.recording import is_recording
from gendom.errors import printable
from gendom.files import check_folder, to_json


@dataclass(frozen=True, kw_only=True)
class Command:
    """Write a set of demonstrations, or a recording, as a LeRobot data set (format v3.0).

    A demonstration becomes an episode of one frame; those that failed, and those not yet
    simulated, are left out. A recording becomes one episode, which gendom check, estimate and
    import read back without loss.

    For example: gendom export casts --out casts-lerobot
    """

    source: tyro.conf.Positional[Path]
    """Folder written by gendom dataset, or a recording."""
    out: Path
    """Folder to make."""
    to: Literal["lerobot"] = "lerobot"
    """The format."""
    json: bool = False
    """Print info.json."""

    def run(self) -> int:
        from gendom.datasets.lerobot import export_demonstrations, export_recording

        check_folder(self.out)
        if is_recording(self.source):
            info = export_recording(Recording.read(self.source), self.out)
        else:
            info = export_demonstrations(self.source, self.out)
        print(to_json(info) if self.json else info_text(info, self.out))
        return 0


def info_text(info: dict[str, Any], out: Path) -> str:
    """The same for people."""
    count, kind = info["total_episodes"], info["codebase_version"]
    lines = [f"{printable(out)}: {count} episodes, LeRobot {kind}"]
    for feature, about in info["features"].items():
        if about["names"]:
            named = zip(about["names"], about["units"], strict=True)
            lines.append(f"  {feature:<17}  {', '.join(f'{n} [{u}]' for n, u in named)}")
    return "\n".join(lines)
