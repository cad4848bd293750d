"""The grid's columns: contiguous runs of nodes along z around the particles of one world.

Memory and work follow the object: a column exists where particles are, and holds the nodes
between the lowest and the highest that they reach, with room for a quarter of a cell of travel.
Node k of column (i, j) is number ``start[i, j] + k``. A layout is one such numbering.

Shapes: L layouts, X x Y grid columns, M grid nodes.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

MARGIN = 0.25
"""How far a particle may travel, in cells, before the grid's columns are laid anew."""

EMPTY_BELOW = 1 << 20
"""Lower end of the node range of a column without nodes."""

CELL_BITS = 10
"""Bits of a packed node index inside the window, one group an axis."""

CELL_MASK = (1 << CELL_BITS) - 1
"""Mask of the second index."""


@functools.cache
def make_columns(real: Any) -> SimpleNamespace:
    """Build the functions that number the nodes, for one scalar type.

    Returns:
        Namespace with ``forget_bounds``, ``locate_particle``, ``mark_particle``, to be called
        in this order over all particles, then ``lay_columns``, or ``lay_column`` for each.
    """
    vec3 = wp.types.vector(3, real)

    @wp.func
    def forget_bounds(layout: int, bounds_out: wp.array2d(dtype=wp.int32)):
        bounds_out[layout, 0] = EMPTY_BELOW
        bounds_out[layout, 1] = EMPTY_BELOW
        bounds_out[layout, 2] = -EMPTY_BELOW
        bounds_out[layout, 3] = -EMPTY_BELOW

    @wp.func
    def locate_particle(
        layout: int,
        x: vec3,
        inv_dx: real,
        bounds_out: wp.array2d(dtype=wp.int32),  # [L, 4] lowest and highest cell in x, y
    ):
        lo = x * inv_dx - vec3(real(0.5 + MARGIN))
        hi = x * inv_dx - vec3(real(0.5 - MARGIN))
        wp.atomic_min(bounds_out, layout, 0, int(wp.floor(lo[0])))
        wp.atomic_min(bounds_out, layout, 1, int(wp.floor(lo[1])))
        wp.atomic_max(bounds_out, layout, 2, int(wp.floor(hi[0])) + 2)
        wp.atomic_max(bounds_out, layout, 3, int(wp.floor(hi[1])) + 2)

    @wp.func
    def mark_particle(
        layout: int,
        x: vec3,
        inv_dx: real,
        z0: real,
        bounds: wp.array2d(dtype=wp.int32),
        low_out: wp.array3d(dtype=wp.int32),  # [L, X, Y] lowest node of the column
        high_out: wp.array3d(dtype=wp.int32),  # [L, X, Y] highest node of the column
    ):
        y = vec3(x[0], x[1], x[2] - z0)
        lo = y * inv_dx - vec3(real(0.5 + MARGIN))
        hi = y * inv_dx - vec3(real(0.5 - MARGIN))
        i0 = int(wp.floor(lo[0])) - bounds[layout, 0]
        j0 = int(wp.floor(lo[1])) - bounds[layout, 1]
        i1 = int(wp.floor(hi[0])) + 2 - bounds[layout, 0]
        j1 = int(wp.floor(hi[1])) + 2 - bounds[layout, 1]
        k0 = int(wp.floor(lo[2]))
        k1 = int(wp.floor(hi[2])) + 2
        if i0 >= 0 and j0 >= 0 and i1 < low_out.shape[1] and j1 < low_out.shape[2]:
            for i in range(i0, i1 + 1):
                for j in range(j0, j1 + 1):
                    wp.atomic_min(low_out, layout, i, j, k0)
                    wp.atomic_max(high_out, layout, i, j, k1)

    @wp.func
    def lay_column(
        layout: int,
        i: int,
        j: int,
        first: int,
        low: wp.array3d(dtype=wp.int32),
        high: wp.array3d(dtype=wp.int32),
        start_out: wp.array3d(dtype=wp.int32),  # [L, X, Y] node k is number start + k
        cell_out: wp.array2d(dtype=wp.int32),  # [L, M] packed column of each node
        level_out: wp.array2d(dtype=wp.int32),  # [L, M] k of each node
    ):
        """Number a column's nodes from ``first`` on; returns 1 where there is no room for them."""
        k0 = low[layout, i, j]
        k1 = high[layout, i, j]
        start_out[layout, i, j] = first - k0
        full = int(0)
        if k0 <= k1:
            if first + k1 - k0 < cell_out.shape[1]:
                for k in range(k0, k1 + 1):
                    cell_out[layout, first + k - k0] = (i << CELL_BITS) | j
                    level_out[layout, first + k - k0] = k
            else:
                full = 1
        return full

    @wp.func
    def lay_columns(
        layout: int,
        bounds: wp.array2d(dtype=wp.int32),
        low: wp.array3d(dtype=wp.int32),
        high: wp.array3d(dtype=wp.int32),
        start_out: wp.array3d(dtype=wp.int32),
        cell_out: wp.array2d(dtype=wp.int32),
        level_out: wp.array2d(dtype=wp.int32),
        count_out: wp.array(dtype=wp.int32),  # [L] nodes in use
    ):
        """Number the nodes of a layout; the count may exceed the room for them."""
        X = bounds[layout, 2] - bounds[layout, 0] + 1
        Y = bounds[layout, 3] - bounds[layout, 1] + 1
        n = int(0)
        for i in range(X):
            for j in range(Y):
                lay_column(layout, i, j, n, low, high, start_out, cell_out, level_out)
                n += wp.max(0, high[layout, i, j] - low[layout, i, j] + 1)
        count_out[layout] = n

    return SimpleNamespace(
        forget_bounds=forget_bounds,
        locate_particle=locate_particle,
        mark_particle=mark_particle,
        lay_column=lay_column,
        lay_columns=lay_columns,
    )
