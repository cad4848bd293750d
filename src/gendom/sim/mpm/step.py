"""The substep of the material point method, forward and transposed: the algorithm at a glance.

    1. forces          impulses between particles, damping, air      (internal_forces)
    2. touch           the table changes velocities                  (boundary)
    3. p2g             mass and momentum of particles to the grid    (transfer)
    4. normalise       velocity of a node = momentum / mass          (transfer)
    5. move gripped    what grippers hold firmly goes with them      (gripped)
    6. g2p             velocity and affine velocity from the grid; x += dt v

Both devices run this code: a block of threads on CUDA, one thread on the CPU, each for one world.
Loops take every ``threads``-th particle from ``thread`` on. Symplectic Euler.

Shapes: W worlds, N particles, G grippers, L layouts of the grid, M nodes.
"""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.block import make_block
from gendom.sim.mpm.boundary import FOLLOWS, make_boundary
from gendom.sim.mpm.gripped import make_gripped
from gendom.sim.mpm.internal_forces import make_internal_forces
from gendom.sim.mpm.particles import MASS, Variant, make_moving, make_taped
from gendom.sim.mpm.transfer import make_bspline, make_transfer
from gendom.sim.mpm.types import INVERTED, OK, make_types


@functools.cache
def make_substep(variant: Variant, *, taped: bool) -> Any:
    """Build ``substep`` of one world.

    Args:
        variant: What kernels are compiled for.
        taped: Whether what the reverse needs is recorded.
    """
    real = variant.real
    types = make_types(real)
    vec3, mat33 = types.vec3, types.mat33
    Model, Grips, Clock = types.Model, types.Grips, types.Clock
    Records, fields, kept = types.Records, make_moving(variant), make_taped(variant)
    forces_of = make_internal_forces(variant)
    bspline, transfer = make_bspline(real, windowed=variant.threads > 1), make_transfer(real)
    window_type = bspline.window
    boundary, gripped = make_boundary(variant), make_gripped(variant)
    Substep, Grid = types.Substep, types.Grid
    block = make_block(real)
    compensates = wp.constant(int(types.compensates))
    damped, keeps = wp.constant(int(variant.damped)), wp.constant(int(taped))

    @wp.func
    def momentum_of(now: Substep, i: int, particles: Records):
        """Momentum of a particle with all impulses of the substep but the table's."""
        own = now.mass * (fields.v(particles, now.w, i) + now.h * now.gravity)
        return own + forces_of.pulled(now.w, i, particles.of, particles.near)

    @wp.func
    def touch(now: Substep, model: Model, particles: Records):
        """Add to velocities what the table changes of each section's."""
        size = model.section
        share = real(1.0) / real(size)
        for s in range(now.thread, now.N // size, now.threads):
            first = fields.x_of(particles, now.w, s * size)
            if first[2] < real(2.0) * (model.contact_radius + model.dx):  # it may touch
                x = vec3()
                q = vec3()
                for p in range(s * size, (s + 1) * size):
                    i = fields.place(particles, now.w, p)
                    x += fields.x(particles, now.w, i)
                    q += momentum_of(now, i, particles)
                change = boundary.contact(now, share * x, (share / now.mass) * q, model)
                if wp.length_sq(change) > real(0.0):
                    for p in range(s * size, (s + 1) * size):
                        i = fields.place(particles, now.w, p)
                        fields.put_v(particles, now.w, i, fields.v(particles, now.w, i) + change)

    @wp.func
    def p2g(now: Substep, grips: Grips, particles: Records, grid: Grid):
        """Add to the grid mass and momentum of particles that are not held firmly."""
        window = window_type()
        held = wp.vec3i(-1, -1, -1)
        begin = now.thread * now.N // now.threads
        for i in range(begin, (now.thread + 1) * now.N // now.threads):
            free = grips.stored_free[now.w, i]
            if free == real(0.0):
                continue
            q = momentum_of(now, i, particles)
            if free < real(1.0):
                q += (real(1.0) - free) * (now.mass * grips.driven[now.w, i] - q)
            node, f, given = transfer.given_by(
                now, fields.x(particles, now.w, i), q, fields.C(particles, now.w, i), grid
            )
            window = bspline.scatter(
                window, held, node, f, given, grid.momentum, now.slot, grid.start, now.layout
            )
            held = node
        bspline.flush(window, held, grid.momentum, now.slot, grid.start, now.layout)

    @wp.func
    def move(now: Substep, i: int, x: vec3, v: vec3, affine: mat33, of: Records):
        """Advance a particle from x; return the square of its way [m^2], too long a one for a NaN.

        In float32, x rounded alone loses what is smaller than its last bit: slow bodies stand
        still. What rounding leaves out is kept and added with the next step. Source: Kahan (1965),
        "Further remarks on reducing truncation errors".
        """
        if compensates == 1:
            more = now.h * v + fields.low(of, now.w, i)
            there = x + more
            fields.put_x(of, now.w, i, there)
            fields.put_low(of, now.w, i, more - (there - x))
        else:
            fields.put_x(of, now.w, i, x + now.h * v)
        fields.put_v(of, now.w, i, v)
        fields.put_C(of, now.w, i, affine)
        far = wp.length_sq(v) * now.h * now.h
        if not (far <= now.dx * now.dx):
            far = real(4.0) * now.dx * now.dx
        return far

    @wp.func
    def move_gripped(now: Substep, grips: Grips, particles: Records):
        """Move what grippers hold firmly; return the square of a thread's longest way."""
        far = real(0.0)
        for n in range(now.thread, now.holding, now.threads):
            if grips.held_share[now.w, n] == real(0.0):
                i = grips.held_index[now.w, n]
                x = fields.x(particles, now.w, i)
                v, spin, _by_b = boundary.follow(
                    now, grips.held_gripper[now.w, n], grips.held_place[now.w, n], x, real(FOLLOWS),
                    grips,
                )  # fmt: skip
                far = wp.max(far, move(now, i, x, v, wp.skew(spin), particles))
        return far

    @wp.func
    def g2p(now: Substep, grips: Grips, particles: Records, grid: Grid):
        """Move all others with the grid; return the square of a thread's longest way."""
        far = real(0.0)
        for i in range(now.thread, now.N, now.threads):
            if grips.stored_free[now.w, i] > real(0.0):
                x = fields.x(particles, now.w, i)
                v, affine = transfer.g2p(now, x, grid)
                far = wp.max(far, move(now, i, x, v, affine, particles))
        return far

    @wp.func
    def substep(
        now: Substep, model: Model, clock: Clock, grips: Grips, particles: Records, tape: Records,
        grid: Grid,
    ):  # fmt: skip
        """Take a world's particles from one state to the next.

        Returns the status and the square of the longest way of a thread's particles [m^2]. Nothing
        moves if a particle is inverted.
        """
        nodes = grid.count[now.layout]
        for n in range(now.thread, now.holding, now.threads):
            if grips.held_share[now.w, n] > real(0.0):
                x = fields.x(particles, now.w, grips.held_index[now.w, n])
                gripped.drive(now, n, x, model, grips)
        if keeps == 1:
            tape.layout_of[now.slot] = now.layout
            for i in range(now.thread, now.N, now.threads):
                kept.put_x(tape, now.slot, i, fields.x(particles, now.w, i))
                kept.put_v(tape, now.slot, i, fields.v(particles, now.w, i))
                kept.put_C(tape, now.slot, i, fields.C(particles, now.w, i))
                if damped == 1:
                    kept.put_Z(tape, now.slot, i, fields.Z(particles, now.w, i))
            bspline.clear(grid.momentum, now.slot, now.thread, now.threads, nodes)
        inverted = forces_of.forces(now, model, clock, particles)
        if inverted == 1:
            return INVERTED, real(0.0)
        if keeps == 1:
            for i in range(now.thread, now.N, now.threads):
                kept.put_q(tape, now.slot, i, momentum_of(now, i, particles))
            block.sync()
        if model.table == 1:
            touch(now, model, particles)
            block.sync()
        p2g(now, grips, particles, grid)
        block.sync()
        far = move_gripped(now, grips, particles)
        bspline.normalise(
            grid.momentum, now.slot, grid.velocity, now.row, now.thread, now.threads, nodes,
            now.keep_velocity, 1 - keeps,
        )  # fmt: skip
        block.sync()
        far = wp.max(far, g2p(now, grips, particles, grid))
        return OK, far

    return substep


@functools.cache
def make_substep_adjoint(variant: Variant) -> Any:
    """Build ``substep_adjoint``, which carries derivatives over one recorded substep backwards."""
    real = variant.real
    types = make_types(real)
    vec3, mat33 = types.vec3, types.mat33
    Model, Grips = types.Model, types.Grips
    ConditionsAdjoint, Substep, Grid = types.ConditionsAdjoint, types.Substep, types.Grid
    Records, before, fields = types.Records, make_taped(variant), make_moving(variant)
    forces_of = make_internal_forces(variant)
    bspline, transfer = make_bspline(real, windowed=variant.threads > 1), make_transfer(real)
    window_type = bspline.window
    boundary, gripped = make_boundary(variant), make_gripped(variant)
    block = make_block(real)

    @wp.func
    def section_motion(now: Substep, s: int, model: Model, tape: Records):
        """Mean position of section s, and its mean velocity without contact."""
        size = model.section
        x = vec3()
        q = vec3()
        for p in range(s * size, (s + 1) * size):
            i = before.place(tape, now.slot, p)
            x += before.x(tape, now.slot, i)
            q += before.q(tape, now.slot, i)
        share = real(1.0) / real(size)
        return share * x, (share / now.mass) * q

    @wp.func
    def g2p_adjoint(now: Substep, grips: Grips, tape: Records, adjoint: Records, grid: Grid):
        """Set derivatives by the nodes' velocities, add to those by x."""
        window = window_type()
        held = wp.vec3i(-1, -1, -1)
        begin = now.thread * now.N // now.threads
        for i in range(begin, (now.thread + 1) * now.N // now.threads):
            if grips.stored_free[now.w, i] == real(0.0):
                continue
            node, f, taken = transfer.taken_by(
                now, before.x(tape, now.slot, i),
                fields.v(adjoint, now.w, i) + now.h * fields.x(adjoint, now.w, i),
                fields.C(adjoint, now.w, i), grid,
            )  # fmt: skip
            window = bspline.scatter(
                window, held, node, f, taken, grid.velocity_bar, now.row, grid.start, now.layout
            )
            held = node
        bspline.flush(window, held, grid.velocity_bar, now.row, grid.start, now.layout)
        block.sync()
        for i in range(now.thread, now.N, now.threads):
            if grips.stored_free[now.w, i] > real(0.0):
                x_bar = fields.x(adjoint, now.w, i)
                x_bar += transfer.g2p_adjoint(
                    now, before.x(tape, now.slot, i), fields.v(adjoint, now.w, i) + now.h * x_bar,
                    fields.C(adjoint, now.w, i), grid,
                )  # fmt: skip
                fields.put_x(adjoint, now.w, i, x_bar)

    @wp.func
    def p2g_adjoint(
        now: Substep, model: Model, grips: Grips, tape: Records, adjoint: Records, grid: Grid,
        by: ConditionsAdjoint,
    ):  # fmt: skip
        """Set derivatives by C and by v (as found in those by momentum), add to those by x, m."""
        per_mass = real(1.0) / now.mass
        sums = adjoint.sums
        for i in range(now.thread, now.N, now.threads):
            free = grips.stored_free[now.w, i]
            x_bar = vec3()
            u_bar = vec3()
            C_bar = mat33()
            mass_bar = real(0.0)
            if free > real(0.0):
                own = per_mass * before.q(tape, now.slot, i)
                u = own
                if model.table == 1:
                    u += by.touched[now.w, fields.particle(adjoint, now.w, i) // model.section]
                v = u
                if free < real(1.0):
                    v += (real(1.0) - free) * (grips.driven[now.w, i] - u)
                x_bar, q_bar, C_bar, mass_bar = transfer.p2g_adjoint(
                    now, before.x(tape, now.slot, i), now.mass * v, before.C(tape, now.slot, i),
                    grid,
                )  # fmt: skip
                mass_bar += wp.dot(q_bar, v)
                u_bar = (free * now.mass) * q_bar
                # its own velocity is momentum over mass
                mass_bar -= per_mass * wp.dot(u_bar, own)
            fields.put_x(adjoint, now.w, i, fields.x(adjoint, now.w, i) + x_bar)
            fields.put_v(adjoint, now.w, i, u_bar)
            fields.put_C(adjoint, now.w, i, C_bar)
            sums[now.w, MASS, i] = sums[now.w, MASS, i] + mass_bar

    @wp.func
    def touch_adjoint(
        now: Substep, model: Model, tape: Records, adjoint: Records, by: ConditionsAdjoint
    ):
        """Add to derivatives by x, by momenta (as found in those by v) and by mass."""
        size = model.section
        sums = adjoint.sums
        for s in range(now.thread, now.N // size, now.threads):
            if wp.length_sq(by.touched[now.w, s]) > real(0.0):
                change_bar = vec3()
                for p in range(s * size, (s + 1) * size):
                    change_bar += fields.v(adjoint, now.w, fields.place(adjoint, now.w, p))
                x, u = section_motion(now, s, model, tape)
                by_x, by_u = boundary.contact_adjoint(now, x, u, model, change_bar, by)
                # u is momentum over mass
                first = fields.place(adjoint, now.w, s * size)
                sums[now.w, MASS, first] = sums[now.w, MASS, first] - wp.dot(by_u, u) / now.mass
                by_x = by_x / real(size)
                by_u = by_u / real(size)
                for p in range(s * size, (s + 1) * size):
                    i = fields.place(adjoint, now.w, p)
                    fields.put_x(adjoint, now.w, i, fields.x(adjoint, now.w, i) + by_x)
                    fields.put_v(adjoint, now.w, i, fields.v(adjoint, now.w, i) + by_u)

    @wp.func
    def momenta_adjoint(now: Substep, tape: Records, adjoint: Records, by: ConditionsAdjoint):
        """From derivatives by momenta to those by x, v, mass and gravity."""
        sums = adjoint.sums
        gravity_sum = vec3()
        for i in range(now.thread, now.N, now.threads):
            x_bar = fields.x(adjoint, now.w, i)
            fields.put_x(
                adjoint, now.w, i, x_bar - forces_of.pulled(now.w, i, adjoint.of, adjoint.near)
            )
            v_bar = fields.v(adjoint, now.w, i)
            gravity_sum += now.h * v_bar
            speed = before.v(tape, now.slot, i) + now.h * now.gravity
            sums[now.w, MASS, i] = sums[now.w, MASS, i] + wp.dot(v_bar, speed) / now.mass
            # the air's stands in place of what rounding leaves out
            fields.put_v(adjoint, now.w, i, v_bar + fields.low(adjoint, now.w, i))
        wp.atomic_add(by.gravity, now.w, wp.vec3d(gravity_sum))

    @wp.func
    def substep_adjoint(
        now: Substep, model: Model, grips: Grips, tape: Records, adjoint: Records, grid: Grid,
        by: ConditionsAdjoint,
    ):  # fmt: skip
        """From derivatives by the state after substep ``gone`` of a recording to those by the state
        before it."""
        nodes = grid.count[now.layout]
        for n in range(now.thread, now.holding, now.threads):
            if grips.held_share[now.w, n] > real(0.0):
                x = before.x(tape, now.slot, grips.held_index[now.w, n])
                gripped.drive(now, n, x, model, grips)
        if model.table == 1:
            for s in range(now.thread, now.N // model.section, now.threads):
                x, u = section_motion(now, s, model, tape)
                by.touched[now.w, s] = boundary.contact(now, x, u, model)
        bspline.normalise(
            grid.momentum, now.slot, grid.velocity, now.row, now.thread, now.threads, nodes,
            now.keep_velocity, 0,
        )  # fmt: skip
        bspline.clear(grid.velocity_bar, now.row, now.thread, now.threads, nodes)
        block.sync()
        g2p_adjoint(now, grips, tape, adjoint, grid)
        if now.holding > 0:
            gripped.firm_adjoint(now, grips, adjoint, by)
        by_keep = bspline.normalise_adjoint(
            grid.momentum, now.slot, grid.velocity_bar, now.row, now.thread, now.threads, nodes,
            now.keep_velocity,
        )  # fmt: skip
        wp.atomic_add(by.velocity_damping, now.w, wp.float64(-now.h * now.keep_velocity) * by_keep)
        block.sync()
        p2g_adjoint(now, model, grips, tape, adjoint, grid, by)
        block.sync()
        if now.holding > 0:
            gripped.partial_adjoint(now, model, grips, tape, adjoint, by)
            block.sync()
        if model.table == 1:
            touch_adjoint(now, model, tape, adjoint, by)
            block.sync()
        forces_of.forces_adjoint(now, model, tape, adjoint, by)
        block.sync()
        momenta_adjoint(now, tape, adjoint, by)
        block.sync()

    return substep_adjoint
