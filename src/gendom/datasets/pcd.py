"""Point clouds in the format of the Point Cloud Library (PCD), version 0.7 and before.

A header of lines of text, then numbers as text (`ascii`), points one after another (`binary`), or
field after field, compressed (`binary_compressed`; LZF). Invalid points are NaN in the file, and
are left out. VIEWPOINT, the pose of the sensor, is not applied.

Source: the library's documentation, "The PCD (Point Cloud Data) file format"; LibLZF by Marc
Lehmann.
"""

from __future__ import annotations

import os
import re
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gendom.errors import RecordingError
from gendom.files import read_bytes

_MAX_HEADER = 1 << 16
_KINDS = {"I": "i", "U": "u", "F": "f"}
_SIZES = {"i": (1, 2, 4, 8), "u": (1, 2, 4, 8), "f": (4, 8)}
_KEYS = ("VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT")
_KEYS += ("WIDTH", "HEIGHT", "VIEWPOINT", "POINTS")
_MOST = 1 << 16  # numbers in one field of a point


@dataclass(frozen=True)
class _Header:
    names: list[str]
    types: list[np.dtype]
    counts: list[int]
    points: int
    encoding: str
    start: int
    """Offset of the data [bytes]."""

    @property
    def row(self) -> np.dtype:
        """NumPy type of one point."""
        fields = zip(self.types, self.counts, strict=True)
        return np.dtype([(f"f{n}", kind, (count,)) for n, (kind, count) in enumerate(fields)])

    @property
    def xyz(self) -> list[int]:
        """Indices of x, y and z among the fields."""
        return [self.names.index(axis) for axis in "xyz"]


class _PcdFault(Exception):
    """A fault of a file; the caller adds the file's name."""


def read_pcd(path: str | os.PathLike) -> np.ndarray:
    """Read the points of a PCD file: ascii, binary or binary_compressed.

    Other fields, and points with a NaN coordinate, are skipped.

    Returns:
        [n, 3] positions in the file's unit, float32 or float64 as stored (integers become
        float64). n may be 0.

    Raises:
        RecordingError: The file is missing, no PCD, cut short, damaged, or without x, y, z.
    """
    path = Path(path)
    data = read_bytes(path, RecordingError)
    try:
        header = _parse_header(data)
        points = _DECODERS[header.encoding](data[header.start :], header)
    except _PcdFault as fault:
        raise RecordingError(
            str(fault), where=str(path), fix="export the point cloud again as PCD"
        ) from None
    points = points if points.dtype.kind == "f" else points.astype(np.float64)
    return points[~np.isnan(points).any(axis=1)]


def _parse_header(data: bytes) -> _Header:
    end = re.search(rb"(?m)^DATA[ \t]+(\w+)[ \t]*\r?\n", data[:_MAX_HEADER])
    if end is None:
        raise _PcdFault("is not a PCD file, or has no line DATA")
    entries: dict[str, list[str]] = {}
    for line in data[: end.start()].decode("latin-1").splitlines():
        words = line.partition("#")[0].split()
        if words and words[0] not in _KEYS:
            raise _PcdFault(f"has the header line {line.strip()[:60]!r}, which is not understood")
        if words:
            entries[words[0]] = words[1:]
    names = entries.get("FIELDS", entries.get("COLUMNS", []))
    for axis in "xyz":
        if names.count(axis) != 1:
            raise _PcdFault(f"has {names.count(axis)} fields {axis!r}, not one")
    columns = [entries.get(key, []) for key in ("SIZE", "TYPE")]
    columns.append(entries.get("COUNT", ["1"] * len(names)))
    if any(len(column) != len(names) for column in columns):
        raise _PcdFault(f"has {len(names)} fields, but not as many of SIZE, TYPE and COUNT")
    counts = [_whole(word, "COUNT") for word in columns[2]]
    types = []
    for size, kind in zip(columns[0], columns[1], strict=True):
        if _whole(size, "SIZE") not in _SIZES.get(_KINDS.get(kind, ""), ()):
            raise _PcdFault(f"has a field of TYPE {kind} and SIZE {size}, which there is not")
        types.append(np.dtype(f"<{_KINDS[kind]}{size}"))
    width, height = (_whole(" ".join(entries.get(k, ["1"])), k) for k in ("WIDTH", "HEIGHT"))
    points = width * height
    if "POINTS" in entries:
        points = _whole(" ".join(entries["POINTS"]), "POINTS")
        if "WIDTH" in entries and points != width * height:
            raise _PcdFault(f"has POINTS {points}, but WIDTH {width} and HEIGHT {height}")
    elif "WIDTH" not in entries:
        raise _PcdFault("does not say how many points it has")
    header = _Header(names, types, counts, points, end[1].decode("ascii"), end.end())
    if not all(0 < count <= _MOST for count in counts):
        raise _PcdFault(f"has fields of {max(counts)} numbers a point")
    if any(counts[place] != 1 for place in header.xyz):
        raise _PcdFault("has more than one number in x, y or z of a point")
    if header.encoding not in _DECODERS:
        raise _PcdFault(f"has DATA {header.encoding}, not one of {', '.join(_DECODERS)}")
    return header


