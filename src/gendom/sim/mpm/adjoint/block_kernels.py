"""The substep backwards on CUDA where bodies are small: a block of threads for each world.

The transpose of ``runners.block_kernels``: derivatives by the particles' state stand in records, in
the order of the layout of the substep that is reversed.

Shapes: W worlds, N particles, S recorded substeps, M nodes.
"""

import functools

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
from gendom.sim.mpm.block import bounds, get_near, make_block, make_store, put_near, spans_of
from gendom.sim.mpm.boundary import make_boundary
from gendom.sim.mpm.elasticity import make_elasticity, make_maxwell_branch
from gendom.sim.mpm.grid import SparseGrid
from gendom.sim.mpm.native import MODULE_OPTIONS
from gendom.sim.mpm.poses import AHEAD, make_poses
from gendom.sim.mpm.runners.held import make_held
from gendom.sim.mpm.runners.records import C, V, Variant, X, make_record_access
from gendom.sim.mpm.step import NOT_FINITE, OK, make_closing
from gendom.sim.mpm.transfer import make_bspline, make_transfer
from gendom.sim.mpm.types import Namespace, make_types


@functools.cache
def make_block_reverse(variant: Variant) -> Namespace:
    """Build the kernel of a variant.

    Returns:
        Namespace with ``BarRecords`` and ``reverse``.
    """
    real = variant.real
    types = make_types(real)
    Nodes, Vectors = types.Nodes, types.Vectors
    vec3, vec4, mat33 = types.vec3, types.vec4, types.mat33
    Clock, Matter, MatterBars = types.Clock, types.Matter, types.MatterBars
    Scene, Paths, Grips, SceneBars = types.Scene, types.Paths, types.Grips, types.SceneBars
    elasticity = make_elasticity(real, variant.law, yields=variant.yields, damped=variant.damped)
    branch = make_maxwell_branch(real).branch
    bspline, transfer = make_bspline(real), make_transfer(real)
    window_type, hand_over = bspline.window, bspline.hand_over
    recorded = make_recorded(real)
    bar_records = make_bar_records(real, resident=variant.room > 0)
    Tape, BarRecords = recorded.Struct, bar_records.Struct
    boundary = make_boundary_adjoint(real, recorded, bar_records)
    held_adjoint = make_held_adjoint(real, resident=variant.room > 0)
    contact = make_boundary(real, recorded).contact
    of_held = make_held(real)
    Held = of_held.Held
    poses = make_poses(real)
    close_rates = make_closing(real).close_rates
    kept = make_store(real, resident=False)
    bar = make_store(real, resident=variant.room > 0)
    access = make_record_access(variant)
    block = make_block(real)
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
            put_near(records.near, w, i, p, matter.lattice, tape.place, layout)

    @wp.func
    def section_motion(s: int, row: int, mass: real, matter: Matter, tape: Tape):
        """As that of ``step``, from the tape."""
        size = matter.section
        layout = tape.layout_of[row]
        x = vec3()
        q = vec3()
        for p in range(s * size, (s + 1) * size):
            i = tape.place[layout, p]
            x += kept.vector(tape.of, row, 0, i)
            q += kept.vector(tape.of, row, 15, i)
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
        momentum: Nodes,  # [S * W, M] and mass
        tape: Tape,
        # scratch
        velocity: Nodes,  # [W, M]
        nodes_bar: Nodes,  # [W, M]
        touched: Vectors,  # [W, sections]
        records: BarRecords,
        held: Held,
        # by the state: after the tape on entry, before it on return
        bars: MatterBars,
        scene_bars: SceneBars,
        trouble: Trouble,
    ):
        turn, lane = wp.tid()
        w = order[turn]
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
            access.load(of, w, i, p, bars)
            for c in range(SUMS):
                sums[w, c, i] = real(0.0)
        find_neighbours(w, lane, lanes, layout, matter, tape, records)
        holding = int(of_held.list_held(w, lane, lanes, tape.order, layout, matter, grips, held))
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
                        spare[w, c, i] = bar.get(of, w, c, j)
                    for c in range(SUMS):
                        spare[w, COMPONENTS + c, i] = sums[w, c, j]
                layout = earlier
                block.meet()
                for i in range(lane, N, lanes):
                    for c in range(COMPONENTS):
                        bar.put(of, w, c, i, spare[w, c, i])
                    for c in range(SUMS):
                        sums[w, c, i] = spare[w, COMPONENTS + c, i]
                find_neighbours(w, lane, lanes, layout, matter, tape, records)
                holding = of_held.list_held(w, lane, lanes, tape.order, layout, matter, grips, held)
            nodes = grid.count[layout]
            age = clock.age[w] + gone
            if grippers > 0 and gone < posed:
                # poses of many substeps at once
                poses.close_poses(w, lane, lanes, posed, count, began, dt, paths, grips, scene_bars)
                block.meet()
                posed = wp.max(0, gone - AHEAD + 1)
                count = gone + 1 - posed
                poses.pose_ahead(w, lane, lanes, posed, count, began, dt, paths, grips)
                block.meet()
            grip_row = w * AHEAD + gone - posed
            for n in range(lane, holding, lanes):
                if held.share[w, n] > real(0.0):
                    x = kept.vector(tape.of, slot, 0, held.record[w, n])
                    of_held.lead(w, n, x, grip_row, h, matter, scene, grips, held)
            if touches == 1:
                for s in range(lane, N // matter.section, lanes):
                    x, u = section_motion(s, slot, mass, matter, tape)
                    touched[w, s] = contact(w, x, u, h, matter.contact_radius, scene)
            block.meet()
            following = vec4()
            if lane < nodes:
                following = bspline.get_node(momentum, slot, lane)
            for n in range(lane, nodes, lanes):
                q = following
                # on its way while this one is updated
                if n + lanes < nodes:
                    following = bspline.get_node(momentum, slot, n + lanes)
                bspline.put_node(nodes_bar, w, n, vec4())
                bspline.put_node(velocity, w, n, transfer.node_velocity(q, factor))
            block.meet()
            window = window_type()
            window_at = wp.vec3i(-1, -1, -1)
            for i in range(begin, end):
                if held.free[w, i] == real(0.0):
                    continue
                x_bar = bar.vector(of, w, X, i)
                node, f, taken = transfer.taken_by(
                    kept.vector(tape.of, slot, 0, i), bar.vector(of, w, V, i) + h * x_bar,
                    bar.matrix(of, w, C, i), layout, inv_dx, grid,
                )  # fmt: skip
                window = hand_over(window, window_at, node, nodes_bar, w, grid.start, layout)
                window = bspline.collect(window, f, taken)
                window_at = node
            hand_over(window, window_at, wp.vec3i(-1, -1, -1), nodes_bar, w, grid.start, layout)
            block.meet()
            for i in range(lane, N, lanes):
                if held.free[w, i] == real(0.0):
                    continue
                x_bar = bar.vector(of, w, X, i)
                x_bar += transfer.g2p_adjoint(
                    kept.vector(tape.of, slot, 0, i), bar.vector(of, w, V, i) + h * x_bar,
                    bar.matrix(of, w, C, i), layout, w, inv_dx, grid, velocity,
                )  # fmt: skip
                bar.put_vector(of, w, X, i, x_bar)
            if holding > 0:
                held_adjoint.carry_adjoint(
                    w, lane, lanes, holding, grip_row, h, grips, records, held, scene_bars
                )
            factor_sum = wp.float64(0.0)
            for n in range(lane, nodes, lanes):
                node_bar, factor_bar = transfer.node_velocity_adjoint(
                    bspline.get_node(momentum, slot, n), bspline.get_node(nodes_bar, w, n), factor
                )
                bspline.put_node(nodes_bar, w, n, node_bar)
                factor_sum += wp.float64(factor_bar)
            if factor < real(1.0):
                wp.atomic_add(scene_bars.damping_factor, w, factor_sum)
            block.meet()
            for i in range(lane, N, lanes):
                p = tape.order[layout, i]
                free = held.free[w, i]
                x_bar = vec3()
                q_bar = vec3()
                C_bar = mat33()
                mass_bar = real(0.0)
                u_bar = vec3()
                if free > real(0.0):
                    x = kept.vector(tape.of, slot, 0, i)
                    own = per_mass * kept.vector(tape.of, slot, 15, i)
                    u = own
                    if touches == 1:
                        u += touched[w, p // matter.section]
                    v = u
                    if free < real(1.0):
                        v += (real(1.0) - free) * (held.led[w, i] - u)
                    x_bar, q_bar, C_bar, mass_bar = transfer.p2g_adjoint(
                        x, mass * v, kept.matrix(tape.of, slot, 6, i), mass, layout, w, inv_dx,
                        grid, nodes_bar,
                    )  # fmt: skip
                    u_bar = mass * q_bar
                    mass_bar += wp.dot(q_bar, v)
                    u_bar = free * u_bar
                    # its own velocity is momentum over mass
                    mass_bar -= per_mass * wp.dot(u_bar, own)
                bar.put_vector(of, w, X, i, bar.vector(of, w, X, i) + x_bar)
                bar.put_vector(of, w, V, i, u_bar)
                bar.put_matrix(of, w, C, i, C_bar)
                sums[w, MASS, i] = sums[w, MASS, i] + mass_bar
                # the first one found is named; a NaN is not below anything
                size = wp.length_sq(x_bar) + wp.length_sq(u_bar)
                if not (size < real(largest)) and (
                    wp.atomic_max(trouble.status, w, NOT_FINITE) == OK
                ):
                    trouble.failed_particle[w] = p
                    trouble.slot[w] = gone
            block.meet()
            if holding > 0:
                held_adjoint.lead_adjoint(
                    w, lane, lanes, holding, grip_row, slot, layout, h, matter, scene, grips, tape,
                    touches, touched, records, held, scene_bars,
                )  # fmt: skip
                block.meet()
            if touches == 1:
                for s in range(lane, N // matter.section, lanes):
                    if wp.length_sq(touched[w, s]) > real(0.0):
                        members = matter.section
                        change_bar = vec3()
                        for p in range(s * members, (s + 1) * members):
                            change_bar += bar.vector(of, w, V, records.place[w, p])
                        x, u = section_motion(s, slot, mass, matter, tape)
                        by_x, by_u = boundary.contact_adjoint(
                            w, x, u, h, matter.contact_radius, scene, change_bar, scene_bars
                        )
                        # u is momentum over mass
                        first = records.place[w, s * members]
                        sums[w, MASS, first] = sums[w, MASS, first] - wp.dot(by_u, u) / mass
                        by_x = by_x / real(members)
                        by_u = by_u / real(members)
                        for p in range(s * members, (s + 1) * members):
                            i = records.place[w, p]
                            bar.put_vector(of, w, X, i, bar.vector(of, w, X, i) + by_x)
                            bar.put_vector(of, w, V, i, bar.vector(of, w, V, i) + by_u)
                block.meet()
            keep, share = branch(matter.damping[w], h, age)
            keep_sum = wp.float64(0.0)
            share_sum = wp.float64(0.0)
            for i in range(lane, N, lanes):
                p = tape.order[layout, i]
                near = get_near(records.near, w, i)
                D = kept.differences(tape.of, slot, 0, near)
                filtered = mat33()
                Z_bar = mat33()
                inverse_plastic = mat33()
                G_bar = mat33()
                if damped == 1:
                    filtered = kept.symmetric(tape.of, slot, TAPED_Z, i)
                    Z_bar = bar.symmetric(of, w, Z, i)
                if plastic == 1:
                    inverse_plastic = kept.matrix(tape.of, slot, TAPED_G, i)
                    G_bar = bar.matrix(of, w, G, i)
                # a pull draws one neighbour forth and the other back
                pull_bar = -per_mass * bar.differences(of, w, V, near)
                D_bar, mu_bar, lam_bar, yield_bar, keep_bar, share_bar, Z_before, G_before = (
                    elasticity.pull_adjoint(
                        D, matter.rest_frame[p], matter.mu[w, p], matter.lam[w, p],
                        matter.yield_stress[w], keep, share, filtered, inverse_plastic,
                        h * matter.volume, pull_bar, Z_bar, G_bar,
                    )
                )  # fmt: skip
                wind = vec3()
                if drag > real(0.0):
                    by_air, wind_bar, drag_bar = elasticity.air_adjoint(
                        D, kept.vector(tape.of, slot, 3, i), spans_of(near, i), matter.sheet, drag,
                        h, per_mass * bar.vector(of, w, V, i),
                    )  # fmt: skip
                    D_bar += by_air
                    wind = wind_bar
                    sums[w, DRAG, i] = sums[w, DRAG, i] + drag_bar
                bar.put_vector(of, w, WIND, i, wind)
                bar.put_matrix(of, w, STRETCHES, i, D_bar)
                sums[w, MU, i] = sums[w, MU, i] + mu_bar
                sums[w, LAM, i] = sums[w, LAM, i] + lam_bar
                if damped == 1 and share > real(0.0):
                    bar.put_symmetric(of, w, Z, i, Z_before)
                    keep_sum += wp.float64(keep_bar)
                    share_sum += wp.float64(share_bar)
                if plastic == 1:
                    bar.put_matrix(of, w, G, i, G_before)
                    sums[w, YIELD, i] = sums[w, YIELD, i] + yield_bar
            if damped == 1 and age > 0:
                wp.atomic_add(scene_bars.branch_factor, w, keep_sum)
                wp.atomic_add(scene_bars.branch_share, w, share_sum)
            block.meet()
            gravity_sum = vec3()
            for i in range(lane, N, lanes):
                slack = bar.pulled(of, w, STRETCHES, get_near(records.near, w, i), i)
                bar.put_vector(of, w, X, i, bar.vector(of, w, X, i) - slack)
                v_bar = bar.vector(of, w, V, i)
                gravity_sum += h * v_bar
                speed = kept.vector(tape.of, slot, 3, i) + h * gravity
                sums[w, MASS, i] = sums[w, MASS, i] + per_mass * wp.dot(v_bar, speed)
                v_bar += bar.vector(of, w, WIND, i)
                bar.put_vector(of, w, V, i, v_bar)
            wp.atomic_add(scene_bars.gravity, w, boundary.wide(gravity_sum))
            block.meet()
            grasped = int(0)
            for g in range(grippers):
                if grips.until[w, g] == age or grips.since[w, g] == age:
                    grasped = 1
            if block.any(grasped) == 1:
                if lane == 0:
                    t = began + wp.float64(gone) * dt
                    boundary.grasp_adjoint(
                        w, t, age, slot, matter, scene, paths, grips, tape, records, scene_bars
                    )
                holding = of_held.list_held(w, lane, lanes, tape.order, layout, matter, grips, held)
            gone -= 1
        poses.close_poses(w, lane, lanes, posed, count, began, dt, paths, grips, scene_bars)
        if lane == 0:
            close_rates(w, dt, int(1), matter, scene, scene_bars)
        for i in range(lane, N, lanes):
            p = tape.order[layout, i]
            access.unload(of, w, i, p, bars)
            bars.mu[w, p] = bars.mu[w, p] + sums[w, MU, i]
            bars.lam[w, p] = bars.lam[w, p] + sums[w, LAM, i]
            bars.mass[w, p] = bars.mass[w, p] + sums[w, MASS, i]
            bars.yield_stress[w, p] = bars.yield_stress[w, p] + sums[w, YIELD, i]
            bars.drag[w, p] = bars.drag[w, p] + sums[w, DRAG, i]

    return Namespace(reverse, BarRecords=BarRecords)
