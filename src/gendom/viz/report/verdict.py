"""The first thing a report says: whether its estimate can be used, and why."""

from __future__ import annotations

from collections.abc import Sequence

from gendom.viz.report.markup import escaped
from gendom.viz.report.summary import EstimateSummary

_NAMES = {
    "E": "Young's modulus",
    "nu": "Poisson's ratio",
    "damping": "damping",
    "friction": "friction",
    "stiffness_slope": "the change of stiffness along the rope",
    "thickness": "the thickness",
}


def verdict_banner(summary: EstimateSummary) -> str:
    """HTML; empty where the estimate's file has no verdict."""
    if summary.usable is None:
        return ""
    if not summary.usable:
        return refusal_banner(
            summary.reasons, "What follows is the best fit, not an estimate of the object."
        )
    names = {True: [], False: []}
    for key, name in _NAMES.items():
        known = summary.determined(key)
        if known is not None and summary.value(key) is not None:
            names[known].append(name)
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
