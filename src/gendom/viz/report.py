"""One HTML file that tells a recording's story: the lift, the estimate, the action.

Everything is inside the file: it opens without a network, prints, and can be sent by mail.
"""

from __future__ import annotations

import base64
import html
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

import numpy as np

from gendom.errors import GendomError
from gendom.files import atomic_path
from gendom.viz.animation import animate
from gendom.viz.charts import (
    OURS_COLOR,
    WITHOUT_COLOR,
    Swing,
    chamfer_chart,
    goal_chart,
    loss_chart,
    parameter_chart,
    swing_chart,
)
from gendom.viz.clouds import CloudSequence, film
from gendom.viz.turnable import encode_scene

ESTIMATE_FORMAT = "gendom-estimate/1"

SUMMARY = (
    "GenDOM watched one lift of this object and found the elasticity with which its simulator "
    "repeats that lift. "
    "One policy, trained beforehand in simulation on many objects, takes this elasticity as an "
    "input and so needs no training on this one. "
    "This page shows how well the simulated lift matches the recorded one, how sure the estimate "
    "is, and what the policy's action reached."
)

# Bytes of the animation before base64; with more, fewer frames are shown.
_MAX_GIF = 1_200_000
_DASH = "–"


@dataclass(frozen=True, kw_only=True)
class LiftPictures:
    """The recorded and the simulated lift."""

    clouds: CloudSequence
    view: str = "auto"
    """One of `gendom.viz.clouds.VIEWS`; "oblique" suits cloths."""
    fps: float = 12.0
    """Frames of the animation shown in a second."""
    note: str = ""
    """Text below the heading."""


@dataclass(frozen=True, kw_only=True)
class EstimateSummary:
    """What was estimated, and what is known besides.

    Raises:
        GendomError: `values` has another format, or no Young's modulus or Poisson's ratio; or
            an interval is not a pair of numbers.
    """

    values: Mapping[str, Any]
    """The estimate's JSON object (gendom-estimate/1), SI units; other keys may be missing."""
    truth: Mapping[str, float] | None = None
    """True values under the keys of `values`, as far as known."""
    bounds: Mapping[str, tuple[float, float]] | None = None
    """Range searched, by key of `values`; the intervals are drawn inside it."""

    def __post_init__(self):
        found = self.values.get("format", ESTIMATE_FORMAT)
        if found != ESTIMATE_FORMAT:
            raise GendomError(
                f"is {found!r}", where="estimate.format", fix=f"give {ESTIMATE_FORMAT!r}"
            )
        for key in ("youngs_modulus", "poissons_ratio"):
            if _number(self.values.get(key)) is None:
                raise GendomError("is no number", where=f"estimate.{key}", fix="estimate again")
        for key, ends in (self.values.get("intervals") or {}).items():
            if key != "level" and ends is not None and len(np.atleast_1d(ends)) != 2:
                raise GendomError(
                    f"is {ends!r}", where=f"estimate.intervals.{key}", fix="give [low, high]"
                )


@dataclass(frozen=True, kw_only=True)
class PolicyRun:
    """One action, and what became of it. Arrays are converted to float64.

    Raises:
        GendomError: An array has another shape, or a number is not finite.
    """

    action: np.ndarray
    """[A]."""
    reached: np.ndarray
    """[D], or one number, in the goal's coordinates [m]."""
    tip_path: np.ndarray | None = None
    """[T, 3] of the rope's tip from the release on [m]."""
    shape_at_release: np.ndarray | None = None
    """[n, 3] points along the rope [m]."""
    shape_at_farthest: np.ndarray | None = None
    """[n, 3] points along the rope when its tip is farthest [m]."""

    def __post_init__(self):
        for name in ("action", "reached"):
            _convert(self, name, 1, np.atleast_1d(np.asarray(getattr(self, name), dtype=float)))
        for name in ("tip_path", "shape_at_release", "shape_at_farthest"):
            value = getattr(self, name)
            if value is not None:
                _convert(self, name, 2, np.asarray(value, dtype=float))
                if getattr(self, name).shape[1] != 3:
                    raise GendomError("is no [n, 3]", where=name, fix="give points in metres")


