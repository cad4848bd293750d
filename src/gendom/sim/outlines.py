"""Flat outlines of cloths: polygons with holes, and the part of a lattice that they cut out."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import ParameterError

ROUNDING = 1e-9
"""Share of an outline's size that counts as no distance."""

LEAST_SHARE = 0.05
"""Share of its area below which a cell is left out, and its area given to a neighbour. The stable
step of a membrane is the same with any share, for mass and stiffness have it alike. That of
bending is shorter: light points take part in the bending of their neighbours. Of 60 outlines drawn
at random it was at most 2.2 times as short, with 2 % 3.4 times, with 0.5 % 6.6 times."""

NARROWEST = 1.0
"""Least width of a cloth's parts [spacings]: strips bend as they should within 4 % then, at any
angle to the lattice."""

CLOSEST = 3.0
"""Least distance between parts side by side [spacings]: nearer ones may share points."""

LEAST_WAY_AROUND = 4.0
"""Way along the outline between two places that are too near, over the least distance, from which
they lie on two sides of a part or a gap. Else they are at a corner of more than 29 degrees, or a
small hole or notch."""


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
        (x, y), inside = points.T, np.zeros(len(points), dtype=bool)
        for a, b in zip(*self._edges()[:2], strict=True):
            if a[1] != b[1]:
                left = x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
                inside ^= ((a[1] > y) != (b[1] > y)) & left
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
        a, b, of = self._edges()
        length = np.linalg.norm(b - a, axis=1)
        whole = np.bincount(of, length)
        begins = np.cumsum(length) - length - (np.cumsum(whole) - whole)[of]
        count = np.maximum(1, np.ceil(length / spacing)).astype(int)
        e = np.repeat(np.arange(len(a)), count)
        share = (np.arange(len(e)) - (np.cumsum(count) - count)[e]) / count[e]
        return (
            a[e] + share[:, None] * (b - a)[e],
            of[e],
            begins[e] + share * length[e],
            whole[of[e]],
        )

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
        size, lower, upper = float(np.ptp(a, axis=0).max()), np.minimum(a, b), np.maximum(a, b)
        after = np.concatenate([np.roll(np.flatnonzero(of == k), -1) for k in np.unique(of)])

        def side(p: Array, q: Array, x: Array) -> Array:
            value = cross(q - p, x - p)
            return np.where(np.abs(value) <= ROUNDING**2 * size**2, 0.0, np.sign(value))

        for i, (p, q) in enumerate(zip(a, b, strict=True)):
            meet = side(p, q, a) * side(p, q, b) <= 0.0
            meet &= side(a, b, p) * side(a, b, q) <= 0.0
            meet &= np.all((lower[i] <= upper) & (lower <= upper[i]), axis=1)
            meet &= (i < np.arange(len(a))) & (after[i] != np.arange(len(a))) & (i != after)
            if meet.any():
                j = int(meet.argmax())
                other = "itself" if of[i] == of[j] else _name(int(of[j]))
                raise ParameterError(
                    f"crosses or touches {other}",
                    where=f"{_name(int(of[i]))}, near ({p[0]:.4g}, {p[1]:.4g}) m",
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


# ---- the part of a lattice -----------------------------------------------------------------------


class Cut:
    """Cells and points of a lattice along an outline's box that lie within it, or reach into it.

    Args:
        outline: What is left of the lattice.
        points: Its numbers of points along the first and second axis.

    Raises:
        ParameterError: If parts of the outline are too narrow for the lattice, or too close.
    """

    def __init__(self, outline: Outline, points: tuple[int, int]):
        lower, upper = outline.box
        spacing = (upper - lower) / (np.array(points) - 1.0)
        _check_resolved(outline, spacing, upper - lower)
        self.outline = outline
        self.spacing = (float(spacing[0]), float(spacing[1]))
        """Distance between points along both axes [m]."""
        self.corners = _corner_shares(outline, lower, spacing, points)
        """[2, 2, rows - 1, columns - 1] what of each cell's area within the outline is represented
        by its corners: integrals of bilinear shape functions, the corner's row and column first."""
        self.cells = _merged(self.corners)
        """[rows - 1, columns - 1] share of each cell's area; 0: there is no cell."""
        from scipy.ndimage import label  # which takes long to import

        _, parts = label(self.cells > 0.0)  # pyright: ignore[reportGeneralTypeIssues]
        require(parts == 1, "the outline falls apart on this lattice", fix="more points")
        has, quarters = np.zeros(points[::-1], dtype=bool), np.zeros(points[::-1])
        for j, i in np.ndindex(2, 2):
            part = (slice(j, points[1] - 1 + j), slice(i, points[0] - 1 + i))
            has[part] |= self.cells > 0.0
            quarters[part] += 0.25 * self.cells
        self.at = np.flatnonzero(has)
        """[n] index of each point in the whole lattice, row by row."""
        place = lower + spacing * np.stack(np.unravel_index(self.at, has.shape)[::-1], axis=1)
        self.area = _balanced(quarters.flat[self.at] * spacing.prod(), place, outline)
        """[n] area represented by each point [m^2]; it has the area and its centre exactly."""
        self.skin = _skin(self, place, lower, spacing)
        """[n, n] sparse matrix from points to the places of cloth nearest to them."""

    def on_skin(self, x: Array) -> Array:
        """Places of cloth [..., n, 3] nearest to its points x [..., n, 3] [m]: points beyond the
        outline are moved onto it."""
        first = np.moveaxis(x, -2, 0)
        found = self.skin @ first.reshape(len(first), -1)
        return np.moveaxis(found.reshape(first.shape), 0, -2)

    @property
    def number(self) -> NDArray[np.int64]:
        """[rows, columns] of each point of the lattice among those that exist; -1: it does not."""
        found = np.full(np.array(self.cells.shape) + 1, -1)
        found.flat[self.at] = np.arange(len(self.at))
        return found

    @property
    def triangles(self) -> NDArray[np.int64]:
        """[F, 3] triangles of the skin, counter-clockwise seen from the third axis: two for
        each cell, less those that an outline leaves nothing of."""
        j, i = np.nonzero(self.cells)
        number = self.number
        a, b, c, d = (number[j + k, i + l] for k in (0, 1) for l in (0, 1))
        found = np.concatenate([np.stack([a, b, c], axis=1), np.stack([d, c, b], axis=1)])
        rows, columns = np.nonzero(number >= 0)
        first, second, third = np.moveaxis((self.skin @ np.stack([columns, rows], 1))[found], 1, 0)
        return found[cross(second - first, third - first) > 1e-3]


def _corner_shares(
    outline: Outline, lower: Array, spacing: Array, points: tuple[int, int]
) -> Array:
    """``Cut.corners`` of all cells that the outline reaches into."""
    shares = np.zeros((2, 2, points[1] - 1, points[0] - 1))
    for loop in outline.loops:
        rest = (loop - lower) / spacing
        for j in range(points[1] - 1):
            row, rest = _clip(rest, 1, j + 1.0)
            for i in range(points[0] - 1):
                if not len(row):
                    break
                cell, row = _clip(row, 0, i + 1.0)
                if len(cell):
                    one, x, y, xy = integrals(cell - (i, j))
                    shares[:, :, j, i] += [[one - x - y + xy, x - xy], [y - xy, xy]]
    full = np.abs(shares.sum(axis=(0, 1)) - 1.0) < 1e-12
    shares[:, :, full] = 0.25  # as of a rectangle
    return shares


def _clip(loop: Array, axis: int, bound: float) -> tuple[Array, Array]:
    """Parts [., 2] of a polygon [K, 2] with coordinates up to and from ``bound`` on along an axis.

    Source: Sutherland and Hodgman (1974), "Reentrant polygon clipping". Edges of parts that it
    joins along the bound cancel in integrals.
    """
    beyond = loop[:, axis] > bound
    if not beyond.any() or beyond.all():
        none = np.empty((0, 2))
        return (none, loop) if beyond.any() else (loop, none)
    after = np.roll(loop, -1, axis=0)
    crosses = beyond != np.roll(beyond, -1)
    step = np.where(crosses, after[:, axis] - loop[:, axis], 1.0)
    meets = loop + ((bound - loop[:, axis]) / step)[:, None] * (after - loop)
    meets[:, axis] = bound
    both = np.stack([loop, meets], axis=1)
    return both[np.stack([~beyond, crosses], axis=1)], both[np.stack([beyond, crosses], axis=1)]


def _merged(corners: Array) -> Array:
    """``Cut.cells``, of which those with too small a share go to a neighbour, in place."""
    cells = corners.sum(axis=(0, 1))
    kept = cells >= LEAST_SHARE
    found = np.where(kept, cells, 0.0)
    for j, i in np.argwhere(~kept & (cells > 0.0)):
        near = [
            (abs(a) + abs(b) == 1, cells[j + b, i + a], j + b, i + a)
            for b in (-1, 0, 1)
            for a in (-1, 0, 1)
            if 0 <= j + b < len(cells) and 0 <= i + a < cells.shape[1] and kept[j + b, i + a]
        ]
        if near:
            *_, b, a = max(near)
            found[b, a] += cells[j, i]
    corners *= np.where(kept, found / np.where(kept, cells, 1.0), 0.0)
    return found


def _balanced(area: Array, place: Array, outline: Outline) -> Array:
    """Areas [n] of points at places [n, 2], times 1 + a + b . x, so that the outline's area and its
    centre are exact. a and b are small: a cut cell's area counts at the middle of the cell."""
    out = place - outline.centre
    basis = np.column_stack([np.ones(len(out)), out / np.abs(out).max()])
    wanted = np.array([outline.area, 0.0, 0.0])
    for _ in range(2):  # once more for what rounding leaves
        by = (basis.T * area) @ basis
        area = area * (1.0 + basis @ np.linalg.solve(by, wanted - basis.T @ area))
    return area


def _skin(of: Cut, place: Array, lower: Array, spacing: Array) -> Any:
    """``Cut.skin``: points within the outline, and for others the nearest place on the outline, by
    the bilinear shape functions of one of their cells."""
    n, columns = len(place), of.cells.shape[1] + 1
    number = of.number
    inside = of.outline.contains(place)
    rows, which = [np.flatnonzero(inside)], [np.flatnonzero(inside)]
    weights = [np.ones(len(rows[0]))]
    foot = (of.outline.nearest(place[~inside]) - lower) / spacing
    for p, x in zip(np.flatnonzero(~inside), foot, strict=True):
        j, i = divmod(int(of.at[p]), columns)
        near = [
            (float(np.abs(x - (a + 0.5, b + 0.5)).max()), b, a)
            for b in (j - 1, j)
            for a in (i - 1, i)
            if 0 <= b < len(of.cells) and 0 <= a < columns - 1 and of.cells[b, a] > 0.0
        ]
        _, b, a = min(near)
        u, v = x - (a, b)
        rows.append(np.full(4, p))
        which.append(number[[b, b, b + 1, b + 1], [a, a + 1, a, a + 1]])
        weights.append(np.array([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v]))
    entries = np.concatenate(weights), (np.concatenate(rows), np.concatenate(which))
    return scipy.sparse.coo_matrix(entries, shape=(n, n))


def _check_resolved(outline: Outline, spacing: Array, size: Array) -> None:
    """Check that parts of the outline, and gaps between them, are wide enough for the lattice."""
    widest = float(spacing.max())
    reach = CLOSEST * widest
    places, of, along, whole = outline.sampled(reach / 8.0)
    i, j = scipy.spatial.KDTree(places).query_pairs(reach, output_type="ndarray").T
    way = np.abs(along[i] - along[j])
    way = np.where(of[i] == of[j], np.minimum(way, whole[i] - way), np.inf)
    across = way > LEAST_WAY_AROUND * NARROWEST * widest
    i, j, way = i[across], j[across], way[across]
    distance = np.linalg.norm(places[i] - places[j], axis=1)
    shares = np.linspace(0.1, 0.9, 5)[:, None, None]
    between = places[i] + shares * (places[j] - places[i])
    cloth = outline.contains(between.reshape(-1, 2)).reshape(len(shares), -1)
    part, gap = cloth.all(axis=0), ~cloth.any(axis=0)
    for inside, least, what in (
        (True, NARROWEST, "a part of the cloth is only {} wide"),
        (False, CLOSEST, "parts of the cloth are only {} apart"),
    ):
        d = np.where(part if inside else gap, distance, np.inf)
        d = np.where(way > LEAST_WAY_AROUND * least * widest, d, np.inf)
        k = int(d.argmin()) if len(d) else 0
        if len(d) and d[k] < (1.0 - 1e-9) * least * widest:
            finer = 1 + np.ceil(least * size / d[k] - 1e-9).astype(int)
            raise ParameterError(
                what.format(f"{1e3 * d[k]:.3g} mm")
                + f", and points are {1e3 * widest:.3g} mm apart",
                where=f"outline, near ({between[2, k, 0]:.4g}, {between[2, k, 1]:.4g}) m",
                fix=f"give it {least:g} spacings: points=({finer[0]}, {finer[1]})",
            )
