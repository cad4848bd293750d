"""The grid's columns: contiguous runs of nodes along z around the particles of one world.

Memory and work follow the object: a column exists where particles are, and holds the nodes
between the lowest and the highest that they reach, with room for half a cell of travel.
Node k of column (i, j) is number ``start[i, j] + k``. A layout is one such numbering.

Shapes: L layouts, X x Y grid columns, M grid nodes.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

MARGIN = 0.5
"""How far a particle may travel, in cells, before the grid's columns are laid anew."""

EMPTY_BELOW = 1 << 20
"""Lower end of the node range of a column without nodes."""

CELL_BITS = 10
"""Bits of a packed node index inside the window, one group an axis."""

CELL_MASK = (1 << CELL_BITS) - 1
"""Mask of the second index."""

LARGEST_GRID = 1 << 24
"""Nodes a world may use; a run that wants more has an object that flies apart."""


@wp.struct
class Columns:
    """L layouts, as kernels take them."""

    bounds: wp.array2d(dtype=wp.int32)  # [L, 4] lowest and highest cell in x, y
    low: wp.array3d(dtype=wp.int32)  # [L, X, Y] lowest node of the column
    high: wp.array3d(dtype=wp.int32)  # [L, X, Y] highest node of the column
    start: wp.array3d(dtype=wp.int32)  # [L, X, Y] node k is number start + k
    cell: wp.array2d(dtype=wp.int32)  # [L, M] packed column of each node
    level: wp.array2d(dtype=wp.int32)  # [L, M] k of each node
    count: wp.array(dtype=wp.int32)  # [L] nodes in use


@dataclass(frozen=True)
class Grid:
    """Columns and what stands on their nodes."""

    columns: Any
    """``Columns`` of L layouts."""
    layout_of: wp.array
    """[S] the layout of each recorded substep."""
    momentum: wp.array
    """[S, M] momentum and mass, or velocity and mass."""


class GridExhausted(Exception):
    """The object spreads over more nodes than any real one does."""


def room_for(x: NDArray[np.floating], dx: float) -> tuple[int, int, int]:
    """Columns in x and y and nodes that the first grid of particles x [W, N, 3] offers.

    A body may turn any way without needing more columns.
    """
    extent = (x.max(axis=1) - x.min(axis=1)).max(axis=0) / dx
    side = int(np.ceil(np.linalg.norm(extent))) + 8
    cell = np.floor(x[0] / dx).astype(np.int64)
    cell -= cell.min(axis=0)
    cells = len(np.unique(np.ravel_multi_index(tuple(cell.T), tuple(cell.max(axis=0) + 1))))
    return min(side, 1 << CELL_BITS), min(side, 1 << CELL_BITS), 8 * cells + 256


def grown_room(
    room: tuple[int, int, int], bounds: NDArray[Any], grid: Grid
) -> tuple[int, int, int]:
    """Room for the bounds [L, 4] for which the grid was too small.

    Raises:
        GridExhausted: If that is more than any object needs.
    """
    window = (bounds[:, 2:] - bounds[:, :2] + 1).max(axis=0)
    X, Y, M = room
    have = grid.columns.low.shape[1:]
    limit = 1 << CELL_BITS
    if window.max() > limit or M > LARGEST_GRID:
        raise GridExhausted
    if window[0] > have[0] or window[1] > have[1]:
        X = max(X, min(limit, int(window[0]) + 8))
        Y = max(Y, min(limit, int(window[1]) + 8))
    else:
        M = max(M, 2 * grid.momentum.shape[1])
    return X, Y, M


def make_grid(
    room: tuple[int, int, int],
    layouts: int,
    node: Any,
    device: Any,
    *,
    rows: int | None = None,
    make: Any = wp.zeros,
) -> Grid:
    """A grid of so many layouts, and of so many rows of nodes (default: one a layout).

    ``node`` is the type of a node's value, ``make`` fills arrays.
    """
    X, Y, M = room
    rows = layouts if rows is None else rows

    def array(shape: Any, dtype: Any = wp.int32) -> wp.array:
        return make(shape, dtype=dtype, device=device)

    columns = Columns()
    columns.bounds = array((layouts, 4))
    columns.low = array((layouts, X, Y))
    columns.high = array((layouts, X, Y))
    columns.start = array((layouts, X, Y))
    columns.cell = array((layouts, M))
    columns.level = array((layouts, M))
    columns.count = array(layouts)
    return Grid(columns, array(rows), array((rows, M), node))


