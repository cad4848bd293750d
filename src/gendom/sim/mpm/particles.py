"""How particles are stored, for functions that do not care.

The CPU and the graph of stages have a row of vectors for each world (``State``); a block of threads
has records by components, in the order of their nodes (``runners.records``). Both offer the
same functions on a particle p in a row.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from gendom.sim.mpm.types import make_types


@dataclass(frozen=True)
class Particles:
    """A struct of particles and the Warp functions that read it."""

    Struct: Any
    position: Any
    """(particles, row, i) -> x of the i-th particle in memory."""
    x: Any
    """(particles, row, p) -> x of particle p."""


@functools.cache
def make_rows(real: Any) -> Particles:
    """Particles in rows of vectors, ``State``."""
    State = make_types(real).State

    @wp.func
    def x_of(particles: State, row: int, p: int):
        return particles.x[row, p]

    return Particles(State, x_of, x_of)
