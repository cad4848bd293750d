"""The substep of the material point method, forward and transposed: the algorithm at a glance.

    1. forces          impulses between particles, damping, air      (internal_forces, elasticity)
    2. touch           the table changes velocities                  (boundary)
    3. p2g             mass and momentum of particles to the grid    (transfer)
    4. normalise       velocity of a node = momentum / mass          (transfer)
    5. move gripped    what grippers hold firmly goes with them      (gripped)
    6. g2p             velocity and affine velocity from the grid; x += dt v

Both devices run this code: a block of threads on CUDA, one thread on the CPU, each for one world.
Loops take every ``threads``-th particle from ``thread`` on. How particles are stored differs, see
``particles``. Symplectic Euler.

Shapes: W worlds, N particles, G grippers, L layouts of the grid, M nodes.
"""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.block import make_block
from gendom.sim.mpm.boundary import FOLLOWS, make_boundary, make_boundary_adjoint
from gendom.sim.mpm.elasticity import make_maxwell_branch
from gendom.sim.mpm.grid import SparseGrid
from gendom.sim.mpm.gripped import make_gripped_adjoint, make_gripped_type, make_listing
from gendom.sim.mpm.internal_forces import make_internal_forces
from gendom.sim.mpm.particles import MASS, Variant, make_adjoint, make_moving, make_taped
from gendom.sim.mpm.transfer import make_bspline, make_transfer
from gendom.sim.mpm.types import make_types

OK = 0
GRID_FULL = 1
INVERTED = 2
DIVERGED = 3
NOT_FINITE = 4
"""Status of a world whose derivatives overflowed."""
NOTHING_HELD = 5
"""Status of a world in which a gripper closed on nothing."""


