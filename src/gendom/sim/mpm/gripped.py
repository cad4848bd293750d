"""What grippers hold: a list of particles with all that moving them needs, forward and transposed.

Looked up particle by particle (who holds it, where, how stiff it is), each number would be waited
for in turn; a list is read at once. Particles held firmly (``free`` is 0) go where the gripper
goes; what is held in part is drawn to it. See ``boundary`` for the formulas.

Shapes: W worlds, N particles.
"""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.block import make_block
from gendom.sim.mpm.boundary import FOLLOWS, make_boundary, make_boundary_adjoint
from gendom.sim.mpm.particles import LAM, MASS, MU, Variant, make_adjoint, make_moving, make_taped
from gendom.sim.mpm.types import Namespace, make_types

LIST = ("free", "driven", "index", "gripper", "number", "share", "place", "modulus")
"""Arrays of ``Gripped`` with a number for each particle."""


@functools.cache
def make_gripped_type(real: Any) -> Any:
    """The struct of the list for one scalar type."""
    vec3 = make_types(real).vec3

    @wp.struct
    class Gripped:
        """Of each stored particle ``free`` and ``driven``; then those held, in any order."""

        free: wp.array2d(dtype=real)  # [W, N] as ``Grips.free``
        driven: wp.array2d(dtype=vec3)  # [W, N] velocity that its gripper would give it [m/s]
        count: wp.array(dtype=wp.int32)  # [W]
        index: wp.array2d(dtype=wp.int32)  # [W, N] of the stored particle
        gripper: wp.array2d(dtype=wp.int32)  # [W, N]
        number: wp.array2d(dtype=wp.int32)  # [W, N] among what that gripper holds
        share: wp.array2d(dtype=real)  # [W, N] ``free`` of it
        place: wp.array2d(dtype=vec3)  # [W, N] in the gripper's frame [m]
        modulus: wp.array2d(dtype=real)  # [W, N] of pressure waves [Pa]

    return Gripped


@functools.cache
def make_listing(variant: Variant) -> Namespace:
    """Build ``list_gripped`` and ``drive``."""
    real = variant.real
    types = make_types(real)
    Matter, Conditions, Grips = types.Matter, types.Conditions, types.Grips
    vec3 = types.vec3
    sync = make_block(real).sync
    boundary = make_boundary(variant)
    Gripped = make_gripped_type(real)
    particle = make_moving(variant).particle

    @wp.func
    def list_gripped(
        w: int, thread: int, threads: int, stored: Any, matter: Matter, grips: Grips,
        gripped: Gripped,
    ):  # fmt: skip
        """List what is held of the stored particles (or derivatives); return how many."""
        N = gripped.free.shape[1]
        sync()
        if thread == 0:
            gripped.count[w] = 0
        sync()
        for i in range(thread, N, threads):
            p = particle(stored, w, i)
            free = grips.free[w, p]
            gripped.free[w, i] = free
            if free < real(1.0):
                n = wp.atomic_add(gripped.count, w, 1)
                g = grips.held_by[w, p] // N
                gripped.index[w, n] = i
                gripped.gripper[w, n] = g
                gripped.number[w, n] = grips.held_by[w, p] % N
                gripped.share[w, n] = free
                gripped.place[w, n] = grips.place[w, g, grips.held_by[w, p] % N]
                gripped.modulus[w, n] = boundary.modulus_of(w, p, matter)
        sync()
        return gripped.count[w]

    @wp.func
    def drive(
        w: int, n: int, x: vec3, grip_row: int, h: real, matter: Matter, conditions: Conditions,
        grips: Grips, gripped: Gripped,
    ):  # fmt: skip
        """Set the velocity that its gripper would give to the n-th of the list, which is at x."""
        b, _slope = boundary.spring(w, gripped.modulus[w, n], h, matter, conditions.dx)
        v, _spin, _by_b = boundary.follow(
            gripped.gripper[w, n], gripped.place[w, n], grip_row, x, b, h, grips
        )
        gripped.driven[w, gripped.index[w, n]] = v

    return Namespace(list_gripped, drive)


