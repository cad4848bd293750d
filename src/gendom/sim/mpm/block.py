"""What the threads of a CUDA block do together; on the CPU a block is one thread.

A kernel that gives each world a block reads the same on both devices: its loops take every
``threads``-th particle or node from ``thread`` on, and threads synchronise between them.
"""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.native import functions_of

ROOMS_OF_TWO = (96_000, 114_000)
"""Shared memory for the particles of one of two blocks on a multiprocessor [bytes]; the smaller
leaves more of it to the cache."""

ROOM_ALONE = 192_000
"""The same of a block that has a multiprocessor to itself."""


def bounds(threads: int) -> tuple[int, int]:
    """Launch bounds of a block: two on a multiprocessor where registers allow."""
    return threads, 2 if threads <= 192 else 1


@functools.cache
def make_block(real: Any) -> SimpleNamespace:
    """Build the functions for one scalar type; all threads of a block must call them.

    ``any``, whether a thread's value is not 0, and ``largest`` synchronise as ``sync`` does, see
    ``native/block.h``.
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

    return SimpleNamespace(**vars(functions_of(locals())), any=block_any)


@wp.func_native("gendom::put_near(near, w, i, p, lattice, place, row);")
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
    ...
