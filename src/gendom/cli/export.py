"""`gendom export`: a set of demonstrations in another project's format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from gendom.files import check_folder, to_json


@dataclass(frozen=True, kw_only=True)
class Command:
    """Write a set of demonstrations as a LeRobot data set (format v3.0).

    A demonstration becomes an episode of one frame; those that failed, and those not yet
    simulated, are left out.

    For example: gendom export casts --out casts-lerobot
    """

    set: tyro.conf.Positional[Path]
    """Folder written by gendom dataset."""
    out: Path
    """Folder to make."""
    to: Literal["lerobot"] = "lerobot"
    """The format."""
    json: bool = False
    """Print info.json."""

    def run(self) -> int:
        from gendom.datasets.lerobot import export_lerobot

        check_folder(self.out)
        info = export_lerobot(self.set, self.out)
        print(to_json(info) if self.json else info_text(info, self.out))
        return 0


def info_text(info: dict[str, Any], out: Path) -> str:
    """The same for people."""
    lines = [f"{out}: {info['total_episodes']} episodes, LeRobot {info['codebase_version']}"]
    for feature, about in info["features"].items():
        if about["names"]:
            named = zip(about["names"], about["units"], strict=True)
            lines.append(f"  {feature:<17}  {', '.join(f'{n} [{u}]' for n, u in named)}")
    return "\n".join(lines)
