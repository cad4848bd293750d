"""Pieces of HTML: escaped text, tables, lists of facts, figures, charts."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence

from gendom.viz.plot import Plot, legend

DASH = "–"
"""Stands where a table has no value."""


def escaped(value: str) -> str:
    """Plain text as HTML, also inside an attribute."""
    return html.escape(value, quote=True)


def cell(inner: str, kind: str = "", *, label: str = "", columns: int = 1) -> str:
    """A table's cell of HTML.

    Args:
        inner: HTML.
        kind: A class of `report.css`.
        label: Plain text that stands before it where a narrow page stacks the cells.
        columns: How many it covers.
    """
    more = f' class="{kind}"' if kind else ""
    more += f' data-label="{escaped(label)}"' if label else ""
    more += f' colspan="{columns}"' if columns > 1 else ""
    return f"<td{more}>{inner}</td>"


def number(text: str, label: str = "") -> str:
    """A cell with a number, or `DASH`; plain text."""
    return cell(escaped(text), "number none" if text == DASH else "number", label=label)


def table(head: Iterable[str], rows: Iterable[str], kind: str = "stacked") -> str:
    """A table of HTML cells: those of the head, and rows.

    `kind` is a class of `report.css`; "stacked" puts a row's cells below each other on a narrow
    page.
    """
    return (
        f'<div class="scroll"><table class="{kind}"><thead><tr>{"".join(head)}</tr></thead>\n'
        "<tbody>\n" + "\n".join(rows) + "\n</tbody></table></div>"
    )


def facts_list(facts: Sequence[tuple[str, str]]) -> str:
    """Names and what they stand for, both plain text."""
    if not facts:
        return ""
    items = [f"<div><dt>{escaped(n)}</dt><dd>{escaped(v)}</dd></div>" for n, v in facts]
    return '<dl class="facts">\n' + "\n".join(items) + "\n</dl>"


def folded(summary: str, inner: str) -> str:
    """HTML that opens with a click on plain text."""
    return f"<details><summary>{escaped(summary)}</summary>{inner}</details>"


def figure(data: bytes, description: str, caption: str = "", *, kind: str) -> str:
    """A picture with plain text below it; arguments as `image`."""
    below = f"<figcaption>{escaped(caption)}</figcaption>" if caption else ""
    return f"<figure>{image(data, kind, description)}{below}</figure>"


def image(data: bytes, kind: str, description: str) -> str:
    """A picture inside the page.

    Args:
        data: The file.
        kind: "png", "jpeg" or "gif".
        description: For those who do not see it; plain text.
    """
    code = base64.b64encode(data).decode("ascii")
    return f'<img src="data:image/{kind};base64,{code}" alt="{escaped(description)}">'


def chart_figure(title: str, plots: Sequence[Plot], note: str = "") -> str:
    """Charts below each other under one heading, with their legends and a note; plain text."""
    parts = [f'<figcaption class="title">{escaped(title)}</figcaption>']
    for plot in plots:
        parts += [legend(plot.entries), plot.svg(title)]
    if note:
        parts.append(f'<p class="note">{escaped(note)}</p>')
    return f'<figure class="chart">{"".join(parts)}</figure>'
