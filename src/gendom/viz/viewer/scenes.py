"""What the viewer shows: layers over time, numbers of sliders, and the models that give them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gendom.arguments import require
from gendom.sim import Body, Obstacle
from gendom.tasks.cloth_spreading import lattice_triangles
from gendom.viz.palette import GOAL_COLOR, INK, OBSTACLE_COLOR, SIMULATED_COLOR, nice_step
from gendom.viz.quantities import SHOWN_UNITS, with_minus

FIELD_OF_VIEW = math.radians(35.0)
"""The camera's, upwards."""

_TURN, _TILT = math.radians(25.0), math.radians(18.0)
"""From where the camera looks, around and down."""

_SQUARES = 10
"""Squares of the table's grid along the longer side of what is shown."""

RING = 8
"""Points of a rod's skin around its centre line, see `gendom.sim.Body.surface`."""

MATERIAL, ACTION, SETUP = "Material", "Action", "Grip and clock"
"""Groups of parameters."""

POSITIONS = 200
"""Of a parameter's slider."""

Array = NDArray[np.floating]

NO_FACES = np.empty((0, 3), dtype=int)


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """Dots, thick lines or a surface that move."""

    name: str
    color: str
    """As "#rrggbb"."""
    points: Sequence[Array]
    """T clouds of dots [n, 3], ends of lines [L, 2, 3], or vertices of a surface [V, 3] [m]; one
    of what rests. The number of dots may change."""
    faces: NDArray[np.integer] = field(default_factory=lambda: NO_FACES)
    """[F, 3] triangles of a surface."""
    closed: bool = False
    """Whether a surface is one around a solid, its triangles counter-clockwise from outside."""
    radius: float = 0.0
    """Of dots and lines [m]."""
    opacity: float = 1.0
    """Of a surface, and of dots in pictures."""

    def at(self, frame: int) -> Array:
        """Its points in a frame of the scene [m]."""
        return np.asarray(self.points[frame if len(self.points) > 1 else 0])

    @property
    def kind(self) -> str:
        """dots, lines or surface."""
        if len(self.faces):
            return "surface"
        return "lines" if self.points[0].ndim == 3 else "dots"


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewerScene:
    """T frames of some layers, each of its own name. World frame, z up."""

    times: Array
    """[T] increasing [s]."""
    layers: tuple[Layer, ...]
    """Each has T frames, or one that is shown at all times."""
    table_height: float | None = None
    """z of the table [m]; None: no table."""
    chamfer: Array | None = None
    """[T] distance of recorded and simulated clouds [m]."""
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
            points = np.concatenate([x.reshape(-1, 3) for x in layer.points])
            if len(points):
                # a depth camera's flying pixels would shrink everything else
                share = (0.005, 0.995) if layer.kind == "dots" else (0.0, 1.0)
                ends.append(np.quantile(points, share, axis=0))
        what, fix = "have no points at all", "record it again"
        require(ends, what, where="layers", fix=fix)
        return np.stack([np.min(ends, axis=(0, 1)), np.max(ends, axis=(0, 1))])


@dataclass(frozen=True, kw_only=True)
class SliderParameter:
    """One number that a slider changes. The slider of a logarithmic one stands at its log10."""

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

    def position(self, value: float) -> float:
        """Where its slider stands for a value."""
        return math.log10(value) if self.log else value

    def at(self, position: float) -> float:
        """The value at a position of its slider: exactly the first one where that began."""
        if position == self.start:
            return self.value
        return 10.0**position if self.log else position

    @property
    def start(self) -> float:
        """Where its slider stands at first."""
        return self.position(self.value)

    @property
    def range(self) -> tuple[float, float, float]:
        """Lowest and highest position of its slider, and the step."""
        low, high = self.position(self.low), max(self.position(self.high), self.start + 1e-9)
        return low, high, (high - low) / POSITIONS

    @property
    def marks(self) -> tuple[tuple[float, str], ...] | None:
        """Positions and texts of round values along a logarithmic slider."""
        if not self.log:
            return None
        low, high, _ = self.range
        within = (1, 2, 5) if high - low < 2.0 else (1,)
        values = [m * 10.0**k for k in range(math.floor(low), math.ceil(high) + 1) for m in within]
        shown = [v for v in values if low <= math.log10(v) <= high]
        # short texts, or those of a wide range would collide
        units = [(1e6, "M"), (1e3, "k"), (0.0, "")]
        texts = [next(f"{v / (a or 1.0):g}{u}" for a, u in units if v >= 9.0 * a) for v in shown]
        return tuple((math.log10(v), text) for v, text in zip(shown, texts, strict=True))

    @property
    def shown(self) -> tuple[float, str]:
        """What its value is multiplied by, and the unit, to be read."""
        return SHOWN_UNITS.get(self.unit, (1.0, self.unit))

    def text(self, value: float) -> str:
        """Its label, and a value with its unit."""
        factor, unit = self.shown
        return f"{self.label} " + with_minus(f"{factor * value:.3g} {unit}".rstrip())


class ViewerModel(Protocol):
    """Something to view: some cases, each with parameters of the same names."""

    title: str
    notes: tuple[str, ...]
    """Sentences to be read beside it."""
    cases: tuple[str, int]
    """What its cases are, in the singular, and how many there are."""
    initial: ViewerScene | None
    """What is known before anything is simulated."""

    def parameters(self, case: int) -> tuple[SliderParameter, ...]: ...

    def simulate(
        self, case: int, values: Mapping[str, float], go_on: Callable[[], None]
    ) -> Iterator[ViewerScene]:
        """One or more scenes, each more complete than the one before.

        Args:
            case: Its number.
            values: Parameters by name.
            go_on: Called now and then; what it raises ends everything.

        Raises:
            GendomError: It cannot be simulated.
        """
        ...


