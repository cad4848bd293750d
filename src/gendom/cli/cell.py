"""`gendom cell`: check a cell's description, and draw it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gendom.cli.arguments import Json
from gendom.cli.outputs import check_places, print_result, write_picture
from gendom.errors import DeviceError
from gendom.hardware.cell import Cell
from gendom.hardware.picture import draw_cell


@dataclass(frozen=True, kw_only=True)
class Command:
    """Validate cell.toml, which describes a robot, its cameras and what stands around them.

    Exit code 2 where the cell cannot be used; warnings are of what to look after. The file is
    described in docs/hardware.md.

    For example: gendom cell check cell.toml --picture cell.png
    """

    what: tyro.conf.Positional[Literal["check"]]
    """check."""
    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CELL")]
    """cell.toml."""
    picture: Path | None = None
    """PNG file: the cell from the top and from the side."""
    json: Json = False

    def run(self) -> int:
        check_places((self.picture, ".png"))
        cell = Cell.read(self.file)
        faults = cell.faults()
        wrong = [fault for fault in faults if fault.severity == "error"]
        if self.picture is not None:
            write_picture(self.picture, draw_cell(cell, cell.model.home[None]), json=self.json)
        if wrong:
            more = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
            where = f"{self.file}: {wrong[0].where}"
            raise DeviceError(wrong[0].what + more, where=where, fix=wrong[0].fix)
        (low, high), around = cell.workspace, cell.surroundings
        summary = {
            "robot": cell.robot, "address": cell.address, "arm": cell.arm,
            "cameras": [c.name for c in cell.camera],
            "obstacles": [o.name for o in around.obstacles],
            "workspace": [low, high], "speed": cell.speed,
            "scene_clearance": around.clearance, "self_clearance": around.self_clearance,
        }  # fmt: skip
        rows = [
            ("robot", f"{cell.robot} at {cell.address}, arm {cell.arm}"),
            ("speed", f"tool {cell.speed.tool:g} m/s, joints {100 * cell.speed.share:g} %"),
            ("distance", f"{1e3 * around.clearance:g} mm to the scene, "
             f"{1e3 * around.self_clearance:g} mm to itself"),
            ("cameras", ", ".join(summary["cameras"]) or "none"),
            ("around", ", ".join(summary["obstacles"]) or "nothing"),
        ]  # fmt: skip
        text = "\n".join(f"{name:<10} {said}" for name, said in rows)
        print_result(summary, text, [f for f in faults if f not in wrong], json=self.json)
        return 0
