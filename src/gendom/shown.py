"""``repr`` and notebook tables of objects: a title and rows."""

from __future__ import annotations

import html
from collections.abc import Sequence


class Shown:
    """Gives ``repr`` and a notebook's table to classes that have `_shown`."""

    def _shown(self) -> tuple[str, Sequence[tuple[str, ...]]]:
        """Title, and rows whose first cell is a name."""
        raise NotImplementedError

    def __repr__(self) -> str:
        title, rows = self._shown()
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        cells = [[c.ljust(w) for c, w in zip(row, widths, strict=True)] for row in rows]
        return "\n".join([title, *("  " + "  ".join(row).rstrip() for row in cells)])

    def _repr_html_(self) -> str:
        title, rows = self._shown()
        cells = "".join(
            "<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>" for row in rows
        )
        return f"<table><caption>{html.escape(title)}</caption>{cells}</table>"
