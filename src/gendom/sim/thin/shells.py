"""Cloths as shells: what the engine, ``ThinEngine``, knows of them."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.arrays import Array
from gendom.materials.parameters import WEAVE
from gendom.sim.outlines import Cut
from gendom.sim.setting import DRAG, Setting, spread
from gendom.sim.thin.contact import check_cloth, triangle_distance
from gendom.sim.thin.types import MARGIN, Coefficients, Lines, V, X, along, parameters_of

SHORTEST = 0.125
"""Smallest length represented by a joint at a gripper's border, over its usual length: no added
inertia compensates for the stiffness."""

MOST_COUPLED = 1.5
"""Largest area that couples both curvatures of a point, over the geometric mean of the areas that
they have alone. The energy is positive for nu down to -1 / 1.5."""


class ShellModel:
    """The elements of W shells of one shape; rows of numbers are those of ``native/shell.h``.

    What is not said here is as of ``RodModel``.

    Raises:
        ParameterError: If the body is no shell, or its points are too near for self-contact.
    """

    kind: ClassVar = "shell"
    directed: ClassVar = False
    state_rows, state_bars, scratch_rows, scratch_bars = 14, 14, 21, 33
    threads_on_cuda: ClassVar = 256
    undamped_cfl: ClassVar = 0.4
    """Nonlinear vibrations gain energy in longer steps, see ``benchmarks/swing.py``."""
    woven: ClassVar[tuple[str, ...]] = WEAVE
    border_rows: ClassVar = [2, 3]
    per_turn = np.zeros(())

    def __init__(self, setting: Setting):
        body, materials = setting.body, setting.materials
        (ny, nx), h, part = body.shape, body.thickness, body.cut
        self.materials, self.thickness, self.cut = materials, h, part
        self.parameters = setting.parameters
        self.shape: tuple[int, int] = (ny, nx)
        """Number of rows, and of points in a row, of the whole lattice."""
        cell, area = np.zeros((ny, nx)), np.zeros((ny, nx))
        if part is None:
            at = np.arange(ny * nx)
            grid = body.points.reshape(ny, nx, 3)
            lx, ly = (float(np.linalg.norm(of - grid[0, 0])) for of in (grid[0, 1], grid[1, 0]))
            cell[:-1, :-1] = 1.0
            area[...] = 0.25 * lx * ly * _to_corners(cell[:-1, :-1])
        else:
            at, (lx, ly), cell[:-1, :-1] = part.at, part.spacing, part.cells
            area.flat[at] = part.area
        self.at, self.spacing, self.widest = at, (lx, ly), max(lx, ly)
        """[n] index of each point in the lattice, row by row; distance between points along rows
        and along columns, and the larger one [m]."""
        self._check(setting)
        self.pitch = -(-(nx + 1) // 8) * 8
        slots = MARGIN + self.pitch * (1 + np.arange(ny))[:, None] + np.arange(nx)
        self.slots, self.row_length = slots.reshape(-1)[at], MARGIN + (ny + 2) * self.pitch + MARGIN
        there = (cell > 0.0).astype(float)
        after, below = there.copy(), there.copy()
        after[1:] = np.maximum(after[1:], there[:-1])
        below[:, 1:] = np.maximum(below[:, 1:], there[:, :-1])
        self.exists = np.stack([after, below, there]).reshape(3, -1)[:, at]
        """[3, n] whether a point has an edge to the next one, to the one below, and a cell."""
        inner_x, inner_y = np.zeros((ny, nx)), np.zeros((ny, nx))
        inner_x[:, 1:] = after[:, 1:] * after[:, :-1]
        inner_y[1:] = below[1:] * below[:-1]
        if part is None:
            bent = [area * inner_x, area * inner_y, area * inner_x * inner_y]
            alone = [inner_x * (1.0 - inner_y), inner_y * (1.0 - inner_x)]
        else:
            bent, alone = _bent(part, inner_x, inner_y)
        self.alone = np.stack(alone).reshape(2, -1)[:, at]
        """[2, n] whether transverse curvature is free, along rows and along columns."""
        quarter = 0.25 * lx * ly * cell
        xx, yy, xy = bent[0] / lx**4, bent[1] / ly**4, bent[2] / (lx * ly) ** 2
        bending = [xx, yy, xy, 2.0 * lx * ly * cell / (lx * ly) ** 2]
        shares = np.stack([quarter, quarter, quarter, 16.0 * quarter, *bending])
        self.shares = shares.reshape(8, -1)[:, at]
        """[8, n] geometric factors of the moduli in each stiffness: areas over spacings."""
        self.faster = (1.0, 1.0) if part is None else _faster(part, area, bending)
        """Largest factors on the squared frequencies of membrane and bending by light points at an
        outline."""
        W, n = len(materials), len(at)
        self.area = area.reshape(-1)[at]
        """[n] of points [m^2]."""
        self.heavier = spread(setting.variation.mass, (W, n), "mass")
        self.varies = np.ones((W, 8, 1))
        """[W, 8, 1] whether a stiffness varies with E at each point; a membrane's own does not."""
        self.varies[[m.membrane is not None for m in materials], :4] = 0.0
        share = spread(setting.variation.stiffness, (W, n), "stiffness")[:, None]
        self.local = 1.0 + self.varies * (share - 1.0)
        """[W, 8, n] stiffness over that of the material."""
        own = self.coefficients(parameters_of(h, setting.parameters))
        self.stiffness, self.mass, _, self.drag = own

    def coefficients(self, p: Mapping[str, Array]) -> Coefficients:
        mass = p["density"] * p["thickness"] * self.area * self.heavier
        drag = np.tile(0.5 * DRAG["cloth"] * self.area, (len(mass), 1))
        return Coefficients(self._moduli(p) * self.local, mass, np.zeros(mass.shape), drag)

    def _check(self, setting: Setting) -> None:
        h, (lx, ly), (ny, nx) = self.thickness, self.spacing, self.shape
        least, side = -1.0 / MOST_COUPLED, min((nx - 1) * lx, (ny - 1) * ly)
        auxetic = self.cut is not None and any(m.nu < least for m in self.materials)
        require(not auxetic, f"cloths with an outline have a nu of at least {least:.2f}")
        require(
            h <= side,
            f"a thickness of {h:g} m and a side of {side:g} m are not those of a shell",
            fix="give metres, or engine='mpm'",
        )
        require(
            not setting.self_contact or h <= 0.5 * min(lx, ly),
            f"a cloth {1e3 * h:.3g} mm thick whose points are {1e3 * min(lx, ly):.3g} mm apart "
            "cannot be folded",
            fix="fewer points",
        )

    def arrays(self, setting: Setting, air: Array) -> dict[str, Any]:
        """What the kernels' model has of shells, in air of densities [W]."""
        drag = air[:, None] * self.drag
        one = np.ones_like(drag)
        return {
            "pitch": self.pitch, "first": self.pitch, "end": self.pitch * (self.shape[0] + 1),
            "per_x": 1.0 / self.spacing[0], "per_y": 1.0 / self.spacing[1],
            "rest": self.exists[None], "stiffness": self.stiffness,
            "inertia": np.stack([1.0 / self.mass, drag, one, one], axis=1),
        }  # fmt: skip

    @cached_property
    def lines(self) -> list[Lines]:
        """Rows and columns."""
        number = self.on_lattice(np.arange(len(self.at))[None], fill=-1)[0]
        has = self.on_lattice(self.exists) > 0.0
        (rows, columns), (lx, ly) = number.shape, self.spacing
        return [
            Lines(number, np.full(columns - 1, lx), has[0][:, :-1], SHORTEST),
            Lines(number.T, np.full(rows - 1, ly), has[1].T[:, :-1], SHORTEST),
        ]

    def on_lattice(self, values: Array, fill: float = 0.0) -> Array:
        """Values of points [W, n, ...] on the whole lattice, [W, rows, columns, ...]."""
        (ny, nx), more = self.shape, values.shape[2:]
        whole = np.full((len(values), ny * nx, *more), fill, dtype=values.dtype)
        whole[:, self.at] = values
        return whole.reshape(len(values), ny, nx, *more)

    def share_bar(self, stiffness_bar: Array) -> Array:
        """Derivatives by E at each point over its material's [W, n], given those by ``stiffness``
        [W, 8, n]."""
        modulus = self._moduli(parameters_of(self.thickness, self.parameters))
        return np.sum(stiffness_bar * modulus * self.varies, axis=1)

    def _moduli(self, p: Mapping[str, Array]) -> Array:
        """[W, 8, n] stiffness of points that have their material's: E h (membrane) and E h^3 / 12
        (bending) times what Poisson's ratio, threads and ``shares`` make of them. Plane stress;
        where transverse curvature is free, the modulus is that of a beam."""
        nu, h, one = p["nu"], p["thickness"], np.ones_like(p["nu"])
        plane = 1.0 / (1.0 - nu**2)
        both, shear = nu * plane, 0.5 / (1.0 + nu)
        twist = 2.0 * shear  # D (1 - nu) = E h^3 / 12 / (1 + nu)
        factors = np.stack([plane, plane, both, shear, plane, plane, both, twist], axis=1)
        free = np.zeros(self.shares.shape, dtype=bool)
        free[4:6] = self.alone > 0.0
        mean = p["warp"] ** 0.5 * p["weft"] ** 0.5
        woven = np.stack([one, one, one, p["shear"], p["warp"], p["weft"], mean, mean], axis=1)
        scale = np.stack(4 * [along(p) * h] + 4 * [p["E"] * h**3 / 12.0], axis=1)
        return np.where(free, 1.0, factors) * (scale * woven) * self.shares

    def longest_step(self) -> Array:
        """Longest stable step [W] [s], 2 / omega of the fastest small vibration in or out of plane.

        Source: von Neumann's analysis of the elements in ``native/shell.h``.
        """
        lx, ly = self.spacing
        k2 = 4.0 / lx**2 + 4.0 / ly**2
        E, in_plane, nu, density, damping = np.array(
            [[m.E, m.in_plane, m.nu, m.density, m.damping] for m in self.materials]
        ).T
        sheared = np.array([max(1.0, m.shear) for m in self.materials])
        bent = np.array([max(m.warp, m.weft) for m in self.materials])
        in_plane, E = in_plane * self.local[:, 0].max(axis=1), E * self.local[:, 4].max(axis=1)
        # joints at a gripper's border can be eight times as stiff
        across = 8.0 * self.faster[1] * self.thickness**2 / 12.0 * k2**2
        along = self.faster[0] * k2
        fastest = np.maximum(in_plane * sheared * along, E * bent * across)
        fastest = fastest / (1.0 - nu**2) / density
        return 2.0 / np.sqrt(np.where(damping > 0.0, 2.0, 1.0) * fastest)

    def by_start(self, x: Array, v: Array, bar: Array) -> tuple[Array, Array]:
        """As of ``RodModel``, as the methods below."""
        return bar[..., X].copy(), bar[..., V].copy()

    def check_apart(self, x: Array) -> None:
        check_cloth(x, self)

    def held(self, x: Array, centre: Array, radius: Array, taken: Array) -> NDArray[np.int32]:
        """Points inside the sphere, and ends of edges whose midpoints are. If there are none but
        the sphere touches the sheet, the nearest point. Of a point beyond the sheet's outline the
        nearest place of cloth counts."""
        skin = x if self.cut is None else self.cut.on_skin(x)
        distance = np.linalg.norm(skin - centre[:, None], axis=2)
        held = distance < radius[:, None]
        for lines in self.lines:
            at, many = lines.of(skin, np.inf), len(lines.index)
            out = 0.5 * (at[:, :-1] + at[:, 1:]) - np.repeat(centre, many, axis=0)[:, None]
            near = np.linalg.norm(out, axis=2) < np.repeat(radius, many)[:, None]
            held |= lines.points(np.pad(near, ((0, 0), (0, 1))) | np.pad(near, ((0, 0), (1, 0))))
        least = distance.min(axis=1)
        touched = (least < np.maximum(radius, 0.75 * self.widest)) & ~held.any(axis=1)
        if self.cut is not None:
            for w in np.flatnonzero(touched):
                sheet = skin[w][self.cut.triangles]
                touched[w] = triangle_distance(centre[w], sheet).min() < radius[w]
        held[np.flatnonzero(touched), distance.argmin(axis=1)[touched]] = True
        return (held & ((taken & 1) == 0)).astype(np.int32)

    def at_borders(self, worlds: Any, stiffer: Array) -> Array:
        return stiffer

    def unstiffened(self, group: slice, stiffer: Array, found: Array) -> Array:
        bar = found[:, 4:6] * self.stiffness[group, 4:6]
        found[:, 4:6] *= stiffer
        return bar


