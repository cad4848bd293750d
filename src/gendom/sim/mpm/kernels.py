"""The kernels: a thread or a block of threads takes one world through many substeps, or back.

A world advances by itself through substeps and frames: it rebuilds its grid where a particle may
have left it, lets grippers close and open, and records positions where a frame ends.

Shapes: W worlds, N particles, G grippers, S recorded substeps, L layouts of the grid, M nodes.
"""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.block import bounds, make_block, put_near
from gendom.sim.mpm.boundary import make_boundary, make_boundary_adjoint, make_grips
from gendom.sim.mpm.elasticity import make_maxwell_branch
from gendom.sim.mpm.grid import MARGIN, SparseGrid, make_rebuild
from gendom.sim.mpm.gripped import make_gripped_type, make_listing
from gendom.sim.mpm.native import MODULE_OPTIONS
from gendom.sim.mpm.particles import (
    ORDERLY,
    Variant,
    make_adjoint,
    make_loading,
    make_moving,
    make_sorting,
    make_taped,
)
from gendom.sim.mpm.poses import AHEAD, make_poses
from gendom.sim.mpm.step import (
    DIVERGED,
    GRID_FULL,
    NOTHING_HELD,
    OK,
    make_substep,
    make_substep_adjoint,
)
from gendom.sim.mpm.transfer import make_bspline
from gendom.sim.mpm.types import make_types

SUMS = 4
"""Sums of derivatives by a particle's parameters, see ``particles``."""


