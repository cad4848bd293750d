"""NumPy files: point clouds, recordings, and shapes at rest. Pickles are never loaded.

A shape at rest is a rope or wire that hangs between two clamps, `gendom-static/1`:

    loops   float [K, n, 3]   K repeats of the same shape: points along it, evenly spaced [m], z up
    meta    JSON text         object: kind ("rope" or "wire"), length [m], mass_per_length [kg/m],
                              optional diameter [m]; source, notes, and anything else

Position and direction of the clamped ends are those of the first and last segment.
"""

from __future__ import annotations

import os
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np

from gendom.datasets.clouds import seen
from gendom.datasets.recording_form import FORMAT, STORED_ARRAYS
from gendom.errors import RecordingError
from gendom.reading import LARGEST_JSON, check_unpacked, file_size, parse_json, record_of, wanted

FORMAT_STATIC = "gendom-static/1"

NAMES = ("points", "xyz")
"""Names of the cloud's array in files with several arrays."""

LARGEST_ARRAYS = 1 << 31
"""Of a recording's file [bytes]."""

_END = 1 << 17  # bytes in which a zip file's index, and the record of its end, are looked for

# what NumPy raises for a damaged zip file or array header
_LOAD_ERRORS = (OSError, EOFError, ValueError, KeyError, RuntimeError, MemoryError, SyntaxError)
_LOAD_ERRORS += (struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error)


def _arrays(
    path: Path, choose: Callable[[list[str]], list[str]], *, write: str
) -> dict[str, np.ndarray]:
    """Arrays of an .npz file, those that a function chooses of all names; `write` says how one is
    written.

    Raises:
        RecordingError: The file is missing, damaged or none; or what `choose` raises.
    """
    where = str(path)
    size = file_size(path, RecordingError, most=LARGEST_ARRAYS)
    try:
        with open(path, "rb") as file:
            wanted(file.read(2) == b"PK", "is no .npz file", where, write)
            _check_archive(file, size, where)
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                found = {name: archive[name] for name in choose(archive.files)}
    except _LOAD_ERRORS as error:
        if isinstance(error, OSError) and error.strerror:
            what, fix = f"cannot be read ({error.strerror})", "check the file"
        elif "allow_pickle" in str(error):
            what = "holds Python objects (pickles), which are never loaded"
            fix = "write its arrays as numbers and meta as JSON text"
        else:
            what, fix = f"is damaged ({short(error)})", "copy or write it again"
        raise RecordingError(what, where=where, fix=fix) from None
    for name, array in found.items():
        wanted(isinstance(array, np.ndarray), f"{name} is no array", where, write)
    return found


def _check_archive(file: BinaryIO, size: int, where: str) -> None:
    """Refuse a zip file of too many members or two of one name, or that unpacks to far more."""
    file.seek(max(0, size - _END))
    end = file.read()
    place = end.rfind(b"PK\5\6")
    index = struct.unpack_from("<I", end, place + 12)[0] if place >= 0 else 0
    wanted(index <= _END, f"has an index of {index} bytes", where, "write it with numpy.savez")
    with zipfile.ZipFile(file) as archive:
        members = archive.infolist()
    names = [member.filename for member in members]
    twice = next((name for name in names if names.count(name) > 1), None)
    wanted(twice is None, f"has {twice} twice", where, "write it with numpy.savez")
    whole = sum(member.file_size for member in members)
    check_unpacked(whole, size, where, RecordingError)


def read_npz_cloud(path: str | os.PathLike) -> np.ndarray:
    """Read the cloud of a NumPy .npz file: its array `points` or `xyz`, or its only array.

    Returns:
        [n, 3] positions in the file's unit, float32 or float64 as stored (others become float64).
        n may be 0.

    Raises:
        RecordingError: The file is missing or damaged, or has no such array.
    """

    def choose(names: list[str]) -> list[str]:
        known = [name for name in NAMES if name in names] or names
        right = len(names) == 1 or (known and known[0] in NAMES)
        wanted(right, f"has the arrays {', '.join(names)}", path, "call the cloud 'points'")
        return known[:1]

    ((name, points),) = _arrays(Path(path), choose, write="write it with numpy.savez").items()
    if points.shape[2:] == (3,):  # organised, pixel by pixel
        points = points.reshape(-1, 3)
    right = points.ndim == 2 and points.shape[1] == 3 and points.dtype.kind in "fiu"
    what = f"{name} is {points.dtype} {list(points.shape)}"
    wanted(right, what, path, "give numbers [n, 3] in metres")
    return seen(points)


