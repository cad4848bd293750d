"""The substep backwards on CUDA where bodies are small: a block of threads for each world.

The transpose of ``block_kernels``: derivatives by the particles' state stand in records, in the
order of the layout of the substep that is reversed.

Shapes: W worlds, N particles, S recorded substeps, M nodes.
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
from gendom.sim.block_kernels import COMPONENTS, carried_components, make_block_kernels
from gendom.sim.columns import Columns
from gendom.sim.kernels import OK, make_kernels
from gendom.sim.reverse import NOT_FINITE, make_reverse

SUM_COMPONENTS = 4
"""Derivatives by mu, lam, mass and yield stress of a particle, besides those by its state."""

_V, _C, _F, _PULL = 3, 6, 15, 15
_MU, _LAM, _MASS, _YIELD = 0, 1, 2, 3


@functools.cache
def make_block_reverse(
    real: Any, law_name: str, *, plastic: bool, room: int = 0, lanes: int = 128
) -> SimpleNamespace:
    """Build the kernel for one scalar type and one material, see ``make_block_kernels``.

    Args:
        real, law_name, plastic, lanes: As there.
        room: Shared memory in which derivatives by a block's state stay [bytes]; 0: in arrays.

    Returns:
        Namespace with ``BarRecords`` and ``reverse``.
    """
    k = make_kernels(real, law_name, plastic=plastic)
    one_thread = make_reverse(real, law_name, plastic=plastic)
    records = make_block_kernels(real, law_name, plastic=plastic, taped=True)
    vec3, vec4, mat33 = k.vec3, k.vec4, k.mat33
    Clock, Tape, Trouble = k.Clock, records.Tape, one_thread.Trouble
    Scene, Paths, Grips = k.boundary.Scene, k.boundary.Paths, k.boundary.Grips
    SceneBars = k.boundary.SceneBars
    Matter, MatterBars = k.transfers.Matter, k.transfers.MatterBars
    kept = make_store(real, resident=False)
    bar = make_store(real, resident=room > 0)
    get, put = bar.get, bar.put
    put_vector, put_matrix = bar.put_vector, bar.put_matrix
    bar_vector, bar_matrix = bar.vector, bar.matrix
    bar_differences, pulled = bar.differences, bar.pulled
    differences = kept.differences
    vector, matrix = kept.vector, kept.matrix
    stays = wp.constant(1 if room else 0)
    numbers = wp.constant(max(1, room // (4 if real == wp.float32 else 8)))
    place_gripper = k.boundary.place_gripper
    update_node = k.boundary.update_node
    update_node_back = k.boundary.update_node_back
    close_substep = one_thread.close_substep
    window_type = k.transfers.window
    collect = k.transfers.collect
    hand_over = k.transfers.hand_over
    before_yielding = k.transfers.before_yielding
    taken_by = k.transfers.taken_by
    moved_back = k.transfers.moved_back
    given_back = k.transfers.given_back
    get_node, put_node = k.transfers.get_node, k.transfers.put_node
    impulse_of_stress = k.transfers.impulse_of_stress
    impulse_of_stress_back = k.transfers.impulse_of_stress_back
    tension_back = k.transfers.tension_back
    yields = k.transfers.yields
    CARRIED = wp.constant(carried_components(plastic=plastic))
    largest_bar = one_thread.largest
    meet = make_block(real).meet

    @wp.struct
    class BarRecords:
        """Derivatives by W worlds' particles in order.

        By x, v, C, and F or, of an elastic body, by the differences of x.
        """

        of: wp.array3d(dtype=real)  # [W, COMPONENTS, N], or [1, ...] if they are resident
        sums: wp.array3d(dtype=real)  # [W, SUM_COMPONENTS, N]
        # scratch
        spare: wp.array3d(dtype=real)  # [W, COMPONENTS + SUM_COMPONENTS, N]
        near: wp.array3d(dtype=wp.int32)  # [W, 3, N] records of its neighbours, if elastic

    @wp.func
    def find_neighbours(
        w: int, lane: int, lanes: int, layout: int, matter: Matter, tape: Tape, records: BarRecords
    ):
        for i in range(lane, records.near.shape[2], lanes):
            p = tape.order[layout, i]
            near = Near()
            for axis in range(3):
                for side in range(2):
                    near[2 * axis + side] = tape.place[layout, matter.lattice[p, axis, side]]
            put_near(records.near, w, i, near)

    @wp.kernel(enable_backward=False, module="unique", launch_bounds=bounds(lanes))
    def reverse(
        order: wp.array(dtype=wp.int32),  # [W] world of each block
        lanes: int,
        time: wp.float64,  # [s] at substep 0 of the frame
        until: wp.array(dtype=wp.int32),  # [W] substeps of the frame done after the tape
        clock: Clock,  # where the tape begins
        matter: Matter,
        scene: Scene,
        paths: Paths,
        grips: Grips,  # [W]
        columns: Columns,  # S * W layouts
        momentum: wp.array2d(dtype=vec4),  # [S * W, M] and mass
        tape: Tape,
        # scratch
        velocity: wp.array2d(dtype=vec4),  # [W, M]
        grid_bar: wp.array2d(dtype=vec4),  # [W, M]
        records: BarRecords,
        # by the state: after the tape on entry, before it on return
        bars: MatterBars,
        scene_bars: SceneBars,
        trouble: Trouble,
    ):
        block, lane = wp.tid()
        w = order[block]
        slots = until[w] - clock.step[w]
        if slots <= 0:
            return
        if stays == 1:
            wp.tile_empty(shape=numbers, dtype=real, storage="shared")
        of, sums, spare = records.of, records.sums, records.spare
        W = clock.dt.shape[0]
        N = bars.x.shape[1]
        z0 = scene.z0
        inv_dx = real(1.0) / scene.dx
        dt = clock.dt[w]
        h = real(dt)
        keep = wp.exp(-scene.damping[w] * h)
        mass = matter.mass[w]
        slot = int((slots - 1) * W + w)
        layout = tape.layout_of[slot]
        for i in range(lane, N, lanes):
            p = tape.order[layout, i]
            put_vector(of, w, 0, i, bars.x[w, p])
            put_vector(of, w, _V, i, bars.v[w, p])
            put_matrix(of, w, _C, i, bars.C[w, p])
            if yields == 1:
                put_matrix(of, w, _F, i, bars.F[w, p])
            for c in range(SUM_COMPONENTS):
                sums[w, c, i] = real(0.0)
        if yields == 0:
            find_neighbours(w, lane, lanes, layout, matter, tape, records)
        meet()
        while slot >= 0:
            if tape.layout_of[slot] != layout:
                earlier = tape.layout_of[slot]
                for i in range(lane, N, lanes):
                    j = tape.place[layout, tape.order[earlier, i]]
                    for c in range(CARRIED):
                        spare[w, c, i] = get(of, w, c, j)
                    for c in range(SUM_COMPONENTS):
                        spare[w, COMPONENTS + c, i] = sums[w, c, j]
                layout = earlier
                meet()
                for i in range(lane, N, lanes):
                    for c in range(CARRIED):
                        put(of, w, c, i, spare[w, c, i])
                    for c in range(SUM_COMPONENTS):
                        sums[w, c, i] = spare[w, COMPONENTS + c, i]
                if yields == 0:
                    find_neighbours(w, lane, lanes, layout, matter, tape, records)
                meet()
            nodes = columns.count[layout]
            step = clock.step[w] + (slot - w) // W
            t = time + wp.float64(step) * dt
            for g in range(lane, grips.closed.shape[1], lanes):
                place_gripper(w, w, g, t, dt, paths, grips)
            meet()
            following = vec4()
            if lane < nodes:
                following = get_node(momentum, slot, lane)
            for n in range(lane, nodes, lanes):
                q = following
                # on its way while this one is updated
                if n + lanes < nodes:
                    following = get_node(momentum, slot, n + lanes)
                u = vec3()
                if q[3] > real(0.0):
                    u = update_node(w, w, layout, n, q, h, keep, scene, paths, grips, columns)
                put_node(grid_bar, w, n, vec4())
                put_node(velocity, w, n, vec4(u[0], u[1], u[2], q[3]))
            meet()
            if yields == 1:
                for i in range(lane, N, lanes):
                    F_bar, mu_bar, yield_bar = before_yielding(
                        vector(tape.of, slot, 0, i), matrix(tape.of, slot, _F, i),
                        matter.mu[w, tape.order[layout, i]], matter.yield_stress[w],
                        bar_matrix(of, w, _F, i), layout, w, h, inv_dx, z0, columns, velocity,
                    )  # fmt: skip
                    put_matrix(of, w, _F, i, F_bar)
                    sums[w, _MU, i] = sums[w, _MU, i] + mu_bar
                    sums[w, _YIELD, i] = sums[w, _YIELD, i] + yield_bar
                meet()
            window = window_type()
            held = wp.vec3i(-1, -1, -1)
            for i in range(lane * N // lanes, (lane + 1) * N // lanes):
                T = mat33()
                if yields == 1:
                    F = matrix(tape.of, slot, _F, i)
                    T = (h * inv_dx) * (bar_matrix(of, w, _F, i) * wp.transpose(F))
                node, f, taken = taken_by(
                    vector(tape.of, slot, 0, i), bar_vector(of, w, 0, i),
                    bar_vector(of, w, _V, i), bar_matrix(of, w, _C, i), T,
                    layout, h, inv_dx, z0, columns,
                )  # fmt: skip
                window = hand_over(window, held, node, grid_bar, w, columns.start, layout)
                window = collect(window, f, taken)
                held = node
            hand_over(window, held, wp.vec3i(-1, -1, -1), grid_bar, w, columns.start, layout)
            meet()
            for i in range(lane, N, lanes):
                T = mat33()
                if yields == 1:
                    F = matrix(tape.of, slot, _F, i)
                    T = (h * inv_dx) * (bar_matrix(of, w, _F, i) * wp.transpose(F))
                x_bar, D = moved_back(
                    vector(tape.of, slot, 0, i), bar_vector(of, w, 0, i),
                    bar_vector(of, w, _V, i), bar_matrix(of, w, _C, i), T,
                    layout, w, h, inv_dx, z0, columns, velocity,
                )  # fmt: skip
                put_vector(of, w, 0, i, x_bar)
                if yields == 1:
                    F_bar = bar_matrix(of, w, _F, i)
                    put_matrix(of, w, _F, i, F_bar + h * (wp.transpose(D) * F_bar))
            keep_sum = wp.float64(0.0)
            gravity_sum = wp.vec3d()
            for n in range(lane, nodes, lanes):
                q = get_node(momentum, slot, n)
                if q[3] > real(0.0):
                    v_bar = get_node(grid_bar, w, n)
                    node_bar, keep_bar, gravity_bar = update_node_back(
                        w, w, layout, n, q, vec3(v_bar[0], v_bar[1], v_bar[2]), h, keep, scene,
                        paths, grips, columns, scene_bars,
                    )  # fmt: skip
                    put_node(grid_bar, w, n, node_bar)
                    keep_sum += keep_bar
                    gravity_sum += gravity_bar
            wp.atomic_add(scene_bars.keep, w, keep_sum)
            wp.atomic_add(scene_bars.gravity, w, gravity_sum)
            meet()
            if lane == 0:
                close_substep(w, w, t, dt, scene, paths, grips, scene_bars)
            for i in range(lane, N, lanes):
                p = tape.order[layout, i]
                x = vector(tape.of, slot, 0, i)
                v = vector(tape.of, slot, _V, i)
                given = mass * v
                T = mat33()
                if yields == 1:
                    T = impulse_of_stress(
                        matrix(tape.of, slot, _F, i), matter.mu[w, p], matter.lam[w, p], h,
                        matter.volume, inv_dx,
                    )  # fmt: skip
                else:
                    given += vector(tape.of, slot, _PULL, i)
                x_bar, u_bar, C_bar, T_bar, mass_bar = given_back(
                    x, v, given, matrix(tape.of, slot, _C, i), T, mass, layout, w, inv_dx, z0,
                    columns, grid_bar,
                )  # fmt: skip
                put_vector(of, w, 0, i, bar_vector(of, w, 0, i) + x_bar)
                put_vector(of, w, _V, i, u_bar)
                put_matrix(of, w, _C, i, C_bar)
                sums[w, _MASS, i] = sums[w, _MASS, i] + mass_bar
                size = wp.length_sq(x_bar) + wp.length_sq(u_bar)
                if yields == 1:
                    F_bar, mu_bar, lam_bar = impulse_of_stress_back(
                        matrix(tape.of, slot, _F, i), matter.mu[w, p], matter.lam[w, p], h,
                        matter.volume, inv_dx, T_bar,
                    )  # fmt: skip
                    put_matrix(of, w, _F, i, bar_matrix(of, w, _F, i) + F_bar)
                    sums[w, _MU, i] = sums[w, _MU, i] + mu_bar
                    sums[w, _LAM, i] = sums[w, _LAM, i] + lam_bar
                    size += wp.ddot(F_bar, F_bar)
                # the first one found is named; a NaN is not below anything
                overflows = not (size < real(largest_bar))
                if overflows and wp.atomic_max(trouble.status, w, NOT_FINITE) == OK:
                    trouble.culprit[w] = p
                    trouble.slot[w] = (slot - w) // W
            if yields == 0:
                meet()
                for i in range(lane, N, lanes):
                    p = tape.order[layout, i]
                    # a pull draws one neighbour forth and the other back
                    near = get_near(records.near, w, i)
                    pull_bar = (real(-1.0) / mass) * bar_differences(of, w, _V, near)
                    D_bar, mu_bar, lam_bar = tension_back(
                        differences(tape.of, slot, 0, near), matter.rest_frame[p],
                        matter.mu[w, p], matter.lam[w, p], h, matter.volume, pull_bar,
                    )  # fmt: skip
                    put_matrix(of, w, _F, i, D_bar)
                    sums[w, _MU, i] = sums[w, _MU, i] + mu_bar
                    sums[w, _LAM, i] = sums[w, _LAM, i] + lam_bar
                meet()
                for i in range(lane, N, lanes):
                    slack = pulled(of, w, _F, get_near(records.near, w, i), i)
                    put_vector(of, w, 0, i, bar_vector(of, w, 0, i) - slack)
            meet()
            slot -= W
        for i in range(lane, N, lanes):
            p = tape.order[layout, i]
            bars.x[w, p] = bar_vector(of, w, 0, i)
            bars.v[w, p] = bar_vector(of, w, _V, i)
            bars.C[w, p] = bar_matrix(of, w, _C, i)
            if yields == 1:
                bars.F[w, p] = bar_matrix(of, w, _F, i)
            bars.mu[w, p] = bars.mu[w, p] + sums[w, _MU, i]
            bars.lam[w, p] = bars.lam[w, p] + sums[w, _LAM, i]
            bars.mass[w, p] = bars.mass[w, p] + sums[w, _MASS, i]
            bars.yield_stress[w, p] = bars.yield_stress[w, p] + sums[w, _YIELD, i]

    return SimpleNamespace(BarRecords=BarRecords, reverse=reverse)
