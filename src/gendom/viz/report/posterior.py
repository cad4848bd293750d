"""The section of every unknown's density before and after the lift."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
import numpy.typing as npt

from gendom.materials.unknowns import UNKNOWNS
from gendom.viz.charts import Axis, Entry, Plot
from gendom.viz.report.markup import Section, cell, chart_figure, escaped, folded, number, table
from gendom.viz.report.summary import SHOWN_UNITS, EstimateSummary, with_minus

# What people call some unknowns here; others go by the registry.
_TITLES = {
    "E_over_rho": "Specific modulus E / ρ",
    "friction": "Friction on the table",
    "stiffness_slope": "d ln E / d(s / L)",
    "thickness": "Thickness over the stated one",
    "delay": "Delay of the clouds",
    "grip_height": "Grip height, correction",
    "grip_along": "Grip along the object, correction",
    "grip_aside": "Grip beside the diagonal, correction",
    "grip_tilt": "Tilt of the held corner",
    "grip_reach": "Reach of the grip, correction",
    "yaw": "Turn of the lying cloth, correction",
}

_DRAWN_SDS = 4.2
_ZOOM = 5.0  # a posterior narrower than its prior by more than this has a strip of the whole prior


@dataclass(frozen=True, kw_only=True)
class Marginal:
    """One unknown's Gaussian before and after, in its transformed value, within what was searched.

    Densities of parameters on a logarithmic scale are those of the logarithm, so that areas are
    probabilities in either case.
    """

    log: bool
    prior: NormalDist
    posterior: NormalDist
    low: float
    high: float
    level: float
    """Probability of intervals."""

    @classmethod
    def of(cls, posterior: Mapping[str, Any], k: int, level: float) -> Marginal:
        """Of unknown k in the posterior of an estimate's file."""
        return cls(
            log=bool(posterior["log"][k]),
            prior=NormalDist(posterior["prior_mean"][k], posterior["prior_sd"][k]),
            posterior=NormalDist(posterior["mean"][k], math.sqrt(posterior["covariance"][k][k])),
            low=posterior["low"][k],
            high=posterior["high"][k],
            level=level,
        )

    def value(self, transformed: npt.ArrayLike) -> np.ndarray:
        """In the unknown's unit."""
        array = np.asarray(transformed, dtype=float)
        return np.exp(array) if self.log else array

    def ends(self, of: NormalDist) -> np.ndarray:
        """[2] transformed ends of the prior's or the posterior's interval."""
        half = NormalDist().inv_cdf(0.5 + self.level / 2.0) * of.stdev
        return np.clip([of.mean - half, of.mean + half], self.low, self.high)

    @property
    def narrowed(self) -> float:
        """By how much the posterior is narrower."""
        return self.prior.stdev / self.posterior.stdev


def beliefs_section(summary: EstimateSummary) -> Section | None:
    """Densities of the material's unknowns, then those of grip and clock; of usable estimates."""
    posterior = summary.values.get("posterior")
    if not posterior or summary.level is None:
        return None
    material, recording, rows = [], [], []
    for k, name in enumerate(posterior["names"]):
        own = name in UNKNOWNS and UNKNOWNS[name].material
        marginal, of_which = Marginal.of(posterior, k, summary.level), _of_which(posterior, k)
        (material if own else recording).append(_figure(summary, marginal, name, of_which))
        rows.append(_row(marginal, name, of_which))
    parts = [
        '<p class="soft">Grey: what was assumed before the lift (prior). Blue: what is known after '
        "it (posterior). Areas are probabilities; a scale with unequal steps is logarithmic.</p>",
        f'<div class="pair">{"".join(material)}</div>',
    ]
    if recording:
        pair = f'<div class="pair">{"".join(recording)}</div>'
        parts.append(folded("Grip and clock of the recording", pair))
    head = ["<th>Unknown</th>", '<th class="number">Prior</th>']
    head.append('<th class="number">Posterior</th>')
    numbers = table(head, rows) + f'<p class="soft">{escaped(summary.level_text)} intervals.</p>'
    parts.append(folded("The same in numbers", numbers))
    return Section(title="Prior and posterior", body="\n".join(parts))


