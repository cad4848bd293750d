"""The shell model: element parameters from a cloth's lattice and materials."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.materials import Material
from gendom.sim.bodies import Body


@dataclass(frozen=True)
class ShellModel:
    """The elements of W shells of one shape; rows of numbers are those of ``native/shell.h``."""

    shape: tuple[int, int]
    """Number of rows, and of points in a row."""
    spacing: tuple[float, float]
    """Distance between points along rows and along columns [m]."""
    thickness: float
    area: NDArray[np.float64]
    """[n] area represented by each point [m^2]."""
    exists: NDArray[np.float64]
    """[3, n] whether a point has an edge to the next one, to the one below, and a cell."""
    rest_bend: NDArray[np.float64]
    """[3, n] stress-free second differences along the normal [m]."""
    stiffest: float
    """Largest factor of the weave on the membrane's stiffness."""
    bending: float
    """Largest factor of the weave on the bending stiffness."""
    shares: NDArray[np.float64]
    """[8, n] geometric factors of the moduli in each stiffness: areas over spacings."""
    alone: NDArray[np.float64]
    """[2, n] whether transverse curvature is free, along rows and along columns."""

    @classmethod
    def of(cls, body: Body) -> "ShellModel":
        ny, nx = body.shape
        grid = body.points.reshape(ny, nx, 3)
        lx = float(np.linalg.norm(grid[0, 1] - grid[0, 0]))
        ly = float(np.linalg.norm(grid[1, 0] - grid[0, 0]))
        one = np.ones((ny, nx))
        after, below = one.copy(), one.copy()
        after[:, -1] = below[-1] = 0.0
        cell = after * below
        wide, high = one.copy(), one.copy()
        wide[:, [0, -1]] *= 0.5
        high[[0, -1]] *= 0.5
        area = lx * ly * wide * high
        inner_x, inner_y = 0.0 * one, 0.0 * one
        inner_x[:, 1:-1] = inner_y[1:-1] = 1.0
        both = inner_x * inner_y
        quarter = 0.25 * lx * ly * cell
        shares = np.stack(
            [
                quarter,
                quarter,
                quarter,
                16.0 * quarter,
                area * inner_x / lx**4,
                area * inner_y / ly**4,
                area * both / (lx * ly) ** 2,
                2.0 * lx * ly * cell / (lx * ly) ** 2,
            ]
        )
        weave = body.weave
        coupled = math.sqrt(weave.warp * weave.weft)
        membrane = [weave.warp, weave.weft, coupled, weave.shear]
        shares *= np.array(membrane + 4 * [weave.bending])[:, None, None]
        k = np.zeros((2, 2)) if body.natural_curvature is None else -body.natural_curvature
        rest = [k[0, 0] * lx**2, k[1, 1] * ly**2, k[0, 1] * lx * ly]
        return cls(
            shape=(ny, nx),
            spacing=(lx, ly),
            thickness=body.thickness,
            area=area.reshape(-1),
            exists=np.stack([after, below, cell]).reshape(3, -1),
            rest_bend=np.array(rest)[:, None] * np.ones((1, nx * ny)),
            stiffest=max(weave.warp, weave.weft, weave.shear),
            bending=weave.bending,
            shares=shares.reshape(8, -1),
            alone=np.stack([inner_x * (1.0 - inner_y), inner_y * (1.0 - inner_x)]).reshape(2, -1),
        )

    def factors(self, nu: NDArray[np.floating]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Stiffness [W, 8, n] over E h (membrane) or E h^3 / 12 (bending), without the factors
        ``shares``, and its derivative with respect to nu. Plane stress; where transverse curvature
        is free, the modulus is that of a beam."""
        plane, plane_nu = 1.0 / (1.0 - nu**2), 2.0 * nu / (1.0 - nu**2) ** 2
        both, both_nu = nu * plane, plane + nu * plane_nu
        shear, shear_nu = 0.5 / (1.0 + nu), -0.5 / (1.0 + nu) ** 2
        twist, twist_nu = 2.0 * shear, 2.0 * shear_nu  # D (1 - nu) = E h^3 / 12 / (1 + nu)
        values = np.stack([plane, plane, both, shear, plane, plane, both, twist], axis=1)
        slopes = np.stack(
            [plane_nu, plane_nu, both_nu, shear_nu, plane_nu, plane_nu, both_nu, twist_nu], axis=1
        )
        free = np.zeros((8, len(self.area)), dtype=bool)
        free[4:6] = self.alone > 0.0
        return np.where(free, 1.0, values[:, :, None]), np.where(free, 0.0, slopes[:, :, None])

    def scales(self, materials: Sequence[Material]) -> NDArray[np.float64]:
        """Scales [W, 8, 1] of the stiffness: E h with the in-plane modulus, and E h^3 / 12."""
        h = self.thickness
        rows = [4 * [m.in_plane * h] + 4 * [m.E * h**3 / 12.0] for m in materials]
        return np.array(rows)[:, :, None]

    def longest_step(
        self, materials: Sequence[Material], share: NDArray[np.floating]
    ) -> NDArray[np.float64]:
        """Longest stable step [W] [s], 2 / omega of the fastest small vibration in or out of plane.

        Source: von Neumann's analysis of the elements in ``native/shell.h``.
        """
        lx, ly = self.spacing
        k2 = 4.0 / lx**2 + 4.0 / ly**2
        E, in_plane = np.array([[m.E, m.in_plane] for m in materials]).T * share.max(axis=1)
        nu = np.array([m.nu for m in materials])
        density = np.array([m.density for m in materials])
        # joints at a gripper's border can be eight times as stiff
        across = 8.0 * self.thickness**2 / 12.0 * k2**2
        fastest = np.maximum(in_plane * self.stiffest * k2, E * self.bending * across)
        fastest = fastest / (1.0 - nu**2) / density
        damped = np.array([m.damping > 0.0 for m in materials])
        return 2.0 / np.sqrt(np.where(damped, 2.0, 1.0) * fastest)