def object_layer(
    name: str,
    body: Body,
    points: Array,
    lattice: tuple[int, int] | None,
    opacity: float = 1.0,
) -> Layer:
    """A simulated rope or cloth.

    Args:
        name: Of the layer.
        body: The object.
        points: [T, n, 3] a rope's centre line, or a cloth's middle surface, row by row [m].
        lattice: A cloth's rows and points in a row; None: a rope.
        opacity: Below 1 where something else is to be seen through it.
    """
    faces, closed, radius = NO_FACES, False, 0.5 * body.thickness
    if lattice is not None:
        faces = lattice_triangles(*lattice)
    elif points.shape[1] == len(body.points):
        points = body.surface(points)
        faces, closed = tube_faces(points.shape[1] // RING, RING), True
    else:  # the sections of particles
        points = np.stack([points[:, :-1], points[:, 1:]], axis=-2)
    return Layer(
        name=name, color=SIMULATED_COLOR, points=list(points), faces=faces, closed=closed,
        radius=radius, opacity=opacity,
    )  # fmt: skip


def goal_layer(mark: Array, size: float) -> Layer:
    """A goal [n, 3] [m] of a scene of some size [m]: an upright line, or a dot, since a line that
    ends where it begins is not drawn."""
    thick, points = (0.006, mark[None]) if len(mark) == 2 else (0.008, mark)
    return Layer(name="goal", color=GOAL_COLOR, points=[points], radius=thick * size)


def gripper_layer(position: Array, size: float, axis: Array | None = None) -> Layer:
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
    color = "#" + "".join(f"{c:02x}" for c in INK)
    lines = list(np.concatenate(ends, axis=1))
    return Layer(name="gripper", color=color, points=lines, radius=0.012 * size)


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


def square_size(scene: ViewerScene) -> float:
    """Side of the squares of a scene's table [m]."""
    low, high = scene.box
    return nice_step(float((high - low)[:2].max()) / _SQUARES)


def camera_of(scene: ViewerScene) -> tuple[Array, Array]:
    """Where the camera stands and what it looks at, [3] each [m]: at the broad side of what is
    shown, from a little above, so that a window as wide as high shows all."""
    low, high = scene.box
    middle, (x, y, _) = 0.5 * (low + high), high - low
    turn = (-0.5 * math.pi if x >= y else 0.0) + _TURN
    towards = np.array([math.cos(turn), math.sin(turn), 0.0])
    direction = math.cos(_TILT) * towards + math.sin(_TILT) * np.array([0.0, 0.0, 1.0])
    radius = 0.5 * float(np.linalg.norm(high - low)) + 1e-3
    away = 1.05 * radius / math.sin(0.5 * FIELD_OF_VIEW)
    return middle + away * direction, middle


def table_ends(scene: ViewerScene) -> tuple[Array, Array]:
    """Corners [2] of a scene's table with least and with most x and y, on its grid [m]."""
    step = square_size(scene)
    low = np.floor(scene.box[0, :2] / step - 2.0) * step
    return low, np.ceil(scene.box[1, :2] / step + 2.0) * step


def tiles_of(scene: ViewerScene) -> Array:
    """[S, 4, 3] corners of the squares of a scene's table, none without a table [m]."""
    if scene.table_height is None:
        return np.empty((0, 4, 3))
    step, (low, high) = square_size(scene), table_ends(scene)
    x, y = (np.arange(low[a], high[a] - 0.5 * step, step) for a in (0, 1))
    at = np.stack(np.meshgrid(x, y))
    corner = np.stack([*at.reshape(2, -1), np.full(at[0].size, scene.table_height)], axis=1)
    return corner[:, None] + step * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


def obstacle_layer(name: str, obstacle: Obstacle, times: Array) -> Layer:
    """A rigid obstacle at times [T] [s]: a cube of small squares, pressed onto its surface."""
    half, reach = obstacle.core
    turn = np.tan(np.linspace(0.0, 0.25 * math.pi, 5))[1:]
    lines = []
    for h in half.tolist():
        inner = np.linspace(-h, h, 5) if h > 0.0 else np.zeros(1)
        outer = h + reach * turn if reach > 0.0 else np.zeros(0)
        lines.append(np.concatenate([-outer[::-1], inner, outer]))
    points, faces, count = [], [], 0
    for axis in range(3):
        u, v = lines[axis - 2], lines[axis - 1]
        for side in (-1.0, 1.0):
            face = np.empty((len(u), len(v), 3))
            face[..., axis] = side * (half[axis] + reach)
            face[..., axis - 2], face[..., axis - 1] = np.meshgrid(u, v, indexing="ij")
            points.append(face.reshape(-1, 3))
            turned = lattice_triangles(len(u), len(v))[:, :: -int(side)]
            faces.append(count + turned)
            count += len(u) * len(v)
    x = np.concatenate(points)
    core = np.clip(x, -half, half)
    away = x - core
    x = core + reach * away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
    moves = len(np.atleast_1d(obstacle.time)) > 1
    poses = [obstacle.pose_at(float(t)) for t in (times if moves else times[:1])]
    shown = [centre + turned.apply(x) for centre, turned in poses]
    skin = {"faces": np.concatenate(faces), "closed": True}
    return Layer(name=name, color=OBSTACLE_COLOR, points=shown, **skin)
