"""Charts as SVG inside a page: their colours, fonts and dark mode are those of its style sheet.

What is drawn names a class of `report.css` ("recorded", "prior", "start-1"), which has the colour.
"""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from gendom.viz.palette import nice_step

_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 10.0, 8.0, 40.0
_WIDTH, _HEIGHT = 420.0, 250.0


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One axis of a chart."""

    low: float
    high: float
    label: str = ""
    """Plain text, with the unit."""
    log: bool = False
    marked: bool = True
    """Whether it has numbers and lines of a grid."""

    @classmethod
    def around(
        cls, values: npt.ArrayLike, *, margin: float = 0.06, log: bool = False, label: str = ""
    ) -> Axis:
        """From the lowest to the highest finite value, with a margin on both sides."""
        array = np.asarray(values, dtype=float).ravel()
        array = array[np.isfinite(array) & ((array > 0.0) | (not log))]
        ends = np.array([array.min(), array.max()])
        if log:
            ends = np.log(ends)
        middle, half = ends.mean(), 0.5 * float(ends[1] - ends[0])
        half = (1.0 + 2.0 * margin) * max(half, 1e-3 if log else 1e-3 * abs(middle), 1e-9)
        low, high = middle - half, middle + half
        if log:
            low, high = math.exp(low), math.exp(high)
        return cls(low=float(low), high=float(high), log=log, label=label)

    def share(self, values: npt.ArrayLike) -> np.ndarray:
        """Where values lie, 0 at the low end and 1 at the high one."""
        array = np.asarray(values, dtype=float)
        if not self.log:
            return (array - self.low) / (self.high - self.low)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log(array / self.low) / math.log(self.high / self.low)

    def ticks(self, most: int = 6) -> list[float]:
        """Values that are marked: about `most`."""
        if not self.log or self.high / self.low < 3.0:
            step = nice_step((self.high - self.low) / most)
            ends = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
            return [k * step for k in range(ends[0], ends[1] + 1)]
        decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        every = max(1, math.ceil(math.log10(self.high / self.low) / most))
        found: list[float] = []
        for steps in ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)):
            marks = [s * 10.0**d for d in decades if d % every == 0 for s in steps]
            marks = [m for m in marks if self.low * 0.999 <= m <= self.high * 1.001]
            if len(marks) <= most or not found:
                found = marks
        return found


@dataclass(frozen=True)
class Entry:
    """One line of a legend."""

    kind: str
    label: str
    shape: str
    """ "line", "dashed", "dot", "area" or "cross"."""


@dataclass(kw_only=True)
class Plot:
    """Lines, areas and marks between two axes, collected one after another."""

    x: Axis
    y: Axis
    height: float = _HEIGHT
    compact: bool = False
    """A strip: no numbers upwards, and little room below."""
    entries: list[Entry] = field(default_factory=list)
    """The legend."""
    _drawn: list[str] = field(default_factory=list)

    @classmethod
    def to_scale(cls, x: Axis, y: Axis) -> Plot:
        """A plot whose axes have one scale; the shorter one is made longer."""
        inner = _WIDTH - _LEFT - _RIGHT
        tall = (y.high - y.low) / (x.high - x.low)
        height = min(max(tall, 0.55), 0.95) * inner
        scale = max((x.high - x.low) / inner, (y.high - y.low) / height)
        wide = [
            Axis(
                low=0.5 * (a.low + a.high - scale * pixels),
                high=0.5 * (a.low + a.high + scale * pixels),
                label=a.label,
            )
            for a, pixels in ((x, inner), (y, height))
        ]
        return cls(x=wide[0], y=wide[1], height=height + _TOP + _BOTTOM)

    def line(
        self,
        x: npt.ArrayLike,
        y: npt.ArrayLike,
        kind: str,
        label: str = "",
        *,
        dashed: bool = False,
        dots: bool = False,
    ) -> None:
        """A line through points, and perhaps dots on them; what is not finite breaks it."""
        px, py = self._places(x, y)
        shape = "dashed" if dashed else "line"
        self._drawn.append(f'<path class="{kind} {shape}" d="{_through(px, py)}"/>')
        if dots:
            self.dots(x, y, kind, size=4.5)
        self._name(kind, label, shape)

    def dots(
        self,
        x: npt.ArrayLike,
        y: npt.ArrayLike,
        kind: str,
        label: str = "",
        *,
        size: float = 7.0,
        faint: bool = False,
        square: bool = False,
    ) -> None:
        """Round dots, or squares, at points; sizes in units of the chart's width of 420."""
        px, py = self._places(x, y)
        places = "".join(
            f"M{a:.1f} {b:.1f}h0" for a, b in zip(px, py, strict=True) if np.isfinite(a + b)
        )
        more = ("faint " if faint else "") + ("square " if square else "")
        self._drawn.append(
            f'<path class="{kind} dots {more}" stroke-width="{size:g}" d="{places}"/>'
        )
        self._name(kind, label, "square" if square else "dot")

    def area(self, x: npt.ArrayLike, y: npt.ArrayLike, kind: str, label: str = "") -> None:
        """What lies between a line and the lower end."""
        px, py = self._places(x, y)
        base = self._bottom
        path = f"{_through(px, py)}L{px[-1]:.1f} {base:.1f}L{px[0]:.1f} {base:.1f}Z"
        self._drawn.append(f'<path class="{kind} area" d="{path}"/>')
        self._name(kind, label, "area")

    def upright(self, x: float, kind: str, label: str = "", *, dashed: bool = True) -> None:
        """A line from top to bottom."""
        self.line([x, x], [self.y.low, self.y.high], kind, label, dashed=dashed)

    def level(self, y: float, kind: str, label: str) -> None:
        """A dashed line from left to right."""
        self.line([self.x.low, self.x.high], [y, y], kind, label, dashed=True)

    def cross(self, x: float, y: float, kind: str, label: str = "") -> None:
        """An upright cross."""
        (px,), (py,) = self._places([x], [y])
        self._drawn.append(
            f'<path class="{kind} cross" d="M{px - 7:.1f} {py:.1f}h14M{px:.1f} {py - 7:.1f}v14"/>'
        )
        self._name(kind, label, "cross")

    def cursor(self, scene: str) -> None:
        """A line at the time that the viewer with this scene shows, moved by its script."""
        self._drawn.append(
            f'<line class="cursor" data-scene="{html.escape(scene)}" data-low="{self.x.low:.6g}" '
            f'data-high="{self.x.high:.6g}" data-left="{self._left:.1f}" '
            f'data-right="{self._right:.1f}" x1="0" x2="0" y1="{_TOP:.1f}" '
            f'y2="{self._bottom:.1f}" visibility="hidden"/>'
        )

    def svg(self, description: str) -> str:
        """An `svg` element; the description is for those who do not see it."""
        left, right, top, bottom = self._left, self._right, _TOP, self._bottom
        parts = [
            f'<svg class="plot" viewBox="0 0 {_WIDTH:.0f} {self.height:.0f}" role="img" '
            f'aria-label="{html.escape(description)}">'
        ]
        if self.x.marked:
            parts += self._x_marks(left, right, top, bottom)
        if self.y.marked and not self.compact:
            for value, text in _written(self.y.ticks(5)):
                at = bottom - (bottom - top) * float(self.y.share(value))
                parts.append(
                    f'<path class="grid" d="M{left:.1f} {at:.1f}H{right:.1f}"/>'
                    f'<text x="{left - 6:.1f}" y="{at + 4:.1f}" text-anchor="end">{text}</text>'
                )
        parts.append(f'<path class="frame" d="M{left:.1f} {bottom:.1f}H{right:.1f}"/>')
        # the view box of an inner svg cuts off what lies outside the axes
        w, h = right - left, bottom - top
        parts.append(
            f'<svg x="{left:.1f}" y="{top:.1f}" width="{w:.1f}" height="{h:.1f}" '
            f'viewBox="{left:.1f} {top:.1f} {w:.1f} {h:.1f}">{"".join(self._drawn)}</svg></svg>'
        )
        return "\n".join(parts)

    def _x_marks(self, left: float, right: float, top: float, bottom: float) -> list[str]:
        parts = []
        for value, text in _written(self.x.ticks(5 if self.x.log else 6)):
            at = left + (right - left) * float(self.x.share(value))
            # a label at the very end would be cut off
            anchor = "end" if at > _WIDTH - 14 else "start" if at < 14 else "middle"
            parts.append(
                f'<path class="grid" d="M{at:.1f} {top:.1f}V{bottom:.1f}"/>'
                f'<text x="{at:.1f}" y="{bottom + 15:.1f}" text-anchor="{anchor}">{text}</text>'
            )
        if self.x.label:
            parts.append(
                f'<text class="label" x="{(left + right) / 2:.1f}" y="{bottom + 33:.1f}" '
                f'text-anchor="middle">{html.escape(self.x.label)}</text>'
            )
        return parts

    @property
    def _left(self) -> float:
        return 10.0 if self.compact or not self.y.marked else _LEFT

    @property
    def _right(self) -> float:
        return _WIDTH - _RIGHT

    @property
    def _bottom(self) -> float:
        return self.height - (_BOTTOM if self.x.label else 22.0)

    def _places(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        px = self._left + (self._right - self._left) * self.x.share(x)
        py = self._bottom - (self._bottom - _TOP) * self.y.share(y)
        return px, py

    def _name(self, kind: str, label: str, shape: str) -> None:
        if label:
            self.entries.append(Entry(kind, label, shape))


def legend(entries: Sequence[Entry]) -> str:
    """What the marks of a chart mean, as a list that wraps."""
    if not entries:
        return ""
    items = "".join(
        f'<li><i class="{e.kind} key {e.shape}"></i>{html.escape(e.label)}</li>' for e in entries
    )
    return f'<ul class="legend">{items}</ul>'


def _through(px: np.ndarray, py: np.ndarray) -> str:
    """A path's data; places that are not finite break it."""
    path, pen_up = [], True
    for a, b in zip(px, py, strict=True):
        if not np.isfinite(a + b):
            pen_up = True
            continue
        path.append(f"{'M' if pen_up else 'L'}{a:.1f} {b:.1f}")
        pen_up = False
    return "".join(path)


def _written(values: Sequence[float]) -> list[tuple[float, str]]:
    """Values with their texts; those of equal steps with as many decimals as the step needs."""
    form = "g"
    if len(values) > 1:
        steps = np.diff(values)
        if np.allclose(steps, steps[0]) and 1e-4 < steps[0] < 1e5:
            form = f".{max(0, math.ceil(-math.log10(steps[0]) - 1e-9))}f"
    return [(v, f"{v:{form}}".replace("-", "\N{MINUS SIGN}")) for v in values]