@functools.cache
def make_advance(variant: Variant, *, taped: bool) -> Any:
    """Build the kernel that takes worlds through many substeps.

    Args:
        variant: What it is compiled for.
        taped: Whether every substep is recorded for the reverse.
    """
    real = variant.real
    types = make_types(real)
    Nodes, vec4 = types.Nodes, types.vec4
    Clock, FramePlan, Matter, State = types.Clock, types.FramePlan, types.Matter, types.State
    Conditions, Paths, Grips = types.Conditions, types.Paths, types.Grips
    Gripped = make_gripped_type(real)
    moving = make_moving(variant)
    Particles, Tape, fields = moving.Struct, make_taped(variant).Struct, moving.fields
    row_at, loading = make_bspline(real, windowed=False).row_at, make_loading(variant)
    rebuild, boundary = make_rebuild(real, moving), make_boundary(variant)
    pose_ahead, list_gripped = make_poses(real).pose_ahead, make_listing(variant).list_gripped
    substep = make_substep(variant, taped=taped)
    block = make_block(real)
    compensates = wp.constant(int(types.compensates))
    keeps, rows = wp.constant(int(taped)), wp.constant(int(variant.rows))
    # known when a kernel is made: on the CPU, kernels with tiles must not run on several threads
    IN_SHARED_MEMORY, numbers = wp.constant(variant.room > 0), wp.constant(variant.numbers)
    resident = wp.constant(int(variant.room > 0))
    number_bytes = wp.constant(4 if real == wp.float32 else 8)
    before_nodes = wp.constant(variant.components)

    @wp.func
    def frame_substep(frame: int, w: int, plan: FramePlan):
        """Length of a world's substeps in a frame [s]; 0 where it has none."""
        dt = wp.float64(0.0)
        if plan.steps[frame, w] > 0:
            dt = (plan.time[frame + 1] - plan.time[frame]) / wp.float64(plan.steps[frame, w])
        return dt

    @wp.func
    def next_event(w: int, t: wp.float64, paths: Paths):
        """Time at which a gripper opens or closes next [s]."""
        soon = wp.float64(1.0e30)
        for g in range(paths.radius.shape[1]):
            if paths.hold_from[w, g] > t:
                soon = wp.min(soon, paths.hold_from[w, g])
            if paths.hold_until[w, g] > t:
                soon = wp.min(soon, paths.hold_until[w, g])
        return soon

    if variant.rows:

        @wp.func
        def load_all(
            w: int, thread: int, threads: int, afresh: int, matter: Matter, state: State,
            particles: Particles,
        ):  # fmt: skip
            """Rows are the state itself."""

        @wp.func
        def unload_all(w: int, thread: int, threads: int, state: State, particles: Particles):
            """Rows are the state itself."""

        @wp.func
        def sort(
            w: int, thread: int, threads: int, layout: int, far: real, dx: real, matter: Matter,
            grid: SparseGrid, particles: Particles, tape: Tape,
        ):  # fmt: skip
            """Rows stay in their order. Returns whether the order changed."""
            return 0

    else:
        sort_records = make_sorting(variant)

        @wp.func
        def load_all(
            w: int, thread: int, threads: int, afresh: int, matter: Matter, state: State,
            particles: Particles,
        ):  # fmt: skip
            """Make the records of a world, in the order of particles if ``afresh``."""
            for i in range(thread, state.x.shape[1], threads):
                p = int(i)
                if afresh == 1:
                    particles.order[w, i] = i
                    particles.place[w, i] = i
                else:
                    p = particles.order[w, i]
                loading.load(particles, w, i, p, state)
                if compensates == 1:
                    fields.put_low(particles, w, i, state.low[w, p])
                particles.moduli[w, 0, i] = matter.mu[w, p]
                particles.moduli[w, 1, i] = matter.lam[w, p]

        @wp.func
        def unload_all(w: int, thread: int, threads: int, state: State, particles: Particles):
            """Write the records of a world to the state."""
            for i in range(thread, state.x.shape[1], threads):
                p = particles.order[w, i]
                loading.unload(particles, w, i, p, state)
                if compensates == 1:
                    state.low[w, p] = fields.low(particles, w, i)

        @wp.func
        def sort(
            w: int, thread: int, threads: int, layout: int, far: real, dx: real, matter: Matter,
            grid: SparseGrid, particles: Particles, tape: Tape,
        ):  # fmt: skip
            """Sort the records if a particle may have come ``far``, and keep their order on the
            tape. Returns whether the order changed."""
            sorts = int(0)
            if far >= real(ORDERLY) * dx:
                sorts = 1
                sort_records(w, thread, threads, layout, real(1.0) / dx, matter, grid, particles)
            if keeps == 1:
                for i in range(thread, particles.order.shape[1], threads):
                    tape.order[layout, i] = particles.order[w, i]
                    tape.place[layout, i] = particles.place[w, i]
            return sorts

    @wp.kernel(
        module="unique", module_options=MODULE_OPTIONS, launch_bounds=bounds(variant.threads)
    )
    def advance(
        order: wp.array(dtype=wp.int32),  # world of each block
        block_threads: int,
        shared: int,  # worlds that share grid and tape: all, or 1
        most: int,  # substeps at the most
        pause: wp.float64,  # [s] no substep begins from here on
        frames: int,  # of the plan to go through
        plan: FramePlan,
        clock: Clock,
        unsorted: wp.array(dtype=real),  # [W] distance travelled since records were sorted [m]
        matter: Matter,
        conditions: Conditions,
        paths: Paths,
        grips: Grips,
        state: State,
        last_good: State,  # where the last frame began
        grid: SparseGrid,  # a layout a world; L for the tape
        # empty before and after each substep, but on the CPU; kept with the tape
        momentum: Nodes,  # [shared, M] and mass; [S * shared, M] for the tape
        velocity: Nodes,  # [shared, M] and mass; the same as momentum on the CPU without a tape
        particles: Particles,
        gripped: Gripped,
        tape: Tape,
    ):
        turn, block_thread = wp.tid()
        thread = int(block_thread)
        threads = int(block_threads)
        if rows == 1:  # known to the compiler
            thread = 0
            threads = 1
        if IN_SHARED_MEMORY:
            wp.tile_empty(shape=numbers, dtype=real, storage="shared")
        w = order[turn]
        own = w % shared
        N = state.x.shape[1]
        grippers = grips.closed.shape[1]
        frame = int(clock.frame[w])
        status = int(clock.status[w])
        if frame >= frames or status != OK:
            return
        dt = frame_substep(frame, w, plan)
        step = int(clock.step[w])
        t = plan.time[frame] + wp.float64(step) * dt
        if t >= pause:
            return
        dx = conditions.dx
        mass = matter.mass[w]
        gravity = conditions.gravity[w]
        steps = int(plan.steps[frame, w])
        h = real(dt)
        keep_velocity = wp.exp(-conditions.velocity_damping[w] * h)
        # of grid and layout; in place unless all are kept
        slot = int(own)
        layout = int(own)
        made = int(own)
        age = clock.age[w]
        holding = int(gripped.count[w])
        travel = clock.travel[w]
        near_by = int(clock.near_table[w])
        event = wp.float64(-1.0e30)
        posed = int(-AHEAD)  # the substep from which on poses are known
        left = int(most)
        far = unsorted[w]
        afresh = int(0)
        if travel >= real(MARGIN) * dx:  # whatever the order was, it will be made anew
            afresh = 1
            far = real(ORDERLY) * dx
        # the nodes' velocities stand behind the particles where they fit
        room = momentum.shape[1]
        velocity_at = row_at(velocity, own)
        offset = (before_nodes * N + 3) // 4 * 4
        if resident == 1 and offset + 4 * room <= numbers:
            velocity_at = block.resident_at(number_bytes * offset)
        nodal = wp.array(ptr=velocity_at, shape=(1, room), dtype=vec4)
        load_all(w, thread, threads, afresh, matter, state, particles)
        block.sync()
        if step == 0:
            for i in range(thread, N, threads):
                loading.unload(particles, w, i, moving.particle(particles, w, i), last_good)
        while frame < frames and left > 0 and status == OK and t < pause:
            if step < steps and travel >= real(MARGIN) * dx:
                if keeps == 1:
                    if made >= grid.count.shape[0]:
                        left = 0  # the tape is full
                    else:
                        layout = made
                        made += shared
                if left > 0:
                    fits = rebuild(
                        w, thread, threads, N, layout, room, real(1.0) / dx, particles, grid
                    )
                    status = GRID_FULL
                    if fits:
                        status = OK
                        far += travel
                        travel = real(0.0)
                        near = int(0)
                        for i in range(thread, N, threads):
                            if boundary.near_table(fields.x(particles, w, i), matter, conditions):
                                near = 1
                        near_by = block.any(near)
                        if (
                            sort(w, thread, threads, layout, far, dx, matter, grid, particles, tape)
                            == 1
                        ):
                            far = real(0.0)
                            holding = list_gripped(
                                w, thread, threads, particles, matter, grips, gripped
                            )
                    elif thread == 0:
                        # the grid's need is read from the world's first layout
                        for a in range(4):
                            grid.bounds[own, a] = grid.bounds[layout, a]
            goes_on = step < steps and status == OK and left > 0
            if goes_on and t >= event:
                empty = int(-1)
                if thread == 0:
                    empty = boundary.grasp(
                        w, t, age, w, N, matter, conditions, paths, grips, particles
                    )
                    if empty >= 0:
                        clock.failed_particle[w] = empty
                event = next_event(w, t, paths)
                if block.any(int(empty >= 0)) == 1:
                    status = NOTHING_HELD
                    goes_on = False
                holding = list_gripped(w, thread, threads, particles, matter, grips, gripped)
            if goes_on:
                # poses of many substeps at once
                if grippers > 0 and (step < posed or step >= posed + AHEAD):
                    posed = step
                    count = wp.min(AHEAD, steps - step)
                    began = plan.time[frame]
                    pose_ahead(w, thread, threads, step, count, began, dt, paths, grips)
                    block.sync()
                status, longest = substep(
                    w, thread, threads, h, age, layout, slot, near_by, holding,
                    w * AHEAD + step - posed, mass, gravity, keep_velocity, matter, conditions,
                    clock, grips, gripped, particles, tape, grid, momentum, nodal,
                )  # fmt: skip
                if status == OK:
                    longest = block.largest(longest)
                    if longest > real(1.5) * dx * dx:
                        status = int(DIVERGED)
                    else:
                        travel += wp.sqrt(longest)
                    if keeps == 1:
                        slot += shared
                    step += 1
                    age += 1
                    left -= 1
                    block.sync()
            if step == steps and status == OK:
                for c in range(thread, plan.particles.shape[0], threads):
                    plan.x[frame, w, c] = moving.x_of(particles, w, plan.particles[c])
                frame += 1
                step = 0
                posed = -AHEAD
                if frame < frames:
                    for i in range(thread, N, threads):
                        loading.unload(particles, w, i, moving.particle(particles, w, i), last_good)
                    steps = plan.steps[frame, w]
                    dt = frame_substep(frame, w, plan)
                    h = real(dt)
                    keep_velocity = wp.exp(-conditions.velocity_damping[w] * h)
            t = plan.time[frame] + wp.float64(step) * dt
        block.sync()
        unload_all(w, thread, threads, state, particles)
        if thread == 0:
            unsorted[w] = far
            clock.frame[w] = frame
            clock.dt[w] = dt
            clock.steps[w] = steps
            clock.step[w] = step
            clock.age[w] = age
            clock.travel[w] = travel
            clock.near_table[w] = near_by
            clock.status[w] = status

    return advance


