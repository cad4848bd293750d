"""The substep on CUDA where bodies are small: a block of threads takes one world through many.

The same functions as in ``kernels``, called by the lanes of a block, which meet between stages.
What is different is where particles are: each world has them as records, component by component, in
the order of their lowest nodes. Lanes then read and write neighbouring numbers, and what
neighbouring particles give to the same nodes is summed before it goes to the grid.

Shapes: W worlds, N particles, L layouts of X x Y grid columns, M nodes.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.block import Near, bounds, get_near, make_block, make_store, put_near
from gendom.sim.columns import MARGIN, Columns
from gendom.sim.kernels import DIVERGED, GRID_FULL, INVERTED, OK, make_kernels

COMPONENTS = 24
"""Of a record: x, v, C, and F or, of an elastic body, the particle's pulls on its neighbours. In
float32 low follows, see ``record_components``."""

SPARE = 29
"""Numbers that are put in order with a particle, at the most: a record, mu and lam."""

ORDERLY = 1.0
"""How far a particle may travel, in cells, before the records are put in order anew."""

_V, _C, _F, _LOW, _MU, _LAM = 3, 6, 15, 24, 0, 1


def record_components(real: Any) -> int:
    """Components of a record in a scalar type."""
    return COMPONENTS + (3 if real == wp.float32 else 0)


def carried_components(*, plastic: bool) -> int:
    """Components of a record that are the particle's state."""
    return 24 if plastic else 15


def taped_components(*, plastic: bool) -> int:
    """Components of a record on a tape: its state, and the sum of pulls on it."""
    return 24 if plastic else 18


