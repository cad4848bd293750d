"""A recording as a folder: one file a frame, gripper.csv, object.toml."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from decimal import Decimal
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gendom.datasets.clouds import read_pcd, read_ply
from gendom.datasets.npz import read_npz_cloud
from gendom.datasets.recording_form import joined
from gendom.errors import RecordingError
from gendom.reading import read_number_table, read_toml, wanted

_PARTS = re.compile(r"(\d+)")
_DECIMAL = re.compile(r"((?:(?<![^\W_])-)?\d+(?:\.\d+)?(?:e[-+]\d{1,2}(?!\d))?)")
_SINCE_1970 = re.compile(r"(?<!\d)1\d{9}(?:\d{3}){0,3}(?!\d)")  # in s, ms, us or ns
_THOUSANDTHS = re.compile(r"\d\.\d{3}")

READERS: dict[str, Callable[[Path], np.ndarray]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".npz": read_npz_cloud,
}
"""Readers of clouds, by file suffix."""

BAGS = (".db3", ".mcap", ".bag")
"""Suffixes of ROS bags' files."""

# Keys of object.toml that belong beside the table [object]. TOML gives keys written below a
# table's head to that table, so they are also looked for there.
_TOP_KEYS = ("table_height", "gripper_source", "quasi_static", "robot", "camera_positions")
_TOP_KEYS += ("cameras_calibrated", "source", "notes")


def read_folder(folder: str | os.PathLike) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read the parts of a recording stored as a folder: clouds, one a frame, in order of the
    numbers in their names (see `in_order`), gripper.csv and object.toml (docs/data.md). .npz files
    beside .ply or .pcd files are not clouds, and are ignored.

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
    wanted(rows == len(files), what, folder, "give one row a frame")
    names = {path.stem: path for path in files}
    ordered = in_order(list(names), arrays["time"], where=str(folder))
    clouds = [READERS[suffix](names[name]) for name in ordered]
    return {**arrays, **joined(clouds)}, meta


def bag_files(path: str | os.PathLike) -> list[Path]:
    """What of a ROS bag is opened: a folder with metadata.yaml, or else the files of one kind in
    it, or the file itself; empty: it is no bag."""
    path = Path(path)
    if not path.is_dir():
        return [path] if path.suffix in BAGS else []
    if (path / "metadata.yaml").exists():
        return [path]
    return next(filter(None, (sorted(path.glob(f"*{suffix}")) for suffix in BAGS)), [])


def _cloud_files(folder: Path) -> tuple[str, list[Path]]:
    """Suffix of a folder's clouds, and their files in order."""
    by_suffix: dict[str, list[Path]] = {}
    others: dict[str, int] = {}
    for path in folder.iterdir():
        suffix = path.suffix.lower()
        if suffix in READERS and not path.name.startswith("."):
            by_suffix.setdefault(suffix, []).append(path)
        elif path.name not in ("gripper.csv", "object.toml"):
            suffix = "".join(path.suffixes[-2:]).lower()
            others[suffix] = others.get(suffix, 0) + 1
    if len(by_suffix) > 1:
        by_suffix.pop(".npz", None)
    fix = "put one point cloud a frame there, or depth pictures into cameras/NAME"
    most = max(others, key=lambda suffix: others[suffix], default="")
    if most and others[most] > 1:
        fix = f"make such files of its {others[most]} {most} files"
    wanted(by_suffix, f"holds no {', '.join(READERS)} file", folder, fix)
    counts = " and ".join(f"{len(paths)} {suffix}" for suffix, paths in by_suffix.items())
    wanted(len(by_suffix) == 1, f"holds {counts} files", folder, "keep those of one kind")
    ((suffix, files),) = by_suffix.items()
    return suffix, files


