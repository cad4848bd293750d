"""RealSense recordings as a source of frames.

A camera's folder holds one recording, .db3 of any name as the SDK or its viewer records it, and
camera.toml with T_world_camera. Colour is aligned with depth. Time is the depth picture's own time
stamp [s]: with the SDK's "Global Time", its default, on the clock of the computer that recorded.

A .db3 file is a bag of ROS 2 whose topics the SDK documents (doc/record-and-playback.md); it is
read without the SDK. Those used here are, below /device_0/sensor_N/, and the same for Color_0:

    Depth_0/camera_info         text "width=640;height=480;fx=...;model=...;coeffs=..."
    Depth_0/tf/ref_K            text "rotation=...;translation=...": from reference K to the stream
    Depth_0/image/metadata      text "timestamp=...;timestamp_domain=..."
    Depth_0/image/data...       the picture, of the same bag time as its metadata

SDK 2.58 stored pictures raw and compressed each message by zstd; since 2.59 pictures are PNG, and
raw compressed by zstd in formats that PNG does not have. Each is read separately on demand: of a
damaged or truncated file all messages that SQLite can read are used. A .bag file is refused with
the command by which the SDK converts it.
"""

import hashlib
import os
import re
import sqlite3
import weakref
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arrays import Array, rigid
from gendom.datasets import Fault
from gendom.datasets.npz import short
from gendom.errors import DeviceError, RecordingError
from gendom.files import atomic_path
from gendom.installation import how_to_install
from gendom.perception.aligned import aligned
from gendom.perception.camera import Camera, expect
from gendom.perception.camera_file import read_camera
from gendom.perception.frames import Frame
from gendom.perception.ros_bag import ANY_SIZE, decompressed, open_database
from gendom.perception.ros_messages import IMAGE, PACKED, picture_of
from gendom.reading import file_size, read_bytes

_DATA = re.compile(r"(/device_0/sensor_\d+/(Depth|Color)_\d+)/image/data(/compressed(Depth)?)?$")
_MAX_UNREADABLE_ROWS = 1000  # in sequence, before the rest is given up
_TEXT = "std_msgs/msg/String"

# Distortion models by the SDK's names. It projects "Inverse Brown Conrady" by OpenCV's formula
# too, to 0.02 pixels at coefficients of 0.07 (rsutil.h).
_OPENCV = ("Brown Conrady", "Inverse Brown Conrady")
_PROJECTED = (*_OPENCV, "Modified Brown Conrady")
_DEVICE_CLOCK = "Hardware Clock"


def is_recording(path: str | os.PathLike) -> bool:
    """Whether a file has the suffix of a RealSense recording."""
    return Path(path).suffix.lower() in (".db3", ".bag")


class RealSenseRecording:
    """A recording of a RealSense camera, as a `FrameSource`.

    Args:
        path: The .db3 file, or its folder, which names the camera; camera.toml is looked
            for beside it.
        on_warning: Called with every fault that does not prevent use.

    Raises:
        RecordingError: It is damaged from its start, without depth, or unlike camera.toml.
    """

    def __init__(
        self, path: str | os.PathLike, *, on_warning: Callable[[Fault], None] = lambda _: None
    ):
        self.path = Path(path)
        if self.path.is_dir():
            self.path = self.find(self.path) or self.path
        file_size(self.path, RecordingError, most=ANY_SIZE)  # a pipe would wait
        _check_checksum(self.path)
        bag = Bag(self.path, on_warning=on_warning)
        where, name = str(self.path), self.path.resolve().parent.name
        depth, colour = bag.stream("Depth", name), bag.stream("Color", f"{name}: colour")
        what = "has no depth pictures" if depth is None else "no depth picture can be read"
        expect(depth and depth.entries, what, where, "record the depth stream (Z16)")
        assert depth is not None
        unit, fix = bag.depth_unit(), "record it with the RealSense SDK"
        expect(unit is not None, "does not say its depth unit", where, fix)
        camera = replace(depth.camera, depth_unit=unit)
        beside = self.path.with_name("camera.toml")
        self.camera: Camera = read_camera(beside, recorded=camera) if beside.exists() else camera
        self._depth = depth.entries
        self._beside: tuple[Any, ...] = ()
        if colour is not None and colour.entries:
            T = colour.T_stream_reference @ np.linalg.inv(depth.T_stream_reference)
            self._beside = colour.camera, colour.entries, T
        if depth.clock == _DEVICE_CLOCK:
            what = "its time stamps are of the camera's own clock"
            fix = "record with the option Global Time Enabled to compare them with other clocks"
            on_warning(Fault(what, where, fix, "warning"))

    def __iter__(self) -> Iterator[Frame]:
        return aligned(self.camera, self._depth, *self._beside)

    @staticmethod
    def find(folder: Path) -> Path | None:
        """The recording in a camera's folder; None: there is none, RecordingError: several are."""
        found = sorted(filter(is_recording, folder.iterdir()))
        found = [path for path in found if path.suffix.lower() == ".db3"] or found
        what = f"holds {len(found)} recordings, {', '.join(p.name for p in found)}"
        expect(len(found) <= 1, what, str(folder), "leave one in the camera's folder")
        return found[0] if found else None