def _whole(word: str, key: str) -> int:
    if not word.isdecimal():
        raise _PcdFault(f"has {key} {word[:20]!r}, which is no whole number")
    return int(word)


def _check_length(there: int, needed: int, unit: str) -> None:
    if there < needed:
        raise _PcdFault(f"is cut short: {there} {unit} where {needed} are announced")


def _ascii(data: bytes, header: _Header) -> np.ndarray:
    tokens, width = data.split(), sum(header.counts)
    _check_length(len(tokens), header.points * width, "numbers")
    first = np.cumsum([0, *header.counts])[header.xyz]
    table = np.array(tokens[: header.points * width]).reshape(header.points, width)[:, first]
    try:
        return table.astype(np.float64).astype(_type(header))
    except ValueError as error:
        raise _PcdFault(f"has a coordinate that is no number ({error})") from None


def _binary(data: bytes, header: _Header) -> np.ndarray:
    _check_length(len(data), header.points * header.row.itemsize, "bytes")
    rows = np.frombuffer(data, header.row, header.points)
    return np.stack([rows[f"f{n}"][:, 0].astype(_type(header)) for n in header.xyz], axis=1)


def _compressed(data: bytes, header: _Header) -> np.ndarray:
    _check_length(len(data), 8, "bytes")
    packed, size = struct.unpack_from("<II", data)
    if size != header.points * header.row.itemsize:
        raise _PcdFault(
            f"unpacks to {size} bytes where {header.points * header.row.itemsize} are announced"
        )
    _check_length(len(data), 8 + packed, "bytes")
    plain = _lzf(data[8 : 8 + packed], size)
    each = [kind.itemsize * n for kind, n in zip(header.types, header.counts, strict=True)]
    starts = np.cumsum([0, *each]) * header.points
    columns = [
        np.frombuffer(plain, header.types[n], header.points, int(starts[n])) for n in header.xyz
    ]
    return np.stack([column.astype(_type(header)) for column in columns], axis=1)


def _type(header: _Header) -> np.dtype:
    """The type that holds all three coordinates."""
    return np.result_type(*(header.types[n].newbyteorder("=") for n in header.xyz))


def _lzf(data: bytes, size: int) -> bytearray:
    """Decompress LZF: literal runs of bytes, and copies of earlier output."""
    out, at = bytearray(), 0
    try:
        while at < len(data):
            head = data[at]
            at += 1
            if head < 32:
                run = data[at : at + head + 1]
                if len(run) <= head:
                    raise IndexError
                out += run
                at += head + 1
                continue
            length = head >> 5
            if length == 7:
                length += data[at]
                at += 1
            begin = len(out) - ((head & 31) << 8) - data[at] - 1
            at += 1
            if begin < 0:
                raise IndexError
            length += 2
            while length > 0:  # source and destination of the copy may overlap
                part = out[begin : begin + length]
                out += part
                length -= len(part)
                begin += len(part)
            if len(out) > size:
                raise IndexError
    except IndexError:
        raise _PcdFault("has compressed data that is damaged") from None
    if len(out) != size:
        raise _PcdFault(f"unpacks to {len(out)} bytes where {size} are announced")
    return out


_DECODERS = {"ascii": _ascii, "binary": _binary, "binary_compressed": _compressed}
