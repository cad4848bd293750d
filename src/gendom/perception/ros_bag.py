"""The files of ROS bags, both versions, opened by rosbags once they are found harmless."""

import heapq
import os
import re
import sqlite3
import weakref
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

from gendom.datasets.folder import bag_files
from gendom.datasets.npz import short
from gendom.errors import RecordingError
from gendom.perception.camera import expect
from gendom.perception.frames import Frame
from gendom.perception.ros_frames import stamp
from gendom.reading import MOST_UNPACKED, check_unpacked, file_size, read_bytes

ANY_SIZE = 1 << 62
"""Of files that are read message by message [bytes]."""
LARGEST_MESSAGE = 1 << 27
"""Also when it is decompressed [bytes]."""
LATE = 3
"""How many messages of a topic may come before one of an earlier time stamp: networks and
recorders change places."""

_SQLITE, _ZSTD = b"SQLite format 3\0", b"\x28\xb5\x2f\xfd"
_COMPUTED = re.compile(r"\bvirtual\b|\bas\b\s*\(", re.IGNORECASE)

_LARGEST_METADATA, _MOST_MARKS = 1 << 17, 6000  # [bytes], lines and parts: YAML is read slowly
_ROS1 = b"#ROSBAG V2.0\n"
_STANDARD = ("geometry_msgs/", "sensor_msgs/", "std_msgs/", "tf2_msgs/")


class RosBag:
    """A bag that is open until it is deleted.

    Raises:
        RecordingError: It cannot be read, here or while its messages are.
        ModuleNotFoundError: There is no rosbags.
    """

    def __init__(self, path: str | os.PathLike):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        self.path, self.where = Path(path), str(path)
        files, store = bag_files(path), get_typestore(Stores.ROS2_HUMBLE)
        expect(bool(files) and self.path.exists(), "no such bag", self.where, "check the path")
        try:
            for file in files if files[0].is_file() else sorted(files[0].iterdir()):
                _check_file(file)
            self._reader = AnyReader(files, default_typestore=store)
            self._reader.open()
        except (RecordingError, ModuleNotFoundError):
            raise
        except Exception as error:
            raise self._fault(error) from error
        weakref.finalize(self, self._reader.close)
        for kind, (_, fields) in self._reader.typestore.fielddefs.items():
            if kind.startswith(_STANDARD) and kind in store.fielddefs:
                spelt = str.lower if kind.endswith("CameraInfo") else str  # K of ROS 1 is k now
                lacking = {name for name, _ in store.fielddefs[kind][1]}
                lacking -= {spelt(name) for name, _ in fields}
                what = f"its definition of {kind} lacks {', '.join(sorted(lacking))}"
                expect(not lacking, what, where=self.where, fix="give the bag, whole")
        self.topics: dict[str, str] = {c.topic: c.msgtype for c in self._reader.connections}
        self.counts = {n: topic.msgcount for n, topic in self._reader.topics.items()}

    def _fault(self, error: Exception) -> RecordingError:
        """Of the reader, and of whatever its decoders make of damaged data."""
        what = f"cannot be read as a ROS bag ({short(error)})"
        fix = "give the bag, whole; rosbag reindex or ros2 bag reindex may mend it"
        return RecordingError(what, where=self.where, fix=fix)

    def messages(self, *topics: str) -> Iterator[tuple[str, Any]]:
        """Topics and messages of some topics, in the order in which they came."""
        wanted = [c for c in self._reader.connections if c.topic in topics]
        stream = self._reader.messages(connections=wanted) if wanted else iter(())
        while True:
            try:
                connection, _, data = next(stream)
                message = self._reader.deserialize(data, connection.msgtype)
            except StopIteration:
                return
            except Exception as error:
                raise self._fault(error) from error
            yield connection.topic, message

    def first(self, topic: str) -> Any:
        """A topic's first message; None: it has none."""
        return next((message for _, message in self.messages(topic)), None)

    def frames(
        self, topic: str, read: Callable[[Any, str], Any] = lambda message, _: message
    ) -> Iterator[Frame]:
        """A topic's messages with their times, in order of these where none came more than `LATE`
        messages late; a frame's `read` gives what a function makes of a message and of what
        messages to people call it."""
        waiting: list[tuple[float, int, Frame]] = []
        for k, (_, message) in enumerate(self.messages(topic)):
            where, time = f"{self.where}: {topic}: frame {k}", stamp(message.header)
            frame = Frame(time, where, partial(read, message, where))
            heapq.heappush(waiting, (time, k, frame))
            if len(waiting) > LATE:
                yield heapq.heappop(waiting)[2]
        while waiting:
            yield heapq.heappop(waiting)[2]


