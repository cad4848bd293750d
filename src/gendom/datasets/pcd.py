"""Point clouds in the format of the Point Cloud Library (PCD), version 0.7 and before.

A header of lines of text, then numbers as text (`ascii`), points one after another (`binary`), or
field after field, compressed (`binary_compressed`; LZF). Invalid points are NaN in the file, and
are left out. VIEWPOINT, the pose of the sensor, is not applied.

Source: the library's documentation, "The PCD (Point Cloud Data) file format"; LibLZF by Marc
Lehmann.
"""

from __future__ import annotations

import os
import struct

import numpy as np

from gendom.datasets.cloud_fields import (
    CloudError,
    Element,
    Field,
    check_length,
    check_points,
    header_lines,
    points_of_bytes,
    points_of_columns,
    points_of_text,
    read_cloud,
)
from gendom.reading import LARGEST_FILE

_SIZES = {"I": (1, 2, 4, 8), "U": (1, 2, 4, 8), "F": (4, 8)}
_KEYS = ("VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT")
_KEYS += ("WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_MOST = 1 << 16  # numbers in one field of a point
_LARGEST_PACKED = 1 << 24  # [bytes]; decompressing many short pieces takes seconds


def read_pcd(path: str | os.PathLike) -> np.ndarray:
    """Read the points of a PCD file: ascii, binary or binary_compressed.

    Other fields, and points with a NaN coordinate, are skipped.

    Returns:
        [n, 3] positions in the file's unit, float32 or float64 as stored (integers become
        float64). n may be 0.

    Raises:
        RecordingError: The file is missing, no PCD, cut short, damaged, or without x, y, z.
    """

    def decode(data: bytes) -> np.ndarray:
        element, encoding, start = _parse_header(data)
        return _DECODERS[encoding](data, start, element)

    return read_cloud(path, "PCD", decode)


def _parse_header(data: bytes) -> tuple[Element, str, int]:
    """The points, their encoding, and the offset of the first byte of data."""
    if (header := header_lines(data, "data")) is None:
        raise CloudError("is not a PCD file, or has no line DATA")
    entries: dict[str, list[str]] = {}
    for line in header[0]:
        words = " ".join(line).partition("#")[0].split()
        if words and words[0].upper() not in _KEYS:
            said = " ".join(line)[:60]
            raise CloudError(f"has the header line {said!r}, which is not understood")
        if words:
            entries[words[0].upper()] = words[1:]
    names = entries.get("FIELDS", entries.get("COLUMNS", []))
    columns = [entries.get(key, []) for key in ("SIZE", "TYPE")]
    columns.append(entries.get("COUNT", ["1"] * len(names)))
    if any(len(column) != len(names) for column in columns):
        raise CloudError(f"has {len(names)} fields, but not as many of SIZE, TYPE and COUNT")
    fields = []
    for name, size, kind, count in zip(names, *columns, strict=True):
        if _whole(size, "SIZE") not in _SIZES.get(kind.upper(), ()):
            raise CloudError(f"has a field of TYPE {kind} and SIZE {size}, which there is not")
        if not 0 < _whole(count, "COUNT") <= _MOST:
            raise CloudError(f"has fields of {count} numbers a point")
        fields.append(Field(name, f"{kind.lower()}{size}", int(count)))
    element = Element("point", _count(entries), fields)
    check_points(element.count)
    encoding = " ".join(entries["DATA"]).lower()
    if encoding not in _DECODERS:
        raise CloudError(f"has DATA {encoding[:20]}, not one of {', '.join(_DECODERS)}")
    _ = element.xyz  # refused here, whatever the data
    return element, encoding, header[1]


def _count(entries: dict[str, list[str]]) -> int:
    """Number of points."""
    width, height = (_whole(" ".join(entries.get(k, ["1"])), k) for k in ("WIDTH", "HEIGHT"))
    if "POINTS" not in entries:
        if "WIDTH" not in entries:
            raise CloudError("does not say how many points it has")
        return width * height
    points = _whole(" ".join(entries["POINTS"]), "POINTS")
    if "WIDTH" in entries and points != width * height:
        raise CloudError(f"has POINTS {points}, but WIDTH {width} and HEIGHT {height}")
    return points


def _whole(word: str, key: str) -> int:
    if not word.isdecimal() or len(word) > 18:
        raise CloudError(f"has {key} {word[:20]!r}, which is no whole number")
    return int(word)


def _compressed(data: bytes, at: int, element: Element) -> np.ndarray:
    check_length(len(data), at + 8, "bytes")
    packed, size = struct.unpack_from("<II", data, at)
    if size != (needed := element.count * element.row().itemsize):
        raise CloudError(f"unpacks to {size} bytes where {needed} are announced")
    check_length(len(data), at + 8 + packed, "bytes")
    if size > LARGEST_FILE or packed > _LARGEST_PACKED:
        raise CloudError(f"has {packed} bytes that unpack to {size}, too many: use DATA binary")
    return points_of_columns(_lzf(data[at + 8 : at + 8 + packed], size), element)


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
            part = out[begin : begin + length + 2]  # short where source and destination overlap
            out += (part * (length // len(part) + 3))[: length + 2]
            if len(out) > size:
                raise IndexError
    except IndexError:
        raise CloudError("has compressed data that is damaged") from None
    if len(out) != size:
        raise CloudError(f"unpacks to {len(out)} bytes where {size} are announced")
    return out


_DECODERS = {
    "ascii": lambda data, at, element: points_of_text(data, at, [element]),
    "binary": lambda data, at, element: points_of_bytes(data, at, [element], "<"),
    "binary_compressed": _compressed,
}
