"""What files of point clouds share: a header of lines, then elements whose rows have fields, as
text or as bytes, of which x, y and z become coordinates."""

from __future__ import annotations

import os
import re
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
MOST_LISTS = 1 << 16
"""Rows with lists in an element: these are read one by one."""
LONGEST = 1100
"""Of a number as text: exact doubles have up to 1,080 characters."""

_BLOCK = re.compile(rb"[\0-\xff]{1,4096}\S*")
_ODD_NANS = re.compile(rb"[-+]?(?:nan\(\w*\)|1\.#(?:ind|qnan|snan)\w*)", re.IGNORECASE)


class CloudError(Exception):
    """A fault of a file; the caller adds the file's name."""


@dataclass(frozen=True)
class Field:
    """A property of a point, or of another element."""

    name: str
    type: str
    """NumPy code without the order of bytes."""
    repeat: int = 1
    """How many numbers it has."""
    count_type: str | None = None
    """Of a list, the type of its length."""


@dataclass
class Element:
    """Rows of the same fields."""

    name: str
    count: int
    fields: list[Field] = field(default_factory=list)

    @property
    def width(self) -> int:
        """Numbers in a row, with one for a list."""
        return sum(own.repeat for own in self.fields)

    @property
    def has_list(self) -> bool:
        return any(own.count_type is not None for own in self.fields)

    def row(self, order: str = "<") -> np.dtype:
        """The type of a row in some order of bytes; of elements without lists."""
        kinds = [(f"f{k}", order + f.type, (f.repeat,)) for k, f in enumerate(self.fields)]
        return np.dtype(kinds)

    @property
    def xyz(self) -> list[int]:
        """Places of x, y and z among the fields; capital letters count where there are no others.

        Raises:
            CloudError: One is not there once, or is no single number.
        """
        single = {k: own for k, own in enumerate(self.fields) if own.count_type is None}
        places = []
        for axis in "xyz":
            own = [k for k, f in single.items() if f.name == axis]
            own = own or [k for k, f in single.items() if f.name == axis.upper()]
            if len(own) != 1:
                raise CloudError(f"has {len(own)} fields {axis!r}, not one")
            if single[own[0]].repeat != 1:
                raise CloudError("has more than one number in x, y or z of a point")
            places += own
        return places

    @property
    def xyz_type(self) -> np.dtype:
        """The type that holds all three."""
        return np.result_type(*(self.fields[k].type for k in self.xyz))


def header_lines(data: bytes, last: str) -> tuple[list[list[str]], int] | None:
    """Words of each line of a header, and the offset of what follows.

    Lines end in a line feed, after which encoding the text may be in.

    Args:
        data: The file.
        last: First word of the last line, in small letters.

    Returns:
        None: there is no such line.
    """
    lines, at = [], 0
    while (end := data.find(b"\n", at, MAX_HEADER)) >= 0:
        lines.append([word.decode("latin-1") for word in data[at:end].split()])
        at = end + 1
        if lines[-1] and lines[-1][0].lower() == last:
            return lines, at
    return None


def read_cloud(
    path: str | os.PathLike, kind: str, decode: Callable[[bytes], np.ndarray]
) -> np.ndarray:
    """[n, 3] points of a file as floating numbers, without those that have a NaN.

    Args:
        path: The file.
        kind: Name of its format.
        decode: What reads it.

    Raises:
        RecordingError: The file is missing, or `decode` raises `CloudError`.
    """
    data = read_bytes(path, RecordingError)
    try:
        return seen(decode(data))
    except CloudError as fault:
        fix = f"export the point cloud again as {kind}"
        raise RecordingError(str(fault), where=str(path), fix=fix) from None


def check_points(count: int) -> None:
    """Refuse a cloud of more points than cameras have.

    Raises:
        CloudError: It has.
    """
    if count > MOST_POINTS:
        raise CloudError(f"announces {count} points, at most {MOST_POINTS} are read")


def check_length(there: int, needed: int, unit: str) -> None:
    """Refuse a file that ends too early.

    Raises:
        CloudError: Fewer numbers or bytes (`unit`) are there than needed.
    """
    if there < needed:
        raise CloudError(f"is cut short: {there} {unit} where {needed} are announced")


