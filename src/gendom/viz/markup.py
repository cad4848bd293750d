"""Pages, and their pieces: escaped text, tables, lists of facts."""

import re
from collections.abc import Mapping, Sequence
from html import escape as escaped
from importlib import resources

DASH = "–"
"""Stands where a table has no value."""


def table(columns: Mapping[str, str], rows: Sequence[Sequence[str]], *, totals: int = 0) -> str:
    """A table as HTML; a row's cells are below each other on a narrow page.

    Args:
        columns: Titles, and the class of `page.css` of each column's cells.
        rows: A text for each column.
        totals: How many of the last rows are means.
    """
    head = "".join(f'<th class="{of}">{escaped(title)}</th>' for title, of in columns.items())
    lines = []
    for k, row in enumerate(rows):
        cells = "".join(
            f'<td class="{of}{" none" * (text == DASH)}" data-label="{escaped(title)}">'
            f"{escaped(text)}</td>"
            for (title, of), text in zip(columns.items(), row, strict=True)
        )
        total = ' class="total"' if k >= len(rows) - totals else ""
        lines.append(f"<tr{total}>{cells}</tr>")
    body = "\n".join(lines)
    return (
        f'<div class="scroll"><table class="stacked"><thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def facts_list(facts: Sequence[tuple[str, str]]) -> str:
    """Names and what they stand for, both plain text."""
    items = [f"<div><dt>{escaped(n)}</dt><dd>{escaped(v)}</dd></div>" for n, v in facts]
    return '<dl class="facts">\n' + "\n".join(items) + "\n</dl>"


def folded(summary: str, inner: str) -> str:
    """HTML that opens with a click on plain text."""
    return f"<details><summary>{escaped(summary)}</summary>{inner}</details>"


def side_by_side(figures: Sequence[str]) -> str:
    """HTML of figures, two in a row where there is room."""
    return f'<div class="pair">{"".join(figures)}</div>' if figures else ""


def render_page(title: str, opening: str, sections: Mapping[str, str] | None = None) -> str:
    """A whole HTML document, with contents, style and script inside.

    Args:
        title: Plain text, for the browser and the heading.
        opening: HTML between the heading and the sections.
        sections: HTML by plain title, in the order of the page; None: there are no contents.
    """
    ids = {heading: "-".join(re.findall("[a-z]+", heading.lower())) for heading in sections or ()}
    links = "".join(f'<li><a href="#{ids[h]}">{escaped(h)}</a></li>' for h in ids)
    contents = (
        '<nav class="contents" aria-label="Contents">\n<strong>Contents</strong>\n'
        f"<ol>{links}</ol>\n</nav>"
    )
    parts = [
        f'<section id="{ids[h]}"><h2>{escaped(h)}</h2>\n{inner}\n</section>'
        for h, inner in (sections or {}).items()
    ]
    body = "\n".join([f"<h1>{escaped(title)}</h1>", opening, *parts])
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; \
style-src 'unsafe-inline'; script-src 'unsafe-inline'">
<link rel="icon" href="data:image/png,">
<title>{escaped(title)}</title>
<style>
{_asset("page.css")}</style>
</head>
<body>
<div class="page">
{contents if ids else ""}
<main>
{body}
</main>
</div>
<script>
{_asset("player.js")}</script>
</body>
</html>
"""


def _asset(name: str) -> str:
    return resources.files("gendom.viz").joinpath(name).read_text(encoding="utf-8")
