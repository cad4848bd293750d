"""JSON, TOML and CSV tables of others, those included that an interrupted program left.

What is read is bounded before memory is taken: only regular files, of sizes up to those below; text
that is nested `DEEPEST` times at most, with integers of 64 bits.

In all functions `error` is the class that is raised for every fault, and `where` what messages call
the place of what was read.
"""

import codecs
import csv
import io
import json
import math
import os
import stat
import tomllib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import numpy as np

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import GendomError, RecordingError, did_you_mean

Record = TypeVar("Record")

LARGEST_FILE = 1 << 28
"""Of a file that is read whole, and of what compressed data unpacks to [bytes]."""

MOST_UNPACKED = 64
"""How many times their size large compressed data may unpack to."""

LARGEST_CSV, LARGEST_JSON, LARGEST_TOML = 1 << 23, 1 << 23, 1 << 16
"""Of files of text [bytes]: numbers as text take twenty times their size in memory."""

MOST_ROWS = 1 << 15
"""Of a CSV file: half a minute at 1 kHz, 18 minutes at 30 Hz."""

MOST_COLUMNS = 1 << 8
"""Of a CSV file."""

MOST_PIXELS = 1 << 24
"""Of a picture."""

MOST_DEPTHS = 1 << 22
"""Of a depth picture: twice those of large depth cameras."""

DEEPEST = 64
"""How deep lists and tables may be nested."""

MOST_DOTS = 256
"""In a line of TOML: reading a key of so many parts takes a time that grows with their cube."""


wanted = partial(require, error=RecordingError)
"""`require` of recordings."""


def near_name(path: str | os.PathLike) -> str:
    """A question that names a file of nearly the same name; empty: there is none."""
    folder, name = os.path.split(path)
    try:
        names = [other for other in os.listdir(folder or ".") if other != name]
        return did_you_mean(name, names, cutoff=0.85)
    except OSError:
        return ""


def file_size(
    path: str | os.PathLike,
    error: type[GendomError] = GendomError,
    *,
    most: int = LARGEST_FILE,
    missing: str = "no such file",
    fix: str = "check the path",
) -> int:
    """Size of a regular file [bytes]; it is not opened, as pipes and devices would wait or never
    end.

    Args:
        path: Named by a person.
        error: See the module.
        most: Largest size that may be read [bytes].
        missing, fix: What is wrong when there is no such file, and what to do then.

    Raises:
        GendomError: As `error`: the file is missing, no regular one, or too large.
    """
    try:
        found = os.stat(path)
    except FileNotFoundError:
        missing = "is a link to a file that is not there" if os.path.islink(path) else missing
        raise error(missing, where=str(path), fix=near_name(path) or fix) from None
    except (OSError, ValueError) as fault:  # ValueError: a zero byte in the name
        what = f"cannot be read ({getattr(fault, 'strerror', fault)})"
        raise error(what, where=str(path), fix="check the path") from None
    what = "is a folder" if stat.S_ISDIR(found.st_mode) else "is a pipe or device, not a file"
    require(stat.S_ISREG(found.st_mode), what, path, "name a file", error)
    what = f"has {found.st_size} bytes, at most {most} are read"
    require(found.st_size <= most, what, path, "check that it is the right file", error)
    return found.st_size


def read_bytes(
    path: str | os.PathLike, error: type[GendomError] = GendomError, **bounds: Any
) -> bytes:
    """All of a file; arguments and errors as of `file_size`, and where it cannot be read."""
    size = file_size(path, error, **bounds)
    try:
        with open(path, "rb") as file:
            return file.read(size)
    except OSError as fault:
        what = f"cannot be read ({fault.strerror})"
        raise error(what, where=str(path), fix="check the file") from None


def check_unpacked(
    size: int, packed: int, where: str, error: type[GendomError] = GendomError
) -> None:
    """Refuse compressed data that unpack to more than `LARGEST_FILE` and `MOST_UNPACKED` times
    their size [bytes]; real arrays and pictures shrink less.

    Raises:
        GendomError: As `error`: they do.
    """
    most = max(LARGEST_FILE, MOST_UNPACKED * packed)
    what = f"unpacks to {size} bytes or more, at most {most} are read"
    require(size <= most, what, where, "check where it comes from", error)


def inside(folder: str | os.PathLike, name: str, *, where: str) -> str:
    """The path of a file that another file names, relative to its folder, with / or, as Windows
    writes them, backslashes.

    Raises:
        RecordingError: The name leads out of the folder.
    """
    parts = name.replace("\\", "/").split("/")
    stays = parts[0] and parts[0][1:2] != ":" and ".." not in parts and "\0" not in name
    if not stays:
        fix = "name files below that folder"
        raise RecordingError(f"{name!r} is not in {folder}", where=where, fix=fix)
    return os.path.join(folder, *parts)


