"""Recording of one demonstration: clouds, gripper motion and the object's description.

On disk it is `gendom-recording/1`, a NumPy `.npz` without pickles: the arrays of `RecordingData`
that are not None, but for `camera_positions`, and `meta`, JSON text with its other fields
(`object`, `table_height`, ...) and anything else.
"""

from __future__ import annotations

import logging
import os
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from gendom.arguments import require
from gendom.datasets.checks import check
from gendom.datasets.folder import bag_files, read_folder
from gendom.datasets.npz import read_npz
from gendom.datasets.recording_form import (
    STORED_ARRAYS,
    Fault,
    RecordingData,
    convert,
    missing_keys,
    parse_meta,
    unread_arrays,
)
from gendom.errors import GendomError, RecordingError
from gendom.files import atomic_path, to_json

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, repr=False)
class Recording(RecordingData):
    """T frames of a point cloud, with the motion of G grippers that hold the object.

    World frame, z up, metres and seconds. Arrays are converted to their types and are read-only;
    take `.copy()` to change one.

    Raises:
        RecordingError: An array has the wrong shape or type, or `offsets` does not divide
            `points`. The values are checked by `validate`, not here.
    """

    @classmethod
    def read(
        cls, path: str | os.PathLike, *, on_warning: Callable[[Fault], None] | None = None
    ) -> Self:
        """Read and validate a recording.

        Args:
            path: A `gendom-recording/1` file, a `gendom-static/1` file (see
                `gendom.datasets.npz`), a folder of clouds (PLY, PCD, NPZ) with
                gripper.csv and object.toml (see `gendom.datasets.folder.read_folder`), or a
                LeRobot data set that `gendom export` made of a recording.
            on_warning: Called with every fault that does not prevent use; by default they are
                logged.

        Raises:
            RecordingError: The recording cannot be read or used; one line a fault.
        """
        path = Path(path)
        arrays, meta, described_in, faults = _read_parts(path)
        values, meta_faults = parse_meta(meta)
        faults += meta_faults
        arrays["camera_positions"] = values.pop("camera_positions")
        converted, array_faults = convert(arrays)
        _refuse_errors([*array_faults, *faults], path if array_faults else described_in)
        recording = cls(**converted, **values)
        recording.require_valid(str(path), on_warning=faults.append)
        for fault in faults:
            if on_warning is not None:
                on_warning(fault)
            else:
                _log.warning("%s: %s", path, fault)
        return recording

    def write(self, path: str | os.PathLike) -> None:
        """Write a `gendom-recording/1` file, atomically; `path` ends in .npz.

        Raises:
            RecordingError: `path` has another suffix, or `extra` has no JSON form.
            GendomError: The place cannot be written.
        """
        path = Path(path)
        what, fix = f"has the suffix {path.suffix!r}", "name the file .npz"
        require(path.suffix == ".npz", what, where=str(path), fix=fix, error=RecordingError)
        arrays = {name: getattr(self, name) for name in STORED_ARRAYS}
        arrays = {name: array for name, array in arrays.items() if array is not None}
        try:
            meta = to_json(self.meta())
        except GendomError as error:
            where = f"{path}: meta.{error.where}"
            raise RecordingError(error.what, where=where, fix=error.fix) from None
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(file, meta=np.array(meta), allow_pickle=False, **arrays)

    @cached_property
    def _faults(self) -> list[Fault]:
        return check(self)

    def validate(self) -> list[Fault]:
        """Check the content and return all faults, errors before warnings."""
        return [*self._faults]

    def require_valid(self, where: str, *, on_warning: Callable[[Fault], None]) -> None:
        """Check the content and refuse errors; `on_warning` is called with every other fault.

        Raises:
            RecordingError: It cannot be used; one line a fault.
        """
        faults = self.validate()
        _refuse_errors(faults, where)
        for fault in faults:
            on_warning(fault)


def _read_parts(path: Path) -> tuple[dict[str, Any], dict[str, Any], str, list[Fault]]:
    """Arrays and meta of a recording in any form, what messages call the file of its meta, and
    faults of the names in it."""
    is_lerobot = (path / "meta/info.json").is_file()
    described = is_lerobot or (path / "gripper.csv").is_file()
    kinds = {
        "is a bag": bag_files(path) and not described,
        "holds depth pictures": (path / "cameras").is_dir(),
        "is no recording": path.is_file() and path.suffix.lower() not in (".npz", ""),
    }
    fix = f"gendom doctor {shlex.quote(str(path))} says what is in it and what makes a recording of"
    for what, is_so in kinds.items():
        require(not is_so, what, where=str(path), fix=f"{fix} it", error=RecordingError)
    if path.is_dir() and not is_lerobot:
        arrays, meta = read_folder(path)
        what, key = "is not given, so there is no table", "table_height"
        fix = "add table_height = z of the table in metres if there is one"
        faults = [] if key in meta else [Fault(what, key, fix, "warning")]
        return arrays, meta, str(path / "object.toml"), faults
    if is_lerobot:
        from gendom.datasets.lerobot import read_lerobot  # imported here: it needs pyarrow

        arrays, meta = read_lerobot(path)
        return arrays, meta, str(path), missing_keys(meta)
    arrays, meta, others = read_npz(path)
    return arrays, meta, str(path), [*missing_keys(meta), *unread_arrays(others)]


def _refuse_errors(faults: list[Fault], where: str | Path) -> None:
    if errors := [fault for fault in faults if fault.severity == "error"]:
        raise RecordingError(where=str(where), faults=errors)


def is_recording(path: str | os.PathLike) -> bool:
    """Whether a file or folder looks like a recording, complete or not."""
    path = Path(path)
    inside = ("object.toml", "gripper.csv", "meta/info.json")
    return path.is_file() or any((path / name).is_file() for name in inside)
