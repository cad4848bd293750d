"""`gendom check`: what `gendom doctor` finds, without its picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gendom.cli.arguments import Json
from gendom.cli.doctor import examine


@dataclass(frozen=True, kw_only=True)
class Command:
    """Validate a recording, or whatever lies there, and print what is in it.

    Exit code 0: it can be used, perhaps with warnings. 2: it cannot; every fault is listed.

    For example: gendom check lift.npz
    """

    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")]
    """A recording, or what gendom doctor takes."""
    json: Json = False

    def run(self) -> int:
        return examine(self.recording, json=self.json)
