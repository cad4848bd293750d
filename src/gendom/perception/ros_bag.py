"""The files of ROS bags, both versions, opened by rosbags once they are found harmless."""

from __future__ import annotations

import os
import weakref
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, BinaryIO

from gendom.datasets.folder import bag_files
from gendom.datasets.npz import short
from gendom.errors import RecordingError
from gendom.perception.camera import expect
from gendom.perception.frames import Frame
from gendom.perception.ros_frames import stamp
from gendom.perception.rosbag import ANY_SIZE, ZSTD, decompressed, open_database
from gendom.reading import check_unpacked, file_size, read_bytes

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
        there, fix = bool(files) and self.path.exists(), "check the path"
        expect(there, "no such bag", where=self.where, fix=fix)
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

    def frames(self, topic: str) -> Iterator[Frame]:
        """A topic's messages with their times, in order of these."""
        for k, (_, message) in enumerate(self.messages(topic)):
            where = f"{self.where}: {topic}: message {k}"
            yield Frame(stamp(message.header), where, lambda m=message: m)


def _check_file(path: Path) -> None:
    """Refuse a bag's file that is no regular file or plain database, or in which something is
    damaged or unpacks to too much."""
    if path.suffix == ".yaml":
        text = read_bytes(path, RecordingError, most=_LARGEST_METADATA)
        marks = sum(map(text.count, (b"\n", b"[", b"{", b",", b"- ", b"? ")))
        what, fix = f"has {marks} lines and parts, at most {_MOST_MARKS} are read", "split the bag"
        expect(marks <= _MOST_MARKS, what, where=str(path), fix=fix)
    elif path.suffix == ".db3":
        with closing(open_database(path)) as database:
            packed = "SELECT data FROM messages WHERE substr(data, 1, 4) = ?"
            for (data,) in database.execute(packed, (ZSTD,)):
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
    fix = "give a bag of ROS, or copy it"
    expect(file.read(len(_ROS1)) == _ROS1, "is no bag", where=file.name, fix=fix)
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
