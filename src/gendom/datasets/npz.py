"""NumPy files: point clouds, and recordings. Pickles are never loaded."""

from __future__ import annotations

import os
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np

from gendom.arguments import require
from gendom.datasets.clouds import seen
from gendom.datasets.recording_form import FORMAT, STORED_ARRAYS
from gendom.errors import RecordingError
from gendom.reading import LARGEST_JSON, check_unpacked, file_size, parse_json

NAMES = ("points", "xyz")
"""Names of the cloud's array in files with several arrays."""

LARGEST_ARRAYS = 1 << 31
"""Of a recording's file [bytes]."""

_END = 1 << 17  # bytes in which a zip file's index, and the record of its end, are looked for

# what NumPy raises for a damaged zip file or array header
_LOAD_ERRORS = (OSError, EOFError, ValueError, KeyError, RuntimeError, MemoryError, SyntaxError)
_LOAD_ERRORS += (struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error)

Taken = TypeVar("Taken")


def _from_npz(path: Path, take: Callable[[Any], Taken], *, write: str) -> Taken:
    """What a function takes from NumPy's archive of an .npz file; `write` says how one is written.

    Raises:
        RecordingError: The file is missing, damaged or none; or what `take` raises.
    """
    where = str(path)
    size = file_size(path, RecordingError, most=LARGEST_ARRAYS)
    try:
        with open(path, "rb") as file:
            is_zip = file.read(2) == b"PK"
            require(is_zip, "is no .npz file", where=where, fix=write, error=RecordingError)
            _check_archive(file, size, where)
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                return take(archive)
    except _LOAD_ERRORS as error:
        if isinstance(error, OSError) and error.strerror:
            what, fix = f"cannot be read ({error.strerror})", "check the file"
        elif "allow_pickle" in str(error):
            what = "holds Python objects (pickles), which are never loaded"
            fix = "write its arrays as numbers and meta as JSON text"
        else:
            what, fix = f"is damaged ({short(error)})", "copy or write it again"
        raise RecordingError(what, where=where, fix=fix) from None


def _check_archive(file: BinaryIO, size: int, where: str) -> None:
    """Refuse a zip file of too many members, or that unpacks to far more than it is."""
    file.seek(max(0, size - _END))
    end = file.read()
    place = end.rfind(b"PK\5\6")
    index = struct.unpack_from("<I", end, place + 12)[0] if place >= 0 else 0
    what, fix = f"has an index of {index} bytes", "write it with numpy.savez"
    require(index <= _END, what, where=where, fix=fix, error=RecordingError)
    with zipfile.ZipFile(file) as archive:
        whole = sum(member.file_size for member in archive.infolist())
    check_unpacked(whole, size, where, RecordingError)


def read_npz_cloud(path: str | os.PathLike) -> np.ndarray:
    """Read the cloud of a NumPy .npz file: its array `points` or `xyz`, or its only array.

    Returns:
        [n, 3] positions in the file's unit, float32 or float64 as stored (others become float64).
        n may be 0.

    Raises:
        RecordingError: The file is missing or damaged, or has no such array.
    """

    def take(archive: Any) -> tuple[str, np.ndarray]:
        names = list(archive.files)
        name = next((n for n in (*NAMES, *names[:1]) if n in names), None)
        if name is None or (name not in NAMES and len(names) > 1):
            what = f"has the arrays {', '.join(names)}"
            raise RecordingError(what, where=str(path), fix="call the cloud 'points'")
        return name, archive[name]

    name, points = _from_npz(Path(path), take, write="write it with numpy.savez")
    right = points.ndim == 2 and points.shape[1] == 3 and points.dtype.kind in "fiu"
    what, fix = f"{name} is {points.dtype} {list(points.shape)}", "give numbers [n, 3] in metres"
    require(right, what, where=str(path), fix=fix, error=RecordingError)
    return seen(points)


def read_npz(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read the arrays of a recording (or of a static one) and the parsed `meta`."""

    def take(archive: Any) -> dict[str, np.ndarray]:
        wanted = (*STORED_ARRAYS, "loops", "meta")
        return {name: archive[name] for name in wanted if name in archive.files}

    where, single = str(path), path.suffix.lower() in (".ply", ".pcd")
    fix = "give the folder that holds all frames"
    require(not single, "is a single cloud", where=where, fix=fix, error=RecordingError)
    stored = _from_npz(path, take, write=f"write {FORMAT} with numpy.savez")
    meta, where = stored.pop("meta", None), f"{path}: meta"
    if meta is None:
        fix = f"add JSON text with format = {FORMAT!r}"
        raise RecordingError("is missing", where=where, fix=fix)
    is_text = meta.size == 1 and meta.dtype.kind in "US" and meta.nbytes <= 4 * LARGEST_JSON
    what, fix = f"is not JSON text, but {meta.dtype} {list(meta.shape)}", "write it with json.dumps"
    require(is_text, what, where=where, fix=fix, error=RecordingError)
    return stored, parse_json(meta.item(), where, RecordingError)


def short(error: BaseException) -> str:
    """The first line of an error's text."""
    return (str(error) or type(error).__name__).splitlines()[0][:120]
