"""The estimate: whether it can be used, and its parameters with what the lift says of them."""

from __future__ import annotations

from collections.abc import Sequence

from gendom.materials.unknowns import UNKNOWNS
from gendom.viz.report.markup import DASH, Section, escaped, table
from gendom.viz.report.summary import (
    EstimateSummary,
    difference_text,
    interval_text,
    quantity_text,
    title_of,
)


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
            summary.values["verdict"].get("reasons") or (),
            "What follows is the best fit, not an estimate of the object.",
        )
    names = {True: [], False: []}
    for key in _of_material():
        known = summary.determined(key)
        measured = key == "thickness" and not known  # by a caliper, or assumed
        if known is not None and summary.value(key) is not None and not measured:
            names[known].append(title_of(key))
    text = "The recording and the fit pass every check."
    if names[True]:
        text += f" Determined by the lift: {', '.join(names[True])}."
    if names[False]:
        text += f" Not determined, the interval is mostly the prior: {', '.join(names[False])}."
    return f'<div class="verdict good"><p><strong>Usable.</strong> {escaped(text)}</p></div>'


def refusal_banner(reasons: Sequence[str], text: str = "") -> str:
    """What is wrong with a recording or its fit; plain text."""
    items = "".join(f"<li>{escaped(reason)}</li>" for reason in reasons)
    return (
        f'<div class="verdict bad"><p><strong>Not usable.</strong> {escaped(text)}</p>'
        f"<ul>{items}</ul></div>"
    )


def parameters_section(summary: EstimateSummary) -> Section:
    """A row for each quantity."""
    keys = [*_of_material(), "density", "E_over_rho", "bending_length"]
    knows_truth = any(summary.true(key) is not None for key in keys)
    has_interval = any(summary.interval(key) is not None for key in keys)
    columns = {"Quantity": "name", "Estimate": "number"}
    if has_interval:
        columns[f"{summary.level_text} interval"] = "interval"
    if knows_truth:
        columns |= {"True value": "number", "Off by": "number"}
    columns["What the lift says"] = "remark"
    rows = []
    for key in keys:
        value = summary.value(key)
        if value is None:
            continue
        interval, true = summary.interval(key), summary.true(key)
        row = [title_of(key), quantity_text(key, value)]
        if has_interval:
            row.append(DASH if interval is None else interval_text(key, interval))
        if knows_truth and true is None:
            row += [DASH, DASH]
        elif true is not None:
            row += [quantity_text(key, true), difference_text(key, value, true)]
        rows.append([*row, _remark(key, summary)])
    return Section(title="The estimate", body=table(columns, rows))


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
    interval, true, texts = summary.interval(key), summary.true(key), []
    known = summary.determined("E" if key == "E_over_rho" else key)
    if known is False:
        said = "a usual value" if interval is None else "the interval is mostly the prior"
        texts.append(f"The lift does not determine this: {said}.")
    elif key == "E_over_rho":
        texts.append("What a motion under gravity depends on, whatever the density.")
    elif key == "bending_length":
        texts.append("About the length over which the object bends under its own weight.")
    elif known:
        texts.append("Determined by the lift.")
    if interval is not None and true is not None:
        inside = interval[0] <= true <= interval[1]
        texts.append(f"The true value lies {'inside' if inside else 'outside'} the interval.")
    return " ".join(texts)