def decoded(data: bytes, errors: str = "strict") -> str:
    """Text of bytes: UTF-8, or UTF-16 after its byte order mark.

    Raises:
        UnicodeDecodeError: They are neither, and `errors` is "strict".
    """
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    if not wide and errors == "strict" and (at := data.find(0)) >= 0:
        raise UnicodeDecodeError("utf-8", data, at, at + 1, "a zero byte, save it as UTF-8")
    return data.decode("utf-16" if wide else "utf-8-sig", errors)


def read_json(
    path: str | os.PathLike, error: type[GendomError] = GendomError, **fix: str
) -> dict[str, Any]:
    """The JSON object in `path`; errors as of `read_bytes` and `parse_json`."""
    return parse_json(read_bytes(path, error, most=LARGEST_JSON), str(path), error, **fix)


def parse_json(
    content: bytes | str,
    where: str,
    error: type[GendomError] = GendomError,
    fix: str = "write the file again",
) -> dict[str, Any]:
    """The object that JSON text holds; `fix` is what to do where it is no JSON.

    Raises:
        GendomError: As `error`: it is no JSON or no object, is nested too deep, or has a number
            that is too large.
    """
    try:
        text = decoded(content) if isinstance(content, bytes) else content
        value = json.loads(text, parse_constant=_refuse_constant)
        what = f"holds a JSON {type(value).__name__}, not an object"
        require(isinstance(value, dict), what, where, "is it the right file?", error)
        _check_tree(value, finite=True)
    except json.JSONDecodeError as fault:
        what = f"is not JSON ({fault.msg} in line {fault.lineno})"
        raise error(what, where=where, fix=fix) from None
    except (ValueError, RecursionError) as fault:  # not UTF-8, NaN, or `_check_tree`
        raise error(f"is not JSON ({fault})", where=where, fix=fix) from None
    return value


def record_of(
    kind: type[Record],
    value: Any,
    *,
    where: str,
    fix: str,
    by_hand: bool = False,
    error: type[GendomError] = GendomError,
) -> Record:
    """A dataclass of what JSON or TOML holds: each of its fields has the type that it says (arrays
    as lists of numbers), those without a default are there. What else is there is left out, or in
    what people write `by_hand` refused. `fix` is what to do about a fault.

    Raises:
        GendomError: As `error`, with the place of the first fault; or what the class raises.
    """
    import msgspec

    if by_hand:
        _check_keys(kind, value, where, error)
    try:
        return msgspec.convert(value, kind, dec_hook=_array_of)
    except (msgspec.ValidationError, RecursionError) as fault:
        what, _, place = str(fault).replace("`", "").partition(" - at $")
        place = f"{where}: {place.lstrip('.')}" if place else where
        raise error(f"{what[0].lower()}{what[1:]}", where=place, fix=fix) from None


def _check_keys(kind: Any, table: dict[str, Any], where: str, error: type[GendomError]) -> None:
    """Refuse keys that are no fields, but for `path`, the place of the file."""
    known, types = [f.name for f in fields(kind) if f.name != "path"], get_type_hints(kind)
    for key, value in table.items():
        fix = did_you_mean(key, known) or f"known are {', '.join(known)}"
        require(key in known, f"has the unknown key {key!r}", where, fix, error)
        inner = next((k for k in (types[key], *get_args(types[key])) if is_dataclass(k)), None)
        for n, entry in enumerate(value if isinstance(value, list) else [value]):
            if inner is not None and isinstance(entry, dict):
                place = f"{key}[{n}]" if isinstance(value, list) else key
                _check_keys(inner, entry, f"{where}: {place}", error)


def _array_of(_: Any, value: Any) -> Array:
    """What a field that is an array takes.

    Raises:
        ValueError: It is no number, and no list of numbers or of equally long such lists.
    """
    array = np.array(value)
    if array.dtype.kind not in "iuf":
        raise ValueError("expected an array of numbers")
    return array.astype(np.float64)


def read_toml(
    path: str | os.PathLike, *, error: type[GendomError] = GendomError, **bounds: Any
) -> dict[str, Any]:
    """The TOML table in `path`; arguments as of `file_size`.

    Raises:
        GendomError: As `error`: the file is missing, unreadable or no TOML, is nested too deep, or
            has an integer that is too large.
    """
    content = read_bytes(path, error, most=LARGEST_TOML, **bounds)
    try:
        text = decoded(content)
        if max(line.count(".") for line in text.split("\n")) > MOST_DOTS:
            raise ValueError(f"a line with more than {MOST_DOTS} dots")
        value = tomllib.loads(text)
        _check_tree(value)
        return value
    except (ValueError, RecursionError) as fault:
        raise error(f"is not TOML ({fault})", where=str(path), fix="mend that line") from None


