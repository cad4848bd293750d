"""Charts of a report: the search, prior and posterior, and the action."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from gendom.viz.plot import Axis, Entry, Plot

_SERIES = 6  # colours of `report.css` for the starts of a search
_DRAWN_SDS = 4.2
_ZOOM = 5.0  # a posterior narrower than its prior by more than this has a strip of the whole prior


@dataclass(frozen=True, kw_only=True)
class SearchLine:
    """One stage of one start of a search."""

    start: int
    label: str
    iterations: np.ndarray
    """[k]."""
    values: np.ndarray
    """[k] in the chart's unit."""
    early: bool = False
    """Whether it is not the search's last stage; drawn dashed."""


@dataclass(frozen=True, kw_only=True)
class Belief:
    """A Gaussian before and after, of a parameter or of its logarithm, within bounds."""

    log: bool
    prior: NormalDist
    """Transformed, like all that follows but the truth and the interval."""
    posterior: NormalDist
    low: float
    high: float
    interval: tuple[float, float]
    """In the chart's unit."""
    level_text: str
    """Its probability: "90 %"."""
    truth: float | None = None
    """In the chart's unit."""
    factor: float = 1.0
    """From the parameter's unit to the chart's."""

    def shown(self, transformed: npt.ArrayLike) -> np.ndarray:
        """In the chart's unit."""
        array = np.asarray(transformed, dtype=float)
        return self.factor * (np.exp(array) if self.log else array)

    @property
    def narrowed(self) -> float:
        """By how much the posterior is narrower."""
        return self.prior.stdev / self.posterior.stdev


@dataclass(frozen=True, kw_only=True)
class Swing:
    """One policy's rope in the picture of a swing."""

    label: str
    kind: str
    """A class of `report.css`."""
    dashed: bool = False
    tip_path: np.ndarray
    """[T, 2] of the tip: along the goal's direction, and up [m]."""
    shapes: Sequence[np.ndarray] = ()
    """The rope at release and at its farthest, each [n, 2] [m]."""


def search_chart(
    lines: Sequence[SearchLine], *, log: bool = False, truth: float | None = None
) -> Plot:
    """A distance or a parameter against iteration, a line for each stage of each start."""
    every = np.concatenate([line.values for line in lines])
    last = max(float(line.iterations.max()) for line in lines)
    ends = every if truth is None else np.append(every, truth)
    plot = Plot(
        x=Axis(low=0.5, high=max(last, 2.0) + 0.5, label="iteration"),
        y=Axis.around(ends, log=log),
    )
    for line in lines:
        kind = f"start-{line.start % _SERIES + 1}"
        plot.line(line.iterations, line.values, kind, line.label, dashed=line.early, dots=True)
    if truth is not None:
        plot.level(truth, "truth", "true value")
    return plot


def distance_chart(times: npt.ArrayLike, distance: npt.ArrayLike, *, scene: str = "") -> Plot:
    """A distance [T] [m] against time [T] [s], in millimetres.

    Args:
        times: Increasing.
        distance: Of the clouds.
        scene: Id of the viewer's data whose time is marked, or none.
    """
    millimetres = 1e3 * np.asarray(distance, dtype=float)
    seconds = np.asarray(times, dtype=float)
    mean = float(millimetres.mean())
    plot = Plot(
        x=Axis(low=float(seconds[0]), high=float(max(seconds[-1], seconds[0] + 1e-3)),
               label="time [s]"),
        y=Axis(low=0.0, high=1.15 * max(float(millimetres.max()), 1e-6)),
    )  # fmt: skip
    plot.area(seconds, millimetres, "recorded")
    plot.line(seconds, millimetres, "recorded")
    plot.level(mean, "soft", f"mean {mean:.1f} mm")
    if scene:
        plot.cursor(scene)
    return plot


def belief_chart(belief: Belief, label: str) -> tuple[Plot, Plot | None]:
    """Densities before and after, and a strip of the whole prior where the first shows a part.

    Densities of parameters on a logarithmic scale are those of the logarithm, so that areas are
    probabilities in either case.
    """
    reach = _DRAWN_SDS * belief.posterior.stdev
    low, high = belief.posterior.mean - reach, belief.posterior.mean + reach
    if belief.truth is not None and (belief.truth > 0.0 or not belief.log):
        true = belief.truth / belief.factor
        true = math.log(true) if belief.log else true
        low, high = min(low, true - 0.3 * reach), max(high, true + 0.3 * reach)
    prior_reach = 3.0 * belief.prior.stdev
    whole = (
        max(belief.low, belief.prior.mean - prior_reach),
        min(belief.high, belief.prior.mean + prior_reach),
    )
    zoomed = (whole[1] - whole[0]) > _ZOOM * (high - low)
    if zoomed:
        low, high = max(low, belief.low), min(high, belief.high)
    else:
        low, high = max(min(low, whole[0]), belief.low), min(max(high, whole[1]), belief.high)
    main = _densities(belief, low, high, label)
    if not zoomed:
        return main, None
    strip = Plot(
        x=_belief_axis(belief, *whole, label="the whole prior"), y=_upwards(1.0), height=86.0,
        compact=True,
    )  # fmt: skip
    at = np.linspace(*whole, 201)
    prior = np.array([belief.prior.pdf(x) for x in at])
    strip.area(belief.shown(at), prior / prior.max(), "prior")
    strip.line(belief.shown(at), prior / prior.max(), "prior")
    window = belief.shown([low, high])
    strip.area(window, [1.0, 1.0], "window", "the part drawn above")
    for end in window:
        strip.upright(float(end), "window", dashed=False)
    return main, strip


