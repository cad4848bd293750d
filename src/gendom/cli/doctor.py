"""`gendom doctor`: what lies in a file or folder, what is wrong with it, and the next command."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gendom.cli.arguments import Json
from gendom.cli.outputs import check_places, fault_entry, print_result, write_picture
from gendom.cli.recognised import look
from gendom.cli.summary import rows_text
from gendom.errors import GendomError, RecordingError
from gendom.files import to_json


@dataclass(frozen=True, kw_only=True)
class Command:
    """Say what lies there, check axes, units, intrinsics and crop, draw it, and name the next
    command.

    Known are recordings, folders of clouds or of depth pictures, bags of ROS 1 and 2, sets of
    LeRobot, boards of a calibration, cameras' files, cells and estimates. Exit code 2: it
    cannot be used; every fault is listed.

    For example: gendom doctor lift
    """

    place: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="PATH")]
    """A file or folder."""
    picture: Path = Path("doctor.png")
    """PNG file: the clouds from the top, the front and the side, where there are any."""
    json: Json = False

    def run(self) -> int:
        return examine(self.place, self.picture, json=self.json)


def examine(place: Path, picture: Path | None = None, *, json: bool) -> int:
    """Print what lies there, and draw it where a picture is wanted; the exit code.

    Raises:
        RecordingError: It cannot be used; one line a fault.
    """
    check_places((picture, ".png"))
    try:
        found = look(place)
    except GendomError as error:
        if json:
            faults = [fault_entry(fault) for fault in getattr(error, "faults", ()) or [error]]
            print(to_json({"path": place, "valid": False, "faults": faults}))
        raise
    errors = [fault for fault in found.faults if fault.severity == "error"]
    warnings = [fault for fault in found.faults if fault.severity != "error"]
    of = {"path": place, "is": found.kind, "valid": not errors, **found.summary}
    if errors:
        of["faults"] = [fault_entry(fault) for fault in errors]
    of["next"] = [{"command": command, "does": does} for command, does in found.next]
    said = f"{found.kind}, {'lacks something' if errors else 'can be used'}"
    print_result(of, rows_text(place, said, found.rows), warnings, json=json)
    if found.next and not json:
        print("next:")
        print("\n".join(f"  {command}\n      {does}" for command, does in found.next))
    if picture is not None and found.clouds:
        from gendom.viz.views import draw_views

        drawn = draw_views(found.clouds, gripper=found.gripper, table=found.table)
        write_picture(picture, drawn, json=json)
    if errors:
        named = any(fault.where.startswith(str(place)) for fault in errors)
        raise RecordingError(where="" if named else str(place), faults=errors)
    return 0
