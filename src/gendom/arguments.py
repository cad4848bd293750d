"""Checks of arguments: each error names the argument, the place in it and the value there."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.errors import ParameterError

Shape = tuple[int | str, ...]
"""Sizes of the axes; a name is any size."""


def check_numbers(
    name: str,
    values: Any,
    *shapes: Shape,
    least: float = -math.inf,
    above: float | None = None,
    finite: bool = True,
) -> NDArray[np.float64]:
    """Check numbers and return them as an array.

    Args:
        name: Name of the argument.
        values: What was given.
        shapes: Shapes that it may have (default: any); () is one number.
        least, above: Bounds.
        finite: Whether NaN and infinity are refused.

    Raises:
        ParameterError: If they are text, ragged or of another shape, not finite or out of bounds.
    """
    wanted = " or ".join(f"[{', '.join(map(str, s))}]" if s else "one number" for s in shapes)
    try:
        a = np.asarray(values)
        if a.dtype.kind not in "iufO":  # text is not read as numbers, nor a mask as 0 and 1
            raise TypeError
        a = a.astype(float, copy=False)
    except (TypeError, ValueError, OverflowError, RuntimeError):
        raise ParameterError(
            f"{name} must be {wanted or 'numbers'}, got {shown(values)}",
            fix="give numbers, and rows of equal length",
        ) from None
    if shapes and not any(_fits(a.shape, shape) for shape in shapes):
        raise ParameterError(f"{name} must be {wanted}, got shape {list(a.shape)}: {shown(values)}")
    bad = (a < least) | (a <= (-math.inf if above is None else above) if above is not None else False)
    if finite:
        bad = bad | ~np.isfinite(a)
    if bad.any():
        at = np.unravel_index(int(bad.argmax()), a.shape)
        limit = f" and at least {least:g}" if least > -math.inf else ""
        limit = f" and above {above:g}" if above is not None else limit
        place = f" at [{', '.join(map(str, at))}]" if at else ""
        raise ParameterError(f"{name} must be finite{limit}, got {a[at]:g}{place}")
    return a