def _check_tree(value: Any, *, finite: bool = False) -> None:
    """Check what is nested in lists and tables.

    Raises:
        ValueError: It is so too deep, holds an integer that no 64 bits hold or, with `finite`, a
            number that overflowed.
    """
    level = [value]
    for _ in range(DEEPEST):
        level = [
            inner
            for outer in level
            for inner in (outer.values() if isinstance(outer, dict) else outer)
            if not isinstance(inner, str)
        ]
        for number in level:
            if isinstance(number, int) and not -(1 << 63) <= number < 1 << 63:
                raise ValueError(f"an integer of {number.bit_length()} bits")
            if finite and isinstance(number, float) and not math.isfinite(number):
                raise ValueError("a number beyond 1e308")
        level = [inner for inner in level if isinstance(inner, (dict, list))]
        if not level:
            return
    raise ValueError(f"it is nested more than {DEEPEST} times")


def read_rows(
    path: str | os.PathLike,
    *,
    header: str,
    damaged: bool = False,
    error: type[GendomError] = RecordingError,
) -> list[tuple[int, list[str]]]:
    """Number and values of each line of a CSV file that is not empty, without blanks around values.

    Args:
        path: The file.
        header: What its first line should be, for messages.
        damaged: Whether bytes that are no UTF-8 are replaced in place of refused.
        error: See the module.

    Raises:
        GendomError: As `error`: the file is missing, too large, empty or no CSV.
    """
    fix = f"write one row a frame under {header}"
    content = read_bytes(path, error, most=LARGEST_CSV, fix=fix)
    rows, fix = max(map(content.count, (b"\n", b"\r"))), "keep one lift, or every tenth row"
    what = f"has {rows} rows, at most {MOST_ROWS} are read"
    require(rows <= MOST_ROWS, what, path, fix, error)
    try:
        text = decoded(content, "replace" if damaged else "strict")
        reader = csv.reader(io.StringIO(text, newline=""))
        lines = [(reader.line_num, [text.strip() for text in row]) for row in reader if row]
    except (UnicodeDecodeError, csv.Error) as fault:
        raise error(f"is not CSV ({fault})", where=str(path), fix="save it as CSV") from None
    write = f"write the header {header}"
    require(lines, "is empty", path, write, error)
    odd = next((mark for mark in ";\t" if mark in text.partition("\n")[0]), None)
    fix = "separate values by commas, and write decimals with a point"
    require(odd is None, f"is separated by {odd!r}", path, fix, error)
    count = len(lines[0][1])
    require(count <= MOST_COLUMNS, f"has {count} columns", path, write, error)
    return lines


def read_number_table(
    path: str | os.PathLike,
    *,
    header: str,
    check_header: Callable[[list[str]], Any],
    on_cut: Callable[[int], None] | None = None,
    error: type[GendomError] = RecordingError,
) -> tuple[list[str], Array, list[int]]:
    """Read a CSV file of numbers under a header.

    Args:
        path: The file.
        header: What its first line should be, for messages.
        check_header: Called with the names of the columns; raises an error for wrong ones.
        on_cut: Called with the number of the last line if it is incomplete because the recording
            was interrupted. The line is then skipped; None: an incomplete line is an error.
        error: See the module.

    Returns:
        Names of the C columns, numbers [N, C], and the N lines' numbers in the file.

    Raises:
        GendomError: As `error`: the file cannot be read, holds no rows, or a row is malformed.
    """
    (_, names), *lines = read_rows(path, header=header, error=error)
    require(lines, "holds a header and no rows", path, "write one row a frame", error)
    check_header(names)
    number, last = lines[-1]
    cut = len(last) < len(names) or (len(last) == len(names) and not _is_number(last[-1]))
    whole = Path(path).read_bytes().endswith((b"\n", b"\r"))
    if on_cut is not None and not whole and len(lines) > 1 and cut:
        on_cut(number)
        del lines[-1]
    with suppress(ValueError):  # a cell that is no number, or rows of several lengths
        table = np.array([row for _, row in lines], dtype=np.float64)
        plain = not any("_" in text for _, row in lines for text in row)  # 1_0 is 10 in Python
        if plain and table.shape[1] == len(names):
            return names, table, [number for number, _ in lines]
    for number, row in lines:
        what, where = f"{len(row)} values under {len(names)} column names", f"{path}, line {number}"
        require(len(row) == len(names), what, where, "give one value a column", error)
        for name, text in zip(names, row, strict=True):
            what, place = f"{text[:60]!r} is no number", f"{where}, column {name}"
            require(_is_number(text), what, place, "give seconds and metres", error)
    raise error("is no table of numbers", where=str(path), fix="give seconds and metres")


def number_of(text: str) -> float:
    """The number that a text is. Python's own reading takes 1_0 for 10.

    Raises:
        ValueError: It is none.
    """
    return float(text.replace("_", "underscore"))


def _is_number(text: str) -> bool:
    with suppress(ValueError):
        number_of(text)
        return True
    return False


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not a JSON number")
