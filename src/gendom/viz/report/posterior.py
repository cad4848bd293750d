"""The section of every unknown's density before and after the lift."""

from __future__ import annotations

import math
from collections.abc import Mapping
from statistics import NormalDist
from typing import Any

import numpy as np

from gendom.materials.unknowns import UNKNOWNS
from gendom.viz.charts import Axis, Plot
from gendom.viz.report.markup import Section, escaped, folded, side_by_side, table
from gendom.viz.report.summary import EstimateSummary, title_of, unit_of, with_minus

_DRAWN_SDS = 4.2
_WHOLE = 5.0  # a prior that is wider than the posterior by more than this is drawn in part


def beliefs_section(summary: EstimateSummary) -> Section | None:
    """Densities of the material's unknowns, then those of grip and clock; of usable estimates."""
    posterior = summary.values.get("posterior")
    if not posterior or summary.level is None:
        return None
    figures: dict[bool, list[str]] = {True: [], False: []}
    rows = []
    for k, name in enumerate(posterior["names"]):
        figure, row = _unknown(summary, posterior, k)
        figures[name in UNKNOWNS and UNKNOWNS[name].material].append(figure)
        rows.append(row)
    parts = [
        '<p class="soft">Grey: what was assumed before the lift (prior). Blue: what is known after '
        "it (posterior). Areas are probabilities; a scale with unequal steps is logarithmic.</p>",
        side_by_side(figures[True]),
    ]
    if figures[False]:
        parts.append(folded("Grip and clock of the recording", side_by_side(figures[False])))
    numbers = table({"Unknown": "name", "Prior": "number", "Posterior": "number"}, rows)
    numbers += f'<p class="soft">{escaped(summary.level_text)} intervals.</p>'
    parts.append(folded("The same in numbers", numbers))
    return Section(title="Prior and posterior", body="\n".join(parts))


def _unknown(
    summary: EstimateSummary, posterior: Mapping[str, Any], k: int
) -> tuple[str, list[str]]:
    """Both Gaussians of unknown k as a figure, and both intervals as a table's row.

    Densities of parameters on a logarithmic scale are those of the logarithm, so that areas are
    probabilities in either case.
    """
    name, log = posterior["names"][k], bool(posterior["log"][k])
    low, high = posterior["low"][k], posterior["high"][k]
    prior = NormalDist(posterior["prior_mean"][k], posterior["prior_sd"][k])
    after = NormalDist(posterior["mean"][k], math.sqrt(posterior["covariance"][k][k]))
    factor, unit = (1.0, "of the stated one") if name == "thickness" else unit_of(name)
    title = title_of(name) + _of_which(posterior, k) + (f" [{unit}]" if unit else "")
    sds = NormalDist().inv_cdf(0.5 + (summary.level or 0.0) / 2.0)

    def shown(transformed: np.ndarray) -> np.ndarray:
        return factor * (np.exp(transformed) if log else transformed)

    def ends(of: NormalDist, width: float) -> np.ndarray:
        return np.clip([of.mean - width * of.stdev, of.mean + width * of.stdev], low, high)

    part, whole = ends(after, _DRAWN_SDS), ends(prior, 3.0)
    true = summary.true("" if name == "thickness" else name)
    if true is not None and (true > 0.0 or not log):
        at, margin = math.log(true) if log else true, 0.3 * _DRAWN_SDS * after.stdev
        part = np.array([min(part[0], at - margin), max(part[1], at + margin)])
    if np.ptp(whole) <= _WHOLE * np.ptp(part):
        part = np.array([min(part[0], whole[0]), max(part[1], whole[1])])
    part = np.clip(part, low, high)
    top = max(of.pdf(float(np.clip(of.mean, *part))) for of in (prior, after))
    left, right = shown(part).tolist()
    plot = Plot(
        x=Axis(low=left, high=right, log=log, label=title),
        y=Axis(low=0.0, high=1.08 * top, marked=False),
        height=190.0,
    )
    for of, kind, between in ((prior, "prior", part), (after, "posterior", ends(after, sds))):
        first, last = np.clip(between, *part)
        at = np.linspace(first, last, 241)
        plot.area(shown(at), [of.pdf(x) for x in at], kind)
        at = np.linspace(part[0], part[1], 241)
        plot.line(shown(at), [of.pdf(x) for x in at], kind, kind)
    plot.entries.append(("posterior", f"{summary.level_text} interval", "area"))
    if true is not None:
        plot.upright(factor * true, "truth", "true value")
    times = prior.stdev / after.stdev
    note = f"{times:.{0 if times >= 9.5 else 1}f} times as narrow as the prior."
    if times < 1.25:
        note = "As wide as the prior: the lift says next to nothing about it."
    texts = [" to ".join(f"{x:.3g}" for x in shown(ends(of, sds))) for of in (prior, after)]
    return plot.figure(title, note), [title, *map(with_minus, texts)]


def _of_which(posterior: Mapping[str, Any], k: int) -> str:
    """Which recording an unknown is of, where there are several."""
    owners = posterior.get("recordings") or [None]
    owner = owners[min(k, len(owners) - 1)]
    several = any(other not in (None, 0) for other in owners)
    return f", recording {owner + 1}" if several and owner is not None else ""