@functools.cache
def make_substep(variant: Variant, *, taped: bool) -> Any:
    """Build ``substep`` of one world.

    Args:
        variant: What kernels are compiled for.
        taped: Whether what the reverse needs is recorded.
    """
    real = variant.real
    types = make_types(real)
    Nodes = types.Nodes
    vec3, mat33 = types.vec3, types.mat33
    Matter, Conditions, Grips, Clock = types.Matter, types.Conditions, types.Grips, types.Clock
    moving, recorded = make_moving(variant), make_taped(variant)
    Particles, Tape = moving.Struct, recorded.Struct
    fields, kept = moving.fields, recorded.fields
    forces_of = make_internal_forces(variant)
    bspline, transfer = make_bspline(real, windowed=not variant.rows), make_transfer(real)
    window_type = bspline.window
    boundary, drive = make_boundary(variant), make_listing(variant).drive
    Gripped = make_gripped_type(real)
    block, branch = make_block(real), make_maxwell_branch(real).branch
    compensates = wp.constant(int(types.compensates))
    damped, keeps = wp.constant(int(variant.damped)), wp.constant(int(taped))
    # the CPU divides momenta in place, and CUDA empties what it has divided
    clears = wp.constant(int(taped or variant.rows))
    empties = wp.constant(int(not taped and not variant.rows))

    # while, not range: with range the CPU's compiler cannot tell that indices are not negative, and
    # checks every array index (a fifth slower)

    @wp.func
    def momentum_of(
        w: int, i: int, h: real, mass: real, gravity: vec3, matter: Matter, particles: Particles
    ):
        """Momentum of a particle with all impulses of the substep but the table's."""
        own = mass * (fields.v(particles, w, i) + h * gravity)
        return own + forces_of.impulse_on(w, i, matter, particles)

    @wp.func
    def record_state(
        w: int, thread: int, threads: int, slot: int, N: int, particles: Particles, tape: Tape
    ):
        i = int(thread)
        while i < N:
            kept.put_x(tape, slot, i, fields.x(particles, w, i))
            kept.put_v(tape, slot, i, fields.v(particles, w, i))
            kept.put_C(tape, slot, i, fields.C(particles, w, i))
            if damped == 1:
                for c in range(6):
                    kept.put_Z(tape, slot, c, i, fields.get_Z(particles, w, c, i))
            i += threads

    @wp.func
    def record_momenta(
        w: int, thread: int, threads: int, slot: int, N: int, h: real, mass: real, gravity: vec3,
        matter: Matter, particles: Particles, tape: Tape,
    ):  # fmt: skip
        i = int(thread)
        while i < N:
            kept.put_q(tape, slot, i, momentum_of(w, i, h, mass, gravity, matter, particles))
            i += threads

    @wp.func
    def touch(
        w: int, thread: int, threads: int, N: int, h: real, mass: real, gravity: vec3,
        matter: Matter, conditions: Conditions, particles: Particles,
    ):  # fmt: skip
        """Add to velocities what the table changes of each section's."""
        size = matter.section
        share = real(1.0) / real(size)
        s = int(thread)
        while s < N // size:
            first = moving.x_of(particles, w, s * size)
            if boundary.near_table(first, matter, conditions):
                x = vec3()
                q = vec3()
                for p in range(s * size, (s + 1) * size):
                    i = moving.place(particles, w, p)
                    x += fields.x(particles, w, i)
                    q += momentum_of(w, i, h, mass, gravity, matter, particles)
                change = boundary.contact(
                    w, share * x, (share / mass) * q, h, matter.contact_radius, conditions
                )
                if wp.length_sq(change) > real(0.0):
                    for p in range(s * size, (s + 1) * size):
                        i = moving.place(particles, w, p)
                        fields.put_v(particles, w, i, fields.v(particles, w, i) + change)
            s += threads

    @wp.func
    def p2g(
        w: int, thread: int, threads: int, N: int, h: real, mass: real, gravity: vec3, layout: int,
        slot: int, inv_dx: real, matter: Matter, gripped: Gripped, particles: Particles,
        grid: SparseGrid, momentum: Nodes,
    ):  # fmt: skip
        """Add to the grid mass and momentum of particles that are not held firmly."""
        window = window_type()
        held = wp.vec3i(-1, -1, -1)
        end = (thread + 1) * N // threads
        i = thread * N // threads - 1
        while i < end - 1:
            i += 1
            free = gripped.free[w, i]
            if free == real(0.0):
                continue
            q = momentum_of(w, i, h, mass, gravity, matter, particles)
            if free < real(1.0):
                q += (real(1.0) - free) * (mass * gripped.driven[w, i] - q)
            node, f, given = transfer.given_by(
                fields.x(particles, w, i), q, fields.C(particles, w, i), mass, layout, inv_dx, grid
            )
            window = bspline.scatter(
                window, held, node, f, given, momentum, slot, grid.start, layout
            )
            held = node
        bspline.flush(window, held, momentum, slot, grid.start, layout)

    @wp.func
    def move(w: int, i: int, x: vec3, v: vec3, affine: mat33, h: real, dx: real, of: Particles):
        """Advance a particle from x; return the square of its way [m^2], too long a one for a NaN.

        In float32, x rounded alone loses what is smaller than its last bit: slow bodies stand
        still. What rounding leaves out is kept and added with the next step. Source: Kahan (1965),
        "Further remarks on reducing truncation errors".
        """
        if compensates == 1:
            more = h * v + fields.low(of, w, i)
            there = x + more
            fields.put_x(of, w, i, there)
            fields.put_low(of, w, i, more - (there - x))
        else:
            fields.put_x(of, w, i, x + h * v)
        fields.put_v(of, w, i, v)
        fields.put_C(of, w, i, affine)
        far = wp.length_sq(v) * h * h
        if not (far <= dx * dx):
            far = real(4.0) * dx * dx
        return far

    @wp.func
    def move_gripped(
        w: int, thread: int, threads: int, holding: int, grip_row: int, h: real, dx: real,
        grips: Grips, gripped: Gripped, particles: Particles,
    ):  # fmt: skip
        """Move what grippers hold firmly; return the square of a thread's longest way."""
        far = real(0.0)
        for n in range(thread, holding, threads):
            if gripped.share[w, n] == real(0.0):
                i = gripped.index[w, n]
                x = fields.x(particles, w, i)
                v, spin, _by_b = boundary.follow(
                    gripped.gripper[w, n], gripped.place[w, n], grip_row, x, real(FOLLOWS), h, grips
                )
                far = wp.max(far, move(w, i, x, v, wp.skew(spin), h, dx, particles))
        return far

    @wp.func
    def g2p(
        w: int, thread: int, threads: int, N: int, h: real, dx: real, layout: int, row: int,
        gripped: Gripped, particles: Particles, grid: SparseGrid, velocity: Nodes,
    ):  # fmt: skip
        """Move all others with the grid; return the square of a thread's longest way."""
        far = real(0.0)
        inv_dx = real(1.0) / dx
        i = int(thread)
        while i < N:
            if gripped.free[w, i] > real(0.0):
                x = fields.x(particles, w, i)
                v, affine = transfer.g2p(layout, row, x, inv_dx, grid, velocity)
                far = wp.max(far, move(w, i, x, v, affine, h, dx, particles))
            i += threads
        return far

    @wp.func
    def substep(
        w: int, thread: int, threads: int, h: real, age: int, layout: int, slot: int,
        near_table: int, holding: int, grip_row: int, mass: real, gravity: vec3,
        keep_velocity: real, matter: Matter, conditions: Conditions, clock: Clock, grips: Grips,
        gripped: Gripped, particles: Particles, tape: Tape, grid: SparseGrid, momentum: Nodes,
        velocity: Nodes,
    ):  # fmt: skip
        """Take a world's particles from one state to the next.

        Returns the status and the square of the longest way of a thread's particles [m^2]. Nothing
        moves if a particle is inverted.
        """
        N = gripped.free.shape[1]
        dx = conditions.dx
        nodes = grid.count[layout]
        for n in range(thread, holding, threads):
            if gripped.share[w, n] > real(0.0):
                x = fields.x(particles, w, gripped.index[w, n])
                drive(w, n, x, grip_row, h, matter, conditions, grips, gripped)
        if keeps == 1:
            tape.layout_of[slot] = layout
            record_state(w, thread, threads, slot, N, particles, tape)
        if clears == 1:
            bspline.clear(momentum, slot, thread, threads, nodes)
        keep, share = branch(matter.damping[w], h, age)
        inverted = forces_of.forces(
            w, thread, threads, h, keep, share, mass, matter, clock, particles
        )
        if inverted == 1:
            return INVERTED, real(0.0)
        if keeps == 1:
            record_momenta(w, thread, threads, slot, N, h, mass, gravity, matter, particles, tape)
            block.sync()
        if near_table == 1:
            touch(w, thread, threads, N, h, mass, gravity, matter, conditions, particles)
            block.sync()
        p2g(
            w, thread, threads, N, h, mass, gravity, layout, slot, real(1.0) / dx, matter, gripped,
            particles, grid, momentum,
        )  # fmt: skip
        block.sync()
        far = move_gripped(w, thread, threads, holding, grip_row, h, dx, grips, gripped, particles)
        bspline.normalise(
            momentum, slot, velocity, 0, thread, threads, nodes, keep_velocity, empties
        )
        block.sync()
        far = wp.max(
            far,
            g2p(w, thread, threads, N, h, dx, layout, 0, gripped, particles, grid, velocity),
        )
        return OK, far

    return substep


