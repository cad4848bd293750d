"""The sparse grid: contiguous runs of nodes along z, a column for each (x, y) near a particle.

Memory and work follow the object: a column exists where particles are, and holds the nodes
between the lowest and the highest that they reach, with room for half a cell of travel. Node k of
column (i, j) is number ``start[i, j] + k``. A layout is one such numbering; it is rebuilt when a
particle may have left it.

Shapes: L layouts, X x Y grid columns, M grid nodes.
"""

import functools
from typing import Any

import numpy as np
import warp as wp

from gendom.arrays import Array
from gendom.sim.mpm.block import make_block
from gendom.sim.mpm.particles import Variant, make_moving
from gendom.sim.mpm.types import make_types

MARGIN = 0.5
"""Largest distance [cells] that a particle may travel before the grid is rebuilt."""

EMPTY_BELOW = 1 << 20
"""Lower end of the node range of a column without nodes."""

WIDEST_WINDOW = 1 << 10
"""Columns along x or y that a world may span."""

LARGEST_GRID = 1 << 24
"""Maximum number of nodes of a world; a run that needs more has diverged."""


def room_for(x: Array, dx: float) -> tuple[int, int, int]:
    """Columns in x and y and nodes that the first grid of particles x [W, N, 3] offers.

    A body may turn any way without needing more columns.
    """
    extent = (x.max(axis=1) - x.min(axis=1)).max(axis=0) / dx
    side = int(np.ceil(np.linalg.norm(extent))) + 8
    cell = np.floor(x[0] / dx).astype(np.int64)
    cell -= cell.min(axis=0)
    cells = len(np.unique(np.ravel_multi_index(tuple(cell.T), tuple(cell.max(axis=0) + 1))))
    return min(side, WIDEST_WINDOW), min(side, WIDEST_WINDOW), 8 * cells + 256


def grown_room(room: tuple[int, int, int], bounds: Array, grid: Any) -> tuple[int, int, int] | None:
    """Room for the bounds [4] for which the grid was too small; None if that is more than any
    object needs."""
    window = bounds[2:] - bounds[:2] + 1
    X, Y, M = room
    have = grid.low.shape[1:]
    if window.max() > WIDEST_WINDOW or M > LARGEST_GRID:
        return None
    if window[0] > have[0] or window[1] > have[1]:
        X = max(X, min(WIDEST_WINDOW, int(window[0]) + 8))
        Y = max(Y, min(WIDEST_WINDOW, int(window[1]) + 8))
    else:
        M = max(M, 2 * grid.momentum.shape[1])
    return X, Y, M


@functools.cache
def make_rebuild(variant: Variant) -> Any:
    """Build ``rebuild``, with which the threads of a block rebuild a world's layout."""
    real = variant.real
    position, sync = make_moving(variant).x, make_block(real).sync
    types = make_types(real)
    vec3, Substep, Grid, Records = types.vec3, types.Substep, types.Grid, types.Records

    @wp.func
    def reach(now: Substep, x: vec3):
        """Lowest and highest node [cells] of a particle that may yet travel by the margin."""
        y = x * now.inv_dx
        below = real(-MARGIN) - real(0.5)
        above = real(MARGIN) - real(0.5)
        lower = wp.vec3i()
        upper = wp.vec3i()
        for a in range(3):
            lower[a] = int(wp.floor(y[a] + below))
            upper[a] = int(wp.floor(y[a] + above)) + 2
        return lower, upper

    @wp.func
    def mark(now: Substep, lower: wp.vec3i, upper: wp.vec3i, grid: Grid):
        """Let columns hold all nodes of a box, unless the layout has no room for it."""
        i0 = lower[0] - grid.bounds[now.layout, 0]
        j0 = lower[1] - grid.bounds[now.layout, 1]
        i1 = upper[0] - grid.bounds[now.layout, 0]
        j1 = upper[1] - grid.bounds[now.layout, 1]
        if i0 >= 0 and j0 >= 0 and i1 < grid.low.shape[1] and j1 < grid.low.shape[2]:
            for i in range(i0, i1 + 1):
                for j in range(j0, j1 + 1):
                    wp.atomic_min(grid.low, now.layout, i, j, lower[2])
                    wp.atomic_max(grid.high, now.layout, i, j, upper[2])

    @wp.func
    def rebuild(now: Substep, particles: Records, grid: Grid):
        """Return whether the layout has room for the particles of a row."""
        if now.thread == 0:
            grid.count[now.layout] = 0
            for a in range(2):
                grid.bounds[now.layout, a] = EMPTY_BELOW
                grid.bounds[now.layout, a + 2] = -EMPTY_BELOW
        sync()
        lower, upper = reach(now, position(particles, now.w, now.thread % now.N))
        for i in range(now.thread, now.N, now.threads):
            low, high = reach(now, position(particles, now.w, i))
            lower = wp.min(lower, low)
            upper = wp.max(upper, high)
        for a in range(2):
            wp.atomic_min(grid.bounds, now.layout, a, lower[a])
            wp.atomic_max(grid.bounds, now.layout, a + 2, upper[a])
        sync()
        X = grid.bounds[now.layout, 2] - grid.bounds[now.layout, 0] + 1
        Y = grid.bounds[now.layout, 3] - grid.bounds[now.layout, 1] + 1
        fits = X <= grid.low.shape[1] and Y <= grid.low.shape[2]
        if fits:
            for n in range(now.thread, X * Y, now.threads):
                grid.low[now.layout, n // Y, n % Y] = EMPTY_BELOW
                grid.high[now.layout, n // Y, n % Y] = -EMPTY_BELOW
            sync()
            # particles that follow each other mostly stand in one column
            begin = now.thread * now.N // now.threads
            lower, upper = reach(now, position(particles, now.w, begin % now.N))
            for i in range(begin, (now.thread + 1) * now.N // now.threads):
                low, high = reach(now, position(particles, now.w, i))
                if wp.abs(low[0] - lower[0]) + wp.abs(low[1] - lower[1]) > 1:
                    mark(now, lower, upper, grid)
                    lower = low
                    upper = high
                lower = wp.min(lower, low)
                upper = wp.max(upper, high)
            mark(now, lower, upper, grid)
            sync()
            # columns are numbered in any order: sums do not depend on it; the count may exceed room
            for n in range(now.thread, X * Y, now.threads):
                k0 = grid.low[now.layout, n // Y, n % Y]
                k1 = grid.high[now.layout, n // Y, n % Y]
                first = wp.atomic_add(grid.count, now.layout, wp.max(0, k1 - k0 + 1))
                grid.start[now.layout, n // Y, n % Y] = first - k0
            sync()
            fits = grid.count[now.layout] <= grid.momentum.shape[1]
        return fits

    return rebuild
