"""What the threads of a CUDA block do together; on the CPU a block is one thread.

A kernel that gives each world a block reads the same on both devices: its loops take every
``threads``-th particle or node from ``thread`` on, and threads synchronise between them.
"""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.types import Namespace, make_types

ROOMS_OF_TWO = (96_000, 114_000)
"""Shared memory for the particles of one of two blocks on a multiprocessor [bytes]; the smaller
leaves more of it to the cache."""

ROOM_ALONE = 192_000
"""The same of a block that has a multiprocessor to itself."""


def bounds(threads: int) -> tuple[int, int]:
    """Launch bounds of a block: two on a multiprocessor where registers allow."""
    return threads, 2 if threads <= 192 else 1


@functools.cache
def make_block(real: Any) -> Namespace:
    """Build the functions for one scalar type; all threads of a block must call them.

    Returns:
        Namespace with ``resident_at``, the address of a byte of a block's memory for particles;
        ``sync``, after which every thread sees what the others have written; ``any``, whether a
        thread's value is not 0, and ``largest``, the largest of all threads' values (no NaN), which
        synchronise too (before ``largest`` is called again, another ``sync`` is needed);
        ``sum_before``, the sum of the values of the threads before this one; and ``add_by_warp``.
    """

    @wp.func_native("return gendom::resident_at(byte);")
    def resident_at(byte: int) -> wp.uint64: ...

    @wp.func_native("gendom::block_sync();")
    def sync(): ...

    @wp.func_native("return gendom::block_any(value);")
    def block_any(value: int) -> int: ...

    @wp.func_native("return gendom::largest(value);")
    def largest(value: real) -> real: ...

    @wp.func_native("gendom::add_by_warp(to, i, j, value);")
    def add_by_warp(to: wp.array2d(dtype=wp.vec3d), i: int, j: int, value: wp.vec3d): ...

    @wp.func_native("return gendom::sum_before(value);")
    def sum_before(value: int) -> int: ...

    return Namespace(resident_at, sync, largest, sum_before, add_by_warp, any=block_any)


@functools.cache
def make_store(real: Any, *, resident: bool) -> Namespace:
    """Build the access to particles by component, for one scalar type.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        resident: Whether a CUDA block has its particles in shared memory while it runs, all of
            that its kernel sets aside; otherwise they stand in an array.

    Returns:
        Namespace with ``get`` and ``put`` of component c of particle i in a row of the array ``of``
        [rows, components, N], and ``vector``, ``put_vector``, ``matrix`` and ``put_matrix`` of the
        components from c on.
    """
    types = make_types(real)
    vec3, mat33 = types.vec3, types.mat33
    number = f"gendom::component<{int(resident)}>(of, row, c, i)"

    @wp.func_native(f"return {number};")
    def get(of: wp.array3d(dtype=real), row: int, c: int, i: int) -> real: ...

    @wp.func_native(f"{number} = value;")
    def put(of: wp.array3d(dtype=real), row: int, c: int, i: int, value: real): ...

    @wp.func
    def vector(of: wp.array3d(dtype=real), row: int, c: int, i: int):
        return vec3(get(of, row, c, i), get(of, row, c + 1, i), get(of, row, c + 2, i))

    @wp.func
    def put_vector(of: wp.array3d(dtype=real), row: int, c: int, i: int, a: vec3):
        for n in range(3):
            put(of, row, c + n, i, a[n])

    @wp.func
    def matrix(of: wp.array3d(dtype=real), row: int, c: int, i: int):
        return mat33(
            get(of, row, c, i), get(of, row, c + 1, i), get(of, row, c + 2, i),
            get(of, row, c + 3, i), get(of, row, c + 4, i), get(of, row, c + 5, i),
            get(of, row, c + 6, i), get(of, row, c + 7, i), get(of, row, c + 8, i),
        )  # fmt: skip

    @wp.func
    def put_matrix(of: wp.array3d(dtype=real), row: int, c: int, i: int, A: mat33):
        for m in range(3):
            for n in range(3):
                put(of, row, c + 3 * m + n, i, A[m, n])

    return Namespace(vector, put_vector, matrix, put_matrix, get=get, put=put)


@wp.func_native("gendom::put_near(near, w, axis, i, before, behind);")
def put_neighbours(
    near: wp.array3d(dtype=wp.int32), w: int, axis: int, i: int, before: int, behind: int
): ...


@wp.func
def put_near(
    near: wp.array3d(dtype=wp.int32),  # see ``Records``
    w: int,
    i: int,
    p: int,
    lattice: wp.array3d(dtype=wp.int32),
    place: wp.array2d(dtype=wp.int32),  # [rows, N] where each particle is
    row: int,
):
    """Keep where the neighbours of particle p are, which is the i-th."""
    for axis in range(3):
        put_neighbours(
            near, w, axis, i, place[row, lattice[p, axis, 0]], place[row, lattice[p, axis, 1]]
        )
