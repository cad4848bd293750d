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

from gendom.sim.block import make_block
from gendom.sim.columns import MARGIN, Columns
from gendom.sim.kernels import DIVERGED, GRID_FULL, INVERTED, OK, RECOVER_EVERY, make_kernels

STATE_COMPONENTS = 24
"""Of a record: x, v, C, F."""

COMPONENTS = 26
"""And mu, lam."""

_V, _C, _F, _MU, _LAM = 3, 6, 15, 24, 25


@functools.cache
def make_block_kernels(
    real: Any, law_name: str, *, plastic: bool, taped: bool = False
) -> SimpleNamespace:
    """Build the kernel for one scalar type and one material, see ``make_kernels``.

    Args:
        real, law_name, plastic: As there.
        taped: Whether every substep is kept for the reverse.

    Returns:
        Namespace with ``Records``, ``Tape`` and ``advance``, and with what reads records.
    """
    k = make_kernels(real, law_name, plastic=plastic)
    vec3, vec4, mat33 = k.vec3, k.vec4, k.mat33
    Clock = k.Clock
    forget_bounds = k.columns.forget_bounds
    locate_particle = k.columns.locate_particle
    mark_particle = k.columns.mark_particle
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
    moved = k.transfers.moved
    recovery_share = k.transfers.recovery_share
    recovered = k.transfers.recovered
    keeps = wp.constant(1 if taped else 0)
    block = make_block(real)
    meet, largest, before = block.meet, block.largest, block.before

    @wp.struct
    class Records:
        """Particles of W worlds in order; which of two sides is in use is the kernel's business."""

        of: wp.array3d(dtype=real)  # [W, 2 * COMPONENTS, N]
        order: wp.array3d(dtype=wp.int32)  # [W, 2, N] particle of each record
        place: wp.array2d(dtype=wp.int32)  # [W, N] record of each particle
        tally: wp.array2d(dtype=wp.int32)  # [W, M] scratch

    @wp.struct
    class Tape:
        """S substeps of W worlds, in rows: substep n of world w has row n * W + w."""

        of: wp.array3d(dtype=real)  # [S * W, STATE_COMPONENTS, N]
        order: wp.array2d(dtype=wp.int32)  # [S * W, N] of each layout
        place: wp.array2d(dtype=wp.int32)  # [S * W, N]
        layout_of: wp.array(dtype=wp.int32)  # [S * W] row of each substep's layout

    @wp.func
    def vector(w: int, c: int, i: int, of: wp.array3d(dtype=real)):
        return vec3(of[w, c, i], of[w, c + 1, i], of[w, c + 2, i])

    @wp.func
    def put_vector(w: int, c: int, i: int, a: vec3, of: wp.array3d(dtype=real)):
        for n in range(3):
            of[w, c + n, i] = a[n]

    @wp.func
    def matrix(w: int, c: int, i: int, of: wp.array3d(dtype=real)):
        return mat33(
            of[w, c, i], of[w, c + 1, i], of[w, c + 2, i],
            of[w, c + 3, i], of[w, c + 4, i], of[w, c + 5, i],
            of[w, c + 6, i], of[w, c + 7, i], of[w, c + 8, i],
        )  # fmt: skip

    @wp.func
    def put_matrix(w: int, c: int, i: int, A: mat33, of: wp.array3d(dtype=real)):
        for m in range(3):
            for n in range(3):
                of[w, c + 3 * m + n, i] = A[m, n]

    @wp.func
    def put_in_order(
        w: int,
        lane: int,
        lanes: int,
        side: int,
        layout: int,
        inv_dx: real,
        z0: real,
        columns: Columns,
        records: Records,
    ):
        """Order a world's records by their lowest nodes, onto the other side."""
        of = records.of
        N = of.shape[2]
        base = side * COMPONENTS
        other = 1 - side
        nodes = columns.count[layout]
        begin = lane * nodes // lanes
        end = (lane + 1) * nodes // lanes
        for n in range(begin, end):
            records.tally[w, n] = 0
        meet()
        for i in range(lane, N, lanes):
            node, _f = place_on_grid(layout, vector(w, base, i, of), inv_dx, z0, columns)
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
            node, _f = place_on_grid(layout, vector(w, base, i, of), inv_dx, z0, columns)
            n = columns.start[layout, node[0], node[1]] + node[2]
            j = wp.atomic_add(records.tally, w, n, 1)
            p = records.order[w, side, i]
            records.order[w, other, j] = p
            records.place[w, p] = j
            for c in range(COMPONENTS):
                of[w, other * COMPONENTS + c, j] = of[w, base + c, i]
        meet()

    @wp.kernel(enable_backward=False, module="unique")
    def advance(
        order: wp.array(dtype=wp.int32),  # [W] world of each block
        lanes: int,
        time: wp.float64,  # [s] at substep 0
        most: int,  # substeps at the most
        clock: Clock,
        matter: Matter,
        scene: Scene,
        paths: Paths,
        grips: Grips,  # [W]
        state: State,  # [W, N]
        columns: Columns,  # a layout a world; S * W for the tape
        momentum: wp.array2d(dtype=vec4),  # [W, M] and mass; [S * W, M] for the tape
        velocity: wp.array2d(dtype=vec4),  # [W, M] and mass
        records: Records,
        tape: Tape,
    ):
        block, lane = wp.tid()
        w = order[block]
        of = records.of
        N = state.x.shape[1]
        dx = scene.dx
        z0 = scene.z0
        inv_dx = real(1.0) / dx
        dt = clock.dt[w]
        h = real(dt)
        keep = wp.exp(-scene.damping[w] * h)
        blend = recovery_share(h, RECOVER_EVERY, matter)
        mass = matter.mass[w]
        yield_stress = matter.yield_stress[w]
        step = int(clock.step[w])
        steps = wp.min(clock.steps[w], step + most)
        if step >= steps or clock.status[w] != OK:
            return
        # rows of the grid and of the layout; in place unless all are kept
        slot = int(w)
        layout = int(w)
        age = clock.age[w]
        travel = clock.travel[w]
        status = int(OK)
        side = int(0)
        lost = travel >= real(MARGIN) * dx  # whatever the order was, it will be made anew
        for i in range(lane, N, lanes):
            p = int(i)
            if lost:
                records.order[w, 0, i] = i
            else:
                p = records.order[w, 0, i]
            put_vector(w, 0, i, state.x[w, p], of)
            put_vector(w, _V, i, state.v[w, p], of)
            put_matrix(w, _C, i, state.C[w, p], of)
            put_matrix(w, _F, i, state.F[w, p], of)
            of[w, _MU, i] = matter.mu[w, p]
            of[w, _LAM, i] = matter.lam[w, p]
        meet()
        while step < steps and status == OK:
            if travel >= real(MARGIN) * dx:
                base = side * COMPONENTS
                layout = slot
                if lane == 0:
                    columns.count[layout] = 0
                    forget_bounds(layout, columns)
                meet()
                for i in range(lane, N, lanes):
                    locate_particle(layout, vector(w, base, i, of), inv_dx, columns)
                meet()
                X = columns.bounds[layout, 2] - columns.bounds[layout, 0] + 1
                Y = columns.bounds[layout, 3] - columns.bounds[layout, 1] + 1
                status = GRID_FULL
                if X <= columns.low.shape[1] and Y <= columns.low.shape[2]:
                    for n in range(lane, X * Y, lanes):
                        empty_column(layout, n // Y, n % Y, columns)
                    meet()
                    for i in range(lane, N, lanes):
                        mark_particle(layout, vector(w, base, i, of), inv_dx, z0, columns)
                    meet()
                    for n in range(lane, X * Y, lanes):
                        lay_column(layout, n // Y, n % Y, columns)
                    meet()
                    if columns.count[layout] <= momentum.shape[1]:
                        status = OK
                        travel = real(0.0)
                        put_in_order(w, lane, lanes, side, layout, inv_dx, z0, columns, records)
                        side = 1 - side
                        if keeps == 1:
                            for i in range(lane, N, lanes):
                                tape.order[layout, i] = records.order[w, side, i]
                                tape.place[layout, i] = records.place[w, i]
                if status == GRID_FULL and lane == 0:
                    # the grid's need is read from the world's first layout
                    for a in range(4):
                        columns.bounds[w, a] = columns.bounds[layout, a]
            if status == OK:
                base = side * COMPONENTS
                nodes = columns.count[layout]
                for n in range(lane, nodes, lanes):
                    momentum[slot, n] = vec4()
                t = time + wp.float64(step) * dt
                for g in range(lane, grips.closed.shape[1], lanes):
                    place_gripper(w, w, g, t, dt, paths, grips)
                if age % RECOVER_EVERY == 0 and blend > real(0.0):
                    for i in range(lane, N, lanes):
                        p = records.order[w, side, i]
                        D = mat33()
                        for axis in range(3):
                            a = records.place[w, matter.lattice[p, axis, 1]]
                            b = records.place[w, matter.lattice[p, axis, 0]]
                            d = vector(w, base, a, of) - vector(w, base, b, of)
                            for n in range(3):
                                D[n, axis] = d[n]
                        F = matrix(w, base + _F, i, of)
                        F = recovered(F, D * matter.rest_frame[p], blend)
                        put_matrix(w, base + _F, i, F, of)
                meet()
                if keeps == 1:
                    if lane == 0:
                        tape.layout_of[slot] = layout
                    for i in range(lane, N, lanes):
                        for c in range(STATE_COMPONENTS):
                            tape.of[slot, c, i] = of[w, base + c, i]
                window = window_type()
                held = wp.vec3i(-1, -1, -1)
                for i in range(lane * N // lanes, (lane + 1) * N // lanes):
                    node, f, q = given_by(
                        vector(w, base, i, of), vector(w, base + _V, i, of),
                        matrix(w, base + _C, i, of), matrix(w, base + _F, i, of),
                        of[w, base + _MU, i], of[w, base + _LAM, i],
                        mass, matter.volume, layout, h, inv_dx, z0, columns,
                    )  # fmt: skip
                    window = hand_over(window, held, node, momentum, slot, columns.start, layout)
                    window = collect(window, f, q)
                    held = node
                hand_over(window, held, wp.vec3i(-1, -1, -1), momentum, slot, columns.start, layout)
                meet()
                for n in range(lane, nodes, lanes):
                    m = momentum[slot, n]
                    if m[3] > real(0.0):
                        u = update_node(w, w, layout, n, m, h, keep, scene, paths, grips, columns)
                        velocity[w, n] = vec4(u[0], u[1], u[2], m[3])
                meet()
                fastest = real(0.0)
                trouble = int(OK)
                for i in range(lane, N, lanes):
                    x = vector(w, base, i, of)
                    v, C, F = moved(
                        x, matrix(w, base + _F, i, of), of[w, base + _MU, i],
                        yield_stress, layout, w, h, inv_dx, z0, columns, velocity,
                    )  # fmt: skip
                    put_vector(w, base, i, x + h * v, of)
                    put_vector(w, base + _V, i, v, of)
                    put_matrix(w, base + _C, i, C, of)
                    put_matrix(w, base + _F, i, F, of)
                    speed = wp.length_sq(v)
                    if wp.determinant(F) <= real(0.0):
                        trouble = INVERTED
                        clock.culprit[w] = records.order[w, side, i]
                    # a NaN is not below anything
                    if not (speed * h * h <= dx * dx):
                        trouble = DIVERGED
                        speed = real(0.0)
                    fastest = wp.max(fastest, speed)
                travel += h * wp.sqrt(largest(fastest))
                status = int(largest(real(trouble)))
                step += 1
                age += 1
                if keeps == 1:
                    slot += state.x.shape[0]
        meet()
        base = side * COMPONENTS
        for i in range(lane, N, lanes):
            p = records.order[w, side, i]
            records.order[w, 0, i] = p
            state.x[w, p] = vector(w, base, i, of)
            state.v[w, p] = vector(w, base + _V, i, of)
            state.C[w, p] = matrix(w, base + _C, i, of)
            state.F[w, p] = matrix(w, base + _F, i, of)
        if lane == 0:
            clock.step[w] = step
            clock.age[w] = age
            clock.travel[w] = travel
            clock.status[w] = status

    return SimpleNamespace(
        Records=Records,
        Tape=Tape,
        advance=advance,
        vector=vector,
        put_vector=put_vector,
        matrix=matrix,
        put_matrix=put_matrix,
    )
