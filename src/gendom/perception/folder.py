"""Recordings of cameras and robot as folders (docs/perception.md, Input).

A camera's folder holds frames.csv and PNG pictures, or a RealSense recording; other packages add
kinds by entry points ``gendom.cameras`` (`gendom.perception.CameraReader`). All times are seconds
of one clock. Each frame is read separately when it is used, so a damaged or missing frame does not
affect others.
"""

import math
import os
import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from gendom.arrays import Array
from gendom.datasets import Fault
from gendom.datasets.folder import check_named, read_gripper, read_object
from gendom.perception.camera import Camera, expect
from gendom.perception.camera_file import read_camera, write_camera
from gendom.perception.frames import (
    CameraReader,
    Frame,
    FrameSource,
    Pictures,
    interpolate,
    read_png,
)
from gendom.perception.realsense import RealSenseRecording
from gendom.perception.robot import Capsules, cut_off, read_shape
from gendom.plugins import plugins
from gendom.reading import inside, number_of, read_rows
from gendom.robot import Arm

_HEADER = "time,depth,colour"
_ROUNDING = 1e-6  # [s]; files of different formats round the same time differently


@dataclass(frozen=True, eq=False)
class RobotPath:
    """Path of the grippers, on the cameras' clock."""

    time: Array
    """[M] [s]."""
    position: Array
    """[M, G, 3] [m]."""
    axis: Array | None = None
    """[M, G, 3] unit vectors along the object at the clamp; None: unknown."""
    closed: npt.NDArray[np.bool_] | None = None
    """[M, G] whether each gripper holds the object; None: all do, always."""

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray | None] | None:
        """Position [G, 3] [m] and axis [G, 3] at a time, linear between rows.

        None outside of the path's times.
        """
        if not self.time[0] - _ROUNDING <= time <= self.time[-1] + _ROUNDING:
            return None
        time = float(np.clip(time, self.time[0], self.time[-1]))
        position = interpolate(self.time, self.position, time)
        if self.axis is None:
            return position, None
        axis = interpolate(self.time, self.axis, time)
        return position, axis / np.linalg.norm(axis, axis=-1, keepdims=True)

    def closed_at(self, time: float) -> npt.NDArray[np.bool_] | None:
        """Whether each gripper is closed at a time [s], [G]: the value of the last row at or before
        it, or of the first row. None: unknown."""
        if self.closed is None:
            return None
        row = int(np.searchsorted(self.time, time + _ROUNDING, side="right")) - 1
        return self.closed[max(row, 0)]


@dataclass(frozen=True, eq=False)
class CameraRecording:
    """The input of perception: cameras, the robot's path and the object."""

    sources: list[FrameSource]
    robot: RobotPath
    meta: dict[str, Any]
    """The content of object.toml, in the layout of a recording's meta."""
    capsules: Callable[[float], Capsules] | None = None
    """The robot's shape at a time [s]; None: unknown."""
    where: str = ""
    """What messages call it."""


class PngCamera:
    """One camera's folder of camera.toml, frames.csv and PNG pictures, as a `FrameSource`.

    `on_warning` is called with a fault for rows of frames.csv that cannot be used.

    Raises:
        RecordingError: camera.toml or frames.csv is missing or holds nothing usable.
    """

    def __init__(
        self, folder: str | os.PathLike, *, on_warning: Callable[[Fault], None] = lambda _: None
    ):
        self.camera: Camera = read_camera(Path(folder) / "camera.toml")
        self._rows = _read_frames(Path(folder) / "frames.csv", on_warning)

    @staticmethod
    def find(folder: Path) -> Path | None:
        """frames.csv of a camera's folder."""
        path = folder / "frames.csv"
        return path if path.exists() else None

    def __iter__(self) -> Iterator[Frame]:
        for time, *files in self._rows:
            yield Frame(time, files[0], lambda files=files: self._read(*map(Path, files)))

    def _read(self, path: Path, colour: Path | None = None) -> Pictures:
        picture = read_png(path)
        what = f"is a PNG of mode {picture.mode}, not 16 bit grey"
        fix = "store depth as 16 bit counts of depth_unit"
        expect(picture.mode.startswith("I"), what, str(path), fix)
        counts = np.asarray(picture).astype(np.uint16, copy=False)
        self.camera.check_size(counts, str(path))
        if colour is None:
            return Pictures(counts)
        painted = np.asarray(read_png(colour).convert("RGB"))
        self.camera.check_size(painted, str(colour))
        return Pictures(counts, painted)


class PngWriter:
    """Writes one camera's folder, made if missing, to be read by `PngCamera`.

    Each picture is on disk before its row is in frames.csv, so what an interrupted recording
    leaves can be read. GendomError: the folder cannot be written.
    """

    def __init__(self, folder: str | os.PathLike, camera: Camera):
        self._folder = Path(folder)
        self._count = 0
        write_camera(self._folder / "camera.toml", camera)
        for name in ("depth", "colour"):
            (self._folder / name).mkdir(exist_ok=True)
        (self._folder / "frames.csv").write_text(_HEADER + "\n", encoding="utf-8")

    def write(self, time: float, pictures: Pictures) -> None:
        """Append a frame; `time` [s] is later than the one before."""
        row = [repr(float(time))]
        for kind, array in {"depth": pictures.depth, "colour": pictures.colour}.items():
            name = f"{kind}/{self._count:06d}.png"
            row.append("" if array is None else name)
            if array is not None:
                Image.fromarray(array).save(self._folder / name, compress_level=1)
        with open(self._folder / "frames.csv", "a", encoding="utf-8") as file:
            file.write(",".join(row) + "\n")
        self._count += 1


