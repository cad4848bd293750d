"""What a report says, in which order, and the numbers to remember at its top."""

import base64
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date

from gendom.files import atomic_path
from gendom.installation import version
from gendom.materials.estimate import Estimate
from gendom.viz.animation import Animation
from gendom.viz.markup import escaped, facts_list, render_page
from gendom.viz.player import player
from gendom.viz.quantities import interval_text, length_text, quantity_text, title_of
from gendom.viz.report import estimate as estimated
from gendom.viz.report import motion


@dataclass(frozen=True, kw_only=True)
class ReportContent:
    """What a report says; parts that are None or empty are left out."""

    title: str
    summary: str
    """What the page shows, in some sentences."""
    command: str
    """Makes the report again."""
    recording_source: str = ""
    """Where the recording came from, and how far it may be trusted."""
    cameras: bytes | None = None
    """What all cameras saw at one moment."""
    cameras_note: str = ""
    """Which cameras, where, when."""
    lift: Animation | None = None
    lift_note: str = ""
    estimate: Estimate | None = None
    truth: Mapping[str, float] = field(default_factory=dict)
    """True values by the names of the estimate's record, as far as known."""
    action: motion.ActionSummary | None = None
    refused: Sequence[str] = ()
    """Why nothing could be estimated, where nothing could."""
    next_steps: Sequence[tuple[str, str]] = ()
    """Commands that go on from what was written, as typed into a shell, and what they do."""

    def html(self) -> str:
        """The whole page; errors as of `sections`."""
        return render_page(self.title, self.opening(), self.sections())

    def sections(self) -> dict[str, str]:
        """HTML of the page's sections by title, in order.

        Raises:
            GendomError: A cloud has no points.
        """
        made, found = {}, self.estimate
        if self.cameras is not None:
            made["What the cameras saw"] = _cameras(self.cameras, self.cameras_note)
        if self.lift is not None:
            note = f"<p>{escaped(self.lift_note)}</p>" if self.lift_note else ""
            shown = player(self.lift, name="lift", subject="Recorded and simulated lift")
            parts = [note, shown, motion.residuals(self.lift)]
            made["The lift, recorded and simulated"] = "\n".join(parts)
        if found is not None:
            made["The estimate"] = estimated.parameters(found, self.truth)
            if found.usable:
                made["Prior and posterior"] = estimated.beliefs(found, self.truth)
            made["The fit"] = estimated.search(found)
        if self.action is not None:
            made["The action"] = motion.action(self.action)
        made["How this was made"] = self._provenance()
        if self.next_steps:
            made["What to try next"] = _steps(self.next_steps)
        return made

    def _provenance(self) -> str:
        """Warnings, command, version and date."""
        notes = () if self.estimate is None else self.estimate.record["notes"]
        parts = [
            f'<p class="warning"><strong>Warning.</strong> {escaped(note)}</p>' for note in notes
        ]
        parts.append(f"<pre>{escaped(self.command)}</pre>")
        parts.append(facts_list([("GenDOM", version()), ("date", date.today().isoformat())]))
        return "\n".join(parts)

    def opening(self) -> str:
        """HTML between the heading and the sections."""
        parts = [estimated.refusal_banner(self.refused)] if self.refused else []
        if self.estimate is not None:
            parts.append(estimated.verdict_banner(self.estimate))
        parts.append(f'<p class="lead">{escaped(self.summary)}</p>')
        cards = "\n".join(
            f'<li><span class="value">{escaped(value)}</span>'
            f'<span class="name">{escaped(name)}</span></li>'
            for value, name in self._cards()
        )
        if cards:
            parts.append(f'<ul class="cards">\n{cards}\n</ul>')
        if self.recording_source:
            said = (
                f"<strong>Where the recording comes from.</strong> {escaped(self.recording_source)}"
            )
            parts.append(f'<div class="source"><p>{said}</p></div>')
        return "\n".join(parts)

    def _cards(self) -> list[tuple[str, str]]:
        """The few numbers to remember: value and name."""
        cards, found = [], self.estimate
        if found is not None:
            cards += _parameter_cards(found) if found.usable else []
            distance = length_text(found.record["rms"])
            cards.append((distance, "distance of the clouds from the best fit, root mean square"))
        if self.action is not None:
            errors = self.action.mean_errors()
            without = length_text(errors[motion.WITHOUT])
            name = f"mean distance from {self.action.goals_text}; {motion.WITHOUT} {without}"
            cards.append((length_text(errors[motion.WITH]), name))
        return cards


def write_report(path: str | os.PathLike, content: ReportContent) -> None:
    """Write one self-contained HTML file, atomically.

    The file makes no request to anywhere. The same content gives the same bytes.

    Raises:
        GendomError: As `gendom.files.atomic_path`; or a cloud has no points.
    """
    data = content.html().encode("utf-8", "backslashreplace")  # names that are no UTF-8
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def _parameter_cards(found: Estimate) -> list[tuple[str, str]]:
    cards, record = [], found.record
    for key in ("E", "nu"):
        name, value, ends = title_of(key), quantity_text(key, record[key]), found.interval(key)
        if record["identifiable"].get(key) is False:
            cards.append(("not determined", f"{name} by this lift; best guess {value}"))
        elif ends is None:
            cards.append((value, name))
        else:
            said = f"{estimated.level_text(found)} interval {interval_text(key, ends, record[key])}"
            cards.append((value, f"{name}; {said}"))
    if record["density_assumed"]:
        value, name = cards[0]
        density = quantity_text("density", record["density"])
        cards[0] = (value, f"{name}; density assumed: {density}")
    return cards


def _cameras(views: bytes, note: str) -> str:
    """HTML: colour and depth of each camera."""
    caption = "A row for each camera: colour, and depth (yellow: near, black: none measured)."
    code = base64.b64encode(views).decode("ascii")
    picture = f'<img src="data:image/jpeg;base64,{code}" alt="What both cameras see">'
    return f"<p>{escaped(note)}</p><figure>{picture}<figcaption>{caption}</figcaption></figure>"


def _steps(steps: Sequence[tuple[str, str]]) -> str:
    """HTML: what each command does, and the command."""
    items = "\n".join(
        f"<li><p>{escaped(purpose)}</p><pre>{escaped(command)}</pre></li>"
        for command, purpose in steps
    )
    return f'<ol class="steps">\n{items}\n</ol>'
