"""Checks of arguments where they enter. Each raises a `ParameterError` unless they are right: one
line that names the argument, what is wanted and given, and the first bad element of several.

Shapes are those of docstrings, ``("K", 3)`` for [K, 3]: a word stands for any length, and ``()``
for a single number.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.arrays import Array
from gendom.errors import GendomError, ParameterError, did_you_mean

Shape = tuple[int | str, ...]


def require(
    holds: Any,
    what: str,
    where: object = None,
    fix: str | None = None,
    error: type[GendomError] = ParameterError,
) -> None:
    """Raise an error with this message unless the condition holds.

    Raises:
        GendomError: Of the given class, as "where: what; fix".
    """
    if not holds:
        raise error(what, where=None if where is None else str(where), fix=fix)


def check_choice(
    name: str, value: Any, choices: Iterable[str], *, where: str | None = None
) -> None:
    """Check that a value is one of some names; the error suggests the closest or lists all."""
    known = tuple(choices)
    if value not in known:
        fix = did_you_mean(str(value), known) or f"choose one of {', '.join(known)}"
        raise ParameterError(f"unknown {name} {value!r}", where=where, fix=fix)


def check_number(
    name: str, value: Any, *, least: float = -math.inf, above: float | None = None
) -> float:
    """Check a single finite number; arguments and errors as of ``check_numbers``."""
    within = isinstance(value, float) and value >= least and (above is None or value > above)
    if within and math.isfinite(value):  # most are, and NumPy would take longer
        return value
    return float(check_numbers(name, value, (), least=least, above=above))


def check_numbers(
    name: str,
    values: Any,
    *shapes: Shape,
    least: float = -math.inf,
    above: float | None = None,
    finite: bool = True,
) -> Array:
    """Check that values are numbers of one of the shapes, and in their range; NaN is in none.

    Args:
        name, values: The argument's name, and what was given.
        shapes: Shapes that it may have (default: any).
        least: Least number that is allowed.
        above: Number that all must exceed, or None.
        finite: Whether all must be finite.
    """
    a = _array(name, values, shapes, "iuf", "number").astype(float, copy=False)
    good = np.isfinite(a) if finite else ~np.isnan(a)
    if least > -math.inf:
        good &= a >= least
    if above is not None:
        good &= a > above
    if not good.all():
        asked = ["positive"] * (above == 0.0) + ["finite"] * finite
        asked += [f"above {above}"] if above else []
        asked += [f"at least {least:g}"] if least > -math.inf else []
        raise _refused(name, " and ".join(asked) or "a number", a, ~good)
    return a


def check_integers(
    name: str, values: Any, *shapes: Shape, least: int = 0, most: int | None = None
) -> NDArray[np.int64]:
    """Check that values are integers of one of the shapes, ``least`` to ``most`` (None: no end)."""
    a = _array(name, values, shapes, "iu", "integer").astype(np.int64, copy=False)
    bad = a < least
    if most is not None:
        bad |= a > most
    if bad.any():
        wanted = f"at least {least}" if most is None else f"{least} to {most}"
        raise _refused(name, wanted, a, bad)
    return a


def check_type(name: str, value: Any, kind: Any, *, optional: bool = False) -> None:
    """Check that a value is of a class, or with ``optional`` None."""
    kinds = (bool, np.bool_) if kind is bool else kind
    if not (isinstance(value, kinds) or (optional and value is None)):
        wanted = "True or False" if kind is bool else f"a {kind.__name__}"
        wanted += " or None" if optional else ""
        raise ParameterError(f"{name} must be {wanted}, got {short_repr(value)}")


def check_list(name: str, values: Any, kind: type) -> None:
    """Check that values are a sequence of elements of a class."""
    if not isinstance(values, Sequence) or isinstance(values, str):
        raise ParameterError(f"{name} must be a list of {kind.__name__}, got {short_repr(values)}")
    wrong = (k for k, value in enumerate(values) if not isinstance(value, kind))
    if (k := next(wrong, None)) is not None:
        check_type(f"{name}[{k}]", values[k], kind)


def _array(name: str, values: Any, shapes: tuple[Shape, ...], kinds: str, noun: str) -> Array:
    """Values as an array of a kind (``dtype.kind``) and shape."""
    try:
        a = np.asarray(values)
    except (TypeError, ValueError, RuntimeError):  # ragged, or a tensor that requires a gradient
        a = np.asarray(None)
    right = a.dtype.kind in kinds or a.size == 0
    if right and (not shapes or a.shape in shapes or any(fits(a.shape, of) for of in shapes)):
        return a
    single = f"an {noun}" if noun == "integer" else f"a {noun}"
    arrays = " or ".join(f"[{', '.join(map(str, shape))}]" for shape in shapes if shape)
    wanted = [single] * (() in shapes) + [f"{arrays} {noun}s".strip()] * (shapes != ((),))
    given = f"shape {list(a.shape)}" if right and a.ndim else short_repr(values)
    raise ParameterError(f"{name} must be {' or '.join(wanted)}, got {given}")


def fits(have: tuple[int, ...], wanted: Shape) -> bool:
    """Whether a shape is a wanted one."""
    return len(have) == len(wanted) and all(
        isinstance(length, str) or n == length for n, length in zip(have, wanted, strict=True)
    )


def _refused(name: str, wanted: str, a: Array, bad: NDArray[np.bool_]) -> ParameterError:
    """The error for an array whose first bad element is named."""
    k = tuple(int(i) for i in np.argwhere(bad)[0])
    place = f" at {list(k)}" if k else ""
    return ParameterError(f"{name} must be {wanted}, got {a[k]}{place}")


def short_repr(value: Any, most: int = 60) -> str:
    """A value in one line of so many characters at most."""
    text = " ".join(repr(value).split())
    return text if len(text) <= most else text[: most - 3] + "..."


def time_text(time: float) -> str:
    """A time [s], since 1970 or from a start, to a microsecond."""
    return f"{round(time, 6):.16g}"
