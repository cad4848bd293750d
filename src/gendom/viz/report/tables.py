"""Sections with tables of text, curves and ranks, such as those of `gendom reproduce`."""

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


def ranks_section(
    title: str, counts: Sequence[int], band: tuple[int, int], band_label: str
) -> Section:
    """A histogram of ranks between 0 and 1, and a band in which its bars should end.

    Args:
        title: Of the section.
        counts: [B] heights of the bars.
        band: Its lower and upper end.
        band_label: What it is; plain text.
    """
    edges = np.repeat(np.linspace(0.0, 1.0, len(counts) + 1), 2)[1:-1]
    heights = np.repeat(np.asarray(counts, dtype=float), 2)
    plot = Plot(
        x=Axis(low=0.0, high=1.0, label="share of the posterior below the truth"),
        y=Axis(low=0.0, high=1.1 * max(*counts, band[1])),
    )
    plot.area(edges, heights, "posterior", "lifts")
    plot.line(edges, heights, "posterior")
    plot.level(band[0], "truth", band_label)
    plot.level(band[1], "truth")
    return Section(title=title, body=chart_figure("lifts by rank", [plot]))
