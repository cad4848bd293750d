"""Live RealSense cameras, and their recording to disk."""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from gendom.arguments import require
from gendom.datasets import Fault
from gendom.errors import DeviceError, GendomError
from gendom.perception.alignment import Alignment
from gendom.perception.camera import Camera, rigid
from gendom.perception.frames import SYNC_TOLERANCE, Frame, FrameSource, FrameWriter, Pictures
from gendom.perception.realsense import own_clock, realsense_sdk

_MAX_COLOUR_LAG = 0.1  # [s]; a colour picture this much behind the depth pictures is lost
_QUEUE_SIZE = 64  # pictures that may wait to be used: about a second of depth and colour


class _Arrived(NamedTuple):
    is_depth: bool
    time: float
    own_clock: bool
    picture: np.ndarray


class RealSenseCamera:
    """A connected RealSense camera, as a `FrameSource`, streaming inside a `with` block.

        with RealSenseCamera("123456789012") as camera:
            for frame in camera:
                pictures = frame.read()

    Time is the depth picture's time stamp [s], on this computer's clock where the camera offers
    "Global Time". Frames wait for about a second to be used; of older ones the oldest are
    dropped, with a warning at the end. When the camera is lost the frames end, after a
    warning.

    Args:
        serial: Its serial number.
        T_world_camera: [4, 4] camera to world [m]; None: not calibrated.
        name: What messages call it; by default the serial number.
        width, height: Of both streams [pixel].
        rate: Frames a second.
        colour: Whether to stream colour too.
        timeout: Without a picture for so long [s] the camera counts as lost.
        on_warning: Called with every fault that does not prevent use.
        device: A device of the SDK to use instead of a connected one.

    Raises:
        DeviceError: The SDK or the camera is missing, or it has no such streams.
    """

    def __init__(
        self,
        serial: str,
        *,
        T_world_camera: npt.ArrayLike | None = None,
        name: str | None = None,
        width: int = 848,
        height: int = 480,
        rate: int = 30,
        colour: bool = True,
        timeout: float = 5.0,
        on_warning: Callable[[Fault], None] = lambda _: None,
        device: Any = None,
    ):
        self._sdk = sdk = realsense_sdk()
        self._where = f"camera {name or serial}"
        self._on_warning = on_warning
        self._timeout = timeout
        self._context = None
        if device is None:
            self._context = sdk.context()
            device = _connected(sdk, self._context, serial)
        self._device = device
        wanted = [(sdk.stream.depth, sdk.format.z16)]
        if colour:
            wanted.append((sdk.stream.color, sdk.format.rgb8))
        found = [self._profile(*kind, (width, height, rate)) for kind in wanted]
        sensor, profile = found[0]
        stream = _camera(name or serial, profile)
        # The SDK holds it as float32, whose shortest text is the number that was meant.
        unit = float(str(np.float32(sensor.as_depth_sensor().get_depth_scale())))
        pose = None if T_world_camera is None else np.asarray(T_world_camera)
        self.camera: Camera = replace(stream, T_world_camera=pose, depth_unit=unit)
        self._align = None
        if colour:
            other = found[1][1]
            second = _camera(f"{name or serial}: colour", other)
            self._align = Alignment(self.camera, second, _between(profile, other))
        # Of cameras whose depth and colour come from one sensor both open at once.
        by_sensor: dict[str, tuple[Any, list[Any]]] = {}
        for sensor, profile in found:
            own = by_sensor.setdefault(sensor.get_info(sdk.camera_info.name), (sensor, []))
            own[1].append(profile)
        self._sensors = list(by_sensor.values())
        self._arrived: queue.Queue[_Arrived | None] = queue.Queue(_QUEUE_SIZE)
        self._dropped = 0
        self._streaming = False
        self._lost = False

    def _profile(self, kind: Any, form: Any, mode: tuple[int, int, int]) -> tuple[Any, Any]:
        """The sensor and its profile of a stream, format, and width, height, rate."""
        modes = set()
        for sensor in self._device.query_sensors():
            for profile in sensor.get_stream_profiles():
                if profile.stream_type() != kind or profile.format() != form:
                    continue
                video = profile.as_video_stream_profile()
                modes.add((video.width(), video.height(), profile.fps()))
                if (video.width(), video.height(), profile.fps()) == mode:
                    return sensor, video
        have = ", ".join(f"{w} x {h} at {f}" for w, h, f in sorted(modes)) or "none"
        width, height, rate = mode
        what = f"has no {kind.name} of {width} x {height} at {rate} a second"
        raise DeviceError(what, where=self._where, fix=f"choose of {have}")

    def __enter__(self) -> RealSenseCamera:
        sdk = self._sdk
        if self._context is not None:
            self._context.set_devices_changed_callback(self._devices_changed)
        try:
            for sensor, profiles in self._sensors:
                if sensor.supports(sdk.option.global_time_enabled):
                    sensor.set_option(sdk.option.global_time_enabled, 1)
                sensor.open(profiles)
                sensor.start(self._take)
        except RuntimeError as error:
            self._stop()
            fix = "close other programs that use it, or plug it in again (USB 3)"
            raise DeviceError(f"does not start ({error})", where=self._where, fix=fix) from None
        self._streaming = True
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop streaming; frames that were not used yet are gone."""
        if not self._streaming:
            return
        self._streaming = False
        self._stop()
        self._put(None)
        if self._dropped:
            what = f"{self._dropped} pictures were dropped because they were not used in time"
            self._warn(what, "record at a lower rate or to a faster disk")

    def _warn(self, what: str, fix: str) -> None:
        self._on_warning(Fault(what, self._where, fix, "warning"))

    def _stop(self) -> None:
        for sensor, _ in self._sensors:
            try:
                sensor.stop()
                sensor.close()
            except RuntimeError:  # not started, or no longer connected
                continue

    def _devices_changed(self, changes: Any) -> None:
        if changes.was_removed(self._device):
            self._lost = True
            self._put(None)

    def _put(self, item: _Arrived | None) -> None:
        """Queue a picture, or None to wake threads that wait for one; the oldest give way."""
        while True:
            try:
                self._arrived.put_nowait(item)
                return
            except queue.Full:
                try:
                    self._arrived.get_nowait()
                    self._dropped += 1
                except queue.Empty:
                    continue

    def _take(self, frame: Any) -> None:
        """Called by the SDK, in a thread of its own."""
        clock = frame.get_frame_timestamp_domain()
        self._put(
            _Arrived(
                frame.get_profile().stream_type() == self._sdk.stream.depth,
                1e-3 * frame.get_timestamp(),
                clock == self._sdk.timestamp_domain.hardware_clock,
                np.array(frame.as_video_frame().get_data()),  # the SDK reuses its memory
            )
        )

    def __iter__(self) -> Iterator[Frame]:
        """Frames until the camera is closed or lost.

        Raises:
            DeviceError: It does not stream, or gives no picture at all.
        """
        if not self._streaming:
            raise DeviceError("does not stream", where=self._where, fix="use it in a with block")
        depths: deque[_Arrived] = deque()
        colours: deque[_Arrived] = deque(maxlen=16)
        count = alone = 0
        while (arrived := self._next(first=count == 0)) is not None:
            (depths if arrived.is_depth else colours).append(arrived)
            while depths and self._ready(depths, colours):
                depth = depths.popleft()
                if count == 0 and depth.own_clock:
                    self._on_warning(own_clock(self._where))
                count += 1
                if (align := self._align) is None:
                    read = partial(Pictures, depth.picture)
                else:
                    colour = min(colours, key=lambda c: abs(c.time - depth.time), default=None)
                    if colour is None or abs(colour.time - depth.time) > SYNC_TOLERANCE:
                        alone += 1
                        continue
                    read = partial(align, depth.picture, colour.picture)
                yield Frame(depth.time, f"{self._where}: frame {count - 1}", read)
        if alone:
            what = f"{alone} of {count} depth pictures have no colour picture within "
            what += f"{SYNC_TOLERANCE:g} s; they are left out"
            self._warn(what, "choose a rate that both streams keep")

    def _ready(self, depths: deque[_Arrived], colours: deque[_Arrived]) -> bool:
        """Whether no better colour picture for the first depth picture can arrive any more."""
        if self._align is None or (colours and colours[-1].time >= depths[0].time):
            return True
        return depths[-1].time - depths[0].time > _MAX_COLOUR_LAG

    def _next(self, first: bool) -> _Arrived | None:
        """The next picture; None when there will be none."""
        try:
            arrived = self._arrived.get(timeout=self._timeout)
        except queue.Empty:
            arrived, self._lost = None, True
        if arrived is not None or not self._lost:
            return arrived
        what = f"gave no picture for {self._timeout:g} s, or was unplugged"
        fix = "check cable and hub: it needs USB 3"
        if first:
            raise DeviceError(what, where=self._where, fix=fix)
        self._warn(f"{what}; its frames end", fix)
        return None


def _connected(sdk: Any, context: Any, serial: str) -> Any:
    """The connected device of a serial number."""
    serials = []
    for device in context.query_devices():
        serials.append(device.get_info(sdk.camera_info.serial_number))
        if serials[-1] == serial:
            return device
    what, fix = f"no RealSense camera {serial!r} is connected", f"have {', '.join(serials)}"
    if not serials:
        what = "no RealSense camera is connected"
        fix = "plug it in (USB 3); on Linux install the SDK's udev rules"
    raise DeviceError(what, fix=fix)


def _camera(name: str, profile: Any) -> Camera:
    """Size and intrinsics of a stream."""
    found = profile.get_intrinsics()
    distorted = any(found.coeffs) and found.model.name != "none"
    known = not distorted or "brown_conrady" in found.model.name
    what = f"has the distortion {found.model.name}, which is not known here"
    fix = "use a camera of the D400 series"
    require(known, what, where=f"camera {name}", fix=fix, error=DeviceError)
    return Camera(
        name=name,
        width=found.width,
        height=found.height,
        K=np.array([[found.fx, 0.0, found.ppx], [0.0, found.fy, found.ppy], [0.0, 0.0, 1.0]]),
        T_world_camera=None,
        distortion=tuple(found.coeffs) if distorted else (),
    )


def _between(depth: Any, colour: Any) -> npt.NDArray[np.float64]:
    """T_colour_depth [4, 4] [m] of two streams."""
    found = depth.get_extrinsics_to(colour)
    return rigid(np.array(found.rotation).reshape(3, 3).T, found.translation)  # column by column


def record_cameras(
    sources: Sequence[FrameSource],
    writers: Sequence[FrameWriter],
    duration: float,
    on_frame: Callable[[int, float], None] = lambda _camera, _time: None,
) -> list[int]:
    """Record cameras for some time, each in a separate thread.

    Frames that cannot be read are left out. Sources and writers are left open: use both in
    `with` blocks around. An interruption (Ctrl-C) ends all of them before it goes on.

    Args:
        sources: The cameras.
        writers: One for each.
        duration: Of each camera's time stamps [s].
        on_frame: Called with the camera's number and the time stamp [s] after a frame is written;
            from several threads.

    Returns:
        How many frames of each camera were written.

    Raises:
        ParameterError: There is not one writer for each source.
        GendomError: What a source or writer raised; the other cameras are ended.
    """
    what = f"{len(sources)} cameras and {len(writers)} writers"
    require(len(sources) == len(writers), what, fix="give one writer for each")
    counts = [0] * len(sources)
    faults: list[BaseException] = []
    ended = threading.Event()

    def run(k: int) -> None:
        try:
            for frame in _frames_for(sources[k], duration):
                if ended.is_set():
                    return
                try:
                    pictures = frame.read()
                except GendomError:
                    continue
                writers[k].write(frame.time, pictures)
                counts[k] += 1
                on_frame(k, frame.time)
        except BaseException as error:
            faults.append(error)
            ended.set()

    threads = [threading.Thread(target=run, args=(k,), daemon=True) for k in range(len(sources))]
    for thread in threads:
        thread.start()
    try:
        while any(thread.is_alive() for thread in threads):
            time.sleep(0.02)
    finally:
        ended.set()
        for thread in threads:
            thread.join()
    if faults:
        raise faults[0]
    return counts


def _frames_for(source: FrameSource, duration: float) -> Iterator[Frame]:
    """A source's frames until a duration [s] after the first."""
    first = None
    for frame in source:
        first = frame.time if first is None else first
        if frame.time - first > duration:
            return
        yield frame
