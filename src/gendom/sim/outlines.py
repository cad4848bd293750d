"""Flat outlines of cloths: polygons with holes."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.errors import ParameterError

Array = NDArray[Any]

ROUNDING = 1e-9
"""Share of an outline's size that counts as no distance."""


@dataclass(frozen=True)
class Outline:
    """A flat shape; coordinates are those of the cloth's first and second axis."""

    loops: tuple[Array, ...]
    """Polygons [K, 2] [m]: the outside counter-clockwise, then holes clockwise."""

    @classmethod
    def of(cls, outline: Any) -> "Outline":
        """Check one polygon [K, 2], or the outside and its holes [m].

        Raises:
            ParameterError: If a polygon has fewer than three points, no area, or crosses itself or
                another, or a hole is not inside the outside.
        """
        try:
            given = [outline] if np.ndim(outline[0]) == 1 else list(outline)
            loops = [np.asarray(loop, dtype=float) for loop in given]
        except (TypeError, ValueError, IndexError, KeyError):
            loops = []
        require(
            loops and all(a.ndim == 2 and a.shape[1] == 2 for a in loops),
            "outline must be a polygon [K, 2] [m], or a sequence of them: outside, holes",
        )
        cleaned = []
        for k, loop in enumerate(loops):
            finite = np.isfinite(loop).all()
            require(finite, "holds numbers that are not finite", where=_name(k))
            loop = loop[np.any(loop != np.roll(loop, 1, axis=0), axis=1)]
            different = f"has {len(loop)} different points"
            require(len(loop) >= 3, different, where=_name(k), fix="give at least three")
            area, size = integrals(loop)[0], float(np.ptp(loop, axis=0).max())
            require(abs(area) > ROUNDING * size**2, "has no area", where=_name(k))
            cleaned.append(loop if (area > 0.0) == (k == 0) else loop[::-1])
        made = cls(tuple(cleaned))
        made._check_crossings()
        made._check_holes()
        return made

    @property
    def box(self) -> tuple[Array, Array]:
        """Least and largest coordinates, [2] each [m]."""
        return self.loops[0].min(axis=0), self.loops[0].max(axis=0)

    @property
    def area(self) -> float:
        """[m^2]."""
        return float(self._totals()[0])

    @property
    def centre(self) -> Array:
        """Centre of area, [2] [m]."""
        area, x, y, _ = self._totals()
        return self.box[0] + np.array([x, y]) / area

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Whether points [N, 2] are inside of the outside and outside of the holes, [N].

        Source: even-odd rule (Haines 1994, "Point in polygon strategies").
        """
        a, b, _ = self._edges()
        inside = np.zeros(len(points), dtype=bool)
        for some in np.array_split(np.arange(len(points)), 1 + len(points) * len(a) // 10**6):
            x, y = points[some, :1], points[some, 1:]
            spans = (a[:, 1] > y) != (b[:, 1] > y)
            rise = np.where(b[:, 1] == a[:, 1], 1.0, b[:, 1] - a[:, 1])
            left = x < a[:, 0] + (y - a[:, 1]) / rise * (b[:, 0] - a[:, 0])
            inside[some] = np.count_nonzero(spans & left, axis=1) % 2 == 1
        return inside

    def nearest(self, points: Array) -> Array:
        """Nearest places [N, 2] on the outline to points [N, 2] [m]."""
        a, b, _ = self._edges()
        step, found = b - a, np.empty((len(points), 2))
        for k, x in enumerate(points):
            share = np.clip(np.sum((x - a) * step, axis=1) / np.sum(step**2, axis=1), 0.0, 1.0)
            foot = a + share[:, None] * step
            found[k] = foot[np.sum((x - foot) ** 2, axis=1).argmin()]
        return found

    def sampled(self, spacing: float) -> tuple[Array, NDArray[np.int64], Array, Array]:
        """Places along the outline at most ``spacing`` apart.

        Returns:
            Places [N, 2], the loop of each, how far along it each is, and how long that is [m].
        """
        places, of, along, whole = [], [], [], []
        for k, loop in enumerate(self.loops):
            step = np.roll(loop, -1, axis=0) - loop
            length = np.linalg.norm(step, axis=1)
            begins = np.cumsum(length) - length
            for a, d, l, s in zip(loop, step, length, begins, strict=True):
                share = np.arange(max(1, int(np.ceil(l / spacing))))
                share = share / len(share)
                places.append(a + share[:, None] * d)
                along.append(s + share * l)
                of.append(np.full(len(share), k))
                whole.append(np.full(len(share), length.sum()))
        return (
            np.concatenate(places), np.concatenate(of), np.concatenate(along),
            np.concatenate(whole),
        )  # fmt: skip

    # ---- checks ----------------------------------------------------------------------------------

    def _totals(self) -> Array:
        """``integrals`` from the corner of the box on."""
        return np.sum([integrals(loop - self.box[0]) for loop in self.loops], axis=0)

    def _edges(self) -> tuple[Array, Array, NDArray[np.int64]]:
        """First and second ends of all edges [S, 2], and their loops [S]."""
        first = np.concatenate(self.loops)
        second = np.concatenate([np.roll(loop, -1, axis=0) for loop in self.loops])
        of = np.repeat(np.arange(len(self.loops)), [len(loop) for loop in self.loops])
        return first, second, of

    def _check_crossings(self) -> None:
        a, b, of = self._edges()
        size = float(np.ptp(a, axis=0).max())
        at = np.arange(len(a))
        after = np.concatenate(
            [np.roll(np.flatnonzero(of == k), -1) for k in range(len(self.loops))]
        )
        pairs: list[tuple[int, int]] = []

        def side(p: Array, q: Array, x: Array) -> Array:
            value = cross(q - p, x - p)
            return np.where(np.abs(value) <= ROUNDING**2 * size**2, 0.0, np.sign(value))

        lower, upper = np.minimum(a, b), np.maximum(a, b)
        for some in np.array_split(at, 1 + len(at) ** 2 // 10**6):
            i = some[:, None]
            p, q = a[i], b[i]
            meet = side(p, q, a) * side(p, q, b) <= 0.0
            meet &= side(a, b, p) * side(a, b, q) <= 0.0
            meet &= np.all((lower[i] <= upper) & (lower <= upper[i]), axis=2)
            meet &= (i < at) & (after[i] != at) & (i != after)
            pairs += [(int(some[k]), int(j)) for k, j in np.argwhere(meet)[:1]]
        for i, j in pairs[:1]:
            own = of[i] == of[j]
            raise ParameterError(
                "crosses or touches " + ("itself" if own else _name(int(of[j]))),
                where=f"{_name(int(of[i]))}, near ({a[i, 0]:.4g}, {a[i, 1]:.4g}) m",
                fix="give polygons whose edges meet at their common points only",
            )

    def _check_holes(self) -> None:
        for k, hole in enumerate(self.loops[1:], start=1):
            inside = Outline(self.loops[:1]).contains(hole[:1])[0]
            require(inside, "is not inside of the outline", where=_name(k))
            for other in range(1, len(self.loops)):
                inside = other != k and Outline((self.loops[other],)).contains(hole[:1])[0]
                require(not inside, f"is inside of {_name(other)}", where=_name(k))


def integrals(loop: Array) -> Array:
    """Integrals of 1, x, y and x y over a polygon [K, 2], negative of a clockwise one.

    Source: Green's theorem (Steger 1996, "On the calculation of arbitrary moments of polygons").
    """
    x, y = loop.T
    x2, y2 = np.roll(x, -1), np.roll(y, -1)
    w = x * y2 - x2 * y
    both = 2.0 * x * y + x * y2 + x2 * y + 2.0 * x2 * y2
    return np.array([w.sum() / 2, w @ (x + x2) / 6, w @ (y + y2) / 6, w @ both / 24])


def cross(a: Array, b: Array) -> Array:
    """Third component of the cross products of vectors [..., 2]."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _name(k: int) -> str:
    return "outline" if k == 0 else f"hole {k}"