def points_of_text(data: bytes, at: int, elements: list[Element]) -> np.ndarray:
    """[n, 3] coordinates of the last of some elements, the first of which begins at an offset.

    Raises:
        CloudError: The text is cut short or too large, or something is no number.
    """
    numbers = sum(own.count * own.width for own in elements)
    if len(data) - at > LARGEST_TEXT or numbers > MOST_NUMBERS:
        what = f"is text of {len(data) - at} bytes and {numbers} numbers, at most {LARGEST_TEXT}"
        raise CloudError(f"{what} and {MOST_NUMBERS} are read: have it binary")
    stream, table = chain.from_iterable(map(_floats, _BLOCK.finditer(data, at))), np.zeros((0, 0))
    try:
        for element in elements:
            if element.has_list:
                rows = [list(_listed(stream, element)) for _ in range(_few(element))]
                table = np.array(rows).reshape(element.count, len(element.fields))
                continue
            needed = element.count * element.width
            found = np.fromiter(islice(stream, needed), np.float64)
            check_length(len(found), needed, "numbers")
            table = found.reshape(element.count, element.width)
    except ValueError as fault:
        raise CloudError(f"has a coordinate that is no number ({fault})") from None
    except RuntimeError:  # the numbers end in a row
        raise CloudError("is cut short: numbers are missing") from None
    last = elements[-1]
    repeats = [1 if last.has_list else own.repeat for own in last.fields]
    first = np.cumsum([0, *repeats])[last.xyz]
    with np.errstate(over="ignore", invalid="ignore"):
        return table[:, first].astype(last.xyz_type)


def _floats(block: re.Match[bytes]) -> Iterator[float]:
    """The numbers in some bytes of a text."""
    if len(block[0]) > 4096 + LONGEST:
        raise ValueError(f"more than {LONGEST} characters: {block[0][-20:]!r}")
    odd = b"(" in block[0] or b"#" in block[0]
    return map(float, (_ODD_NANS.sub(b"nan", block[0]) if odd else block[0]).split())


def _listed(stream: Iterator[float], element: Element) -> Iterator[float]:
    """One row of an element with lists, the lengths of those in their place."""
    for own in element.fields:
        value = next(stream)
        if own.count_type is not None:
            for _ in range(_length(value, own)):
                next(stream)
        yield value


def points_of_bytes(data: bytes, at: int, elements: list[Element], order: str) -> np.ndarray:
    """[n, 3] coordinates of the last of some elements, the first of which begins at an offset.

    Raises:
        CloudError: The data are cut short.
    """
    table = np.zeros((0, 0))
    for element in elements:
        if not element.has_list:
            row = element.row(order)
            if element is elements[-1]:
                check_length(len(data), at + element.count * row.itemsize, "bytes")
                rows = np.frombuffer(data, row, element.count, at)
                return _stacked([rows[f"f{k}"][:, 0] for k in element.xyz], element)
            at += element.count * row.itemsize
            continue
        check_length(len(data), at + element.count, "bytes")  # a row has at least one
        table = np.empty((_few(element), len(element.fields)))
        for k in range(element.count):
            for j, own in enumerate(element.fields):
                first = np.dtype(order + (own.count_type or own.type))
                check_length(len(data), at + first.itemsize, "bytes")
                table[k, j] = np.frombuffer(data, first, 1, at)[0]
                at += first.itemsize
                if own.count_type is not None:
                    at += _length(table[k, j], own) * np.dtype(own.type).itemsize
    return _stacked(list(table.T[elements[-1].xyz]), elements[-1])


def points_of_columns(data: bytes | bytearray, element: Element) -> np.ndarray:
    """[n, 3] coordinates of an element that is stored field after field, as little endian."""
    sizes = [np.dtype(own.type).itemsize * own.repeat for own in element.fields]
    starts = np.cumsum([0, *sizes]) * element.count
    columns = [
        np.frombuffer(data, f"<{element.fields[k].type}", element.count, int(starts[k]))
        for k in element.xyz
    ]
    return _stacked(columns, element)


def _stacked(columns: list[np.ndarray], element: Element) -> np.ndarray:
    return np.stack([column.astype(element.xyz_type) for column in columns], axis=1)


def _few(element: Element) -> int:
    """Number of rows with lists, if they are not too many."""
    if element.count > MOST_LISTS:
        raise CloudError(f"is cut short, or has more than {MOST_LISTS} rows of lists")
    return element.count


def _length(value: float, own: Field) -> int:
    """Of a list."""
    if not (0.0 <= value <= LARGEST_FILE and value == int(value)):
        raise CloudError(f"has {value:g} as the length of the list {own.name!r}")
    return int(value)


def seen(points: np.ndarray) -> np.ndarray:
    """The same points as floating numbers, without those that have a NaN: in organised clouds these
    are pixels that saw nothing."""
    if points.dtype not in (np.float32, np.float64):
        points = points.astype(np.float64)
    hidden = np.isnan(points).any(axis=1)
    return points[~hidden] if hidden.any() else points
