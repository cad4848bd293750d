"""Point clouds as smooth density grids that compare clouds of different sizes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.arguments import require


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
        cls, points: ArrayLike, *, margin: float = 0.0, resolution: int = 64
    ) -> "DensityGrid":
        """The smallest grid of cubic cells around points [n, 3] [m].

        Args:
            points: [n, 3] [m].
            margin: Space to leave on every side [m].
            resolution: Nodes along the longest side; the paper's by default.

        Raises:
            ParameterError: If there are no points or they all coincide without a margin.
        """
        p = np.asarray(points, dtype=float).reshape(-1, 3)
        some = len(p) > 0 and np.isfinite(p).all()
        require(some, "a density grid needs finite points to stand around")
        require(resolution >= 4, f"a density grid needs 4 nodes or more, got {resolution}")
        low, high = p.min(axis=0) - margin, p.max(axis=0) + margin
        cell = float((high - low).max()) / (resolution - 3)
        require(cell > 0.0, "all points coincide: give the density grid a margin [m]")
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
        index, weights, _ = self._stencil(p.reshape(-1, n, 3))
        index += (np.arange(len(index)) * self.num_nodes)[:, None, None, None, None]
        x, y, z = np.moveaxis(weights, 2, 0)
        weight = (x / n)[..., None, None] * y[..., None, :, None] * z[..., None, None, :]
        total = len(index) * self.num_nodes
        sums = np.bincount(index.ravel(), weight.ravel(), minlength=total)
        return sums.astype(float).reshape(*lead, self.num_nodes)

    def splat_transpose(self, points: ArrayLike, adjoint: ArrayLike) -> NDArray[np.floating]:
        """Derivative of a loss by the points of clouds, from that by their densities.

        Args:
            points: [..., n, 3] clouds [m].
            adjoint: [..., X * Y * Z] derivative of the loss by what `splat` makes of them.

        Returns:
            [..., n, 3] [1/m].
        """
        p = np.asarray(points, dtype=float)
        n = p.shape[-2]
        index, weights, derivatives = self._stencil(p.reshape(-1, n, 3))
        flat = np.asarray(adjoint, dtype=float).reshape(len(index), self.num_nodes)
        gathered = np.take_along_axis(flat, index.reshape(len(index), -1), axis=1)
        gathered = gathered.reshape(index.shape)
        found = np.empty((len(index), n, 3))
        for axis in range(3):
            x, y, z = ((derivatives if a == axis else weights)[:, :, a, :] for a in range(3))
            found[..., axis] = np.einsum("lnijk,lni,lnj,lnk->ln", gathered, x, y, z, optimize=True)
        return (found / (n * self.cell)).reshape(p.shape)

    def _stencil(
        self, p: NDArray[np.floating]
    ) -> tuple[NDArray[np.int64], NDArray[np.floating], NDArray[np.floating]]:
        """Nodes [L, n, 3, 3, 3] around points [L, n, 3], the weights [L, n, 3 axes, 3] whose
        products they take, and their derivatives by the position in cells."""
        q = (p - self.origin) / self.cell
        base = np.floor(q - 0.5).astype(np.int64)
        f = q - base
        w = np.stack([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2], axis=-1)
        dw = np.stack([f - 1.5, 2.0 - 2.0 * f, f - 0.5], axis=-1)
        node = base[..., None] + np.arange(3)
        size = np.array(self.shape)[:, None]
        on = (node >= 0) & (node < size)
        node = np.clip(node, 0, size - 1)
        _, Y, Z = self.shape
        x, y, z = np.moveaxis(node, 2, 0)
        index = (x[..., None, None] * Y + y[..., None, :, None]) * Z + z[..., None, None, :]
        return index, np.where(on, w, 0.0), np.where(on, dw, 0.0)
