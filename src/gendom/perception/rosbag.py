"""The RealSense SDK's recordings, read without the SDK.

A .db3 file is a ROS 2 bag: an SQLite database whose table `messages` holds one row a message and
whose table `topics` names them. The topics are documented in the SDK (doc/record-and-playback.md);
those used here are, below /device_0/sensor_N/:

    Depth_0/camera_info         text "width=640;height=480;fx=...;model=...;coeffs=..."
    Depth_0/tf/ref_K            text "rotation=...;translation=...": from reference K to the stream
    Depth_0/image/metadata      text "timestamp=...;timestamp_domain=..."
    Depth_0/image/data...       the picture, of the same bag time as its metadata

and the same for Color_0. SDK 2.58 stored pictures raw and compressed each message by zstd;
since 2.59 pictures are PNG, and raw compressed by zstd in formats that PNG does not have.
Messages are in CDR (OMG DDS-XTypes 1.3, section 7.4, version 1).

Each picture is read separately on demand. Of a damaged or truncated file, all messages that SQLite
can read are used.
"""

from __future__ import annotations

import re
import sqlite3
import struct
import weakref
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gendom.arrays import Array, rigid
from gendom.datasets import Fault
from gendom.errors import RecordingError
from gendom.perception.camera import Camera, expect
from gendom.perception.frames import decode_png
from gendom.reading import MOST_UNPACKED, file_size

_SQLITE = b"SQLite format 3\0"
ZSTD = b"\x28\xb5\x2f\xfd"
_PNG = b"\x89PNG"
_ZSTD_FORMAT = re.compile(r"(\w+); zstd; (\d+)x(\d+) step=(\d+)$")

_COMPUTED = re.compile(r"\bvirtual\b|\bas\b\s*\(", re.IGNORECASE)

ANY_SIZE = 1 << 62
"""Of files that are read message by message [bytes]."""
LARGEST_MESSAGE = 1 << 27
"""Also when it is decompressed [bytes]."""

_DATA = re.compile(r"(/device_0/sensor_\d+/(Depth|Color)_\d+)/image/data(/compressed(Depth)?)?$")
_MAX_UNREADABLE_ROWS = 1000  # in sequence, before the rest is given up

# Distortion models by the SDK's names. It projects "Inverse Brown Conrady" by OpenCV's formula
# too, to 0.02 pixels at coefficients of 0.07 (rsutil.h).
_OPENCV = ("Brown Conrady", "Inverse Brown Conrady")
_PROJECTED = (*_OPENCV, "Modified Brown Conrady")


def open_database(path: Path) -> sqlite3.Connection:
    """A bag's database for reading; RecordingError: it is missing, or no database of plain tables:
    what views, virtual tables and computed columns yield may have no end."""
    where = str(path)
    file_size(path, RecordingError, most=ANY_SIZE)
    with open(path, "rb") as file:
        fix = "record it with the RealSense SDK or ROS 2, or copy it"
        expect(file.read(16) == _SQLITE, "is no .db3 recording", where=where, fix=fix)
    # Immutable: no journal is looked for and no lock taken, so any folder will do. The schema
    # counts as writable so that SQLite reads files shorter than their header says.
    address = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
    database = sqlite3.connect(address, uri=True, check_same_thread=False)
    database.execute("PRAGMA writable_schema = ON")
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_MESSAGE)
    try:
        made = database.execute("SELECT type, name, sql FROM sqlite_master LIMIT 1000").fetchall()
    except sqlite3.DatabaseError as error:
        database.close()
        what = f"has no table of topics ({error})"
        raise RecordingError(what, where=where, fix="copy it again") from None
    for kind, name, sql in made:
        plain = kind in ("table", "index") and not _COMPUTED.search(str(sql or ""))
        what = f"has {str(name)[:40]!r}, which is no plain table"
        expect(plain, what, where=where, fix="copy it again")
    return database


@dataclass(frozen=True, eq=False)
class Entry:
    """A picture in the file."""

    row: int
    """Its message's number."""
    compressed: bool
    """Whether the message is a CompressedImage; else an Image."""
    time: float
    """Time stamp [s]."""
    domain: str
    """The clock it is of: "Global Time", "System Time" or "Hardware Clock"."""


