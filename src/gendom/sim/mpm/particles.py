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
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.mpm.block import make_block, put_near
from gendom.sim.mpm.transfer import make_transfer
from gendom.sim.mpm.types import make_types
from gendom.sim.native import functions_of

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
def make_moving(variant: Variant) -> SimpleNamespace:
    """Particles while they move, or derivatives by them: ``x``, ``v``, ``C``, ``q``, ``low``,
    ``put_x`` and so on of the i-th record of a row, ``Z``, its filtered stress, ``particle``, which
    it is of; ``place`` of particle p, and its ``x_of``."""
    return _access(variant.real, STRESS, resident=variant.room > 0, taped=False)


@functools.cache
def make_taped(variant: Variant) -> SimpleNamespace:
    """The same of particles on a tape; row n * W + w is substep n of world w."""
    return _access(variant.real, TAPED_STRESS, resident=False, taped=True)


def _access(real: Any, stress: int, *, resident: bool, taped: bool) -> SimpleNamespace:
    """Access to records whose filtered stress begins at component ``stress``; ``resident``: in the
    shared memory of a CUDA block, all that its kernel sets aside; ``taped``: in the orders of
    layouts."""
    types = make_types(real)
    Records, number, shared = types.Records, f"wp::{real.__name__}", int(resident)
    TAPED = wp.constant(int(taped))
    one = f"gendom::component<{shared}>(of, row, c, i)"

    @wp.func_native(f"return {one};")
    def get(of: wp.array3d(dtype=real), row: int, c: int, i: int) -> real: ...

    @wp.func_native(f"{one} = value;")
    def put(of: wp.array3d(dtype=real), row: int, c: int, i: int, value: real): ...

    def field(name: str, kind: Any, native: str, first: int) -> dict[str, Any]:
        @wp.func_native(f"return gendom::get_as<{shared}, wp::{native}>(s.of, row, {first}, i);")
        def get(s: Records, row: int, i: int) -> kind: ...

        @wp.func_native(f"gendom::put_as<{shared}>(s.of, row, {first}, i, value);")
        def put(s: Records, row: int, i: int, value: kind): ...

        return {name: get, f"put_{name}": put}

    @wp.func
    def order_of(s: Records, row: int):
        order = row
        if TAPED == 1:
            order = s.layout_of[row]
        return order

    @wp.func
    def particle(s: Records, row: int, i: int):
        return s.order[order_of(s, row), i]

    @wp.func
    def place(s: Records, row: int, p: int):
        return s.place[order_of(s, row), p]

    found = field("C", types.mat33, f"mat_t<3, 3, {number}>", AFFINE)
    found |= field("Z", types.symmetric, f"vec_t<6, {number}>", stress)
    for name, first in (("x", X), ("v", V), ("q", MOMENTUM), ("low", LOW)):
        found |= field(name, types.vec3, f"vec_t<3, {number}>", first)
    x = found["x"]

    @wp.func
    def x_of(s: Records, row: int, p: int):
        return x(s, row, s.place[order_of(s, row), p])

    return functions_of({**locals(), **found})


@functools.cache
def make_loading(variant: Variant) -> SimpleNamespace:
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
            fields.put_Z(stored, w, i, state.Z[w, p])

    @wp.func
    def unload(stored: Records, w: int, i: int, p: int, state: State):
        """Set particle p from the i-th of the stored ones."""
        state.x[w, p] = fields.x(stored, w, i)
        state.v[w, p] = fields.v(stored, w, i)
        state.C[w, p] = fields.C(stored, w, i)
        if damped == 1:
            state.Z[w, p] = fields.Z(stored, w, i)

    return functions_of(locals())


@functools.cache
def make_sorting(variant: Variant) -> SimpleNamespace:
    """Build ``reorder``, after which the i-th record of a world is the ``spare_order[w, i]``-th,
    and ``sort``, which puts a world's records in the order of their lowest nodes."""
    real = variant.real
    types = make_types(real)
    Model, Substep, Grid, Records = types.Model, types.Substep, types.Grid, types.Records
    fields, locate, block = make_moving(variant), make_transfer(real).locate, make_block(real)
    COMPONENTS = wp.constant(variant.components)

    @wp.func
    def reorder(now: Substep, records: Records, more: wp.array3d(dtype=real)):
        """Together with the rows [W, n, N] of ``more``."""
        of, spare = records.of, records.spare
        for i in range(now.thread, more.shape[2], now.threads):
            j = records.spare_order[now.w, i]
            for c in range(COMPONENTS):
                spare[now.w, c, i] = fields.get(of, now.w, c, j)
            for c in range(more.shape[1]):
                spare[now.w, COMPONENTS + c, i] = more[now.w, c, j]
        block.sync()
        for i in range(now.thread, more.shape[2], now.threads):
            for c in range(COMPONENTS):
                fields.put(of, now.w, c, i, spare[now.w, c, i])
            for c in range(more.shape[1]):
                more[now.w, c, i] = spare[now.w, COMPONENTS + c, i]

    @wp.func
    def node_of(now: Substep, i: int, grid: Grid, records: Records):
        node, _f = locate(now, fields.x(records, now.w, i), grid)
        return grid.start[now.layout, node[0], node[1]] + node[2]

    @wp.func
    def sort(now: Substep, model: Model, grid: Grid, records: Records):
        tally = grid.tally
        row = now.w % tally.shape[0]
        N = records.of.shape[2]
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
            records.spare_order[now.w, j] = i
            records.place[now.w, records.order[now.w, i]] = j
        block.sync()
        reorder(now, records, records.moduli)
        for p in range(now.thread, N, now.threads):
            i = records.place[now.w, p]
            records.order[now.w, i] = p
            put_near(records.near, now.w, i, p, model.lattice, records.place, now.w)
        block.sync()

    return functions_of(locals())
