"""What the viewer shows: layers over time, what they are made of, and the models that give them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.arguments import require
from gendom.sim import Body
from gendom.tasks.cloth_spreading import lattice_triangles
from gendom.viz.palette import INK, SIMULATED_COLOR
from gendom.viz.quantities import SHOWN_UNITS, with_minus

RING = 8
"""Points of a rod's skin around its centre line, see `gendom.sim.Body.surface`."""

SIDES = 12
"""Sides of a capsule's mesh."""

MATERIAL, ACTION, SETUP = "Material", "Action", "Grip and clock"
"""Groups of parameters."""

_LATITUDES = np.concatenate([np.linspace(0.0, 0.5, 5), np.linspace(0.5, 1.0, 5)]) * np.pi

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
    """A dot's radius [m]."""

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

    def __len__(self) -> int:
        return len(self.vertices)

    def all_points(self) -> Array:
        """[n, 3] vertices of all frames [m]."""
        return self.vertices.reshape(-1, 3)


Layer = PointLayer | MeshLayer


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewerScene:
    """T frames of some layers, each of its own name. World frame, z up."""

    times: Array
    """[T] increasing [s]."""
    layers: tuple[Layer, ...]
    """Each has T frames, or one that is shown at all times."""
    table_height: float | None = None
    """z of the table [m]; None: no table."""
    curves: Mapping[str, Array] = field(default_factory=dict)
    """[T] each: numbers over time, by name and unit."""
    facts: tuple[tuple[str, str], ...] = ()
    """Names and values to read."""

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self.times)

    def frame_at(self, time: float) -> int:
        """Number of the last frame that is not after a time [s]."""
        return max(int(np.searchsorted(self.times, time, side="right")) - 1, 0)

    @cached_property
    def box(self) -> Array:
        """[2, 3] lowest and highest corner of all layers, without stray points [m].

        Raises:
            ParameterError: There are no points at all.
        """
        ends = []
        for layer in self.layers:
            points = layer.all_points()
            if len(points):
                # a depth camera's flying pixels would shrink everything else
                share = (0.005, 0.995) if isinstance(layer, PointLayer) else (0.0, 1.0)
                ends.append(np.quantile(points, share, axis=0))
        what, fix = "have no points at all", "record it again"
        require(ends, what, where="layers", fix=fix)
        return np.stack([np.min(ends, axis=(0, 1)), np.max(ends, axis=(0, 1))])


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number that a slider changes."""

    name: str
    label: str
    """As people write it."""
    unit: str
    meaning: str
    group: str
    low: float
    high: float
    value: float
    """At first, within the range."""
    log: bool = False
    """Whether its slider is logarithmic."""

    def position(self, value: float) -> float:
        """Where its slider stands for a value: at log10 of a logarithmic one."""
        return math.log10(value) if self.log else value

    def at(self, position: float) -> float:
        """The value of a position of its slider, inverse of `position`."""
        return 10.0**position if self.log else position

    def text(self, value: float) -> str:
        """A value with its unit."""
        factor, unit = SHOWN_UNITS.get(self.unit, (1.0, self.unit))
        return with_minus(f"{factor * value:.3g} {unit}".rstrip())


class Model:
    """Something to view."""

    title: str
    """One line."""
    notes: tuple[str, ...]
    """Sentences to be read beside it."""
    cases: tuple[str, int]
    """What its cases are, in the singular, and how many there are."""
    initial: ViewerScene | None
    """What is known before anything is simulated."""

    def parameters(self, case: int) -> tuple[Parameter, ...]:
        """Parameters of a case; of the same names in all cases."""
        raise NotImplementedError

    def simulate(
        self, case: int, values: Mapping[str, float], go_on: Callable[[], None]
    ) -> Iterator[ViewerScene]:
        """One or more scenes, each more complete than the one before.

        Args:
            case: Its number.
            values: Parameters by name.
            go_on: Called now and then; what it raises ends everything.

        Raises:
            ParameterError: It cannot be simulated.
        """
        raise NotImplementedError


def object_layer(
    name: str,
    body: Body,
    points: Array,
    lattice: tuple[int, int] | None,
    opacity: float = 1.0,
) -> MeshLayer:
    """A simulated rope or cloth.

    Args:
        name: Of the layer.
        body: The object.
        points: [T, n, 3] a rope's centre line, or a cloth's middle surface, row by row [m].
        lattice: A cloth's rows and points in a row; None: a rope.
        opacity: Below 1 where something else is to be seen through it.
    """
    if lattice is not None:
        vertices, faces = points, lattice_triangles(*lattice)
    elif points.shape[1] == len(body.points):
        vertices = body.surface(points)
        faces = tube_faces(vertices.shape[1] // RING, RING)
    else:  # the sections of particles
        links = np.stack([points[:, :-1], points[:, 1:]], axis=-2)
        vertices, faces = capsules(links, np.full(links.shape[1], 0.5 * body.thickness))
    return MeshLayer(
        name=name, color=SIMULATED_COLOR, vertices=vertices, faces=faces, opacity=opacity
    )


def gripper_layer(position: Array, size: float, axis: Array | None = None) -> MeshLayer:
    """Grippers as sticks that stand on what they hold, and a bar along the object at the clamp.

    Args:
        position: [T, G, 3] where they hold it [m].
        size: Of the object [m].
        axis: [T, G, 3] unit vectors along the object at the clamps; None: unknown.
    """
    up = np.array([0.0, 0.0, 0.15 * size])
    ends = [np.stack([position, position + up], axis=-2)]
    if axis is not None:
        half = 0.04 * size * axis
        ends.append(np.stack([position - half, position + half], axis=-2))
    every = np.concatenate(ends, axis=1)
    vertices, faces = capsules(every, np.full(every.shape[1], 0.012 * size))
    color = "#" + "".join(f"{c:02x}" for c in INK)
    return MeshLayer(name="gripper", color=color, vertices=vertices, faces=faces)


def tube_faces(rings: int, sides: int) -> NDArray[np.integer]:
    """[F, 3] triangles of a closed tube: rings of vertices one after another, and its two ends.

    They are counter-clockwise from outside where rings are so, seen from the last one.
    """
    at = np.arange(rings * sides).reshape(rings, sides)
    a, b = at[:-1], at[1:]
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    fan = [[0, k, k + 1] for k in range(1, sides - 1)]
    faces = [np.stack([a, c, b], axis=-1), np.stack([a, d, c], axis=-1)]
    ends = [at[0][fan][:, ::-1], at[-1][fan]]
    return np.concatenate([f.reshape(-1, 3) for f in (*faces, *ends)])


def capsules(
    ends: ArrayLike, radius: ArrayLike
) -> tuple[NDArray[np.floating], NDArray[np.integer]]:
    """Vertices [T, V, 3] [m] and triangles [F, 3] of C capsules, of balls where both ends meet.

    Args:
        ends: [T, C, 2, 3] ends of their axes [m].
        radius: [C] [m].
    """
    ends, radius = np.asarray(ends, dtype=float), np.asarray(radius, dtype=float)
    axis = ends[..., 1, :] - ends[..., 0, :]
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    axis = np.where(length > 1e-9, axis / np.maximum(length, 1e-9), [0.0, 0.0, 1.0])
    # any direction that is far from the axis
    aside = np.eye(3)[np.argmin(np.abs(axis), axis=-1)]
    first = np.cross(axis, aside)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(axis, first)
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    around = np.cos(angle)[:, None] * first[..., None, :]
    around = around + np.sin(angle)[:, None] * second[..., None, :]  # [T, C, S, 3]
    out = np.sin(_LATITUDES)[:, None, None] * around[..., None, :, :]
    out = out - np.cos(_LATITUDES)[:, None, None] * axis[..., None, None, :]
    rings = len(_LATITUDES)
    centre = np.repeat(ends, rings // 2, axis=-2)[..., None, :]  # [T, C, R, 1, 3]
    vertices = centre + radius[:, None, None, None] * out
    one, each = tube_faces(rings, SIDES), rings * SIDES
    faces = np.concatenate([one + c * each for c in range(len(radius))])
    return vertices.reshape(len(ends), -1, 3), faces