@dataclass(frozen=True, eq=False)
class Stream:
    """One stream of pictures."""

    camera: Camera
    """Size and intrinsics."""
    T_stream_reference: Array
    """[4, 4] from the device's axes to the stream's [m]."""
    entries: list[Entry]
    """In order of time."""


class Bag:
    """A .db3 recording; `on_warning` is called with what is damaged.

    Raises:
        RecordingError: It is no recording of the SDK, or nothing in it can be read.
    """

    def __init__(self, path: str | Path, *, on_warning: Callable[[Fault], None] = lambda _: None):
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
            info = _pairs(self._first(where))
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
        return Stream(camera, self._extrinsics(prefix), list(self._entries(prefix, topic)))

    def _extrinsics(self, prefix: str) -> Array:
        topic = next((name for name in self._topics if name.startswith(f"{prefix}/tf/")), None)
        if topic is None:
            return np.eye(4)
        try:
            found = _pairs(self._first(topic))
            shift, turn = (
                np.array(found[name].split(","), float) for name in ("translation", "rotation")
            )
            return rigid(turn.reshape(3, 3).T, shift)  # column after column
        except (KeyError, ValueError) as error:
            raise self._error(f"{topic} is damaged ({error})", "record again") from None

    def _entries(self, prefix: str, topic: str) -> Iterator[Entry]:
        """Pictures whose metadata is there and whose time stamps increase."""
        stamps = {}
        for row, time in self._rows.get(self._topics.get(f"{prefix}/image/metadata", -1), []):
            try:
                values = _pairs(_Cdr(self._message(row)).string())
                stamp = float(values["timestamp"]) * 1e-3
                if not np.isfinite(stamp):
                    continue
            except (KeyError, ValueError):
                continue
            stamps[time] = stamp, values.get("timestamp_domain", "")
        last, left_out, compressed = -np.inf, 0, "/compressed" in topic
        for row, time in self._rows.get(self._topics[topic], []):
            stamp, domain = stamps.get(time, (np.nan, ""))
            if not stamp > last:
                left_out += 1
                continue
            last = stamp
            yield Entry(row, compressed, stamp, domain)
        if left_out:
            what = f"{left_out} pictures have no time stamp, or one that goes back; "
            what += "they are left out"
            fix = "record again if too much is missing"
            self._on_warning(Fault(what, f"{self.path}: {prefix}", fix, "warning"))

    def depth_unit(self) -> float | None:
        """The depth sensor's own setting [m a count]; None: unknown."""
        for name in self._topics:
            if name.endswith("/option/Depth_Units/value"):
                with suppress(ValueError):
                    if (unit := float(self._first(name))) > 0.0:
                        return unit
        return None

    def picture(self, entry: Entry, where: str) -> npt.NDArray[np.generic]:
        """A decoded picture: [height, width] uint16 or [height, width, 3] uint8, RGB, which
        messages call `where`; RecordingError: it is damaged or of an unknown format."""
        try:
            cdr = _Cdr(self._message(entry.row))
            for skip in (cdr.uint32, cdr.uint32, cdr.string):  # bag time [s], [ns]; stream's name
                skip()
            if entry.compressed:
                form = cdr.string()
                return packed_picture(cdr.sequence(), form, where)
            height, width = cdr.uint32(), cdr.uint32()
            encoding = cdr.string()
            order, step = "<>"[cdr.uint8() & 1], cdr.uint32()
            return raw_picture(cdr.sequence(), encoding, width, height, step, order, where)
        except ValueError as error:
            what = f"is damaged ({str(error)[:80]})"
            raise RecordingError(what, where=where, fix="copy the file again") from None

    def _message(self, row: int) -> bytes:
        """A message's bytes; ValueError: it cannot be read."""
        try:
            query = "SELECT data FROM messages WHERE id = ?"
            (data,) = self._database.execute(query, (row,)).fetchone() or (None,)
        except sqlite3.DatabaseError as error:
            raise ValueError(str(error)) from None
        if not isinstance(data, bytes):
            raise ValueError("no such message")
        return decompressed(data)

    def _first(self, topic: str) -> str:
        """The text of a topic's first message; ValueError: there is none that can be read."""
        if not (rows := self._rows.get(self._topics.get(topic, -1))):
            raise ValueError("no message of it is left")
        return _Cdr(self._message(rows[0][0])).string()


def _pairs(text: str) -> dict[str, str]:
    return dict(pair.split("=", 1) for pair in text.split(";") if "=" in pair)


