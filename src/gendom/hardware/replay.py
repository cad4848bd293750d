"""A recorded folder as devices, so that what follows a recording can be tried again."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from gendom.arguments import require
from gendom.errors import DeviceError
from gendom.hardware.cell import CellCamera
from gendom.hardware.contracts import Recorded
from gendom.perception import Camera, read_cameras


class ReplayedCamera:
    """One camera of a recorded folder; what it records is what was recorded there.

    Args:
        cell_camera: Its name is that of the camera in the folder; its serial number the folder.
    """

    def __init__(self, cell_camera: CellCamera):
        self.name, self._folder = cell_camera.name, Path(cell_camera.serial)
        self._source: Any = None

    @property
    def camera(self) -> Camera:
        """Intrinsics, depth unit and pose, once it is connected."""
        where, fix, known = f"camera {self.name}", "connect it", self._source is not None
        require(known, "is not connected", where=where, fix=fix, error=DeviceError)
        return self._source.camera

    def connect(self) -> None:
        """Raises: `RecordingError` where the folder holds no such camera."""
        (self._source,) = read_cameras(self._folder, cameras=[self.name]).sources

    def start_recording(self, folder: Path) -> None:
        """Copy what was recorded."""
        shutil.copytree(self._folder / "cameras" / self.name, folder, dirs_exist_ok=True)

    def wait_for_pictures(self) -> None:
        """They are there."""

    def fault(self) -> None:
        """There is none."""

    def stop_recording(self) -> Recorded:
        return Recorded(pictures=sum(1 for _ in self._source), missing=0)

    def disconnect(self) -> None:
        """Nothing is held."""
