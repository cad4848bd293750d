"""Particles as records for a block of threads: component by component, in the order of nodes.

Shapes: W worlds, N particles, L layouts of the grid, M nodes.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from gendom.sim.mpm.block import make_block, make_store, put_near
from gendom.sim.mpm.grid import SparseGrid
from gendom.sim.mpm.particles import Particles
from gendom.sim.mpm.transfer import make_transfer
from gendom.sim.mpm.types import Namespace, make_types

ORDERLY = 1.0
"""Largest distance [cells] that a particle may travel before the records are sorted again."""

X, V, C, PULLS, LOW = 0, 3, 6, 15, 24
"""First components of a record: position, velocity, affine velocity, pulls on the neighbours, what
rounding leaves out; then Z and G where bodies have them."""


@dataclass(frozen=True)
class Variant:
    """Parameters for which a kernel is compiled."""

    real: Any
    law: str
    yields: bool
    damped: bool
    room: int
    """Shared memory in which a block's particles stay [bytes]; 0: in arrays."""
    lanes: int
    """Threads of a block on CUDA."""

    @property
    def components(self) -> int:
        """Of a record."""
        return 27 + 6 * self.damped + 9 * self.yields

    @property
    def Z(self) -> int:
        """First component of Z."""
        return 27

    @property
    def G(self) -> int:
        """First component of G."""
        return 27 + 6 * self.damped

    @property
    def numbers(self) -> int:
        """That the room holds."""
        return max(1, self.room // (4 if self.real == wp.float32 else 8))

    @property
    def taped(self) -> int:
        """Components of a record on a tape: x, v, C, its momentum but for the table's, Z, G."""
        return 18 + 6 * self.damped + 9 * self.yields


@functools.cache
def make_records(real: Any, *, resident: bool) -> Particles:
    """Particles in records, as ``particles.make_rows``."""
    vector = make_store(real, resident=resident).vector

    @wp.struct
    class Records:
        """Particles of W worlds in order."""

        of: wp.array3d(dtype=real)  # [W, components, N], or [1, ...] if they are resident
        moduli: wp.array3d(dtype=real)  # [W, 2, N] mu, lam
        order: wp.array2d(dtype=wp.int32)  # [W, N] particle of each record
        place: wp.array2d(dtype=wp.int32)  # [W, N] record of each particle
        near: wp.array3d(dtype=wp.int32)  # [W, 3, N] records of its neighbours
        strayed: wp.array(dtype=real)  # [W] distance travelled since they were put in order [m]
        # scratch
        spare: wp.array3d(dtype=real)  # [W, components + 2, N]
        spare_order: wp.array2d(dtype=wp.int32)  # [W, N]
        tally: wp.array2d(dtype=wp.int32)  # [W, M]

    @wp.func
    def position(records: Records, w: int, i: int):
        return vector(records.of, w, X, i)

    @wp.func
    def x_of(records: Records, w: int, p: int):
        return vector(records.of, w, X, records.place[w, p])

    return Particles(Records, position, x_of)


@functools.cache
def make_tape(real: Any) -> Any:
    """The struct of recorded substeps."""

    @wp.struct
    class Tape:
        """S substeps of W worlds: substep n of world w has row n * W + w.

        Layout n of world w is number n * W + w; there may be fewer of them than substeps.
        """

        of: wp.array3d(dtype=real)  # [S * W, taped, N] records before the substep
        order: wp.array2d(dtype=wp.int32)  # [L, N] of each layout
        place: wp.array2d(dtype=wp.int32)  # [L, N]
        layout_of: wp.array(dtype=wp.int32)  # [S * W] row of each substep's layout

    return Tape


@functools.cache
def make_record_access(variant: Variant) -> Namespace:
    """Build what fills, orders and empties the records of a variant.

    Returns:
        Namespace with ``load`` and ``unload`` (from and to rows) and ``put_in_order``.
    """
    real = variant.real
    types = make_types(real)
    Matter = types.Matter
    Records = make_records(real, resident=variant.room > 0).Struct
    locate = make_transfer(real).locate
    store = make_store(real, resident=variant.room > 0)
    block = make_block(real)
    COMPONENTS, Z, G = map(wp.constant, (variant.components, variant.Z, variant.G))
    damped, plastic = wp.constant(int(variant.damped)), wp.constant(int(variant.yields))

    @wp.func
    def put_in_order(
        w: int, lane: int, lanes: int, layout: int, inv_dx: real, matter: Matter, grid: SparseGrid,
        records: Records,
    ):  # fmt: skip
        """Order a world's records by their lowest nodes."""
        of = records.of
        N = of.shape[2]
        nodes = grid.count[layout]
        begin = lane * nodes // lanes
        end = (lane + 1) * nodes // lanes
        for n in range(begin, end):
            records.tally[w, n] = 0
        block.meet()
        for i in range(lane, N, lanes):
            node, _f = locate(layout, store.vector(of, w, X, i), inv_dx, grid)
            n = grid.start[layout, node[0], node[1]] + node[2]
            wp.atomic_add(records.tally, w, n, 1)
        block.meet()
        total = int(0)
        for n in range(begin, end):
            total += records.tally[w, n]
        first = block.before(total)
        for n in range(begin, end):
            here = records.tally[w, n]
            records.tally[w, n] = first
            first += here
        block.meet()
        for i in range(lane, N, lanes):
            node, _f = locate(layout, store.vector(of, w, X, i), inv_dx, grid)
            n = grid.start[layout, node[0], node[1]] + node[2]
            j = wp.atomic_add(records.tally, w, n, 1)
            p = records.order[w, i]
            records.spare_order[w, j] = p
            records.place[w, p] = j
            for c in range(COMPONENTS):
                records.spare[w, c, j] = store.get(of, w, c, i)
            for c in range(2):
                records.spare[w, COMPONENTS + c, j] = records.moduli[w, c, i]
        block.meet()
        for i in range(lane, N, lanes):
            p = records.spare_order[w, i]
            records.order[w, i] = p
            for c in range(COMPONENTS):
                store.put(of, w, c, i, records.spare[w, c, i])
            for c in range(2):
                records.moduli[w, c, i] = records.spare[w, COMPONENTS + c, i]
            put_near(records.near, w, i, p, matter.lattice, records.place, w)
        block.meet()

    @wp.func
    def load(of: wp.array3d(dtype=real), w: int, i: int, p: int, state: Any):
        """Make record i of particle p of a ``State``, or of its derivatives."""
        store.put_vector(of, w, X, i, state.x[w, p])
        store.put_vector(of, w, V, i, state.v[w, p])
        store.put_matrix(of, w, C, i, state.C[w, p])
        if damped == 1:
            for c in range(6):
                store.put(of, w, Z + c, i, state.Z[w, c, p])
        if plastic == 1:
            store.put_matrix(of, w, G, i, state.G[w, p])

    @wp.func
    def unload(of: wp.array3d(dtype=real), w: int, i: int, p: int, state: Any):
        """Write record i to particle p."""
        state.x[w, p] = store.vector(of, w, X, i)
        state.v[w, p] = store.vector(of, w, V, i)
        state.C[w, p] = store.matrix(of, w, C, i)
        if damped == 1:
            for c in range(6):
                state.Z[w, c, p] = store.get(of, w, Z + c, i)
        if plastic == 1:
            state.G[w, p] = store.matrix(of, w, G, i)

    return Namespace(load, unload, put_in_order)
