"""The substep backwards on CUDA where bodies are small: a block of threads for each world.

The transpose of ``runners.block_kernels``: derivatives by the particles' state stand in records, in
the order of the layout of the substep that is reversed.

Shapes: W worlds, N particles, S recorded substeps, M nodes.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace

import warp as wp

from gendom.sim.mpm.adjoint.boundary import make_boundary_adjoint
from gendom.sim.mpm.adjoint.held import make_held_adjoint
from gendom.sim.mpm.adjoint.records import (
    DRAG,
    LAM,
    MASS,
    MU,
    STRETCHES,
    SUMS,
    WIND,
    YIELD,
    make_bar_records,
    make_recorded,
)
from gendom.sim.mpm.adjoint.sums import Trouble
from gendom.sim.mpm.block import (
    Near,
    bounds,
    get_near,
    make_block,
    make_store,
    put_near,
    spans_of,
)
from gendom.sim.mpm.boundary import make_boundary
from gendom.sim.mpm.elasticity import make_elasticity, make_maxwell_branch
from gendom.sim.mpm.grid import SparseGrid
from gendom.sim.mpm.native import MODULE_OPTIONS
from gendom.sim.mpm.poses import AHEAD, make_poses
from gendom.sim.mpm.runners.held import make_held
from gendom.sim.mpm.runners.records import C, V, Variant, X
from gendom.sim.mpm.step import NOT_FINITE, OK, make_closing
from gendom.sim.mpm.transfer import make_bspline, make_transfer
from gendom.sim.mpm.types import make_types


@functools.cache
def make_block_reverse(variant: Variant) -> SimpleNamespace:
    """Build the kernel of a variant.

    Returns:
        Namespace with ``BarRecords`` and ``reverse``.
    """
    real = variant.real
    types = make_types(real)
    vec3, vec4, mat33 = types.vec3, types.vec4, types.mat33
    Clock, Matter, MatterBars = types.Clock, types.Matter, types.MatterBars
    Scene, Paths, Grips, SceneBars = types.Scene, types.Paths, types.Grips, types.SceneBars
    elasticity = make_elasticity(real, variant.law, yields=variant.yields, damped=variant.damped)
    pull_adjoint, air_adjoint = elasticity.pull_adjoint, elasticity.air_adjoint
    branch = make_maxwell_branch(real).branch
    bspline, transfer = make_bspline(real), make_transfer(real)
    window_type, collect, hand_over = bspline.window, bspline.collect, bspline.hand_over
    get_node, put_node = bspline.get_node, bspline.put_node
    taken_by, g2p_adjoint, p2g_adjoint = (
        transfer.taken_by,
        transfer.g2p_adjoint,
        transfer.p2g_adjoint,
    )
    node_velocity, node_velocity_adjoint = transfer.node_velocity, transfer.node_velocity_adjoint
    recorded = make_recorded(real)
    bar_records = make_bar_records(real, resident=variant.room > 0)
    Tape, BarRecords = recorded.Struct, bar_records.Struct
    boundary = make_boundary_adjoint(real, recorded, bar_records)
    contact_adjoint, grasp_adjoint = boundary.contact_adjoint, boundary.grasp_adjoint
    held_adjoint = make_held_adjoint(real, resident=variant.room > 0)
    carry_adjoint, lead_adjoint = held_adjoint.carry_adjoint, held_adjoint.lead_adjoint
    contact = make_boundary(real, recorded).contact
    of_held = make_held(real)
    Held, list_held, lead = of_held.Held, of_held.list_held, of_held.lead
    poses = make_poses(real)
    pose_ahead, close_poses = poses.pose_ahead, poses.close_poses
    close_rates = make_closing(real).close_rates
    kept = make_store(real, resident=False)
    bar = make_store(real, resident=variant.room > 0)
    get, put = bar.get, bar.put
    put_vector, put_matrix, put_symmetric = bar.put_vector, bar.put_matrix, bar.put_symmetric
    bar_vector, bar_matrix, bar_symmetric = bar.vector, bar.matrix, bar.symmetric
    bar_differences, pulled = bar.differences, bar.pulled
    vector, matrix, symmetric = kept.vector, kept.matrix, kept.symmetric
    differences = kept.differences
    block = make_block(real)
    meet, any_of = block.meet, block.any
    COMPONENTS, Z, G = map(wp.constant, (variant.components, variant.Z, variant.G))
    TAPED_Z, TAPED_G = wp.constant(18), wp.constant(18 + 6 * variant.damped)
    damped, plastic = wp.constant(int(variant.damped)), wp.constant(int(variant.yields))
    stays, numbers = wp.constant(int(variant.room > 0)), wp.constant(variant.numbers)
    largest = 1.0e37 if real == wp.float32 else 1.0e300

    @wp.func
    def find_neighbours(
        w: int, lane: int, lanes: int, layout: int, matter: Matter, tape: Tape, records: BarRecords
    ):
        for i in range(lane, records.near.shape[2], lanes):
            p = tape.order[layout, i]
            records.place[w, p] = i
            near = Near()
            for axis in range(3):
                for side in range(2):
                    near[2 * axis + side] = tape.place[layout, matter.lattice[p, axis, side]]
            put_near(records.near, w, i, near)

    @wp.func
    def section_motion(s: int, row: int, mass: real, matter: Matter, tape: Tape):
        """As that of ``step``, from the tape."""
        size = matter.section
        layout = tape.layout_of[row]
        x = vec3()
        q = vec3()
        for p in range(s * size, (s + 1) * size):
            i = tape.place[layout, p]
            x += vector(tape.of, row, 0, i)
            q += vector(tape.of, row, 15, i)
        share = real(1.0) / real(size)
        return share * x, (share / mass) * q

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS, launch_bounds=bounds(variant.lanes))
    def reverse(
        order: wp.array(dtype=wp.int32),  # world of each block
        lanes: int,
        time: wp.float64,  # [s] at substep 0 of the frame
        until: wp.array(dtype=wp.int32),  # [W] substeps of the frame done after the tape
        clock: Clock,  # where the tape begins
        matter: Matter,
        scene: Scene,
        paths: Paths,
        grips: Grips,  # [W]
        grid: SparseGrid,  # S * W layouts
        momentum: wp.array2d(dtype=vec4),  # [S * W, M] and mass
        tape: Tape,
        # scratch
        velocity: wp.array2d(dtype=vec4),  # [W, M]
        nodes_bar: wp.array2d(dtype=vec4),  # [W, M]
        touched: wp.array2d(dtype=vec3),  # [W, sections]
        records: BarRecords,
        held: Held,
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
        # of the records that this lane gives to the grid
        begin = lane * N // lanes
        end = (lane + 1) * N // lanes
        grippers = grips.closed.shape[1]
        inv_dx = real(1.0) / scene.dx
        dt = clock.dt[w]
        h = real(dt)
        factor = wp.exp(-scene.velocity_damping[w] * h)
        mass = matter.mass[w]
        per_mass = real(1.0) / mass
        drag = matter.drag[w]
        gravity = scene.gravity[w]
        touches = wp.max(scene.table, scene.walls)
        layout = int(tape.layout_of[(slots - 1) * W + w])
        for i in range(lane, N, lanes):
            p = tape.order[layout, i]
            put_vector(of, w, X, i, bars.x[w, p])
            put_vector(of, w, V, i, bars.v[w, p])
            put_matrix(of, w, C, i, bars.C[w, p])
            if damped == 1:
                for c in range(6):
                    put(of, w, Z + c, i, bars.Z[w, c, p])
            if plastic == 1:
                put_matrix(of, w, G, i, bars.G[w, p])
            for c in range(SUMS):
                sums[w, c, i] = real(0.0)
        find_neighbours(w, lane, lanes, layout, matter, tape, records)
        holding = int(list_held(w, lane, lanes, tape.order, layout, matter, grips, held))
        began = time + wp.float64(clock.step[w]) * dt
        gone = int(slots - 1)
        posed = int(slots)  # the substep from which on poses are known, and how many of them
        count = int(0)
        while gone >= 0:
            slot = gone * W + w
            if tape.layout_of[slot] != layout:
                earlier = tape.layout_of[slot]
                for i in range(lane, N, lanes):
                    j = tape.place[layout, tape.order[earlier, i]]
                    for c in range(COMPONENTS):
                        spare[w, c, i] = get(of, w, c, j)
                    for c in range(SUMS):
                        spare[w, COMPONENTS + c, i] = sums[w, c, j]
                layout = earlier
                meet()
                for i in range(lane, N, lanes):
                    for c in range(COMPONENTS):
                        put(of, w, c, i, spare[w, c, i])
                    for c in range(SUMS):
                        sums[w, c, i] = spare[w, COMPONENTS + c, i]
                find_neighbours(w, lane, lanes, layout, matter, tape, records)
                holding = list_held(w, lane, lanes, tape.order, layout, matter, grips, held)
            nodes = grid.count[layout]
            age = clock.age[w] + gone
            if grippers > 0 and gone < posed:
                # poses of many substeps at once
                close_poses(w, lane, lanes, posed, count, began, dt, paths, grips, scene_bars)
                meet()
                posed = wp.max(0, gone - AHEAD + 1)
                count = gone + 1 - posed
                pose_ahead(w, lane, lanes, posed, count, began, dt, paths, grips)
                meet()
            grip_row = w * AHEAD + gone - posed
            for n in range(lane, holding, lanes):
                if held.share[w, n] > real(0.0):
                    x = vector(tape.of, slot, 0, held.record[w, n])
                    lead(w, n, x, grip_row, h, matter, scene, grips, held)
            if touches == 1:
                for s in range(lane, N // matter.section, lanes):
                    x, u = section_motion(s, slot, mass, matter, tape)
                    touched[w, s] = contact(w, x, u, h, matter.contact_radius, scene)
            meet()
            following = vec4()
            if lane < nodes:
                following = get_node(momentum, slot, lane)
            for n in range(lane, nodes, lanes):
                q = following
                # on its way while this one is updated
                if n + lanes < nodes:
                    following = get_node(momentum, slot, n + lanes)
                put_node(nodes_bar, w, n, vec4())
                put_node(velocity, w, n, node_velocity(q, factor))
            meet()
            window = window_type()
            window_at = wp.vec3i(-1, -1, -1)
            for i in range(begin, end):
                if held.free[w, i] == real(0.0):
                    continue
                x_bar = bar_vector(of, w, X, i)
                node, f, taken = taken_by(
                    vector(tape.of, slot, 0, i), bar_vector(of, w, V, i) + h * x_bar,
                    bar_matrix(of, w, C, i), layout, inv_dx, grid,
                )  # fmt: skip
                window = hand_over(window, window_at, node, nodes_bar, w, grid.start, layout)
                window = collect(window, f, taken)
                window_at = node
            hand_over(window, window_at, wp.vec3i(-1, -1, -1), nodes_bar, w, grid.start, layout)
            meet()
            for i in range(lane, N, lanes):
                if held.free[w, i] == real(0.0):
                    continue
                x_bar = bar_vector(of, w, X, i)
                x_bar += g2p_adjoint(
                    vector(tape.of, slot, 0, i), bar_vector(of, w, V, i) + h * x_bar,
                    bar_matrix(of, w, C, i), layout, w, inv_dx, grid, velocity,
                )  # fmt: skip
                put_vector(of, w, X, i, x_bar)
            if holding > 0:
                carry_adjoint(
                    w, lane, lanes, holding, grip_row, h, grips, records, held, scene_bars
                )
            factor_sum = wp.float64(0.0)
            for n in range(lane, nodes, lanes):
                node_bar, factor_bar = node_velocity_adjoint(
                    get_node(momentum, slot, n), get_node(nodes_bar, w, n), factor
                )
                put_node(nodes_bar, w, n, node_bar)
                factor_sum += wp.float64(factor_bar)
            if factor < real(1.0):
                wp.atomic_add(scene_bars.damping_factor, w, factor_sum)
            meet()
            for i in range(lane, N, lanes):
                p = tape.order[layout, i]
                free = held.free[w, i]
                x_bar = vec3()
                q_bar = vec3()
                C_bar = mat33()
                mass_bar = real(0.0)
                u_bar = vec3()
                if free > real(0.0):
                    x = vector(tape.of, slot, 0, i)
                    own = per_mass * vector(tape.of, slot, 15, i)
                    u = own
                    if touches == 1:
                        u += touched[w, p // matter.section]
                    v = u
                    if free < real(1.0):
                        v += (real(1.0) - free) * (held.led[w, i] - u)
                    x_bar, q_bar, C_bar, mass_bar = p2g_adjoint(
                        x, mass * v, matrix(tape.of, slot, 6, i), mass, layout, w, inv_dx, grid,
                        nodes_bar,
                    )  # fmt: skip
                    u_bar = mass * q_bar
                    mass_bar += wp.dot(q_bar, v)
                    u_bar = free * u_bar
                    # its own velocity is momentum over mass
                    mass_bar -= per_mass * wp.dot(u_bar, own)
                put_vector(of, w, X, i, bar_vector(of, w, X, i) + x_bar)
                put_vector(of, w, V, i, u_bar)
                put_matrix(of, w, C, i, C_bar)
                sums[w, MASS, i] = sums[w, MASS, i] + mass_bar
                # the first one found is named; a NaN is not below anything
                size = wp.length_sq(x_bar) + wp.length_sq(u_bar)
                if not (size < real(largest)) and (
                    wp.atomic_max(trouble.status, w, NOT_FINITE) == OK
                ):
                    trouble.failed_particle[w] = p
                    trouble.slot[w] = gone
            meet()
            if holding > 0:
                lead_adjoint(
                    w, lane, lanes, holding, grip_row, slot, layout, h, matter, scene, grips, tape,
                    touches, touched, records, held, scene_bars,
                )  # fmt: skip
                meet()
            if touches == 1:
                for s in range(lane, N // matter.section, lanes):
                    if wp.length_sq(touched[w, s]) > real(0.0):
                        members = matter.section
                        change_bar = vec3()
                        for p in range(s * members, (s + 1) * members):
                            change_bar += bar_vector(of, w, V, records.place[w, p])
                        x, u = section_motion(s, slot, mass, matter, tape)
                        by_x, by_u = contact_adjoint(
                            w, x, u, h, matter.contact_radius, scene, change_bar, scene_bars
                        )
                        # u is momentum over mass
                        first = records.place[w, s * members]
                        sums[w, MASS, first] = sums[w, MASS, first] - wp.dot(by_u, u) / mass
                        by_x = by_x / real(members)
                        by_u = by_u / real(members)
                        for p in range(s * members, (s + 1) * members):
                            i = records.place[w, p]
                            put_vector(of, w, X, i, bar_vector(of, w, X, i) + by_x)
                            put_vector(of, w, V, i, bar_vector(of, w, V, i) + by_u)
                meet()
            keep, share = branch(matter.damping[w], h, age)
            keep_sum = wp.float64(0.0)
            share_sum = wp.float64(0.0)
            for i in range(lane, N, lanes):
                p = tape.order[layout, i]
                near = get_near(records.near, w, i)
                D = differences(tape.of, slot, 0, near)
                filtered = mat33()
                Z_bar = mat33()
                inverse_plastic = mat33()
                G_bar = mat33()
                if damped == 1:
                    filtered = symmetric(tape.of, slot, TAPED_Z, i)
                    Z_bar = bar_symmetric(of, w, Z, i)
                if plastic == 1:
                    inverse_plastic = matrix(tape.of, slot, TAPED_G, i)
                    G_bar = bar_matrix(of, w, G, i)
                # a pull draws one neighbour forth and the other back
                pull_bar = -per_mass * bar_differences(of, w, V, near)
                D_bar, mu_bar, lam_bar, yield_bar, keep_bar, share_bar, Z_before, G_before = (
                    pull_adjoint(
                        D, matter.rest_frame[p], matter.mu[w, p], matter.lam[w, p],
                        matter.yield_stress[w], keep, share, filtered, inverse_plastic,
                        h * matter.volume, pull_bar, Z_bar, G_bar,
                    )
                )  # fmt: skip
                wind = vec3()
                if drag > real(0.0):
                    by_air, wind_bar, drag_bar = air_adjoint(
                        D, vector(tape.of, slot, 3, i), spans_of(near, i), matter.sheet, drag, h,
                        per_mass * bar_vector(of, w, V, i),
                    )  # fmt: skip
                    D_bar += by_air
                    wind = wind_bar
                    sums[w, DRAG, i] = sums[w, DRAG, i] + drag_bar
                put_vector(of, w, WIND, i, wind)
                put_matrix(of, w, STRETCHES, i, D_bar)
                sums[w, MU, i] = sums[w, MU, i] + mu_bar
                sums[w, LAM, i] = sums[w, LAM, i] + lam_bar
                if damped == 1 and share > real(0.0):
                    put_symmetric(of, w, Z, i, Z_before)
                    keep_sum += wp.float64(keep_bar)
                    share_sum += wp.float64(share_bar)
                if plastic == 1:
                    put_matrix(of, w, G, i, G_before)
                    sums[w, YIELD, i] = sums[w, YIELD, i] + yield_bar
            if damped == 1 and age > 0:
                wp.atomic_add(scene_bars.branch_factor, w, keep_sum)
                wp.atomic_add(scene_bars.branch_share, w, share_sum)
            meet()
            gravity_sum = vec3()
            for i in range(lane, N, lanes):
                slack = pulled(of, w, STRETCHES, get_near(records.near, w, i), i)
                put_vector(of, w, X, i, bar_vector(of, w, X, i) - slack)
                v_bar = bar_vector(of, w, V, i)
                gravity_sum += h * v_bar
                speed = vector(tape.of, slot, 3, i) + h * gravity
                sums[w, MASS, i] = sums[w, MASS, i] + per_mass * wp.dot(v_bar, speed)
                v_bar += bar_vector(of, w, WIND, i)
                put_vector(of, w, V, i, v_bar)
            wp.atomic_add(
                scene_bars.gravity, w,
                wp.vec3d(
                    wp.float64(gravity_sum[0]), wp.float64(gravity_sum[1]),
                    wp.float64(gravity_sum[2]),
                ),
            )  # fmt: skip
            meet()
            grasped = int(0)
            for g in range(grippers):
                if grips.until[w, g] == age or grips.since[w, g] == age:
                    grasped = 1
            if any_of(grasped) == 1:
                if lane == 0:
                    t = began + wp.float64(gone) * dt
                    grasp_adjoint(
                        w, t, age, slot, matter, scene, paths, grips, tape, records, scene_bars
                    )
                holding = list_held(w, lane, lanes, tape.order, layout, matter, grips, held)
            gone -= 1
        close_poses(w, lane, lanes, posed, count, began, dt, paths, grips, scene_bars)
        if lane == 0:
            close_rates(w, dt, int(1), matter, scene, scene_bars)
        for i in range(lane, N, lanes):
            p = tape.order[layout, i]
            bars.x[w, p] = bar_vector(of, w, X, i)
            bars.v[w, p] = bar_vector(of, w, V, i)
            bars.C[w, p] = bar_matrix(of, w, C, i)
            if damped == 1:
                for c in range(6):
                    bars.Z[w, c, p] = get(of, w, Z + c, i)
            if plastic == 1:
                bars.G[w, p] = bar_matrix(of, w, G, i)
            bars.mu[w, p] = bars.mu[w, p] + sums[w, MU, i]
            bars.lam[w, p] = bars.lam[w, p] + sums[w, LAM, i]
            bars.mass[w, p] = bars.mass[w, p] + sums[w, MASS, i]
            bars.yield_stress[w, p] = bars.yield_stress[w, p] + sums[w, YIELD, i]
            bars.drag[w, p] = bars.drag[w, p] + sums[w, DRAG, i]

    return SimpleNamespace(BarRecords=BarRecords, reverse=reverse)
