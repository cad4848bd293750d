"""Point clouds as NumPy files."""

from __future__ import annotations

import os
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

from gendom.errors import RecordingError

NAMES = ("points", "xyz")
"""Names of the cloud's array in files with several arrays."""

LOAD_ERRORS = (
    OSError,
    EOFError,
    ValueError,
    KeyError,
    RuntimeError,
    MemoryError,
    SyntaxError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
"""Exceptions that NumPy raises for a damaged zip file or array header."""


def read_npz_cloud(path: str | os.PathLike) -> np.ndarray:
    """Read the cloud of a NumPy .npz file: its array `points` or `xyz`, or its only array.

    Returns:
        [n, 3] positions in the file's unit, float32 or float64 as stored (others become float64).
        n may be 0.

    Raises:
        RecordingError: The file is missing or damaged, or has no such array.
    """
    path = Path(path)

    def fault(what: str, fix: str) -> RecordingError:
        return RecordingError(what, where=str(path), fix=fix)

    try:
        with open(path, "rb") as file:
            if file.read(2) != b"PK":
                raise fault("is no .npz file", "write it with numpy.savez")
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                names = list(archive.files)
                name = next((n for n in (*NAMES, *names[:1]) if n in names), None)
                if name is None or (name not in NAMES and len(names) > 1):
                    raise fault(f"has the arrays {', '.join(names)}", "call the cloud 'points'")
                points = archive[name]
    except FileNotFoundError:
        raise fault("no such file", "check the path") from None
    except LOAD_ERRORS as error:
        said = (str(error) or type(error).__name__).splitlines()[0][:120]
        raise fault(f"is damaged ({said})", "copy or write it again") from None
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise fault(
            f"{name} is {points.dtype} {list(points.shape)}", "give numbers [n, 3] in metres"
        )
    return points if points.dtype in (np.float32, np.float64) else points.astype(np.float64)
