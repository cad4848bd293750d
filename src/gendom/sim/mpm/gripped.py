"""Grippers in a substep, forward and transposed: their poses, and a list of what they hold.

Looked up particle by particle (who holds it, where, how stiff it is), each number would be waited
for in turn; a list is read at once. Particles held firmly (``free`` is 0) go where the gripper
goes; what is held in part is drawn to it. See ``boundary`` for the formulas.

Shapes: W worlds, N particles, G grippers.
"""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.mpm.block import make_block
from gendom.sim.mpm.boundary import FOLLOWS, make_boundary
from gendom.sim.mpm.particles import LAM, MASS, MU, Variant, make_moving, make_taped
from gendom.sim.mpm.types import make_types
from gendom.sim.native import functions_of
from gendom.sim.paths import make_paths

AHEAD = 32
"""Number of substeps for which gripper poses are computed at once."""


@functools.cache
def make_gripped(variant: Variant) -> SimpleNamespace:
    """Build ``list_gripped``, ``drive``, and ``firm_adjoint`` and ``partial_adjoint`` of particles
    held firmly and in part.

    The derivatives of a warp's threads by a gripper are summed before they are added to it.
    """
    real = variant.real
    types = make_types(real)
    vec3, Model, Grips, Substep = types.vec3, types.Model, types.Grips, types.Substep
    ConditionsAdjoint = types.ConditionsAdjoint
    Records, before, fields = types.Records, make_taped(variant), make_moving(variant)
    sync, add_by_warp = make_block(real).sync, make_block(real).add_by_warp
    boundary = make_boundary(variant)
    pose_type = wp.types.matrix((4, 3), wp.float64)

    @wp.func
    def list_gripped(now: Substep, stored: Records, model: Model, grips: Grips):
        """List what is held of the stored particles (or derivatives); return how many."""
        N = grips.stored_free.shape[1]
        sync()
        if now.thread == 0:
            grips.held[now.w] = 0
        sync()
        for i in range(now.thread, N, now.threads):
            p = fields.particle(stored, now.w, i)
            free = grips.free[now.w, p]
            grips.stored_free[now.w, i] = free
            if free < real(1.0):
                n = wp.atomic_add(grips.held, now.w, 1)
                g = grips.held_by[now.w, p] // N
                grips.held_index[now.w, n] = i
                grips.held_gripper[now.w, n] = g
                grips.held_number[now.w, n] = grips.held_by[now.w, p] % N
                grips.held_share[now.w, n] = free
                grips.held_place[now.w, n] = grips.place[now.w, g, grips.held_by[now.w, p] % N]
                grips.held_modulus[now.w, n] = model.lam[now.w, p] + real(2.0) * model.mu[now.w, p]
        sync()
        return grips.held[now.w]

    @wp.func
    def drive(now: Substep, n: int, x: vec3, model: Model, grips: Grips):
        """Set the velocity that its gripper would give to the n-th of the list, which is at x."""
        b, _slope = boundary.spring(now, grips.held_modulus[now.w, n], model)
        v, _spin, _by_b = boundary.follow(
            now, grips.held_gripper[now.w, n], grips.held_place[now.w, n], x, b, grips
        )
        grips.driven[now.w, grips.held_index[now.w, n]] = v

    @wp.func
    def rows_of(centre_bar: vec3, V_bar: vec3, spin_bar: vec3, R_bar: vec3):
        """Derivatives by a gripper's pose, a row each."""
        return wp.matrix_from_rows(
            wp.vec3d(centre_bar), wp.vec3d(V_bar), wp.vec3d(spin_bar), wp.vec3d(R_bar)
        )

    @wp.func
    def add_to_pose(w: int, g: int, total: pose_type, by: ConditionsAdjoint):
        """Add the sum of a warp's derivatives by a gripper's pose."""
        add_by_warp(by.centre, w, g, total[0])
        add_by_warp(by.velocity, w, g, total[1])
        add_by_warp(by.spin, w, g, total[2])
        add_by_warp(by.rotation, w, g, total[3])

    @wp.func
    def firm_adjoint(now: Substep, grips: Grips, adjoint: Records, by: ConditionsAdjoint):
        """Derivatives by x and by grippers of what they hold firmly."""
        for g in range(grips.closed.shape[1]):
            total = pose_type()
            for n in range(now.thread, now.holding, now.threads):
                if grips.held_gripper[now.w, n] == g and grips.held_share[now.w, n] == real(0.0):
                    i = grips.held_index[now.w, n]
                    x_bar = fields.x(adjoint, now.w, i)
                    centre_bar, V_bar, spin_bar, R_bar = boundary.follow_adjoint(
                        now, g, grips.held_number[now.w, n], real(FOLLOWS),
                        fields.v(adjoint, now.w, i) + now.h * x_bar,
                        boundary.turned_adjoint(fields.C(adjoint, now.w, i)), grips, by,
                    )  # fmt: skip
                    fields.put_x(adjoint, now.w, i, x_bar - centre_bar)
                    total += rows_of(centre_bar, V_bar, spin_bar, R_bar)
            add_to_pose(now.w, g, total, by)

    @wp.func
    def partial_adjoint(
        now: Substep, model: Model, grips: Grips, tape: Records, adjoint: Records,
        by: ConditionsAdjoint,
    ):  # fmt: skip
        """The same of what they hold in part, and by mass and moduli.

        Derivatives by a particle's own velocity u are known; those by the velocity that it is given
        follow.
        """
        for g in range(grips.closed.shape[1]):
            total = pose_type()
            for n in range(now.thread, now.holding, now.threads):
                share = grips.held_share[now.w, n]
                if grips.held_gripper[now.w, n] == g and share > real(0.0):
                    i = grips.held_index[now.w, n]
                    u = before.q(tape, now.slot, i) / now.mass
                    if model.table == 1:
                        u += by.touched[now.w, fields.particle(adjoint, now.w, i) // model.section]
                    by_lam, by_mass, centre_bar, V_bar, spin_bar, R_bar = boundary.driven_adjoint(
                        now, g, grips.held_number[now.w, n], grips.held_modulus[now.w, n],
                        real(1.0) - share, before.x(tape, now.slot, i), u, model,
                        fields.v(adjoint, now.w, i) / share, grips, by,
                    )  # fmt: skip
                    fields.put_x(adjoint, now.w, i, fields.x(adjoint, now.w, i) - centre_bar)
                    sums = adjoint.sums
                    sums[now.w, LAM, i] = sums[now.w, LAM, i] + by_lam
                    sums[now.w, MU, i] = sums[now.w, MU, i] + real(2.0) * by_lam
                    sums[now.w, MASS, i] = sums[now.w, MASS, i] + by_mass
                    total += rows_of(centre_bar, V_bar, spin_bar, R_bar)
            add_to_pose(now.w, g, total, by)

    return functions_of(locals())


@functools.cache
def make_poses(real: Any) -> SimpleNamespace:
    """Build ``pose_ahead`` (grippers in many substeps, by the threads of a block) and its transpose
    ``pose_adjoint`` of one substep, for one scalar type."""
    types = make_types(real)
    Paths, Grips, Substep = types.Paths, types.Grips, types.Substep
    ConditionsAdjoint = types.ConditionsAdjoint
    paths_of = make_paths(real)

    @wp.func
    def pose_ahead(
        now: Substep, first: int, count: int, t0: wp.float64, dt: wp.float64, paths: Paths,
        grips: Grips,
    ):  # fmt: skip
        """Poses in ``count`` substeps from ``first`` on, side by side; substep 0 begins at t0."""
        w = now.w
        grippers = grips.closed.shape[1]
        for n in range(now.thread, count * grippers, now.threads):
            row = w * AHEAD + n // grippers
            g = n % grippers
            t = t0 + wp.float64(first + n // grippers) * dt
            grips.closed[row, g] = int(paths_of.is_closed(w, g, t, paths))
            here, _q, knot = paths_of.placed(w, g, t, paths)
            there, q, end = paths_of.placed(w, g, t + dt, paths)
            grips.centre[row, g] = types.vec3(there)
            grips.orientation[row, g] = types.mat33(wp.quat_to_matrix(q))
            grips.velocity[row, g] = types.vec3((there - here) / dt)
            # each segment contributes a rotation for its part of the substep
            turned = wp.vec3d()
            if paths.turns[w, g] == 1:
                for k in range(knot, end + 1):
                    turned += paths_of.share_of(w, g, k, t, dt, paths) * paths.turn[w, g, k]
            grips.spin[row, g] = types.vec3(turned / dt)

    @wp.func
    def pose_adjoint(
        now: Substep, t: wp.float64, dt: wp.float64, paths: Paths, grips: Grips,
        by: ConditionsAdjoint,
    ):  # fmt: skip
        """Transpose of ``pose_ahead`` for the substep that begins at t; resets its sums."""
        w = now.w
        for g in range(now.thread, grips.closed.shape[1], now.threads):
            if grips.closed[now.grip_row, g] == 1:
                moved = by.velocity[w, g] / dt
                _here, _q, knot = paths_of.placed(w, g, t, paths)
                _there, _q_end, end = paths_of.placed(w, g, t + dt, paths)
                paths_of.pose_adjoint(w, g, t, -moved, wp.vec3d(), paths, by.position, by.turn)
                paths_of.pose_adjoint(
                    w, g, t + dt, by.centre[w, g] + moved, by.rotation[w, g], paths,
                    by.position, by.turn,
                )  # fmt: skip
                if paths.turns[w, g] == 1:
                    for k in range(knot, end + 1):
                        by_turn = (paths_of.share_of(w, g, k, t, dt, paths) / dt) * by.spin[w, g]
                        paths_of.turn_adjoint(
                            w, g, k, wp.float64(0.0), wp.vec3d(), by_turn, paths, by.turn
                        )
                by.centre[w, g] = wp.vec3d()
                by.rotation[w, g] = wp.vec3d()
                by.velocity[w, g] = wp.vec3d()
                by.spin[w, g] = wp.vec3d()

    return functions_of(locals())
