"""Results for people or as JSON, places for files, and tables of text."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gendom.datasets import Fault
from gendom.errors import GendomError, printable
from gendom.files import atomic_path, check_file, check_folder, to_json, write_json

if TYPE_CHECKING:
    from PIL import Image


class _Lines(io.TextIOBase):
    """Lines for a terminal, which obeys none of them."""

    def __init__(self, to: Any):
        self._to = to

    def write(self, text: str) -> int:
        self._do(self._to.write, "\n".join(map(printable, text.split("\n"))))
        return len(text)

    def flush(self) -> None:
        self._do(self._to.flush)

    def _do(self, work: Callable[..., Any], *given: str) -> None:
        """A reader that has gone, such as `head`, does not stop the work: files are written."""
        try:
            work(*given)
        except BrokenPipeError:
            with suppress(OSError, ValueError):  # all further text goes nowhere
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._to.fileno())


@contextmanager
def escaped() -> Iterator[None]:
    """What is printed inside comes out `printable`, line by line, whatever names it holds."""
    with redirect_stdout(_Lines(sys.stdout)):
        yield


def check_places(*places: tuple[Path | None, str]) -> None:
    """Refuse what cannot be written before the work, not after it.

    Args:
        places: Paths, None where nothing is written, each with the ending of its name; no ending
            where it is a folder.
    """
    for path, ending in places:
        if path is not None:
            check_file(path, ending) if ending else check_folder(path)


def tell_written(path: Path, *, json: bool = False) -> None:
    """Name a file that was written: on stdout, or on stderr where stdout holds JSON."""
    print(f"written: {printable(path)}", file=sys.stderr if json else sys.stdout)


def write_result(path: Path | None, record: Any, *, json: bool) -> None:
    """Write a JSON file and name it, if one is wanted."""
    if path is not None:
        write_json(path, record)
        tell_written(path, json=json)


def write_picture(path: Path, picture: Image.Image, *, json: bool = False) -> None:
    """Write a PNG, and name it."""
    with atomic_path(path) as temporary:
        picture.save(temporary, "PNG")
    tell_written(path, json=json)


def fault_entry(fault: Fault | GendomError) -> dict[str, str | None]:
    """A fault for JSON."""
    return {"what": fault.what, "where": fault.where, "fix": fault.fix}


def print_result(
    summary: Mapping[str, Any], text: str, warnings: Sequence[Fault], *, json: bool
) -> None:
    """Print what a command has found, as JSON or for people, and its warnings below."""
    if json:
        print(to_json({**summary, "warnings": [fault_entry(w) for w in warnings]}))
    else:
        print("\n".join([text, *(f"  warning   {warning}" for warning in warnings)]))


def columns(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of text: names in the first column, numbers in the others."""
    lines = [tuple(head), *map(tuple, rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        f"{name:<{widths[0]}}"
        + "".join(f"  {text:>{w}}" for text, w in zip(texts, widths[1:], strict=True))
        for name, *texts in lines
    )
