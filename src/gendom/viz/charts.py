"""Charts as SVG inside a page: their colours, fonts and dark mode are those of its style sheet.

What is drawn names a class of `page.css` ("recorded", "prior", "truth"), which has the colour.
"""

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from gendom.viz.palette import nice_step

_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 10.0, 8.0, 40.0
_WIDTH, _HEIGHT = 420.0, 250.0
_MARKED = 5


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

    def share(self, values: npt.ArrayLike) -> np.ndarray:
        """Where values lie, 0 at the low end and 1 at the high one."""
        array = np.asarray(values, dtype=float)
        if self.log:
            return np.log(array / self.low) / math.log(self.high / self.low)
        return (array - self.low) / (self.high - self.low)

    def ticks(self) -> list[float]:
        """Values that are marked: about `_MARKED`."""
        if not self.log or self.high / self.low < 3.0:
            step = nice_step((self.high - self.low) / _MARKED)
            ends = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
            return [k * step for k in range(ends[0], ends[1] + 1)]
        decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        every = max(1, math.ceil(math.log10(self.high / self.low) / _MARKED))
        within = [
            (k, k * 10.0**d)
            for d in decades if d % every == 0
            for k in (1, 2, 5) if self.low <= k * 10.0**d <= self.high
        ]  # fmt: skip
        fine = len(within) <= _MARKED + 1
        return [value for k, value in within if k == 1 or fine]


@dataclass(kw_only=True)
class Plot:
    """Lines, areas and marks between two axes, collected one after another."""

    x: Axis
    y: Axis
    height: float = _HEIGHT
    entries: list[tuple[str, str, str]] = field(default_factory=list)
    """The legend: class, label, and its mark's shape."""
    _drawn: list[str] = field(default_factory=list)

    def line(
        self, x: npt.ArrayLike, y: npt.ArrayLike, kind: str, label: str = "", shape: str = "line"
    ) -> None:
        """A line through points; `shape` is "line" or "dashed"."""
        self._drawn.append(f'<path class="{kind} {shape}" d="{self._through(x, y)}"/>')
        if label:
            self.entries.append((kind, label, shape))

    def area(self, x: npt.ArrayLike, y: npt.ArrayLike, kind: str) -> None:
        """What lies between a line and the lower end."""
        (first, _), *_, (last, _) = self._places(x, y)
        base = self._bottom
        path = f"{self._through(x, y)}L{last:.1f} {base:.1f}L{first:.1f} {base:.1f}Z"
        self._drawn.append(f'<path class="{kind} area" d="{path}"/>')

    def figure(self, title: str, note: str = "") -> str:
        """HTML: the chart under a heading, with its legend and a note; plain text."""
        parts = [f'<figcaption class="title">{html.escape(title)}</figcaption>']
        if self.entries:
            items = "".join(
                f'<li><i class="{kind} key {shape}"></i>{html.escape(label)}</li>'
                for kind, label, shape in self.entries
            )
            parts.append(f'<ul class="legend">{items}</ul>')
        parts.append(self._svg(title))
        if note:
            parts.append(f'<p class="note">{html.escape(note)}</p>')
        return f'<figure class="chart">{"".join(parts)}</figure>'

    def _svg(self, description: str) -> str:
        left, right, top, bottom = self._left, _WIDTH - _RIGHT, _TOP, self._bottom
        parts = [
            f'<svg class="plot" viewBox="0 0 {_WIDTH:.0f} {self.height:.0f}" role="img" '
            f'aria-label="{html.escape(description)}">'
        ]
        for value, text in _written(self.x.ticks()):
            at = left + (right - left) * float(self.x.share(value))
            # a label at the very end would be cut off
            anchor = "end" if at > _WIDTH - 14 else "start" if at < 14 else "middle"
            parts.append(
                f'<path class="grid" d="M{at:.1f} {top:.1f}V{bottom:.1f}"/>'
                f'<text x="{at:.1f}" y="{bottom + 15:.1f}" text-anchor="{anchor}">{text}</text>'
            )
        for value, text in _written(self.y.ticks()) if self.y.marked else ():
            at = bottom - (bottom - top) * float(self.y.share(value))
            parts.append(
                f'<path class="grid" d="M{left:.1f} {at:.1f}H{right:.1f}"/>'
                f'<text x="{left - 6:.1f}" y="{at + 4:.1f}" text-anchor="end">{text}</text>'
            )
        # the view box of an inner svg cuts off what lies outside the axes
        w, h = right - left, bottom - top
        parts.append(
            f'<text class="label" x="{(left + right) / 2:.1f}" y="{bottom + 33:.1f}" '
            f'text-anchor="middle">{html.escape(self.x.label)}</text>'
            f'<path class="frame" d="M{left:.1f} {bottom:.1f}H{right:.1f}"/>'
            f'<svg x="{left:.1f}" y="{top:.1f}" width="{w:.1f}" height="{h:.1f}" '
            f'viewBox="{left:.1f} {top:.1f} {w:.1f} {h:.1f}">{"".join(self._drawn)}</svg></svg>'
        )
        return "\n".join(parts)

    @property
    def _left(self) -> float:
        return _LEFT if self.y.marked else _RIGHT

    @property
    def _bottom(self) -> float:
        return self.height - _BOTTOM

    def _places(self, x: npt.ArrayLike, y: npt.ArrayLike) -> list[tuple[float, float]]:
        """Where points are in the picture."""
        px = self._left + (_WIDTH - _RIGHT - self._left) * self.x.share(x)
        py = self._bottom - (self._bottom - _TOP) * self.y.share(y)
        return list(zip(px.tolist(), py.tolist(), strict=True))

    def _through(self, x: npt.ArrayLike, y: npt.ArrayLike) -> str:
        """A path's data."""
        return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in self._places(x, y))


def _written(values: Sequence[float]) -> list[tuple[float, str]]:
    """Values with their texts; those of equal steps with as many decimals as the step needs."""
    form = "g"
    if len(values) > 1:
        steps = np.diff(values)
        if np.allclose(steps, steps[0]) and 1e-4 < steps[0] < 1e5:
            form = f".{max(0, math.ceil(-math.log10(steps[0]) - 1e-9))}f"
    return [(v, f"{v:{form}}".replace("-", "\N{MINUS SIGN}")) for v in values]
