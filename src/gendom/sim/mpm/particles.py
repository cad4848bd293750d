"""How particles are stored, for functions that do not care.

The CPU and the graph of stages have a row of vectors for each world (``State``); a block of threads
has records by components, in the order of their nodes (``runners.block_kernels``). Both offer the
same functions on a particle p in a row.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportAttributeAccessIssue=false

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from gendom.sim.mpm.compensated_sum import make_compensated_sum
from gendom.sim.mpm.types import make_types


@dataclass(frozen=True)
class Particles:
    """A struct of particles and the Warp functions that read and write it."""

    Struct: Any
    position: Any
    """(particles, row, i) -> x of the i-th particle in memory."""
    x: Any
    """(particles, row, p) -> x; likewise ``v`` and ``C``."""
    v: Any
    C: Any
    put_v: Any
    """(particles, row, p, v)."""
    put_C: Any
    move: Any
    """(particles, row, w, p, step): add to x; in float32 with what was left out so far."""


@functools.cache
def make_rows(real: Any) -> Particles:
    """Particles in rows of vectors, ``State``."""
    types = make_types(real)
    vec3, mat33, State = types.vec3, types.mat33, types.State
    compensates = wp.constant(int(types.compensates))
    compensated_sum = make_compensated_sum(real)

    @wp.func
    def x_of(particles: State, row: int, p: int):
        return particles.x[row, p]

    @wp.func
    def v_of(particles: State, row: int, p: int):
        return particles.v[row, p]

    @wp.func
    def C_of(particles: State, row: int, p: int):
        return particles.C[row, p]

    @wp.func
    def put_v(particles: State, row: int, p: int, v: vec3):
        particles.v[row, p] = v

    @wp.func
    def put_C(particles: State, row: int, p: int, C: mat33):
        particles.C[row, p] = C

    @wp.func
    def move(particles: State, row: int, w: int, p: int, step: vec3):
        if compensates == 1:
            there, low = compensated_sum(particles.x[row, p], step, particles.low[w, p])
            particles.x[row, p] = there
            particles.low[w, p] = low
        else:
            particles.x[row, p] = particles.x[row, p] + step

    return Particles(State, x_of, x_of, v_of, C_of, put_v, put_C, move)
