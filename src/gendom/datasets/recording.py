"""Recording of one demonstration: clouds, gripper motion and the object's description.

On disk it is `gendom-recording/1`, a NumPy `.npz` without pickles:

    points            float32 [S, 3]     all frames' points [m], world frame, z up
    offsets           int64   [T + 1]    frame t is points[offsets[t]:offsets[t + 1]]
    time              float64 [T]        [s]
    gripper_position  float64 [T, G, 3]  where each gripper holds the object [m]
    gripper_axis      float64 [T, G, 3]  optional: unit vector along the object at the clamp
    gripper_closed    bool    [T, G]     optional: whether it holds the object; always if left out
    meta              JSON text          object, table_height, gripper_source, quasi_static,
                                         source, notes, camera_positions, cameras_calibrated,
                                         and anything else
"""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gendom.datasets.checks import NEEDED_SIZES, SIZES, Fault, check
from gendom.datasets.folder import read_folder
from gendom.datasets.recording_form import (
    ARRAYS,
    FORMAT,
    STORED_ARRAYS,
    ObjectDescription,
    convert,
    missing_keys,
    parse_meta,
    read_npz,
)
from gendom.errors import GendomError, RecordingError
from gendom.files import atomic_path, to_json
from gendom.shown import Shown

_log = logging.getLogger(__name__)

_BAGS = (".bag", ".db3", ".mcap")


