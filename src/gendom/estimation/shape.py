"""A `Shape`: the middle line of a rope or middle surface of a cloth, to which points are
assigned."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from gendom.estimation.replay import lattice
from gendom.estimation.scene import LiftScene
from gendom.observation import visible_on_sheet

Array = NDArray[np.floating]

FEET = 48
"""Places along the longer side of a cloth that points may belong to, about."""


class Shape:
    """The middle line or surface of a scene's object as a finite element."""

    def __init__(self, scene: LiftScene):
        self.rope = scene.kind == "rope"
        self.radius = scene.body.thickness / 2.0
        self.lattice = a, b = lattice(scene)
        if self.rope:
            k = np.arange(len(a) - 1)
            parts = (np.arange(2) + 0.5) / 2.0
            u = np.tile(parts, len(k))
            index = np.repeat(np.stack([k, k + 1], axis=1), len(parts), axis=0)
            self.samples = index, np.stack([1.0 - u, u], axis=1)
            self.spacing = float(a[1] - a[0])
            return
        parts = max(2, round(FEET / max(len(a) - 1, len(b) - 1)))
        self.spacing = float(max(a[1] - a[0], b[1] - b[0])) / parts
        number = np.arange(len(a) * len(b)).reshape(len(b), len(a))
        corners = [number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]]
        cells = np.stack([c.ravel() for c in corners], axis=1)
        ticks = (np.arange(parts) + 0.5) / parts
        v, u = (x.ravel() for x in np.meshgrid(ticks, ticks, indexing="ij"))
        shares = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], axis=1)
        index = np.repeat(cells, len(shares), axis=0)
        self.fine = index, np.tile(shares, (len(cells), 1))
        self.samples = cells, np.full((len(cells), 4), 0.25)

    def taken_from(self, other: Shape, values: Array) -> Array:
        """[T, n, ...] at this shape's points, of values at those of another of the same object,
        between which they are linear."""
        if [len(k) for k in self.lattice] == [len(k) for k in other.lattice]:
            return values
        Ka, Kb = (
            np.stack([np.interp(ours, theirs, e) for e in np.eye(len(theirs))], axis=1)
            for ours, theirs in zip(self.lattice, other.lattice, strict=True)
        )
        T, _, *rest = values.shape
        rows = values.reshape(T, Kb.shape[1], Ka.shape[1], -1)
        return np.einsum("ij,kl,tjlp->tikp", Kb, Ka, rows, optimize=True).reshape(T, -1, *rest)

    def nearest(self, x: Array, points: Array) -> tuple[NDArray[np.intp], Array, Array]:
        """Middle points around the feet of points [T, m, 3] on shapes [T, n, 3], [T, m, k], their
        shares, and the feet [T, m, 3]."""
        if self.rope:
            a, d = x[:, :-1], np.diff(x, axis=1)
            long = np.maximum((d**2).sum(axis=2), 1e-18)
            # |p - a - u d|^2 with u the foot's share of each edge, by products of matrices
            along = points @ np.swapaxes(d, 1, 2) - (a * d).sum(axis=2)[:, None]
            far = (points**2).sum(axis=2)[..., None] - 2.0 * points @ np.swapaxes(a, 1, 2)
            far += (a**2).sum(axis=2)[:, None]
            u = np.clip(along / long[:, None], 0.0, 1.0)
            k = (far - 2.0 * u * along + u**2 * long[:, None]).argmin(axis=2)
            share = np.take_along_axis(u, k[..., None], axis=2)
            foot = np.take_along_axis(a, k[..., None], axis=1)
            foot = foot + share * np.take_along_axis(d, k[..., None], axis=1)
            return np.stack([k, k + 1], axis=2), np.concatenate([1.0 - share, share], axis=2), foot
        index, weight = self.fine
        places = np.einsum("mk,tmka->tma", weight, x[:, index])
        near = np.stack([_tree(a).query(b)[1] for a, b in zip(places, points, strict=True)])
        foot = np.take_along_axis(places, near[..., None], axis=1)
        return index[near], weight[near], foot

    def open_to(self, cameras: Array, x: Array, places: Array) -> NDArray[np.bool_]:
        """[m] which samples of a sheet [n, 3], at these places [m, 3], a camera sees."""
        index, weight = self.fine
        return visible_on_sheet(
            places,
            self.normals(x[None], self.samples[0][None])[0],
            np.einsum("mk,mka->ma", weight, x[index]),
            spacing=self.spacing,
            camera_positions=cameras,
        )

    def normals(self, x: Array, index: NDArray[np.intp]) -> Array:
        """[T, m, 3] unit normals of sheets' [T, n, 3] cells with corners [T, m, 4]."""
        q = taken(x, index)
        along = q[..., 1, :] - q[..., 0, :] + q[..., 3, :] - q[..., 2, :]
        across = q[..., 2, :] - q[..., 0, :] + q[..., 3, :] - q[..., 1, :]
        n = np.cross(along, across)
        return n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-18)


def _tree(points: Array) -> KDTree:
    """A tree that is built fast, for about as many queries as it has points."""
    return KDTree(points, balanced_tree=False, compact_nodes=False)


def taken(J: Array, index: NDArray[np.intp]) -> Array:
    """[T, m, k, 3] of [T, n, 3] at indices [T, m, k]."""
    return np.take_along_axis(J[:, :, None], index.reshape(len(index), -1, 1, 1), axis=1).reshape(
        *index.shape, 3
    )