def in_order(names: list[str], time: np.ndarray, *, where: str) -> list[str]:
    """Names of frames in the order of their times.

    Numbers in names (without endings) are read as decimal ("-2" before "-1", "1.45" before "1.5")
    or part by part ("1.9" before "1.10"): where that gives two orders, by which the numbers grow as
    the times [T] of the frames do.

    Raises:
        RecordingError: Neither grows so, or names that are times are not those of the frames.
    """
    found = []
    for pattern in (_DECIMAL, _PARTS):
        ordered = sorted(names, key=lambda name: (_name_key(pattern, name), name))
        found.append((ordered, *_misfit(_numbers_of(pattern, ordered), time)))
    (decimal, as_times, evenly), (parts, _, counted) = found
    for one, other in pairwise(parts):
        alike = all(_name_key(of, one) == _name_key(of, other) for of in (_DECIMAL, _PARTS))
        fix = "number the clouds in order of time, each once"
        wanted(not alike, f"{one!r} and {other!r} are the same number", where, fix)
    step = float(np.median(np.diff(time))) if len(time) > 1 else np.inf
    if decimal != parts:
        what = "names can be put in two orders, and the times of gripper.csv fit neither"
        fix = "name the clouds 0000, 0001, ... in order of time"
        wanted(min(as_times, evenly, counted) <= step, what, where, fix)
        if counted < min(as_times, evenly):
            return parts
    check_named(decimal, time, where=where)
    return decimal


def check_named(names: list[str], time: np.ndarray, *, where: str) -> None:
    """Check names of frames in order: where most are times since 1970, they must be those of the
    frames [T], in any unit and from any start; where most have thousandths, they may also grow
    evenly, as counters do.

    Raises:
        RecordingError: They are not.
    """

    def most_have(pattern: re.Pattern[str]) -> bool:
        return 2 * sum(pattern.search(name) is not None for name in names) > len(names)

    since_1970 = most_have(_SINCE_1970)
    if not (since_1970 or most_have(_THOUSANDTHS)):
        return
    as_times, evenly = _misfit(_numbers_of(_DECIMAL, names), time)
    _, counted = _misfit(_numbers_of(_PARTS, names), time)
    off = as_times if since_1970 else min(as_times, evenly, counted)
    if np.isfinite(off) and off > float(np.median(np.diff(time))):
        what = f"times in names, as {names[0]!r}, are up to {off:.3g} s from those of the frames"
        fix = "give each frame the time of its row, or name them 0000, 0001, ..."
        raise RecordingError(what, where=where, fix=fix)


def _name_key(pattern: re.Pattern[str], name: str) -> list[tuple[int, Decimal, str]]:
    """Numbers as such, and what is between them regardless of capitals."""
    return [
        (0, Decimal(part), "") if k % 2 else (1, Decimal(0), part.casefold())
        for k, part in enumerate(pattern.split(name))
        if part
    ]


def _numbers_of(pattern: re.Pattern[str], names: list[str]) -> np.ndarray | None:
    """The number in which names differ, from the first one's [T]; None: they differ otherwise."""
    rows = [[Decimal(part) for part in pattern.findall(name)] for name in names]
    if len({len(row) for row in rows}) != 1:
        return None
    columns = [column for column in zip(*rows, strict=True) if len(set(column)) > 1]
    if len(columns) == 2 and pattern is _PARTS:  # seconds and nanoseconds
        columns = [[s + ns * Decimal("1e-9") for s, ns in zip(*columns, strict=True)]]
    if len(columns) != 1:
        return None
    return np.array([float(number - columns[0][0]) for number in columns[0]])


def _misfit(numbers: np.ndarray | None, time: np.ndarray) -> tuple[float, float]:
    """How far numbers [T] lie from times at most [s]: as times in the unit that fits best, and as
    what grows evenly with time."""
    if numbers is None or len(time) < 2 or not np.isfinite(time).all():
        return np.inf, np.inf
    since, last = time - time[0], numbers[-1]
    units = [numbers * unit for unit in (1.0, 1e-3, 1e-6, 1e-9)]
    off = [np.abs(of - since - np.median(of - since)).max() for of in units]
    even = np.abs(numbers / last * since[-1] - since).max() if last > 0 else np.inf
    return float(min(off)), float(even)


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
    gripper_closed bool [T, G] if present; `on_cut` as of `read_number_table`.

    Raises:
        RecordingError: The file cannot be read, or a row is malformed.
    """
    right = partial(_gripper_columns, path=path)
    header, table, lines = read_number_table(
        path, header="time,x,y,z", check_header=right, on_cut=on_cut
    )
    position, axis, closed = _gripper_columns(header, path)
    fix = "give 1 where the gripper is closed, 0 where it is open"
    for j in closed:
        for i in np.flatnonzero(~np.isin(table[:, j], (0.0, 1.0))):
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


def _gripper_columns(header: list[str], path: Path) -> tuple[list[int], ...]:
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
        wanted(not names, f"the header {verb} {', '.join(map(repr, names))}", path, fix)
    return tuple([header.index(name) for name in names] for names in (position, axes, closed))
