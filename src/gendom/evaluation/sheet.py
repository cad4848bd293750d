"""Parts of tables: rows of text, curves over an axis, histograms of ranks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """A table of text: names in the first column, numbers in the others."""

    title: str
    head: tuple[str, ...]
    """Of all columns but the first."""
    rows: Mapping[str, tuple[str, ...]]
    """By the text of the first column."""

    def __str__(self) -> str:
        """Columns set below each other."""
        first = max(map(len, (self.title, *self.rows)))
        widths = [
            max(len(text) for text in column)
            for column in zip(self.head, *self.rows.values(), strict=True)
        ]
        lines = [(self.title, self.head), *self.rows.items()]
        return "\n".join(
            f"{name:<{first}}"
            + "".join(f"  {text:>{w}}" for text, w in zip(texts, widths, strict=True))
            for name, texts in lines
        )


@dataclass(frozen=True, kw_only=True)
class Curves:
    """Lines over a common axis."""

    title: str
    x: str
    """What the axis has."""
    y: str
    log: bool
    """Whether both axes are logarithmic."""
    lines: Mapping[str, tuple[Sequence[float], Sequence[float]]]
    """Places and values by name."""


@dataclass(frozen=True, kw_only=True)
class Ranks:
    """A histogram of ranks of true values in their posteriors."""

    title: str
    counts: tuple[int, ...]
    """Of ranks in equal parts of 0 to 1."""
    band: tuple[int, int]
    """In which counts of uniform ranks lie."""
    band_label: str
    """What it says."""
