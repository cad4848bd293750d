"""A recorded folder as devices, so that what follows a recording can be tried again."""

from __future__ import annotations

import shutil
from pathlib import Path

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
        self.name = cell_camera.name
        self._source = Path(cell_camera.serial)
        self._camera: Camera | None = None
        self._pictures = 0

    @property
    def camera(self) -> Camera:
        """Intrinsics, depth unit and pose, once it is connected."""
        if self._camera is None:
            raise DeviceError("is not connected", where=f"camera {self.name}", fix="connect it")
        return self._camera

    def connect(self) -> None:
        """Raises: `RecordingError` where the folder holds no such camera."""
        (source,) = read_cameras(self._source, cameras=[self.name]).sources
        self._camera, self._pictures = source.camera, sum(1 for _ in source)

    def start_recording(self, folder: Path) -> None:
        """Copy what was recorded."""
        shutil.copytree(self._source / "cameras" / self.name, folder, dirs_exist_ok=True)

    def wait_for_pictures(self) -> None:
        """They are there."""

    def fault(self) -> None:
        """There is none."""

    def stop_recording(self) -> Recorded:
        return Recorded(pictures=self._pictures, missing=0)

    def disconnect(self) -> None:
        """Nothing is held."""
