"""Point clouds in the Polygon File Format (PLY).

Source of the format: Greg Turk, "The PLY Polygon File Format" (1994).
"""

from __future__ import annotations

import os

import numpy as np

from gendom.arguments import require
from gendom.datasets.cloud_fields import (
    CloudError,
    Element,
    Field,
    check_points,
    header_lines,
    points_of_bytes,
    points_of_text,
    read_cloud,
)
from gendom.errors import RecordingError
from gendom.files import atomic_path
from gendom.reading import LARGEST_FILE

_TYPES = {
    **{"char": "i1", "short": "i2", "int": "i4", "long": "i8", "float": "f4", "double": "f8"},
    **{"uchar": "u1", "ushort": "u2", "uint": "u4", "ulong": "u8", "bool": "u1"},
    **{f"int{8 * n}": f"i{n}" for n in (1, 2, 4, 8)},
    **{f"uint{8 * n}": f"u{n}" for n in (1, 2, 4, 8)},
    **{"float32": "f4", "float64": "f8"},
}
_BYTE_ORDER = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def read_ply(path: str | os.PathLike) -> np.ndarray:
    """Read the vertices of a PLY file, ascii or binary.

    Other vertex properties, other elements, and points with a NaN coordinate are skipped.

    Returns:
        [n, 3] positions in the file's unit, float32 or float64 as stored (integers become
        float64). n may be 0.

    Raises:
        RecordingError: The file is missing, no PLY, cut short, or without x, y, z.
    """

    def decode(data: bytes) -> np.ndarray:
        encoding, elements, start = _parse_header(data)
        if encoding == "ascii":
            return points_of_text(data, start, elements)
        return points_of_bytes(data, start, elements, _BYTE_ORDER[encoding])

    return read_cloud(path, "PLY", decode)


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


def _parse_header(data: bytes) -> tuple[str, list[Element], int]:
    """Encoding, elements up to the vertices, and the offset of the first byte of data."""
    if data[:3].lower() != b"ply" or data[3:4] not in b" \t\r\n":
        raise CloudError("is not a PLY file (it does not begin with the line 'ply')")
    if (header := header_lines(data, "end_header")) is None:
        raise CloudError("has no end_header")
    encoding = None
    elements: list[Element] = []
    for line in header[0][1:-1]:
        words = [word.lower() for word in line]
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3:
            encoding = words[1]
        elif words[0] == "element" and len(words) == 3 and words[2].isdecimal():
            # A row has a byte at least.
            elements.append(Element(words[1], int(words[2][:18])))
        elif words[0] == "property" and elements and (own := _parse_property(words, line[-1])):
            elements[-1].fields.append(own)
        else:
            said = " ".join(line)[:80]
            raise CloudError(f"has the header line {said!r}, which is not understood")
    if encoding not in _BYTE_ORDER:
        raise CloudError(f"has the format {encoding!r}, not one of {', '.join(_BYTE_ORDER)}")
    place = next((k for k, e in enumerate(elements) if e.name == "vertex"), None)
    if place is None:
        raise CloudError("has no element 'vertex'")
    _ = elements[place].xyz  # refused here, whatever the data
    if any(own.count > LARGEST_FILE for own in elements[: place + 1]):
        raise CloudError(f"is cut short: it announces {elements[place].count} points")
    check_points(elements[place].count)
    return encoding, elements[: place + 1], header[1]


def _parse_property(words: list[str], name: str) -> Field | None:
    """The property of a header line in small letters; None: it is none."""
    if len(words) == 3 and words[1] in _TYPES:
        return Field(name, _TYPES[words[1]])
    if len(words) == 5 and words[1] == "list" and words[2] in _TYPES and words[3] in _TYPES:
        return Field(name, _TYPES[words[3]], count_type=_TYPES[words[2]])
    return None
