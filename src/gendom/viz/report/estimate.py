"""The estimate: whether it can be used, and its parameters with what the lift says of them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gendom.materials.unknowns import UNKNOWNS
from gendom.viz.report.markup import (
    DASH,
    Section,
    cell,
    escaped,
    number,
    table,
)
from gendom.viz.report.summary import (
    RATIOS,
    EstimateSummary,
    difference_text,
    interval_text,
    quantity_text,
)

# What people call some quantities; others go by the registry.
_HTML_NAMES = {
    "E": "Young's modulus <i>E</i>",
    "nu": "Poisson's ratio <i>ν</i>",
    "friction": "Friction on the table <i>μ</i>",
    "stiffness_slope": "d ln <i>E</i> / d(<i>s</i> / <i>L</i>)",
    "thickness": "Diameter or thickness",
    "density": "Density <i>ρ</i>",
    "E_over_rho": "Specific modulus <i>E</i> / <i>ρ</i>",
    "bending_length": "Bending length",
}

# The same within a sentence.
_NAMES = {
    "E": "Young's modulus",
    "nu": "Poisson's ratio",
    "stiffness_slope": "the change of stiffness along the rope",
    "thickness": "the thickness",
}


def _of_material() -> list[str]:
    """Keys of the material's parameters, E first."""
    own = (n for n, u in UNKNOWNS.items() if u.material and n != "E_over_rho")
    return ["E", *own]


def verdict_banner(summary: EstimateSummary) -> str:
    """HTML; empty where the estimate's file has no verdict."""
    if summary.usable is None:
        return ""
    if not summary.usable:
        return refusal_banner(
            summary.reasons, "What follows is the best fit, not an estimate of the object."
        )
    names = {True: [], False: []}
    for key in _of_material():
        known = summary.determined(key)
        measured = key == "thickness" and not known  # by a caliper, or assumed
        if known is not None and summary.value(key) is not None and not measured:
            names[known].append(_NAMES.get(key) or UNKNOWNS[key].title)
    text = "The recording and the fit pass every check."
    if names[True]:
        text += f" The lift determines {_listed(names[True])}."
    if names[False]:
        text += f" It does not determine {_listed(names[False])}: there the interval is mostly the "
        text += "prior."
    return f'<div class="verdict good"><p><strong>Usable.</strong> {escaped(text)}</p></div>'


def refusal_banner(reasons: Sequence[str], text: str = "") -> str:
    """What is wrong with a recording or its fit; plain text."""
    items = "".join(f"<li>{escaped(reason)}</li>" for reason in reasons)
    return (
        f'<div class="verdict bad"><p><strong>Not usable.</strong> {escaped(text)}</p>'
        f"<ul>{items}</ul></div>"
    )


def _listed(names: Sequence[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last


def parameters_section(summary: EstimateSummary) -> Section:
    """A row for each quantity, and how to read the bars if there are any."""
    keys = [*_of_material(), "density", "E_over_rho", "bending_length"]
    knows_truth = any(summary.true(key) is not None for key in keys)
    has_interval = any(summary.interval(key) is not None for key in keys)
    rows, bars = [], False
    for key in keys:
        name = _HTML_NAMES.get(key) or escaped(UNKNOWNS[key].title.capitalize())
        value = summary.value(key)
        if value is None:
            continue
        interval, true = summary.interval(key), summary.true(key)
        cells = [cell(name, "name"), number(quantity_text(key, value), "estimate")]
        if has_interval:
            shown = escaped(interval_text(key, interval)) if interval else DASH
            bar = _bar(key, value, interval, true, summary.searched(key))
            bars = bars or bool(bar)
            label = f"{summary.level_text} interval"
            kind = "interval" if interval else "interval none"
            cells.append(cell(f"<span>{shown}{bar}</span>", kind, label=label))
        if knows_truth:
            shown = DASH if true is None else quantity_text(key, true)
            cells.append(number(shown, "true value"))
            shown = DASH if true is None else difference_text(key, value, true)
            cells.append(number(shown, "off by"))
        cells.append(cell(escaped(_remark(key, summary)), "remark"))
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
            '\n<p class="soft">Bars: the grey range was searched, the blue part is the interval, '
            "the thick mark the estimate"
            + (", the thin mark the true value" if knows_truth else "")
            + ". Scales are logarithmic, but for ratios.</p>"
        )
    return Section(title="The estimate", body=text)


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
    known = summary.determined("E" if key == "E_over_rho" else key)
    if known is False:
        said = (
            "a usual value" if summary.interval(key) is None else "the interval is mostly the prior"
        )
        texts.append(f"The lift does not determine this: {said}.")
    elif key == "E_over_rho":
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
