"""The contracts of cameras and recorders, and the matching of frames by time stamp."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from gendom.arguments import require
from gendom.datasets import Fault
from gendom.errors import GendomError
from gendom.perception.camera import Camera

SYNC_TOLERANCE = 0.02
"""Frames of different cameras further apart than this [s] do not belong together."""

_ROUNDING = 1e-9  # [s]; time stamps apart by just the tolerance match


@dataclass(frozen=True, eq=False)
class Pictures:
    """What a camera saw at one moment, its colour aligned with its depth."""

    depth: npt.NDArray[np.uint16]
    """[height, width] counts of the camera's depth unit along its axis; 0: no depth."""
    colour: npt.NDArray[np.uint8] | None = None
    """[height, width, 3] sRGB, pixel for pixel as depth; None: the camera gives none."""


@dataclass(frozen=True)
class Frame:
    """One frame of a camera: a time and its pictures."""

    time: float
    """Time stamp [s] on a clock that all cameras share."""
    where: str
    """What messages call it."""
    read: Callable[[], Pictures]
    """The pictures, fetched or decoded when called; raises `RecordingError` when damaged."""


@runtime_checkable
class FrameSource(Protocol):
    """A depth camera: recorded pictures, a vendor's recording or a device.

    Iterating gives frames in order of time, once. A source that fails logs a warning with the
    reason and then ends. Pictures are decoded only by `Frame.read`, so unmatched frames cost
    nothing.
    """

    @property
    def camera(self) -> Camera:
        """Intrinsics, depth unit and pose."""
        ...

    def __iter__(self) -> Iterator[Frame]: ...


class CameraReader(Protocol):
    """A kind of recorded camera: a class of `FrameSource` with `find`.

    The folder is cameras/NAME of a recording. `gendom.perception.read_camera` reads its
    camera.toml.
    """

    def find(self, folder: Path) -> Path | None:
        """The file that tells that a camera's folder is of this kind; None: it is not."""
        ...

    def __call__(self, folder: Path, *, on_warning: Callable[[Fault], None]) -> FrameSource:
        """The folder's frames.

        Args:
            folder: One in which `find` finds a file.
            on_warning: Called with every fault that does not prevent use.

        Raises:
            RecordingError: It cannot be read.
        """
        ...


class FrameWriter(Protocol):
    """A writer of a camera's frames; close it when all are written."""

    def write(self, time: float, pictures: Pictures) -> None:
        """Append a frame; `time` [s] is later than the one before."""
        ...

    def close(self) -> None: ...


@dataclass
class Matching:
    """Statistics of the matching of frames."""

    used: int = 0
    """Sets of frames given."""
    alone: list[int] = field(default_factory=list)
    """Frames of each camera that no other camera's frame belonged to."""
    span: list[tuple[float, float]] = field(default_factory=list)
    """First and last time stamp of each camera [s]."""

    def spans(self, names: Sequence[str]) -> str:
        """`span` in words."""
        return ", ".join(
            f"{name} {first:.6g} to {last:.6g} s"
            for name, (first, last) in zip(names, self.span, strict=True)
        )


def match_frames(
    sources: Sequence[Iterable[Frame]],
    *,
    tolerance: float = SYNC_TOLERANCE,
    matching: Matching | None = None,
) -> Iterator[tuple[Frame, ...]]:
    """Sets of frames, one of each source, whose time stamps lie within a tolerance.

    Each frame is used once at most. Of two sets that compete for a frame the closer one wins,
    as far as one frame of look-ahead shows.

    Args:
        sources: Frames in order of time.
        tolerance: Largest difference of time stamps in a set [s].
        matching: Filled while iterating.

    Raises:
        GendomError: A source's time stamps do not increase.
    """
    count = Matching() if matching is None else matching
    count.alone = [0] * len(sources)
    count.span = [(np.nan, np.nan)] * len(sources)
    streams = [_Lookahead(source) for source in sources]

    def skip(k: int) -> None:
        streams[k].step()
        count.alone[k] += 1

    while all(stream.head is not None for stream in streams):
        heads = [stream.head for stream in streams if stream.head is not None]
        times = [frame.time for frame in heads]
        spread = max(times) - min(times)
        first = int(np.argmin(times))
        after = streams[first].following
        if spread > tolerance + _ROUNDING or _next_is_closer(times, first, after):
            skip(first)
        else:
            count.used += 1
            yield tuple(heads)
            for stream in streams:
                stream.step()
        count.span = [stream.span for stream in streams]
    for k, stream in enumerate(streams):
        while stream.head is not None:
            skip(k)
    count.span = [stream.span for stream in streams]


def _next_is_closer(times: list[float], first: int, after: Frame | None) -> bool:
    """Whether the frame after the earliest one would be closer to the others."""
    if after is None or len(times) == 1:
        return False
    others = [t for k, t in enumerate(times) if k != first]
    spread = max([*others, after.time]) - min([*others, after.time])
    return spread < max(times) - min(times)


class _Lookahead:
    """A source's current frame and the one after it."""

    def __init__(self, source: Iterable[Frame]):
        self._frames = iter(source)
        self.head: Frame | None = None
        self.following: Frame | None = next(self._frames, None)
        self.span = (np.nan, np.nan)
        self.step()

    def step(self) -> None:
        self.head, self.following = self.following, next(self._frames, None)
        if self.head is None:
            return
        first = self.head.time if np.isnan(self.span[0]) else self.span[0]
        self.span = (first, self.head.time)
        if (after := self.following) is not None:
            what = f"time goes from {self.head.time:.6g} s to {after.time:.6g} s"
            increases, fix = after.time > self.head.time, "sort the frames and drop repeated ones"
            require(increases, what, where=after.where, fix=fix, error=GendomError)


def interpolate(
    times: npt.NDArray[np.float64], values: npt.NDArray[np.float64], time: float
) -> npt.NDArray[np.float64]:
    """Values [...] at a time, linear between rows [M, ...] at times [M]; constant outside."""
    k = int(np.searchsorted(times, time))
    before, after = max(k - 1, 0), min(k, len(times) - 1)
    step = times[after] - times[before]
    share = (time - times[before]) / step if step > 0.0 else 0.0
    return (1.0 - share) * values[before] + share * values[after]
