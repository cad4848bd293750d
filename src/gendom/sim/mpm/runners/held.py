"""What grippers hold, listed for the threads of a block, with all that moving it needs.

Looked up particle by particle (who holds it, where, how stiff it is) each number would be waited
for in turn; a list is read at once.

Shapes: W worlds, N particles.
"""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.block import make_block
from gendom.sim.mpm.boundary import make_boundary
from gendom.sim.mpm.particles import make_rows
from gendom.sim.mpm.types import Namespace, make_types

LIST = ("free", "led", "record", "gripper", "number", "share", "place", "modulus")
"""Arrays of ``Held`` with a number for each particle."""


@functools.cache
def make_held(real: Any) -> Namespace:
    """Build the list for one scalar type.

    Returns:
        Namespace with ``Held``, ``list_held`` and ``lead``.
    """
    types = make_types(real)
    Matter, Scene, Grips = types.Matter, types.Scene, types.Grips
    vec3 = types.vec3
    meet = make_block(real).meet
    boundary = make_boundary(real, make_rows(real))

    @wp.struct
    class Held:
        """Of each record ``free`` and ``led``; then the records that are held, in any order."""

        free: wp.array2d(dtype=real)  # [W, N] as ``Grips.free``
        led: wp.array2d(dtype=vec3)  # [W, N] velocity that its gripper would give it [m/s]
        count: wp.array(dtype=wp.int32)  # [W]
        record: wp.array2d(dtype=wp.int32)  # [W, N]
        gripper: wp.array2d(dtype=wp.int32)  # [W, N]
        number: wp.array2d(dtype=wp.int32)  # [W, N] among what that gripper holds
        share: wp.array2d(dtype=real)  # [W, N] ``free`` of it
        place: wp.array2d(dtype=vec3)  # [W, N] in the gripper's frame [m]
        modulus: wp.array2d(dtype=real)  # [W, N] of pressure waves [Pa]

    @wp.func
    def list_held(
        w: int, lane: int, lanes: int, order: wp.array2d(dtype=wp.int32), row: int, matter: Matter,
        grips: Grips, held: Held,
    ):  # fmt: skip
        """List what is held of the records of particles ``order[row]``; return how many."""
        N = held.free.shape[1]
        meet()
        if lane == 0:
            held.count[w] = 0
        meet()
        for i in range(lane, N, lanes):
            p = order[row, i]
            free = grips.free[w, p]
            held.free[w, i] = free
            if free < real(1.0):
                n = wp.atomic_add(held.count, w, 1)
                g = grips.held_by[w, p] // N
                held.record[w, n] = i
                held.gripper[w, n] = g
                held.number[w, n] = grips.held_by[w, p] % N
                held.share[w, n] = free
                held.place[w, n] = grips.place[w, g, grips.held_by[w, p] % N]
                held.modulus[w, n] = boundary.modulus_of(w, p, matter)
        meet()
        return held.count[w]

    @wp.func
    def lead(
        w: int, n: int, x: vec3, grip_row: int, h: real, matter: Matter, scene: Scene, grips: Grips,
        held: Held,
    ):  # fmt: skip
        """Set the velocity that its gripper would give to the n-th of the list, which is at x."""
        b, _slope = boundary.spring(w, held.modulus[w, n], h, matter, scene.dx)
        v, _spin, _by_b = boundary.follow(
            held.gripper[w, n], held.place[w, n], grip_row, x, b, h, grips
        )
        held.led[w, held.record[w, n]] = v

    return Namespace(list_held, lead, Held=Held)
