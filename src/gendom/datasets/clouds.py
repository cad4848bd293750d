"""Point clouds in the Polygon File Format (PLY) and that of the Point Cloud Library (PCD).

Both are a header of lines, then rows of fields as text or bytes, of which x, y and z are read. PCD
may also hold field after field, compressed (LZF); VIEWPOINT, the sensor's pose, is not applied.

Sources: Greg Turk, "The PLY Polygon File Format" (1994); the library's documentation, "The PCD
(Point Cloud Data) file format"; LibLZF by Marc Lehmann.
"""

from __future__ import annotations

import codecs
import os
import re
import string
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import chain, islice

import numpy as np

from gendom.errors import RecordingError
from gendom.reading import LARGEST_FILE, read_bytes

MAX_HEADER = 1 << 16
"""Longest header that is searched [bytes]."""
MOST_POINTS = 1 << 22
"""Of a cloud: twice those of the largest depth cameras."""
LARGEST_TEXT, MOST_NUMBERS = 1 << 25, 3 << 20
"""Of a cloud as text [bytes], and of its numbers: a million points of three."""
LONGEST = 1100
"""Of a number as text: exact doubles have up to 1,080 characters."""
_MOST = 1 << 16  # numbers in one field of a point
_LARGEST_PACKED = 1 << 23  # [bytes]; decompressing many short pieces takes a second

_BLOCK = re.compile(rb"[\0-\xff]{1,4096}\S*")
_ODD_NANS = re.compile(rb"[-+]?(?:nan\(\w*\)|1\.#(?:ind|qnan|snan)\w*)", re.IGNORECASE)

_PLY_TYPES = {
    **{"char": "i1", "short": "i2", "int": "i4", "long": "i8", "float": "f4", "double": "f8"},
    **{"uchar": "u1", "ushort": "u2", "uint": "u4", "ulong": "u8", "bool": "u1"},
    **{f"int{8 * n}": f"i{n}" for n in (1, 2, 4, 8)},
    **{f"uint{8 * n}": f"u{n}" for n in (1, 2, 4, 8)},
    **{"float32": "f4", "float64": "f8"},
}
_PLY_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_PCD_SIZES = {"I": (1, 2, 4, 8), "U": (1, 2, 4, 8), "F": (4, 8)}
_PCD_KEYS = ("VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT")
_PCD_KEYS += ("WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")


def read_ply(path: str | os.PathLike) -> np.ndarray:
    """Read the vertices of a PLY file, ascii or binary.

    Other vertex properties, other elements, and points with a NaN coordinate are skipped.

    Returns:
        [n, 3] positions in the file's unit, float32 or float64 as stored (integers become
        float64). n may be 0.

    Raises:
        RecordingError: The file is missing, no PLY, cut short, or without x, y, z; or it has lists
            before its vertices or in them.
    """

    def decode(data: bytes) -> list[np.ndarray]:
        encoding, elements, start = _ply_header(data)
        if encoding == "ascii":
            return _from_text(data, start, elements)
        return _from_bytes(data, start, elements, _PLY_ORDERS[encoding])

    return _read(path, "PLY", decode)


def read_pcd(path: str | os.PathLike) -> np.ndarray:
    """Read the points of a PCD file, ascii, binary or binary_compressed, to positions [n, 3] as of
    `read_ply`. Other fields, and points with a NaN coordinate, are skipped.

    Raises:
        RecordingError: The file is missing, no PCD, cut short, damaged, or without x, y, z.
    """

    def decode(data: bytes) -> list[np.ndarray]:
        encoding, points, start = _pcd_header(data)
        return _PCD_DECODERS[encoding](data, start, points)

    return _read(path, "PCD", decode)


def seen(points: np.ndarray) -> np.ndarray:
    """The same points as floating numbers, without those that have a NaN: in organised clouds these
    are pixels that saw nothing."""
    if points.dtype not in (np.float32, np.float64):
        points = points.astype(np.float64)
    hidden = np.isnan(points).any(axis=1)
    return points[~hidden] if hidden.any() else points


class _CloudError(Exception):
    """A fault of a file; `_read` adds the file's name."""


@dataclass
class _Element:
    """Rows of the same fields."""

    name: str
    count: int
    fields: list[tuple[str, str, int]] = field(default_factory=list)
    """Name, NumPy code without the order of bytes, and how many numbers it has."""
    has_list: bool = False
    ends: bool = True
    """Nothing comes after it."""

    @property
    def numbers(self) -> list[int]:
        """How many numbers each field has."""
        return [repeat for _, _, repeat in self.fields]

    @property
    def sizes(self) -> list[int]:
        """The size of each field [bytes]."""
        return [int(kind[1:]) * repeat for _, kind, repeat in self.fields]

    @property
    def xyz(self) -> list[int]:
        """Indices of x, y and z among the fields; capital letters count where there are no others.

        Raises:
            _CloudError: One is not there once, or is no single number.
        """
        names, found = [name for name, _, _ in self.fields], []
        for axis in "xyz":
            letter = axis if axis in names else axis.upper()
            if names.count(letter) != 1:
                raise _CloudError(f"has {names.count(letter)} fields {axis!r}, not one")
            found.append(names.index(letter))
        if any(self.numbers[k] != 1 for k in found):
            raise _CloudError("has more than one number in x, y or z of a point")
        return found


