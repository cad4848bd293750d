"""What readers of point clouds share: fields of points as text or bytes become coordinates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

MAX_HEADER = 1 << 16
"""Longest header that is searched [bytes]."""


class CloudError(Exception):
    """A fault of a file; the caller adds the file's name."""


def check_length(there: int, needed: int, unit: str) -> None:
    """Refuse a file that ends too early.

    Raises:
        CloudError: Fewer numbers or bytes (`unit`) are there than needed.
    """
    if there < needed:
        raise CloudError(f"is cut short: {there} {unit} where {needed} are announced")


def numbers_of(table: np.ndarray, kind: np.dtype) -> np.ndarray:
    """[n, 3] coordinates of a type from text.

    Raises:
        CloudError: A text is no number.
    """
    try:
        return table.astype(np.float64).astype(kind)
    except ValueError as error:
        raise CloudError(f"has a coordinate that is no number ({error})") from None


def columns_of(
    data: bytes | bytearray,
    start: int,
    types: Sequence[np.dtype],
    count: int,
    xyz: Sequence[int],
    repeats: Sequence[int] | None = None,
) -> np.ndarray:
    """[n, 3] coordinates from rows of fields, in the type that holds all three.

    Args:
        data: They begin at `start`, and are as long as `count` rows.
        start: Offset [bytes].
        types: Of the fields.
        count: Number of rows, n.
        xyz: Which fields are x, y and z.
        repeats: How many numbers each field has (default: one); those of `xyz` have one.
    """
    sizes = repeats or [1] * len(types)
    fields = [(f"f{k}", kind, (n,)) for k, (kind, n) in enumerate(zip(types, sizes, strict=True))]
    rows = np.frombuffer(data, np.dtype(fields), count, start)
    kind = np.result_type(*(types[k].newbyteorder("=") for k in xyz))
    return np.stack([rows[f"f{k}"][:, 0].astype(kind) for k in xyz], axis=1)


def as_float(points: np.ndarray) -> np.ndarray:
    """The same points, integers as float64."""
    return points if points.dtype.kind == "f" else points.astype(np.float64)
