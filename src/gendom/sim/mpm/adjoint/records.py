"""Derivatives by particles as records for a block of threads, and the tape they go back over.

Shapes: W worlds, N particles.
"""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.adjoint.boundary import ParticleBars
from gendom.sim.mpm.block import make_store
from gendom.sim.mpm.particles import Particles
from gendom.sim.mpm.runners.records import X, make_tape
from gendom.sim.mpm.types import make_types

STRETCHES, WIND = 15, 24
"""Components of a record of derivatives besides those by the state: by the differences between
neighbours, and what the air adds to those by v."""

SUMS = 5
"""Derivatives by mu, lam, mass, yield stress and drag of a particle."""

MU, LAM, MASS, YIELD, DRAG = range(SUMS)


@functools.cache
def make_recorded(real: Any) -> Particles:
    """Particles on a tape, of which nothing but positions is asked and nothing is written."""
    Tape = make_tape(real)
    vector = make_store(real, resident=False).vector

    @wp.func
    def x_of(tape: Tape, row: int, p: int):
        return vector(tape.of, row, X, tape.place[tape.layout_of[row], p])

    return Particles(Tape, x_of, x_of)


@functools.cache
def make_bar_records(real: Any, *, resident: bool) -> ParticleBars:
    """Derivatives in records, as ``adjoint.boundary.make_row_bars``."""
    types = make_types(real)
    vec3 = types.vec3
    store = make_store(real, resident=resident)

    @wp.struct
    class BarRecords:
        """Derivatives by W worlds' particles in order."""

        of: wp.array3d(dtype=real)  # [W, components, N], or [1, ...] if they are resident
        sums: wp.array3d(dtype=real)  # [W, SUMS, N]
        near: wp.array3d(dtype=wp.int32)  # [W, 3, N] records of its neighbours
        place: wp.array2d(dtype=wp.int32)  # [W, N] record of each particle
        spare: wp.array3d(dtype=real)  # [W, components + SUMS, N] scratch

    @wp.func
    def x_of(bars: BarRecords, w: int, p: int):
        return store.vector(bars.of, w, X, bars.place[w, p])

    @wp.func
    def put_x(bars: BarRecords, w: int, p: int, value: vec3):
        store.put_vector(bars.of, w, X, bars.place[w, p], value)

    return ParticleBars(BarRecords, x_of, put_x)