def _figure(summary: EstimateSummary, marginal: Marginal, name: str, of_which: str) -> str:
    title = _TITLES.get(name, _name_of(name).capitalize()) + of_which
    factor, unit = SHOWN_UNITS.get(_unit_of(name), (1.0, _unit_of(name)))
    true = summary.true("" if name == "thickness" else name)
    plots = _charts(marginal, factor, true, f"{title} [{unit}]" if unit else title)
    times = marginal.narrowed
    if times < 1.25:
        note = "As wide as the prior: the lift says next to nothing about it."
    else:
        shown = f"{times:.0f}" if times >= 9.5 else f"{times:.1f}"
        note = f"{shown} times as narrow as the prior."
    plots[0].entries.append(Entry("posterior", f"{summary.level_text} interval", "area"))
    if true is not None:
        plots[0].upright(factor * true, "truth", "true value")
    return chart_figure(title, plots, note)


def _charts(marginal: Marginal, factor: float, true: float | None, label: str) -> list[Plot]:
    """Both densities, and a strip of the whole prior where they show a part of it.

    Args:
        marginal: The unknown.
        factor: From its unit to the chart's.
        true: Its true value, where that is known.
        label: Of the axis.
    """
    prior, posterior = marginal.prior, marginal.posterior
    reach = _DRAWN_SDS * posterior.stdev
    low, high = posterior.mean - reach, posterior.mean + reach
    if true is not None and (true > 0.0 or not marginal.log):
        at = math.log(true) if marginal.log else true
        low, high = min(low, at - 0.3 * reach), max(high, at + 0.3 * reach)
    whole = np.clip(
        [prior.mean - 3.0 * prior.stdev, prior.mean + 3.0 * prior.stdev],
        marginal.low,
        marginal.high,
    )
    zoomed = (whole[1] - whole[0]) > _ZOOM * (high - low)
    if not zoomed:
        low, high = min(low, whole[0]), max(high, whole[1])
    part = np.clip([low, high], marginal.low, marginal.high)

    def plot(ends: np.ndarray, top: float, height: float, label: str) -> Plot:
        left, right = (factor * marginal.value(ends)).tolist()
        x = Axis(low=left, high=right, log=marginal.log, label=label)
        y = Axis(low=0.0, high=1.08 * top, marked=False)
        return Plot(x=x, y=y, height=height, compact=True)

    def density(of: NormalDist, ends: np.ndarray) -> tuple[np.ndarray, list[float]]:
        at = np.linspace(ends[0], ends[1], 241)
        return factor * marginal.value(at), [of.pdf(x) for x in at]

    top = max(of.pdf(float(np.clip(of.mean, *part))) for of in (prior, posterior))
    main = plot(part, top, 190.0, label)
    main.area(*density(prior, part), "prior")
    main.line(*density(prior, part), "prior", "prior")
    main.area(*density(posterior, np.clip(marginal.ends(posterior), *part)), "posterior")
    main.line(*density(posterior, part), "posterior", "posterior")
    if not zoomed:
        return [main]
    top = prior.pdf(float(np.clip(prior.mean, *whole)))
    strip = plot(whole, top, 86.0, "the whole prior")
    strip.area(*density(prior, whole), "prior")
    strip.line(*density(prior, whole), "prior")
    window = factor * marginal.value(part)
    strip.area(window, [top, top], "window", "the part drawn above")
    for end in window:
        strip.upright(float(end), "window", dashed=False)
    return [main, strip]


def _name_of(name: str) -> str:
    """What people call an unknown."""
    return UNKNOWNS[name].title if name in UNKNOWNS else name.replace("_", " ")


def _unit_of(name: str) -> str:
    return UNKNOWNS[name].unit if name in UNKNOWNS else ""


def _of_which(posterior: Mapping[str, Any], k: int) -> str:
    """Which recording an unknown is of, where there are several."""
    owners = posterior.get("recordings") or [None]
    several, owner = (
        any(other not in (None, 0) for other in owners),
        owners[min(k, len(owners) - 1)],
    )
    return f", recording {owner + 1}" if several and owner is not None else ""


def _row(marginal: Marginal, name: str, of_which: str) -> str:
    """Both intervals in numbers."""
    unit = _unit_of(name)
    label = _name_of(name) + (f" [{unit}]" if unit not in ("", "1") else "")
    cells = [cell(escaped(label.replace("^2", "²") + of_which), "name")]
    for of, said in ((marginal.prior, "prior"), (marginal.posterior, "posterior")):
        low, high = marginal.value(marginal.ends(of)).tolist()
        cells.append(number(with_minus(f"{low:.3g} to {high:.3g}"), said))
    return f"<tr>{''.join(cells)}</tr>"
