"""What was estimated: whether it can be used, the parameters, what was known before and after the
lift, and how well it fits."""

from collections.abc import Mapping, Sequence
from statistics import NormalDist
from typing import Any

import numpy as np

from gendom.materials.estimate import Estimate
from gendom.materials.unknowns import UNKNOWNS
from gendom.viz.charts import Axis, Plot
from gendom.viz.markup import DASH, escaped, facts_list, folded, side_by_side, table
from gendom.viz.quantities import (
    difference_text,
    interval_text,
    length_text,
    quantity_text,
    title_of,
    unit_of,
)

Truth = Mapping[str, float]
"""True values by the names of an estimate's record, as far as known, in SI units."""

_DRAWN_SDS = 4.2
_WHOLE = 5.0  # a prior that is wider than the posterior by more than this is drawn in part

_DISTANCES = {
    "rms": "distance of recorded points from the simulated surface, root mean square",
    "chamfer_mean": "Chamfer distance, all frames",
    "chamfer_last": "Chamfer distance, last frame",
}


def level_text(found: Estimate) -> str:
    """How probable the intervals are: "90 %"."""
    return f"{100.0 * found.level:g} %"


def _of_material() -> list[str]:
    """Keys of the material's parameters, E first."""
    return ["E", *(n for n, u in UNKNOWNS.items() if u.material and n != "E_over_rho")]


# ---- whether it can be used ----------------------------------------------------------------------


def verdict_banner(found: Estimate) -> str:
    """HTML."""
    if not found.usable:
        text = "What follows is the best fit, not an estimate of the object."
        return refusal_banner(found.verdict.reasons, text)
    names = {True: [], False: []}
    for key in _of_material():
        known = found.record["identifiable"].get(key)
        measured = key == "thickness" and not known  # by a caliper, or assumed
        if known is not None and found.record.get(key) is not None and not measured:
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


# ---- parameters ----------------------------------------------------------------------------------


def parameters(found: Estimate, truth: Truth) -> str:
    """HTML: a row for each quantity."""
    columns = {"Quantity": "name", "Estimate": "number"}
    if found.usable:
        columns[f"{level_text(found)} interval"] = "interval"
    if truth:
        columns |= {"True value": "number", "Off by": "number"}
    columns["What the lift says"] = "remark"
    rows = []
    for key in [*_of_material(), "density", "E_over_rho", "bending_length"]:
        value, ends, true = found.record.get(key), found.interval(key), truth.get(key)
        if value is None:
            continue
        row = [title_of(key), quantity_text(key, value)]
        if found.usable:
            row.append(DASH if ends is None else interval_text(key, ends, value))
        if truth:
            known = None if true is None else quantity_text(key, true)
            row += [known or DASH, DASH if true is None else difference_text(key, value, true)]
        rows.append([*row, _remark(key, found, true)])
    return table(columns, rows)


def _remark(key: str, found: Estimate, true: float | None) -> str:
    """How far a value can be trusted, in words."""
    if key == "density":
        if found.record["density_assumed"]:
            return "Assumed, not measured: the motion shows only E / ρ, so E scales with this."
        return "From the object's mass and size."
    if not found.usable:
        return ""
    ends, texts = found.interval(key), []
    known = found.record["identifiable"].get("E" if key == "E_over_rho" else key)
    if known is False:
        said = "a usual value" if ends is None else "the interval is mostly the prior"
        texts.append(f"The lift does not determine this: {said}.")
    elif key == "E_over_rho":
        texts.append("What a motion under gravity depends on, whatever the density.")
    elif key == "bending_length":
        texts.append("About the length over which the object bends under its own weight.")
    elif known:
        texts.append("Determined by the lift.")
    if ends is not None and true is not None:
        inside = ends[0] <= true <= ends[1]
        texts.append(f"The true value lies {'inside' if inside else 'outside'} the interval.")
    return " ".join(texts)


# ---- before and after the lift -------------------------------------------------------------------


