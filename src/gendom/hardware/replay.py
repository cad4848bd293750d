"""A recorded folder as devices, so that what follows a recording can be tried again."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from gendom.hardware.cell import CellCamera
from gendom.hardware.contracts import Recorded
from gendom.perception import read_cameras


class ReplayedCamera:
    """One camera of a recorded folder; what it records is what was recorded there.

    Args:
        cell_camera: Its name is that of the camera in the folder; its serial number the folder.
    """

    def __init__(self, cell_camera: CellCamera):
        self.name, self._folder = cell_camera.name, Path(cell_camera.serial)
        self._source: Any = None
        self.pixels = 0

    def connect(self) -> None:
        """Raises: `RecordingError` where the folder holds no such camera."""
        (self._source,) = read_cameras(self._folder, cameras=[self.name]).sources
        self.pixels = self._source.camera.width * self._source.camera.height

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