@functools.cache
def make_reverse(variant: Variant) -> Any:
    """Build the kernel that carries derivatives over a recording backwards."""
    real = variant.real
    types = make_types(real)
    Nodes = types.Nodes
    Clock, Matter, StateAdjoint = types.Clock, types.Matter, types.StateAdjoint
    Conditions, Paths, Grips = types.Conditions, types.Paths, types.Grips
    ConditionsAdjoint, Gripped = types.ConditionsAdjoint, make_gripped_type(real)
    Tape = make_taped(variant).Struct
    adjoint_of = make_adjoint(variant)
    Adjoint, fields = adjoint_of.Struct, adjoint_of.fields
    substep_adjoint, boundary = make_substep_adjoint(variant), make_boundary_adjoint(variant)
    poses, close_rates = make_poses(real), _make_close_rates(real)
    list_gripped, loading, block = (
        make_listing(variant).list_gripped,
        make_loading(variant),
        make_block(real),
    )
    rows, numbers = wp.constant(int(variant.rows)), wp.constant(variant.numbers)
    IN_SHARED_MEMORY = wp.constant(variant.room > 0)
    COMPONENTS = wp.constant(variant.components)

    if variant.rows:

        @wp.func
        def load_all(
            w: int, thread: int, threads: int, layout: int, matter: Matter, tape: Tape,
            by_state: StateAdjoint, adjoint: Adjoint,
        ):  # fmt: skip
            """Rows are the derivatives themselves."""

        @wp.func
        def unload_all(w: int, thread: int, threads: int, by_state: StateAdjoint, adjoint: Adjoint):
            """Rows are the derivatives themselves."""

        @wp.func
        def change_layout(
            w: int, thread: int, threads: int, layout: int, earlier: int, matter: Matter,
            tape: Tape, adjoint: Adjoint,
        ):  # fmt: skip
            """Rows stay in their order."""

    else:
        store = fields.store

        @wp.func
        def set_order(
            w: int, thread: int, threads: int, layout: int, matter: Matter, tape: Tape,
            adjoint: Adjoint,
        ):  # fmt: skip
            """Which particle each record is of, and where its neighbours are."""
            for i in range(thread, adjoint.near.shape[2], threads):
                p = tape.order[layout, i]
                adjoint.order[w, i] = p
                adjoint.place[w, p] = i
                put_near(adjoint.near, w, i, p, matter.lattice, tape.place, layout)

        @wp.func
        def load_all(
            w: int, thread: int, threads: int, layout: int, matter: Matter, tape: Tape,
            by_state: StateAdjoint, adjoint: Adjoint,
        ):  # fmt: skip
            """Make the records of a world in the order of a layout."""
            for i in range(thread, adjoint.near.shape[2], threads):
                loading.load(adjoint, w, i, tape.order[layout, i], by_state)
                for c in range(SUMS):
                    adjoint.sums[w, c, i] = real(0.0)
            set_order(w, thread, threads, layout, matter, tape, adjoint)

        @wp.func
        def unload_all(w: int, thread: int, threads: int, by_state: StateAdjoint, adjoint: Adjoint):
            """Write the records of a world back."""
            for i in range(thread, adjoint.near.shape[2], threads):
                p = adjoint.order[w, i]
                loading.unload(adjoint, w, i, p, by_state)
                for c in range(SUMS):
                    by_state.sums[w, c, p] = by_state.sums[w, c, p] + adjoint.sums[w, c, i]

        @wp.func
        def change_layout(
            w: int, thread: int, threads: int, layout: int, earlier: int, matter: Matter,
            tape: Tape, adjoint: Adjoint,
        ):  # fmt: skip
            """Put the records in the order of an earlier layout."""
            of, sums, spare = adjoint.of, adjoint.sums, adjoint.spare
            N = sums.shape[2]
            for i in range(thread, N, threads):
                j = tape.place[layout, tape.order[earlier, i]]
                for c in range(COMPONENTS):
                    spare[w, c, i] = store.get(of, w, c, j)
                for c in range(SUMS):
                    spare[w, COMPONENTS + c, i] = sums[w, c, j]
            block.sync()
            for i in range(thread, N, threads):
                for c in range(COMPONENTS):
                    store.put(of, w, c, i, spare[w, c, i])
                for c in range(SUMS):
                    sums[w, c, i] = spare[w, COMPONENTS + c, i]
            set_order(w, thread, threads, earlier, matter, tape, adjoint)

    @wp.kernel(
        module="unique", module_options=MODULE_OPTIONS, launch_bounds=bounds(variant.threads)
    )
    def reverse(
        order: wp.array(dtype=wp.int32),  # world of each block
        block_threads: int,
        shared: int,  # worlds that share grid and tape: all, or 1
        began: wp.array(dtype=wp.float64),  # [W] where the tape begins [s]
        slots: wp.array(dtype=wp.int32),  # [W] substeps to reverse
        clock: Clock,  # where the tape begins
        matter: Matter,
        conditions: Conditions,
        paths: Paths,
        grips: Grips,
        grid: SparseGrid,  # layouts of the tape
        momentum: Nodes,  # [S * shared, M] and mass
        tape: Tape,
        # scratch
        velocity: Nodes,  # [shared, M]
        nodes_bar: Nodes,  # [shared, M]
        touched: wp.array2d(dtype=types.vec3),  # [W, sections]
        adjoint: Adjoint,
        gripped: Gripped,
        # by the state: after the tape on entry, before it on return
        by_state: StateAdjoint,
        by: ConditionsAdjoint,
    ):
        turn, block_thread = wp.tid()
        thread = int(block_thread)
        threads = int(block_threads)
        if rows == 1:  # known to the compiler
            thread = 0
            threads = 1
        w = order[turn]
        own = w % shared
        gone = int(slots[w] - 1)
        if gone < 0:
            return
        if IN_SHARED_MEMORY:
            wp.tile_empty(shape=numbers, dtype=real, storage="shared")
        grippers = grips.closed.shape[1]
        t0 = began[w]
        dt = clock.dt[w]
        h = real(dt)
        keep_velocity = wp.exp(-conditions.velocity_damping[w] * h)
        mass = matter.mass[w]
        gravity = conditions.gravity[w]
        layout = int(tape.layout_of[gone * shared + own])
        load_all(w, thread, threads, layout, matter, tape, by_state, adjoint)
        holding = int(list_gripped(w, thread, threads, adjoint, matter, grips, gripped))
        posed = int(gone + 1)  # the substep from which on poses are known, and how many of them
        count = int(0)
        while gone >= 0 and by.status[w] == OK:
            slot = gone * shared + own
            if tape.layout_of[slot] != layout:
                earlier = tape.layout_of[slot]
                if rows == 0:
                    change_layout(w, thread, threads, layout, earlier, matter, tape, adjoint)
                    holding = list_gripped(w, thread, threads, adjoint, matter, grips, gripped)
                layout = earlier
            age = clock.age[w] + gone
            if grippers > 0 and gone < posed:
                # poses of many substeps at once
                poses.close_poses(w, thread, threads, posed, count, t0, dt, paths, grips, by)
                block.sync()
                posed = wp.max(0, gone - AHEAD + 1)
                count = gone + 1 - posed
                poses.pose_ahead(w, thread, threads, posed, count, t0, dt, paths, grips)
                block.sync()
            substep_adjoint(
                w, own, thread, threads, h, age, layout, slot, gone, holding,
                w * AHEAD + gone - posed, mass, gravity, keep_velocity, matter, conditions, grips,
                gripped, tape, touched, adjoint, grid, momentum, velocity, nodes_bar, by,
            )  # fmt: skip
            grasped = int(0)
            for g in range(grippers):
                if grips.until[w, g] == age or grips.since[w, g] == age:
                    grasped = 1
            if block.any(grasped) == 1:
                if thread == 0:
                    t = t0 + wp.float64(gone) * dt
                    boundary.grasp_adjoint(
                        w, t, age, slot, matter, conditions, paths, grips, tape, adjoint, by
                    )
                holding = list_gripped(w, thread, threads, adjoint, matter, grips, gripped)
            gone -= 1
        poses.close_poses(w, thread, threads, posed, count, t0, dt, paths, grips, by)
        if thread == 0:
            close_rates(w, dt, matter, conditions, by)
        unload_all(w, thread, threads, by_state, adjoint)

    return reverse


