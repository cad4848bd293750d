"""Structs of arrays for the thin engine's kernels, made for one scalar type.

Shapes: W worlds, G grippers, n points, P numbers in a row. Points are stored in slots between
margins, so that kernels can read beyond both ends, and several points at once. Components of rows
are named in ``native/rod.h``, ``native/shell.h`` and their adjoints.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from gendom.arrays import Array
from gendom.sim.paths import make_path_type

MARGIN = 8
"""Length of the margin at the start of a row."""

X, V = slice(0, 3), slice(3, 6)
"""Components of states and of derivatives by states: positions [m] and velocities [m/s]."""

Q, SPIN = slice(6, 10), slice(10, 13)
"""Components of a rod's state: directions (quaternions, scalar last) and spins [rad/s]."""

PER_MASS, DRAG, GRAVITY, DAMPING, FRICTION, VELOCITY_DAMPING = 12, 13, slice(15, 18), 18, 19, 20
SELF_FRICTION, RADIUS, DISTANCE = 21, 22, 23
"""Components of derivatives by the model that are common to rods and shells."""

PER_TURN = 14
"""That of rods only: by 1 / inertia of edges."""

TURN_BAR, SPIN_BAR = slice(6, 9), slice(9, 12)
"""Components of derivatives by a rod's state: by rotations of directions, and by spins."""

MODEL_ROWS = 24
"""Components of derivatives by the model; then come those by each obstacle's friction."""


class Coefficients(NamedTuple):
    """Numbers of W bodies of n points that follow from their parameters; without grippers."""

    stiffness: Array
    """[W, R, n]."""
    mass: Array
    """[W, n] of points [kg]."""
    inertia: Array
    """[W, n] of a rod's edges [kg m^2]; of shells 0."""
    drag: Array
    """[W, n] of points over the density of the air."""


def parameters_of(thickness: ArrayLike, materials: Mapping[str, Array]) -> dict[str, Array]:
    """[W, 1] parameters that ``coefficients`` of a model follow from, by name, from those of
    materials [W]."""
    found = {name: values[:, None] for name, values in materials.items()}
    return found | {"thickness": np.full((len(found["E"]), 1), thickness)}


def along(p: Mapping[str, Array]) -> Array:
    """[W, 1] Young's modulus along a rod or in a shell's plane [Pa]."""
    return np.where(np.isnan(p["membrane"]), p["E"], p["membrane"])


@dataclass(frozen=True)
class Lines:
    """Lines of points along which a body bends: a rod itself, rows or columns of a shell."""

    index: NDArray[np.int64]
    """[L, k] points of each line."""
    length: Array
    """[k - 1] of edges at rest [m]."""
    least: float
    """Least length represented by a joint at a gripper's border, over its usual length."""

    def of(self, values: Array) -> Array:
        """Values of points [W, n, ...] along the lines of all worlds, [W L, k, ...]."""
        return values[:, self.index].reshape(-1, self.index.shape[1], *values.shape[2:])

    def points(self, values: Array) -> Array:
        """Inverse of ``of``."""
        worlds, more = len(values) // len(self.index), values.shape[2:]
        found = np.empty((worlds, self.index.size, *more), values.dtype)
        found[:, self.index] = values.reshape(worlds, *self.index.shape, *more)
        return found


