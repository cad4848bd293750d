"""Depth cameras without hardware: the RealSense SDK's software device."""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np

from gendom.hardware.cell import CellCamera
from gendom.hardware.realsense import RealSenseCamera
from gendom.perception.realsense import realsense_sdk


class SoftwareCamera:
    """A device of the SDK with the geometry of a `Camera`."""

    def __init__(self, camera):
        self.sdk = sdk = realsense_sdk()
        self.camera = camera
        self.domain = sdk.timestamp_domain.global_time
        self.device = sdk.software_device()
        self.device.register_info(sdk.camera_info.name, "Software D435I")
        self.device.register_info(sdk.camera_info.serial_number, camera.name)
        self.sensors, self.profiles = [], []
        kinds = (
            ("Stereo Module", sdk.stream.depth, sdk.format.z16, 2),
            ("RGB Camera", sdk.stream.color, sdk.format.rgb8, 3),
        )
        for uid, (name, kind, form, size) in enumerate(kinds, start=1):
            stream = sdk.video_stream()
            stream.type, stream.fmt, stream.bpp, stream.uid = kind, form, size, uid
            stream.index, stream.fps = 0, 30
            stream.width, stream.height = camera.width, camera.height
            stream.intrinsics = self._intrinsics()
            self.sensors.append(self.device.add_sensor(name))
            self.profiles.append(self.sensors[-1].add_video_stream(stream))
        self.sensors[0].add_read_only_option(sdk.option.depth_units, camera.depth_unit)
        apart = sdk.extrinsics()
        apart.rotation, apart.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [0, 0, 0]
        self.profiles[0].register_extrinsics_to(self.profiles[1], apart)

    def _intrinsics(self):
        camera, K = self.camera, self.camera.K
        found, kinds = self.sdk.intrinsics(), self.sdk.distortion
        found.width, found.height = camera.width, camera.height
        found.fx, found.fy, found.ppx, found.ppy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
        found.model = kinds.brown_conrady if any(camera.distortion) else kinds.none
        found.coeffs = [*camera.distortion, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
        return found

    def show(self, time, number, pictures):
        """Send depth and colour of a time [s]."""
        arrays = (pictures.depth, pictures.colour)
        for sensor, profile, array in zip(self.sensors, self.profiles, arrays, strict=True):
            frame = self.sdk.software_video_frame()
            frame.pixels = np.ascontiguousarray(array)
            frame.bpp = array.itemsize * (array.shape[2] if array.ndim == 3 else 1)
            frame.stride = frame.bpp * self.camera.width
            frame.timestamp, frame.domain, frame.frame_number = 1e3 * time, self.domain, number
            frame.profile = profile.as_video_stream_profile()
            if array.ndim == 2:
                frame.depth_units = self.camera.depth_unit
            sensor.on_video_frame(frame)


def connected(software, **settings):
    """A connected `RealSenseCamera` of a software device."""
    camera = software.camera
    described = CellCamera(
        name=camera.name, device="realsense", serial="", T_world_camera=camera.T_world_camera
    )
    live = RealSenseCamera(described, device=software.device)
    vars(live).update(mode=(camera.width, camera.height, 30), **settings)
    live.connect()
    return live


@contextmanager
def recording(folder, camera, *, compress=True):
    """Gives a function (time [s], pictures) that writes a frame of folder/recording.db3."""
    software = SoftwareCamera(camera)
    live = connected(software, compress=compress)
    live.start_recording(folder)
    count = 0

    def write(time, pictures):
        nonlocal count
        count += 1
        software.show(time, count, pictures)

    try:
        yield write
    finally:
        assert not count or live.stop_recording().missing == 0
        live.disconnect()