def read_npz(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any], list[str]]:
    """Read the arrays of a recording, or of a shape at rest as one, the parsed `meta`, and names of
    arrays that are not read."""
    known, others = (*STORED_ARRAYS, "loops", "meta"), []

    def choose(names: list[str]) -> list[str]:
        others.extend(name for name in names if name not in known)
        return [name for name in known if name in names]

    stored = _arrays(path, choose, write=f"write {FORMAT} with numpy.savez")
    meta, where = stored.pop("meta", np.zeros(0)), f"{path}: meta"
    is_text = meta.size == 1 and meta.dtype.kind in "US" and meta.nbytes <= 4 * LARGEST_JSON
    fix = "gendom.Recording.from_frames(...).write makes a recording (docs/recordings.md)"
    wanted(is_text, "is missing, or no JSON text", where, fix)
    meta = parse_json(meta.item(), where, RecordingError)
    if (form := meta.get("format")) == FORMAT_STATIC:
        return *_recording_of_static(stored, meta, str(path)), others
    wanted(form == FORMAT, f"is {form!r}", f"{where}.format", f"only {FORMAT!r} can be read here")
    return stored, meta, others


@dataclass(frozen=True, kw_only=True)
class _Wire:
    """The object of a shape at rest."""

    kind: Literal["rope", "wire"]
    length: float
    mass_per_length: float


def _recording_of_static(
    arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any], where: str
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Convert a shape at rest, by the arrays and meta of its file, to those of a recording.

    Each repeat becomes a frame, one second after the previous one. Points are ordered markers, two
    grippers hold the ends, and `static` in the meta marks the recording as motionless.

    Raises:
        RecordingError: Something is missing or not a number.
    """
    loops, fix = arrays.get("loops", np.zeros(0)), "give [K, n, 3]: K repeats of 5 points or more"
    right = loops.ndim == 3 and loops.shape[1] >= 5 and loops.shape[2] == 3
    right = right and loops.dtype.kind in "fiu" and np.isfinite(loops).all()
    what = f"has shape {list(loops.shape)}, or numbers that are not finite"
    wanted(right, what, f"{where}: loops", fix)
    of, fix = f"{where}: object", "give kind, length [m] and mass_per_length [kg/m]"
    wire = record_of(_Wire, meta.get("object"), where=of, fix=fix, error=RecordingError)
    for name in ("length", "mass_per_length"):
        value = getattr(wire, name)
        wanted(0.0 < value < np.inf, f"is {value}", f"{of}.{name}", "give a number above 0, in SI")
    described = {**meta["object"], "kind": "rope", "grasp": "both ends"}
    described["mass"] = wire.length * wire.mass_per_length
    loops = loops.astype(float)
    # the clamped ends are at their mean position over all repeats
    ends = loops[:, [0, -1]].mean(axis=0)
    axes = (loops[:, [1, -2]] - loops[:, [0, -1]]).mean(axis=0)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    K, n = loops.shape[:2]
    made = {
        "points": loops.reshape(-1, 3).astype(np.float32),
        "offsets": np.arange(K + 1) * n,
        "time": np.arange(K, dtype=float),
        "gripper_position": np.tile(ends, (K, 1, 1)),
        "gripper_axis": np.tile(axes, (K, 1, 1)),
    }
    usual = {"table_height": None, "gripper_source": "measured", "quasi_static": True}
    marked = {"ordered_markers": True, "static": True}
    return made, {**usual, **marked, **meta, "format": FORMAT, "object": described}


def short(error: BaseException) -> str:
    """The first line of an error's text."""
    return (str(error) or type(error).__name__).splitlines()[0][:120]
