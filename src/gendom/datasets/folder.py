"""A recording as a folder: one file a frame, gripper.csv, object.toml.

0000.ply, ...   or .pcd, or .npz: one cloud a frame, in natural order of names (2 before 10)
gripper.csv     one row a frame: time,x,y,z[,ax,ay,az][,closed]
object.toml     description of the object, and table_height
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.datasets.npz import read_npz_cloud
from gendom.datasets.pcd import read_pcd
from gendom.datasets.ply import read_ply
from gendom.datasets.recording_form import joined
from gendom.errors import RecordingError
from gendom.files import read_number_table, read_toml

READERS: dict[str, Callable[[Path], np.ndarray]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".npz": read_npz_cloud,
}
"""Readers of clouds, by file suffix."""

# Keys of object.toml that belong beside the table [object]. TOML gives keys written below a
# table's head to that table, so they are also looked for there.
_TOP_KEYS = (
    "table_height",
    "gripper_source",
    "quasi_static",
    "robot",
    "camera_positions",
    "cameras_calibrated",
    "source",
    "notes",
)


def read_folder(
    folder: str | os.PathLike,
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read the parts of a recording stored as a folder.

    The folder holds
        *.ply, *.pcd or *.npz: one cloud a frame, in natural order of their names (2 before 10);
            .npz files beside .ply or .pcd files are not clouds, and are ignored;
        gripper.csv: one row a frame; header time,x,y,z (and ax,ay,az: the axis along the
            object; and closed: 1 where the gripper holds it, 0 where not) for one gripper, or
            time,x0,y0,z0,x1,y1,z1,... (and ax0,ay0,az0,...; closed0,closed1,...);
        object.toml: table [object] with the sizes, and table_height, gripper_source,
            quasi_static, source, notes, camera_positions, cameras_calibrated and anything else.

    Returns:
        Arrays by their names in a recording's file, and the content of object.toml in the layout
        of its `meta`.

    Raises:
        RecordingError: Something is missing, malformed or does not fit together.
    """
    folder = Path(folder)
    suffix, files = _cloud_files(folder)
    meta = read_object(folder / "object.toml")
    arrays = read_gripper(folder / "gripper.csv")
    rows = len(arrays["time"])
    what = f"{len(files)} {suffix} files but {rows} rows in gripper.csv"
    fix = "give one row a frame"
    require(rows == len(files), what, where=str(folder), fix=fix, error=RecordingError)
    return {**arrays, **joined([READERS[suffix](path) for path in files])}, meta


def _cloud_files(folder: Path) -> tuple[str, list[Path]]:
    """Suffix of a folder's clouds, and their files in order."""
    by_suffix: dict[str, list[Path]] = {}
    for path in folder.iterdir():
        suffix = path.suffix.lower()
        if suffix in READERS and not path.name.startswith("."):
            by_suffix.setdefault(suffix, []).append(path)
    if len(by_suffix) > 1:
        by_suffix.pop(".npz", None)
    where, counts = str(folder), " and ".join(f"{len(ps)} {s}" for s, ps in by_suffix.items())
    what, fix = f"holds no {', '.join(READERS)} file", "put one point cloud a frame there"
    require(by_suffix, what, where=where, fix=fix, error=RecordingError)
    what, fix = f"holds {counts} files", "keep those of one kind"
    require(len(by_suffix) == 1, what, where=where, fix=fix, error=RecordingError)
    ((suffix, files),) = by_suffix.items()
    return suffix, sorted(files, key=lambda path: natural_key(path.name))


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sorting key under which frame_2 comes before frame_10."""
    return [
        (0, int(part), part) if part.isdecimal() else (1, 0, part.casefold())
        for part in re.split(r"(\d+)", name)
        if part
    ]


def read_object(path: Path) -> dict[str, Any]:
    """object.toml in the layout of a recording's meta."""
    fix = "write one with the table [object]: kind, sizes in metres, grasp"
    meta = read_toml(path, fix=fix, error=RecordingError)
    table = meta.get("object")
    if isinstance(table, dict):
        for key in _TOP_KEYS:
            if key in table and key not in meta:
                meta[key] = table.pop(key)
    return meta


def read_gripper(
    path: Path, *, on_cut: Callable[[int], None] | None = None
) -> dict[str, np.ndarray]:
    """Read gripper.csv: time [T], gripper_position [T, G, 3], and gripper_axis [T, G, 3] and
    gripper_closed bool [T, G] if present.

    Args:
        path: The file.
        on_cut: Called with the number of the last line if it is incomplete because the recording
            was interrupted. The line is then skipped; None: an incomplete line is an error.

    Raises:
        RecordingError: The file cannot be read, or a row is malformed.
    """
    header, table, lines = read_number_table(
        path,
        header="time,x,y,z",
        check_header=lambda names: _gripper_columns(names, path),
        on_cut=on_cut,
    )
    position, axis, closed = _gripper_columns(header, path)
    fix = "give 1 where the gripper is closed, 0 where it is open"
    for j in closed:
        wrong = np.flatnonzero(~np.isin(table[:, j], (0.0, 1.0)))
        for i in wrong:
            where = f"{path}, line {lines[i]}, column {header[j]}"
            raise RecordingError(f"is '{table[i, j]:g}'", where=where, fix=fix)
    arrays = {
        "time": table[:, header.index("time")],
        "gripper_position": table[:, position].reshape(len(table), -1, 3),
    }
    if axis:
        arrays["gripper_axis"] = table[:, axis].reshape(len(table), -1, 3)
    if closed:
        arrays["gripper_closed"] = table[:, closed] == 1.0
    return arrays


def _gripper_columns(header: list[str], path: Path) -> tuple[list[int], list[int], list[int]]:
    """Columns of the positions, of the axes and of the states, gripper after gripper."""
    count = 0
    while f"x{count}" in header:
        count += 1
    tails = [str(g) for g in range(count)] or [""]
    position = [f"{axis}{tail}" for tail in tails for axis in "xyz"]
    axes = [f"a{axis}{tail}" for tail in tails for axis in "xyz"]
    closed = [f"closed{tail}" for tail in tails]
    axes, closed = (names if set(names) & set(header) else [] for names in (axes, closed))
    expected = ["time", *position, *axes, *closed]
    missing = [name for name in expected if name not in header]
    unknown = [name for name in header if name not in expected]
    twice = sorted({name for name in header if header.count(name) > 1})
    fix = "use time,x,y,z[,ax,ay,az][,closed], or time,x0,y0,z0,x1,... for several grippers"
    for names, verb in ((missing, "lacks"), (unknown, "has unknown"), (twice, "repeats")):
        what = f"the header {verb} {', '.join(map(repr, names))}"
        require(not names, what, where=str(path), fix=fix, error=RecordingError)
    found = [[header.index(name) for name in names] for names in (position, axes, closed)]
    return found[0], found[1], found[2]
