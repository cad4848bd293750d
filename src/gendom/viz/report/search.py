"""The section that shows how the search for the parameters went."""

from __future__ import annotations

import numpy as np

from gendom.viz.charts import Axis, Plot
from gendom.viz.report.markup import Section, facts_list, side_by_side
from gendom.viz.report.summary import (
    EstimateSummary,
    finite,
    length_text,
    pascal_unit,
)

_SERIES = 6  # colours of `report.css` for the starts of a search

_DISTANCES = {
    "rms": "distance of recorded points from the simulated surface, root mean square",
    "chamfer_mean": "Chamfer distance, all frames",
    "chamfer_last": "Chamfer distance, last frame",
    "chamfer_mean_surface": "Chamfer distance, seen surface, all frames",
    "chamfer_last_surface": "Chamfer distance, seen surface, last frame",
    "chamfer_mean_registered": "Chamfer distance with the cameras' motion, all frames",
    "chamfer_last_registered": "Chamfer distance with the cameras' motion, last frame",
}


def search_section(summary: EstimateSummary) -> Section | None:
    """Distance and E against iteration, and how well it fits."""
    factor, unit = pascal_unit(summary.values["E"])
    note = (
        "Root mean square, logarithmic scale. The search makes the fit as probable as it can be, "
        "noise and priors included, so this distance need not fall in every step. Stages compare "
        "different points or move different parameters."
    )
    figures = [
        _chart(summary, "loss", "Distance of the clouds from the fit [mm]", 1e3, note),
        _chart(summary, "E", f"Young's modulus [{unit}]", factor),
    ]
    parts = [side_by_side([f for f in figures if f]), _facts(summary)]
    body = "\n".join(part for part in parts if part)
    return Section(title="The search", body=body) if body else None


def _chart(summary: EstimateSummary, key: str, title: str, scale: float, note: str = "") -> str:
    """A quantity against iteration, a line for each stage of each start."""
    series: dict[tuple[int, str], list[tuple[float, float]]] = {}
    for entry in summary.values.get("history") or []:
        at, value = finite(entry.get("iteration")), finite(entry.get(key))
        if at is not None and value is not None and value > 0.0:
            name = int(entry.get("start", 0)), str(entry.get("stage", ""))
            series.setdefault(name, []).append((at, scale * value))
    if not series:
        return ""
    every, true = np.concatenate(list(series.values())), summary.true(key)
    shown = every[:, 1] if true is None else np.append(every[:, 1], scale * true)
    x = Axis(low=every[:, 0].min() - 0.5, high=every[:, 0].max() + 0.5, label="iteration")
    plot = Plot(x=x, y=Axis.around(shown, log=True))
    last = {start: stage for start, stage in series}  # of each start
    for (start, stage), points in sorted(series.items(), key=lambda named: named[0][0]):
        kind, early = f"start-{start % _SERIES + 1}", stage != last[start]
        at, values = np.transpose(points)
        label = ", ".join(filter(None, (f"start {start + 1}", stage)))
        plot.line(at, values, kind, label, "dashed" if early else "line")
        plot.marks(at, values, kind)
    if true is not None:
        plot.level(scale * true, "truth", "true value")
    return plot.figure(title, note)


def _facts(summary: EstimateSummary) -> str:
    """How well both lifts match, how the search went, and what was held."""
    values = summary.values
    facts = [
        (name, length_text(value))
        for key, name in _DISTANCES.items()
        if (value := summary.value(key)) is not None
    ]
    facts += [
        (n, str(values[n])) for n in ("method", "device", "seed") if values.get(n) is not None
    ]
    for key, name in (("iterations", "iterations, all starts"), ("seconds", "time [s]")):
        if (value := summary.value(key)) is not None:
            facts.append((name, f"{value:.4g}"))
    held = dict(values.get("object") or {})
    kind, mass = str(held.pop("kind", "")), finite(held.pop("mass", None))
    if kind == "rope":
        held.pop("thickness", None)  # a rope's is a share of its diameter
    known = [f"{n} {length_text(v)}" for n, v in held.items() if finite(v) is not None]
    known += [] if mass is None else [f"mass {mass:.4g} kg"]
    return facts_list([*facts, *([("object", ", ".join([kind, *known]))] if kind else [])])
