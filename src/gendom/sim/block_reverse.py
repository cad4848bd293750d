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

from gendom.sim.block import make_block
from gendom.sim.block_kernels import make_block_kernels
from gendom.sim.columns import Columns
from gendom.sim.kernels import OK, RECOVER_EVERY, make_kernels
from gendom.sim.reverse import NOT_FINITE, make_reverse

BAR_COMPONENTS = 28
"""Derivatives by x, v, C, F, mu, lam, mass and yield stress of a particle."""

_V, _C, _F, _MU, _LAM, _MASS, _YIELD = 3, 6, 15, 24, 25, 26, 27


@functools.cache
def make_block_reverse(real: Any, law_name: str, *, plastic: bool) -> SimpleNamespace:
    """Build the kernel for one scalar type and one material, see ``make_kernels``.

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
    vector, put_vector = records.vector, records.put_vector
    matrix, put_matrix = records.matrix, records.put_matrix
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
    recovery_share = k.transfers.recovery_share
    yields = k.transfers.yields
    smallest_volume = k.transfers.smallest_volume
    largest_bar = one_thread.largest
    meet = make_block(real).meet

    @wp.struct
    class BarRecords:
        """Derivatives by W worlds' particles in order, on either of two sides."""

        of: wp.array3d(dtype=real)  # [W, 2 * BAR_COMPONENTS, N]

    @wp.kernel(enable_backward=False, module="unique")
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
        states: wp.array3d(dtype=real),  # [(S + 1) * W, STATE_COMPONENTS, N] records
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
        of = records.of
        W = clock.dt.shape[0]
        N = bars.x.shape[1]
        z0 = scene.z0
        inv_dx = real(1.0) / scene.dx
        dt = clock.dt[w]
        h = real(dt)
        keep = wp.exp(-scene.damping[w] * h)
        blend = recovery_share(h, RECOVER_EVERY, matter)
        mass = matter.mass[w]
        side = int(0)
        slot = int((slots - 1) * W + w)
        layout = tape.layout_of[slot]
        for i in range(lane, N, lanes):
            p = tape.order[layout, i]
            put_vector(w, 0, i, bars.x[w, p], of)
            put_vector(w, _V, i, bars.v[w, p], of)
            put_matrix(w, _C, i, bars.C[w, p], of)
            put_matrix(w, _F, i, bars.F[w, p], of)
            for c in range(_MU, BAR_COMPONENTS):
                of[w, c, i] = real(0.0)
        meet()
        while slot >= 0:
            if tape.layout_of[slot] != layout:
                earlier = tape.layout_of[slot]
                for i in range(lane, N, lanes):
                    j = tape.place[layout, tape.order[earlier, i]]
                    for c in range(BAR_COMPONENTS):
                        of[w, (1 - side) * BAR_COMPONENTS + c, i] = of[
                            w, side * BAR_COMPONENTS + c, j
                        ]
                side = 1 - side
                layout = earlier
                meet()
            base = side * BAR_COMPONENTS
            nodes = columns.count[layout]
            step = clock.step[w] + (slot - w) // W
            t = time + wp.float64(step) * dt
            for g in range(lane, grips.closed.shape[1], lanes):
                place_gripper(w, w, g, t, dt, paths, grips)
            meet()
            for n in range(lane, nodes, lanes):
                grid_bar[w, n] = vec4()
                velocity[w, n] = vec4()
                q = momentum[slot, n]
                if q[3] > real(0.0):
                    u = update_node(w, w, layout, n, q, h, keep, scene, paths, grips, columns)
                    velocity[w, n] = vec4(u[0], u[1], u[2], q[3])
            meet()
            if yields == 1:
                for i in range(lane, N, lanes):
                    F_bar, mu_bar, yield_bar = before_yielding(
                        vector(slot, 0, i, states), matrix(slot, _F, i, states),
                        matter.mu[w, tape.order[layout, i]], matter.yield_stress[w],
                        matrix(w, base + _F, i, of), layout, w, h, inv_dx, z0, columns, velocity,
                    )  # fmt: skip
                    put_matrix(w, base + _F, i, F_bar, of)
                    of[w, base + _MU, i] = of[w, base + _MU, i] + mu_bar
                    of[w, base + _YIELD, i] = of[w, base + _YIELD, i] + yield_bar
                meet()
            window = window_type()
            held = wp.vec3i(-1, -1, -1)
            for i in range(lane * N // lanes, (lane + 1) * N // lanes):
                node, f, pull = taken_by(
                    vector(slot, 0, i, states), matrix(slot, _F, i, states),
                    vector(w, base, i, of), vector(w, base + _V, i, of),
                    matrix(w, base + _C, i, of), matrix(w, base + _F, i, of),
                    layout, h, inv_dx, z0, columns,
                )  # fmt: skip
                window = hand_over(window, held, node, grid_bar, w, columns.start, layout)
                window = collect(window, f, pull)
                held = node
            hand_over(window, held, wp.vec3i(-1, -1, -1), grid_bar, w, columns.start, layout)
            meet()
            for i in range(lane, N, lanes):
                x_bar, F_bar = moved_back(
                    vector(slot, 0, i, states), matrix(slot, _F, i, states),
                    vector(w, base, i, of), vector(w, base + _V, i, of),
                    matrix(w, base + _C, i, of), matrix(w, base + _F, i, of),
                    layout, w, h, inv_dx, z0, columns, velocity,
                )  # fmt: skip
                put_vector(w, base, i, x_bar, of)
                put_matrix(w, base + _F, i, F_bar, of)
            keep_sum = wp.float64(0.0)
            gravity_sum = wp.vec3d()
            for n in range(lane, nodes, lanes):
                q = momentum[slot, n]
                if q[3] > real(0.0):
                    v_bar = grid_bar[w, n]
                    node_bar, keep_bar, gravity_bar = update_node_back(
                        w, w, layout, n, q, vec3(v_bar[0], v_bar[1], v_bar[2]), h, keep, scene,
                        paths, grips, columns, scene_bars,
                    )  # fmt: skip
                    grid_bar[w, n] = node_bar
                    keep_sum += keep_bar
                    gravity_sum += gravity_bar
            wp.atomic_add(scene_bars.keep, w, keep_sum)
            wp.atomic_add(scene_bars.gravity, w, gravity_sum)
            meet()
            if lane == 0:
                close_substep(w, w, t, dt, scene, paths, grips, scene_bars)
            for i in range(lane, N, lanes):
                p = tape.order[layout, i]
                x_bar, u_bar, C_bar, F_bar, mu_bar, lam_bar, mass_bar = given_back(
                    vector(slot, 0, i, states), vector(slot, _V, i, states),
                    matrix(slot, _C, i, states), matrix(slot, _F, i, states),
                    matter.mu[w, p], matter.lam[w, p], mass, matter.volume, layout, w, h, inv_dx,
                    z0, columns, grid_bar,
                )  # fmt: skip
                put_vector(w, base, i, vector(w, base, i, of) + x_bar, of)
                put_vector(w, base + _V, i, u_bar, of)
                put_matrix(w, base + _C, i, C_bar, of)
                put_matrix(w, base + _F, i, matrix(w, base + _F, i, of) + F_bar, of)
                of[w, base + _MU, i] = of[w, base + _MU, i] + mu_bar
                of[w, base + _LAM, i] = of[w, base + _LAM, i] + lam_bar
                of[w, base + _MASS, i] = of[w, base + _MASS, i] + mass_bar
                size = wp.length_sq(x_bar) + wp.length_sq(u_bar) + wp.ddot(F_bar, F_bar)
                # the first one found is named; a NaN is not below anything
                overflows = not (size < real(largest_bar))
                if overflows and wp.atomic_max(trouble.status, w, NOT_FINITE) == OK:
                    trouble.culprit[w] = p
                    trouble.slot[w] = (slot - w) // W
            if (clock.age[w] + (slot - w) // W) % RECOVER_EVERY == 0 and blend > real(0.0):
                meet()
                for i in range(lane, N, lanes):
                    p = tape.order[layout, i]
                    D = mat33()
                    for axis in range(3):
                        a = tape.place[layout, matter.lattice[p, axis, 1]]
                        b = tape.place[layout, matter.lattice[p, axis, 0]]
                        d = vector(slot, 0, a, states) - vector(slot, 0, b, states)
                        for n in range(3):
                            D[n, axis] = d[n]
                    if wp.determinant(D * matter.rest_frame[p]) > real(smallest_volume):
                        F_bar = matrix(w, base + _F, i, of)
                        D_bar = (blend * F_bar) * wp.transpose(matter.rest_frame[p])
                        for axis in range(3):
                            a = tape.place[layout, matter.lattice[p, axis, 1]]
                            b = tape.place[layout, matter.lattice[p, axis, 0]]
                            for n in range(3):
                                wp.atomic_add(of, w, base + n, a, D_bar[n, axis])
                                wp.atomic_sub(of, w, base + n, b, D_bar[n, axis])
                        put_matrix(w, base + _F, i, (real(1.0) - blend) * F_bar, of)
            meet()
            slot -= W
        base = side * BAR_COMPONENTS
        for i in range(lane, N, lanes):
            p = tape.order[layout, i]
            bars.x[w, p] = vector(w, base, i, of)
            bars.v[w, p] = vector(w, base + _V, i, of)
            bars.C[w, p] = matrix(w, base + _C, i, of)
            bars.F[w, p] = matrix(w, base + _F, i, of)
            bars.mu[w, p] = bars.mu[w, p] + of[w, base + _MU, i]
            bars.lam[w, p] = bars.lam[w, p] + of[w, base + _LAM, i]
            bars.mass[w, p] = bars.mass[w, p] + of[w, base + _MASS, i]
            bars.yield_stress[w, p] = bars.yield_stress[w, p] + of[w, base + _YIELD, i]

    return SimpleNamespace(BarRecords=BarRecords, reverse=reverse)
