"""Charts of a report, as SVG images: how the estimate was found, and what the action did."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

# From Okabe and Ito's palette; the clouds' blue and orange mean something else.
OURS_COLOR = "#009E73"
WITHOUT_COLOR = "#D55E00"
_BEST_COLOR = "#0072B2"
_INK = "#222222"
_SOFT_INK = "#6e6e6e"
_OTHERS_COLOR = "#b8b8b8"

STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.size": 10.0,
    "text.color": _INK,
    "axes.labelcolor": _INK,
    "axes.edgecolor": "#bbbbbb",
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "grid.color": "#eaeaea",
    "grid.linewidth": 0.8,
    "xtick.color": _SOFT_INK,
    "ytick.color": _SOFT_INK,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "svg.fonttype": "path",  # the reader's machine may have other fonts
    "svg.hashsalt": "gendom",  # otherwise random names inside the file
}
"""Matplotlib's settings of every chart."""


@dataclass(frozen=True, kw_only=True)
class Swing:
    """One policy's rope in the picture of a swing."""

    label: str
    color: str
    dashed: bool = False
    tip_path: np.ndarray
    """[T, 2] of the tip: along the goal's direction, and up [m]."""
    shapes: Sequence[np.ndarray] = ()
    """The rope at release and at its farthest, each [n, 2] [m]."""


@matplotlib.rc_context(STYLE)
def search_chart(history: Sequence[tuple[np.ndarray, np.ndarray]], best: int | None) -> bytes:
    """Distance of the clouds from the fit against iteration, one line for each start.

    Args:
        history: For each start its iterations [k] and distances [k] [m]; what is not positive is
            left out, as the scale is logarithmic.
        best: Index of the start that was chosen, or None.

    Returns:
        SVG.
    """
    figure, axes = _start(4.8, 2.9)
    _draw_starts(axes, [(iterations, 1e3 * values) for iterations, values in history], best)
    positive = [np.asarray(values) > 0.0 for _, values in history]
    if any(p.any() for p in positive):
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set(xlabel="iteration", title="Distance of the clouds from the fit [mm]")
    return to_svg(figure)


@matplotlib.rc_context(STYLE)
def parameter_chart(
    history: Sequence[tuple[np.ndarray, np.ndarray]],
    best: int | None,
    *,
    name: str,
    truth: float | None,
) -> bytes:
    """A parameter against iteration, one line for each start, and its true value if known.

    Arguments and result as `search_chart`, values in any unit.
    """
    figure, axes = _start(4.8, 2.9)
    _draw_starts(axes, history, best)
    if truth is not None:
        axes.axhline(truth, color=_INK, linestyle=(0, (4, 3)), linewidth=1.0, label="true value")
        axes.legend(loc="best")
    axes.set(xlabel="iteration", title=name)
    return to_svg(figure)


@matplotlib.rc_context(STYLE)
def distance_chart(times: npt.ArrayLike, distance: npt.ArrayLike, *, name: str) -> bytes:
    """A distance [T] [m] against time [T] [s], as SVG."""
    millimetres = 1e3 * np.asarray(distance, dtype=float)
    figure, axes = _start(4.8, 2.9)
    axes.plot(times, millimetres, color=_BEST_COLOR, linewidth=1.6)
    mean = float(millimetres.mean())
    dashes = (0, (4, 3))
    label = f"mean {mean:.1f} mm"
    axes.axhline(mean, color=_SOFT_INK, linestyle=dashes, linewidth=1.0, label=label)
    axes.legend(loc="best")
    axes.set(xlabel="time [s]", title=f"{name} [mm]")
    axes.set_ylim(0.0, 1.15 * max(float(millimetres.max()), 1e-6))
    return to_svg(figure)


