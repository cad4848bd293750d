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

import numpy as np

from gendom.datasets.cloud_fields import (
    MAX_HEADER,
    CloudError,
    as_float,
    check_length,
    columns_of,
    numbers_of,
)
from gendom.errors import RecordingError
from gendom.files import read_bytes

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
    def row_size(self) -> int:
        """Length of one point [bytes]."""
        return sum(t.itemsize * n for t, n in zip(self.types, self.counts, strict=True))

    @property
    def xyz(self) -> list[int]:
        """Indices of x, y and z among the fields."""
        return [self.names.index(axis) for axis in "xyz"]

    @property
    def xyz_type(self) -> np.dtype:
        """The type that holds all three."""
        return np.result_type(*(self.types[n].newbyteorder("=") for n in self.xyz))


def read_pcd(path: str | os.PathLike) -> np.ndarray:
    """Read the points of a PCD file: ascii, binary or binary_compressed.

    Other fields, and points with a NaN coordinate, are skipped.

    Returns:
        [n, 3] positions in the file's unit, float32 or float64 as stored (integers become
        float64). n may be 0.

    Raises:
        RecordingError: The file is missing, no PCD, cut short, damaged, or without x, y, z.
    """
    data = read_bytes(path, RecordingError)
    try:
        header = _parse_header(data)
        points = as_float(_DECODERS[header.encoding](data[header.start :], header))
    except CloudError as fault:
        fix = "export the point cloud again as PCD"
        raise RecordingError(str(fault), where=str(path), fix=fix) from None
    return points[~np.isnan(points).any(axis=1)]


def _parse_header(data: bytes) -> _Header:
    end = re.search(rb"(?m)^DATA[ \t]+(\w+)[ \t]*\r?\n", data[:MAX_HEADER])
    if end is None:
        raise CloudError("is not a PCD file, or has no line DATA")
    entries: dict[str, list[str]] = {}
    for line in data[: end.start()].decode("latin-1").splitlines():
        words = line.partition("#")[0].split()
        if words and words[0] not in _KEYS:
            raise CloudError(f"has the header line {line.strip()[:60]!r}, which is not understood")
        if words:
            entries[words[0]] = words[1:]
    names = entries.get("FIELDS", entries.get("COLUMNS", []))
    for axis in "xyz":
        if names.count(axis) != 1:
            raise CloudError(f"has {names.count(axis)} fields {axis!r}, not one")
    columns = [entries.get(key, []) for key in ("SIZE", "TYPE")]
    columns.append(entries.get("COUNT", ["1"] * len(names)))
    if any(len(column) != len(names) for column in columns):
        raise CloudError(f"has {len(names)} fields, but not as many of SIZE, TYPE and COUNT")
    counts = [_whole(word, "COUNT") for word in columns[2]]
    types = []
    for size, kind in zip(columns[0], columns[1], strict=True):
        if _whole(size, "SIZE") not in _SIZES.get(_KINDS.get(kind, ""), ()):
            raise CloudError(f"has a field of TYPE {kind} and SIZE {size}, which there is not")
        types.append(np.dtype(f"<{_KINDS[kind]}{size}"))
    width, height = (_whole(" ".join(entries.get(k, ["1"])), k) for k in ("WIDTH", "HEIGHT"))
    points = width * height
    if "POINTS" in entries:
        points = _whole(" ".join(entries["POINTS"]), "POINTS")
        if "WIDTH" in entries and points != width * height:
            raise CloudError(f"has POINTS {points}, but WIDTH {width} and HEIGHT {height}")
    elif "WIDTH" not in entries:
        raise CloudError("does not say how many points it has")
    header = _Header(names, types, counts, points, end[1].decode("ascii"), end.end())
    if not all(0 < count <= _MOST for count in counts):
        raise CloudError(f"has fields of {max(counts)} numbers a point")
    if any(counts[place] != 1 for place in header.xyz):
        raise CloudError("has more than one number in x, y or z of a point")
    if header.encoding not in _DECODERS:
        raise CloudError(f"has DATA {header.encoding}, not one of {', '.join(_DECODERS)}")
    return header


def _whole(word: str, key: str) -> int:
    if not word.isdecimal():
        raise CloudError(f"has {key} {word[:20]!r}, which is no whole number")
    return int(word)


def _ascii(data: bytes, header: _Header) -> np.ndarray:
    tokens, width = data.split(), sum(header.counts)
    check_length(len(tokens), header.points * width, "numbers")
    first = np.cumsum([0, *header.counts])[header.xyz]
    table = np.array(tokens[: header.points * width]).reshape(header.points, width)
    return numbers_of(table[:, first], header.xyz_type)


def _binary(data: bytes, header: _Header) -> np.ndarray:
    check_length(len(data), header.points * header.row_size, "bytes")
    return columns_of(data, 0, header.types, header.points, header.xyz, header.counts)


def _compressed(data: bytes, header: _Header) -> np.ndarray:
    check_length(len(data), 8, "bytes")
    packed, size = struct.unpack_from("<II", data)
    if size != (needed := header.points * header.row_size):
        raise CloudError(f"unpacks to {size} bytes where {needed} are announced")
    check_length(len(data), 8 + packed, "bytes")
    plain = _lzf(data[8 : 8 + packed], size)
    each = [kind.itemsize * n for kind, n in zip(header.types, header.counts, strict=True)]
    starts = np.cumsum([0, *each]) * header.points
    columns = [
        np.frombuffer(plain, header.types[n], header.points, int(starts[n])) for n in header.xyz
    ]
    return np.stack([column.astype(header.xyz_type) for column in columns], axis=1)


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
        raise CloudError("has compressed data that is damaged") from None
    if len(out) != size:
        raise CloudError(f"unpacks to {len(out)} bytes where {size} are announced")
    return out


_DECODERS = {"ascii": _ascii, "binary": _binary, "binary_compressed": _compressed}
