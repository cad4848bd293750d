"""Pieces of HTML: escaped text, tables, lists of facts, figures."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence

DASH = "–"
"""Stands where a table has no value."""


def escaped(value: str) -> str:
    """Plain text as HTML, also inside an attribute."""
    return html.escape(value, quote=True)


def table(head: Iterable[str], rows: Iterable[str], kind: str = "") -> str:
    """A table of HTML cells: those of the head, and rows; `kind` is a class of `report.css`."""
    attribute = f' class="{kind}"' if kind else ""
    return (
        f'<div class="scroll"><table{attribute}><thead><tr>{"".join(head)}</tr></thead>\n'
        "<tbody>\n" + "\n".join(rows) + "\n</tbody></table></div>"
    )


def facts_list(facts: Sequence[tuple[str, str]]) -> str:
    """Names and what they stand for, both plain text."""
    if not facts:
        return ""
    items = [f"<div><dt>{escaped(n)}</dt><dd>{escaped(v)}</dd></div>" for n, v in facts]
    return '<dl class="facts">\n' + "\n".join(items) + "\n</dl>"


def figure(data: bytes, description: str, caption: str = "", *, kind: str = "svg+xml") -> str:
    """A picture with plain text below it; arguments as `image`."""
    below = f"<figcaption>{escaped(caption)}</figcaption>" if caption else ""
    return f"<figure>{image(data, kind, description)}{below}</figure>"


def image(data: bytes, kind: str, description: str) -> str:
    """A picture inside the page.

    Args:
        data: The file.
        kind: "png", "jpeg", "gif" or "svg+xml".
        description: For those who do not see it; plain text.
    """
    code = base64.b64encode(data).decode("ascii")
    return f'<img src="data:image/{kind};base64,{code}" alt="{escaped(description)}">'