@dataclass(frozen=True, kw_only=True, repr=False)
class Recording(Shown):
    """T frames of a point cloud, with the motion of G grippers that hold the object.

    World frame, z up, metres and seconds. Arrays are converted to the types below and are
    read-only; take `.copy()` to change one.

    Raises:
        RecordingError: An array has the wrong shape or type, or `offsets` does not divide
            `points`. The values are checked by `validate`, not here.
    """

    points: np.ndarray
    """[S, 3] float32: all frames' points, one after another [m]."""
    offsets: np.ndarray
    """[T + 1] int64: frame t is points[offsets[t]:offsets[t + 1]]."""
    time: np.ndarray
    """[T] float64: strictly increasing [s]."""
    gripper_position: np.ndarray
    """[T, G, 3] float64: where each gripper holds the object [m]."""
    gripper_axis: np.ndarray | None = None
    """[T, G, 3] float64: unit vector along the object at the clamp; None: unknown."""
    gripper_closed: np.ndarray | None = None
    """[T, G] bool: whether each gripper holds the object; None: all do, always."""
    object: ObjectDescription
    table_height: float | None = None
    """z of the table [m]; None: no table."""
    gripper_source: str = "commanded"
    """"commanded" or "measured"."""
    quasi_static: bool = False
    """True: inertia is negligible, and time may be rescaled."""
    camera_positions: np.ndarray | None = None
    """[K, 3] float64 [m]; None: unknown."""
    cameras_calibrated: bool = True
    """False: the transform between cameras and gripper is unknown, so points and
    `camera_positions` are in another frame than the gripper, upright to within a few degrees."""
    source: str = ""
    notes: str = ""
    extra: dict[str, Any] = field(default_factory=dict)
    """Other keys of the file's `meta`, kept and written back."""

    def __post_init__(self):
        arrays = {name: getattr(self, name) for name in ARRAYS}
        converted, faults = convert(arrays)
        if faults:
            raise RecordingError(faults=faults)
        for name, array in converted.items():
            object.__setattr__(self, name, array)

    @property
    def num_frames(self) -> int:
        """Number of frames, T."""
        return len(self.time)

    @property
    def num_grippers(self) -> int:
        """Number of grippers, G."""
        return self.gripper_position.shape[1]

    @property
    def holds(self) -> np.ndarray:
        """[T, G] bool: `gripper_closed`, all true where that is None."""
        if self.gripper_closed is None:
            return np.ones(self.gripper_position.shape[:2], dtype=bool)
        return self.gripper_closed

    @property
    def frame_valid(self) -> np.ndarray:
        """[T] bool: the frame has points."""
        return np.diff(self.offsets) > 0

    @property
    def begins_with(self) -> str:
        """SHA-256 of the first points; a recording and a longer one of the same motion share it."""
        first = self.frame(int(np.argmax(self.frame_valid)))
        return hashlib.sha256(np.ascontiguousarray(first, dtype="<f4").tobytes()).hexdigest()

    @property
    def digest(self) -> str:
        """SHA-256 of all data that an estimate depends on: all arrays, and `meta` without `source`,
        `notes` and `extra`. It does not depend on the file format."""
        found = hashlib.sha256()
        for name in STORED_ARRAYS:
            array = getattr(self, name)
            if array is not None:
                little = array.astype(array.dtype.newbyteorder("<"), copy=False)
                found.update(f"{name} {array.dtype.name} {array.shape}".encode())
                found.update(np.ascontiguousarray(little).tobytes())
        meta = self.meta()
        stated = {n: meta[n] for n in sorted(meta.keys() - {"source", "notes", *self.extra})}
        stated["object"] = asdict(replace(self.object, extra={}))
        found.update(to_json(stated).encode())
        return found.hexdigest()

    def frame(self, t: int) -> np.ndarray:
        """[n, 3] float32: the points of frame t [m]; a negative t counts from the end.

        Raises:
            IndexError: There is no such frame.
        """
        if not -self.num_frames <= t < self.num_frames:
            raise IndexError(f"frame {t} of a recording with {self.num_frames} frames")
        t %= self.num_frames
        return self.points[self.offsets[t] : self.offsets[t + 1]]

    def frames(self, which: Sequence[int] | range | None = None) -> list[np.ndarray]:
        """The points of the given frames, by default of all."""
        return [self.frame(t) for t in (range(self.num_frames) if which is None else which)]

    def head(self, n: int) -> Recording:
        """The first n frames.

        Raises:
            RecordingError: n is not in 1..T.
        """
        if not 1 <= n <= self.num_frames:
            raise RecordingError(
                f"cannot take the first {n} of {self.num_frames} frames",
                fix=f"choose 1 to {self.num_frames}",
            )
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        values["points"] = self.points[: self.offsets[n]]
        values["offsets"] = self.offsets[: n + 1]
        for name in ("time", "gripper_position", "gripper_axis", "gripper_closed"):
            if values[name] is not None:
                values[name] = values[name][:n]
        return Recording(**values)

    def moved(self, T: np.ndarray) -> Recording:
        """Return a copy with points and cameras moved by T [4, 4] [m], and unchanged grippers."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        for name in ("points", "camera_positions"):
            if values[name] is not None:
                values[name] = values[name] @ T[:3, :3].T + T[:3, 3]
        return Recording(**values)

    @classmethod
    def from_frames(
        cls,
        frames: Sequence[npt.ArrayLike],
        *,
        time: npt.ArrayLike,
        gripper_position: npt.ArrayLike,
        gripper_axis: npt.ArrayLike | None = None,
        gripper_closed: npt.ArrayLike | None = None,
        object: ObjectDescription,
        **other: Any,
    ) -> Recording:
        """Make a recording from one cloud for each frame.

        Args:
            frames: T arrays [n, 3] [m]; n may differ and may be 0.
            time: [T] [s].
            gripper_position: [T, G, 3], or [T, 3] for one gripper [m].
            gripper_axis: Like `gripper_position`, unit vectors; or None.
            gripper_closed: [T, G] bool, or [T] for one gripper; None: closed throughout.
            object: Description of the object.
            other: The remaining fields, by name.

        Raises:
            RecordingError: A cloud is not [n, 3], or the lengths do not fit together.
        """
        clouds = [np.asarray(cloud) for cloud in frames]
        for t, cloud in enumerate(clouds):
            if cloud.ndim != 2 or cloud.shape[1] != 3:
                raise RecordingError(
                    f"has shape {list(cloud.shape)}", where=f"frame {t}", fix="give [n, 3]"
                )
        position = np.asarray(gripper_position)
        axis = None if gripper_axis is None else np.asarray(gripper_axis)
        closed = None if gripper_closed is None else np.asarray(gripper_closed)
        return cls(
            points=np.concatenate([np.zeros((0, 3), np.float32), *clouds]),
            offsets=np.cumsum([0, *map(len, clouds)]),
            time=np.asarray(time),
            gripper_position=position[:, None] if position.ndim == 2 else position,
            gripper_axis=axis[:, None] if axis is not None and axis.ndim == 2 else axis,
            gripper_closed=closed[:, None] if closed is not None and closed.ndim == 1 else closed,
            object=object,
            **other,
        )

    @classmethod
    def read(
        cls, path: str | os.PathLike, *, on_warning: Callable[[Fault], None] | None = None
    ) -> Recording:
        """Read and validate a recording.

        Args:
            path: A `gendom-recording/1` file, a `gendom-static/1` file (see
                `gendom.datasets.static`), a folder of clouds (PLY, PCD, NPZ) with
                gripper.csv and object.toml (see `gendom.datasets.folder.read_folder`), or a
                LeRobot data set that `gendom export` made of a recording.
            on_warning: Called with every fault that does not prevent use; by default they are
                logged.

        Raises:
            RecordingError: The recording cannot be read or used; one line a fault.
        """
        path = Path(path)
        described = any((path / name).is_file() for name in ("gripper.csv", "meta/info.json"))
        if path.suffix in _BAGS or ((path / "metadata.yaml").is_file() and not described):
            raise RecordingError(
                "is a bag",
                where=str(path),
                fix="turn it into a recording: gendom import (ROS 2) or gendom perceive "
                "(RealSense)",
            )
        if path.is_dir() and (path / "meta/info.json").is_file():
            from gendom.datasets.lerobot import read_lerobot  # imported here: it needs pyarrow

            arrays, meta = read_lerobot(path)
            where, faults = str(path), missing_keys(meta)
        elif path.is_dir():
            clouds, arrays, meta = read_folder(path)
            arrays["points"] = np.concatenate([np.zeros((0, 3), np.float32), *clouds])
            arrays["offsets"] = np.cumsum([0, *map(len, clouds)])
            where, faults = str(path / "object.toml"), []
            if "table_height" not in meta:
                faults.append(
                    Fault(
                        "is not given, so there is no table",
                        "table_height",
                        "add table_height = z of the table in metres if there is one",
                        "warning",
                    )
                )
        else:
            arrays, meta = read_npz(path)
            where, faults = str(path), missing_keys(meta)
        values, meta_faults = parse_meta(meta)
        faults += meta_faults
        arrays["camera_positions"] = values.pop("camera_positions")
        converted, array_faults = convert(arrays)
        if errors := [f for f in [*array_faults, *faults] if f.severity == "error"]:
            raise RecordingError(where=str(path) if array_faults else where, faults=errors)
        recording = cls(**converted, **values)
        faults += recording.validate()
        if errors := [f for f in faults if f.severity == "error"]:
            raise RecordingError(where=str(path), faults=errors)
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
        check_name(path)
        arrays = {name: getattr(self, name) for name in STORED_ARRAYS}
        arrays = {name: array for name, array in arrays.items() if array is not None}
        try:
            meta = to_json(self.meta())
        except GendomError as error:
            raise RecordingError(
                error.what, where=f"{path}: meta.{error.where}", fix=error.fix
            ) from None
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(file, meta=np.array(meta), allow_pickle=False, **arrays)

    def meta(self) -> dict[str, Any]:
        """All fields except the arrays, in the form of the file."""
        sizes = NEEDED_SIZES.get(self.object.kind, ())
        optional = {"rope": ("diameter",), "cloth": ("thickness",)}.get(self.object.kind, ())
        shown = (*sizes, *optional, "mass")
        description = {"kind": self.object.kind}
        for name in SIZES:
            value = getattr(self.object, name)
            if name in shown or value is not None:
                description[name] = value
        meta = {
            "format": FORMAT,
            "object": {**description, "grasp": self.object.grasp, **self.object.extra},
            "table_height": self.table_height,
            "gripper_source": self.gripper_source,
            "quasi_static": self.quasi_static,
            "source": self.source,
            "notes": self.notes,
        }
        if self.camera_positions is not None:
            meta["camera_positions"] = self.camera_positions
        if not self.cameras_calibrated:
            meta["cameras_calibrated"] = False
        return {**meta, **{k: v for k, v in self.extra.items() if k not in meta}}

    def _shown(self) -> tuple[str, list[tuple[str, str]]]:
        counts, held = np.diff(self.offsets), self.object
        sizes = [f"{n} {v:.4g} m" for n in SIZES if n != "mass" and (v := getattr(held, n))]
        mass = [] if held.mass is None else [f"mass {held.mass:.4g} kg"]
        motion = "quasi-static" if self.quasi_static else "dynamic"
        table = "none" if self.table_height is None else f"at z = {self.table_height:.4g} m"
        return f"Recording ({held.kind}, {self.num_frames} frames)", [
            ("object", ", ".join([*sizes, *mass, f"held by: {held.grasp}"])),
            ("points", f"{counts.min()} to {counts.max()} a frame"),
            ("time", f"{self.time[0]:.4g} to {self.time[-1]:.4g} s, {motion}"),
            ("grippers", f"{self.num_grippers} ({self.gripper_source})"),
            ("table", table),
        ]

    def validate(self) -> list[Fault]:
        """Check the content and return all faults, errors before warnings."""
        return check(self)


def is_recording(path: str | os.PathLike) -> bool:
    """Whether a file or folder looks like a recording, complete or not."""
    path = Path(path)
    inside = ("object.toml", "gripper.csv", "meta/info.json")
    return path.is_file() or any((path / name).is_file() for name in inside)


def check_name(path: str | os.PathLike) -> None:
    """Check that a recording can be written under a name; call it before long computations.

    Raises:
        RecordingError: It does not end in .npz.
    """
    if (suffix := Path(path).suffix) != ".npz":
        raise RecordingError(
            f"has the suffix {suffix!r}", where=str(path), fix="name the file .npz"
        )