@dataclass(frozen=True, kw_only=True)
class ReachOutcome:
    """One goal, and what both policies reached.

    Raises:
        GendomError: Goal and place reached differ in shape, or the goal is not 1-D or 2-D.
    """

    goal: np.ndarray
    """[1] or one number: distance; [2]: distance and height [m]."""
    ours: PolicyRun
    """The policy that knows the estimate."""
    without: PolicyRun | None = None
    """The same network without parameters."""

    def __post_init__(self):
        _convert(self, "goal", 1, np.atleast_1d(np.asarray(self.goal, dtype=float)))
        if self.goal.shape not in ((1,), (2,)):
            raise GendomError(
                f"has shape {list(self.goal.shape)}", where="goal", fix="give [1] or [2]"
            )
        for name, run in (("ours", self.ours), ("without", self.without)):
            if run is not None and run.reached.shape != self.goal.shape:
                raise GendomError(
                    f"has shape {list(run.reached.shape)}, the goal {list(self.goal.shape)}",
                    where=f"{name}.reached",
                    fix="give both in the same coordinates",
                )

    def error(self, run: PolicyRun) -> float:
        """Distance between the place reached and the goal [m]."""
        return float(np.linalg.norm(run.reached - self.goal))


@dataclass(frozen=True, kw_only=True)
class ActionSummary:
    """The task carried out for one or several goals.

    Raises:
        GendomError: There is no outcome, or goals or actions differ in shape.
    """

    outcomes: Sequence[ReachOutcome]
    goal_name: str = "farthest distance of the tip"
    action_names: Sequence[str] = ()
    """One for each number of an action, with its unit: "release x [m]"."""
    note: str = ""
    """Text below the heading: what was done, and where."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where a goal's distance is measured from [m]."""
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0)
    """Horizontal unit vector along which a goal's distance is measured."""
    table_height: float | None = None
    """z of the table [m], or None."""
    shown: int | None = None
    """The outcome whose swing is drawn; None: the first that has a path."""

    def __post_init__(self):
        if not self.outcomes:
            raise GendomError("is empty", where="outcomes", fix="give one goal or leave it out")
        sizes = {
            (len(o.goal), len(run.action))
            for o in self.outcomes
            for run in (o.ours, o.without)
            if run is not None
        }
        if len(sizes) > 1:
            raise GendomError("differ in shape", where="goals and actions", fix="give one task's")
        actions = next(iter(sizes))[1]
        if self.action_names and len(self.action_names) != actions:
            raise GendomError(
                f"has {len(self.action_names)} names for {actions} numbers",
                where="action_names",
                fix="give one each",
            )
        if self.shown is not None and not 0 <= self.shown < len(self.outcomes):
            raise GendomError(f"is {self.shown}", where="shown", fix="give an outcome's index")


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


@dataclass(frozen=True, kw_only=True)
class ReportContent:
    """What a report tells; parts that are None are left out."""

    title: str
    summary: str = SUMMARY
    recording_source: str = ""
    """Where the recording came from, and how far it may be trusted."""
    lift: LiftPictures | None = None
    estimate: EstimateSummary | None = None
    action: ActionSummary | None = None
    provenance: Provenance = field(default_factory=Provenance)


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
    parts = [_opening(content)]
    if content.lift is not None:
        parts.append(_lift_section(content.lift))
    if content.estimate is not None:
        parts.append(_estimate_section(content.estimate, content.lift))
    if content.action is not None:
        parts.append(_action_section(content.action))
    parts.append(_provenance_section(content.provenance))
    body = "\n".join(parts)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; \