def append_row(path: Path, row: Iterable[float]) -> None:
    """Append numbers to a CSV file, on the disk at once."""
    with open(path, "a", encoding="utf-8") as file:
        file.write(",".join(f"{float(x):.6f}" for x in row) + "\n")


def read_cameras(
    folder: str | os.PathLike,
    *,
    cameras: Sequence[str] = (),
    arm: Arm | None = None,
    on_warning: Callable[[Fault], None] = lambda _: None,
) -> CameraRecording:
    """Read a folder of the layout above; pictures are read later, one by one.

    Args:
        folder: DIR.
        cameras: Names of those to use; by default all, in order of their names.
        arm: The robot of joints.csv; by default the one that object.toml names.
        on_warning: Called with every fault that does not prevent use.

    Raises:
        RecordingError: A part is missing or cannot be used.
    """
    folder = Path(folder)
    place, path = folder / "cameras", folder / "gripper.csv"
    fix = f"gendom doctor {shlex.quote(str(folder))} says what it is"
    expect(folder.is_dir() or not folder.exists(), "is no folder", str(folder), fix)
    expect(folder.is_dir(), "no such folder", str(folder), "check the path")
    found = sorted(p.name for p in place.iterdir() if p.is_dir()) if place.is_dir() else []
    fix = f"give each a folder with camera.toml and frames.csv or a RealSense recording; {fix}"
    expect(found, "holds no camera", str(place), fix)
    for name in cameras:
        what, fix = f"there is no camera {name!r}", f"have {', '.join(found)}"
        expect(name in found, what, str(place), fix)
    meta = read_object(folder / "object.toml")
    arrays = read_gripper(path, on_cut=lambda line: on_warning(cut_off(path, line)))
    time = arrays["time"]
    increases = np.isfinite(time).all() and (np.diff(time) > 0).all()
    fix = "give the robot's path in order of time"
    expect(increases, "its times do not increase", str(path), fix)
    return CameraRecording(
        sources=[_open_camera(place / name, on_warning) for name in cameras or found],
        robot=RobotPath(
            time,
            arrays["gripper_position"],
            arrays.get("gripper_axis"),
            arrays.get("gripper_closed"),
        ),
        meta=meta,
        capsules=read_shape(folder, meta, (time[0], time[-1]), arm=arm, on_warning=on_warning),
        where=str(folder),
    )


def _open_camera(folder: Path, on_warning: Callable[[Fault], None]) -> FrameSource:
    """A camera's folder of any kind: one of ours, or of an entry point ``gendom.cameras``."""
    readers: list[CameraReader] = [
        PngCamera,
        RealSenseRecording,
        *plugins("cameras", lambda reader: reader.find).values(),
    ]
    found = [(reader, path) for reader in readers if (path := reader.find(folder)) is not None]
    what = f"holds {' and '.join(path.name for _, path in found)}"
    expect(len(found) <= 1, what, str(folder), "leave one of them in the camera's folder")
    # Of an empty folder PngCamera tells what is missing.
    return (found[0][0] if found else PngCamera)(folder, on_warning=on_warning)


def _read_frames(path: Path, on_warning: Callable[[Fault], None]) -> list[tuple[Any, ...]]:
    """Rows (time [s], path of the depth[, of the colour]) of frames.csv."""
    lines = read_rows(path, header=_HEADER, damaged=True)
    header, rows, bad = lines[0][1], [], []
    right = {"time", "depth"} <= set(header) <= {"time", "depth", "colour"}
    what = f"has the header {','.join(header)!r}"
    expect(right, what, str(path), f"write {_HEADER}")
    at, depth = header.index("time"), header.index("depth")
    colour = header.index("colour") if "colour" in header else depth
    folder = os.fspath(path.parent)
    for number, line in lines[1:]:
        try:
            time, whole = number_of(line[at]), len(line) == len(header) and line[depth]
        except (ValueError, IndexError):
            time, whole = math.nan, False
        if not whole or not math.isfinite(time) or (rows and time <= rows[-1][0]):
            bad.append(number)
            continue
        named = [line[depth], line[colour]] if colour != depth and line[colour] else [line[depth]]
        where = f"{path}, line {number}"
        rows.append((time, *(inside(folder, name, where=where) for name in named)))
    expect(rows, "holds no usable row", str(path), f"write one row a frame under {_HEADER}")
    if bad:
        what = f"{len(bad)} of {len(lines) - 1} rows are cut short, no numbers or go back in time, "
        what += f"first in line {bad[0]}; they are left out"
        on_warning(Fault(what, str(path), "record again if too much is missing", "warning"))
    times = np.array([row[0] for row in rows])
    check_named([os.path.splitext(os.path.basename(r[1]))[0] for r in rows], times, where=str(path))
    return rows
