"""The section that shows how the search for the parameters went."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gendom.viz.charts import Axis, Plot
from gendom.viz.report.markup import (
    DASH,
    Section,
    cell,
    chart_figure,
    facts_list,
    folded,
    number,
    table,
)
from gendom.viz.report.summary import (
    EstimateSummary,
    finite,
    length_text,
    pascal_unit,
    property_text,
    quantity_text,
)

_SERIES = 6  # colours of `report.css` for the starts of a search


def search_section(summary: EstimateSummary) -> Section | None:
    """Distance and parameters against iteration, where each start ended, and how well it fits."""
    charts = _search_charts(summary)
    parts = []
    if charts:
        parts.append(f'<div class="pair">{"".join(charts)}</div>')
    parts += [_starts_table(summary), _fit_facts(summary)]
    body = "\n".join(part for part in parts if part)
    return Section(title="The search", body=body) if body else None


def _fit_facts(summary: EstimateSummary) -> str:
    """How well both lifts match, how the search went, and what was held."""
    values = summary.values
    facts = []
    for key, name in (
        ("rms", "distance of recorded points from the simulated surface, root mean square"),
        ("chamfer_mean", "Chamfer distance, all frames"),
        ("chamfer_last", "Chamfer distance, last frame"),
        ("chamfer_mean_surface", "Chamfer distance, seen surface, all frames"),
        ("chamfer_last_surface", "Chamfer distance, seen surface, last frame"),
        ("chamfer_mean_registered", "Chamfer distance with the cameras' motion, all frames"),
        ("chamfer_last_registered", "Chamfer distance with the cameras' motion, last frame"),
    ):
        value = summary.value(key)
        if value is not None:
            facts.append((name, length_text(value)))
    for key, name in (("method", "method"), ("device", "device"), ("seed", "seed")):
        if values.get(key) is not None:
            facts.append((name, str(values[key])))
    for key, name, unit in (
        ("iterations", "iterations, all starts", ""),
        ("seconds", "time", " s"),
    ):
        value = summary.value(key)
        if value is not None:
            facts.append((name, f"{value:.4g}{unit}"))
    described = values.get("object")
    if isinstance(described, Mapping):
        known = [
            f"{name} {property_text(name, value)}"
            for name, value in described.items()
            if isinstance(value, (str, int, float))
        ]
        facts.append(("object", ", ".join(known)))
    return facts_list(facts)


def _starts_table(summary: EstimateSummary) -> str:
    """Where each start of the search began and ended."""
    starts = summary.values.get("starts") or []
    if len(starts) < 2:
        return ""
    keys = ("E", "nu")
    titles = ("E at the start", "ν at the start", "E found", "ν found", "distance")
    rows = []
    for start in starts:
        texts = []
        for stage in ("initial", "final"):
            for key in keys:
                value = finite((start.get(stage) or {}).get(key))
                texts.append(DASH if value is None else quantity_text(key, value))
        loss = finite(start.get("loss"))
        texts.append(DASH if loss is None else length_text(loss))
        cells = [cell(f"start {len(rows) + 1}", "name")]
        cells += [number(text, title) for text, title in zip(texts, titles, strict=True)]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    head = ["<th>Start</th>", *(f'<th class="number">{title}</th>' for title in titles)]
    return folded(f"All {len(starts)} starts", table(head, rows))


def _search_charts(summary: EstimateSummary) -> list[str]:
    """Distance and both parameters against iteration, a line for each stage of each start."""
    values = summary.values
    factor, unit = pascal_unit(values["E"])
    figures = []
    for key, name, scale in (
        ("loss", "Distance of the clouds from the fit [mm]", 1e3),
        ("E", f"Young's modulus [{unit}]", factor),
        ("nu", "Poisson's ratio", 1.0),
    ):
        stages = _stages(summary, key, scale)
        # what the lift does not determine hardly moves
        if not stages or (key == "nu" and summary.determined(key) is False):
            continue
        true = summary.true(key)
        ends = np.concatenate([numbers for *_, numbers in stages.values()])
        ends = ends if true is None else np.append(ends, scale * true)
        last = max(float(iterations[-1]) for iterations, _ in stages.values())
        log = key != "nu" and bool((ends > 0.0).all())
        plot = Plot(
            x=Axis(low=0.5, high=max(last, 2.0) + 0.5, label="iteration"),
            y=Axis.around(ends, log=log),
        )
        _draw_stages(plot, stages, _chosen_start(summary))
        if true is not None:
            plot.level(scale * true, "truth", "true value")
        note = ""
        if key == "loss":
            note = (
                "Root mean square, logarithmic scale. The search makes the fit as probable as it "
                "can be, noise and priors included, so this distance need not fall in every step. "
                "Stages compare different points or move different parameters."
            )
        figures.append(chart_figure(name, [plot], note))
    return figures


_Stages = dict[tuple[int, str], tuple[np.ndarray, np.ndarray]]


def _stages(summary: EstimateSummary, key: str, scale: float) -> _Stages:
    """[k] iterations and [k] values of each stage of each start. A stage begins where the one
    before it has ended."""
    found: dict[tuple[int, str], list[tuple[float, float]]] = {}
    for entry in summary.values.get("history") or []:
        iteration, value = finite(entry.get("iteration")), finite(entry.get(key))
        if iteration is not None and value is not None:
            name = int(entry.get("start", 0)), str(entry.get("stage", ""))
            found.setdefault(name, []).append((iteration, scale * value))
    stages: _Stages = {}
    before: dict[int, tuple[float, float]] = {}
    for name in sorted(found, key=lambda name: name[0]):  # by start; stages stay in their order
        points = sorted(found[name])
        first = [before[name[0]]] if name[0] in before else []
        iterations, numbers = np.array([*first, *points]).T
        stages[name] = iterations, numbers
        before[name[0]] = points[-1]
    return stages


def _draw_stages(plot: Plot, stages: _Stages, chosen: int | None) -> None:
    """A line for each; those before the search's last stage are dashed."""
    several_starts = len({start for start, _ in stages}) > 1
    several_stages = len({stage for _, stage in stages}) > 1
    last = dict(list(stages))  # stage of each start
    for (start, stage), (iterations, numbers) in stages.items():
        label = f"start {start + 1}" if several_starts else ""
        if several_stages:
            label = ", ".join(filter(None, (label, stage)))
        if several_starts and start == chosen and stage == last[start]:
            label += " (chosen)"
        kind, early = f"start-{start % _SERIES + 1}", stage != last.get(chosen or 0)
        plot.line(iterations, numbers, kind, label, dashed=early, dots=True)


def _chosen_start(summary: EstimateSummary) -> int | None:
    """The start that ended at the estimate; where several did or none, that of least distance."""
    starts = summary.values.get("starts") or []
    found = summary.value("E")
    ended = [finite((start.get("final") or {}).get("E")) for start in starts]
    if ended.count(found) == 1:
        return ended.index(found)
    losses = [finite(start.get("loss")) for start in starts]
    known = [(loss, i) for i, loss in enumerate(losses) if loss is not None]
    return min(known)[1] if known else None