@matplotlib.rc_context(STYLE)
def goal_chart(goals: np.ndarray, ours: np.ndarray, without: np.ndarray | None) -> bytes:
    """Goals [K, D] against what was reached [K, D] [m], as SVG.

    With D = 1 reached against goal and the line on which they are equal; with D = 2 the plane of
    the goals, each joined with the places reached. A row of `without` may be NaN.
    """
    figure, axes = _start(5.2, 4.6)
    groups = [(ours, OURS_COLOR, "o", "with the estimate")]
    if without is not None:
        groups.append((without, WITHOUT_COLOR, "s", "without parameters"))
    if goals.shape[1] == 1:
        every = np.concatenate([goals, *(g[0] for g in groups)])
        low, high = np.nanmin(every), np.nanmax(every)
        margin = 0.06 * max(high - low, 0.02)
        ends = [low - margin, high + margin]
        axes.plot(ends, ends, color=_SOFT_INK, linewidth=1.0, linestyle=(0, (4, 3)))
        for reached, color, marker, label in groups:
            axes.plot(
                goals[:, 0],
                reached[:, 0],
                linestyle="none",
                marker=marker,
                markersize=6.0,
                color=color,
                markeredgecolor="white",
                markeredgewidth=0.6,
                label=label,
            )
        axes.set(xlim=ends, ylim=ends, xlabel="goal [m]", title="Reached [m]; on the line: hit")
    else:
        for reached, color, marker, label in groups:
            for goal, place in zip(goals, reached, strict=True):
                axes.plot(*np.stack([goal, place], axis=1), color=color, linewidth=0.8, alpha=0.6)
            axes.plot(
                *reached.T,
                linestyle="none",
                marker=marker,
                markersize=6.0,
                color=color,
                label=label,
            )
        axes.plot(
            *goals.T,
            linestyle="none",
            marker="+",
            markersize=11.0,
            markeredgewidth=1.8,
            color=_INK,
            label="goal",
        )
        axes.set(xlabel="along [m]", title="Goals and places reached: height [m]")
    axes.locator_params(nbins=6)
    axes.set_aspect("equal", adjustable="box" if goals.shape[1] == 1 else "datalim")
    axes.legend(loc="best")
    return to_svg(figure)


@matplotlib.rc_context(STYLE)
def swing_chart(
    swings: Sequence[Swing], goal: np.ndarray, *, table_height: float | None = None
) -> bytes:
    """Paths of the tip, the rope at release and at its farthest, and the goal, as SVG.

    Args:
        swings: One for each policy.
        goal: [1] distance along the horizontal axis, drawn as a line, or [2] a place [m].
        table_height: z of the table [m], or None.
    """
    figure, axes = _start(5.2, 4.6)
    for swing in swings:
        for shape, opacity in zip(swing.shapes, (0.25, 0.6), strict=False):
            axes.plot(
                *shape.T,
                linestyle="none",
                marker="o",
                markersize=3.2,
                markeredgewidth=0.0,
                color=swing.color,
                alpha=opacity,
            )
        axes.plot(
            *swing.tip_path.T,
            color=swing.color,
            linewidth=1.8,
            linestyle=(0, (5, 2)) if swing.dashed else "-",
            label=f"tip, {swing.label}",
        )
        for index, marker in ((0, "o"), (int(np.argmax(swing.tip_path[:, 0])), "D")):
            axes.plot(
                *swing.tip_path[index],
                marker=marker,
                markersize=6.5,
                color=swing.color,
                markeredgecolor="white",
                markeredgewidth=0.8,
            )
    if len(goal) == 1:
        axes.axvline(goal[0], color=_INK, linewidth=1.4, linestyle=(0, (2, 2)), label="goal")
    else:
        axes.plot(*goal, marker="+", markersize=14.0, markeredgewidth=2.0, color=_INK, label="goal")
    if table_height is not None:
        axes.axhline(table_height, color="#969696", linewidth=1.4, label="table")
    axes.locator_params(nbins=7)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="distance along the goal's direction [m]", ylabel="height [m]")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return to_svg(figure)


def to_svg(figure: Figure) -> bytes:
    """A chart as SVG, the same bytes each time it is drawn."""
    buffer = io.BytesIO()
    # Date and program version would make the same chart another file each time.
    FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def _draw_starts(
    axes: Axes, history: Sequence[tuple[np.ndarray, np.ndarray]], best: int | None
) -> None:
    """The chosen start in colour and on top, the others in grey."""
    drawn_other = False
    for start, (iterations, values) in enumerate(history):
        chosen = start == best or len(history) == 1
        label = None
        if len(history) > 1:
            if chosen:
                label = "chosen start"
            elif not drawn_other:
                label, drawn_other = "other starts", True
        axes.plot(
            iterations,
            values,
            color=_BEST_COLOR if chosen else _OTHERS_COLOR,
            linewidth=2.0 if chosen else 1.2,
            marker="o",
            markersize=3.5 if chosen else 2.5,
            zorder=3 if chosen else 2,
            label=label,
        )
    if len(history) > 1:
        axes.legend(loc="best")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _start(width: float, height: float) -> tuple[Figure, Axes]:
    """An empty chart of a size in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.add_subplot()
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes
