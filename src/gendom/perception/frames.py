"""Frames of depth cameras: the contract of their sources, matching by time stamp, PNG files."""

import io
import struct
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from PIL import Image

from gendom.arguments import time_text
from gendom.arrays import Array
from gendom.datasets import Fault
from gendom.errors import RecordingError
from gendom.perception.camera import Camera, expect
from gendom.reading import MOST_PIXELS, read_bytes

SYNC_TOLERANCE = 0.02
"""Frames of different cameras further apart than this [s] do not belong together."""

_ROUNDING = 1e-9  # [s]; time stamps apart by just the tolerance match
# Exceptions that Pillow raises for damaged or vast pictures.
_PNG_ERRORS = (OSError, SyntaxError, ValueError, EOFError, struct.error, zlib.error)
_PNG_ERRORS += (Image.DecompressionBombError, Image.DecompressionBombWarning)


@dataclass(frozen=True, eq=False)
class Pictures:
    """What a camera saw at one moment, its colour aligned with its depth."""

    depth: npt.NDArray[np.uint16]
    """[height, width] counts of the camera's depth unit along its axis; 0: no depth."""
    colour: npt.NDArray[np.uint8] | None = None
    """[height, width, 3] sRGB, pixel for pixel as depth; None: the camera gives none."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame of a camera: a time and its pictures."""

    time: float
    """Time stamp [s] on a clock that all cameras share."""
    where: str
    """What messages call it."""
    read: Callable[[], Any]
    """`Pictures` (of a single sensor or a bag's topic: its picture or message), fetched or decoded
    when called; raises `RecordingError` when damaged."""


@runtime_checkable
class FrameSource(Protocol):
    """A depth camera: recorded pictures, a vendor's recording or a device.

    Iterating gives frames in order of time. Pictures are decoded only by `Frame.read`, so
    unmatched frames cost nothing.
    """

    @property
    def camera(self) -> Camera:
        """Intrinsics, depth unit and pose."""
        ...

    def __iter__(self) -> Iterator[Frame]: ...


class CameraReader(Protocol):
    """A kind of recorded camera: a class of `FrameSource` with `find`, whose folder is cameras/NAME
    of a recording. `gendom.perception.read_camera` reads its camera.toml."""

    def find(self, folder: Path) -> Path | None:
        """The file that tells that a camera's folder is of this kind; None: it is not."""
        ...

    def __call__(self, folder: Path, *, on_warning: Callable[[Fault], None]) -> FrameSource:
        """The frames of a folder in which `find` finds a file; faults that do not prevent use go to
        `on_warning`, others raise `RecordingError`."""
        ...


class MatchedFrames:
    """Sets of frames, one of each source, whose time stamps lie within a tolerance.

    Each frame is used once at most. Of two sets that compete for a frame the closer one wins,
    as far as one frame of look-ahead shows. Iterate once; then the attributes are final.

    Args:
        sources: Frames in order of time; iterating raises `RecordingError` where they are not.
        tolerance: Largest difference of time stamps in a set [s].

    Attributes:
        used: Sets of frames given.
        alone: Frames of each source that no other source's frame belonged to.
        spans: First and last time stamp of each source [s].
    """

    def __init__(self, sources: Sequence[Iterable[Frame]], tolerance: float = SYNC_TOLERANCE):
        self._sources, self._tolerance = sources, tolerance
        self.used, self.alone = 0, [0] * len(sources)
        self.spans = [(np.nan, np.nan)] * len(sources)

    def __iter__(self) -> Iterator[tuple[Frame, ...]]:
        streams, each = [_in_order(source) for source in self._sources], range(len(self._sources))
        following = [next(stream, None) for stream in streams]
        heads: list[Frame | None] = [None for _ in each]

        def step(k: int) -> None:
            heads[k], following[k] = following[k], next(streams[k], None)
            if (head := heads[k]) is not None:
                first = self.spans[k][0]
                self.spans[k] = (head.time if np.isnan(first) else first, head.time)

        for k in each:
            step(k)
        while all(heads):
            frames = tuple(filter(None, heads))
            times = np.array([frame.time for frame in frames])
            spread, k = np.ptp(times), int(times.argmin())
            if (after := following[k]) is not None:
                times[k] = after.time
            if spread > self._tolerance + _ROUNDING or np.ptp(times) < spread:
                self.alone[k] += 1
                step(k)
            else:
                self.used += 1
                yield frames
                for k in each:
                    step(k)
        for k in each:
            while heads[k] is not None:
                self.alone[k] += 1
                step(k)

    def left_out(self, names: Iterable[str]) -> Iterator[Fault]:
        """A warning of each source, by what messages call it, some of whose frames were alone."""
        for name, alone in zip(names, self.alone, strict=True):
            if alone:
                what = f"{alone} of {alone + self.used} frames match no frame of the others within "
                what += f"{self._tolerance:g} s; they are left out"
                yield Fault(what, name, "check the cameras' clocks if there are many", "warning")


def _in_order(source: Iterable[Frame]) -> Iterator[Frame]:
    last = -np.inf
    for frame in source:
        what = f"time goes from {time_text(last)} s to {time_text(frame.time)} s"
        expect(frame.time > last, what, frame.where, "sort the frames and drop repeated ones")
        yield frame
        last = frame.time


def interpolate(times: Array, values: Array, time: float) -> Array:
    """Values [...] at a time, linear between rows [M, ...] at times [M]; constant outside."""
    k = int(np.searchsorted(times, time))
    before, after = max(k - 1, 0), min(k, len(times) - 1)
    step = times[after] - times[before]
    share = (time - times[before]) / step if step > 0.0 else 0.0
    return (1.0 - share) * values[before] + share * values[after]


def read_png(path: Path) -> Image.Image:
    """A decoded PNG file whose checksums hold; RecordingError: it is missing, damaged or large."""
    fix = "the recording was cut off; record it again"
    return decode(read_bytes(path, RecordingError, fix=fix), str(path))


def decode(data: bytes, where: str, form: str = "PNG") -> Image.Image:
    """The same of a file's bytes, which messages call `where`; also of the form "JPEG"."""
    try:
        with (
            warnings.catch_warnings(action="error"),
            Image.open(io.BytesIO(data), formats=[form]) as picture,
        ):
            width, height = picture.size  # of its header
            what, fix = f"has {width} x {height} pixels", f"give pictures of {MOST_PIXELS} at most"
            expect(width * height <= MOST_PIXELS, what, where, fix)
            picture.verify()  # decoding alone lets some damage pass as wrong pixels
        picture = Image.open(io.BytesIO(data), formats=[form])
        picture.load()
    except _PNG_ERRORS as error:
        reason = f"no {form}" if isinstance(error, Image.UnidentifiedImageError) else str(error)
        what = f"is damaged ({reason[:80] or type(error).__name__})"
        raise RecordingError(what, where=where, fix="copy it again") from None
    return picture