@functools.cache
def make_substep_adjoint(variant: Variant) -> Any:
    """Build ``substep_adjoint``, which carries derivatives over one recorded substep backwards."""
    real = variant.real
    types = make_types(real)
    Nodes = types.Nodes
    vec3, mat33 = types.vec3, types.mat33
    Matter, Conditions, Grips = types.Matter, types.Conditions, types.Grips
    ConditionsAdjoint, Gripped = types.ConditionsAdjoint, make_gripped_type(real)
    taped, adjoint_of = make_taped(variant), make_adjoint(variant)
    Tape, Adjoint = taped.Struct, adjoint_of.Struct
    before, fields = taped.fields, adjoint_of.fields
    forces_of = make_internal_forces(variant)
    bspline, transfer = make_bspline(real, windowed=not variant.rows), make_transfer(real)
    window_type = bspline.window
    boundary, contact = make_boundary_adjoint(variant), make_boundary(variant).contact
    gripped_adjoint, drive = make_gripped_adjoint(variant), make_listing(variant).drive
    block, branch = make_block(real), make_maxwell_branch(real).branch
    largest = 1.0e37 if real == wp.float32 else 1.0e300

    @wp.func
    def section_motion(s: int, slot: int, mass: real, matter: Matter, tape: Tape):
        """Mean position of section s, and its mean velocity without contact."""
        size = matter.section
        x = vec3()
        q = vec3()
        for p in range(s * size, (s + 1) * size):
            i = taped.place(tape, slot, p)
            x += before.x(tape, slot, i)
            q += before.q(tape, slot, i)
        share = real(1.0) / real(size)
        return share * x, (share / mass) * q

    @wp.func
    def g2p_adjoint(
        w: int, row: int, thread: int, threads: int, N: int, slot: int, h: real, layout: int,
        inv_dx: real, gripped: Gripped, tape: Tape, adjoint: Adjoint, grid: SparseGrid,
        velocity: Nodes, nodes_bar: Nodes,
    ):  # fmt: skip
        """Set derivatives by the nodes' velocities, add to those by x."""
        window = window_type()
        held = wp.vec3i(-1, -1, -1)
        end = (thread + 1) * N // threads
        i = thread * N // threads - 1
        while i < end - 1:
            i += 1
            if gripped.free[w, i] == real(0.0):
                continue
            node, f, taken = transfer.taken_by(
                before.x(tape, slot, i), fields.v(adjoint, w, i) + h * fields.x(adjoint, w, i),
                fields.C(adjoint, w, i), layout, inv_dx, grid,
            )  # fmt: skip
            window = bspline.scatter(
                window, held, node, f, taken, nodes_bar, row, grid.start, layout
            )
            held = node
        bspline.flush(window, held, nodes_bar, row, grid.start, layout)
        block.sync()
        i = int(thread)
        while i < N:
            if gripped.free[w, i] > real(0.0):
                x_bar = fields.x(adjoint, w, i)
                x_bar += transfer.g2p_adjoint(
                    before.x(tape, slot, i), fields.v(adjoint, w, i) + h * x_bar,
                    fields.C(adjoint, w, i), layout, row, inv_dx, grid, velocity,
                )  # fmt: skip
                fields.put_x(adjoint, w, i, x_bar)
            i += threads

    @wp.func
    def p2g_adjoint(
        w: int, row: int, thread: int, threads: int, N: int, slot: int, gone: int, mass: real,
        layout: int, inv_dx: real, matter: Matter, conditions: Conditions, gripped: Gripped,
        tape: Tape, touched: wp.array2d(dtype=vec3), adjoint: Adjoint, grid: SparseGrid,
        nodes_bar: Nodes, by: ConditionsAdjoint,
    ):  # fmt: skip
        """Set derivatives by C and by v (as found in those by momentum), add to those by x, m."""
        per_mass = real(1.0) / mass
        sums = adjoint.sums
        i = int(thread)
        while i < N:
            free = gripped.free[w, i]
            x_bar = vec3()
            u_bar = vec3()
            C_bar = mat33()
            mass_bar = real(0.0)
            if free > real(0.0):
                own = per_mass * before.q(tape, slot, i)
                u = own
                if conditions.table == 1:
                    u += touched[w, adjoint_of.particle(adjoint, w, i) // matter.section]
                v = u
                if free < real(1.0):
                    v += (real(1.0) - free) * (gripped.driven[w, i] - u)
                x_bar, q_bar, C_bar, mass_bar = transfer.p2g_adjoint(
                    before.x(tape, slot, i), mass * v, before.C(tape, slot, i), mass, layout, row,
                    inv_dx, grid, nodes_bar,
                )  # fmt: skip
                mass_bar += wp.dot(q_bar, v)
                u_bar = (free * mass) * q_bar
                # its own velocity is momentum over mass
                mass_bar -= per_mass * wp.dot(u_bar, own)
            fields.put_x(adjoint, w, i, fields.x(adjoint, w, i) + x_bar)
            fields.put_v(adjoint, w, i, u_bar)
            fields.put_C(adjoint, w, i, C_bar)
            sums[w, MASS, i] = sums[w, MASS, i] + mass_bar
            # the first one found is named; a NaN is not below anything
            size = wp.length_sq(x_bar) + wp.length_sq(u_bar)
            if not (size < real(largest)) and wp.atomic_max(by.status, w, NOT_FINITE) == OK:
                by.failed_particle[w] = adjoint_of.particle(adjoint, w, i)
                by.failed_slot[w] = gone
            i += threads

    @wp.func
    def touch_adjoint(
        w: int, thread: int, threads: int, N: int, slot: int, h: real, mass: real, matter: Matter,
        conditions: Conditions, tape: Tape, touched: wp.array2d(dtype=vec3), adjoint: Adjoint,
        by: ConditionsAdjoint,
    ):  # fmt: skip
        """Add to derivatives by x, by momenta (as found in those by v) and by mass."""
        size = matter.section
        sums = adjoint.sums
        s = int(thread)
        while s < N // size:
            if wp.length_sq(touched[w, s]) > real(0.0):
                change_bar = vec3()
                for p in range(s * size, (s + 1) * size):
                    change_bar += fields.v(adjoint, w, adjoint_of.place(adjoint, w, p))
                x, u = section_motion(s, slot, mass, matter, tape)
                by_x, by_u = boundary.contact_adjoint(
                    w, x, u, h, matter.contact_radius, conditions, change_bar, by
                )
                # u is momentum over mass
                first = adjoint_of.place(adjoint, w, s * size)
                sums[w, MASS, first] = sums[w, MASS, first] - wp.dot(by_u, u) / mass
                by_x = by_x / real(size)
                by_u = by_u / real(size)
                for p in range(s * size, (s + 1) * size):
                    i = adjoint_of.place(adjoint, w, p)
                    fields.put_x(adjoint, w, i, fields.x(adjoint, w, i) + by_x)
                    fields.put_v(adjoint, w, i, fields.v(adjoint, w, i) + by_u)
            s += threads

    @wp.func
    def momenta_adjoint(
        w: int, thread: int, threads: int, N: int, slot: int, h: real, mass: real, gravity: vec3,
        matter: Matter, tape: Tape, adjoint: Adjoint, by: ConditionsAdjoint,
    ):  # fmt: skip
        """From derivatives by momenta to those by x, v, mass and gravity."""
        sums = adjoint.sums
        gravity_sum = vec3()
        i = int(thread)
        while i < N:
            x_bar, wind_bar = forces_of.impulse_on_adjoint(w, i, matter, adjoint)
            fields.put_x(adjoint, w, i, fields.x(adjoint, w, i) + x_bar)
            v_bar = fields.v(adjoint, w, i)
            gravity_sum += h * v_bar
            speed = before.v(tape, slot, i) + h * gravity
            sums[w, MASS, i] = sums[w, MASS, i] + wp.dot(v_bar, speed) / mass
            fields.put_v(adjoint, w, i, v_bar + wind_bar)
            i += threads
        wp.atomic_add(by.gravity, w, boundary.wide(gravity_sum))

    @wp.func
    def substep_adjoint(
        w: int, row: int, thread: int, threads: int, h: real, age: int, layout: int, slot: int,
        gone: int, holding: int, grip_row: int, mass: real, gravity: vec3, keep_velocity: real,
        matter: Matter, conditions: Conditions, grips: Grips, gripped: Gripped, tape: Tape,
        touched: wp.array2d(dtype=vec3), adjoint: Adjoint, grid: SparseGrid, momentum: Nodes,
        velocity: Nodes, nodes_bar: Nodes, by: ConditionsAdjoint,
    ):  # fmt: skip
        """From derivatives by the state after substep ``gone`` of a recording to those by the state
        before it. ``row`` is the world's of ``velocity`` and ``nodes_bar``, which are scratch."""
        N = gripped.free.shape[1]
        inv_dx = real(1.0) / conditions.dx
        nodes = grid.count[layout]
        for n in range(thread, holding, threads):
            if gripped.share[w, n] > real(0.0):
                x = before.x(tape, slot, gripped.index[w, n])
                drive(w, n, x, grip_row, h, matter, conditions, grips, gripped)
        if conditions.table == 1:
            for s in range(thread, N // matter.section, threads):
                x, u = section_motion(s, slot, mass, matter, tape)
                touched[w, s] = contact(w, x, u, h, matter.contact_radius, conditions)
        bspline.normalise(momentum, slot, velocity, row, thread, threads, nodes, keep_velocity, 0)
        bspline.clear(nodes_bar, row, thread, threads, nodes)
        block.sync()
        g2p_adjoint(
            w, row, thread, threads, N, slot, h, layout, inv_dx, gripped, tape, adjoint, grid,
            velocity, nodes_bar,
        )  # fmt: skip
        if holding > 0:
            gripped_adjoint.firm_adjoint(
                w, thread, threads, holding, grip_row, h, grips, gripped, adjoint, by
            )
        by_keep = bspline.normalise_adjoint(
            momentum, slot, nodes_bar, row, thread, threads, nodes, keep_velocity
        )
        wp.atomic_add(by.damping_factor, w, by_keep)
        block.sync()
        p2g_adjoint(
            w, row, thread, threads, N, slot, gone, mass, layout, inv_dx, matter, conditions,
            gripped, tape, touched, adjoint, grid, nodes_bar, by,
        )  # fmt: skip
        block.sync()
        if holding > 0:
            gripped_adjoint.partial_adjoint(
                w, thread, threads, holding, grip_row, slot, h, mass, matter, conditions, grips,
                gripped, tape, touched, adjoint, by,
            )  # fmt: skip
            block.sync()
        if conditions.table == 1:
            touch_adjoint(
                w, thread, threads, N, slot, h, mass, matter, conditions, tape, touched, adjoint, by
            )
            block.sync()
        keep, share = branch(matter.damping[w], h, age)
        forces_of.forces_adjoint(
            w, thread, threads, slot, age, h, keep, share, mass, matter, tape, adjoint, by
        )
        block.sync()
        momenta_adjoint(w, thread, threads, N, slot, h, mass, gravity, matter, tape, adjoint, by)
        block.sync()

    return substep_adjoint