style-src 'unsafe-inline'; script-src 'unsafe-inline'">
<title>{_text(content.title)}</title>
<style>
{_asset("report.css")}</style>
</head>
<body>
<main>
{body}
</main>
<script>
{_asset("report.js")}</script>
</body>
</html>
"""


def _opening(content: ReportContent) -> str:
    parts = [f"<h1>{_text(content.title)}</h1>", f'<p class="lead">{_text(content.summary)}</p>']
    if content.recording_source:
        parts.append(
            '<div class="source"><p><strong>Where the recording comes from.</strong> '
            f"{_text(content.recording_source)}</p></div>"
        )
    cards = _cards(content)
    if cards:
        items = "\n".join(
            f'<li><span class="value">{_text(value)}</span>'
            f'<span class="name">{_text(name)}</span></li>'
            for value, name in cards
        )
        parts.append(f'<ul class="cards">\n{items}\n</ul>')
    return "\n".join(parts)


def _cards(content: ReportContent) -> list[tuple[str, str]]:
    """The few numbers to remember: value and name."""
    cards = []
    if content.estimate is not None:
        values = content.estimate.values
        for key, name in (
            ("youngs_modulus", "Young's modulus"),
            ("poissons_ratio", "Poisson's ratio"),
        ):
            value = _quantity(key, values[key])
            interval = _interval(values, key)
            if _identifiable(values, key) is False:
                cards.append(("not determined", f"{name} by this lift; best guess {value}"))
            elif interval is not None:
                cards.append((value, f"{name}; {_level(values)} interval {_span(key, interval)}"))
            else:
                cards.append((value, name))
        density = _number(values.get("density"))
        if values.get("density_assumed") and density is not None:
            value, name = cards[0]
            cards[0] = (value, f"{name}; density assumed: {_quantity('density', density)}")
    distance = _mean_chamfer(content)
    if distance is not None:
        cards.append((_length(distance), "Chamfer distance of both lifts, mean of all frames"))
    if content.action is not None:
        ours, without = _mean_errors(content.action)
        goals = len(content.action.outcomes)
        name = "distance from the goal" if goals == 1 else f"mean distance from {goals} goals"
        if without is not None:
            name += f"; without parameters {_length(without)}"
        cards.append((_length(ours), name))
    return cards


def _mean_chamfer(content: ReportContent) -> float | None:
    if content.estimate is not None:
        value = _number(content.estimate.values.get("chamfer_mean"))
        if value is not None:
            return value
    if content.lift is not None and content.lift.clouds.chamfer is not None:
        return float(content.lift.clouds.chamfer.mean())
    return None


def _lift_section(lift: LiftPictures) -> str:
    clouds = lift.clouds
    both = clouds.simulated is not None
    gif, max_frames = b"", 60
    for max_frames in (60, 40, 25, 12):
        gif = animate(clouds, fps=lift.fps, max_frames=max_frames, view=lift.view, width=640)
        if len(gif) <= _MAX_GIF:
            break
    strip = film(clouds, frames=6, columns=3, view=lift.view, width=1600)
    subject = "Recorded and simulated lift" if both else "Recorded lift"
    scene = encode_scene(clouds, fps=lift.fps)
    parts = [f"<h2>{'The lift, recorded and simulated' if both else 'The recorded lift'}</h2>"]
    if lift.note:
        parts.append(f"<p>{_text(lift.note)}</p>")
    duration = float(clouds.times[-1] - clouds.times[0])
    shown = len(clouds.spread(max_frames))
    caption = f"{clouds.num_frames} frames, {duration:.3g} s of recording"
    caption += f", shown in {shown / lift.fps:.2g} s." if shown > 1 else "."
    parts.append(
        '<div class="pair">'
        f'<figure class="moving">{_image(gif, "gif", f"{subject}, animated")}'
        f"<figcaption>{caption}</figcaption>"
        "</figure>"
        '<figure class="viewer" id="viewer" hidden>'
        '<canvas role="img" aria-label="The clouds of one frame; drag to turn them"></canvas>'
        '<div class="controls"><button type="button">Play</button>'
        '<input type="range" min="0" value="0" aria-label="Frame"><output></output></div>'
        "<figcaption>The same, thinned out: drag to turn it, move the slider through the "
        "frames.</figcaption></figure></div>"
        f'<script type="application/json" id="scene">{scene}</script>'
    )
    parts.append(
        f"<figure>{_image(strip, 'png', f'{subject}, six frames')}"
        "<figcaption>Evenly spaced frames, first to last. "
        + ("Blue: recorded. Orange: simulated. " if both else "")
        + ("Cross: gripper." if clouds.gripper is not None else "")
        + "</figcaption></figure>"
    )
    return "\n".join(parts)


# Key of an estimate, its name, and what to say about it.
_ROWS = (
    ("youngs_modulus", "Young's modulus <i>E</i>"),
    ("poissons_ratio", "Poisson's ratio <i>ν</i>"),
    ("density", "Density <i>ρ</i>"),
    ("specific_modulus", "Specific modulus <i>E</i> / <i>ρ</i>"),
    ("bending_length", "Bending length"),
)


def _estimate_section(summary: EstimateSummary, lift: LiftPictures | None) -> str:
    values, truth, bounds = summary.values, summary.truth or {}, summary.bounds or {}
    rows = []
    knows_truth = any(_number(truth.get(key)) is not None for key, _ in _ROWS)
    has_interval = any(_interval(values, key) is not None for key, _ in _ROWS)
    for key, name in _ROWS:
        value = _number(values.get(key))
        if value is None:
            continue
        interval, true = _interval(values, key), _number(truth.get(key))
        cells = [f"<td>{name}</td>", f'<td class="number">{_text(_quantity(key, value))}</td>']
        if has_interval:
            shown = _text(_span(key, interval)) if interval else _DASH
            cells.append(f"<td>{shown}{_bar(value, interval, true, bounds.get(key))}</td>")
        if knows_truth:
            shown = _DASH if true is None else _text(_quantity(key, true))
            cells.append(f'<td class="number">{shown}</td>')
            shown = _DASH if true is None else _text(_difference(key, value, true))
            cells.append(f'<td class="number">{shown}</td>')
        cells.append(f'<td class="remark">{_text(_remark(key, values, interval, true))}</td>')
        rows.append(f"<tr>{''.join(cells)}</tr>")
    head = ["<th>Quantity</th>", '<th class="number">Estimate</th>']
    if has_interval:
        head.append(f"<th>{_text(_level(values))} interval</th>")
    if knows_truth:
        head += ['<th class="number">True value</th>', '<th class="number">Off by</th>']
    head.append("<th>What the lift says</th>")
    parts = ["<h2>The estimate</h2>", _table(head, rows)]
    if has_interval and bounds:
        parts.append(
            '<p class="soft">Bars: the grey range was searched, the light part is the interval, '
            "the blue mark the estimate"
            + (", the black mark the true value" if knows_truth else "")
            + ".</p>"
        )
    charts = _estimate_charts(summary)
    clouds = None if lift is None else lift.clouds
    if clouds is not None and clouds.chamfer is not None:
        chart = chamfer_chart(clouds.times, clouds.chamfer)
        charts.append(
            _figure(
                chart,
                "Chamfer distance in each frame",
                "Mean distance from each recorded point to the nearest simulated one, plus the "
                "same the other way round.",
            )
        )
    if charts:
        parts.append(f'<div class="pair">{"".join(charts)}</div>')
    parts.append(_fit_facts(values))
    parts.append(_starts_table(values))
    return "\n".join(part for part in parts if part)


def _estimate_charts(summary: EstimateSummary) -> list[str]:
    """Loss and both parameters against iteration, for every start."""
    values, truth = summary.values, summary.truth or {}
    entries = values.get("history") or []
    losses = [_number(start.get("loss")) for start in values.get("starts") or []]
    finite = [(loss, i) for i, loss in enumerate(losses) if loss is not None]
    best = min(finite)[1] if finite else None
    figures = []
    for key, name, factor in (
        ("loss", "Loss", 1.0),
        ("youngs_modulus", "Young's modulus [kPa]", 1e-3),
        ("poissons_ratio", "Poisson's ratio", 1.0),
    ):
        lines: dict[int, list[tuple[float, float]]] = {}
        for entry in entries:
            iteration, value = _number(entry.get("iteration")), _number(entry.get(key))
            if iteration is not None and value is not None:
                line = lines.setdefault(int(entry.get("start", 0)), [])
                line.append((iteration, factor * value))
        if not lines:
            continue
        order = sorted(lines)
        history = [tuple(np.array(sorted(lines[start])).T) for start in order]
        chosen = order.index(best) if best in order else None
        if key == "loss":
            chart = loss_chart(history, chosen)
            said = "Logarithmic scale."
            if len({entry.get("stage") for entry in entries}) > 1:
                said += " It jumps where the search passes from the coarse grid to the fine one."
            figures.append(_figure(chart, "Loss in each iteration", said))
        else:
            true = _number(truth.get(key))
            true = None if true is None else factor * true
            chart = parameter_chart(history, chosen, name=name, truth=true)
            figures.append(_figure(chart, f"{name} in each iteration", ""))
    return figures


def _fit_facts(values: Mapping[str, Any]) -> str:
    facts = []
    for key, name in (
        ("chamfer_mean", "Chamfer distance, all frames"),
        ("chamfer_last", "Chamfer distance, last frame"),
        ("chamfer_mean_surface", "to the simulated surface, all frames"),
        ("chamfer_last_surface", "to the simulated surface, last frame"),
    ):
        value = _number(values.get(key))
        if value is not None:
            facts.append((name, _length(value)))
    for key, name in (("method", "method"), ("device", "device"), ("seed", "seed")):
        if values.get(key) is not None:
            facts.append((name, str(values[key])))
    for key, name, unit in (
        ("loss", "final loss", ""),
        ("iterations", "iterations", ""),
        ("seconds", "time", " s"),
    ):
        value = _number(values.get(key))
        if value is not None:
            facts.append((name, f"{value:.4g}{unit}"))
    described = values.get("object")
    if isinstance(described, Mapping):
        known = [f"{k} {v}" for k, v in described.items() if isinstance(v, (str, int, float))]
        facts.append(("object", ", ".join(known)))
    return _facts_list(facts)


def _starts_table(values: Mapping[str, Any]) -> str:
    starts = values.get("starts") or []
    if len(starts) < 2:
        return ""
    keys = ("youngs_modulus", "poissons_ratio")
    rows = []
    for start in starts:
        cells = []
        for stage in ("initial", "final"):
            for key in keys:
                value = _number((start.get(stage) or {}).get(key))
                shown = _DASH if value is None else _text(_quantity(key, value))
                cells.append(f'<td class="number">{shown}</td>')
        loss = _number(start.get("loss"))
        cells.append(f'<td class="number">{_DASH if loss is None else f"{loss:.4g}"}</td>')
        rows.append(f"<tr>{''.join(cells)}</tr>")
    titles = ("E at the start", "ν at the start", "E found", "ν found", "Loss")
    head = [f'<th class="number">{title}</th>' for title in titles]
    return f"<details><summary>All {len(starts)} starts</summary>{_table(head, rows)}</details>"


def _action_section(action: ActionSummary) -> str:
    outcomes = action.outcomes
    compared = any(o.without is not None for o in outcomes)
    parts = ["<h2>The action</h2>"]
    if action.note:
        parts.append(f"<p>{_text(action.note)}</p>")
    ours, without = _mean_errors(action)
    if without is not None:
        parts.append(f"<p>{_verdict(ours, without, len(outcomes))}</p>")
    groups = ["With the estimate", "Without parameters"] if compared else []
    columns = ["Action", "Reached", "Error"] * max(1, len(groups))
    titles = "".join(f'<th class="number">{column}</th>' for column in columns)
    span = ' rowspan="2"' if groups else ""
    head = f'<th{span} class="number">Goal</th>'
    if groups:
        head += "".join(f'<th colspan="3" class="group">{group}</th>' for group in groups)
        head += f"</tr><tr>{titles}"
    else:
        head += titles
    rows = []
    for outcome in outcomes:
        cells = [f'<td class="number">{_text(_place(outcome.goal))}</td>']
        for run in (outcome.ours, outcome.without) if compared else (outcome.ours,):
            if run is None:
                cells += [f'<td class="number">{_DASH}</td>'] * 3
                continue
            numbers = ", ".join(f"{a:.3f}" for a in run.action)
            cells.append(f'<td class="number">{_text(_minus(numbers))}</td>')
            cells.append(f'<td class="number">{_text(_place(run.reached))}</td>')
            cells.append(f'<td class="number">{_text(_length(outcome.error(run)))}</td>')
        rows.append(f"<tr>{''.join(cells)}</tr>")
    if len(outcomes) > 1:
        cells = [
            '<td class="number">mean</td>',
            "<td></td><td></td>",
            f'<td class="number">{_length(ours)}</td>',
        ]
        if compared:
            shown = _DASH if without is None else _length(without)
            cells += ["<td></td><td></td>", f'<td class="number">{shown}</td>']
        rows.append(f'<tr class="total">{"".join(cells)}</tr>')
    parts.append(_table([head], rows))
    names = f"Goal: {action.goal_name}."
    if action.action_names:
        names += f" Action: {', '.join(action.action_names)}."
    parts.append(f'<p class="soft">{_text(names)}</p>')
    figures = []
    if len(outcomes) > 1:
        goals = np.array([o.goal for o in outcomes])
        reached = np.array([o.ours.reached for o in outcomes])
        missing = np.full_like(goals[0], np.nan)
        others = [missing if o.without is None else o.without.reached for o in outcomes]
        chart = goal_chart(goals, reached, np.array(others) if compared else None)
        figures.append(_figure(chart, "Goals and places reached", ""))
    shown = _shown(action)
    if shown is not None:
        figures.append(_swing_figure(action, shown))
    if figures:
        parts.append(f'<div class="pair">{"".join(figures)}</div>')
    return "\n".join(parts)


def _verdict(ours: float, without: float, goals: int) -> str:
    """One sentence that compares both policies, whichever was better."""
    what = "the goal is missed" if goals == 1 else f"the {goals} goals are missed on average"
    text = (
        f"With the estimate {what} by <strong>{_length(ours)}</strong>; the same network without "
        f"parameters misses by <strong>{_length(without)}</strong>"
    )
    if ours < without:
        return (
            f"{text}: the estimate takes away {100.0 * (1.0 - ours / without):.0f} % of the error."
        )
    return f"{text}: here the estimate did not help."


def _shown(action: ActionSummary) -> ReachOutcome | None:
    """The outcome whose swing is drawn."""
    chosen = action.outcomes if action.shown is None else [action.outcomes[action.shown]]
    return next((o for o in chosen if o.ours.tip_path is not None), None)


def _swing_figure(action: ActionSummary, outcome: ReachOutcome) -> str:
    direction = np.array(action.direction) / np.linalg.norm(action.direction)

    def flat(points: np.ndarray) -> np.ndarray:
        return np.stack([(points - np.array(action.origin)) @ direction, points[:, 2]], axis=1)

    swings = []
    for run, label, color in (
        (outcome.without, "without parameters", WITHOUT_COLOR),
        (outcome.ours, "with the estimate", OURS_COLOR),
    ):
        if run is None or run.tip_path is None:
            continue
        shapes = []
        for shape in (run.shape_at_release, run.shape_at_farthest):
            if shape is not None and len(shape):
                # A few hundred dots show the rope as well as thousands, in a smaller file.
                shapes.append(flat(shape[:: max(1, len(shape) // 250)]))
        dashed = run is outcome.without
        path = flat(run.tip_path)
        swings.append(Swing(label=label, color=color, dashed=dashed, tip_path=path, shapes=shapes))
    chart = swing_chart(swings, outcome.goal, table_height=action.table_height)
    return _figure(
        chart,
        "Paths of the rope's tip after the release",
        f"Goal {_place(outcome.goal)}. Circles: the tip at release; diamonds: at its farthest. "
        "Dots: the rope at these two moments, the earlier one pale.",
    )


def _provenance_section(made: Provenance) -> str:
    parts = ["<h2>How this was made</h2>"]
    parts += [
        f'<p class="warning"><strong>Warning.</strong> {_text(text)}</p>' for text in made.warnings
    ]
    if made.commands:
        parts.append(f"<pre>{_text(chr(10).join(made.commands))}</pre>")
    facts = [("GenDOM", made.version), ("date", made.date), ("device", made.device)]
    if made.seeds:
        facts.append(("seeds", ", ".join(f"{k} {v}" for k, v in made.seeds.items())))
    facts += list(made.facts.items())
    parts.append(_facts_list([(name, value) for name, value in facts if value]))
    if made.stage_seconds:
        stages = [(name, f"{s:.1f} s") for name, s in made.stage_seconds.items()]
        rows = [
            f'<tr><td>{_text(name)}</td><td class="number">{_text(value)}</td></tr>'
            for name, value in stages
        ]
        total = sum(made.stage_seconds.values())
        rows.append(f'<tr class="total"><td>all</td><td class="number">{total:.1f} s</td></tr>')
        parts.append(_table(["<th>Stage</th>", '<th class="number">Time</th>'], rows, "narrow"))
    return "\n".join(part for part in parts if part)


def _mean_errors(action: ActionSummary) -> tuple[float, float | None]:
    """Mean distance from the goals [m], of our policy and of the one without parameters.

    The second is None unless that policy was run for every goal: other means would not compare.
    """
    ours = float(np.mean([o.error(o.ours) for o in action.outcomes]))
    others = [o.error(o.without) for o in action.outcomes if o.without is not None]
    return ours, float(np.mean(others)) if len(others) == len(action.outcomes) else None


def _remark(
    key: str,
    values: Mapping[str, Any],
    interval: tuple[float, float] | None,
    true: float | None,
) -> str:
    """How far a value can be trusted, in words."""
    if key == "density":
        if values.get("density_assumed") is None:
            return ""
        if values["density_assumed"]:
            return "Assumed, not measured: the motion shows only E / ρ, so E scales with this."
        return "From the object's mass and size."
    texts = []
    known = _identifiable(values, "youngs_modulus" if key == "specific_modulus" else key)
    if known is False:
        texts.append("The lift does not determine this: the interval is mostly the prior.")
    elif key == "specific_modulus":
        texts.append("What a motion under gravity depends on, whatever the density.")
    elif key == "bending_length":
        texts.append("About the length over which the object bends under its own weight.")
    elif known:
        texts.append("Determined by the lift.")
    if interval is not None and true is not None:
        inside = interval[0] <= true <= interval[1]
        texts.append(f"The true value lies {'inside' if inside else 'outside'} the interval.")
    return " ".join(texts)


def _identifiable(values: Mapping[str, Any], key: str) -> bool | None:
    """Whether the lift determines a parameter; None: not said."""
    return (values.get("identifiable") or {}).get(key)


def _interval(values: Mapping[str, Any], key: str) -> tuple[float, float] | None:
    ends = (values.get("intervals") or {}).get(key)
    if ends is None:
        return None
    low, high = (_number(end) for end in ends)
    return None if low is None or high is None else (low, high)


def _level(values: Mapping[str, Any]) -> str:
    level = _number((values.get("intervals") or {}).get("level"))
    return "" if level is None else f"{100.0 * level:g} %"


def _bar(
    value: float,
    interval: tuple[float, float] | None,
    true: float | None,
    bounds: tuple[float, float] | None,
) -> str:
    """The interval inside the range that was searched, drawn with boxes."""
    if interval is None or bounds is None or not bounds[0] < bounds[1]:
        return ""

    def percent(x: float) -> float:
        return 100.0 * min(max((x - bounds[0]) / (bounds[1] - bounds[0]), 0.0), 1.0)

    left, right = percent(interval[0]), percent(interval[1])
    marks = (
        f'<span class="interval" style="left:{left:.2f}%;width:{right - left:.2f}%"></span>'
        f'<span class="estimate" style="left:{percent(value):.2f}%"></span>'
    )
    if true is not None:
        marks += f'<span class="truth" style="left:{percent(true):.2f}%"></span>'
    return f'<div class="range">{marks}</div>'


def _quantity(key: str, value: float) -> str:
    """A value with its unit."""
    if key == "youngs_modulus":
        factor, unit = _pascal(value)
        return _minus(f"{value * factor:.4g} {unit}")
    if key == "bending_length":
        return _length(value)
    unit = {"poissons_ratio": "", "density": " kg/m³", "specific_modulus": " m²/s²"}[key]
    text = f"{value:.3f}" if key == "poissons_ratio" else f"{value:.4g}"
    return _minus(text + unit)


def _span(key: str, interval: tuple[float, float]) -> str:
    """Both ends in one unit."""
    low, high = interval
    factor, unit = 1.0, {"density": "kg/m³", "specific_modulus": "m²/s²"}.get(key, "")
    if key == "youngs_modulus":
        factor, unit = _pascal(high)
    elif key == "bending_length":
        factor, unit = 1e3, "mm"
    low, high = factor * low, factor * high
    decimals = 3
    if key != "poissons_ratio":
        decimals = max(0, 3 - math.floor(math.log10(max(abs(high), 1e-9))))
    return _minus(f"{low:.{decimals}f} to {high:.{decimals}f} {unit}".rstrip())


def _difference(key: str, value: float, true: float) -> str:
    """Relative, but absolute for Poisson's ratio, whose zero means nothing special."""
    if key == "poissons_ratio" or true == 0.0:
        return _minus(f"{value - true:+.3f}")
    return _minus(f"{100.0 * (value / true - 1.0):+.1f} %")


