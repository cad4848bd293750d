"""What a report says, in which order, and the numbers to remember at its top."""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date

from gendom.files import atomic_path
from gendom.installation import version
from gendom.viz.report.action import WITHOUT, ActionSummary, action_section
from gendom.viz.report.estimate import (
    parameters_section,
    refusal_banner,
    verdict_banner,
)
from gendom.viz.report.lift import LiftPictures, lift_section
from gendom.viz.report.markup import Section, escaped, facts_list, render_page, table
from gendom.viz.report.posterior import beliefs_section
from gendom.viz.report.search import search_section
from gendom.viz.report.summary import (
    EstimateSummary,
    interval_text,
    length_text,
    quantity_text,
    title_of,
)

SUMMARY = (
    "GenDOM watched one lift of this object and found the elasticity with which its simulator "
    "repeats that lift. "
    "One policy, trained beforehand in simulation on many objects, takes this elasticity as an "
    "input and so needs no training on this one. "
    "This page shows how well the simulated lift matches the recorded one, how sure the estimate "
    "is, and what the policy's action reached."
)


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """How a result was made, so that it can be made again."""

    commands: Sequence[str] = ()
    date: str = field(default_factory=lambda: date.today().isoformat())
    device: str = ""
    seeds: Mapping[str, int] = field(default_factory=dict)
    stage_seconds: Mapping[str, float] = field(default_factory=dict)
    """Seconds of each stage, in order."""
    warnings: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class ReportContent:
    """What a report says; parts that are None or empty are left out."""

    title: str
    summary: str = SUMMARY
    recording_source: str = ""
    """Where the recording came from, and how far it may be trusted."""
    cameras: bytes | None = None
    """What all cameras saw at one moment, see `gendom.viz.encode_camera_views`."""
    cameras_note: str = ""
    """Which cameras, where, when."""
    lift: LiftPictures | None = None
    estimate: EstimateSummary | None = None
    action: ActionSummary | None = None
    provenance: Provenance = field(default_factory=Provenance)
    refused: Sequence[str] = ()
    """Why nothing could be estimated, where nothing could."""
    next_steps: Sequence[tuple[str, str]] = ()
    """Commands that go on from what was written, as typed into a shell, and what they do."""

    def sections(self) -> list[Section]:
        """The page's sections in order. A new part is a field above and two lines here.

        Raises:
            GendomError: A cloud has no points, or a view is unknown.
        """
        sections: list[Section | None] = []
        if self.cameras is not None:
            sections.append(_cameras_section(self.cameras, self.cameras_note))
        if self.lift is not None:
            sections.append(lift_section(self.lift, self.estimate))
        if self.estimate is not None:
            sections.append(parameters_section(self.estimate))
            sections.append(beliefs_section(self.estimate))
            sections.append(search_section(self.estimate))
        if self.action is not None:
            sections.append(action_section(self.action))
        sections.append(_provenance_section(self.provenance))
        if self.next_steps:
            sections.append(_next_section(self.next_steps))
        return [section for section in sections if section is not None]


def write_report(path: str | os.PathLike, content: ReportContent) -> None:
    """Write one self-contained HTML file, atomically.

    The file makes no request to anywhere. The same content gives the same bytes.

    Raises:
        GendomError: As `gendom.files.atomic_path`; or a cloud has no points, or a view is
            unknown.
    """
    data = render_report(content).encode("utf-8", "backslashreplace")  # names that are no UTF-8
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def render_report(content: ReportContent) -> str:
    """The HTML of `write_report`.

    Raises:
        GendomError: A cloud has no points, or a view is unknown.
    """
    return render_page(content.title, _opening(content), content.sections())


