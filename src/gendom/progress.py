"""Progress bars for all commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_silent = False


Show = Callable[..., None]
"""Advances a bar: how much is done (at first, what was done before), of how much in all where that
is known only now, and a note that stands behind the bar: `show(done, total=None, note="")`."""


@contextmanager
def silence() -> Iterator[None]:
    """No bar shows inside."""
    global _silent
    before, _silent = _silent, True
    try:
        yield
    finally:
        _silent = before


@contextmanager
def bar(
    doing: str, total: float, unit: str, *, even: bool = False, shown: bool = True
) -> Iterator[Show]:
    """A bar of what is done of a total of units (named in the singular), in terminals, as wide as
    they are, and in notebooks. It is full, and removed, when the block ends without an error.

    Args:
        doing, total, unit: What is done, how much of it there is, and what is counted.
        even: Whether all units take about equally long, so that a rate is meaningful.
        shown: False: nothing shows at all.
    """
    from tqdm.auto import tqdm

    told = "{rate_noinv_fmt}, {remaining} left" if even else "{elapsed}"
    with tqdm(
        total=total,
        desc=doing,
        unit=f" {unit}",
        bar_format=f"{{l_bar}}{{bar}}| {unit} {{n_fmt}}/{{total_fmt}}, {told}{{postfix}}",
        smoothing=0.0,
        dynamic_ncols=True,
        leave=False,
        disable=None if shown and not _silent else True,
    ) as line:
        known = False

        def show(done: float, total: float | None = None, note: str = "") -> None:
            nonlocal known
            if not known:
                line.initial = done  # what was there already must not count as fast work
                known = True
            line.total = line.total if total is None else total
            line.set_postfix_str(note, refresh=False)
            line.update(min(done, line.total) - line.n)

        yield show
        line.total = line.n = line.n or line.total  # what ends early was all there was to do
        line.refresh()
