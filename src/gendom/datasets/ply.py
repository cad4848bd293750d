"""Point clouds in the Polygon File Format (PLY).

Source of the format: Greg Turk, "The PLY Polygon File Format" (1994).
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field

import numpy as np

from gendom.arguments import require
from gendom.datasets.cloud_fields import (
    MAX_HEADER,
    CloudError,
    as_float,
    check_length,
    columns_of,
    numbers_of,
)
from gendom.errors import RecordingError
from gendom.files import atomic_path, read_bytes

_TYPES = {
    **{"char": "i1", "short": "i2", "int": "i4", "float": "f4", "double": "f8"},
    **{"uchar": "u1", "ushort": "u2", "uint": "u4", "float32": "f4", "float64": "f8"},
    **{"int8": "i1", "int16": "i2", "int32": "i4", "uint8": "u1", "uint16": "u2", "uint32": "u4"},
}
_BYTE_ORDER = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class _Property:
    name: str
    type: str  # NumPy code of the value
    count_type: str | None  # NumPy code of a list's length; None for a scalar


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    @property
    def has_list(self) -> bool:
        return any(p.count_type is not None for p in self.properties)

    @property
    def xyz(self) -> list[int]:
        """Indices of x, y and z among the properties."""
        names = [p.name if p.count_type is None else "" for p in self.properties]
        return [names.index(axis) for axis in "xyz"]

    @property
    def xyz_type(self) -> np.dtype:
        """The type that holds all three."""
        return np.result_type(*(self.properties[i].type for i in self.xyz))


def read_ply(path: str | os.PathLike) -> np.ndarray:
    """Read the vertices of a PLY file, ascii or binary.

    Other vertex properties and other elements are skipped.

    Returns:
        [n, 3] positions in the file's unit, float32 or float64 as stored (integers become
        float64). n may be 0.

    Raises:
        RecordingError: The file is missing, no PLY, cut short, or without x, y, z.
    """
    data = read_bytes(path, RecordingError)
    try:
        encoding, elements, start = _parse_header(data)
        if encoding == "ascii":
            points = _ascii_vertices(data[start:].split(), elements)
        else:
            points = _binary_vertices(data, start, elements, _BYTE_ORDER[encoding])
    except CloudError as fault:
        fix = "export the point cloud again as PLY"
        raise RecordingError(str(fault), where=str(path), fix=fix) from None
    return as_float(points)


def write_ply(path: str | os.PathLike, points: np.ndarray, *, text: bool = False) -> None:
    """Write points as a PLY file, atomically: binary little endian, or ascii with `text`.

    Args:
        path: The file to write.
        points: [n, 3] positions; float64 is stored as double, everything else as float.
        text: Write ascii (exact: reading it gives the same numbers).

    Raises:
        RecordingError: `points` is not [n, 3].
        GendomError: The place cannot be written.
    """
    points = np.asarray(points)
    right, what = points.ndim == 2 and points.shape[1] == 3, f"points have shape {points.shape}"
    require(right, what, where=str(path), fix="give [n, 3]", error=RecordingError)
    name, code = ("double", "<f8") if points.dtype == np.float64 else ("float", "<f4")
    points = points.astype(code)
    header = [
        "ply",
        f"format {'ascii' if text else 'binary_little_endian'} 1.0",
        f"element vertex {len(points)}",
        *(f"property {name} {axis}" for axis in "xyz"),
        "end_header",
    ]
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        file.write(("\n".join(header) + "\n").encode("ascii"))
        if text:
            for point in points:
                file.write((" ".join(str(value) for value in point) + "\n").encode("ascii"))
        else:
            file.write(points.tobytes())


def _parse_header(data: bytes) -> tuple[str, list[_Element], int]:
    """Encoding, elements up to the vertices, and the offset of the first byte of data."""
    if not re.match(rb"ply[ \t]*\r?\n", data):
        raise CloudError("is not a PLY file (it does not begin with the line 'ply')")
    end = re.search(rb"\nend_header[ \t]*\r?\n", data[:MAX_HEADER])
    if end is None:
        raise CloudError("has no end_header")
    encoding = None
    elements: list[_Element] = []
    for line in data[: end.start()].decode("latin-1").splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3:
            encoding = words[1]
        elif words[0] == "element" and len(words) == 3 and words[2].isdecimal():
            elements.append(_Element(words[1], int(words[2])))
        elif words[0] == "property" and elements and (own := _parse_property(words)):
            elements[-1].properties.append(own)
        else:
            raise CloudError(f"has the header line {line.strip()!r}, which is not understood")
    if encoding not in _BYTE_ORDER:
        raise CloudError(f"has the format {encoding!r}, not one of {', '.join(_BYTE_ORDER)}")
    place = next((k for k, e in enumerate(elements) if e.name == "vertex"), None)
    if place is None:
        raise CloudError("has no element 'vertex'")
    scalars = [p.name for p in elements[place].properties if p.count_type is None]
    for axis in "xyz":
        if scalars.count(axis) != 1:
            raise CloudError(f"has {scalars.count(axis)} vertex properties {axis!r}, not one")
    return encoding, elements[: place + 1], end.end()


def _parse_property(words: list[str]) -> _Property | None:
    """The property of a header line; None: it is none."""
    if len(words) == 3 and words[1] in _TYPES:
        return _Property(words[2], _TYPES[words[1]], None)
    if len(words) == 5 and words[1] == "list" and words[2] in _TYPES and words[3] in _TYPES:
        return _Property(words[4], _TYPES[words[3]], _TYPES[words[2]])
    return None


def _ascii_vertices(tokens: list[bytes], elements: list[_Element]) -> np.ndarray:
    """[n, 3] vertices, the last of the elements."""
    at, rows = 0, []
    for element in elements:
        rows, width = [], len(element.properties)
        if not element.has_list:
            rows, at = tokens[at : at + element.count * width], at + element.count * width
            continue
        for _ in range(element.count):
            for prop in element.properties:
                check_length(len(tokens), at + 1, "numbers")
                rows.append(tokens[at])
                at += 1 if prop.count_type is None else 1 + _count(tokens[at], prop)
    vertices = elements[-1]
    check_length(len(tokens), at, "numbers")
    table = np.array(rows).reshape(vertices.count, len(vertices.properties))
    return numbers_of(table[:, vertices.xyz], vertices.xyz_type)


def _binary_vertices(data: bytes, at: int, elements: list[_Element], order: str) -> np.ndarray:
    """[n, 3] vertices, the last of the elements; `order` is that of the bytes."""
    vertices = elements[-1]
    for element in elements:
        if not element.has_list:
            types = [np.dtype(order + p.type) for p in element.properties]
            size = element.count * sum(kind.itemsize for kind in types)
            if element is vertices:
                check_length(len(data), at + size, "bytes")
                return columns_of(data, at, types, element.count, element.xyz)
            at += size
            continue
        check_length(len(data), at + element.count, "bytes")  # a row has at least one
        axis_of = {place: a for a, place in enumerate(vertices.xyz)} if element is vertices else {}
        points = np.empty((element.count if axis_of else 0, 3), vertices.xyz_type)
        for row in range(element.count):
            for place, prop in enumerate(element.properties):
                first = np.dtype(order + (prop.count_type or prop.type))
                check_length(len(data), at + first.itemsize, "bytes")
                value = np.frombuffer(data, first, 1, at)[0]
                at += first.itemsize
                if prop.count_type is not None:
                    at += _count(value, prop) * np.dtype(prop.type).itemsize
                elif place in axis_of:
                    points[row, axis_of[place]] = value
        if element is vertices:
            return points
    raise AssertionError("the last element are the vertices")


def _count(value: bytes | np.number, prop: _Property) -> int:
    """A list's length."""
    try:
        count = int(value)
    except ValueError:
        count = -1
    if count < 0:
        raise CloudError(f"has {value!r} as the length of the list {prop.name!r}")
    return count