def _pascal(value: float) -> tuple[float, str]:
    for factor, unit in ((1e-9, "GPa"), (1e-6, "MPa"), (1e-3, "kPa")):
        if abs(value) * factor >= 1.0:
            return factor, unit
    return 1.0, "Pa"


def _length(value: float) -> str:
    """Metres from 1 m on, millimetres below; never finer than a tenth, but for tiny ones."""
    if abs(value) >= 1.0:
        return _minus(f"{value:.2f} m")
    form = ".0f" if abs(value) >= 0.1 else ".1f" if abs(value) >= 1e-4 else ".2g"
    return _minus(f"{1e3 * value:{form}} mm")


def _place(coordinates: np.ndarray) -> str:
    return _minus(", ".join(f"{c:.3f}" for c in coordinates) + " m")


def _minus(text: str) -> str:
    return text.replace("-", "\N{MINUS SIGN}")


def _number(value: Any) -> float | None:
    """A finite float, or None."""
    if value is None or isinstance(value, (bool, str)):
        return None
    try:
        value = float(value)
    except (TypeError, ValueError):
        return None
    return value if math.isfinite(value) else None


def _convert(target: object, name: str, dimensions: int, array: np.ndarray) -> None:
    """Set a field of a frozen dataclass to an array, after a look at it."""
    if array.ndim != dimensions or array.size == 0:
        raise GendomError(
            f"has shape {list(array.shape)}", where=name, fix=f"give {dimensions} dimensions"
        )
    if not np.isfinite(array).all():
        raise GendomError("holds NaN or infinity", where=name, fix="check what made it")
    object.__setattr__(target, name, array)


