"""RealSense recordings as a source of frames.

A recorded camera is a folder with one recording and camera.toml:

    cameras/left/
      recording.db3    or .bag, of any name, as the SDK or its viewer records them
      camera.toml      T_world_camera; depth_unit only where the recording's is wrong

Intrinsics, distortion and depth unit are the recording's. Colour is aligned with depth
(`gendom.perception.alignment`). Time is the depth picture's own time stamp [s]: with the SDK's
"Global Time", its default, on the clock of the computer that recorded, since 1970.

.db3 files are read without the SDK (`gendom.perception.rosbag`). .bag files are converted by it
first, in a process of its own: the SDK ends the process on some damaged files.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.datasets import Fault
from gendom.errors import DeviceError, RecordingError
from gendom.files import atomic_path
from gendom.installation import how_to_install
from gendom.perception.alignment import Alignment
from gendom.perception.camera import Camera, adopt_camera
from gendom.perception.frames import SYNC_TOLERANCE, Frame, Pictures
from gendom.perception.rosbag import Bag, Entry
from gendom.reading import read_bytes

_DEVICE_CLOCK = "Hardware Clock"


def is_recording(path: str | os.PathLike) -> bool:
    """Whether a file has the suffix of a RealSense recording."""
    return Path(path).suffix.lower() in (".db3", ".bag")


class RealSenseRecording:
    """A recording of a RealSense camera, as a `FrameSource`.

    Args:
        path: The .db3 or .bag file, or its folder; camera.toml is looked for beside it.
        name: The camera's name; by default that of its folder.
        on_warning: Called with every fault that does not prevent use.

    Raises:
        RecordingError: It is damaged from the start on, has no depth, or camera.toml contradicts
            it.
        DeviceError: A .bag file is to be read and the SDK is missing.
    """

    def __init__(
        self,
        path: str | os.PathLike,
        *,
        name: str | None = None,
        on_warning: Callable[[Fault], None] = lambda _: None,
    ):
        self.path = Path(path)
        if self.path.is_dir():
            self.path = self.find(self.path) or self.path
        self._on_warning = on_warning
        _check_checksum(self.path)
        self._bag = Bag(self._as_db3(), on_warning=on_warning)
        where = str(self.path)
        name = name or self.path.resolve().parent.name
        depth = self._bag.stream("Depth", name)
        if depth is None or not depth.entries:
            what = "has no depth pictures" if depth is None else "no depth picture can be read"
            raise RecordingError(what, where=where, fix="record the depth stream (Z16)")
        self._depth = depth.entries
        camera = replace(depth.camera, depth_unit=self._unit())
        self.camera: Camera = adopt_camera(self.path.with_name("camera.toml"), camera)
        colour = self._bag.stream("Color", f"{name}: colour")
        self._colour = [] if colour is None else colour.entries
        self._colour_times = np.array([entry.time for entry in self._colour])
        self._align: Alignment | None = None
        if colour is not None and self._colour:
            T = colour.T_stream_reference @ np.linalg.inv(depth.T_stream_reference)
            self._align = Alignment(self.camera, colour.camera, T)
        if self._depth[0].domain == _DEVICE_CLOCK:
            on_warning(own_clock(where))

    def _as_db3(self) -> Path:
        """Path of the .db3 file, converted by the SDK from a .bag if necessary."""
        try:
            with open(self.path, "rb") as file:
                is_bag = file.read(7) == b"#ROSBAG"
        except OSError:
            is_bag = False  # `Bag` raises the reason
        if not is_bag:
            return self.path
        folder = Path(tempfile.mkdtemp(prefix="gendom-"))
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        return _converted(self.path, folder, self._on_warning)

    def _unit(self) -> float:
        unit = next((e.depth_unit for e in self._depth if e.depth_unit is not None), None)
        unit = unit or self._bag.depth_unit()
        if unit is None:
            what, fix = "does not say its depth unit", "record it with the RealSense SDK"
            raise RecordingError(what, where=str(self.path), fix=fix)
        return unit

    @staticmethod
    def find(folder: Path) -> Path | None:
        """The recording in a camera's folder; None: there is none.

        Raises:
            RecordingError: There are several.
        """
        found = sorted(filter(is_recording, folder.iterdir()))
        what = f"holds {len(found)} recordings, {', '.join(p.name for p in found)}"
        fix = "leave one in the camera's folder"
        require(len(found) <= 1, what, where=str(folder), fix=fix, error=RecordingError)
        return found[0] if found else None

    def __len__(self) -> int:
        return len(self._depth)

    def __iter__(self) -> Iterator[Frame]:
        for k, entry in enumerate(self._depth):
            where = f"{self.path}: frame {k}"
            yield Frame(entry.time, where, lambda e=entry, w=where: self._read(e, w))

    def _read(self, entry: Entry, where: str) -> Pictures:
        depth = self._bag.picture(entry, f"{where}: depth")
        _check_size(depth, (self.camera.height, self.camera.width), np.uint16, f"{where}: depth")
        if self._align is None:
            return Pictures(depth)  # pyright: ignore[reportArgumentType]
        nearest = int(np.abs(self._colour_times - entry.time).argmin())
        late = float(abs(self._colour_times[nearest] - entry.time))
        what, fix = (
            f"the nearest colour picture is {late:.3g} s away",
            "record colour at the rate of depth",
        )
        require(late <= SYNC_TOLERANCE, what, where=where, fix=fix, error=RecordingError)
        colour = self._bag.picture(self._colour[nearest], f"{where}: colour")
        size = self._align.colour.height, self._align.colour.width
        _check_size(colour, size, np.uint8, f"{where}: colour")
        return self._align(depth, colour)  # pyright: ignore[reportArgumentType]


def write_checksum(path: Path) -> None:
    """Write the SHA-256 of a recording beside it, as ``sha256sum`` does: uncompressed pictures have
    no checksum of their own."""
    with atomic_path(_checksum_path(path)) as temporary:
        temporary.write_text(f"{_checksum(path)}  {path.name}\n", encoding="utf-8")


def _check_checksum(path: Path) -> None:
    """Check a recording against the checksum beside it, if there is one.

    Raises:
        RecordingError: They differ.
    """
    if not (beside := _checksum_path(path)).exists():
        return
    stated = read_bytes(beside, error=RecordingError).split(b" ", 1)[0]
    fix = f"copy it again, or delete {beside.name} to use what is left of it"
    same = stated.decode("ascii", "replace") == _checksum(path)
    require(same, "differs from its checksum", where=str(path), fix=fix, error=RecordingError)


def _checksum_path(path: Path) -> Path:
    return path.with_name(path.name + ".sha256")


def _checksum(path: Path) -> str:
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise RecordingError(f"cannot be read ({error.strerror})", where=str(path)) from None


def _check_size(picture: np.ndarray, size: tuple[int, int], kind: type, where: str) -> None:
    right = picture.shape[:2] == size and picture.dtype == kind
    what = f"is {picture.shape[1]} x {picture.shape[0]} of {picture.dtype}, the stream "
    what += f"{size[1]} x {size[0]} of {np.dtype(kind)}"
    require(right, what, where=where, fix="copy the file again", error=RecordingError)


def own_clock(where: str) -> Fault:
    """Warning that time stamps are relative to the start of a camera."""
    what = "its time stamps are of the camera's own clock"
    fix = "record with the option Global Time Enabled to compare them with other clocks"
    return Fault(what, where, fix, "warning")


_CONVERT = "import sys, pyrealsense2; pyrealsense2.context().convert_bag_to_db3(*sys.argv[1:])"


def _converted(path: Path, folder: Path, on_warning: Callable[[Fault], None]) -> Path:
    """Convert the readable part of a .bag to a .db3 file with the SDK.

    Raises:
        DeviceError: The SDK is missing.
        RecordingError: The conversion fails.
    """
    sdk = realsense_sdk()
    if not hasattr(sdk.context, "convert_bag_to_db3"):
        what = f"the RealSense SDK {sdk.__version__} cannot convert .bag files"
        raise DeviceError(what, where=str(path), fix="pip install 'pyrealsense2>=2.59'")
    # The SDK detects the format from the file name, not from the content.
    source, made = path.resolve(), folder / "recording.db3"
    if source.suffix != ".bag":
        source = Path(shutil.copyfile(source, folder / "recording.bag"))
    done = subprocess.run(
        [sys.executable, "-c", _CONVERT, str(source), str(made)], capture_output=True, text=True
    )
    if done.returncode != 0:
        reason = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        what = f"the RealSense SDK cannot read it ({reason[:120]})"
        fix = "copy it again; rosbag reindex mends one that was cut off"
        require(made.exists(), what, where=str(path), fix=fix, error=RecordingError)
        what = f"is damaged or cut off ({reason[:120]}); what comes before is used"
        fix = "copy it again, or record again if too much is missing"
        on_warning(Fault(what, str(path), fix, "warning"))
    return made


def realsense_sdk() -> Any:
    """The module pyrealsense2.

    Raises:
        DeviceError: It is missing or does not load.
    """
    try:
        import pyrealsense2
    except ModuleNotFoundError:
        fix = f"{how_to_install('camera')} (Linux and Windows, x86-64)"
        raise DeviceError("the RealSense SDK is missing", fix=fix) from None
    except ImportError as error:
        what = f"the RealSense SDK does not load ({error})"
        fix = "install the library it names; on Debian: apt install libusb-1.0-0"
        raise DeviceError(what, fix=fix) from None
    return pyrealsense2
