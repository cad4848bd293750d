"""The substep backwards: derivatives of a loss carried from a later state to an earlier one.

The CPU kernel walks through one recorded stretch of one world from its last substep to its
first; on CUDA each stage of a substep is a kernel over all worlds. Each substep's grid is kept by
the recording, so only the grid's velocities are made again; the transposes are those of
``transfers``, ``boundary`` and ``materials.laws``.

A name with ``_bar`` is the derivative of the loss by that quantity. Shapes: W worlds, N
particles, G grippers, K path knots, S recorded substeps, X x Y grid columns, M nodes.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.materials.laws import make_law
from gendom.sim.boundary import make_boundary
from gendom.sim.columns import CELL_BITS, CELL_MASK
from gendom.sim.kernels import OK, RECOVER_EVERY
from gendom.sim.stencil import FUSED
from gendom.sim.transfers import make_transfers

NOT_FINITE = 4
"""Status of a world whose derivatives overflowed."""


@functools.cache
def make_reverse(real: Any, law_name: str, *, plastic: bool) -> Any:
    """Build the CPU kernel that reverses a recorded stretch of one world.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        law_name: Elastic law, see ``gendom.materials.laws``.
        plastic: Whether particles yield.
    """
    law = make_law(law_name, real, plastic=plastic)
    return_map_back = law.return_map_back
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)
    mat33 = wp.types.matrix((3, 3), real)
    boundary = make_boundary(real)
    place_gripper = boundary.place_gripper
    place_gripper_back = boundary.place_gripper_back
    update_node = boundary.update_node
    update_node_back = boundary.update_node_back
    transfers = make_transfers(real, law.stress, law.stress_back)
    scatter_particle_back = transfers.scatter_particle_back
    gather_particle = transfers.gather_particle
    gather_particle_back = transfers.gather_particle_back
    recovered_gradient_back = transfers.recovered_gradient_back
    yields = wp.constant(1 if plastic else 0)
    mask = CELL_MASK
    recovery_span = float(RECOVER_EVERY)
    largest = 1.0e37 if real == wp.float32 else 1.0e300

    @wp.kernel(enable_backward=False, module="unique", module_options=FUSED)
    def reverse(
        w: int,
        slots: int,  # substeps to reverse
        begun: int,  # number in its frame of the first recorded substep
        age: int,  # substeps done in all before it
        time: wp.float64,  # [s] at substep 0 of the frame
        dt: wp.float64,  # [s]
        # material
        mu: wp.array2d(dtype=real),  # [W, N] [Pa]
        lam: wp.array2d(dtype=real),  # [W, N] [Pa]
        yield_stress: wp.array(dtype=real),  # [W] [Pa]
        mass: wp.array(dtype=real),  # [W] [kg]
        volume: real,
        lattice: wp.array3d(dtype=wp.int32),
        rest_frame: wp.array(dtype=mat33),
        recovery: real,
        # scene
        dx: real,
        z0: real,
        gravity: wp.array(dtype=vec3),
        damping: wp.array(dtype=real),
        table: int,
        friction: wp.array(dtype=real),
        walls: int,
        box_lower: vec3,
        box_upper: vec3,
        # grippers
        path_time: wp.array3d(dtype=wp.float64),
        path_position: wp.array3d(dtype=wp.vec3d),
        path_spin: wp.array3d(dtype=wp.vec3d),
        hold_from: wp.array2d(dtype=wp.float64),
        hold_until: wp.array2d(dtype=wp.float64),
        grip_radius: wp.array2d(dtype=real),
        grip_centre: wp.array2d(dtype=vec3),
        grip_velocity: wp.array2d(dtype=vec3),
        grip_spin: wp.array2d(dtype=vec3),
        grip_closed: wp.array2d(dtype=wp.int32),
        # the recording
        x: wp.array2d(dtype=vec3),  # [S + 1, N]
        v: wp.array2d(dtype=vec3),
        C: wp.array2d(dtype=mat33),
        F: wp.array2d(dtype=mat33),
        bounds: wp.array2d(dtype=wp.int32),  # [S, 4]
        start: wp.array3d(dtype=wp.int32),  # [S, X, Y]
        cell: wp.array2d(dtype=wp.int32),  # [S, M]
        level: wp.array2d(dtype=wp.int32),  # [S, M]
        count: wp.array(dtype=wp.int32),  # [S]
        layout_of: wp.array(dtype=wp.int32),  # [S]
        momentum: wp.array2d(dtype=vec4),  # [S, M]
        # scratch
        velocity: wp.array2d(dtype=vec4),  # [1, M]
        grid_bar: wp.array2d(dtype=vec4),  # [1, M]
        grip_centre_bar: wp.array2d(dtype=wp.vec3d),  # [W, G]
        grip_velocity_bar: wp.array2d(dtype=wp.vec3d),  # [W, G]
        keep_bar: wp.array(dtype=wp.float64),  # [W]
        # derivatives by the state: of the last row on entry, of the first on return
        x_bar: wp.array2d(dtype=vec3),  # [W, N]
        v_bar: wp.array2d(dtype=vec3),
        C_bar: wp.array2d(dtype=mat33),
        F_bar: wp.array2d(dtype=mat33),
        # derivatives by parameters, summed up
        mu_bar: wp.array2d(dtype=real),  # [W, N]
        lam_bar: wp.array2d(dtype=real),  # [W, N]
        mass_bar: wp.array2d(dtype=real),  # [W, N]
        yield_bar: wp.array2d(dtype=real),  # [W, N]
        friction_bar: wp.array(dtype=wp.float64),  # [W]
        damping_bar: wp.array(dtype=wp.float64),  # [W]
        gravity_bar: wp.array(dtype=wp.vec3d),  # [W]
        path_bar: wp.array3d(dtype=wp.vec3d),  # [W, G, K]
        # what happened
        status_out: wp.array(dtype=wp.int32),  # [W]
        slot_out: wp.array(dtype=wp.int32),  # [W] substep of the trouble
        culprit_out: wp.array(dtype=wp.int32),  # [W] particle
    ):
        N = x.shape[1]
        inv_dx = real(1.0) / dx
        h = real(dt)
        keep = wp.exp(-damping[w] * h)
        blend = real(1.0) - wp.exp(-recovery * h * real(recovery_span))
        keep_bar[w] = wp.float64(0.0)
        status = int(OK)
        slot = int(slots - 1)
        while slot >= 0 and status == OK:
            layout = layout_of[slot]
            nodes = count[layout]
            t = time + wp.float64(begun + slot) * dt
            for g in range(grip_closed.shape[1]):
                place_gripper(
                    w, w, g, t, dt, path_time, path_position, path_spin,
                    hold_from, hold_until, grip_centre, grip_velocity, grip_spin, grip_closed,
                )  # fmt: skip
                grip_centre_bar[w, g] = wp.vec3d()
                grip_velocity_bar[w, g] = wp.vec3d()
            for n in range(nodes):
                grid_bar[0, n] = vec4()
                velocity[0, n] = vec4()
                q = momentum[slot, n]
                if q[3] > real(0.0):
                    u = update_node(
                        w, w, q, bounds[layout, 0] + (cell[layout, n] >> CELL_BITS),
                        bounds[layout, 1] + (cell[layout, n] & mask), level[layout, n], h, dx, z0,
                        gravity[w], keep, table, friction[w], walls, box_lower, box_upper,
                        grip_centre, grip_velocity, grip_spin, grip_closed, grip_radius,
                    )  # fmt: skip
                    velocity[0, n] = vec4(u[0], u[1], u[2], q[3])
            for p in range(N):
                xp = x[slot, p]
                Fp = F[slot, p]
                moved_bar = x_bar[w, p]
                trial_bar = F_bar[w, p]
                if yields == 1:
                    _v, _C, D = gather_particle(xp, inv_dx, z0, layout, bounds, start, 0, velocity)
                    trial_bar, mu_part, yield_part = return_map_back(
                        Fp + h * (D * Fp), mu[w, p], yield_stress[w], trial_bar
                    )
                    mu_bar[w, p] = mu_bar[w, p] + mu_part
                    yield_bar[w, p] = yield_bar[w, p] + yield_part
                x_part, gradient = gather_particle_back(
                    xp, v_bar[w, p] + h * moved_bar, C_bar[w, p],
                    h * (trial_bar * wp.transpose(Fp)), inv_dx, z0, layout, bounds, start,
                    0, velocity, grid_bar,
                )  # fmt: skip
                x_bar[w, p] = moved_bar + x_part
                F_bar[w, p] = trial_bar + h * (wp.transpose(gradient) * trial_bar)
            for n in range(nodes):
                q = momentum[slot, n]
                if q[3] > real(0.0):
                    b = grid_bar[0, n]
                    grid_bar[0, n] = update_node_back(
                        w, w, q, vec3(b[0], b[1], b[2]),
                        bounds[layout, 0] + (cell[layout, n] >> CELL_BITS),
                        bounds[layout, 1] + (cell[layout, n] & mask), level[layout, n], h, dx, z0,
                        gravity[w], keep, table, friction[w], walls, box_lower, box_upper,
                        grip_centre, grip_spin, grip_closed, grip_radius,
                        grip_centre_bar, grip_velocity_bar, friction_bar, keep_bar, gravity_bar,
                    )  # fmt: skip
            for g in range(grip_closed.shape[1]):
                if grip_closed[w, g] == 1:
                    place_gripper_back(
                        w, g, t, dt, path_time, grip_centre_bar[w, g], grip_velocity_bar[w, g],
                        path_bar,
                    )  # fmt: skip
            for p in range(N):
                x_part, vb, Cb, F_part, mu_part, lam_part, mass_part = scatter_particle_back(
                    x[slot, p], v[slot, p], C[slot, p], F[slot, p], mu[w, p], lam[w, p], mass[w],
                    volume, h, inv_dx, z0, layout, bounds, start, 0, grid_bar,
                )  # fmt: skip
                x_bar[w, p] = x_bar[w, p] + x_part
                v_bar[w, p] = vb
                C_bar[w, p] = Cb
                F_bar[w, p] = F_bar[w, p] + F_part
                mu_bar[w, p] = mu_bar[w, p] + mu_part
                lam_bar[w, p] = lam_bar[w, p] + lam_part
                mass_bar[w, p] = mass_bar[w, p] + mass_part
                size = wp.length_sq(x_part) + wp.length_sq(vb) + wp.ddot(F_part, F_part)
                if not (size < real(largest)) and status == OK:
                    status = NOT_FINITE
                    culprit_out[w] = p
                    slot_out[w] = slot
            if (age + slot) % RECOVER_EVERY == 0 and blend > real(0.0):
                for p in range(N):
                    F_bar[w, p] = recovered_gradient_back(
                        w, p, F_bar[w, p], blend, slot, x, lattice, rest_frame, x_bar
                    )
            slot -= 1
        damping_bar[w] = damping_bar[w] - wp.float64(h * keep) * keep_bar[w]
        status_out[w] = status

    return reverse


@functools.cache
def make_reverse_stages(real: Any, law_name: str, *, plastic: bool) -> SimpleNamespace:
    """Build the CUDA kernels that reverse one recorded substep of all worlds.

    Substep r of a graph is reversed in the worlds that have done it (``r < done[w]``).

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        law_name: Elastic law, see ``gendom.materials.laws``.
        plastic: Whether particles yield.

    Returns:
        Namespace with ``grid_again``, ``gather_back``, ``grid_back``, ``scatter_back``,
        ``world_back``, ``recover_back``, to be called in this order.
    """
    law = make_law(law_name, real, plastic=plastic)
    return_map_back = law.return_map_back
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)
    mat33 = wp.types.matrix((3, 3), real)
    boundary = make_boundary(real)
    place_gripper_back = boundary.place_gripper_back
    update_node = boundary.update_node
    update_node_back = boundary.update_node_back
    transfers = make_transfers(real, law.stress, law.stress_back)
    scatter_particle_back = transfers.scatter_particle_back
    gather_particle = transfers.gather_particle
    gather_particle_back = transfers.gather_particle_back
    recovered_gradient_back = transfers.recovered_gradient_back
    yields = wp.constant(1 if plastic else 0)
    mask = CELL_MASK
    recovery_span = float(RECOVER_EVERY)
    largest = 1.0e37 if real == wp.float32 else 1.0e300

    @wp.kernel(enable_backward=False)
    def grid_again(
        r: int,
        done: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        dx: real,
        z0: real,
        gravity: wp.array(dtype=vec3),
        damping: wp.array(dtype=real),
        table: int,
        friction: wp.array(dtype=real),
        walls: int,
        box_lower: vec3,
        box_upper: vec3,
        grip_centre: wp.array2d(dtype=vec3),  # [GRAPH * W, G]
        grip_velocity: wp.array2d(dtype=vec3),
        grip_spin: wp.array2d(dtype=vec3),
        grip_closed: wp.array2d(dtype=wp.int32),
        grip_radius: wp.array2d(dtype=real),
        bounds: wp.array2d(dtype=wp.int32),
        cell: wp.array2d(dtype=wp.int32),
        level: wp.array2d(dtype=wp.int32),
        count: wp.array(dtype=wp.int32),
        momentum: wp.array2d(dtype=vec4),
        velocity: wp.array2d(dtype=vec4),
        grid_bar: wp.array2d(dtype=vec4),
    ):
        """Velocities of the substep's grid once more, and an empty grid of derivatives."""
        w, n = wp.tid()
        if n >= count[w] or r >= done[w]:
            return
        q = momentum[w, n]
        u = vec3()
        if q[3] > real(0.0):
            h = real(dt[w])
            u = update_node(
                w, r * done.shape[0] + w, q, bounds[w, 0] + (cell[w, n] >> CELL_BITS),
                bounds[w, 1] + (cell[w, n] & mask), level[w, n], h, dx, z0,
                gravity[w], wp.exp(-damping[w] * h), table, friction[w], walls,
                box_lower, box_upper,
                grip_centre, grip_velocity, grip_spin, grip_closed, grip_radius,
            )  # fmt: skip
        velocity[w, n] = vec4(u[0], u[1], u[2], q[3])
        grid_bar[w, n] = vec4()

    @wp.kernel(enable_backward=False)
    def gather_back(
        r: int,
        done: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        dx: real,
        z0: real,
        mu: wp.array2d(dtype=real),
        yield_stress: wp.array(dtype=real),
        bounds: wp.array2d(dtype=wp.int32),
        start: wp.array3d(dtype=wp.int32),
        velocity: wp.array2d(dtype=vec4),
        grid_bar: wp.array2d(dtype=vec4),
        x: wp.array2d(dtype=vec3),
        F: wp.array2d(dtype=mat33),
        x_bar: wp.array2d(dtype=vec3),
        v_bar: wp.array2d(dtype=vec3),
        C_bar: wp.array2d(dtype=mat33),
        F_bar: wp.array2d(dtype=mat33),
        mu_bar: wp.array2d(dtype=real),
        yield_bar: wp.array2d(dtype=real),
    ):
        w, p = wp.tid()
        if r >= done[w]:
            return
        h = real(dt[w])
        inv_dx = real(1.0) / dx
        xp = x[w, p]
        Fp = F[w, p]
        moved_bar = x_bar[w, p]
        trial_bar = F_bar[w, p]
        if yields == 1:
            _v, _C, D = gather_particle(xp, inv_dx, z0, w, bounds, start, w, velocity)
            trial_bar, mu_part, yield_part = return_map_back(
                Fp + h * (D * Fp), mu[w, p], yield_stress[w], trial_bar
            )
            mu_bar[w, p] = mu_bar[w, p] + mu_part
            yield_bar[w, p] = yield_bar[w, p] + yield_part
        x_part, gradient = gather_particle_back(
            xp, v_bar[w, p] + h * moved_bar, C_bar[w, p], h * (trial_bar * wp.transpose(Fp)),
            inv_dx, z0, w, bounds, start, w, velocity, grid_bar,
        )  # fmt: skip
        x_bar[w, p] = moved_bar + x_part
        F_bar[w, p] = trial_bar + h * (wp.transpose(gradient) * trial_bar)

    @wp.kernel(enable_backward=False)
    def grid_back(
        r: int,
        done: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        dx: real,
        z0: real,
        gravity: wp.array(dtype=vec3),
        damping: wp.array(dtype=real),
        table: int,
        friction: wp.array(dtype=real),
        walls: int,
        box_lower: vec3,
        box_upper: vec3,
        grip_centre: wp.array2d(dtype=vec3),
        grip_spin: wp.array2d(dtype=vec3),
        grip_closed: wp.array2d(dtype=wp.int32),
        grip_radius: wp.array2d(dtype=real),
        bounds: wp.array2d(dtype=wp.int32),
        cell: wp.array2d(dtype=wp.int32),
        level: wp.array2d(dtype=wp.int32),
        count: wp.array(dtype=wp.int32),
        momentum: wp.array2d(dtype=vec4),
        grip_centre_bar: wp.array2d(dtype=wp.vec3d),  # [W, G]
        grip_velocity_bar: wp.array2d(dtype=wp.vec3d),  # [W, G]
        friction_bar: wp.array(dtype=wp.float64),
        keep_bar: wp.array(dtype=wp.float64),
        gravity_bar: wp.array(dtype=wp.vec3d),
        grid_bar: wp.array2d(dtype=vec4),
    ):
        w, n = wp.tid()
        if n >= count[w] or r >= done[w]:
            return
        q = momentum[w, n]
        if q[3] > real(0.0):
            h = real(dt[w])
            b = grid_bar[w, n]
            grid_bar[w, n] = update_node_back(
                w, r * done.shape[0] + w, q, vec3(b[0], b[1], b[2]),
                bounds[w, 0] + (cell[w, n] >> CELL_BITS), bounds[w, 1] + (cell[w, n] & mask),
                level[w, n], h, dx, z0, gravity[w], wp.exp(-damping[w] * h), table, friction[w],
                walls, box_lower, box_upper, grip_centre, grip_spin, grip_closed, grip_radius,
                grip_centre_bar, grip_velocity_bar, friction_bar, keep_bar, gravity_bar,
            )  # fmt: skip

    @wp.kernel(enable_backward=False)
    def scatter_back(
        r: int,
        done: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        dx: real,
        z0: real,
        mu: wp.array2d(dtype=real),
        lam: wp.array2d(dtype=real),
        mass: wp.array(dtype=real),
        volume: real,
        bounds: wp.array2d(dtype=wp.int32),
        start: wp.array3d(dtype=wp.int32),
        grid_bar: wp.array2d(dtype=vec4),
        x: wp.array2d(dtype=vec3),
        v: wp.array2d(dtype=vec3),
        C: wp.array2d(dtype=mat33),
        F: wp.array2d(dtype=mat33),
        x_bar: wp.array2d(dtype=vec3),
        v_bar: wp.array2d(dtype=vec3),
        C_bar: wp.array2d(dtype=mat33),
        F_bar: wp.array2d(dtype=mat33),
        mu_bar: wp.array2d(dtype=real),
        lam_bar: wp.array2d(dtype=real),
        mass_bar: wp.array2d(dtype=real),
        status: wp.array(dtype=wp.int32),
        slot_out: wp.array(dtype=wp.int32),
        culprit_out: wp.array(dtype=wp.int32),
    ):
        w, p = wp.tid()
        if r >= done[w]:
            return
        x_part, vb, Cb, F_part, mu_part, lam_part, mass_part = scatter_particle_back(
            x[w, p], v[w, p], C[w, p], F[w, p], mu[w, p], lam[w, p], mass[w],
            volume, real(dt[w]), real(1.0) / dx, z0, w, bounds, start, w, grid_bar,
        )  # fmt: skip
        x_bar[w, p] = x_bar[w, p] + x_part
        v_bar[w, p] = vb
        C_bar[w, p] = Cb
        F_bar[w, p] = F_bar[w, p] + F_part
        mu_bar[w, p] = mu_bar[w, p] + mu_part
        lam_bar[w, p] = lam_bar[w, p] + lam_part
        mass_bar[w, p] = mass_bar[w, p] + mass_part
        size = wp.length_sq(x_part) + wp.length_sq(vb) + wp.ddot(F_part, F_part)
        # the first one found is named; a NaN is not below anything
        if not (size < real(largest)) and wp.atomic_max(status, w, NOT_FINITE) == OK:
            culprit_out[w] = p
            slot_out[w] = r

    @wp.kernel(enable_backward=False)
    def world_back(
        r: int,
        done: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        damping: wp.array(dtype=real),
        step: wp.array(dtype=wp.int32),  # [W] substeps of the frame done before the graph
        time: wp.float64,
        path_time: wp.array3d(dtype=wp.float64),
        grip_closed: wp.array2d(dtype=wp.int32),
        grip_centre_bar: wp.array2d(dtype=wp.vec3d),
        grip_velocity_bar: wp.array2d(dtype=wp.vec3d),
        keep_bar: wp.array(dtype=wp.float64),
        damping_bar: wp.array(dtype=wp.float64),
        path_bar: wp.array3d(dtype=wp.vec3d),
    ):
        """What a substep's nodes say of grippers' paths and of damping."""
        w = wp.tid()
        if r >= done[w]:
            return
        t = time + wp.float64(step[w] + r) * dt[w]
        for g in range(grip_closed.shape[1]):
            if grip_closed[r * done.shape[0] + w, g] == 1:
                place_gripper_back(
                    w, g, t, dt[w], path_time, grip_centre_bar[w, g], grip_velocity_bar[w, g],
                    path_bar,
                )  # fmt: skip
            grip_centre_bar[w, g] = wp.vec3d()
            grip_velocity_bar[w, g] = wp.vec3d()
        h = real(dt[w])
        damping_bar[w] = damping_bar[w] - wp.float64(h * wp.exp(-damping[w] * h)) * keep_bar[w]
        keep_bar[w] = wp.float64(0.0)

    @wp.kernel(enable_backward=False)
    def recover_back(
        r: int,
        done: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        age: wp.array(dtype=wp.int32),  # [W] substeps done in all before the graph
        lattice: wp.array3d(dtype=wp.int32),
        rest_frame: wp.array(dtype=mat33),
        recovery: real,
        x: wp.array2d(dtype=vec3),
        x_bar: wp.array2d(dtype=vec3),
        F_bar: wp.array2d(dtype=mat33),
    ):
        w, p = wp.tid()
        if r >= done[w] or (age[w] + r) % RECOVER_EVERY != 0:
            return
        blend = real(1.0) - wp.exp(-recovery * real(dt[w]) * real(recovery_span))
        if blend > real(0.0):
            F_bar[w, p] = recovered_gradient_back(
                w, p, F_bar[w, p], blend, w, x, lattice, rest_frame, x_bar
            )

    return SimpleNamespace(
        grid_again=grid_again,
        gather_back=gather_back,
        grid_back=grid_back,
        scatter_back=scatter_back,
        world_back=world_back,
        recover_back=recover_back,
    )
