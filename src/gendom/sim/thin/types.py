"""What the thin engine's kernels take: structs of arrays, made for one scalar type.

Shapes: W worlds, G grippers, n points, P numbers of a row: the points between two margins, so that
kernels may read beyond both ends and several points at once. Names of rows are in ``native/rod.h``
and ``native/rod_adjoint.h``.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

MARGIN = 8
"""Numbers of a row before its first point."""

X, V, Q, SPIN, LAG = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13), slice(13, 19)
"""Components of a state: positions [m], velocities [m/s], directions (quaternions, scalar last),
spins [rad/s], and the lagged strains of edges and joints."""

STATE, STATE_BARS, MODEL_BARS, SCRATCH, SCRATCH_BARS = 19, 18, 21, 12, 18
"""Components of states, of derivatives by them and by the model, and of both scratches."""

X_BAR, V_BAR, Q_BAR, SPIN_BAR = (slice(3 * k, 3 * k + 3) for k in range(4))
"""Components of derivatives by a state; those by directions are by turns in the world's axes."""


def row_length(points: int) -> int:
    """P for so many points."""
    return MARGIN + -(-points // 8) * 8 + MARGIN


def in_rows(values: NDArray[np.floating], points: int, fill: float = 0.0) -> NDArray[np.floating]:
    """[..., P] rows of values [..., n] (or fewer than n)."""
    rows = np.full((*values.shape[:-1], row_length(points)), fill)
    rows[..., MARGIN : MARGIN + values.shape[-1]] = values
    return rows


@dataclass(frozen=True)
class Types:
    """Vectors and structs of one scalar type."""

    real: Any
    vec3: Any
    quat: Any
    Rod: Any
    Bars: Any
    Plan: Any


@functools.cache
def make_types(real: Any) -> Types:
    """The types for ``wp.float32`` or ``wp.float64``."""
    vec3 = wp.types.vector(3, real)
    quat = wp.quatf if real == wp.float32 else wp.quatd

    @wp.struct
    class Rod:
        """W rods, and what surrounds them."""

        points: int
        rest: wp.array3d(dtype=real)  # [1, 7, P] 1 / length of edges [1/m], strains free of stress
        stiffness: wp.array3d(dtype=real)  # [W, 6, P] of edges [N], of joints over length [N m]
        inertia: wp.array3d(dtype=real)  # [W, 4, P] see ``native/rod.h``
        scratch: wp.array3d(dtype=real)  # [W, 12, P]
        damping: wp.array(dtype=real)  # [W] [s]
        velocity_damping: wp.array(dtype=real)  # [W] [1/s]
        friction: wp.array(dtype=real)  # [W]
        gravity: wp.array(dtype=vec3)  # [W] [m/s^2]
        table: int  # at height 0
        radius: real  # height of a point on the table [m]
        walls: int
        box_lower: vec3
        box_upper: vec3
        holds: wp.array3d(dtype=wp.int32)  # [W, G, n] 1: a point is held, 2: an edge's direction is
        place: wp.array3d(dtype=real)  # [W G, 7, P] of those, as seen from the gripper

    @wp.struct
    class Bars:
        """Derivatives of a loss; those by the model are by each point's share of it."""

        state: wp.array3d(dtype=real)  # [W, 18, P]
        model: wp.array3d(dtype=real)  # [W, 21, P]
        scratch: wp.array3d(dtype=real)  # [W, 18, P]
        place: wp.array3d(dtype=real)  # [W G, 6, P]
        centre: wp.array2d(dtype=vec3)  # [W, G] of one step
        turn: wp.array2d(dtype=vec3)  # [W, G] of one step

    @wp.struct
    class Plan:
        """What W worlds do one after the other: pieces of equal steps."""

        begins: wp.array2d(dtype=wp.float64)  # [W, S] [s]
        steps: wp.array2d(dtype=wp.int32)  # [W, S]
        dt: wp.array2d(dtype=wp.float64)  # [W, S] [s]
        frame: wp.array2d(dtype=wp.int32)  # [W, S] recorded at its end; -1: none

    return Types(real=real, vec3=vec3, quat=quat, Rod=Rod, Bars=Bars, Plan=Plan)
