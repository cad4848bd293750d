"""What moves, described once, as layers over time: viewer, reports, films and meshes draw it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import check_numbers, require
from gendom.arrays import Array
from gendom.viz.palette import nice_step

_TURN, _TILT = math.radians(25.0), math.radians(18.0)
"""From where it is seen, around and down."""

_SQUARES = 10
"""Squares of the table's grid along the longer side of what is shown."""

NO_FACES = np.empty((0, 3), dtype=int)


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """Dots, thick lines or a surface that move.

    Raises:
        ParameterError: Points are not [n, 3] or [L, 2, 3], or not finite.
    """

    name: str
    color: str
    """As "#rrggbb"."""
    points: Sequence[Array] | Array
    """T clouds of dots [n, 3], ends of lines [L, 2, 3], or vertices of a surface [V, 3] [m]; one
    of what rests. The number of dots may change."""
    faces: NDArray[np.integer] = field(default_factory=lambda: NO_FACES)
    """[F, 3] triangles of a surface."""
    closed: bool = False
    """Whether a surface is one around a solid, its triangles counter-clockwise from outside."""
    radius: float | Array = 0.0
    """Of dots, or of lines [L] [m]."""
    opacity: float = 1.0
    """Of dots, and of a surface in the viewer."""

    def __post_init__(self) -> None:
        for t, x in enumerate(self.points):
            check_numbers(f"{self.name}[{t}]", x, ("n", 3), ("L", 2, 3))

    def at(self, frame: int) -> Array:
        """Its points in a frame of the animation [m]."""
        return np.asarray(self.points[frame if len(self.points) > 1 else 0])

    @property
    def kind(self) -> str:
        """dots, lines or surface."""
        if len(self.faces):
            return "surface"
        return "lines" if np.ndim(self.points[0]) == 3 else "dots"


@dataclass(frozen=True, kw_only=True, eq=False)
class Animation:
    """T frames of some layers, each of its own name. World frame, z up.

    Raises:
        ParameterError: Times do not increase, or a layer has another number of frames.
    """

    times: Array
    """[T] increasing [s]."""
    layers: tuple[Layer, ...]
    """Each has T frames, or one that is shown at all times."""
    table_height: float | None = None
    """z of the table [m]; None: no table."""
    distance: tuple[str, Array] | None = None
    """How far recorded and simulated clouds are apart: what it is, and [T] [m]."""
    facts: tuple[tuple[str, str], ...] = ()
    """Names and values to read."""

    def __post_init__(self) -> None:
        times, T = check_numbers("times", self.times, ("T",)), len(self.times)
        grows = T > 0 and np.all(np.diff(times) > 0.0)
        require(grows, "must increase, at least one", where="times", fix="sort them")
        for layer in self.layers:
            what = f"has {len(layer.points)} frames, but there are {T} times"
            require(len(layer.points) in (1, T), what, where=layer.name, fix="give one each")
        if self.distance is not None:
            check_numbers("distance", self.distance[1], (T,))

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self.times)

    @cached_property
    def box(self) -> Array:
        """[2, 3] lowest and highest corner of all layers, without stray points [m].

        Raises:
            ParameterError: There are no points at all.
        """
        ends = []
        for layer in self.layers:
            points = np.concatenate([np.reshape(x, (-1, 3)) for x in layer.points])
            if len(points):
                # a depth camera's flying pixels would shrink everything else
                share = (0.005, 0.995) if layer.kind == "dots" else (0.0, 1.0)
                ends.append(np.quantile(points, share, axis=0))
        require(ends, "have no points at all", where="layers", fix="record it again")
        return np.stack([np.min(ends, axis=(0, 1)), np.max(ends, axis=(0, 1))])

    @property
    def corners(self) -> Array:
        """[8, 3] of the box [m]."""
        return np.stack(np.meshgrid(*self.box.T), axis=-1).reshape(-1, 3)

    @property
    def view(self) -> tuple[float, float]:
        """From where it is seen: at the broad side, from a little above. As of `axes_of`."""
        x, y, _ = np.ptp(self.box, axis=0)
        return _TURN + (0.0 if x >= y else 0.5 * math.pi), _TILT

    @property
    def square(self) -> float:
        """Side of the squares of the table [m]."""
        return nice_step(float(np.ptp(self.box, axis=0)[:2].max()) / _SQUARES)

    @property
    def table_ends(self) -> tuple[Array, Array]:
        """Corners [2] of the table with least and with most x and y, on its grid [m]."""
        low = np.floor(self.box[0, :2] / self.square - 2.0) * self.square
        return low, np.ceil(self.box[1, :2] / self.square + 2.0) * self.square


def axes_of(turn: float, tilt: float) -> Array:
    """[3, 3] unit vectors in the world that point right, up and away in a picture.

    Args:
        turn: Angle about z from x to the right of the picture [rad].
        tilt: Angle by which it looks downwards [rad]: 0 from the side, pi / 2 from above.
    """
    (c, s), (ct, st) = ((math.cos(a), math.sin(a)) for a in (turn, tilt))
    return np.array([[c, s, 0.0], [-s * st, c * st, ct], [-s * ct, c * ct, -st]])
