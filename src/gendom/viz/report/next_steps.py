"""The section with commands that go on from the files that were written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gendom.viz.report.markup import escaped
from gendom.viz.report.page import Section


@dataclass(frozen=True, kw_only=True)
class NextStep:
    """A command to try."""

    command: str
    """As typed into a shell where the report was made."""
    purpose: str
    """What it does; plain text."""


def next_section(steps: Sequence[NextStep]) -> Section:
    """What each command does, and the command."""
    items = "\n".join(
        f"<li><p>{escaped(step.purpose)}</p><pre>{escaped(step.command)}</pre></li>"
        for step in steps
    )
    return Section(title="What to try next", body=f'<ol class="steps">\n{items}\n</ol>')