def _to_corners(cells: Array) -> Array:
    """Sums [rows, columns] at points of values [rows - 1, columns - 1] of the cells around them."""
    return _corner_sums(np.broadcast_to(cells, (2, 2, *cells.shape)))


def _corner_sums(corners: Array) -> Array:
    """Sums [rows, columns] at points of values [2, 2, rows - 1, columns - 1] at cells' corners."""
    rows, columns = corners.shape[2:]
    total = np.zeros((rows + 1, columns + 1))
    for j, i in np.ndindex(2, 2):
        total[j : rows + j, i : columns + i] += corners[j, i]
    return total


def _corners(values: Array) -> Array:
    """Values [rows, columns] of points at the corners of cells, [2, 2, rows - 1, columns - 1]."""
    return sliding_window_view(values, (2, 2)).transpose(2, 3, 0, 1)


def _bent(cut: Cut, inner_x: Array, inner_y: Array) -> tuple[list[Array], list[Array]]:
    """Areas [rows, columns] that bend with x_xx and x_yy of each point, and with both, and where
    the transverse curvature is free, see ``ShellModel.alone``.

    A cell's area goes to those of its corners that have the difference: points at the outline
    have not. A sheet of constant curvature then has the energy of a plate in all directions.
    """
    lx, ly = cut.spacing
    both = inner_x * inner_y
    areas = []
    for has in (inner_x, inner_y, both):
        part = cut.corners * _corners(has)
        some = part.sum(axis=(0, 1))
        part = part * np.where(some > 0.0, cut.cells / np.where(some > 0.0, some, 1.0), 0.0)
        areas.append(lx * ly * _corner_sums(part))
    areas[2] = np.minimum(areas[2], MOST_COUPLED * np.sqrt(areas[0] * areas[1]))
    # in parts one cell wide no cell has a point with both
    coupled = _to_corners((_corners(both) * (cut.cells > 0.0)).max(axis=(0, 1))) > 0.0
    return areas, [inner_x * ~coupled, inner_y * ~coupled]


def _faster(cut: Cut, area: Array, bent: list[Array]) -> tuple[float, float]:
    """``ShellModel.faster``: sums of absolute values in rows of stiffness over mass (Gershgorin).

    Args:
        cut: The lattice's part.
        area: [rows, columns] of points [m^2].
        bent: ``ShellModel.shares`` of bending, [rows, columns] each.
    """
    lx, ly = cut.spacing

    def spread(values: Array, axis: int) -> Array:
        beside = np.pad(values, 1)
        before, after = (np.roll(beside, k, axis)[1:-1, 1:-1] for k in (1, -1))
        return 4.0 * (before + 2.0 * values + after)

    twist = 4.0 * _to_corners(bent[3][:-1, :-1])
    coupled = np.maximum(spread(bent[2], 0) + spread(bent[2], 1), twist)
    rows = spread(bent[0], 1) + spread(bent[1], 0) + coupled
    there = area > 0.0
    usual = (4.0 / lx**2 + 4.0 / ly**2) ** 2
    quarters = 0.25 * lx * ly * _to_corners(cut.cells)
    lighter = float((quarters[there] / area[there]).max())
    return max(1.0, lighter), max(1.0, float((rows[there] / area[there]).max()) / usual)
