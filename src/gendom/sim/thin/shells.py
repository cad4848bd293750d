"""Cloths as shells: what the engine, ``ThinEngine``, knows of them."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.arrays import Array
from gendom.materials.parameters import WEAVE
from gendom.sim.setting import DRAG, Setting, spread
from gendom.sim.thin.contact import check_cloth
from gendom.sim.thin.types import MARGIN, Coefficients, Lines, V, X, along, parameters_of

SHORTEST = 0.125
"""Smallest length represented by a joint at a gripper's border, over its usual length: no added
inertia compensates for the stiffness."""


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
    shared_rows: ClassVar = 22
    """``SHARED_ROWS`` of ``native/contact_lists.h``."""
    cfl, undamped_cfl = 0.8, 0.4
    """As of rods; undamped, nonlinear ones gain energy in longer steps (benchmarks/swing.py)."""
    woven: ClassVar[tuple[str, ...]] = WEAVE
    border_rows: ClassVar = [2, 3]
    per_turn = np.zeros(())

    def __init__(self, setting: Setting):
        body, materials = setting.body, setting.materials
        (ny, nx), h = body.shape, body.thickness
        self.materials, self.thickness = materials, h
        self.parameters = setting.parameters
        self.shape: tuple[int, int] = (ny, nx)
        """Number of rows, and of points in a row."""
        grid = body.points.reshape(ny, nx, 3)
        lx, ly = (float(np.linalg.norm(of - grid[0, 0])) for of in (grid[0, 1], grid[1, 0]))
        self.spacing, self.widest = (lx, ly), max(lx, ly)
        """Distance between points along rows and along columns, and the larger one [m]."""
        self._check(setting)
        self.pitch = -(-(nx + 1) // 8) * 8
        slots = MARGIN + self.pitch * (1 + np.arange(ny))[:, None] + np.arange(nx)
        self.slots, self.row_length = slots.reshape(-1), MARGIN + (ny + 2) * self.pitch + MARGIN
        after, below = np.ones((ny, nx)), np.ones((ny, nx))
        after[:, -1], below[-1] = 0.0, 0.0
        cell, inner_x, inner_y = after * below, after.copy(), below.copy()
        inner_x[:, 0], inner_y[0] = 0.0, 0.0
        self.exists = np.stack([after, below, cell]).reshape(3, -1)
        """[3, n] whether a point has an edge to the next one, to the one below, and a cell."""
        alone = [inner_x * (1.0 - inner_y), inner_y * (1.0 - inner_x)]
        self.alone = np.stack(alone).reshape(2, -1)
        """[2, n] whether transverse curvature is free, along rows and along columns."""
        quarter = 0.25 * lx * ly * cell
        area = 0.25 * lx * ly * (1.0 + inner_x) * (1.0 + inner_y)
        xx, yy = area * inner_x / lx**4, area * inner_y / ly**4
        xy = area * inner_x * inner_y / (lx * ly) ** 2
        bending = [xx, yy, xy, 2.0 * lx * ly * cell / (lx * ly) ** 2]
        shares = np.stack([quarter, quarter, quarter, 16.0 * quarter, *bending])
        self.shares = shares.reshape(8, -1)
        """[8, n] geometric factors of the moduli in each stiffness: areas over spacings."""
        W, n = len(materials), ny * nx
        self.area = area.reshape(-1)
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
        side = min((nx - 1) * lx, (ny - 1) * ly)
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
        (rows, columns), (lx, ly) = self.shape, self.spacing
        number = np.arange(rows * columns).reshape(rows, columns)
        return [
            Lines(number, np.full(columns - 1, lx), SHORTEST),
            Lines(number.T, np.full(rows - 1, ly), SHORTEST),
        ]

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
        across = 8.0 * self.thickness**2 / 12.0 * k2**2
        fastest = np.maximum(in_plane * sheared * k2, E * bent * across)
        fastest = fastest / (1.0 - nu**2) / density
        return 2.0 / np.sqrt(np.where(damping > 0.0, 2.0, 1.0) * fastest)

    def by_start(self, x: Array, v: Array, bar: Array) -> tuple[Array, Array]:
        """As of ``RodModel``, as the methods below."""
        return bar[..., X].copy(), bar[..., V].copy()

    def check_apart(self, x: Array) -> None:
        check_cloth(x, self)

    def held(self, x: Array, centre: Array, radius: Array, taken: Array) -> NDArray[np.int32]:
        """Points inside the sphere, and ends of edges whose midpoints are. If there are none but
        the sphere touches the sheet, the nearest point."""
        distance = np.linalg.norm(x - centre[:, None], axis=2)
        held = distance < radius[:, None]
        for lines in self.lines:
            at, many = lines.of(x), len(lines.index)
            out = 0.5 * (at[:, :-1] + at[:, 1:]) - np.repeat(centre, many, axis=0)[:, None]
            near = np.linalg.norm(out, axis=2) < np.repeat(radius, many)[:, None]
            held |= lines.points(np.pad(near, ((0, 0), (0, 1))) | np.pad(near, ((0, 0), (1, 0))))
        least = distance.min(axis=1)
        touched = (least < np.maximum(radius, 0.75 * self.widest)) & ~held.any(axis=1)
        held[np.flatnonzero(touched), distance.argmin(axis=1)[touched]] = True
        return (held & ((taken & 1) == 0)).astype(np.int32)

    def at_borders(self, worlds: Any, stiffer: Array) -> Array:
        return stiffer

    def unstiffened(self, group: slice, stiffer: Array, found: Array) -> Array:
        bar = found[:, 4:6] * self.stiffness[group, 4:6]
        found[:, 4:6] *= stiffer
        return bar
