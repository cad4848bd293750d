"""A recording as a folder: one file a frame, gripper.csv, object.toml.

0000.ply, ...   or .pcd, or .npz: one cloud a frame, in natural order of names (2 before 10)
gripper.csv     one row a frame: time,x,y,z[,ax,ay,az][,closed]
object.toml     description of the object, and table_height
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gendom.datasets.npz import read_npz_cloud
from gendom.datasets.pcd import read_pcd
from gendom.datasets.ply import read_ply
from gendom.errors import RecordingError
from gendom.files import is_cut, read_toml

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
) -> tuple[list[np.ndarray], dict[str, np.ndarray], dict[str, Any]]:
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
        clouds (T arrays [n, 3]), arrays (time [T], gripper_position [T, G, 3], perhaps
        gripper_axis [T, G, 3] and gripper_closed [T, G]) and the content of object.toml in the
        layout of a recording's `meta`.

    Raises:
        RecordingError: Something is missing, malformed or does not fit together.
    """
    folder = Path(folder)
    suffix, files = _cloud_files(folder)
    meta = read_object(folder / "object.toml")
    arrays = read_gripper(folder / "gripper.csv")
    rows = len(arrays["time"])
    if rows != len(files):
        raise RecordingError(
            f"{len(files)} {suffix} files but {rows} rows in gripper.csv",
            where=str(folder),
            fix="give one row a frame",
        )
    return [READERS[suffix](path) for path in files], arrays, meta


def _cloud_files(folder: Path) -> tuple[str, list[Path]]:
    """Suffix of a folder's clouds, and their files in order."""
    by_suffix: dict[str, list[Path]] = {}
    for path in folder.iterdir():
        suffix = path.suffix.lower()
        if suffix in READERS and not path.name.startswith("."):
            by_suffix.setdefault(suffix, []).append(path)
    if len(by_suffix) > 1:
        by_suffix.pop(".npz", None)
    if not by_suffix:
        raise RecordingError(
            f"holds no {', '.join(READERS)} file",
            where=str(folder),
            fix="put one point cloud a frame there",
        )
    if len(by_suffix) > 1:
        counts = " and ".join(f"{len(paths)} {suffix}" for suffix, paths in by_suffix.items())
        raise RecordingError(
            f"holds {counts} files", where=str(folder), fix="keep those of one kind"
        )
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
    meta = read_toml(
        path,
        fix="write one with the table [object]: kind, sizes in metres, grasp",
        error=RecordingError,
    )
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
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            lines = [(reader.line_num, row) for row in reader if row]
            file.seek(0)
            whole = file.read().endswith(("\n", "\r"))
    except FileNotFoundError:
        raise RecordingError(
            "no such file", where=str(path), fix="write one row a frame under time,x,y,z"
        ) from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"is not CSV ({error})", where=str(path), fix="save as CSV") from None
    if not lines:
        raise RecordingError("is empty", where=str(path), fix="write the header time,x,y,z")
    if len(lines) == 1:
        raise RecordingError(
            "holds a header and no rows", where=str(path), fix="write one row a frame"
        )
    header = [name.strip() for name in lines[0][1]]
    position, axis, closed = _gripper_columns(header, path)
    number, last = lines[-1]
    if on_cut is not None and not whole and len(lines) > 2 and is_cut(last, len(header)):
        on_cut(number)
        del lines[-1]
    table = np.empty((len(lines) - 1, len(header)))
    for i, (number, row) in enumerate(lines[1:]):
        if len(row) != len(header):
            raise RecordingError(
                f"{len(row)} values under {len(header)} column names",
                where=f"{path}, line {number}",
                fix="give one value a column",
            )
        for j, text in enumerate(row):
            try:
                table[i, j] = float(text)
            except ValueError:
                raise RecordingError(
                    f"{text!r} is no number",
                    where=f"{path}, line {number}, column {header[j]}",
                    fix="give seconds and metres",
                ) from None
            if j in closed and table[i, j] not in (0.0, 1.0):
                raise RecordingError(
                    f"is {text!r}",
                    where=f"{path}, line {number}, column {header[j]}",
                    fix="give 1 where the gripper is closed, 0 where it is open",
                )
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
    for names, verb in ((missing, "lacks"), (unknown, "has unknown"), (twice, "repeats")):
        if names:
            raise RecordingError(
                f"the header {verb} {', '.join(map(repr, names))}",
                where=str(path),
                fix="use time,x,y,z[,ax,ay,az][,closed], or time,x0,y0,z0,x1,... for several "
                "grippers",
            )
    return (
        [header.index(n) for n in position],
        [header.index(n) for n in axes],
        [header.index(n) for n in closed],
    )
