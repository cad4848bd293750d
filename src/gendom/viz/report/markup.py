"""The page of a report, and its pieces: escaped text, tables, lists of facts, figures, charts."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import resources

from gendom.viz.charts import Plot, legend

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


def chart_figure(title: str, plots: Sequence[Plot], note: str = "") -> str:
    """Charts below each other under one heading, with their legends and a note; plain text."""
    parts = [f'<figcaption class="title">{escaped(title)}</figcaption>']
    for plot in plots:
        parts += [legend(plot.entries), plot.svg(title)]
    if note:
        parts.append(f'<p class="note">{escaped(note)}</p>')
    return f'<figure class="chart">{"".join(parts)}</figure>'


@dataclass(frozen=True, kw_only=True)
class Section:
    """One part of a report, under a heading of its own."""

    title: str
    """Plain text."""
    body: str
    """HTML."""

    @property
    def name(self) -> str:
        """The section's id in the page."""
        return "-".join(re.findall("[a-z]+", self.title.lower()))

    @property
    def html(self) -> str:
        return f'<section id="{self.name}"><h2>{escaped(self.title)}</h2>\n{self.body}\n</section>'


def render_page(title: str, opening: str, sections: Sequence[Section]) -> str:
    """A whole HTML document, with contents, style and script inside.

    Args:
        title: Plain text, for the browser and the heading.
        opening: HTML between the heading and the sections.
        sections: In the order of the page.
    """
    body = "\n".join([f"<h1>{escaped(title)}</h1>", opening, *(s.html for s in sections)])
    links = "".join(f'<li><a href="#{s.name}">{escaped(s.title)}</a></li>' for s in sections)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; \
style-src 'unsafe-inline'; script-src 'unsafe-inline'">
<title>{escaped(title)}</title>
<style>
{_asset("report.css")}</style>
</head>
<body>
<div class="page">
<nav class="contents" aria-label="Contents">
<div class="bar"><strong>Contents</strong><button type="button" id="theme" hidden></button></div>
<ol>{links}</ol>
</nav>
<main>
{body}
</main>
</div>
<script>
{_asset("report.js")}{_asset("viewer.js")}</script>
</body>
</html>
"""


def _asset(name: str) -> str:
    return resources.files("gendom.viz.report").joinpath(name).read_text(encoding="utf-8")
