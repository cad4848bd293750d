"""Sections with tables of text and with curves, such as those of `gendom reproduce`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gendom.viz.plot import Axis, Plot
from gendom.viz.report.markup import cell, chart_figure, escaped, number, table
from gendom.viz.report.page import Section

LINES = 4
"""Colours of curves, by `start-1` and so on of the style sheet; then they begin again."""


def table_section(
    title: str, head: Sequence[str], rows: Mapping[str, Sequence[str]], note: str = ""
) -> Section:
    """A table of plain text: names in the first column, numbers in the others.

    Args:
        title: Of the section.
        head: [C] of all columns but the first.
        rows: [C] texts by name.
        note: Below it.
    """
    below = f'<p class="note">{escaped(note)}</p>' if note else ""
    cells = ["<th></th>", *(f'<th class="number">{escaped(text)}</th>' for text in head)]
    body = [
        "<tr>"
        + cell(escaped(name))
        + "".join(number(text, label) for text, label in zip(texts, head, strict=True))
        + "</tr>"
        for name, texts in rows.items()
    ]
    return Section(title=title, body=table(cells, body) + below)


def curves_section(
    title: str,
    x_label: str,
    y_label: str,
    lines: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    *,
    log: bool = False,
) -> Section:
    """Lines over a common axis.

    Args:
        title: Of the section.
        x_label: With the unit; plain text.
        y_label: The same.
        lines: Places and values by name.
        log: Whether both axes are logarithmic.
    """
    every_x = np.concatenate([np.asarray(x, dtype=float) for x, _ in lines.values()])
    every_y = np.concatenate([np.asarray(y, dtype=float) for _, y in lines.values()])
    plot = Plot(
        x=Axis.around(every_x, log=log, label=x_label),
        y=Axis.around(every_y if log else [0.0, *every_y], log=log, label=y_label),
    )
    for k, (name, (x, y)) in enumerate(lines.items()):
        plot.line(x, y, f"start-{k % LINES + 1}", name, dots=True)
    return Section(title=title, body=chart_figure(y_label, [plot]))
