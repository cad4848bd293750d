"""The section that says how a result was made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from gendom.viz.report.markup import cell, escaped, facts_list, number, table
from gendom.viz.report.page import Section


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """How a result was made, so that it can be made again."""

    commands: Sequence[str] = ()
    version: str = ""
    date: str = ""
    device: str = ""
    seeds: Mapping[str, int] = field(default_factory=dict)
    stage_seconds: Mapping[str, float] = field(default_factory=dict)
    """Seconds of each stage, in order."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """Anything else worth knowing, by name."""
    warnings: Sequence[str] = ()


def provenance_section(made: Provenance) -> Section:
    """Warnings, commands, versions and seeds, and how long each stage took."""
    parts = [
        f'<p class="warning"><strong>Warning.</strong> {escaped(text)}</p>'
        for text in made.warnings
    ]
    if made.commands:
        parts.append(f"<pre>{escaped(chr(10).join(made.commands))}</pre>")
    facts = [("GenDOM", made.version), ("date", made.date), ("device", made.device)]
    if made.seeds:
        facts.append(("seeds", ", ".join(f"{k} {v}" for k, v in made.seeds.items())))
    facts += list(made.facts.items())
    parts.append(facts_list([(name, value) for name, value in facts if value]))
    if made.stage_seconds:
        stages = [(name, f"{s:.1f} s") for name, s in made.stage_seconds.items()]
        rows = [f"<tr>{cell(escaped(name))}{number(value)}</tr>" for name, value in stages]
        total = sum(made.stage_seconds.values())
        rows.append(f'<tr class="total">{cell("all")}{number(f"{total:.1f} s")}</tr>')
        parts.append(table(["<th>Stage</th>", '<th class="number">Time</th>'], rows, "narrow"))
    return Section(title="How this was made", body="\n".join(part for part in parts if part))
