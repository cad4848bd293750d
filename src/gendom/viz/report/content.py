"""What a report says, in which order, and the numbers to remember at its top."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field

from gendom.files import atomic_path
from gendom.viz.report.action import ActionSummary, action_section
from gendom.viz.report.beliefs import beliefs_section
from gendom.viz.report.cameras import CameraViews, cameras_section
from gendom.viz.report.lift import LiftPictures, lift_section
from gendom.viz.report.markup import escaped
from gendom.viz.report.next_steps import NextStep, next_section
from gendom.viz.report.page import Section, render_page
from gendom.viz.report.parameters import parameters_section
from gendom.viz.report.provenance import Provenance, provenance_section
from gendom.viz.report.quantities import interval_text, length_text, quantity_text
from gendom.viz.report.search import search_section
from gendom.viz.report.summary import EstimateSummary
from gendom.viz.report.verdict import refusal_banner, verdict_banner

SUMMARY = (
    "GenDOM watched one lift of this object and found the elasticity with which its simulator "
    "repeats that lift. "
    "One policy, trained beforehand in simulation on many objects, takes this elasticity as an "
    "input and so needs no training on this one. "
    "This page shows how well the simulated lift matches the recorded one, how sure the estimate "
    "is, and what the policy's action reached."
)


@dataclass(frozen=True, kw_only=True)
class ReportContent:
    """What a report says; parts that are None or empty are left out."""

    title: str
    summary: str = SUMMARY
    recording_source: str = ""
    """Where the recording came from, and how far it may be trusted."""
    cameras: CameraViews | None = None
    lift: LiftPictures | None = None
    estimate: EstimateSummary | None = None
    action: ActionSummary | None = None
    provenance: Provenance = field(default_factory=Provenance)
    refused: Sequence[str] = ()
    """Why nothing could be estimated, where nothing could."""
    next_steps: Sequence[NextStep] = ()
    """Commands that go on from what was written."""

    def sections(self) -> list[Section]:
        """The page's sections in order. A new part is a field above and two lines here.

        Raises:
            GendomError: A cloud has no points, or a view is unknown.
        """
        sections: list[Section | None] = []
        if self.cameras is not None:
            sections.append(cameras_section(self.cameras))
        if self.lift is not None:
            sections.append(lift_section(self.lift, self.estimate))
        if self.estimate is not None:
            sections.append(parameters_section(self.estimate))
            sections.append(beliefs_section(self.estimate))
            sections.append(search_section(self.estimate))
        if self.action is not None:
            sections.append(action_section(self.action))
        sections.append(provenance_section(self.provenance))
        if self.next_steps:
            sections.append(next_section(self.next_steps))
        return [section for section in sections if section is not None]


def write_report(path: str | os.PathLike, content: ReportContent) -> None:
    """Write one self-contained HTML file, atomically.

    The file makes no request to anywhere. The same content gives the same bytes.

    Raises:
        GendomError: As `gendom.files.atomic_path`; or a cloud has no points, or a view is
            unknown.
    """
    data = render_report(content).encode("utf-8")
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
    cards = _cards(content)
    if cards:
        items = "\n".join(
            f'<li><span class="value">{escaped(value)}</span>'
            f'<span class="name">{escaped(name)}</span></li>'
            for value, name in cards
        )
        parts.append(f'<ul class="cards">\n{items}\n</ul>')
    if content.recording_source:
        parts.append(
            '<div class="source"><p><strong>Where the recording comes from.</strong> '
            f"{escaped(content.recording_source)}</p></div>"
        )
    return "\n".join(parts)


def _cards(content: ReportContent) -> list[tuple[str, str]]:
    """The few numbers to remember: value and name."""
    cards = []
    if content.estimate is not None:
        cards += _parameter_cards(content.estimate)
    distance = _mean_chamfer(content)
    if distance is not None:
        cards.append((length_text(distance), "Chamfer distance of both lifts, mean of all frames"))
    if content.action is not None:
        ours, without = content.action.mean_errors()
        goals = len(content.action.outcomes)
        name = "distance from the goal" if goals == 1 else f"mean distance from {goals} goals"
        if without is not None:
            name += f"; without parameters {length_text(without)}"
        cards.append((length_text(ours), name))
    return cards


def _parameter_cards(summary: EstimateSummary) -> list[tuple[str, str]]:
    if summary.usable is False:
        return []
    cards = []
    for key, name in (("E", "Young's modulus"), ("nu", "Poisson's ratio")):
        value = quantity_text(key, summary.values[key])
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


def _mean_chamfer(content: ReportContent) -> float | None:
    if content.estimate is not None:
        value = content.estimate.value("chamfer_mean")
        if value is not None:
            return value
    if content.lift is not None and content.lift.clouds.chamfer is not None:
        return float(content.lift.clouds.chamfer.mean())
    return None
