"""Rows of CSV files with a header."""

from __future__ import annotations

import csv
from pathlib import Path

from gendom.errors import RecordingError


def read_rows(path: Path, *, header: str, damaged: bool = False) -> list[tuple[int, list[str]]]:
    """Number and values of each line that is not empty, without blanks around values.

    Args:
        path: The file.
        header: What its first line should be, for messages.
        damaged: Whether bytes that are no UTF-8 are replaced in place of refused.

    Raises:
        RecordingError: The file is missing, empty or no CSV.
    """
    try:
        errors = "replace" if damaged else "strict"
        with open(path, newline="", encoding="utf-8-sig", errors=errors) as file:
            reader = csv.reader(file)
            lines = [(reader.line_num, [text.strip() for text in row]) for row in reader if row]
    except FileNotFoundError:
        fix = f"write one row a frame under {header}"
        raise RecordingError("no such file", where=str(path), fix=fix) from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        what = f"is not CSV ({error})"
        raise RecordingError(what, where=str(path), fix="save it as CSV") from None
    if not lines:
        raise RecordingError("is empty", where=str(path), fix=f"write the header {header}")
    return lines
