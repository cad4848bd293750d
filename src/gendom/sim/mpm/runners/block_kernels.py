"""Substeps on CUDA for small bodies: a block of threads runs many substeps of one world.

The functions are those of ``step``, called by the lanes of a block, which synchronise between
stages. Only the storage of particles differs: each world has them as records, component by
component, in the order of their lowest nodes. Lanes then access neighbouring numbers, and the
contributions of neighbouring particles to the same nodes are summed before they are added to the
grid.

Shapes: W worlds, N particles, L layouts of the grid, M nodes.
"""

import functools

import warp as wp

from gendom.sim.mpm.block import bounds, get_near, make_block, make_store, spans_of
from gendom.sim.mpm.boundary import FOLLOWS, make_boundary
from gendom.sim.mpm.compensated_sum import make_compensated_sum
from gendom.sim.mpm.elasticity import make_elasticity, make_maxwell_branch
from gendom.sim.mpm.grid import MARGIN, SparseGrid, make_rebuild_world
from gendom.sim.mpm.native import MODULE_OPTIONS
from gendom.sim.mpm.poses import AHEAD, make_poses
from gendom.sim.mpm.runners.held import make_held
from gendom.sim.mpm.runners.records import (
    LOW,
    ORDERLY,
    PULLS,
    C,
    V,
    Variant,
    X,
    make_record_access,
    make_records,
    make_tape,
)
from gendom.sim.mpm.step import DIVERGED, GRID_FULL, INVERTED, NOTHING_HELD, OK
from gendom.sim.mpm.transfer import make_bspline, make_transfer
from gendom.sim.mpm.types import Namespace, make_types


