"""The section that tells what was estimated, and how far it can be trusted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Any

import numpy as np

from gendom.errors import GendomError
from gendom.viz.charts import distance_chart, parameter_chart, search_chart
from gendom.viz.clouds import CloudSequence
from gendom.viz.report.markup import DASH, escaped, facts_list, figure, table
from gendom.viz.report.page import Section
from gendom.viz.report.quantities import (
    RATIOS,
    difference_text,
    finite,
    interval_text,
    length_text,
    pascal_unit,
    property_text,
    quantity_text,
    with_minus,
)

ESTIMATE_FORMAT = "gendom-estimate/1"


@dataclass(frozen=True, kw_only=True)
class EstimateSummary:
    """What was estimated, and what is known besides.

    Raises:
        GendomError: `values` has another format, or no Young's modulus or Poisson's ratio; or
            an interval or a range that was searched is not a pair of numbers.
    """

    values: Mapping[str, Any]
    """The estimate's JSON object (gendom-estimate/1), SI units; other keys may be missing."""
    truth: Mapping[str, float] | None = None
    """True values under the keys of `values`, as far as known."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Of the unknowns of the estimate's posterior, by name."""

    def __post_init__(self):
        found = self.values.get("format", ESTIMATE_FORMAT)
        if found != ESTIMATE_FORMAT:
            raise GendomError(
                f"is {found!r}", where="estimate.format", fix=f"give {ESTIMATE_FORMAT!r}"
            )
        for key in ("youngs_modulus", "poissons_ratio"):
            if finite(self.values.get(key)) is None:
                raise GendomError("is no number", where=f"estimate.{key}", fix="estimate again")
        for name in ("intervals", "bounds"):
            for key, ends in (self.values.get(name) or {}).items():
                if key != "level" and ends is not None and len(np.atleast_1d(ends)) != 2:
                    raise GendomError(
                        f"is {ends!r}", where=f"estimate.{name}.{key}", fix="give [low, high]"
                    )

    def value(self, key: str) -> float | None:
        """What was estimated, in the unit of `values`."""
        return finite(self.values.get(key))

    def true(self, key: str) -> float | None:
        """The true value, where it is known."""
        return finite((self.truth or {}).get(key))

    def interval(self, key: str) -> tuple[float, float] | None:
        """Lowest and highest plausible value."""
        return self._ends("intervals", key)

    def searched(self, key: str) -> tuple[float, float] | None:
        """Lowest and highest value that was looked at; None: the file does not say."""
        return self._ends("bounds", key)

    def _ends(self, name: str, key: str) -> tuple[float, float] | None:
        ends = (self.values.get(name) or {}).get(key)
        if ends is None:
            return None
        low, high = (finite(end) for end in ends)
        return None if low is None or high is None else (low, high)

    @property
    def level_text(self) -> str:
        """How probable the intervals are: "90 %"."""
        level = finite((self.values.get("intervals") or {}).get("level"))
        return "" if level is None else f"{100.0 * level:g} %"

    @property
    def usable(self) -> bool | None:
        """Whether the estimate is of any use; None: not said."""
        return (self.values.get("verdict") or {}).get("usable")

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it is not."""
        return tuple((self.values.get("verdict") or {}).get("reasons") or ())

    def determined(self, key: str) -> bool | None:
        """Whether the lift determines a parameter; None: not said."""
        return (self.values.get("identifiable") or {}).get(key)


# Key of an estimate, its name, and what to say about it.
_ROWS = (
    ("youngs_modulus", "Young's modulus <i>E</i>"),
    ("poissons_ratio", "Poisson's ratio <i>ν</i>"),
    ("friction", "Friction on the table <i>μ</i>"),
    ("damping", "Damping"),
    ("stiffness_slope", "d ln <i>E</i> / d(<i>s</i> / <i>L</i>)"),
    ("density", "Density <i>ρ</i>"),
    ("specific_modulus", "Specific modulus <i>E</i> / <i>ρ</i>"),
    ("bending_length", "Bending length"),
)


def estimate_section(summary: EstimateSummary, clouds: CloudSequence | None = None) -> Section:
    """Verdict, parameters with intervals, the search for them, and how well the lifts match.

    Args:
        summary: The estimate.
        clouds: Both lifts at the frames that were compared, for charts of their distance.
    """
    parts = [_verdict(summary), _parameter_table(summary)]
    charts = _search_charts(summary) + _distance_charts(summary, clouds)
    if charts:
        parts.append(f'<div class="pair">{"".join(charts)}</div>')
    parts.append(_beliefs_table(summary))
    parts.append(_fit_facts(summary))
    parts.append(_starts_table(summary))
    return Section(title="The estimate", body="\n".join(part for part in parts if part))


def _verdict(summary: EstimateSummary) -> str:
    if summary.usable is None:
        return ""
    if summary.usable:
        return "<p>Verdict: the recording and its fit are usable.</p>"
    reasons = "".join(f"<li>{escaped(reason)}</li>" for reason in summary.reasons)
    return (
        '<div class="warning"><strong>Not usable.</strong> What follows is the best fit, not an '
        f"estimate of the object.<ul>{reasons}</ul></div>"
    )


def _parameter_table(summary: EstimateSummary) -> str:
    """A row for each quantity, and how to read the bars if there are any."""
    knows_truth = any(summary.true(key) is not None for key, _ in _ROWS)
    has_interval = any(summary.interval(key) is not None for key, _ in _ROWS)
    rows, bars = [], False
    for key, name in _ROWS:
        value = summary.value(key)
        if value is None:
            continue
        interval, true = summary.interval(key), summary.true(key)
        cells = [f'<td class="name">{name}</td>', _number_cell(quantity_text(key, value))]
        if has_interval:
            shown = escaped(interval_text(key, interval)) if interval else DASH
            bar = _bar(key, value, interval, true, summary.searched(key))
            bars = bars or bool(bar)
            cells.append(f'<td class="interval">{shown}{bar}</td>')
        if knows_truth:
            cells.append(_number_cell(DASH if true is None else quantity_text(key, true)))
            cells.append(_number_cell(DASH if true is None else difference_text(key, value, true)))
        cells.append(f'<td class="remark">{escaped(_remark(key, summary))}</td>')
        rows.append(f"<tr>{''.join(cells)}</tr>")
    head = ["<th>Quantity</th>", '<th class="number">Estimate</th>']
    if has_interval:
        head.append(f'<th class="interval">{escaped(summary.level_text)} interval</th>')
    if knows_truth:
        head += ['<th class="number">True value</th>', '<th class="number">Off by</th>']
    head.append("<th>What the lift says</th>")
    text = table(head, rows)
    if bars:
        text += (
            '\n<p class="soft">Bars: the grey range was searched, the light part is the interval, '
            "the blue mark the estimate"
            + (", the black mark the true value" if knows_truth else "")
            + ". Logarithmic, but for ratios.</p>"
        )
    return text


def _number_cell(text: str) -> str:
    return f'<td class="number">{escaped(text)}</td>'


def _search_charts(summary: EstimateSummary) -> list[str]:
    """Distance and both parameters against iteration, for every start."""
    values = summary.values
    entries = values.get("history") or []
    losses = [finite(start.get("loss")) for start in values.get("starts") or []]
    known = [(loss, i) for i, loss in enumerate(losses) if loss is not None]
    best = min(known)[1] if known else None
    factor, unit = pascal_unit(values["youngs_modulus"])
    figures = []
    for key, name, scale in (
        ("loss", "Distance", 1.0),
        ("youngs_modulus", f"Young's modulus [{unit}]", factor),
        ("poissons_ratio", "Poisson's ratio", 1.0),
    ):
        lines: dict[int, list[tuple[float, float]]] = {}
        for entry in entries:
            iteration, value = finite(entry.get("iteration")), finite(entry.get(key))
            if iteration is not None and value is not None:
                line = lines.setdefault(int(entry.get("start", 0)), [])
                line.append((iteration, scale * value))
        if not lines:
            continue
        order = sorted(lines)
        history = [tuple(np.array(sorted(lines[start])).T) for start in order]
        chosen = order.index(best) if best in order else None
        if key == "loss":
            chart = search_chart(history, chosen)
            said = "Root mean square over all frames, logarithmic scale."
            title = "Distance of the clouds from the fit in each iteration"
            figures.append(figure(chart, title, said))
        else:
            true = summary.true(key)
            true = None if true is None else scale * true
            chart = parameter_chart(history, chosen, name=name, truth=true)
            figures.append(figure(chart, f"{name} in each iteration"))
    return figures


def _distance_charts(summary: EstimateSummary, clouds: CloudSequence | None) -> list[str]:
    """How far both lifts are apart over time."""
    if clouds is None:
        return []
    figures = []
    rms = summary.values.get("rms_by_frame") or []
    if len(rms) == clouds.num_frames:
        name = "Distance of points from the simulated skin"
        said = "Root mean square in each frame that was compared."
        figures.append(figure(distance_chart(clouds.times, rms, name=name), name, said))
    if clouds.chamfer is not None:
        name = "Chamfer distance, recorded to simulated"
        said = (
            "Mean distance from each recorded point to the nearest simulated one, plus the same "
            "the other way round."
        )
        figures.append(figure(distance_chart(clouds.times, clouds.chamfer, name=name), name, said))
    return figures


_SHOWN = 3.0
"""Half of a bar of beliefs, in deviations of the prior."""


def _beliefs_table(summary: EstimateSummary) -> str:
    """Each unknown as it was believed to be and as it was found; of usable estimates."""
    posterior = summary.values.get("posterior")
    level = finite((summary.values.get("intervals") or {}).get("level"))
    if not posterior or level is None:
        return ""
    z = NormalDist().inv_cdf(0.5 + level / 2.0)
    rows = []
    for k, name in enumerate(posterior["names"]):
        before = posterior["prior_mean"][k], posterior["prior_sd"][k]
        after = posterior["mean"][k], math.sqrt(posterior["covariance"][k][k])
        ends = []
        for mean, sd in (before, after):
            low = max(mean - z * sd, posterior["low"][k])
            high = min(mean + z * sd, posterior["high"][k])
            shown = (math.exp(low), math.exp(high)) if posterior["log"][k] else (low, high)
            ends.append(with_minus(f"{shown[0]:.3g} to {shown[1]:.3g}"))
        left, at, right = (
            50.0 + 50.0 * min(max((x - before[0]) / (_SHOWN * before[1]), -1.0), 1.0)
            for x in (after[0] - z * after[1], after[0], after[0] + z * after[1])
        )
        half = 50.0 * z / _SHOWN
        bar = (
            f'<div class="range"><span class="prior" style="left:{50.0 - half:.2f}%;'
            f'width:{2.0 * half:.2f}%"></span><span class="interval" style="left:{left:.2f}%;'
            f'width:{right - left:.2f}%"></span><span class="estimate" style="left:{at:.2f}%">'
            "</span></div>"
        )
        unit = summary.units.get(name, "")
        label = name.replace("_", " ") + (f" [{unit}]" if unit not in ("", "1") else "")
        cells = [f'<td class="name">{escaped(label)}</td>', *map(_number_cell, ends)]
        rows.append(f"<tr>{''.join(cells)}<td>{bar}</td></tr>")
    head = ["<th>Unknown</th>", '<th class="number">Believed before</th>']
    head += ['<th class="number">Found</th>', "<th>Both</th>"]
    return (
        "<details><summary>What was believed before, and what was found</summary>"
        f"{table(head, rows)}"
        f'<p class="soft">{escaped(summary.level_text)} intervals. Bars: grey before, blue after, '
        "within three standard deviations of what was believed.</p></details>"
    )


def _fit_facts(summary: EstimateSummary) -> str:
    """How well both lifts match, how the search went, and what was held."""
    values = summary.values
    facts = []
    for key, name in (
        ("rms", "distance of points from the simulated skin, root mean square"),
        ("chamfer_mean", "Chamfer distance, all frames"),
        ("chamfer_last", "Chamfer distance, last frame"),
        ("chamfer_mean_surface", "to the simulated surface, all frames"),
        ("chamfer_last_surface", "to the simulated surface, last frame"),
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
    keys = ("youngs_modulus", "poissons_ratio")
    rows = []
    for start in starts:
        cells = []
        for stage in ("initial", "final"):
            for key in keys:
                value = finite((start.get(stage) or {}).get(key))
                cells.append(_number_cell(DASH if value is None else quantity_text(key, value)))
        loss = finite(start.get("loss"))
        cells.append(_number_cell(DASH if loss is None else length_text(loss)))
        rows.append(f"<tr>{''.join(cells)}</tr>")
    titles = ("E at the start", "ν at the start", "E found", "ν found", "Distance")
    head = [f'<th class="number">{title}</th>' for title in titles]
    return f"<details><summary>All {len(starts)} starts</summary>{table(head, rows)}</details>"


def _remark(key: str, summary: EstimateSummary) -> str:
    """How far a value can be trusted, in words."""
    if key == "density":
        assumed = summary.values.get("density_assumed")
        if assumed is None:
            return ""
        if assumed:
            return "Assumed, not measured: the motion shows only E / ρ, so E scales with this."
        return "From the object's mass and size."
    if summary.usable is False:
        return ""
    texts = []
    known = summary.determined("youngs_modulus" if key == "specific_modulus" else key)
    if known is False:
        said = (
            "a usual value" if summary.interval(key) is None else "the interval is mostly the prior"
        )
        texts.append(f"The lift does not determine this: {said}.")
    elif key == "specific_modulus":
        texts.append("What a motion under gravity depends on, whatever the density.")
    elif key == "bending_length":
        texts.append("About the length over which the object bends under its own weight.")
    elif known:
        texts.append("Determined by the lift.")
    interval, true = summary.interval(key), summary.true(key)
    if interval is not None and true is not None:
        inside = interval[0] <= true <= interval[1]
        texts.append(f"The true value lies {'inside' if inside else 'outside'} the interval.")
    return " ".join(texts)


def _bar(
    key: str,
    value: float,
    interval: tuple[float, float] | None,
    true: float | None,
    bounds: tuple[float, float] | None,
) -> str:
    """The interval inside the range that was searched, drawn with boxes."""
    linear = key in RATIOS
    if interval is None or bounds is None or not bounds[0] < bounds[1]:
        return ""
    if not linear and min(*bounds, *interval, value) <= 0.0:
        return ""
    scale = float if linear else math.log  # moduli are searched over decades
    low, high = scale(bounds[0]), scale(bounds[1])

    def percent(x: float) -> float:
        # what is not positive has no place on a logarithmic scale but its lower end
        at = scale(x) if linear or x > 0.0 else low
        return 100.0 * min(max((at - low) / (high - low), 0.0), 1.0)

    left, right = percent(interval[0]), percent(interval[1])
    marks = (
        f'<span class="interval" style="left:{left:.2f}%;width:{right - left:.2f}%"></span>'
        f'<span class="estimate" style="left:{percent(value):.2f}%"></span>'
    )
    if true is not None:
        marks += f'<span class="truth" style="left:{percent(true):.2f}%"></span>'
    return f'<div class="range">{marks}</div>'