def beliefs(found: Estimate, truth: Truth) -> str:
    """HTML: densities of the material's unknowns, then those of grip and clock, before and after
    the lift."""
    figures: dict[bool, list[str]] = {True: [], False: []}
    for k, u in enumerate(found.posterior.prior.unknowns):
        figures[u.material].append(_unknown(found, truth, k))
    parts = [
        '<p class="soft">Grey: what was assumed before the lift (prior). Blue: what is known after '
        "it (posterior). Areas are probabilities; a scale with unequal steps is logarithmic.</p>",
        side_by_side(figures[True]),
    ]
    if figures[False]:
        parts.append(folded("Grip and clock of the recording", side_by_side(figures[False])))
    return "\n".join(parts)


def _unknown(found: Estimate, truth: Truth, k: int) -> str:
    """Both Gaussians of unknown k as a figure.

    Densities of parameters on a logarithmic scale are those of the logarithm, so that areas are
    probabilities in either case.
    """
    all_prior = found.posterior.prior
    u, owner = all_prior.unknowns[k], all_prior.owners[k]
    low, high = float(all_prior.low[k]), float(all_prior.high[k])
    prior = NormalDist(float(all_prior.mean[k]), float(all_prior.sd[k]))
    after = NormalDist(float(found.mean[k]), float(found.sd[k]))
    relative = u.name == "thickness"
    factor, unit = (1.0, "of the stated one") if relative else unit_of(u.name)
    several = any(all_prior.owners)  # recordings
    title = title_of(u.name)
    title += "" if owner is None or not several else f", recording {owner + 1}"
    title += f" [{unit}]" if unit else ""
    sds = NormalDist().inv_cdf(0.5 + found.level / 2.0)

    def shown(transformed: np.ndarray) -> np.ndarray:
        return factor * (np.exp(transformed) if u.log else transformed)

    def ends(of: NormalDist, width: float) -> np.ndarray:
        return np.clip([of.mean - width * of.stdev, of.mean + width * of.stdev], low, high)

    part, whole = ends(after, _DRAWN_SDS), ends(prior, 3.0)
    true = None if relative else truth.get(u.name)
    if true is not None:
        at, margin = u.transformed(true), 0.3 * _DRAWN_SDS * after.stdev
        part = np.array([min(part[0], at - margin), max(part[1], at + margin)])
    if np.ptp(whole) <= _WHOLE * np.ptp(part):
        part = np.array([min(part[0], whole[0]), max(part[1], whole[1])])
    part = np.clip(part, low, high)
    top = max(of.pdf(float(np.clip(of.mean, *part))) for of in (prior, after))
    left, right = shown(part).tolist()
    across = Axis(low=left, high=right, log=u.log, label=title)
    plot = Plot(x=across, y=Axis(low=0.0, high=1.08 * top, marked=False), height=190.0)
    for of, kind, between in ((prior, "prior", part), (after, "posterior", ends(after, sds))):
        first, last = np.clip(between, *part)
        at = np.linspace(first, last, 241)
        plot.area(shown(at), [of.pdf(x) for x in at], kind)
        at = np.linspace(part[0], part[1], 241)
        plot.line(shown(at), [of.pdf(x) for x in at], kind, kind)
    plot.entries.append(("posterior", f"{level_text(found)} interval", "area"))
    if true is not None:
        at = factor * true
        plot.line([at, at], [0.0, 1.08 * top], "truth", "true value", "dashed")
    times = prior.stdev / after.stdev
    note = f"{times:.{0 if times >= 9.5 else 1}f} times as narrow as the prior."
    if times < 1.25:
        note = "As wide as the prior: the lift says next to nothing about it."
    return plot.figure(title, note)


# ---- the search ----------------------------------------------------------------------------------


def search(found: Estimate) -> str:
    """HTML: how well both lifts match, how the search went, and what was held."""
    record: dict[str, Any] = found.record
    facts = [(name, length_text(record[key])) for key, name in _DISTANCES.items()]
    facts += [(name, str(record[name])) for name in ("method", "device", "seed")]
    facts.append(("iterations, all starts", str(record["iterations"])))
    facts.append(("time [s]", f"{record['seconds']:.4g}"))
    held = dict(record["object"])
    kind, mass = held.pop("kind"), held.pop("mass")
    if kind == "rope":
        held.pop("thickness")  # a rope's is a share of its diameter
    known = [f"{n} {length_text(v)}" for n, v in held.items() if v is not None]
    known += [] if mass is None else [f"mass {mass:.4g} kg"]
    return facts_list([*facts, ("object", ", ".join([kind, *known]))])
