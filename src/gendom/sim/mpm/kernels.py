"""The kernels: a thread or a block of threads takes one world through many substeps, or back.

A world advances by itself through substeps and frames: it rebuilds its grid where a particle may
have left it, lets grippers close and open, and records positions where a frame ends.

Shapes: W worlds, N particles, G grippers, S recorded substeps, L layouts of the grid, M nodes.
"""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.block import bounds, make_block, put_near
from gendom.sim.mpm.boundary import make_boundary
from gendom.sim.mpm.grid import MARGIN, make_rebuild
from gendom.sim.mpm.gripped import AHEAD, make_gripped, make_poses
from gendom.sim.mpm.native import MODULE_OPTIONS
from gendom.sim.mpm.particles import ORDERLY, Variant, make_loading, make_moving, make_sorting
from gendom.sim.mpm.step import make_substep, make_substep_adjoint
from gendom.sim.mpm.transfer import make_bspline
from gendom.sim.mpm.types import DIVERGED, GRID_FULL, NOTHING_HELD, OK, make_types

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
    vec4, Substep, Grid = types.vec4, types.Substep, types.Grid
    Clock, FramePlan, Model, State = types.Clock, types.FramePlan, types.Model, types.State
    Paths, Grips = types.Paths, types.Grips
    Records, fields, loading = types.Records, make_moving(variant), make_loading(variant)
    row_at, rebuild = make_bspline(real, windowed=False).row_at, make_rebuild(variant)
    boundary, sort_records = make_boundary(variant), make_sorting(variant).sort
    pose_ahead, list_gripped = make_poses(real).pose_ahead, make_gripped(variant).list_gripped
    substep, begin = make_substep(variant, taped=taped), _make_begin(real)
    block = make_block(real)
    compensates = wp.constant(int(types.compensates))
    keeps, SORTS = wp.constant(int(taped)), wp.constant(variant.sorts)
    # known when a kernel is made: on the CPU, kernels with tiles must not run on several threads
    IN_SHARED_MEMORY, numbers = wp.constant(variant.room > 0), wp.constant(variant.numbers)
    number_bytes = wp.constant(4 if real == wp.float32 else 8)
    before_nodes = wp.constant(variant.components)

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

    @wp.func
    def velocities_at(grid: Grid, ptr: wp.uint64):
        """The grid with one row of velocities that stands elsewhere."""
        grid.velocity = wp.array(ptr=ptr, shape=(1, grid.momentum.shape[1]), dtype=vec4)
        return grid

    @wp.func
    def load_all(now: Substep, afresh: int, model: Model, state: State, particles: Records):
        """Make the records of a world, in the order of particles if ``afresh``."""
        for i in range(now.thread, state.x.shape[1], now.threads):
            p = int(i)
            if afresh == 1:
                particles.order[now.w, i] = i
                particles.place[now.w, i] = i
            else:
                p = particles.order[now.w, i]
            loading.load(particles, now.w, i, p, state)
            if compensates == 1:
                fields.put_low(particles, now.w, i, state.low[now.w, p])
            particles.moduli[now.w, 0, i] = model.mu[now.w, p]
            particles.moduli[now.w, 1, i] = model.lam[now.w, p]

    @wp.func
    def unload_all(now: Substep, state: State, particles: Records):
        """Write the records of a world to the state."""
        for i in range(now.thread, state.x.shape[1], now.threads):
            p = particles.order[now.w, i]
            loading.unload(particles, now.w, i, p, state)
            if compensates == 1:
                state.low[now.w, p] = fields.low(particles, now.w, i)

    @wp.func
    def sort(now: Substep, far: real, model: Model, grid: Grid, particles: Records, tape: Records):
        """Sort the records if a particle may have come ``far``, and keep their order on the
        tape. Returns whether the order changed."""
        sorts = int(0)
        if SORTS and far >= real(ORDERLY) * now.dx:
            sorts = 1
            sort_records(now, model, grid, particles)
        if keeps == 1:
            for i in range(now.thread, particles.order.shape[1], now.threads):
                tape.order[now.layout, i] = particles.order[now.w, i]
                tape.place[now.layout, i] = particles.place[now.w, i]
        return sorts

    @wp.kernel(
        module="unique", module_options=MODULE_OPTIONS, launch_bounds=bounds(variant.threads)
    )
    def advance(
        order: wp.array(dtype=wp.int32),  # world of each block
        threads: int,  # of a block
        shared: int,  # worlds that share grid and tape: all, or 1
        most: int,  # substeps at the most
        frames: int,  # of the plan to go through
        plan: FramePlan,
        clock: Clock,
        unsorted: wp.array(dtype=real),  # [W] distance travelled since records were sorted [m]
        model: Model,
        paths: Paths,
        grips: Grips,
        state: State,
        # a layout a world; L for the tape, which keeps momentum. Else it is empty between substeps
        world_grid: Grid,
        particles: Records,
        tape: Records,
    ):
        turn, thread = wp.tid()
        if IN_SHARED_MEMORY:
            wp.tile_empty(shape=numbers, dtype=real, storage="shared")
        w = order[turn]
        own = w % shared
        grippers = grips.closed.shape[1]
        frame = int(clock.frame[w])
        status = int(clock.status[w])
        if frame >= frames or status != OK:
            return
        dt = plan.dt[frame, w]
        step = int(clock.step[w])
        t = plan.time[frame] + wp.float64(step) * dt
        now = begin(w, thread, threads, state.x.shape[1], dt, model)
        now.age = clock.age[w]
        now.holding = grips.held[w]
        # of grid and layout; in place unless all are kept
        now.slot = own
        now.layout = own
        made = int(own)
        steps = int(plan.steps[frame, w])
        travel = clock.travel[w]
        event = wp.float64(-1.0e30)
        posed = int(-AHEAD)  # the substep from which on poses are known
        left = int(most)
        far = unsorted[w]
        afresh = int(0)
        if travel >= real(MARGIN) * now.dx:  # whatever the order was, it will be made anew
            afresh = 1
            far = real(ORDERLY) * now.dx
        # the nodes' velocities stand behind the particles where they fit
        velocity_at = row_at(world_grid.velocity, own)
        offset = (before_nodes * now.N + 3) // 4 * 4
        if IN_SHARED_MEMORY and offset + 4 * world_grid.momentum.shape[1] <= numbers:
            velocity_at = block.resident_at(number_bytes * offset)
        grid = velocities_at(world_grid, velocity_at)
        load_all(now, afresh, model, state, particles)
        block.sync()
        while frame < frames and left > 0 and status == OK:
            if step < steps and travel >= real(MARGIN) * now.dx:
                if keeps == 1:  # a tape has a layout for each substep
                    now.layout = made
                    made += shared
                fits = rebuild(now, particles, grid)
                status = GRID_FULL
                if fits:
                    status = OK
                    far += travel
                    travel = real(0.0)
                    if sort(now, far, model, grid, particles, tape) == 1:
                        far = real(0.0)
                        now.holding = list_gripped(now, particles, model, grips)
                elif thread == 0:
                    # the grid's need is read from the world's first layout
                    for a in range(4):
                        grid.bounds[own, a] = grid.bounds[now.layout, a]
            goes_on = step < steps and status == OK
            if goes_on and t >= event:
                empty = int(-1)
                if thread == 0:
                    empty = boundary.grasp(now, t, model, paths, grips, particles)
                    if empty >= 0:
                        clock.failed_particle[w] = empty
                event = next_event(w, t, paths)
                if block.any(int(empty >= 0)) == 1:
                    status = NOTHING_HELD
                    goes_on = False
                now.holding = list_gripped(now, particles, model, grips)
            if goes_on:
                # poses of many substeps at once
                if grippers > 0 and (step < posed or step >= posed + AHEAD):
                    posed = step
                    count = wp.min(AHEAD, steps - step)
                    began = plan.time[frame]
                    pose_ahead(now, step, count, began, dt, paths, grips)
                    block.sync()
                now.grip_row = w * AHEAD + step - posed
                status, longest = substep(now, model, clock, grips, particles, tape, grid)
                if status == OK:
                    longest = block.largest(longest)
                    if longest > real(1.5) * now.dx * now.dx:
                        status = int(DIVERGED)
                    else:
                        travel += wp.sqrt(longest)
                    if keeps == 1:
                        now.slot += shared
                    step += 1
                    now.age += 1
                    left -= 1
                    block.sync()
            if step == steps and status == OK:
                for c in range(thread, plan.particles.shape[0], threads):
                    plan.x[frame, w, c] = fields.x_of(particles, w, plan.particles[c])
                frame += 1
                step = 0
                posed = -AHEAD
                if frame < frames:
                    steps = plan.steps[frame, w]
                    dt = plan.dt[frame, w]
                    # not by a function: a struct that is assigned whole does not stay in registers
                    now.h = real(dt)
                    now.keep_velocity = wp.exp(-model.velocity_damping[w] * now.h)
            t = plan.time[frame] + wp.float64(step) * dt
        block.sync()
        unload_all(now, state, particles)
        if thread == 0:
            unsorted[w] = far
            clock.frame[w] = frame
            clock.dt[w] = dt
            clock.step[w] = step
            clock.age[w] = now.age
            clock.travel[w] = travel
            clock.status[w] = status

    return advance