def goal_chart(goals: np.ndarray, ours: np.ndarray, without: np.ndarray | None) -> Plot:
    """Goals [K, D] against what was reached [K, D] [m].

    With D = 1 reached against goal and the line on which they are equal; with D = 2 the plane of
    the goals, each joined with the places reached. A row of `without` may be NaN.
    """
    groups = [(ours, "ours", "with the estimate")]
    if without is not None:
        groups.append((without, "without", "without parameters"))
    one = goals.shape[1] == 1
    every = np.concatenate([goals, *(g[0] for g in groups)])
    if one:
        ends = Axis.around(every, margin=0.08)
        plot = Plot.to_scale(
            Axis(low=ends.low, high=ends.high, label="goal [m]"),
            Axis(low=ends.low, high=ends.high),
        )
        diagonal = [plot.x.low, plot.x.high]
        plot.line(diagonal, diagonal, "soft", "reached = goal", dashed=True)
    else:
        plot = Plot.to_scale(
            Axis.around(every[:, 0], margin=0.1, label="along [m]"),
            Axis.around(every[:, 1], margin=0.1),
        )
        for k, goal in enumerate(goals):
            plot.cross(goal[0], goal[1], "ink", "" if k else "goal")
    for reached, kind, label in groups:
        if not one:
            for goal, place in zip(goals, reached, strict=True):
                plot.line([goal[0], place[0]], [goal[1], place[1]], kind)
        across = goals[:, 0] if one else reached[:, 0]
        plot.dots(across, reached[:, -1], kind, label, square=kind == "without")
    return plot


def swing_chart(
    swings: Sequence[Swing], goal: np.ndarray, *, table_height: float | None = None
) -> Plot:
    """Paths of the tip, the rope at release and at its farthest, and the goal.

    Args:
        swings: One for each policy.
        goal: [1] distance along the horizontal axis, drawn as a line, or [2] a place [m].
        table_height: z of the table [m], or None.
    """
    points = np.concatenate([p for s in swings for p in (s.tip_path, *s.shapes)])
    across = np.append(points[:, 0], goal[0])
    up = points[:, 1] if len(goal) == 1 else np.append(points[:, 1], goal[1])
    if table_height is not None:
        up = np.append(up, table_height)
    plot = Plot.to_scale(
        Axis.around(across, margin=0.04, label="distance along the goal's direction [m]"),
        Axis.around(up, margin=0.04),
    )
    if table_height is not None:
        plot.level(table_height, "soft", "table", dashed=False)
    for swing in swings:
        for k, shape in enumerate(swing.shapes):
            plot.dots(shape[:, 0], shape[:, 1], swing.kind, size=5.0, faint=k == 0)
        path = swing.tip_path
        plot.line(path[:, 0], path[:, 1], swing.kind, f"tip, {swing.label}", dashed=swing.dashed)
    for swing in swings:
        first, farthest = swing.tip_path[0], swing.tip_path[np.argmax(swing.tip_path[:, 0])]
        plot.dots([first[0]], [first[1]], swing.kind, size=9.0)
        plot.dots([farthest[0]], [farthest[1]], swing.kind, size=9.0, square=True)
    if len(goal) == 1:
        plot.upright(goal[0], "ink", "goal")
    else:
        plot.cross(goal[0], goal[1], "ink", "goal")
    return plot


def _densities(belief: Belief, low: float, high: float, label: str) -> Plot:
    """Both densities over one range of transformed values."""
    at = np.linspace(low, high, 241)
    prior = np.array([belief.prior.pdf(x) for x in at])
    posterior = np.array([belief.posterior.pdf(x) for x in at])
    plot = Plot(
        x=_belief_axis(belief, low, high, label=label),
        y=_upwards(float(max(prior.max(), posterior.max()))),
        height=190.0,
        compact=True,
    )
    plot.area(belief.shown(at), prior, "prior")
    plot.line(belief.shown(at), prior, "prior", "prior")
    ends = np.clip(belief.interval, *belief.shown([low, high]))
    inside = np.linspace(ends[0], ends[1], 121)
    transformed = np.log(inside / belief.factor) if belief.log else inside / belief.factor
    density = np.array([belief.posterior.pdf(x) for x in transformed])
    plot.area(inside, density, "posterior")
    plot.line(belief.shown(at), posterior, "posterior", "posterior")
    plot.entries.append(Entry("posterior", f"{belief.level_text} interval", "area"))
    if belief.truth is not None:
        plot.upright(belief.truth, "truth", "true value")
    return plot


def _belief_axis(belief: Belief, low: float, high: float, *, label: str) -> Axis:
    ends = belief.shown([low, high])
    return Axis(low=float(ends[0]), high=float(ends[1]), log=belief.log, label=label)


def _upwards(highest: float) -> Axis:
    return Axis(low=0.0, high=1.08 * highest, marked=False)