def _opening(content: ReportContent) -> str:
    parts = [refusal_banner(content.refused)] if content.refused else []
    if content.estimate is not None:
        parts.append(verdict_banner(content.estimate))
    parts.append(f'<p class="lead">{escaped(content.summary)}</p>')
    cards = "\n".join(
        f'<li><span class="value">{escaped(value)}</span>'
        f'<span class="name">{escaped(name)}</span></li>'
        for value, name in _cards(content)
    )
    if cards:
        parts.append(f'<ul class="cards">\n{cards}\n</ul>')
    if content.recording_source:
        parts.append(
            '<div class="source"><p><strong>Where the recording comes from.</strong> '
            f"{escaped(content.recording_source)}</p></div>"
        )
    return "\n".join(parts)


def _cards(content: ReportContent) -> list[tuple[str, str]]:
    """The few numbers to remember: value and name."""
    cards, summary, lift = [], content.estimate, content.lift
    if summary is not None:
        cards += _parameter_cards(summary)
    distance = None if summary is None else summary.value("chamfer_mean")
    if distance is None and lift is not None and lift.clouds.chamfer is not None:
        distance = float(lift.clouds.chamfer.mean())
    if distance is not None:
        cards.append((length_text(distance), "Chamfer distance of both lifts, mean of all frames"))
    if content.action is not None:
        ours, *_ = (errors := content.action.mean_errors()).values()
        goals = len(content.action.outcomes)
        name = "distance from the goal" if goals == 1 else f"mean distance from {goals} goals"
        if WITHOUT in errors:
            name += f"; {WITHOUT} {length_text(errors[WITHOUT])}"
        cards.append((length_text(ours), name))
    return cards


def _parameter_cards(summary: EstimateSummary) -> list[tuple[str, str]]:
    if summary.usable is False:
        return []
    cards = []
    for key in ("E", "nu"):
        name, value = title_of(key), quantity_text(key, summary.values[key])
        interval = summary.interval(key)
        if summary.determined(key) is False:
            cards.append(("not determined", f"{name} by this lift; best guess {value}"))
        elif interval is not None:
            ends = interval_text(key, interval)
            cards.append((value, f"{name}; {summary.level_text} interval {ends}"))
        else:
            cards.append((value, name))
    density = summary.value("density")
    if summary.values.get("density_assumed") and density is not None:
        value, name = cards[0]
        cards[0] = (value, f"{name}; density assumed: {quantity_text('density', density)}")
    return cards


def _cameras_section(views: bytes, note: str) -> Section:
    """Colour and depth of each camera."""
    caption = "A row for each camera: colour, and depth (yellow: near, black: none measured)."
    code = base64.b64encode(views).decode("ascii")
    picture = f'<img src="data:image/jpeg;base64,{code}" alt="What both cameras see">'
    body = f"<figure>{picture}<figcaption>{caption}</figcaption></figure>"
    return Section(title="What the cameras saw", body=f"<p>{escaped(note)}</p>{body}")


def _next_section(steps: Sequence[tuple[str, str]]) -> Section:
    """What each command does, and the command."""
    items = "\n".join(
        f"<li><p>{escaped(purpose)}</p><pre>{escaped(command)}</pre></li>"
        for command, purpose in steps
    )
    return Section(title="What to try next", body=f'<ol class="steps">\n{items}\n</ol>')


def _provenance_section(made: Provenance) -> Section:
    """Warnings, commands, versions and seeds, and how long each stage took."""
    parts = [
        f'<p class="warning"><strong>Warning.</strong> {escaped(text)}</p>'
        for text in made.warnings
    ]
    if made.commands:
        parts.append(f"<pre>{escaped(chr(10).join(made.commands))}</pre>")
    seeds = ", ".join(f"{k} {v}" for k, v in made.seeds.items())
    facts = {"GenDOM": version(), "date": made.date, "device": made.device, "seeds": seeds}
    parts.append(facts_list([(name, value) for name, value in facts.items() if value]))
    if made.stage_seconds:
        stages = {**made.stage_seconds, "all": sum(made.stage_seconds.values())}
        rows = [[name, f"{seconds:.1f} s"] for name, seconds in stages.items()]
        parts.append(table({"Stage": "", "Time": "number"}, rows, totals=1, kind="narrow"))
    return Section(title="How this was made", body="\n".join(part for part in parts if part))