@functools.cache
def make_reverse(variant: Variant) -> Any:
    """Build the kernel that carries derivatives over a recording backwards."""
    real = variant.real
    types = make_types(real)
    Clock, Model, Grid, Substep = types.Clock, types.Model, types.Grid, types.Substep
    Paths, Grips, State = types.Paths, types.Grips, types.State
    ConditionsAdjoint = types.ConditionsAdjoint
    Records, reorder = types.Records, make_sorting(variant).reorder
    substep_adjoint, boundary = make_substep_adjoint(variant), make_boundary(variant)
    poses, begin = make_poses(real), _make_begin(real)
    list_gripped, loading = make_gripped(variant).list_gripped, make_loading(variant)
    block = make_block(real)
    IN_SHARED_MEMORY, numbers = wp.constant(variant.room > 0), wp.constant(variant.numbers)
    SORTS = wp.constant(variant.sorts)

    @wp.func
    def set_order(now: Substep, model: Model, tape: Records, adjoint: Records):
        """Which particle each record is of, and where its neighbours are."""
        for i in range(now.thread, adjoint.near.shape[2], now.threads):
            p = tape.order[now.layout, i]
            adjoint.order[now.w, i] = p
            adjoint.place[now.w, p] = i
            put_near(adjoint.near, now.w, i, p, model.lattice, tape.place, now.layout)

    @wp.func
    def load_all(now: Substep, model: Model, tape: Records, by_state: State, adjoint: Records):
        """Make the records of a world in the order of a layout."""
        for i in range(now.thread, adjoint.near.shape[2], now.threads):
            loading.load(adjoint, now.w, i, tape.order[now.layout, i], by_state)
            for c in range(SUMS):
                adjoint.sums[now.w, c, i] = real(0.0)
        set_order(now, model, tape, adjoint)

    @wp.func
    def unload_all(now: Substep, by_state: State, adjoint: Records):
        """Write the records of a world back."""
        for i in range(now.thread, adjoint.near.shape[2], now.threads):
            p = adjoint.order[now.w, i]
            loading.unload(adjoint, now.w, i, p, by_state)
            for c in range(SUMS):
                so_far = by_state.sums[now.w, c, p]
                by_state.sums[now.w, c, p] = so_far + adjoint.sums[now.w, c, i]

    @wp.func
    def change_layout(now: Substep, earlier: int, model: Model, tape: Records, adjoint: Records):
        """Put the records in the order of an earlier layout."""
        for i in range(now.thread, adjoint.of.shape[2], now.threads):
            adjoint.spare_order[now.w, i] = tape.place[now.layout, tape.order[earlier, i]]
        block.sync()
        reorder(now, adjoint, adjoint.sums)
        now.layout = earlier
        set_order(now, model, tape, adjoint)

    @wp.kernel(
        module="unique", module_options=MODULE_OPTIONS, launch_bounds=bounds(variant.threads)
    )
    def reverse(
        order: wp.array(dtype=wp.int32),  # world of each block
        threads: int,  # of a block
        shared: int,  # worlds that share grid and tape: all, or 1
        began: wp.array(dtype=wp.float64),  # [W] where the tape begins [s]
        slots: wp.array(dtype=wp.int32),  # [W] substeps to reverse
        clock: Clock,  # where the tape begins
        model: Model,
        paths: Paths,
        grips: Grips,
        grid: Grid,  # of the tape
        tape: Records,
        adjoint: Records,
        # by the state: after the tape on entry, before it on return
        by_state: State,
        by: ConditionsAdjoint,
    ):
        turn, thread = wp.tid()
        w = order[turn]
        own = w % shared
        if slots[w] < 1:
            return
        if IN_SHARED_MEMORY:
            wp.tile_empty(shape=numbers, dtype=real, storage="shared")
        grippers = grips.closed.shape[1]
        t0 = began[w]
        dt = clock.dt[w]
        now = begin(w, thread, threads, grips.free.shape[1], dt, model)
        now.gone = slots[w] - 1
        now.row = own
        now.layout = tape.layout_of[now.gone * shared + own]
        load_all(now, model, tape, by_state, adjoint)
        now.holding = list_gripped(now, adjoint, model, grips)
        posed = int(now.gone + 1)  # the substep from which on poses are known
        while now.gone >= 0:
            now.slot = now.gone * shared + own
            now.age = clock.age[w] + now.gone
            earlier = tape.layout_of[now.slot]
            if earlier != now.layout:
                if SORTS:
                    change_layout(now, earlier, model, tape, adjoint)
                    now.holding = list_gripped(now, adjoint, model, grips)
                now.layout = earlier
            if grippers > 0 and now.gone < posed:
                # poses of many substeps at once
                posed = wp.max(0, now.gone - AHEAD + 1)
                poses.pose_ahead(now, posed, now.gone + 1 - posed, t0, dt, paths, grips)
                block.sync()
            now.grip_row = w * AHEAD + now.gone - posed
            substep_adjoint(now, model, grips, tape, adjoint, grid, by)
            t = t0 + wp.float64(now.gone) * dt
            poses.pose_adjoint(now, t, dt, paths, grips, by)
            grasped = int(0)
            for g in range(grippers):
                if grips.until[w, g] == now.age or grips.since[w, g] == now.age:
                    grasped = 1
            if block.any(grasped) == 1:
                if thread == 0:
                    boundary.grasp_adjoint(now, t, model, paths, grips, tape, adjoint, by)
                now.holding = list_gripped(now, adjoint, model, grips)
            now.gone -= 1
        unload_all(now, by_state, adjoint)

    return reverse


@functools.cache
def _make_begin(real: Any) -> Any:
    """Build ``begin``, what substeps of one length have in common."""
    types = make_types(real)
    Substep, Model = types.Substep, types.Model

    @wp.func
    def begin(w: int, thread: int, threads: int, N: int, dt: wp.float64, model: Model):
        now = Substep()
        now.w = w
        now.thread = thread
        now.threads = threads
        now.N = N
        now.mass = model.mass[w]
        now.gravity = model.gravity[w]
        now.dx = model.dx
        now.inv_dx = real(1.0) / model.dx
        now.h = real(dt)
        now.keep_velocity = wp.exp(-model.velocity_damping[w] * now.h)
        return now

    return begin
