"""How particles are stored: one code for both devices, two ways to reach their numbers.

- **Rows** (CPU): the vectors of ``State``, particle by particle.
- **Records** (CUDA): component by component, in the order of the particles' lowest nodes. Threads
  then access neighbouring numbers, and contributions of neighbouring particles to the same nodes
  are summed before they are added to the grid.

Each offers the same functions on the i-th particle of a row: of particles while they move, of a
tape with recorded substeps, and of derivatives.

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
    rows: bool
    """Particles in rows, one thread a world (CPU); otherwise in records, by a block of threads."""
    room: int = 0
    """Shared memory in which a block's records stay [bytes]; 0: in arrays."""
    threads: int = 1
    """Threads of a block."""

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


@dataclass(frozen=True, eq=False)
class Stored:
    """A struct of particles, the functions that read and write it, and which particle is where."""

    Struct: Any
    fields: Namespace
    """``x``, ``v``, ``C`` and ``put_x`` and so on of the i-th particle of a row."""
    particle: Any
    """(stored, row, i) -> p, the number in the body of the i-th particle."""
    place: Any
    """(stored, row, p) -> i."""
    x_of: Any
    """(stored, row, p) -> x of particle p."""


@functools.cache
def make_moving(variant: Variant) -> Stored:
    """Particles while they move, or derivatives by them."""
    if variant.rows:
        return _rows(variant.real)
    Records = make_types(variant.real).Records
    fields = _record_fields(variant.real, STRESS, resident=variant.room > 0)
    own_x = fields.x

    @wp.func
    def particle(s: Records, row: int, i: int):
        return s.order[row, i]

    @wp.func
    def place(s: Records, row: int, p: int):
        return s.place[row, p]

    @wp.func
    def x_of(s: Records, row: int, p: int):
        return own_x(s, row, s.place[row, p])

    return Stored(Records, fields, particle, place, x_of)


@functools.cache
def make_taped(variant: Variant) -> Stored:
    """Particles on a tape; row n * W + w is substep n of world w."""
    if variant.rows:
        return _rows(variant.real)
    Records = make_types(variant.real).Records
    fields = _record_fields(variant.real, TAPED_STRESS, resident=False)
    taped_x = fields.x

    @wp.func
    def taped_particle(s: Records, row: int, i: int):
        return s.order[s.layout_of[row], i]

    @wp.func
    def taped_place(s: Records, row: int, p: int):
        return s.place[s.layout_of[row], p]

    @wp.func
    def taped_x_of(s: Records, row: int, p: int):
        return taped_x(s, row, taped_place(s, row, p))

    return Stored(Records, fields, taped_particle, taped_place, taped_x_of)


@functools.cache
def _rows(real: Any) -> Stored:
    types = make_types(real)
    State, vec3 = types.State, types.vec3

    def field(name: str, kind: Any) -> dict[str, Any]:
        @wp.func_native(f"return wp::index(s.{name}, row, i);")
        def get(s: State, row: int, i: int) -> kind: ...

        @wp.func_native(f"wp::index(s.{name}, row, i) = value;")
        def put(s: State, row: int, i: int, value: kind): ...

        return {name: get, f"put_{name}": put}

    @wp.func
    def get_Z(s: State, row: int, c: int, i: int):
        return s.Z[row, c, i]

    @wp.func
    def put_Z(s: State, row: int, c: int, i: int, value: real):
        s.Z[row, c, i] = value

    @wp.func
    def same(s: State, row: int, i: int):
        return i

    fields = Namespace(get_Z, put_Z, **field("C", types.mat33))
    for name in ("x", "v", "q", "low"):
        vars(fields).update(field(name, vec3))
    return Stored(State, fields, same, same, fields.x)


def _record_fields(real: Any, stress: int, *, resident: bool) -> Namespace:
    """Access to records whose filtered stress begins at component ``stress``."""
    store = make_store(real, resident=resident)
    types = make_types(real)
    vec3, mat33 = types.vec3, types.mat33
    STRESS_AT = wp.constant(stress)

    def vector(name: str, first: int) -> dict[str, Any]:
        FIRST = wp.constant(first)

        @wp.func
        def get(s: Any, row: int, i: int):
            return store.vector(s.of, row, FIRST, i)

        @wp.func
        def put(s: Any, row: int, i: int, value: vec3):
            store.put_vector(s.of, row, FIRST, i, value)

        return {name: get, f"put_{name}": put}

    @wp.func
    def C(s: Any, row: int, i: int):
        return store.matrix(s.of, row, AFFINE, i)

    @wp.func
    def put_C(s: Any, row: int, i: int, value: mat33):
        store.put_matrix(s.of, row, AFFINE, i, value)

    @wp.func
    def get_Z(s: Any, row: int, c: int, i: int):
        return store.get(s.of, row, STRESS_AT + c, i)

    @wp.func
    def put_Z(s: Any, row: int, c: int, i: int, value: real):
        store.put(s.of, row, STRESS_AT + c, i, value)

    fields = Namespace(C, put_C, get_Z, put_Z, store=store)
    for name, first in (("x", X), ("v", V), ("q", MOMENTUM), ("low", LOW)):
        vars(fields).update(vector(name, first))
    return fields


@functools.cache
def make_loading(variant: Variant) -> Namespace:
    """Build ``load`` and ``unload`` between a ``State`` (or its adjoint) and what is stored."""
    fields = make_moving(variant).fields
    damped = wp.constant(int(variant.damped))

    @wp.func
    def load(stored: Any, w: int, i: int, p: int, state: Any):
        """Set the i-th of the stored particles from particle p."""
        fields.put_x(stored, w, i, state.x[w, p])
        fields.put_v(stored, w, i, state.v[w, p])
        fields.put_C(stored, w, i, state.C[w, p])
        if damped == 1:
            for c in range(6):
                fields.put_Z(stored, w, c, i, state.Z[w, c, p])

    @wp.func
    def unload(stored: Any, w: int, i: int, p: int, state: Any):
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
    Model, Substep, Grid = types.Model, types.Substep, types.Grid
    moving = make_moving(variant)
    Records, fields = moving.Struct, moving.fields
    store = fields.store
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
        N = of.shape[2]
        nodes = grid.count[now.layout]
        begin = now.thread * nodes // now.threads
        end = (now.thread + 1) * nodes // now.threads
        for n in range(begin, end):
            records.tally[now.w, n] = 0
        block.sync()
        for i in range(now.thread, N, now.threads):
            wp.atomic_add(records.tally, now.w, node_of(now, i, grid, records), 1)
        block.sync()
        total = int(0)
        for n in range(begin, end):
            total += records.tally[now.w, n]
        first = block.sum_before(total)
        for n in range(begin, end):
            here = records.tally[now.w, n]
            records.tally[now.w, n] = first
            first += here
        block.sync()
        for i in range(now.thread, N, now.threads):
            j = wp.atomic_add(records.tally, now.w, node_of(now, i, grid, records), 1)
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