def write_checksum(path: Path) -> None:
    """Write the SHA-256 of a recording beside it, as ``sha256sum`` does: uncompressed pictures have
    no checksum of their own."""
    with atomic_path(path.with_name(path.name + ".sha256")) as temporary:
        temporary.write_text(f"{_checksum(path)}  {path.name}\n", encoding="utf-8")


def _check_checksum(path: Path) -> None:
    """Check a recording against the checksum beside it, if there is one."""
    if not (beside := path.with_name(path.name + ".sha256")).exists():
        return
    stated = read_bytes(beside, error=RecordingError).split(b" ", 1)[0]
    same = stated.decode("ascii", "replace") == _checksum(path)
    fix = f"copy it again, or delete {beside.name} to use what is left of it"
    expect(same, "differs from its checksum", str(path), fix)


def _checksum(path: Path) -> str:
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise RecordingError(f"cannot be read ({error.strerror})", where=str(path)) from None


def realsense_sdk() -> Any:
    """The module pyrealsense2; DeviceError: it is missing or does not load."""
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


@dataclass(frozen=True, eq=False)
class Stream:
    """One stream of pictures."""

    camera: Camera
    """Size and intrinsics."""
    T_stream_reference: Array
    """[4, 4] from the device's axes to the stream's [m]."""
    entries: list[Frame]
    """In order of time."""
    clock: str
    """Of the first one's time: "Global Time", "System Time" or "Hardware Clock"."""