@functools.cache
def make_gripped_adjoint(variant: Variant) -> Namespace:
    """Build ``firm_adjoint`` and ``partial_adjoint`` of particles held firmly and in part.

    The derivatives of a warp's threads by a gripper are summed before they are added to it.
    """
    real = variant.real
    types = make_types(real)
    vec3 = types.vec3
    Matter, Conditions, Grips = types.Matter, types.Conditions, types.Grips
    ConditionsAdjoint, Gripped = types.ConditionsAdjoint, make_gripped_type(real)
    taped, adjoint_of = make_taped(variant), make_adjoint(variant)
    Tape, Adjoint = taped.Struct, adjoint_of.Struct
    before, fields, particle = taped.fields, adjoint_of.fields, adjoint_of.particle
    boundary = make_boundary_adjoint(variant)
    wide, add_by_warp = boundary.wide, make_block(real).add_by_warp
    pose_type = wp.types.matrix((4, 3), wp.float64)

    @wp.func
    def rows_of(centre_bar: vec3, V_bar: vec3, spin_bar: vec3, R_bar: vec3):
        """Derivatives by a gripper's pose, a row each."""
        return wp.matrix_from_rows(wide(centre_bar), wide(V_bar), wide(spin_bar), wide(R_bar))

    @wp.func
    def add_to_pose(grip_row: int, g: int, total: pose_type, by: ConditionsAdjoint):
        """Add the sum of a warp's derivatives by a gripper's pose."""
        add_by_warp(by.centre, grip_row, g, total[0])
        add_by_warp(by.velocity, grip_row, g, total[1])
        add_by_warp(by.spin, grip_row, g, total[2])
        add_by_warp(by.rotation, grip_row, g, total[3])

    @wp.func
    def firm_adjoint(
        w: int, thread: int, threads: int, holding: int, grip_row: int, h: real, grips: Grips,
        gripped: Gripped, adjoint: Adjoint, by: ConditionsAdjoint,
    ):  # fmt: skip
        """Derivatives by x and by grippers of what they hold firmly."""
        for g in range(grips.closed.shape[1]):
            total = pose_type()
            for n in range(thread, holding, threads):
                if gripped.gripper[w, n] == g and gripped.share[w, n] == real(0.0):
                    i = gripped.index[w, n]
                    x_bar = fields.x(adjoint, w, i)
                    centre_bar, V_bar, spin_bar, R_bar = boundary.follow_adjoint(
                        w, g, gripped.number[w, n], grip_row, real(FOLLOWS), h,
                        fields.v(adjoint, w, i) + h * x_bar,
                        boundary.turned_adjoint(fields.C(adjoint, w, i)), grips, by,
                    )  # fmt: skip
                    fields.put_x(adjoint, w, i, x_bar - centre_bar)
                    total += rows_of(centre_bar, V_bar, spin_bar, R_bar)
            add_to_pose(grip_row, g, total, by)

    @wp.func
    def partial_adjoint(
        w: int, thread: int, threads: int, holding: int, grip_row: int, slot: int, h: real,
        mass: real, matter: Matter, conditions: Conditions, grips: Grips, gripped: Gripped,
        tape: Tape, touched: wp.array2d(dtype=vec3), adjoint: Adjoint, by: ConditionsAdjoint,
    ):  # fmt: skip
        """The same of what they hold in part, and by mass and moduli.

        Derivatives by a particle's own velocity u are known; those by the velocity that it is given
        follow.
        """
        for g in range(grips.closed.shape[1]):
            total = pose_type()
            for n in range(thread, holding, threads):
                share = gripped.share[w, n]
                if gripped.gripper[w, n] == g and share > real(0.0):
                    i = gripped.index[w, n]
                    u = before.q(tape, slot, i) / mass
                    if conditions.table == 1:
                        u += touched[w, particle(adjoint, w, i) // matter.section]
                    by_lam, by_mass, centre_bar, V_bar, spin_bar, R_bar = boundary.driven_adjoint(
                        w, g, gripped.number[w, n], gripped.modulus[w, n], real(1.0) - share,
                        grip_row, before.x(tape, slot, i), u, h, conditions.dx, matter,
                        fields.v(adjoint, w, i) / share, grips, by,
                    )  # fmt: skip
                    fields.put_x(adjoint, w, i, fields.x(adjoint, w, i) - centre_bar)
                    sums = adjoint.sums
                    sums[w, LAM, i] = sums[w, LAM, i] + by_lam
                    sums[w, MU, i] = sums[w, MU, i] + real(2.0) * by_lam
                    sums[w, MASS, i] = sums[w, MASS, i] + by_mass
                    total += rows_of(centre_bar, V_bar, spin_bar, R_bar)
            add_to_pose(grip_row, g, total, by)

    return Namespace(firm_adjoint, partial_adjoint)