@functools.cache
def make_block_kernels(
    real: Any,
    law_name: str,
    *,
    plastic: bool,
    taped: bool = False,
    room: int = 0,
    lanes: int = 128,
) -> SimpleNamespace:
    """Build the kernel for one scalar type and one material, see ``make_kernels``.

    Args:
        real, law_name, plastic: As there.
        taped: Whether every substep is kept for the reverse.
        room: Shared memory in which a block's particles stay [bytes]; 0: in arrays.
        lanes: Threads of a block on CUDA.

    Returns:
        Namespace with ``Records``, ``Tape`` and ``advance``.
    """
    k = make_kernels(real, law_name, plastic=plastic)
    vec3, vec4, mat33 = k.vec3, k.vec4, k.mat33
    Clock, Plan, frame_substep = k.Clock, k.Plan, k.frame_substep
    forget_bounds = k.columns.forget_bounds
    reach = k.columns.reach
    widen_bounds = k.columns.widen_bounds
    mark_box = k.columns.mark_box
    empty_column = k.columns.empty_column
    lay_column = k.columns.lay_column
    Scene, Paths, Grips = k.boundary.Scene, k.boundary.Paths, k.boundary.Grips
    place_gripper = k.boundary.place_gripper
    update_node = k.boundary.update_node
    Matter, State = k.transfers.Matter, k.transfers.State
    window_type = k.transfers.window
    collect = k.transfers.collect
    hand_over = k.transfers.hand_over
    place_on_grid = k.transfers.place_on_grid
    given_by = k.transfers.given_by
    impulse_of_stress = k.transfers.impulse_of_stress
    tension = k.transfers.tension
    moved = k.transfers.moved
    rounds = k.transfers.rounds
    gather_particle = k.transfers.gather_particle
    get_node, put_node = k.transfers.get_node, k.transfers.put_node
    yields = k.transfers.yields
    CARRIED = wp.constant(carried_components(plastic=plastic))
    keeps = wp.constant(1 if taped else 0)
    stays = wp.constant(1 if room else 0)
    numbers = wp.constant(max(1, room // (4 if real == wp.float32 else 8)))
    store = make_store(real, resident=room > 0)
    get, put = store.get, store.put
    vector, put_vector = store.vector, store.put_vector
    matrix, put_matrix = store.matrix, store.put_matrix
    differences, pulled, step_on = store.differences, store.pulled, store.step_on
    put_taped = make_store(real, resident=False).put_vector
    block = make_block(real)
    meet, any_of, largest, before = block.meet, block.any, block.largest, block.before

    @wp.struct
    class Records:
        """Particles of W worlds in order."""

        of: wp.array3d(dtype=real)  # [W, record_components, N], or [1, ...] if they are resident
        moduli: wp.array3d(dtype=real)  # [W, 2, N] mu, lam
        order: wp.array2d(dtype=wp.int32)  # [W, N] particle of each record
        place: wp.array2d(dtype=wp.int32)  # [W, N] record of each particle
        near: wp.array3d(dtype=wp.int32)  # [W, 3, N] records of its neighbours, if elastic
        strayed: wp.array(dtype=real)  # [W] distance travelled since they were put in order [m]
        # scratch
        spare: wp.array3d(dtype=real)  # [W, SPARE, N]
        spare_order: wp.array2d(dtype=wp.int32)  # [W, N]
        tally: wp.array2d(dtype=wp.int32)  # [W, M]

    @wp.struct
    class Tape:
        """S substeps of W worlds: substep n of world w has row n * W + w.

        Layout n of world w is number n * W + w; there may be fewer of them than substeps.
        """

        of: wp.array3d(dtype=real)  # [S * W, taped_components, N] records before the substep
        order: wp.array2d(dtype=wp.int32)  # [L, N] of each layout
        place: wp.array2d(dtype=wp.int32)  # [L, N]
        layout_of: wp.array(dtype=wp.int32)  # [S * W] row of each substep's layout

    @wp.func
    def put_in_order(
        w: int,
        lane: int,
        lanes: int,
        layout: int,
        inv_dx: real,
        z0: real,
        matter: Matter,
        columns: Columns,
        records: Records,
    ):
        """Order a world's records by their lowest nodes."""
        of = records.of
        N = of.shape[2]
        nodes = columns.count[layout]
        begin = lane * nodes // lanes
        end = (lane + 1) * nodes // lanes
        for n in range(begin, end):
            records.tally[w, n] = 0
        meet()
        for i in range(lane, N, lanes):
            node, _f = place_on_grid(layout, vector(of, w, 0, i), inv_dx, z0, columns)
            n = columns.start[layout, node[0], node[1]] + node[2]
            wp.atomic_add(records.tally, w, n, 1)
        meet()
        total = int(0)
        for n in range(begin, end):
            total += records.tally[w, n]
        first = before(total)
        for n in range(begin, end):
            here = records.tally[w, n]
            records.tally[w, n] = first
            first += here
        meet()
        for i in range(lane, N, lanes):
            node, _f = place_on_grid(layout, vector(of, w, 0, i), inv_dx, z0, columns)
            n = columns.start[layout, node[0], node[1]] + node[2]
            j = wp.atomic_add(records.tally, w, n, 1)
            p = records.order[w, i]
            records.spare_order[w, j] = p
            records.place[w, p] = j
            for c in range(CARRIED):
                records.spare[w, c, j] = get(of, w, c, i)
            for c in range(2):
                records.spare[w, CARRIED + c, j] = records.moduli[w, c, i]
            if rounds == 1:
                for c in range(3):
                    records.spare[w, CARRIED + 2 + c, j] = get(of, w, _LOW + c, i)
        meet()
        for i in range(lane, N, lanes):
            p = records.spare_order[w, i]
            records.order[w, i] = p
            for c in range(CARRIED):
                put(of, w, c, i, records.spare[w, c, i])
            for c in range(2):
                records.moduli[w, c, i] = records.spare[w, CARRIED + c, i]
            if rounds == 1:
                for c in range(3):
                    put(of, w, _LOW + c, i, records.spare[w, CARRIED + 2 + c, i])
            if yields == 0:
                near = Near()
                for axis in range(3):
                    for side in range(2):
                        near[2 * axis + side] = records.place[w, matter.lattice[p, axis, side]]
                put_near(records.near, w, i, near)
        meet()

    @wp.kernel(enable_backward=False, module="unique", launch_bounds=bounds(lanes))
    def advance(
        order: wp.array(dtype=wp.int32),  # [W] world of each block
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
        columns: Columns,  # a layout a world; L for the tape
        # empty before and after each substep; kept with the tape
        momentum: wp.array2d(dtype=vec4),  # [W, M] and mass; [S * W, M] for the tape
        velocity: wp.array2d(dtype=vec4),  # [W, M] and mass
        records: Records,
        tape: Tape,
    ):
        block, lane = wp.tid()
        if stays == 1:
            wp.tile_empty(shape=numbers, dtype=real, storage="shared")
        w = order[block]
        of = records.of
        moduli = records.moduli
        W = state.x.shape[0]
        N = state.x.shape[1]
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
        z0 = scene.z0
        inv_dx = real(1.0) / dx
        mass = matter.mass[w]
        yield_stress = matter.yield_stress[w]
        steps = int(plan.steps[frame, w])
        h = real(dt)
        keep = wp.exp(-scene.damping[w] * h)
        # of grid and layout; in place unless all are kept
        slot = int(w)
        layout = int(w)
        age = clock.age[w]
        travel = clock.travel[w]
        left = int(most)
        laid = int(w)
        strayed = records.strayed[w]
        lost = travel >= real(MARGIN) * dx  # whatever the order was, it will be made anew
        if lost:
            strayed = real(ORDERLY) * dx
        for i in range(lane, N, lanes):
            p = int(i)
            if lost:
                records.order[w, i] = i
                records.place[w, i] = i
            else:
                p = records.order[w, i]
            put_vector(of, w, 0, i, state.x[w, p])
            put_vector(of, w, _V, i, state.v[w, p])
            put_matrix(of, w, _C, i, state.C[w, p])
            if yields == 1:
                put_matrix(of, w, _F, i, state.F[w, p])
            if rounds == 1:
                put_vector(of, w, _LOW, i, state.low[w, p])
            moduli[w, _MU, i] = matter.mu[w, p]
            moduli[w, _LAM, i] = matter.lam[w, p]
        if step == 0:
            for p in range(lane, N, lanes):
                last_good.x[w, p] = state.x[w, p]
                last_good.v[w, p] = state.v[w, p]
                last_good.C[w, p] = state.C[w, p]
                if yields == 1:
                    last_good.F[w, p] = state.F[w, p]
        meet()
        while frame < frames and left > 0 and status == OK and t < pause:
            if step < steps and travel >= real(MARGIN) * dx:
                if keeps == 1:
                    if laid >= columns.count.shape[0]:
                        left = 0  # the tape is full
                    else:
                        layout = laid
                        laid += W
                if left > 0:
                    if lane == 0:
                        columns.count[layout] = 0
                        forget_bounds(layout, columns)
                    meet()
                    lower, upper = reach(vector(of, w, 0, lane % N), inv_dx, z0)
                    for i in range(lane, N, lanes):
                        low, high = reach(vector(of, w, 0, i), inv_dx, z0)
                        lower = wp.min(lower, low)
                        upper = wp.max(upper, high)
                    widen_bounds(layout, lower, upper, columns)
                    meet()
                    X = columns.bounds[layout, 2] - columns.bounds[layout, 0] + 1
                    Y = columns.bounds[layout, 3] - columns.bounds[layout, 1] + 1
                    status = GRID_FULL
                    if X <= columns.low.shape[1] and Y <= columns.low.shape[2]:
                        for n in range(lane, X * Y, lanes):
                            empty_column(layout, n // Y, n % Y, columns)
                        meet()
                        # particles that follow each other mostly stand in one column
                        begin = lane * N // lanes
                        lower, upper = reach(vector(of, w, 0, begin % N), inv_dx, z0)
                        for i in range(begin, (lane + 1) * N // lanes):
                            low, high = reach(vector(of, w, 0, i), inv_dx, z0)
                            if wp.abs(low[0] - lower[0]) + wp.abs(low[1] - lower[1]) > 1:
                                mark_box(layout, lower, upper, columns)
                                lower = low
                                upper = high
                            lower = wp.min(lower, low)
                            upper = wp.max(upper, high)
                        mark_box(layout, lower, upper, columns)
                        meet()
                        for n in range(lane, X * Y, lanes):
                            lay_column(layout, n // Y, n % Y, columns)
                        meet()
                        if columns.count[layout] <= momentum.shape[1]:
                            status = OK
                            strayed += travel
                            travel = real(0.0)
                            meet()
                            if strayed >= real(ORDERLY) * dx:
                                strayed = real(0.0)
                                put_in_order(
                                    w, lane, lanes, layout, inv_dx, z0, matter, columns, records
                                )
                            if keeps == 1:
                                for i in range(lane, N, lanes):
                                    tape.order[layout, i] = records.order[w, i]
                                    tape.place[layout, i] = records.place[w, i]
                    if status == GRID_FULL and lane == 0:
                        # the grid's need is read from the world's first layout
                        for a in range(4):
                            columns.bounds[w, a] = columns.bounds[layout, a]
            substep = step < steps and status == OK and left > 0
            if substep:
                for g in range(lane, grips.closed.shape[1], lanes):
                    place_gripper(w, w, g, t, dt, paths, grips)
                if keeps == 1:
                    tape.layout_of[slot] = layout
                    for n in range(lane, columns.count[layout], lanes):
                        momentum[slot, n] = vec4()
                if yields == 0:
                    inverted = int(0)
                    for i in range(lane, N, lanes):
                        p = records.order[w, i]
                        D = differences(of, w, 0, get_near(records.near, w, i))
                        tight, upright = tension(
                            D, matter.rest_frame[p], moduli[w, _MU, i], moduli[w, _LAM, i], h,
                            matter.volume,
                        )  # fmt: skip
                        put_matrix(of, w, _F, i, tight)
                        if not upright:
                            inverted = 1
                            clock.culprit[w] = p
                    if any_of(inverted) == 1:
                        status = INVERTED
                        substep = False
                elif keeps == 1:
                    meet()
            if substep:
                nodes = columns.count[layout]
                if keeps == 1:
                    for i in range(lane, N, lanes):
                        for c in range(CARRIED):
                            tape.of[slot, c, i] = get(of, w, c, i)
                window = window_type()
                held = wp.vec3i(-1, -1, -1)
                for i in range(lane * N // lanes, (lane + 1) * N // lanes):
                    given = mass * vector(of, w, _V, i)
                    T = mat33()
                    if yields == 1:
                        T = impulse_of_stress(
                            matrix(of, w, _F, i), moduli[w, _MU, i], moduli[w, _LAM, i], h,
                            matter.volume, inv_dx,
                        )  # fmt: skip
                    else:
                        pull = pulled(of, w, _F, get_near(records.near, w, i), i)
                        given += pull
                        if keeps == 1:
                            put_taped(tape.of, slot, CARRIED, i, pull)
                    node, f, q = given_by(
                        vector(of, w, 0, i), given, matrix(of, w, _C, i), T,
                        mass, layout, inv_dx, z0, columns,
                    )  # fmt: skip
                    window = hand_over(window, held, node, momentum, slot, columns.start, layout)
                    window = collect(window, f, q)
                    held = node
                hand_over(window, held, wp.vec3i(-1, -1, -1), momentum, slot, columns.start, layout)
                meet()
                following = vec4()
                if lane < nodes:
                    following = get_node(momentum, slot, lane)
                for n in range(lane, nodes, lanes):
                    m = following
                    # on its way while this one is updated
                    if n + lanes < nodes:
                        following = get_node(momentum, slot, n + lanes)
                    if m[3] > real(0.0):
                        if keeps == 0:
                            put_node(momentum, slot, n, vec4())
                        u = update_node(w, w, layout, n, m, h, keep, scene, paths, grips, columns)
                        put_node(velocity, w, n, vec4(u[0], u[1], u[2], m[3]))
                meet()
                # the longest way, in squared cells; above 1 what went wrong
                worst = real(0.0)
                for i in range(lane, N, lanes):
                    x = vector(of, w, 0, i)
                    v = vec3()
                    C = mat33()
                    upright = bool(True)
                    if yields == 1:
                        v, C, F = moved(
                            x, matrix(of, w, _F, i), moduli[w, _MU, i],
                            yield_stress, layout, w, h, inv_dx, z0, columns, velocity,
                        )  # fmt: skip
                        put_matrix(of, w, _F, i, F)
                        upright = wp.determinant(F) > real(0.0)
                    else:
                        v, C, _D = gather_particle(layout, w, x, inv_dx, z0, columns, velocity)
                    put_vector(of, w, 0, i, step_on(of, w, _LOW, i, x, h * v))
                    put_vector(of, w, _V, i, v)
                    put_matrix(of, w, _C, i, C)
                    far = wp.length_sq(v) * h * h / (dx * dx)
                    if not upright:
                        far = wp.max(far, real(INVERTED))
                        clock.culprit[w] = records.order[w, i]
                    # a NaN is not below anything
                    if not (wp.length_sq(v) * h * h <= dx * dx):
                        far = real(DIVERGED)
                    worst = wp.max(worst, far)
                worst = largest(worst)
                if worst > real(1.5):
                    status = int(worst)
                else:
                    travel += dx * wp.sqrt(worst)
                if keeps == 1:
                    slot += W
                step += 1
                age += 1
                left -= 1
            if step == steps and status == OK:
                for c in range(lane, plan.particles.shape[0], lanes):
                    i = records.place[w, plan.particles[c]]
                    plan.x[frame, w, c] = vector(of, w, 0, i)
                frame += 1
                if frame < frames:
                    for i in range(lane, N, lanes):
                        p = records.order[w, i]
                        last_good.x[w, p] = vector(of, w, 0, i)
                        last_good.v[w, p] = vector(of, w, _V, i)
                        last_good.C[w, p] = matrix(of, w, _C, i)
                        if yields == 1:
                            last_good.F[w, p] = matrix(of, w, _F, i)
                    steps = plan.steps[frame, w]
                    dt = frame_substep(frame, w, plan)
                    h = real(dt)
                    keep = wp.exp(-scene.damping[w] * h)
                    step = 0
            t = plan.time[frame] + wp.float64(step) * dt
        meet()
        for i in range(lane, N, lanes):
            p = records.order[w, i]
            state.x[w, p] = vector(of, w, 0, i)
            state.v[w, p] = vector(of, w, _V, i)
            state.C[w, p] = matrix(of, w, _C, i)
            if yields == 1:
                state.F[w, p] = matrix(of, w, _F, i)
            if rounds == 1:
                state.low[w, p] = vector(of, w, _LOW, i)
        if lane == 0:
            records.strayed[w] = strayed
            clock.frame[w] = frame
            clock.dt[w] = dt
            clock.steps[w] = steps
            clock.step[w] = step
            clock.age[w] = age
            clock.travel[w] = travel
            clock.status[w] = status

    return SimpleNamespace(
        Records=Records,
        Tape=Tape,
        advance=advance,
    )