@functools.cache
def make_block_kernels(variant: Variant, *, taped: bool = False) -> Namespace:
    """Build the kernel of a variant; ``taped``: every substep is kept for the reverse.

    Returns:
        Namespace with ``Records``, ``Tape`` and ``advance``.
    """
    real = variant.real
    types = make_types(real)
    Nodes = types.Nodes
    vec3, vec4, mat33 = types.vec3, types.vec4, types.mat33
    Clock, Plan, Matter, State = types.Clock, types.Plan, types.Matter, types.State
    Scene, Paths, Grips = types.Scene, types.Paths, types.Grips
    elasticity = make_elasticity(real, variant.law, yields=variant.yields, damped=variant.damped)
    branch = make_maxwell_branch(real).branch
    bspline, transfer = make_bspline(real), make_transfer(real)
    window_type, hand_over = bspline.window, bspline.hand_over
    records_of = make_records(real, resident=variant.room > 0)
    Records, Tape = records_of.Struct, make_tape(real)
    access = make_record_access(variant)
    rebuild = make_rebuild_world(real, records_of)
    boundary, pose_ahead = make_boundary(real, records_of), make_poses(real).pose_ahead
    of_held = make_held(real)
    Held = of_held.Held
    store = make_store(real, resident=variant.room > 0)
    kept = make_store(real, resident=False)
    compensates = wp.constant(int(types.compensates))
    compensated_sum = make_compensated_sum(real)
    block = make_block(real)
    number = wp.constant(4 if real == wp.float32 else 8)
    before_nodes = wp.constant(variant.components)
    Z, G = map(wp.constant, (variant.Z, variant.G))
    TAPED_Z, TAPED_G = wp.constant(18), wp.constant(18 + 6 * variant.damped)
    damped, plastic = wp.constant(int(variant.damped)), wp.constant(int(variant.yields))
    keeps = wp.constant(int(taped))
    stays, numbers = wp.constant(int(variant.room > 0)), wp.constant(variant.numbers)

    @wp.func
    def frame_substep(frame: int, w: int, plan: Plan):
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

    @wp.func
    def momentum_of(w: int, i: int, h: real, mass: real, gravity: vec3, records: Records):
        """Momentum of a particle with the impulses of the substep, but for the table's."""
        q = mass * (store.vector(records.of, w, V, i) + h * gravity)
        return q + store.pulled(records.of, w, PULLS, get_near(records.near, w, i), i)

    @wp.func
    def touch(
        w: int, s: int, h: real, mass: real, matter: Matter, scene: Scene, records: Records,
    ):  # fmt: skip
        """As that of ``step``, but what table and walls change is added to the velocities."""
        size = matter.section
        x = vec3()
        q = vec3()
        first = store.vector(records.of, w, X, records.place[w, s * size])
        if boundary.near_table(first, matter, scene):
            for p in range(s * size, (s + 1) * size):
                i = records.place[w, p]
                x += store.vector(records.of, w, X, i)
                q += momentum_of(w, i, h, mass, scene.gravity[w], records)
            share = real(1.0) / real(size)
            change = boundary.contact(
                w, share * x, (share / mass) * q, h, matter.contact_radius, scene
            )
            if wp.length_sq(change) > real(0.0):
                for p in range(s * size, (s + 1) * size):
                    i = records.place[w, p]
                    v = store.vector(records.of, w, V, i)
                    store.put_vector(records.of, w, V, i, v + change)

    @wp.func
    def carry(
        w: int, lane: int, lanes: int, holding: int, grip_row: int, h: real, dx: real, grips: Grips,
        records: Records, held: Held,
    ):  # fmt: skip
        """Move what grippers hold firmly; return the square of a lane's longest way."""
        far = real(0.0)
        for n in range(lane, holding, lanes):
            if held.share[w, n] == real(0.0):
                i = held.record[w, n]
                x = store.vector(records.of, w, X, i)
                v, spin, _by_b = boundary.follow(
                    held.gripper[w, n], held.place[w, n], grip_row, x, real(FOLLOWS), h, grips
                )
                far = wp.max(far, move(w, i, x, v, wp.skew(spin), h, dx, records))
        return far

    @wp.func
    def move(w: int, i: int, x: vec3, v: vec3, affine: mat33, h: real, dx: real, records: Records):
        """Advance record i from x; return the square of its way [m^2], too long a one for a NaN."""
        if compensates == 1:
            there, low = compensated_sum(x, h * v, store.vector(records.of, w, LOW, i))
            store.put_vector(records.of, w, X, i, there)
            store.put_vector(records.of, w, LOW, i, low)
        else:
            store.put_vector(records.of, w, X, i, x + h * v)
        store.put_vector(records.of, w, V, i, v)
        store.put_matrix(records.of, w, C, i, affine)
        far = wp.length_sq(v) * h * h
        if not (far <= dx * dx):
            far = real(4.0) * dx * dx
        return far

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS, launch_bounds=bounds(variant.lanes))
    def advance(
        order: wp.array(dtype=wp.int32),  # world of each block
        lanes: int,
        most: int,  # substeps at the most
        pause: wp.float64,  # [s] no substep begins from here on
        plan: Plan,
        clock: Clock,
        matter: Matter,
        scene: Scene,
        paths: Paths,
        grips: Grips,  # [W]
        state: State,  # [W, N]
        last_good: State,  # [W, N] where the last frame began
        grid: SparseGrid,  # a layout a world; L for the tape
        # empty before and after each substep; kept with the tape
        momentum: Nodes,  # [W, M] and mass; [S * W, M] for the tape
        velocity: Nodes,  # [W, M] and mass
        records: Records,
        held: Held,
        tape: Tape,
    ):
        turn, lane = wp.tid()
        if stays == 1:
            wp.tile_empty(shape=numbers, dtype=real, storage="shared")
        w = order[turn]
        of = records.of
        moduli = records.moduli
        W = state.x.shape[0]
        N = state.x.shape[1]
        sections = N // matter.section
        # of the records that this lane gives to the grid
        begin = lane * N // lanes
        end = (lane + 1) * N // lanes
        grippers = grips.closed.shape[1]
        frames = plan.steps.shape[0]
        frame = int(clock.frame[w])
        status = int(clock.status[w])
        if frame >= frames or status != OK:
            return
        dt = frame_substep(frame, w, plan)
        step = int(clock.step[w])
        t = plan.time[frame] + wp.float64(step) * dt
        if t >= pause:
            return
        dx = scene.dx
        inv_dx = real(1.0) / dx
        mass = matter.mass[w]
        per_mass = real(1.0) / mass
        drag = matter.drag[w]
        gravity = scene.gravity[w]
        steps = int(plan.steps[frame, w])
        h = real(dt)
        factor = wp.exp(-scene.velocity_damping[w] * h)
        # of grid and layout; in place unless all are kept
        slot = int(w)
        layout = int(w)
        age = clock.age[w]
        holding = int(held.count[w])
        travel = clock.travel[w]
        near_by = int(clock.near_table[w])
        event = wp.float64(-1.0e30)
        posed = int(-AHEAD)  # the substep from which on poses are known
        left = int(most)
        made = int(w)
        strayed = records.strayed[w]
        lost = travel >= real(MARGIN) * dx  # whatever the order was, it will be made anew
        if lost:
            strayed = real(ORDERLY) * dx
        # the nodes' velocities stand behind the particles where they fit
        velocity_at = bspline.row_at(velocity, w)
        room = momentum.shape[1]
        offset = (before_nodes * N + 3) // 4 * 4
        if stays == 1 and offset + 4 * room <= numbers:
            velocity_at = block.resident_at(number * offset)
        nodal = wp.array(ptr=velocity_at, shape=(1, room), dtype=vec4)
        for i in range(lane, N, lanes):
            p = int(i)
            if lost:
                records.order[w, i] = i
                records.place[w, i] = i
            else:
                p = records.order[w, i]
            access.load(of, w, i, p, state)
            if compensates == 1:
                store.put_vector(of, w, LOW, i, state.low[w, p])
            moduli[w, 0, i] = matter.mu[w, p]
            moduli[w, 1, i] = matter.lam[w, p]
        block.meet()
        if step == 0:
            for i in range(lane, N, lanes):
                access.unload(of, w, i, records.order[w, i], last_good)
        while frame < frames and left > 0 and status == OK and t < pause:
            if step < steps and travel >= real(MARGIN) * dx:
                if keeps == 1:
                    if made >= grid.count.shape[0]:
                        left = 0  # the tape is full
                    else:
                        layout = made
                        made += W
                if left > 0:
                    fits = rebuild(
                        w, lane, lanes, N, layout, momentum.shape[1], inv_dx, records, grid
                    )
                    status = GRID_FULL
                    if fits:
                        status = OK
                        strayed += travel
                        travel = real(0.0)
                        mine = int(0)
                        for i in range(lane, N, lanes):
                            if boundary.near_table(store.vector(of, w, X, i), matter, scene):
                                mine = 1
                        near_by = block.any(mine)
                        if strayed >= real(ORDERLY) * dx:
                            strayed = real(0.0)
                            access.put_in_order(
                                w, lane, lanes, layout, inv_dx, matter, grid, records
                            )
                            holding = of_held.list_held(
                                w, lane, lanes, records.order, w, matter, grips, held
                            )
                        if keeps == 1:
                            for i in range(lane, N, lanes):
                                tape.order[layout, i] = records.order[w, i]
                                tape.place[layout, i] = records.place[w, i]
                    elif lane == 0:
                        # the grid's need is read from the world's first layout
                        for a in range(4):
                            grid.bounds[w, a] = grid.bounds[layout, a]
            substep = step < steps and status == OK and left > 0
            if substep and t >= event:
                empty = int(-1)
                if lane == 0:
                    empty = boundary.grasp(w, t, age, w, N, matter, scene, paths, grips, records)
                    if empty >= 0:
                        clock.failed_particle[w] = empty
                event = next_event(w, t, paths)
                if block.any(int(empty >= 0)) == 1:
                    status = NOTHING_HELD
                    substep = False
                holding = of_held.list_held(w, lane, lanes, records.order, w, matter, grips, held)
            if substep:
                # poses of many substeps at once
                if grippers > 0 and (step < posed or step >= posed + AHEAD):
                    posed = step
                    began = plan.time[frame]
                    pose_ahead(w, lane, lanes, step, AHEAD, began, dt, paths, grips)
                    block.meet()
                grip_row = w * AHEAD + step - posed
                for n in range(lane, holding, lanes):
                    if held.share[w, n] > real(0.0):
                        x = store.vector(of, w, X, held.record[w, n])
                        of_held.lead(w, n, x, grip_row, h, matter, scene, grips, held)
                if keeps == 1:
                    tape.layout_of[slot] = layout
                    for n in range(lane, grid.count[layout], lanes):
                        momentum[slot, n] = vec4()
                keep, share = branch(matter.damping[w], h, age)
                inverted = int(0)
                for i in range(lane, N, lanes):
                    p = records.order[w, i]
                    near = get_near(records.near, w, i)
                    D = store.differences(of, w, X, near)
                    filtered = mat33()
                    inverse_plastic = mat33()
                    if damped == 1:
                        filtered = store.symmetric(of, w, Z, i)
                    if plastic == 1:
                        inverse_plastic = store.matrix(of, w, G, i)
                    pull, filtered_after, inverse_after, upright = elasticity.pull(
                        D, matter.rest_frame[p], moduli[w, 0, i], moduli[w, 1, i],
                        matter.yield_stress[w], keep, share, filtered, inverse_plastic,
                        h * matter.volume,
                    )  # fmt: skip
                    v = store.vector(of, w, V, i)
                    if keeps == 1:
                        kept.put_vector(tape.of, slot, 0, i, store.vector(of, w, X, i))
                        kept.put_vector(tape.of, slot, 3, i, v)
                        kept.put_matrix(tape.of, slot, 6, i, store.matrix(of, w, C, i))
                        if damped == 1:
                            kept.put_symmetric(tape.of, slot, TAPED_Z, i, filtered)
                        if plastic == 1:
                            kept.put_matrix(tape.of, slot, TAPED_G, i, inverse_plastic)
                    if drag > real(0.0):
                        wind = elasticity.air(D, v, spans_of(near, i), matter.sheet, drag, h)
                        store.put_vector(of, w, V, i, v + per_mass * wind)
                    store.put_matrix(of, w, PULLS, i, pull)
                    if damped == 1:
                        store.put_symmetric(of, w, Z, i, filtered_after)
                    if plastic == 1:
                        store.put_matrix(of, w, G, i, inverse_after)
                    if not upright:
                        inverted = 1
                        clock.failed_particle[w] = p
                if block.any(inverted) == 1:
                    status = INVERTED
                    substep = False
            if substep:
                if keeps == 1:
                    for i in range(lane, N, lanes):
                        q = momentum_of(w, i, h, mass, gravity, records)
                        kept.put_vector(tape.of, slot, 15, i, q)
                    block.meet()
                if near_by == 1:
                    for s in range(lane, sections, lanes):
                        touch(w, s, h, mass, matter, scene, records)
                    block.meet()
                nodes = grid.count[layout]
                window = window_type()
                window_at = wp.vec3i(-1, -1, -1)
                for i in range(begin, end):
                    free = held.free[w, i]
                    if free == real(0.0):
                        continue
                    q = momentum_of(w, i, h, mass, gravity, records)
                    if free < real(1.0):
                        q += (real(1.0) - free) * (mass * held.led[w, i] - q)
                    x, affine = store.vector(of, w, X, i), store.matrix(of, w, C, i)
                    node, f, given = transfer.given_by(x, q, affine, mass, layout, inv_dx, grid)
                    window = hand_over(window, window_at, node, momentum, slot, grid.start, layout)
                    window = bspline.collect(window, f, given)
                    window_at = node
                hand_over(
                    window, window_at, wp.vec3i(-1, -1, -1), momentum, slot, grid.start, layout
                )
                block.meet()
                # the square of the longest way [m^2]
                longest = carry(w, lane, lanes, holding, grip_row, h, dx, grips, records, held)
                following = vec4()
                if lane < nodes:
                    following = bspline.get_node(momentum, slot, lane)
                for n in range(lane, nodes, lanes):
                    m = following
                    # on its way while this one is updated
                    if n + lanes < nodes:
                        following = bspline.get_node(momentum, slot, n + lanes)
                    if m[3] > real(0.0):
                        if keeps == 0:
                            bspline.put_node(momentum, slot, n, vec4())
                        bspline.put_node(nodal, 0, n, transfer.node_velocity(m, factor))
                block.meet()
                for i in range(lane, N, lanes):
                    if held.free[w, i] == real(0.0):
                        continue
                    x = store.vector(of, w, X, i)
                    v, affine = transfer.g2p(layout, 0, x, inv_dx, grid, nodal)
                    longest = wp.max(longest, move(w, i, x, v, affine, h, dx, records))
                longest = block.largest(longest)
                if longest > real(1.5) * dx * dx:
                    status = int(DIVERGED)
                else:
                    travel += wp.sqrt(longest)
                if keeps == 1:
                    slot += W
                step += 1
                age += 1
                left -= 1
                block.meet()
            if step == steps and status == OK:
                for c in range(lane, plan.particles.shape[0], lanes):
                    i = records.place[w, plan.particles[c]]
                    plan.x[frame, w, c] = store.vector(of, w, X, i)
                frame += 1
                if frame < frames:
                    for i in range(lane, N, lanes):
                        access.unload(of, w, i, records.order[w, i], last_good)
                    steps = plan.steps[frame, w]
                    dt = frame_substep(frame, w, plan)
                    h = real(dt)
                    factor = wp.exp(-scene.velocity_damping[w] * h)
                    step = 0
                    posed = -AHEAD
            t = plan.time[frame] + wp.float64(step) * dt
        block.meet()
        for i in range(lane, N, lanes):
            p = records.order[w, i]
            access.unload(of, w, i, p, state)
            if compensates == 1:
                state.low[w, p] = store.vector(of, w, LOW, i)
        if lane == 0:
            records.strayed[w] = strayed
            clock.frame[w] = frame
            clock.dt[w] = dt
            clock.steps[w] = steps
            clock.step[w] = step
            clock.age[w] = age
            clock.travel[w] = travel
            clock.near_table[w] = near_by
            clock.status[w] = status

    return Namespace(advance, Records=Records, Tape=Tape)
