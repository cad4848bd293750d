"""What a viewer shows: layers over time, free of what draws them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gendom.errors import GendomError

Array = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True, eq=False)
class PointLayer:
    """A cloud that changes."""

    name: str
    color: str
    """As "#rrggbb"."""
    points: Sequence[Array]
    """T clouds [n_t, 3] [m]."""
    radius: float
    """Of a dot [m]."""
    framed: bool = True
    """Whether the camera is placed so that it is seen."""

    def __len__(self) -> int:
        return len(self.points)

    def all_points(self) -> Array:
        """[n, 3] points of all frames [m]."""
        return np.concatenate([np.zeros((0, 3)), *self.points])


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshLayer:
    """A surface that moves."""

    name: str
    color: str
    """As "#rrggbb"."""
    vertices: Array
    """[T, V, 3] [m]; [1, V, 3] of one that rests."""
    faces: NDArray[np.integer]
    """[F, 3] its triangles."""
    opacity: float = 1.0
    framed: bool = True
    """Whether the camera is placed so that it is seen."""

    def __len__(self) -> int:
        return len(self.vertices)

    def all_points(self) -> Array:
        """[n, 3] vertices of all frames [m]."""
        return self.vertices.reshape(-1, 3)


Layer = PointLayer | MeshLayer


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewerScene:
    """T frames of some layers. World frame, z up.

    Raises:
        GendomError: There is no frame, lengths differ, or two layers have one name.
    """

    times: Array
    """[T] increasing [s]."""
    layers: tuple[Layer, ...]
    """Of T frames each, or of one that is shown at all times."""
    table_height: float | None = None
    """z of the table [m]; None: no table."""
    curves: Mapping[str, Array] = field(default_factory=dict)
    """[T] each: numbers over time, by name and unit."""
    facts: tuple[tuple[str, str], ...] = ()
    """Names and values to read."""
    backdrop: Array | None = None
    """[3] a place that the camera is to see behind everything else [m]; None: any."""

    def __post_init__(self) -> None:
        T = len(self.times)
        if T == 0:
            raise GendomError("is empty", where="times", fix="give at least one frame")
        for layer in self.layers:
            if len(layer) not in (1, T):
                raise GendomError(
                    f"has {len(layer)} frames, but times has {T}",
                    where=layer.name,
                    fix="give 1 each",
                )
        for name, values in self.curves.items():
            if len(values) != T:
                raise GendomError(
                    f"has {len(values)} numbers, but times has {T}", where=name, fix="give 1 each"
                )
        names = [layer.name for layer in self.layers]
        if len(set(names)) < len(names):
            raise GendomError(f"are {', '.join(names)}", where="layers", fix="give each a name")

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self.times)

    def frame_at(self, time: float) -> int:
        """Number of the last frame that is not after a time [s]."""
        return max(int(np.searchsorted(self.times, time, side="right")) - 1, 0)

    @cached_property
    def box(self) -> Array:
        """[2, 3] lowest and highest corner of the layers that the camera is to show, without stray
        points [m].

        Raises:
            GendomError: There are no points at all.
        """
        ends = []
        for layer in self.layers:
            points = layer.all_points() if layer.framed else ()
            if len(points):
                # a depth camera's flying pixels would shrink everything else
                share = (0.005, 0.995) if isinstance(layer, PointLayer) else (0.0, 1.0)
                ends.append(np.quantile(points, share, axis=0))
        if not ends:
            raise GendomError("have no points at all", where="layers", fix="record it again")
        return np.stack([np.min(ends, axis=(0, 1)), np.max(ends, axis=(0, 1))])