def decompressed(data: bytes, codec: str = "zstd") -> bytes:
    """Decompress data by zstd, if they are so compressed, or by another codec of pyarrow;
    ValueError: they are damaged, or unpack to more than `LARGEST_MESSAGE`, or than 16 MB and
    `MOST_UNPACKED` times their size."""
    if codec == "zstd" and not data.startswith(ZSTD):
        return data
    import pyarrow  # late: few recordings need it

    most = min(LARGEST_MESSAGE, max(1 << 24, MOST_UNPACKED * len(data)))
    try:
        with pyarrow.CompressedInputStream(pyarrow.BufferReader(data), codec) as stream:
            found = stream.read(most + 1)
    except (OSError, pyarrow.ArrowException) as error:
        raise ValueError(str(error)) from None
    if len(found) > most:
        raise ValueError(f"unpacks to more than {most} bytes")
    return found


def packed_picture(data: bytes, form: str, where: str) -> npt.NDArray[np.generic]:
    """The picture of a CompressedImage, whose format is "16UC1; compressedDepth png", "rgb8; png
    compressed bgr8" or "rgb8; zstd; 64x48 step=192"; ValueError: it is damaged, RecordingError: so
    is the PNG, or the format is unknown."""
    if raw := _ZSTD_FORMAT.match(form):
        width, height, step = (int(raw[k]) for k in (2, 3, 4))
        return raw_picture(decompressed(data), raw[1], width, height, step, "<", where)
    # Depth has twelve bytes more in front (compressed_depth_image_transport).
    picture = decode_png(data[max(data.find(_PNG, 0, 16), 0) :], where)
    if picture.mode.startswith("I"):
        return np.asarray(picture).astype(np.uint16, copy=False)
    return np.asarray(picture.convert("RGB"))


def raw_picture(
    data: bytes, encoding: str, width: int, height: int, step: int, order: str, where: str
) -> npt.NDArray[np.generic]:
    """A picture of raw rows, `step` bytes apart."""
    if (form := _RAW.get(encoding.lower())) is None:
        fix = "record colour as RGB8, depth as Z16"
        raise RecordingError(f"is stored as {encoding}", where=where, fix=fix)
    size, places = form
    row = width * size
    step = row if step in (0, len(data)) else step  # where drivers leave it 0, or give the whole
    if step < row or len(data) < step * height or not 0 < height * width < 2**28:
        raise ValueError("fewer pixels than its size says")
    rows = np.frombuffer(data, np.uint8, step * height).reshape(height, step)[:, :row]
    if not places:
        kind = f"{'u' if size == 2 else 'f'}{size}"
        return np.ascontiguousarray(rows).view(order + kind).astype(kind)
    return np.ascontiguousarray(rows.reshape(height, width, size)[:, :, places])


# Raw formats by the names of ROS or the SDK: bytes a pixel, and which of them are red, green and
# blue; none: it is depth.
_RAW: dict[str, tuple[int, list[int]]] = {
    "mono16": (2, []),
    "16uc1": (2, []),
    "32fc1": (4, []),
    "rgb8": (3, [0, 1, 2]),
    "bgr8": (3, [2, 1, 0]),
    "rgba8": (4, [0, 1, 2]),
    "bgra8": (4, [2, 1, 0]),
}


class _Cdr:
    """Values of a CDR message one after the other, numbers aligned to their size; ValueError: it
    is too short, or no CDR."""

    def __init__(self, message: bytes):
        if len(message) < 4 or message[0] != 0 or message[1] not in (0, 1):
            raise ValueError("no CDR")
        self._order = "<" if message[1] else ">"
        self._data = message[4:]
        self.at = 0

    def uint8(self) -> int:
        return self._take(1)[0]

    def uint32(self) -> int:
        self.at += -self.at % 4
        return struct.unpack(f"{self._order}I", self._take(4))[0]

    def string(self) -> str:
        """Text up to its final zero byte."""
        return self.sequence().rstrip(b"\0").decode("utf-8", errors="replace")

    def sequence(self) -> bytes:
        return self._take(self.uint32())

    def _take(self, size: int) -> bytes:
        taken = self._data[self.at : self.at + size]
        if len(taken) < size:
            raise ValueError("ends too early")
        self.at += size
        return taken