# ---- headers -------------------------------------------------------------------------------------


def _ply_header(data: bytes) -> tuple[str, list[_Element], int]:
    """Encoding, elements up to the vertices, and the offset of the first byte of data."""
    if data[:3].lower() != b"ply" or data[3:4] not in b" \t\r\n":
        raise _CloudError("is not a PLY file (it does not begin with the line 'ply')")
    lines, start = _header_lines(data, "end_header", "has no end_header")
    encoding, elements = "", []
    for line in lines[1:-1]:
        match [word.lower() for word in line]:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", encoding, _]:
                pass
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count[:18])))
            case ["property", kind, _] if elements and kind in _PLY_TYPES:
                elements[-1].fields.append((line[-1], _PLY_TYPES[kind], 1))
            case ["property", "list", a, b, _] if elements and {a, b} <= _PLY_TYPES.keys():
                elements[-1].has_list = True
            case _:
                said = " ".join(line)[:80]
                raise _CloudError(f"has the header line {said!r}, which is not understood")
    if encoding not in _PLY_ORDERS:
        raise _CloudError(f"has the format {encoding!r}, not one of {', '.join(_PLY_ORDERS)}")
    names = [own.name for own in elements]
    if "vertex" not in names:
        raise _CloudError("has no element 'vertex'")
    elements = elements[: names.index("vertex") + 1]
    elements[-1].ends = len(elements) == len(names)
    if any(own.has_list for own in elements):
        raise _CloudError("has lists before its vertices or in them, which are not read")
    return encoding, elements, start


def _pcd_header(data: bytes) -> tuple[str, _Element, int]:
    """Encoding, the points, and the offset of the first byte of data."""
    lines, start = _header_lines(data, "data", "is not a PCD file, or has no line DATA")
    entries: dict[str, list[str]] = {}
    for line in lines:
        words = " ".join(line).partition("#")[0].split()
        if words and words[0].upper() not in _PCD_KEYS:
            said = " ".join(line)[:60]
            raise _CloudError(f"has the header line {said!r}, which is not understood")
        if words:
            entries[words[0].upper()] = words[1:]
    names = entries.get("FIELDS", entries.get("COLUMNS", []))
    columns = [entries.get(key, []) for key in ("SIZE", "TYPE")]
    columns.append(entries.get("COUNT", ["1"] * len(names)))
    if any(len(column) != len(names) for column in columns):
        raise _CloudError(f"has {len(names)} fields, but not as many of SIZE, TYPE and COUNT")
    points = _Element("point", _count(entries))
    for name, size, kind, count in zip(names, *columns, strict=True):
        if _whole(size, "SIZE") not in _PCD_SIZES.get(kind.upper(), ()):
            raise _CloudError(f"has a field of TYPE {kind} and SIZE {size}, which there is not")
        if not 0 < _whole(count, "COUNT") <= _MOST:
            raise _CloudError(f"has fields of {count} numbers a point")
        points.fields.append((name, f"{kind.lower()}{size}", int(count)))
    encoding = " ".join(entries["DATA"]).lower()
    if encoding not in _PCD_DECODERS:
        raise _CloudError(f"has DATA {encoding[:20]}, not one of {', '.join(_PCD_DECODERS)}")
    return encoding, points, start


def _header_lines(data: bytes, last: str, missing: str) -> tuple[list[list[str]], int]:
    """Words of each line of a header, and the offset of what follows its last line, which begins
    with a word. Lines end in a line feed, after which encoding the text may be in."""
    lines, at = [], 0
    while (end := data.find(b"\n", at, MAX_HEADER)) >= 0:
        lines.append([word.decode("latin-1") for word in data[at:end].split()])
        at = end + 1
        if lines[-1] and lines[-1][0].lower() == last:
            return lines, at
    raise _CloudError(missing)


def _count(entries: dict[str, list[str]]) -> int:
    """Number of points."""
    width, height = (_whole(" ".join(entries.get(k, ["1"])), k) for k in ("WIDTH", "HEIGHT"))
    if not {"POINTS", "WIDTH"} & entries.keys():
        raise _CloudError("does not say how many points it has")
    points = _whole(" ".join(entries.get("POINTS", [str(width * height)])), "POINTS")
    if "WIDTH" in entries and points != width * height:
        raise _CloudError(f"has POINTS {points}, but WIDTH {width} and HEIGHT {height}")
    return points


def _whole(word: str, key: str) -> int:
    if not word.isdecimal() or len(word) > 18:
        raise _CloudError(f"has {key} {word[:20]!r}, which is no whole number")
    return int(word)


# ---- data ----------------------------------------------------------------------------------------


