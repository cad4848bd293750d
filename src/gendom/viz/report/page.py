"""The page of a report: one HTML file that asks nothing of the network."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources

from gendom.viz.report.markup import escaped


@dataclass(frozen=True, kw_only=True)
class Section:
    """One part of a report, under a heading of its own."""

    title: str
    """Plain text."""
    body: str
    """HTML, made of the pieces in `gendom.viz.report.markup`."""

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
