"""Intel RealSense cameras, recorded by the vendor's SDK.

The SDK's own recorder writes what the camera sends, for `gendom.perception.RealSenseRecording`.
Aligning and encoding pictures while they arrive would lose most of them.
"""

import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.errors import DeviceError
from gendom.hardware.cell import CellCamera
from gendom.hardware.contracts import Recorded
from gendom.perception.camera_file import write_pose
from gendom.perception.realsense import Bag, realsense_sdk, write_checksum

RECORDING = "recording.db3"
"""Name of the file in a camera's folder."""

_FIRST_PICTURE = 5.0  # [s] that a camera may take to start
_SILENT = 1.0  # [s] without a new picture after which a camera counts as lost
_FLUSH = 0.3  # [s] in which the SDK's threads hand the last pictures to its recorder


@dataclass
class _Stream:
    """What has come of one stream."""

    pictures: int = 0
    first: int = 0
    last: int = 0
    begun: float = -np.inf
    stamp: float = -np.inf
    advanced: float = -np.inf  # when `stamp` last grew, on the clock of time.monotonic [s]


class RealSenseCamera:
    """A connected RealSense camera; a `gendom.hardware.DepthCamera`.

    Args:
        cell_camera: Its name, serial number and pose.
        device: A device of the SDK to use instead of a connected one.
    """

    mode = 848, 480, 30
    """Width and height of both streams [pixel], and frames a second."""
    kinds = "depth", "color"
    compress = False
    """Whether the SDK encodes pictures as PNG while it records: a third of the size, but two
    cameras keep two cores busy, and lose pictures beside other work."""

    def __init__(self, cell_camera: CellCamera, *, device: Any = None):
        self.name = cell_camera.name
        self._described = cell_camera
        self._device = device
        self._context: Any = None
        self._connected = False
        self._recorder: Any = None
        self._sensors: list[Any] = []
        self._streams: dict[str, _Stream] = {}
        self._path = Path()
        self._unplugged = False

    @property
    def pixels(self) -> int:
        """Of a picture."""
        return self.mode[0] * self.mode[1]

    def _require(self, holds: bool, what: str, fix: str) -> None:
        require(holds, what, where=f"camera {self.name}", fix=fix, error=DeviceError)

    def connect(self) -> None:
        """Find the camera and its streams.

        Raises:
            DeviceError: The SDK or the camera is missing, or it has no such streams.
        """
        sdk = realsense_sdk()
        if self._device is None:
            self._context = sdk.context()
            self._device = _connected(sdk, self._context, self._described.serial)
            self._context.set_devices_changed_callback(self._devices_changed)
        for kind in self.kinds:
            self._profile(self._device, kind)
        self._connected = True

    def _profile(self, device: Any, kind: str) -> tuple[Any, Any]:
        """A device's sensor and its profile of a stream, in this camera's mode."""
        sdk = realsense_sdk()
        form = sdk.format.z16 if kind == "depth" else sdk.format.rgb8
        modes = {}
        for sensor in device.query_sensors():
            for profile in sensor.get_stream_profiles():
                if profile.stream_type().name == kind and profile.format() == form:
                    video = profile.as_video_stream_profile()
                    modes[video.width(), video.height(), profile.fps()] = sensor, video
        have = ", ".join(f"{w} x {h} at {f}" for w, h, f in sorted(modes)) or "none"
        what = "has no {} of {} x {} at {} a second".format(kind, *self.mode)
        self._require(self.mode in modes, what, f"choose of {have}")
        return modes[self.mode]

    def _devices_changed(self, changes: Any) -> None:
        self._unplugged |= changes.was_removed(self._device)

    def start_recording(self, folder: Path) -> None:
        """Record both streams into ``folder/recording.db3`` until `stop_recording`, with the
        camera's pose in camera.toml. Returns when both streams have begun.

        Raises:
            DeviceError: The camera does not stream, or the SDK cannot write there.
        """
        self._require(self._connected, "is not connected", "call connect() first")
        sdk = realsense_sdk()
        self._path = Path(folder) / RECORDING
        taken = self._path.exists()
        require(not taken, "is there already", where=str(self._path), fix="name another folder")
        write_pose(self._path.with_name("camera.toml"), self._described.T_world_camera)
        try:
            self._recorder = sdk.recorder(str(self._path), self._device, self.compress)
            self._streams = {kind: _Stream() for kind in self.kinds}
            # Of cameras whose depth and colour come from one sensor both open at once.
            by_sensor: dict[str, tuple[Any, list[Any]]] = {}
            for kind in self.kinds:
                sensor, profile = self._profile(self._recorder, kind)
                name = sensor.get_info(sdk.camera_info.name)
                by_sensor.setdefault(name, (sensor, []))[1].append(profile)
            for sensor, profiles in by_sensor.values():
                if sensor.supports(sdk.option.global_time_enabled):
                    sensor.set_option(sdk.option.global_time_enabled, 1)
                sensor.open(profiles)
                self._sensors.append(sensor)
                sensor.start(self._take)
        except RuntimeError as error:
            self._close()
            fix = "close programs that use it, plug it in again (USB 3), or name another folder"
            self._require(False, f"does not record ({error})", fix)

    def wait_for_pictures(self) -> None:
        """Return when every stream has begun.

        Raises:
            DeviceError: One does not within five seconds.
        """
        until = time.monotonic() + _FIRST_PICTURE
        while silent := [k for k, s in self._streams.items() if not s.pictures]:
            what = f"gives no {' and no '.join(silent)} picture"
            waits = time.monotonic() <= until and not self._unplugged
            self._require(waits, what, "check cable and hub: it needs USB 3")
            time.sleep(0.01)

    def _take(self, frame: Any) -> None:
        """Called by the SDK, in a thread for each sensor."""
        number, stamp = frame.get_frame_number(), 1e-3 * frame.get_timestamp()
        stream = self._streams[frame.get_profile().stream_type().name]
        if not stream.pictures:
            stream.first, stream.begun = number, stamp
        stream.pictures += 1
        if stamp > stream.stamp:
            stream.stamp, stream.last, stream.advanced = stamp, number, time.monotonic()

    def fault(self) -> str | None:
        """What is wrong with the camera while it records; None: nothing."""
        if self._unplugged:
            return "was unplugged"
        for name, stream in self._streams.items():
            silent = time.monotonic() - stream.advanced
            if stream.pictures and silent > _SILENT:
                return f"has given no new {name} picture for {silent:.1f} s"
        return None

    def stop_recording(self) -> Recorded:
        """Stop, wait until everything is on disk, and count the pictures there.

        Raises:
            DeviceError: It does not record.
            RecordingError: The file cannot be read.
        """
        self._require(self._recorder is not None, "does not record", "start a recording first")
        time.sleep(_FLUSH)
        self._close()
        if not self.compress:  # PNG has checksums of its own
            write_checksum(self._path)
        bag = Bag(self._path)
        pictures = missing = 0
        for kind, seen in self._streams.items():
            stream = bag.stream(kind.capitalize(), self.name)
            entries = [] if stream is None else stream.entries
            # The SDK gives the first picture to its recorder, or begins that behind it.
            late = bool(entries) and entries[0].time > seen.begun + 1e-6
            sent = seen.last - seen.first + 1 - late if seen.pictures else 0
            pictures, missing = pictures + len(entries), missing + max(0, sent - len(entries))
        return Recorded(pictures=pictures, missing=missing)

    def _close(self) -> None:
        for sensor in self._sensors:
            with suppress(RuntimeError):  # not started, or no longer connected
                sensor.stop()
                sensor.close()
        self._sensors = []
        # The recorder flushes its buffers when the last reference is deleted.
        self._recorder = None

    def disconnect(self) -> None:
        """Stop a recording that still runs, and let the camera go."""
        self._close()
        self._connected = False


def _connected(sdk: Any, context: Any, serial: str) -> Any:
    """The connected device of a serial number."""
    found = {d.get_info(sdk.camera_info.serial_number): d for d in context.query_devices()}
    fix = "plug it in (USB 3); on Linux install the SDK's udev rules"
    require(found, "no RealSense camera is connected", fix=fix, error=DeviceError)
    what, fix = f"no RealSense camera {serial!r} is connected", f"have {', '.join(found)}"
    require(serial in found, what, fix=fix, error=DeviceError)
    return found[serial]
