"""Files and folders that are either whole or absent, and JSON that every reader understands."""

import errno
import json
import math
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from datetime import date, time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.errors import GendomError

FILES = (".csv", ".gif", ".html", ".json", ".mp4", ".npz", ".onnx", ".parquet", ".toml", ".zip")
"""What no folder's name ends in."""

LEAST_ROOM = 1 << 22
"""Without which a disk counts as full [bytes]."""

FULL = (errno.ENOSPC, errno.EDQUOT)
"""Errors of a disk without room."""

_wanted = partial(require, error=GendomError)


@contextmanager
def atomic_path(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary path in the same folder that becomes `path` when the block succeeds.

    The block writes a file there. If it raises (Ctrl-C included) the temporary file is removed
    and an older `path` stays as it was. Missing folders are made. The temporary name keeps the
    suffix, for writers that choose a format by it.

    Raises:
        GendomError: `path` is a folder, or its folder cannot be made or written, or the disk is
            full.
    """
    path = Path(path)
    _wanted(not path.is_dir(), "is a folder", path, "name a file")
    with _beside(path) as temporary:
        yield temporary


@contextmanager
def atomic_folder(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary folder that becomes `path` when the block succeeds.

    If the block raises (Ctrl-C included) the temporary folder is removed with all that is in it.

    Raises:
        GendomError: `path` is there already, or its folder cannot be made or written, or the disk
            is full.
    """
    path = Path(path)
    _wanted(not path.exists(), "is there already", path, "name a new folder")
    with _beside(path) as temporary:
        temporary.mkdir()
        yield temporary


def check_folder(folder: str | os.PathLike) -> None:
    """Whether files can be written into a folder that need not exist yet; it is not made.

    Raises:
        GendomError: It is a file, lies below one or is named like one, or nothing can be written
            there.
    """
    folder = Path(folder)
    new_file = folder.suffix.lower() in FILES and not folder.exists()
    what = "is named like a file, and a folder is written"
    _wanted(not new_file, what, folder, "name a folder")
    _check_place(folder)


def check_file(path: str | os.PathLike, ending: str) -> None:
    """Whether a file can be written, whose name must have an ending; it is not made.

    Raises:
        GendomError: It ends otherwise or is a folder, or nothing can be written there.
    """
    path = Path(path)
    what = f"does not end in {ending}, which is what is written"
    _wanted(path.suffix.lower() == ending, what, path, f"name a file that ends in {ending}")
    _wanted(not path.is_dir(), "is a folder", path, "name a file")
    _check_place(path.parent)


def free_room(folder: str | os.PathLike) -> int:
    """Free space on the disk of a folder that need not exist yet [bytes]."""
    return shutil.disk_usage(_nearest(Path(folder))).free


def _nearest(path: Path) -> Path:
    """The path itself, or what is there above it."""
    path = path.absolute()
    return next(there for there in (path, *path.parents) if there.exists())


def _check_place(folder: Path) -> None:
    """Refuse a folder that cannot be made or written, by writing to the nearest that is there."""
    there = _nearest(folder)
    _wanted(there.is_dir(), "is a file, not a folder", there, "name a folder")
    try:
        with tempfile.TemporaryFile(dir=there) as probe:
            probe.write(bytes(LEAST_ROOM))
    except OSError as error:
        full = error.errno in FULL
        what = "the disk is full" if full else f"cannot be written ({error.strerror})"
        fix = "make room, or choose another place" if full else "choose another place"
        raise GendomError(what, where=str(there), fix=fix) from None


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """A temporary name in the folder of `path`, which is made if it is missing. What has that name
    becomes `path` if the block succeeds, once it is on the disk, and is removed if it does not."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        what = f"cannot make the folder ({error.strerror})"
        raise GendomError(what, where=str(path.parent), fix="choose another place") from error
    may, what = os.access(path.parent, os.W_OK), "no permission to write here"
    _wanted(may, what, path.parent, "choose another place")
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.tmp{path.suffix}")
    try:
        yield temporary
        for written in (temporary, *temporary.rglob("*")):
            if written.is_file():
                with open(written, "rb+") as file:
                    os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        if error.errno not in FULL:
            raise
        fix = "make room, and run the same command again"
        raise GendomError("the disk is full", where=str(path), fix=fix) from error
    finally:
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)


def to_json(value: Any) -> str:
    """`value` as indented JSON text.

    Besides what JSON knows, takes dataclasses, paths, dates and NumPy scalars and arrays.

    Raises:
        GendomError: A number is NaN or infinite (JSON has neither; the message names its
            place), or a value has no JSON form.
    """
    text = json.dumps(_plain(value, ""), indent=2, allow_nan=False, ensure_ascii=False)
    return text.encode("utf-8", "backslashreplace").decode()  # names that are not UTF-8


def write_json(path: str | os.PathLike, value: Mapping[str, Any]) -> None:
    """Write `value` to `path` as JSON, atomically.

    Raises:
        GendomError: As `to_json` and `atomic_path`.
    """
    try:
        text = to_json(value)
    except GendomError as error:
        raise GendomError(error.what, where=f"{path}: {error.where}", fix=error.fix) from None
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def _plain(value: Any, where: str) -> Any:
    """`value` made of dict, list, str, int, float, bool and None only."""
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            what, fix = f"is {value}, which JSON cannot hold", "store null where none is known"
            raise GendomError(what, where=where or "value", fix=fix)
        return float(value)
    if isinstance(value, Mapping):
        return {str(k): _plain(v, f"{where}.{k}" if where else str(k)) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v, f"{where}[{i}]") for i, v in enumerate(value)]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, (date, time)):  # of TOML
        return value.isoformat()
    if isinstance(value, (np.generic, np.ndarray)):
        return _plain(value.tolist(), where)
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value), where)
    what = f"is a {type(value).__name__}, which JSON cannot hold"
    raise GendomError(what, where=where or "value", fix="convert it first")
