"""Point clouds as smooth density grids that compare clouds of different sizes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.errors import ParameterError

RESOLUTION = 64
"""Cells along the longest side of the observed space, as in the paper."""


@dataclass(frozen=True, kw_only=True)
class DensityGrid:
    """A box of cells on which clouds become densities.

    A point gives each of the 27 nodes around it a weight that falls with distance: the product
    of quadratic B-splines of its position in the cell. Weights of a cloud sum to one, so a cloud
    of 100 points compares with one of 1,000. Source: Kuroki et al. (2024), section III-C.
    """

    origin: NDArray[np.floating]
    """[3] position of node (0, 0, 0) [m]."""
    cell: float
    """Edge of a cell [m]."""
    shape: tuple[int, int, int]
    """Nodes along x, y, z."""

    @classmethod
    def around(
        cls,
        points: ArrayLike,
        *,
        margin: float = 0.0,
        resolution: int = RESOLUTION,
    ) -> "DensityGrid":
        """The smallest grid of cubic cells around points [n, 3], its longest side ``resolution``.

        Args:
            points: [n, 3] [m].
            margin: Space to leave on every side [m].
            resolution: Nodes along the longest side.

        Raises:
            ParameterError: If there are no points or they all coincide without a margin.
        """
        p = np.asarray(points, dtype=float).reshape(-1, 3)
        if len(p) == 0 or not np.isfinite(p).all():
            raise ParameterError("a density grid needs finite points to stand around")
        if resolution < 4:
            raise ParameterError(f"a density grid needs 4 nodes or more, got {resolution}")
        low, high = p.min(axis=0) - margin, p.max(axis=0) + margin
        cell = float((high - low).max()) / (resolution - 3)
        if cell <= 0.0:
            raise ParameterError("all points coincide: give the density grid a margin [m]")
        shape = np.minimum(np.ceil((high - low) / cell).astype(int) + 3, resolution)
        x, y, z = (int(n) for n in shape)
        return cls(origin=low - cell, cell=cell, shape=(x, y, z))

    @property
    def num_nodes(self) -> int:
        return int(np.prod(self.shape))

    def splat(self, points: ArrayLike) -> NDArray[np.floating]:
        """Densities [..., X * Y * Z] of clouds [..., n, 3]; a node off the grid takes nothing.

        Each cloud's weights sum to one when it lies on the grid.
        """
        p = np.asarray(points, dtype=float)
        lead, n = p.shape[:-2], p.shape[-2]
        q = (p.reshape(-1, n, 3) - self.origin) / self.cell
        base = np.floor(q - 0.5).astype(np.int64)
        f = q - base
        w = np.stack([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2], axis=-1)
        step = np.arange(3)
        node = base[..., None] + step  # [L, n, 3 axes, 3 offsets]
        size = np.array(self.shape)[:, None]
        w = np.where((node >= 0) & (node < size), w, 0.0)
        node = np.clip(node, 0, size - 1)
        _, Y, Z = self.shape
        first = (np.arange(len(q)) * self.num_nodes)[:, None, None, None, None]
        x, y, z = node[:, :, 0], node[:, :, 1], node[:, :, 2]
        index = first + (x[:, :, :, None, None] * Y + y[:, :, None, :, None]) * Z
        index = index + z[:, :, None, None, :]
        wx, wy, wz = w[:, :, 0] / n, w[:, :, 1], w[:, :, 2]
        weight = wx[:, :, :, None, None] * wy[:, :, None, :, None] * wz[:, :, None, None, :]
        total = len(q) * self.num_nodes
        sums = np.bincount(index.ravel(), weight.ravel(), minlength=total)
        return sums.astype(float).reshape(*lead, self.num_nodes)


def density_distance(grid: DensityGrid, a: ArrayLike, b: ArrayLike) -> float:
    """L1 distance of two clouds' densities, from 0 (equal) to 2 (apart), as the paper's loss."""
    return float(np.abs(grid.splat(a) - grid.splat(b)).sum())