def _text(value: str) -> str:
    return html.escape(value, quote=True)


def _table(head: Iterable[str], rows: Iterable[str], kind: str = "") -> str:
    attribute = f' class="{kind}"' if kind else ""
    return (
        f'<div class="scroll"><table{attribute}><thead><tr>{"".join(head)}</tr></thead>\n'
        "<tbody>\n" + "\n".join(rows) + "\n</tbody></table></div>"
    )


def _facts_list(facts: Sequence[tuple[str, str]]) -> str:
    if not facts:
        return ""
    items = [f"<div><dt>{_text(n)}</dt><dd>{_text(v)}</dd></div>" for n, v in facts]
    return '<dl class="facts">\n' + "\n".join(items) + "\n</dl>"


def _figure(svg: bytes, description: str, caption: str) -> str:
    below = f"<figcaption>{_text(caption)}</figcaption>" if caption else ""
    return f"<figure>{_image(svg, 'svg+xml', description)}{below}</figure>"


def _image(data: bytes, kind: str, description: str) -> str:
    code = base64.b64encode(data).decode("ascii")
    return f'<img src="data:image/{kind};base64,{code}" alt="{_text(description)}">'


def _asset(name: str) -> str:
    return resources.files("gendom.viz").joinpath(name).read_text(encoding="utf-8")