class Bag:
    """A .db3 recording; `on_warning` is called with what is damaged.

    Raises:
        RecordingError: It is no recording of the SDK, or nothing in it can be read.
        ModuleNotFoundError: There is no rosbags.
    """

    def __init__(self, path: str | Path, *, on_warning: Callable[[Fault], None] = lambda _: None):
        from rosbags.typesys import Stores, get_typestore

        self._types = get_typestore(Stores.ROS2_HUMBLE)
        self.path = Path(path)
        self._on_warning = on_warning
        self._database, self._most = open_database(self.path), file_size(self.path, most=ANY_SIZE)
        weakref.finalize(self, self._database.close)
        try:
            topics = self._database.execute("SELECT id, name FROM topics").fetchall()
        except sqlite3.DatabaseError as error:
            raise self._error(f"has no table of topics ({error})", "copy it again") from None
        self._topics = {str(name): number for number, name in topics}
        self._rows = self._index()

    def _error(self, what: str, fix: str) -> RecordingError:
        return RecordingError(what, where=str(self.path), fix=fix)

    def _index(self) -> dict[int, list[tuple[int, int]]]:
        """(row, bag time) of all messages by topic; warns of those that cannot be read."""
        rows: dict[int, list[tuple[int, int]]] = {}
        last = lost = 0
        query = "SELECT id, topic_id, timestamp FROM messages "
        try:
            for found in self._database.execute(f"{query} ORDER BY id LIMIT ?", (self._most,)):
                last, topic, time = found
                rows.setdefault(topic, []).append((last, time))
            return rows
        except sqlite3.DatabaseError:
            row = last
        # A page on the way is damaged. Others behind it may still be found by number.
        while (row := row + 1) <= last + _MAX_UNREADABLE_ROWS:
            with suppress(sqlite3.DatabaseError):
                if found := self._database.execute(f"{query} WHERE id = ?", (row,)).fetchone():
                    lost, last = lost + row - last - 1, row
                    rows.setdefault(found[1], []).append((row, found[2]))
        middle = f"{lost} messages in the middle and all after number {last}"
        what = f"is damaged or cut off: {middle if lost else f'all after message {last}'} are lost"
        fix = "copy it again, or record again if too much is missing"
        self._on_warning(Fault(what, str(self.path), fix, "warning"))
        return rows

    def stream(self, kind: str, name: str = "") -> Stream | None:
        """The first stream of a kind, "Depth" or "Color"; None: there is none.

        Messages call its camera `name`. RecordingError: its geometry is missing, damaged or of a
        kind that cannot be used.
        """
        matches = [m for m in map(_DATA.match, sorted(self._topics)) if m and m[2] == kind]
        if not matches:
            return None
        topic, prefix = matches[0][0], matches[0][1]
        where = f"{prefix}/camera_info"
        try:
            info = self._pairs(self._first(where))
            width, height = int(info["width"]), int(info["height"])
            fx, fy, cx, cy = (float(info[key]) for key in ("fx", "fy", "ppx", "ppy"))
            coefficients = tuple(float(k) for k in info["coeffs"].split(","))
            model = info["model"]
        except (KeyError, ValueError) as error:
            fix = "copy the file again, or record again; depth needs intrinsics"
            raise self._error(f"{where} is missing or damaged ({error})", fix) from None
        known = _PROJECTED if kind == "Color" else _OPENCV
        if not any(coefficients) or model in ("None", ""):
            coefficients = ()
        elif model not in known:
            what = f"{kind} has the distortion {model!r}, which is not known here"
            raise self._error(what, f"use a camera whose distortion is one of {', '.join(known)}")
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        size = {"width": width, "height": height, "distortion": coefficients}
        camera = Camera(name=name or kind, K=K, T_world_camera=None, **size)
        entries, clock = self._entries(prefix, topic)
        return Stream(camera, self._extrinsics(prefix), entries, clock)

    def _extrinsics(self, prefix: str) -> Array:
        topic = next((name for name in self._topics if name.startswith(f"{prefix}/tf/")), None)
        if topic is None:
            return np.eye(4)
        try:
            found = self._pairs(self._first(topic))
            shift, turn = (
                np.array(found[name].split(","), float) for name in ("translation", "rotation")
            )
            return rigid(turn.reshape(3, 3).T, shift)  # column after column
        except (KeyError, ValueError) as error:
            raise self._error(f"{topic} is damaged ({error})", "record again") from None

    def _entries(self, prefix: str, topic: str) -> tuple[list[Frame], str]:
        """Pictures with metadata, whose time stamps increase, and the clock of these."""
        stamps = {}
        for row, time in self._rows.get(self._topics.get(f"{prefix}/image/metadata", -1), []):
            with suppress(KeyError, ValueError):
                values = self._pairs(row)
                stamps[time] = float(values["timestamp"]) * 1e-3, values["timestamp_domain"]
        found, rows = [], self._rows.get(self._topics[topic], [])
        kind = PACKED if "/compressed" in topic else IMAGE
        for row, time in rows:
            stamp, _ = stamps.get(time, (np.nan, ""))
            if (found[-1].time if found else -np.inf) < stamp < np.inf:
                where = f"{self.path}: frame {len(found)}{': colour' * ('/Color_' in topic)}"
                read = partial(self._picture, row, kind, where)
                found.append(Frame(stamp, where, read))
        if left_out := len(rows) - len(found):
            what = f"{left_out} pictures have no time stamp, or one that goes back; "
            what += "they are left out"
            fix = "record again if too much is missing"
            self._on_warning(Fault(what, f"{self.path}: {prefix}", fix, "warning"))
        return found, next((clock for _, clock in stamps.values()), "")

    def depth_unit(self) -> float | None:
        """The depth sensor's own setting [m a count]; None: unknown."""
        for name in self._topics:
            if name.endswith("/option/Depth_Units/value"):
                with suppress(ValueError):
                    if (unit := float(self._message(self._first(name), _TEXT).data)) > 0.0:
                        return unit
        return None

    def _picture(self, row: int, kind: str, where: str) -> Array:
        """The picture of a message; RecordingError: it is damaged or of an unknown format."""
        try:
            message = self._message(row, kind)
        except ValueError as error:
            what = f"is damaged ({error})"
            raise RecordingError(what, where=where, fix="copy it again") from None
        return picture_of(message, kind, where)

    def _message(self, row: int, kind: str) -> Any:
        """A message of a type; ValueError: it cannot be read."""
        try:
            query = "SELECT data FROM messages WHERE id = ?"
            (data,) = self._database.execute(query, (row,)).fetchone() or (b"",)
            return self._types.deserialize_cdr(decompressed(bytes(data)), kind)
        except Exception as error:  # SQLite's, and whatever decoders make of damaged data
            raise ValueError(short(error)[:80]) from None

    def _pairs(self, row: int) -> dict[str, str]:
        """What the text of a message says: "key=value;..."."""
        text = self._message(row, _TEXT).data
        return dict(pair.split("=", 1) for pair in text.split(";") if "=" in pair)

    def _first(self, topic: str) -> int:
        """The number of a topic's first message; ValueError: there is none."""
        if not (rows := self._rows.get(self._topics.get(topic, -1))):
            raise ValueError("no message of it is left")
        return rows[0][0]
