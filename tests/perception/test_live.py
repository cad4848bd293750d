"""Live cameras behind the same contract, with the SDK's software device as far as that goes."""

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from gendom.errors import DeviceError, GendomError, ParameterError, RecordingError
from gendom.perception import (
    Camera,
    Frame,
    FrameSource,
    Pictures,
    PngCamera,
    PngWriter,
    RealSenseCamera,
    RealSenseRecording,
    RealSenseWriter,
    record_cameras,
)

WIDTH, HEIGHT, F = 64, 48, 60.0


class Device:
    """A software device that looks like a D435: depth, and colour 15 mm beside it."""

    def __init__(self, sdk, own_clock=False):
        self.sdk = sdk
        self.device = sdk.software_device()
        self.device.register_info(sdk.camera_info.name, "Software D435I")
        self.device.register_info(sdk.camera_info.serial_number, "123")
        domains = sdk.timestamp_domain
        self.domain = domains.hardware_clock if own_clock else domains.global_time
        self.sensors, self.profiles = [], []
        for number, (name, kind, form, size) in enumerate(
            [
                ("Stereo Module", sdk.stream.depth, sdk.format.z16, 2),
                ("RGB Camera", sdk.stream.color, sdk.format.rgb8, 3),
            ]
        ):
            stream = sdk.video_stream()
            stream.type, stream.fmt, stream.bpp, stream.uid = kind, form, size, number + 1
            stream.index, stream.fps, stream.width, stream.height = 0, 30, WIDTH, HEIGHT
            intrinsics = sdk.intrinsics()
            intrinsics.width, intrinsics.height = WIDTH, HEIGHT
            intrinsics.fx = intrinsics.fy = F
            intrinsics.ppx, intrinsics.ppy = 31.5, 23.5
            intrinsics.model, intrinsics.coeffs = sdk.distortion.none, [0.0] * 5
            stream.intrinsics = intrinsics
            self.sensors.append(self.device.add_sensor(name))
            self.profiles.append(self.sensors[-1].add_video_stream(stream))
        self.sensors[0].add_read_only_option(sdk.option.depth_units, 1e-4)
        beside = sdk.extrinsics()
        beside.rotation, beside.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [-0.1, 0, 0]
        self.profiles[0].register_extrinsics_to(self.profiles[1], beside)

    def show(self, which, time, array):
        """A picture of sensor 0 (depth) or 1 (colour) at a time [s]."""
        frame = self.sdk.software_video_frame()
        frame.pixels = np.ascontiguousarray(array)
        frame.bpp = 3 if array.ndim == 3 else 2
        frame.stride, frame.timestamp, frame.domain = frame.bpp * WIDTH, 1e3 * time, self.domain
        frame.frame_number = 1
        frame.profile = self.profiles[which].as_video_stream_profile()
        self.sensors[which].on_video_frame(frame)


def depth(counts=6000):
    return np.full((HEIGHT, WIDTH), counts, np.uint16)


def columns(first=0):
    """Colour whose red is the column."""
    colour = np.full((HEIGHT, WIDTH, 3), first, np.uint8)
    colour[..., 0] = np.arange(WIDTH)
    return colour


def open_camera(device, **other):
    values = {"width": WIDTH, "height": HEIGHT, "device": device.device, "timeout": 0.5, **other}
    return RealSenseCamera("123", **values)


def test_frames_of_a_device(sdk):
    device = Device(sdk)
    with open_camera(device, T_world_camera=np.eye(4), name="left") as camera:
        assert isinstance(camera, FrameSource)
        assert camera.camera.name == "left" and camera.camera.depth_unit == 1e-4
        np.testing.assert_allclose(camera.camera.K, [[F, 0, 31.5], [0, F, 23.5], [0, 0, 1]])
        np.testing.assert_array_equal(camera.camera.calibrated(), np.eye(4))
        for t in range(5):
            device.show(0, 100.0 + t / 30, depth(6000 + t))
            device.show(1, 100.004 + t / 30, columns(t))
        frames = []
        for frame in camera:
            frames.append(frame)
            if len(frames) == 5:
                break
    np.testing.assert_allclose([f.time for f in frames], 100.0 + np.arange(5) / 30)
    for t, frame in enumerate(frames):
        seen = frame.read()
        np.testing.assert_array_equal(seen.depth, depth(6000 + t))
        # At 0.6 m, 0.1 m aside is ten columns.
        assert seen.colour is not None and (seen.colour[:, 10:, 1] == t).all()
        np.testing.assert_array_equal(seen.colour[0, 10:, 0], np.arange(WIDTH - 10))
        assert not seen.colour[:, :10].any()


def test_depth_alone(sdk):
    device = Device(sdk)
    with open_camera(device, colour=False) as camera:
        device.show(0, 1.0, depth())
        assert next(iter(camera)).read().colour is None