def _read(
    path: str | os.PathLike, kind: str, decode: Callable[[bytes], list[np.ndarray]]
) -> np.ndarray:
    """[n, 3] points of a file whose coordinates x, y and z are decoded, `seen`."""
    data = read_bytes(path, RecordingError).removeprefix(codecs.BOM_UTF8)
    try:
        columns = decode(data)
    except _CloudError as fault:
        fix = f"export the point cloud again as {kind}"
        raise RecordingError(str(fault), where=str(path), fix=fix) from None
    common = np.result_type(*(column.dtype.newbyteorder("=") for column in columns))
    return seen(np.stack([column.astype(common) for column in columns], axis=1))


def _begin(last: _Element) -> list[int]:
    """`xyz` of points that are not too many."""
    found = last.xyz
    if last.count > MOST_POINTS:
        raise _CloudError(f"announces {last.count} points, at most {MOST_POINTS} are read")
    return found


def _check_length(there: int, needed: int, unit: str, beyond: bool = False) -> None:
    if there < needed:
        raise _CloudError(f"is cut short: {there} {unit} where {needed} are announced")
    if beyond:
        raise _CloudError(f"holds more than the {needed} {unit} that are announced")


def _from_text(data: bytes, at: int, elements: list[_Element]) -> list[np.ndarray]:
    """Coordinates [n] of the last of some elements, the first of which begins at an offset."""
    last, places = elements[-1], _begin(elements[-1])
    before = sum(own.count * sum(own.numbers) for own in elements[:-1])
    width = sum(last.numbers)
    needed = before + last.count * width
    if len(data) - at > LARGEST_TEXT or needed > MOST_NUMBERS:
        what = f"is text of {len(data) - at} bytes and {needed} numbers, at most {LARGEST_TEXT}"
        raise _CloudError(f"{what} and {MOST_NUMBERS} are read: have it binary")
    stream = chain.from_iterable(map(_floats, _BLOCK.finditer(data, at)))
    try:
        found = np.fromiter(islice(stream, needed), np.float64)
        beyond = last.ends and next(stream, None) is not None
    except ValueError as fault:
        raise _CloudError(f"has a coordinate that is no number ({fault})") from None
    _check_length(len(found), needed, "numbers", beyond)
    table = found[before:].reshape(last.count, width)
    with np.errstate(over="ignore", invalid="ignore"):
        return [table[:, sum(last.numbers[:k])].astype(last.fields[k][1]) for k in places]


def _floats(block: re.Match[bytes]) -> Iterator[float]:
    """The numbers in some bytes of a text."""
    if len(block[0]) > 4096 + LONGEST:
        raise ValueError(f"more than {LONGEST} characters: {block[0][-20:]!r}")
    if b"_" in block[0]:  # 1_0 is 10 in Python
        raise ValueError("an underscore")
    odd = b"(" in block[0] or b"#" in block[0]
    return map(float, (_ODD_NANS.sub(b"nan", block[0]) if odd else block[0]).split())


def _from_bytes(data: bytes, at: int, elements: list[_Element], order: str) -> list[np.ndarray]:
    """Coordinates [n] of the last of some elements, the first of which begins at an offset."""
    *before, last = elements
    places, sizes = _begin(last), last.sizes
    at += sum(own.count * sum(own.sizes) for own in before)
    end = at + last.count * sum(sizes)
    beyond = last.ends and bool(data[end:].strip(b"\0" + string.whitespace.encode()))
    _check_length(len(data), end, "bytes", beyond)
    if last.count == 0:
        return [np.empty(0, last.fields[k][1]) for k in places]
    step = (sum(sizes),)
    return [
        np.ndarray(last.count, order + last.fields[k][1], data, at + sum(sizes[:k]), step)
        for k in places
    ]


def _from_packed(data: bytes, at: int, points: _Element) -> list[np.ndarray]:
    """Coordinates [n] of points that are stored field after field, compressed."""
    places, sizes = _begin(points), points.sizes
    _check_length(len(data), at + 8, "bytes")
    packed, size = struct.unpack_from("<II", data, at)
    if size != (needed := points.count * sum(sizes)):
        raise _CloudError(f"unpacks to {size} bytes where {needed} are announced")
    _check_length(len(data), at + 8 + packed, "bytes")
    if size > LARGEST_FILE or packed > _LARGEST_PACKED:
        raise _CloudError(f"has {packed} bytes that unpack to {size}, too many: use DATA binary")
    plain, n = _lzf(data[at + 8 : at + 8 + packed], size), points.count
    return [np.frombuffer(plain, f"<{points.fields[k][1]}", n, sum(sizes[:k]) * n) for k in places]


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
        raise _CloudError("has compressed data that is damaged") from None
    if len(out) != size:
        raise _CloudError(f"unpacks to {len(out)} bytes where {size} are announced")
    return out


_PCD_DECODERS = {
    "ascii": lambda data, at, points: _from_text(data, at, [points]),
    "binary": lambda data, at, points: _from_bytes(data, at, [points], "<"),
    "binary_compressed": _from_packed,
}
