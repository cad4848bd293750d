"""How particles are stored while they move and on a tape: in records, component by component.

On CUDA records stand in the order of the particles' lowest nodes. Neighbouring threads then access
neighbouring numbers, and contributions of neighbouring particles to the same nodes are summed
before they are added to the grid. On the CPU neighbouring records fill a SIMD register.

The functions here read and write the i-th record of a row: of particles while they move, of a tape
with recorded substeps, and of derivatives.

Shapes: W worlds, N particles, L layouts of the grid, M nodes.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from gendom.sim.mpm.block import make_block, make_store, put_near
from gendom.sim.mpm.transfer import make_transfer
from gendom.sim.mpm.types import Namespace, make_types

ORDERLY = 1.0
"""Largest distance [cells] that a particle may travel before the records are sorted again."""

X, V, AFFINE, IMPULSES, MOMENTUM, LOW, STRESS = 0, 3, 6, 15, 15, 24, 27
"""First components of a record: position, velocity, affine velocity, impulses on the neighbours (on
a tape: momentum with all impulses but the table's), what rounding leaves out, filtered stress. Of
derivatives: those by the differences between neighbours in place of impulses, and what the air adds
to those by v in place of what rounding leaves out."""

TAPED_STRESS = 18
"""First component of the filtered stress on a tape."""

MU, LAM, MASS, DRAG = range(4)
"""Sums of derivatives by a particle's parameters."""


@dataclass(frozen=True)
class Variant:
    """Parameters for which kernels are compiled."""

    real: Any
    damped: bool
    """Whether any material has damping."""
    sorts: bool
    """Whether records are sorted again and again; else they keep the order of particles, and sums
    are the same to the bit however a run is divided."""
    room: int = 0
    """Shared memory in which a block's records stay [bytes]; 0: in arrays."""
    threads: int = 1
    """Threads of a block; on the CPU a block is one thread."""

    @property
    def components(self) -> int:
        """Components of a record."""
        return STRESS + 6 * self.damped

    @property
    def taped(self) -> int:
        """Components of a record on a tape."""
        return TAPED_STRESS + 6 * self.damped

    @property
    def numbers(self) -> int:
        """Numbers that the room holds."""
        return max(1, self.room // (4 if self.real == wp.float32 else 8))


@functools.cache
def make_moving(variant: Variant) -> Namespace:
    """Particles while they move, or derivatives by them: ``x``, ``v``, ``C``, ``q``, ``low``,
    ``put_x`` and so on of the i-th record of a row, ``get_Z`` and ``put_Z`` of its filtered stress,
    ``particle``, which it is of; ``place`` of particle p, and its ``x_of``."""

    @wp.func
    def order_of(s: Any, row: int):
        return row

    return _access(variant.real, order_of, STRESS, resident=variant.room > 0)


@functools.cache
def make_taped(variant: Variant) -> Namespace:
    """The same of particles on a tape; row n * W + w is substep n of world w."""

    @wp.func
    def order_of(s: Any, row: int):
        return s.layout_of[row]

    return _access(variant.real, order_of, TAPED_STRESS, resident=False)


def _access(real: Any, order_of: Any, stress: int, *, resident: bool) -> Namespace:
    """Access to records whose filtered stress begins at component ``stress``."""
    store = make_store(real, resident=resident)
    types = make_types(real)
    vec3, mat33, Records = types.vec3, types.mat33, types.Records
    STRESS_AT = wp.constant(stress)

    def vector(name: str, first: int) -> dict[str, Any]:
        FIRST = wp.constant(first)

        @wp.func
        def get(s: Records, row: int, i: int):
            return store.vector(s.of, row, FIRST, i)

        @wp.func
        def put(s: Records, row: int, i: int, value: vec3):
            store.put_vector(s.of, row, FIRST, i, value)

        return {name: get, f"put_{name}": put}

    @wp.func
    def C(s: Records, row: int, i: int):
        return store.matrix(s.of, row, AFFINE, i)

    @wp.func
    def put_C(s: Records, row: int, i: int, value: mat33):
        store.put_matrix(s.of, row, AFFINE, i, value)

    @wp.func
    def get_Z(s: Records, row: int, c: int, i: int):
        return store.get(s.of, row, STRESS_AT + c, i)

    @wp.func
    def put_Z(s: Records, row: int, c: int, i: int, value: real):
        store.put(s.of, row, STRESS_AT + c, i, value)

    @wp.func
    def particle(s: Records, row: int, i: int):
        return s.order[order_of(s, row), i]

    @wp.func
    def place(s: Records, row: int, p: int):
        return s.place[order_of(s, row), p]

    @wp.func
    def x_of(s: Records, row: int, p: int):
        return store.vector(s.of, row, X, s.place[order_of(s, row), p])

    made = Namespace(C, put_C, get_Z, put_Z, particle, place, x_of, store=store)
    for name, first in (("x", X), ("v", V), ("q", MOMENTUM), ("low", LOW)):
        vars(made).update(vector(name, first))
    return made


@functools.cache
def make_loading(variant: Variant) -> Namespace:
    """Build ``load`` and ``unload`` between a ``State`` (or its adjoint) and what is stored."""
    fields, types = make_moving(variant), make_types(variant.real)
    Records, State = types.Records, types.State
    damped = wp.constant(int(variant.damped))

    @wp.func
    def load(stored: Records, w: int, i: int, p: int, state: State):
        """Set the i-th of the stored particles from particle p."""
        fields.put_x(stored, w, i, state.x[w, p])
        fields.put_v(stored, w, i, state.v[w, p])
        fields.put_C(stored, w, i, state.C[w, p])
        if damped == 1:
            for c in range(6):
                fields.put_Z(stored, w, c, i, state.Z[w, c, p])

    @wp.func
    def unload(stored: Records, w: int, i: int, p: int, state: State):
        """Set particle p from the i-th of the stored ones."""
        state.x[w, p] = fields.x(stored, w, i)
        state.v[w, p] = fields.v(stored, w, i)
        state.C[w, p] = fields.C(stored, w, i)
        if damped == 1:
            for c in range(6):
                state.Z[w, c, p] = fields.get_Z(stored, w, c, i)

    return Namespace(load, unload)


@functools.cache
def make_sorting(variant: Variant) -> Any:
    """Build ``sort``, which puts a world's records in the order of their lowest nodes."""
    real = variant.real
    types = make_types(real)
    Model, Substep, Grid, Records = types.Model, types.Substep, types.Grid, types.Records
    fields, store = make_moving(variant), make_moving(variant).store
    locate = make_transfer(real).locate
    block = make_block(real)
    COMPONENTS = wp.constant(variant.components)

    @wp.func
    def node_of(now: Substep, i: int, grid: Grid, records: Records):
        node, _f = locate(now, fields.x(records, now.w, i), grid)
        return grid.start[now.layout, node[0], node[1]] + node[2]

    @wp.func
    def sort(now: Substep, model: Model, grid: Grid, records: Records):
        of = records.of
        tally = grid.tally
        row = now.w % tally.shape[0]
        N = of.shape[2]
        nodes = grid.count[now.layout]
        begin = now.thread * nodes // now.threads
        end = (now.thread + 1) * nodes // now.threads
        for n in range(begin, end):
            tally[row, n] = 0
        block.sync()
        for i in range(now.thread, N, now.threads):
            wp.atomic_add(tally, row, node_of(now, i, grid, records), 1)
        block.sync()
        total = int(0)
        for n in range(begin, end):
            total += tally[row, n]
        first = block.sum_before(total)
        for n in range(begin, end):
            here = tally[row, n]
            tally[row, n] = first
            first += here
        block.sync()
        for i in range(now.thread, N, now.threads):
            j = wp.atomic_add(tally, row, node_of(now, i, grid, records), 1)
            p = records.order[now.w, i]
            records.spare_order[now.w, j] = p
            records.place[now.w, p] = j
            for c in range(COMPONENTS):
                records.spare[now.w, c, j] = store.get(of, now.w, c, i)
            for c in range(2):
                records.spare[now.w, COMPONENTS + c, j] = records.moduli[now.w, c, i]
        block.sync()
        for i in range(now.thread, N, now.threads):
            p = records.spare_order[now.w, i]
            records.order[now.w, i] = p
            for c in range(COMPONENTS):
                store.put(of, now.w, c, i, records.spare[now.w, c, i])
            for c in range(2):
                records.moduli[now.w, c, i] = records.spare[now.w, COMPONENTS + c, i]
            put_near(records.near, now.w, i, p, model.lattice, records.place, now.w)
        block.sync()

    return sort