@functools.cache
def make_types(real: Any) -> SimpleNamespace:
    """Make vector types and structs for ``wp.float32`` or ``wp.float64``."""
    vec3 = wp.types.vector(3, real)
    quat = wp.quatf if real == wp.float32 else wp.quatd
    Paths = make_path_type(real)

    @wp.struct
    class ThinModel:
        """W rods or shells, and their surroundings."""

        points: int
        slot: wp.array(dtype=wp.int32)  # [n] of each point in a row
        # for shells: stride between rows, 0 for rods; index of the first point, and after the last
        pitch: int
        first: int
        end: int
        per_x: real  # 1 / spacing along rows [1/m]
        per_y: real
        rest: wp.array3d(dtype=real)  # [W or 1, ., P] shape, and stress-free strains
        stiffness: wp.array3d(dtype=real)  # [W, ., P]
        inertia: wp.array3d(dtype=real)  # [W, ., P]
        scratch: wp.array3d(dtype=real)  # [W, ., P]
        interleaved: wp.array2d(dtype=real)  # [W, .], see ``native/interleaved.h``
        damping: wp.array(dtype=real)  # [W] [s]
        velocity_damping: wp.array(dtype=real)  # [W] [1/s]
        friction: wp.array(dtype=real)  # [W]
        gravity: wp.array(dtype=vec3)  # [W] [m/s^2]
        table: int  # at height 0
        radius: real  # height of a point on the table [m]
        obstacles: wp.array3d(dtype=real)  # [W, O, .], see ``native/surroundings.h``
        obstacle_paths: Paths
        holds: wp.array3d(dtype=wp.int32)  # [W, G, n] 1: a point is held, 2: an edge's direction is
        place: wp.array3d(dtype=real)  # [W G, 7, P] of those, in the gripper's frame
        # contact with itself
        contact: int
        contact_distance: real  # between centre lines or middle surfaces [m]
        contact_margin: real  # of the list of pairs [m]
        contact_apart: int  # of rods: smallest number of points between parts in self-contact
        contact_most_turns: int  # over the contacts of a step
        self_friction: wp.array(dtype=real)  # [W]
        loose: wp.array3d(dtype=real)  # [W, 1, P] 1 / mass of free points, 0 for held ones [1/kg]
        push: wp.array3d(dtype=real)  # [W, 10, P] of one step's contacts, see ``native/contact.h``
        listed: wp.array3d(dtype=real)  # [W, 3, P] where points were when pairs were listed [m]
        boxes: wp.array3d(dtype=real)  # [W, 13, P] around features then [m], and more
        near: wp.array3d(dtype=wp.int32)  # [W, M, 2] pairs
        close: wp.array3d(dtype=wp.int32)  # [W, M, 2] that a step's turns go over
        touching: wp.array3d(dtype=wp.int32)  # [W, M, 2] that a turn pushes apart
        pair_counts: wp.array3d(dtype=wp.int32)  # [W, 3, 2] from the front and from the back

    @wp.struct
    class ModelAdjoint:
        """Derivatives of a loss; those by the model are for each point's contribution."""

        state: wp.array3d(dtype=real)  # [W, ., P]
        model: wp.array3d(dtype=real)  # [W, MODEL_ROWS + O, P]
        scratch: wp.array3d(dtype=real)  # [W, ., P]
        place: wp.array3d(dtype=real)  # [W G, 6, P]
        position: wp.array3d(dtype=wp.vec3d)  # [W, G, K] by grippers' knots
        path_turn: wp.array3d(dtype=wp.vec3d)  # [W, G, K] by a rotation of them, in world axes
        centre: wp.array2d(dtype=vec3)  # [W, G] of one step
        turn: wp.array2d(dtype=vec3)  # [W, G] of one step

    @wp.struct
    class ThinRun:
        """A run of W worlds: pieces of equal steps, which of them are next, and what is kept."""

        begins: wp.array2d(dtype=wp.float64)  # [W, S] start of the piece's interval [s]
        done: wp.array2d(dtype=wp.int32)  # [W, S] steps of that interval before the piece
        steps: wp.array2d(dtype=wp.int32)  # [W, S]
        dt: wp.array2d(dtype=wp.float64)  # [W, S] [s]
        before: wp.array2d(dtype=wp.float64)  # [W, S] length of the step before; 0 at a start [s]
        frame: wp.array2d(dtype=wp.int32)  # [W, S] recorded at its end; -1: none
        piece: wp.array2d(dtype=wp.int32)  # [W, 2] the next, and the one after the last
        # of a step, if any: when it begins and ends [s]; it is divided when it is taken
        span: wp.array(dtype=wp.float64)
        substep: wp.array(dtype=wp.float64)  # [W] the longest [s]
        # step k of a piece goes from row w + k stride - offset to the next; stride 0: in place
        offset: int
        stride: int
        state: wp.array3d(dtype=real)
        # [W + pieces * every] states at the start of pieces; with LISTED more components they, and
        # the states of a stride, tell what the list of pairs was made from
        kept: wp.array3d(dtype=real)
        every: int  # -1: none are kept
        stopped: wp.array(dtype=wp.int32)  # [W] the piece in which a world exceeded a limit, or -1
        stopped_at: wp.array(dtype=wp.float64)  # [W] when [s]
        frames: wp.array3d(dtype=vec3)  # [T, W, K]
        points: wp.array(dtype=wp.int32)  # [K] recorded

    return SimpleNamespace(
        vec3=vec3, quat=quat, ThinModel=ThinModel, ModelAdjoint=ModelAdjoint, ThinRun=ThinRun
    )
