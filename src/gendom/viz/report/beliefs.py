"""The section with the densities of every unknown before and after the lift."""

from __future__ import annotations

import math
from collections.abc import Mapping
from statistics import NormalDist
from typing import Any

from gendom.viz.charts import Belief, belief_chart
from gendom.viz.report.markup import cell, chart_figure, escaped, folded, number, table
from gendom.viz.report.page import Section
from gendom.viz.report.quantities import pascal_unit, with_minus
from gendom.viz.report.summary import EstimateSummary

# Name in a posterior -> key of its truth, and what people call it. Others are of the recording.
_MATERIAL = {
    "E_over_rho": ("E", "Young's modulus"),
    "nu": ("nu", "Poisson's ratio"),
    "damping": ("damping", "Damping"),
    "friction": ("friction", "Friction on the table"),
    "stiffness_slope": ("stiffness_slope", "d ln E / d(s / L)"),
    "thickness": ("", "Thickness over the stated one"),
}

_RECORDING = {
    "delay": "Delay of the clouds",
    "grip_height": "Grip height, correction",
    "grip_along": "Grip along the object, correction",
    "grip_aside": "Grip beside the diagonal, correction",
    "grip_tilt": "Tilt of the held corner",
    "grip_reach": "Reach of the grip, correction",
    "yaw": "Turn of the lying cloth, correction",
}

_SHOWN_UNITS = {"m": (1e3, "mm"), "s": (1e3, "ms"), "rad": (180.0 / math.pi, "°"), "1": (1.0, "")}


def beliefs_section(summary: EstimateSummary) -> Section | None:
    """Densities of the material's unknowns, then those of grip and clock; of usable estimates."""
    posterior = summary.values.get("posterior")
    if not posterior or summary.level is None:
        return None
    material, recording = [], []
    for k, name in enumerate(posterior["names"]):
        (material if name in _MATERIAL else recording).append(_chart(summary, posterior, k))
    parts = [
        '<p class="soft">Grey: what was assumed before the lift (prior). Blue: what is known after '
        "it (posterior). Areas are probabilities; a scale with unequal steps is logarithmic.</p>",
        f'<div class="pair">{"".join(material)}</div>',
    ]
    if recording:
        parts.append(
            folded(
                "Grip and clock of the recording", f'<div class="pair">{"".join(recording)}</div>'
            )
        )
    parts.append(folded("The same in numbers", _numbers_table(summary, posterior)))
    return Section(title="Prior and posterior", body="\n".join(parts))


def _chart(summary: EstimateSummary, posterior: Mapping[str, Any], k: int) -> str:
    name = str(posterior["names"][k])
    title: str = _RECORDING.get(name, name.replace("_", " ")) + _of_which(posterior, k)
    key, title = _MATERIAL.get(name, ("", title))
    unit = summary.units.get(name, "")
    factor, unit = _SHOWN_UNITS.get(unit, (1.0, unit))
    true = summary.true(key)
    density = summary.value("density")
    if name == "E_over_rho" and density is not None:
        scale, unit = pascal_unit(summary.values["E"])
        factor, true = scale * density, None if true is None else scale * true
    elif name == "E_over_rho":
        title, true = "Specific modulus E / ρ", summary.true(name)
    elif true is not None:
        true *= factor
    ends = _interval(summary, posterior, k)
    belief = Belief(
        log=bool(posterior["log"][k]),
        prior=NormalDist(posterior["prior_mean"][k], posterior["prior_sd"][k]),
        posterior=NormalDist(posterior["mean"][k], math.sqrt(posterior["covariance"][k][k])),
        low=posterior["low"][k],
        high=posterior["high"][k],
        interval=(factor * ends[0], factor * ends[1]),
        level_text=summary.level_text,
        truth=true,
        factor=factor,
    )
    main, strip = belief_chart(belief, f"{title} [{unit}]" if unit else title)
    times = belief.narrowed
    if times < 1.25:
        note = "As wide as the prior: the lift says next to nothing about it."
    else:
        shown = f"{times:.0f}" if times >= 9.5 else f"{times:.1f}"
        note = f"{shown} times as narrow as the prior."
    return chart_figure(title, [main] if strip is None else [main, strip], note)


def _of_which(posterior: Mapping[str, Any], k: int) -> str:
    """Which recording an unknown is of, where there are several."""
    owners = posterior.get("recordings") or [None]
    several, owner = (
        any(other not in (None, 0) for other in owners),
        owners[min(k, len(owners) - 1)],
    )
    return f", recording {owner + 1}" if several and owner is not None else ""


def _interval(
    summary: EstimateSummary, posterior: Mapping[str, Any], k: int, stage: str = ""
) -> tuple[float, float]:
    """Ends in the unknown's unit, cut at what was searched; stage "prior_" for those before."""
    assert summary.level is not None
    z = NormalDist().inv_cdf(0.5 + summary.level / 2.0)
    sd = posterior["prior_sd"][k] if stage else math.sqrt(posterior["covariance"][k][k])
    mean = posterior[f"{stage}mean"][k]
    low = max(mean - z * sd, posterior["low"][k])
    high = min(mean + z * sd, posterior["high"][k])
    return (math.exp(low), math.exp(high)) if posterior["log"][k] else (low, high)


def _numbers_table(summary: EstimateSummary, posterior: Mapping[str, Any]) -> str:
    rows = []
    for k, name in enumerate(posterior["names"]):
        unit = summary.units.get(name, "")
        label = name.replace("_", " ") + (f" [{unit}]" if unit not in ("", "1") else "")
        label = label.replace("^2", "²") + _of_which(posterior, k)
        cells = [cell(escaped(label), "name")]
        for stage, said in (("prior_", "prior"), ("", "posterior")):
            low, high = _interval(summary, posterior, k, stage)
            cells.append(number(with_minus(f"{low:.3g} to {high:.3g}"), said))
        rows.append(f"<tr>{''.join(cells)}</tr>")
    head = ["<th>Unknown</th>", '<th class="number">Prior</th>']
    head.append('<th class="number">Posterior</th>')
    return table(head, rows) + f'<p class="soft">{escaped(summary.level_text)} intervals.</p>'