def open_database(path: Path) -> sqlite3.Connection:
    """A bag's database for reading; RecordingError: it is missing, or no database of plain tables:
    what views, virtual tables and computed columns yield may have no end."""
    where = str(path)
    file_size(path, RecordingError, most=ANY_SIZE)
    with open(path, "rb") as file:
        head, fix = file.read(16), "record it with the RealSense SDK or ROS 2, or copy it"
    if head.startswith(_ROS1[:7]):
        fix = "convert it by the SDK: python -c 'import pyrealsense2 as rs; rs.context()"
        fix += f'.convert_bag_to_db3("{path}", "{path.with_suffix(".db3")}")\''
    expect(head == _SQLITE, "is no .db3 recording", where, fix)
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
        expect(plain, what, where, "copy it again")
    return database


def decompressed(data: bytes, codec: str = "zstd") -> bytes:
    """Decompress data by zstd, if they are so compressed, or by another codec of pyarrow;
    ValueError: they are damaged, or unpack to more than `LARGEST_MESSAGE`, or than 16 MB and
    `MOST_UNPACKED` times their size."""
    if codec == "zstd" and not data.startswith(_ZSTD):
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


def _check_file(path: Path) -> None:
    """Refuse a bag's file that is no regular file or plain database, or in which something is
    damaged or unpacks to too much."""
    if path.suffix == ".yaml":
        text = read_bytes(path, RecordingError, most=_LARGEST_METADATA)
        marks = sum(map(text.count, (b"\n", b"[", b"{", b",", b"- ", b"? ")))
        what, fix = f"has {marks} lines and parts, at most {_MOST_MARKS} are read", "split the bag"
        expect(marks <= _MOST_MARKS, what, str(path), fix)
    elif path.suffix == ".db3":
        with closing(open_database(path)) as database:
            packed = "SELECT data FROM messages WHERE substr(data, 1, 4) = ?"
            for (data,) in database.execute(packed, (_ZSTD,)):
                decompressed(data)
    elif check := {".bag": _check_bag, ".mcap": _check_chunks, ".zstd": _check_stream}.get(
        path.suffix
    ):
        size = file_size(path, RecordingError, most=ANY_SIZE)
        with open(path, "rb") as file:
            check(file, size)


def _check_bag(file: BinaryIO, size: int) -> None:
    """Unpack each chunk of a bag of ROS 1 (its format 2.0: records of a header and data, both with
    their length in front)."""
    expect(file.read(len(_ROS1)) == _ROS1, "is no bag", file.name, "give a bag of ROS, or copy it")
    at = len(_ROS1)
    while at < size:
        file.seek(at)
        header = file.read(min(_length(file), size))
        length = _length(file)
        at = file.tell() + length
        for codec in ("lz4", "bz2"):
            if b"compression=" + codec.encode() in header:
                decompressed(file.read(min(length, size)), codec)


def _length(file: BinaryIO) -> int:
    return int.from_bytes(file.read(4), "little")


def _check_chunks(file: BinaryIO, size: int) -> None:
    """Unpack each chunk of a .mcap file (its specification, "Chunk")."""
    at = 8
    while at < size:
        file.seek(at)
        head = file.read(49)
        kind, length = head[0], int.from_bytes(head[1:9], "little")
        if kind == 6 and len(head) == 49:
            word = int.from_bytes(head[37:41], "little")
            codec = (head[41:] + file.read(word))[: min(word, 8)].decode("latin-1")
            file.seek(at + 49 - 8 + word)
            packed = file.read(min(int.from_bytes(file.read(8), "little"), size))
            if codec in ("lz4", "zstd"):
                decompressed(packed, codec)
        at += 9 + length


def _check_stream(file: BinaryIO, size: int) -> None:
    """Unpack a file of zstd, piece by piece."""
    import pyarrow

    there = 0
    with pyarrow.CompressedInputStream(file, "zstd") as stream:
        while piece := stream.read(1 << 20):
            there += len(piece)
            check_unpacked(there, size, "compressed file", RecordingError)