@functools.cache
def _make_close_rates(real: Any) -> Any:
    types = make_types(real)
    Matter, Conditions, ConditionsAdjoint = types.Matter, types.Conditions, types.ConditionsAdjoint
    branch_adjoint = make_maxwell_branch(real).branch_adjoint

    @wp.func
    def close_rates(
        w: int, dt: wp.float64, matter: Matter, conditions: Conditions, by: ConditionsAdjoint
    ):
        """Add the sums of equally long substeps to derivatives by damping rates; reset them."""
        h = real(dt)
        slope = wp.float64(-h * wp.exp(-conditions.velocity_damping[w] * h))
        by.velocity_damping[w] = by.velocity_damping[w] + slope * by.damping_factor[w]
        by_damping = branch_adjoint(
            matter.damping[w], h, 1, real(by.branch_factor[w]), real(by.branch_share[w])
        )
        by.damping[w] = by.damping[w] + wp.float64(by_damping)
        by.damping_factor[w] = wp.float64(0.0)
        by.branch_factor[w] = wp.float64(0.0)
        by.branch_share[w] = wp.float64(0.0)

    return close_rates


@functools.cache
def make_hold_as_at(real: Any) -> Any:
    """Build the kernel that lets worlds hold again what they held before their substep ``age``."""
    hold_world_as_at = make_grips(real).hold_as_at
    Grips = make_types(real).Grips

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def hold_as_at(order: wp.array(dtype=wp.int32), age: wp.array(dtype=wp.int32), grips: Grips):
        w = order[wp.tid()]
        hold_world_as_at(w, age[w], grips)

    return hold_as_at