def test_nearest_colour_wins_and_lonely_depth_is_left_out(sdk):
    device, faults = Device(sdk), []
    camera = open_camera(device, on_warning=faults.append, timeout=0.3)
    with camera:
        for t in range(10):
            device.show(0, t / 30, depth(6000 + t))
            if t not in (3, 4):
                device.show(1, t / 30 - 0.002, columns(t))
        device.show(1, 10 / 30, columns(10))
        found = list(camera)
    assert [round(30 * f.time) for f in found] == [0, 1, 2, 5, 6, 7, 8, 9]
    for frame in found:
        seen = frame.read()
        assert seen.colour is not None
        assert seen.colour[0, -1, 1] == round(30 * frame.time) == seen.depth[0, 0] - 6000
    told = [str(f) for f in faults]
    assert "2 of 10 depth pictures have no colour picture" in " ".join(told)


def test_a_camera_that_falls_silent(sdk):
    """Before the first picture it is a fault, later a warning."""
    device, faults = Device(sdk), []
    with (
        open_camera(device, timeout=0.1) as camera,
        pytest.raises(DeviceError, match=r"camera 123: gave no picture for 0\.1 s.*USB 3"),
    ):
        next(iter(camera))
    with open_camera(device, timeout=0.1, colour=False, on_warning=faults.append) as camera:
        device.show(0, 1.0, depth())
        assert len(list(camera)) == 1
    assert "gave no picture" in str(faults[0]) and faults[0].severity == "warning"


def test_a_camera_that_is_unplugged(sdk):
    device, faults = Device(sdk), []
    with open_camera(device, timeout=60.0, colour=False, on_warning=faults.append) as camera:
        device.show(0, 1.0, depth())
        removed = SimpleNamespace(was_removed=lambda which: which is device.device)
        timer = threading.Timer(0.2, camera._devices_changed, [removed])
        timer.start()
        assert len(list(camera)) == 1
    assert "was unplugged; its frames end" in str(faults[0])


def test_what_is_not_used_in_time_is_dropped(sdk):
    device, faults = Device(sdk), []
    with open_camera(device, colour=False, on_warning=faults.append) as camera:
        for t in range(100):
            device.show(0, t / 30, depth(t))
        first = next(iter(camera))
    assert first.read().depth[0, 0] == 100 - 64
    assert "36 pictures were dropped" in str(faults[0])


def test_own_clock_is_told(sdk):
    device, faults = Device(sdk, own_clock=True), []
    with open_camera(device, colour=False, on_warning=faults.append) as camera:
        device.show(0, 1.0, depth())
        next(iter(camera))
    assert "of the camera's own clock" in str(faults[0])


def test_absent_devices_and_modes(sdk):
    with pytest.raises(DeviceError, match=r"no RealSense camera.* is connected; "):
        RealSenseCamera("0" * 12)
    with pytest.raises(DeviceError, match=r"no depth of 848 x 480 at 30.*choose of 64 x 48"):
        open_camera(Device(sdk), width=848, height=480)
    with pytest.raises(DeviceError, match="use it in a with block"):
        next(iter(open_camera(Device(sdk))))


def test_no_sdk(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyrealsense2", None)
    with pytest.raises(DeviceError, match=r"SDK is missing; pip install .*\[camera\]'"):
        RealSenseCamera("123")


# Recording.


class Clockwork:
    """A camera that gives frames, faster than life, until it is told to end."""

    def __init__(self, name, frames=10**6, spoilt=()):
        K = np.array([[F, 0, 31.5], [0, F, 23.5], [0, 0, 1]])
        self.camera = Camera(name=name, width=WIDTH, height=HEIGHT, K=K, T_world_camera=np.eye(4))
        self._frames, self._spoilt = frames, spoilt

    def __iter__(self):
        for t in range(self._frames):
            yield Frame(5.0 + t / 30, f"frame {t}", lambda t=t: self._read(t))

    def _read(self, t):
        if t in self._spoilt:
            raise RecordingError("is spoilt", where=f"frame {t}", fix="look away")
        return Pictures(depth(6000 + t), columns(t % 256))


def test_cameras_are_recorded(sdk, tmp_path):
    """Of two kinds, with a frame that cannot be read."""
    sources = [Clockwork("left"), Clockwork("right", spoilt=(4,))]
    seen = []
    with (
        PngWriter(tmp_path / "left", sources[0].camera) as left,
        RealSenseWriter(tmp_path / "right", sources[1].camera) as right,
    ):
        counts = record_cameras(sources, [left, right], 0.5, lambda k, time: seen.append((k, time)))
    assert counts == [16, 15] and len(seen) == 31
    again = [PngCamera(tmp_path / "left"), RealSenseRecording(tmp_path / "right/recording.db3")]
    for source, count in zip(again, counts, strict=True):
        frames = list(source)
        assert len(frames) == count
        for frame in frames:
            t = round(30 * (frame.time - 5.0))
            assert frame.read().depth[0, 0] == 6000 + t


def test_a_full_disk_ends_all(tmp_path):
    class Full:
        def write(self, time, pictures):
            raise GendomError("no space left", where="disk", fix="delete something")

        def close(self):
            pass

    sources = [Clockwork("left"), Clockwork("right")]
    start = time.monotonic()
    with pytest.raises(GendomError, match="no space left"):
        record_cameras(
            sources, [Full(), PngWriter(tmp_path / "b", sources[1].camera)], duration=1e6
        )
    assert time.monotonic() - start < 5.0
    with pytest.raises(ParameterError, match="2 cameras and 0 writers"):
        record_cameras(sources, [], 1.0)
