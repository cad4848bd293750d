"""Recordings of cameras and robot as folders of PNG pictures.

    DIR/
      object.toml            what is held, as in a folder of PLY clouds
      gripper.csv            the robot's path: time,x,y,z[,ax,ay,az][,closed], at times of its own
      joints.csv             optional: the robot's joint angles, see `gendom.robot`
      capsules.csv           optional: shape of the robot, or of what else is in the way
      cameras/NAME/
        camera.toml          see `gendom.perception.camera`
        frames.csv           time,depth[,colour]: seconds, and files relative to this folder
        depth/*.png          16 bit grey, counts of depth_unit along the optical axis, 0: none
        colour/*.png         8 bit, of the depth's size and aligned with it

Instead of frames.csv and pictures a camera may have a RealSense recording; then its camera.toml
holds the pose only (`gendom.perception.realsense`).

All times are seconds of one clock. Each frame is read separately when it is used, so a damaged or
missing frame does not affect others.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from gendom.datasets import Fault
from gendom.datasets.folder import read_gripper, read_object
from gendom.errors import RecordingError
from gendom.perception.camera import Camera, read_camera, write_camera
from gendom.perception.frames import Frame, FrameSource, Pictures
from gendom.perception.png import read_png
from gendom.perception.realsense import RealSenseRecording, find_recording
from gendom.perception.robot import CapsulePath, cut_off, read_shape

_HEADER = "time,depth,colour"
_ROUNDING = 1e-6  # [s]; files of different formats round the same time differently


@dataclass(frozen=True, eq=False)
class RobotPath:
    """Path of the grippers, on the cameras' clock."""

    time: npt.NDArray[np.float64]
    """[M] [s]."""
    position: npt.NDArray[np.float64]
    """[M, G, 3] [m]."""
    axis: npt.NDArray[np.float64] | None = None
    """[M, G, 3] unit vectors along the object at the clamp; None: unknown."""
    closed: npt.NDArray[np.bool_] | None = None
    """[M, G] whether each gripper holds the object; None: all do, always."""

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray | None] | None:
        """Position [G, 3] [m] and axis [G, 3] at a time, linear between rows.

        None outside of the path's times.
        """
        if not self.time[0] - _ROUNDING <= time <= self.time[-1] + _ROUNDING:
            return None
        k = int(np.clip(np.searchsorted(self.time, time, side="right"), 1, len(self.time) - 1))
        k = min(k, len(self.time) - 1)
        before = max(k - 1, 0)
        step = self.time[k] - self.time[before]
        w = 0.0 if step == 0.0 else (time - self.time[before]) / step
        position = (1.0 - w) * self.position[before] + w * self.position[k]
        if self.axis is None:
            return position, None
        axis = (1.0 - w) * self.axis[before] + w * self.axis[k]
        return position, axis / np.linalg.norm(axis, axis=-1, keepdims=True)

    def closed_at(self, time: float) -> npt.NDArray[np.bool_] | None:
        """Whether each gripper is closed at a time [s], [G]: the value of the last row at or before
        it, or of the first row. None: unknown."""
        if self.closed is None:
            return None
        row = int(np.searchsorted(self.time, time + _ROUNDING, side="right")) - 1
        return self.closed[max(row, 0)]


@dataclass(frozen=True, eq=False)
class Sighting:
    """The input of perception: cameras, the robot's path and the object."""

    sources: list[FrameSource]
    robot: RobotPath
    meta: dict[str, Any]
    """The content of object.toml, in the layout of a recording's meta."""
    capsules: CapsulePath | None = None
    """The robot's shape; None: unknown."""
    where: str = ""
    """What messages call it."""


class PngCamera:
    """One camera's folder of PNG pictures, as a `FrameSource`.

    Args:
        folder: It holds camera.toml, frames.csv and the pictures.
        on_warning: Called with a fault for rows of frames.csv that cannot be used.

    Raises:
        RecordingError: camera.toml or frames.csv is missing or holds nothing usable.
    """

    def __init__(
        self, folder: str | os.PathLike, *, on_warning: Callable[[Fault], None] = lambda _: None
    ):
        self._folder = Path(folder)
        self.camera: Camera = read_camera(self._folder / "camera.toml")
        self._rows = _read_frames(self._folder / "frames.csv", on_warning)

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[Frame]:
        for time, depth, colour in self._rows:
            where = str(self._folder / depth)
            yield Frame(time, where, lambda d=depth, c=colour: self._read(d, c))

    def _read(self, depth: str, colour: str | None) -> Pictures:
        path = self._folder / depth
        picture = read_png(path)
        if not picture.mode.startswith("I"):
            raise RecordingError(
                f"is a PNG of mode {picture.mode}, not 16 bit grey",
                where=str(path),
                fix="store depth as 16 bit counts of depth_unit",
            )
        counts = self._sized(np.asarray(picture), path).astype(np.uint16, copy=False)
        if colour is None:
            return Pictures(counts)
        path = self._folder / colour
        return Pictures(counts, self._sized(np.asarray(read_png(path).convert("RGB")), path))

    def _sized(self, array: np.ndarray, path: Path) -> np.ndarray:
        height, width = self.camera.height, self.camera.width
        if array.shape[:2] != (height, width):
            raise RecordingError(
                f"is {array.shape[1]} x {array.shape[0]}, camera.toml says {width} x {height}",
                where=str(path),
                fix="give the intrinsics of these pictures, colour aligned with depth",
            )
        return array