@functools.cache
def make_columns(real: Any) -> SimpleNamespace:
    """Build the functions that number the nodes, for one scalar type.

    Returns:
        Namespace with ``forget_bounds``, ``locate_particle``, ``empty_column``, ``mark_particle``,
        ``lay_column``, to be called in this order over all particles or columns; and ``reach``,
        ``widen_bounds`` and ``mark_box``, which do for several particles together what those for
        one do.
    """
    vec3 = wp.types.vector(3, real)

    @wp.func
    def forget_bounds(layout: int, columns: Columns):
        columns.bounds[layout, 0] = EMPTY_BELOW
        columns.bounds[layout, 1] = EMPTY_BELOW
        columns.bounds[layout, 2] = -EMPTY_BELOW
        columns.bounds[layout, 3] = -EMPTY_BELOW

    @wp.func
    def reach(x: vec3, inv_dx: real, z0: real):
        """Lowest and highest node [cells] of a particle that may yet travel by the margin."""
        y = vec3(x[0], x[1], x[2] - z0) * inv_dx
        below = real(-MARGIN) - real(0.5)
        above = real(MARGIN) - real(0.5)
        lower = wp.vec3i(
            int(wp.floor(y[0] + below)), int(wp.floor(y[1] + below)), int(wp.floor(y[2] + below))
        )
        upper = wp.vec3i(
            int(wp.floor(y[0] + above)) + 2,
            int(wp.floor(y[1] + above)) + 2,
            int(wp.floor(y[2] + above)) + 2,
        )
        return lower, upper

    @wp.func
    def widen_bounds(layout: int, lower: wp.vec3i, upper: wp.vec3i, columns: Columns):
        wp.atomic_min(columns.bounds, layout, 0, lower[0])
        wp.atomic_min(columns.bounds, layout, 1, lower[1])
        wp.atomic_max(columns.bounds, layout, 2, upper[0])
        wp.atomic_max(columns.bounds, layout, 3, upper[1])

    @wp.func
    def locate_particle(layout: int, x: vec3, inv_dx: real, columns: Columns):
        lower, upper = reach(x, inv_dx, real(0.0))
        widen_bounds(layout, lower, upper, columns)

    @wp.func
    def mark_box(layout: int, lower: wp.vec3i, upper: wp.vec3i, columns: Columns):
        """Let columns hold all nodes of a box, unless the layout has no room for it."""
        i0 = lower[0] - columns.bounds[layout, 0]
        j0 = lower[1] - columns.bounds[layout, 1]
        i1 = upper[0] - columns.bounds[layout, 0]
        j1 = upper[1] - columns.bounds[layout, 1]
        if i0 >= 0 and j0 >= 0 and i1 < columns.low.shape[1] and j1 < columns.low.shape[2]:
            for i in range(i0, i1 + 1):
                for j in range(j0, j1 + 1):
                    wp.atomic_min(columns.low, layout, i, j, lower[2])
                    wp.atomic_max(columns.high, layout, i, j, upper[2])

    @wp.func
    def mark_particle(layout: int, x: vec3, inv_dx: real, z0: real, columns: Columns):
        lower, upper = reach(x, inv_dx, z0)
        mark_box(layout, lower, upper, columns)

    @wp.func
    def empty_column(layout: int, i: int, j: int, columns: Columns):
        columns.low[layout, i, j] = EMPTY_BELOW
        columns.high[layout, i, j] = -EMPTY_BELOW

    @wp.func
    def lay_column(layout: int, i: int, j: int, columns: Columns):
        """Number a column's nodes; returns 1 where there is no room for them.

        In any order of columns: sums do not depend on a node's number. The count may exceed the
        room.
        """
        k0 = columns.low[layout, i, j]
        k1 = columns.high[layout, i, j]
        first = wp.atomic_add(columns.count, layout, wp.max(0, k1 - k0 + 1))
        columns.start[layout, i, j] = first - k0
        full = int(0)
        if k0 <= k1:
            if first + k1 - k0 < columns.cell.shape[1]:
                for k in range(k0, k1 + 1):
                    columns.cell[layout, first + k - k0] = (i << CELL_BITS) | j
                    columns.level[layout, first + k - k0] = k
            else:
                full = 1
        return full

    return SimpleNamespace(
        forget_bounds=forget_bounds,
        reach=reach,
        widen_bounds=widen_bounds,
        mark_box=mark_box,
        locate_particle=locate_particle,
        mark_particle=mark_particle,
        empty_column=empty_column,
        lay_column=lay_column,
    )