class PngWriter:
    """Writes one camera's folder, to be read by `PngCamera`.

    Each picture is on disk before its row is in frames.csv, so what an interrupted recording
    leaves can be read.

    Args:
        folder: Made if missing.
        camera: Written as camera.toml.

    Raises:
        GendomError: The folder cannot be written.
    """

    def __init__(self, folder: str | os.PathLike, camera: Camera):
        self._folder = Path(folder)
        self._count = 0
        write_camera(self._folder / "camera.toml", camera)
        for name in ("depth", "colour"):
            (self._folder / name).mkdir(exist_ok=True)
        (self._folder / "frames.csv").write_text(_HEADER + "\n", encoding="utf-8")

    def __enter__(self) -> PngWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Nothing is left to write; other writers have more to do."""

    def write(self, time: float, pictures: Pictures) -> None:
        """Append a frame; `time` [s] is later than the one before."""
        name = f"{self._count:06d}.png"
        files = {"depth": pictures.depth, "colour": pictures.colour}
        row = [repr(float(time))]
        for kind, array in files.items():
            row.append("" if array is None else f"{kind}/{name}")
            if array is not None:
                Image.fromarray(array).save(self._folder / kind / name, compress_level=1)
        with open(self._folder / "frames.csv", "a", encoding="utf-8") as file:
            file.write(",".join(row) + "\n")
        self._count += 1


def read_sighting(
    folder: str | os.PathLike,
    *,
    cameras: Sequence[str] = (),
    on_warning: Callable[[Fault], None] = lambda _: None,
) -> Sighting:
    """Read a folder of the layout above; pictures are read later, one by one.

    Args:
        folder: DIR.
        cameras: Names of those to use; by default all, in order of their names.
        on_warning: Called with every fault that does not prevent use.

    Raises:
        RecordingError: A part is missing or cannot be used.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise RecordingError("no such folder", where=str(folder), fix="check the path")
    place = folder / "cameras"
    found = sorted(p.name for p in place.iterdir() if p.is_dir()) if place.is_dir() else []
    if not found:
        raise RecordingError(
            "holds no camera",
            where=str(place),
            fix="give each a folder with camera.toml and frames.csv or a RealSense recording",
        )
    if unknown := [name for name in cameras if name not in found]:
        raise RecordingError(
            f"there is no camera {unknown[0]!r}", where=str(place), fix=f"have {', '.join(found)}"
        )
    meta = read_object(folder / "object.toml")
    path = folder / "gripper.csv"
    arrays = read_gripper(path, on_cut=lambda line: on_warning(cut_off(path, line)))
    time = arrays["time"]
    if not np.isfinite(time).all() or (np.diff(time) <= 0).any():
        raise RecordingError(
            "its times do not increase",
            where=str(path),
            fix="give the robot's path in order of time",
        )
    return Sighting(
        sources=[_open_camera(place / name, on_warning) for name in cameras or found],
        robot=RobotPath(
            time,
            arrays["gripper_position"],
            arrays.get("gripper_axis"),
            arrays.get("gripper_closed"),
        ),
        meta=meta,
        capsules=read_shape(folder, meta, (time[0], time[-1]), on_warning=on_warning),
        where=str(folder),
    )


def _open_camera(folder: Path, on_warning: Callable[[Fault], None]) -> FrameSource:
    """A camera's folder of either kind."""
    recording = find_recording(folder)
    if recording is None:
        return PngCamera(folder, on_warning=on_warning)
    if (folder / "frames.csv").exists():
        raise RecordingError(
            f"holds frames.csv and {recording.name}",
            where=str(folder),
            fix="leave one of them in the camera's folder",
        )
    return RealSenseRecording(recording, on_warning=on_warning)


def _read_frames(
    path: Path, on_warning: Callable[[Fault], None]
) -> list[tuple[float, str, str | None]]:
    """Rows (time [s], depth file, colour file or None) of frames.csv."""
    try:
        with open(path, newline="", encoding="utf-8-sig", errors="replace") as file:
            lines = [row for row in csv.reader(file) if row]
    except FileNotFoundError:
        raise RecordingError(
            "no such file", where=str(path), fix=f"write one row a frame under {_HEADER}"
        ) from None
    except (OSError, csv.Error) as error:
        raise RecordingError(
            f"cannot be read ({error})", where=str(path), fix="save it as CSV"
        ) from None
    header = [name.strip() for name in lines[0]] if lines else []
    if not {"time", "depth"} <= set(header) <= {"time", "depth", "colour"}:
        raise RecordingError(
            f"has the header {','.join(header)!r}", where=str(path), fix=f"write {_HEADER}"
        )
    rows, bad = [], []
    for number, line in enumerate(lines[1:], start=2):
        entry = dict(zip(header, (text.strip() for text in line), strict=False))
        try:
            time = float(entry["time"])
            if len(line) != len(header) or not np.isfinite(time) or not entry["depth"]:
                raise ValueError
            if rows and time <= rows[-1][0]:
                raise ValueError
        except (ValueError, KeyError):
            bad.append(number)
            continue
        rows.append((time, entry["depth"], entry.get("colour") or None))
    if not rows:
        raise RecordingError(
            "holds no usable row", where=str(path), fix=f"write one row a frame under {_HEADER}"
        )
    if bad:
        on_warning(
            Fault(
                f"{len(bad)} of {len(lines) - 1} rows are cut short, no numbers or go back in "
                f"time, first in line {bad[0]}; they are left out",
                str(path),
                "record again if too much is missing",
                "warning",
            )
        )
    return rows
