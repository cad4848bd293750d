"""The substep of the material point method: the loops over particles and grid nodes.

One source for both devices. On the CPU one thread advances one world through many substeps, so
that its particles and its grid stay in cache; on CUDA each stage of a substep is a kernel over
all worlds. Both call the same functions of ``transfers``, ``boundary`` and ``columns``.
Symplectic Euler.

Shapes: W worlds, N particles, G grippers, K path knots, L layouts of X x Y grid columns, M nodes.
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
from gendom.sim.columns import CELL_BITS, CELL_MASK, EMPTY_BELOW, MARGIN, make_columns
from gendom.sim.stencil import FUSED
from gendom.sim.transfers import make_transfers

OK = 0
GRID_FULL = 1
INVERTED = 2
DIVERGED = 3

RECOVER_EVERY = 16
"""Substeps from one recovery of the deformation gradient to the next."""


@functools.cache
def make_kernels(real: Any, law_name: str, *, plastic: bool) -> SimpleNamespace:
    """Build all kernels for one scalar type and one material.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        law_name: Elastic law, see ``gendom.materials.laws``.
        plastic: Whether particles yield.

    Returns:
        Namespace with the vector types, ``advance`` (CPU) and the stages of a substep (CUDA):
        ``tally``, ``place``, ``locate``, ``empty``, ``mark``, ``lay`` where a graph begins, then
        ``p2g``, ``grid_update``, ``g2p`` for each of its substeps.
    """
    law = make_law(law_name, real, plastic=plastic)
    return_map = law.return_map
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)
    mat33 = wp.types.matrix((3, 3), real)
    columns = make_columns(real)
    forget_bounds = columns.forget_bounds
    locate_particle = columns.locate_particle
    mark_particle = columns.mark_particle
    lay_column = columns.lay_column
    lay_columns = columns.lay_columns
    boundary = make_boundary(real)
    place_gripper = boundary.place_gripper
    update_node = boundary.update_node
    transfers = make_transfers(real, law.stress, law.stress_back)
    scatter_particle = transfers.scatter_particle
    gather_particle = transfers.gather_particle
    recovered_gradient = transfers.recovered_gradient
    mask = CELL_MASK
    recovery_span = float(RECOVER_EVERY)

    # ---- CPU: one thread, one world, many substeps -------------------------------------------

    @wp.kernel(enable_backward=False, module="unique", module_options=FUSED)
    def advance(
        # which world, which substeps; grid arrays hold this world alone
        w: int,
        step_inout: wp.array(dtype=wp.int32),  # [W] substeps of this frame done
        age_inout: wp.array(dtype=wp.int32),  # [W] substeps done in all
        steps: wp.array(dtype=wp.int32),  # [W] substeps to do
        time: wp.float64,  # [s] at substep 0
        dt: wp.array(dtype=wp.float64),  # [W] [s]
        # material
        mu: wp.array2d(dtype=real),  # [W, N] [Pa]
        lam: wp.array2d(dtype=real),  # [W, N] [Pa]
        yield_stress: wp.array(dtype=real),  # [W] [Pa]
        mass: wp.array(dtype=real),  # [W] of a particle [kg]
        volume: real,  # of a particle [m^3]
        lattice: wp.array3d(dtype=wp.int32),  # [N, 3, 2]
        rest_frame: wp.array(dtype=mat33),  # [N] [1/m]
        recovery: real,  # rate [1/s] at which F follows the positions
        # scene
        dx: real,
        z0: real,  # height of node level 0 [m]
        gravity: wp.array(dtype=vec3),  # [W] [m/s^2]
        damping: wp.array(dtype=real),  # [W] [1/s]
        table: int,
        friction: wp.array(dtype=real),  # [W]
        walls: int,
        box_lower: vec3,
        box_upper: vec3,
        # grippers
        path_time: wp.array3d(dtype=wp.float64),  # [W, G, K] [s]
        path_position: wp.array3d(dtype=wp.vec3d),  # [W, G, K] [m]
        path_spin: wp.array3d(dtype=wp.vec3d),  # [W, G, K] [rad/s] from this knot on
        hold_from: wp.array2d(dtype=wp.float64),  # [W, G] [s]
        hold_until: wp.array2d(dtype=wp.float64),  # [W, G] [s]
        grip_radius: wp.array2d(dtype=real),  # [W, G] [m]
        grip_centre: wp.array2d(dtype=vec3),  # [W, G]
        grip_velocity: wp.array2d(dtype=vec3),  # [W, G]
        grip_spin: wp.array2d(dtype=vec3),  # [W, G]
        grip_closed: wp.array2d(dtype=wp.int32),  # [W, G]
        # state, in rows: substep n of this call goes from row first + n * stride to the next;
        # stride 0 works in place, 1 keeps every state, its grid and its layout for the reverse
        first: int,
        stride: int,
        x: wp.array2d(dtype=vec3),  # [rows, N] [m]
        v: wp.array2d(dtype=vec3),  # [rows, N] [m/s]
        C: wp.array2d(dtype=mat33),  # [rows, N] [1/s]
        F: wp.array2d(dtype=mat33),  # [rows, N]
        # grid
        bounds: wp.array2d(dtype=wp.int32),  # [L, 4]
        low: wp.array3d(dtype=wp.int32),  # [L, X, Y]
        high: wp.array3d(dtype=wp.int32),  # [L, X, Y]
        start: wp.array3d(dtype=wp.int32),  # [L, X, Y]
        cell: wp.array2d(dtype=wp.int32),  # [L, M]
        level: wp.array2d(dtype=wp.int32),  # [L, M]
        count: wp.array(dtype=wp.int32),  # [L]
        layout_of: wp.array(dtype=wp.int32),  # [L] the layout of each substep of this call
        momentum: wp.array2d(dtype=vec4),  # [L, M] and mass
        velocity: wp.array2d(dtype=vec4),  # [1, M] and mass; may be ``momentum`` where stride is 0
        # what happened
        travel_inout: wp.array(dtype=real),  # [W] distance since the columns were laid [m]
        status_inout: wp.array(dtype=wp.int32),  # [W]
        culprit_out: wp.array(dtype=wp.int32),  # [W] particle
    ):
        N = x.shape[1]
        inv_dx = real(1.0) / dx
        h = real(dt[w])
        keep = wp.exp(-damping[w] * h)
        blend = real(1.0) - wp.exp(-recovery * h * real(recovery_span))
        begun = step_inout[w]
        step = int(begun)
        age = age_inout[w]
        travel = travel_inout[w]
        status = int(OK)
        layout = layout_of[0]
        while step < steps[w] and status == OK:
            slot = (step - begun) * stride
            row = first + slot
            after = row + stride
            if travel >= real(MARGIN) * dx:
                layout = slot
                forget_bounds(layout, bounds)
                for p in range(N):
                    locate_particle(layout, x[row, p], inv_dx, bounds)
                X = bounds[layout, 2] - bounds[layout, 0] + 1
                Y = bounds[layout, 3] - bounds[layout, 1] + 1
                count[layout] = momentum.shape[1] + 1
                if X <= low.shape[1] and Y <= low.shape[2]:
                    for i in range(X):
                        for j in range(Y):
                            low[layout, i, j] = EMPTY_BELOW
                            high[layout, i, j] = -EMPTY_BELOW
                    for p in range(N):
                        mark_particle(layout, x[row, p], inv_dx, z0, bounds, low, high)
                    lay_columns(layout, bounds, low, high, start, cell, level, count)
                if count[layout] > momentum.shape[1]:
                    status = GRID_FULL
                    # the grid's need is read from the first layout
                    for a in range(4):
                        bounds[0, a] = bounds[layout, a]
                else:
                    travel = real(0.0)
            if status == OK:
                layout_of[slot] = layout
                t = time + wp.float64(step) * dt[w]
                for g in range(grip_closed.shape[1]):
                    place_gripper(
                        w, w, g, t, dt[w], path_time, path_position, path_spin,
                        hold_from, hold_until, grip_centre, grip_velocity, grip_spin, grip_closed,
                    )  # fmt: skip
                if age % RECOVER_EVERY == 0 and blend > real(0.0):
                    for p in range(N):
                        F[row, p] = recovered_gradient(
                            row, p, F[row, p], blend, x, lattice, rest_frame
                        )
                nodes = count[layout]
                for n in range(nodes):
                    momentum[slot, n] = vec4()
                for p in range(N):
                    scatter_particle(
                        x[row, p], v[row, p], C[row, p], F[row, p], mu[w, p], lam[w, p], mass[w],
                        volume, h, inv_dx, z0, layout, bounds, start, slot, momentum,
                    )  # fmt: skip
                for n in range(nodes):
                    q = momentum[slot, n]
                    if q[3] > real(0.0):
                        u = update_node(
                            w, w, q, bounds[layout, 0] + (cell[layout, n] >> CELL_BITS),
                            bounds[layout, 1] + (cell[layout, n] & mask), level[layout, n], h, dx,
                            z0, gravity[w], keep, table, friction[w], walls, box_lower, box_upper,
                            grip_centre, grip_velocity, grip_spin, grip_closed, grip_radius,
                        )  # fmt: skip
                        velocity[0, n] = vec4(u[0], u[1], u[2], q[3])
                fastest = real(0.0)
                total = real(0.0)
                for p in range(N):
                    xp = x[row, p]
                    Fp = F[row, p]
                    vp, Cp, Dp = gather_particle(xp, inv_dx, z0, layout, bounds, start, 0, velocity)
                    Fp = return_map(Fp + h * (Dp * Fp), mu[w, p], yield_stress[w])
                    if wp.determinant(Fp) <= real(0.0) and status == OK:
                        status = INVERTED
                        culprit_out[w] = p
                    x[after, p] = xp + h * vp
                    v[after, p] = vp
                    C[after, p] = Cp
                    F[after, p] = Fp
                    speed = wp.length_sq(vp)
                    fastest = wp.max(fastest, speed)
                    total += speed
                # a sum keeps a NaN, a maximum may drop it
                if not (total < real(1.0e30)) or h * wp.sqrt(fastest) > dx:
                    status = DIVERGED
                travel += h * wp.sqrt(fastest)
                step += 1
                age += 1
        step_inout[w] = step
        age_inout[w] = age
        travel_inout[w] = travel
        status_inout[w] = status

    # ---- CUDA: a graph of GRAPH substeps; columns are laid anew only where it begins ------------
    #
    # A world that would leave its columns, that has done its substeps or that failed stands still
    # for the rest of the graph. Inside a graph nothing but the substep's three kernels runs: how
    # far a world has travelled is summed from each substep's largest speed by whoever asks.

    @wp.func
    def runs(
        w: int,
        r: int,  # number of the substep in its graph
        dx: real,
        dt: wp.array(dtype=wp.float64),
        step: wp.array(dtype=wp.int32),
        steps: wp.array(dtype=wp.int32),
        status: wp.array(dtype=wp.int32),
        trouble: wp.array(dtype=wp.int32),
        travel: wp.array(dtype=real),
        fastest: wp.array2d(dtype=real),
    ):
        going = step[w] + r < steps[w] and status[w] == OK and trouble[w] == OK
        if going:
            far = travel[w]
            for q in range(r):
                far += real(dt[w]) * wp.sqrt(fastest[w, q])
            going = far < real(MARGIN) * dx
        return going

    @wp.kernel(enable_backward=False)
    def tally(
        dx: real,
        dt: wp.array(dtype=wp.float64),
        step: wp.array(dtype=wp.int32),
        age: wp.array(dtype=wp.int32),
        travel: wp.array(dtype=real),
        status: wp.array(dtype=wp.int32),
        trouble: wp.array(dtype=wp.int32),
        done: wp.array(dtype=wp.int32),  # [W] substeps done in the graph that has ended
        fastest: wp.array2d(dtype=real),  # [W, GRAPH] largest squared speed of each
        stale: wp.array(dtype=wp.int32),  # [W] 1 where the columns must be laid anew
        bounds: wp.array2d(dtype=wp.int32),
        count: wp.array(dtype=wp.int32),
    ):
        """Count what a graph has done; call before the next one, and before reading ``step``."""
        w = wp.tid()
        n = done[w]
        far = travel[w]
        for q in range(n):
            far += real(dt[w]) * wp.sqrt(fastest[w, q])
        for q in range(fastest.shape[1]):
            fastest[w, q] = real(0.0)
        travel[w] = far
        step[w] = step[w] + n
        age[w] = age[w] + n
        done[w] = 0
        if status[w] == OK and trouble[w] != OK:
            status[w] = trouble[w]
        trouble[w] = OK
        # a world that found no room keeps its bounds: the host reads from them what it needs
        if far >= real(MARGIN) * dx and status[w] == OK:
            stale[w] = 1
            travel[w] = real(0.0)
            count[w] = 0
            forget_bounds(w, bounds)

    @wp.kernel(enable_backward=False)
    def place(
        step: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        time: wp.array(dtype=wp.float64),  # [1] of the frame's substep 0
        path_time: wp.array3d(dtype=wp.float64),
        path_position: wp.array3d(dtype=wp.vec3d),
        path_spin: wp.array3d(dtype=wp.vec3d),
        hold_from: wp.array2d(dtype=wp.float64),
        hold_until: wp.array2d(dtype=wp.float64),
        grip_centre: wp.array2d(dtype=vec3),  # [GRAPH * W, G]
        grip_velocity: wp.array2d(dtype=vec3),
        grip_spin: wp.array2d(dtype=vec3),
        grip_closed: wp.array2d(dtype=wp.int32),
    ):
        """Grippers in every substep of the graph that begins."""
        r, w = wp.tid()
        t = time[0] + wp.float64(step[w] + r) * dt[w]
        for g in range(grip_closed.shape[1]):
            place_gripper(
                r * step.shape[0] + w, w, g, t, dt[w], path_time, path_position, path_spin,
                hold_from, hold_until, grip_centre, grip_velocity, grip_spin, grip_closed,
            )  # fmt: skip

    @wp.kernel(enable_backward=False)
    def locate(
        stale: wp.array(dtype=wp.int32),
        x: wp.array2d(dtype=vec3),
        dx: real,
        bounds: wp.array2d(dtype=wp.int32),
    ):
        w, p = wp.tid()
        if stale[w] == 1:
            locate_particle(w, x[w, p], real(1.0) / dx, bounds)

    @wp.kernel(enable_backward=False)
    def empty(
        stale: wp.array(dtype=wp.int32),
        low: wp.array3d(dtype=wp.int32),
        high: wp.array3d(dtype=wp.int32),
    ):
        w, i, j = wp.tid()
        if stale[w] == 1:
            low[w, i, j] = EMPTY_BELOW
            high[w, i, j] = -EMPTY_BELOW

    @wp.kernel(enable_backward=False)
    def mark(
        stale: wp.array(dtype=wp.int32),
        x: wp.array2d(dtype=vec3),
        dx: real,
        z0: real,
        bounds: wp.array2d(dtype=wp.int32),
        low: wp.array3d(dtype=wp.int32),
        high: wp.array3d(dtype=wp.int32),
    ):
        w, p = wp.tid()
        if stale[w] == 1:
            mark_particle(w, x[w, p], real(1.0) / dx, z0, bounds, low, high)

    @wp.kernel(enable_backward=False)
    def lay(
        stale: wp.array(dtype=wp.int32),
        bounds: wp.array2d(dtype=wp.int32),
        low: wp.array3d(dtype=wp.int32),
        high: wp.array3d(dtype=wp.int32),
        start: wp.array3d(dtype=wp.int32),
        cell: wp.array2d(dtype=wp.int32),
        level: wp.array2d(dtype=wp.int32),
        count: wp.array(dtype=wp.int32),
        status: wp.array(dtype=wp.int32),
    ):
        w, i, j = wp.tid()
        if stale[w] == 1:
            if i >= bounds[w, 2] - bounds[w, 0] + 1 or j >= bounds[w, 3] - bounds[w, 1] + 1:
                return
            # in any order: sums do not depend on a node's number
            first = wp.atomic_add(count, w, wp.max(0, high[w, i, j] - low[w, i, j] + 1))
            full = lay_column(w, i, j, first, low, high, start, cell, level)
            if (
                full == 1
                or bounds[w, 2] - bounds[w, 0] >= low.shape[1]
                or bounds[w, 3] - bounds[w, 1] >= low.shape[2]
            ):
                status[w] = GRID_FULL

    @wp.kernel(enable_backward=False)
    def p2g(
        r: int,
        dx: real,
        dt: wp.array(dtype=wp.float64),
        step: wp.array(dtype=wp.int32),
        steps: wp.array(dtype=wp.int32),
        status: wp.array(dtype=wp.int32),
        trouble: wp.array(dtype=wp.int32),
        travel: wp.array(dtype=real),
        fastest: wp.array2d(dtype=real),
        stale: wp.array(dtype=wp.int32),
        age: wp.array(dtype=wp.int32),
        lattice: wp.array3d(dtype=wp.int32),
        rest_frame: wp.array(dtype=mat33),
        recovery: real,
        x: wp.array2d(dtype=vec3),
        v: wp.array2d(dtype=vec3),
        C: wp.array2d(dtype=mat33),
        F: wp.array2d(dtype=mat33),
        mu: wp.array2d(dtype=real),
        lam: wp.array2d(dtype=real),
        mass: wp.array(dtype=real),
        volume: real,
        z0: real,
        bounds: wp.array2d(dtype=wp.int32),
        start: wp.array3d(dtype=wp.int32),
        momentum: wp.array2d(dtype=vec4),
    ):
        w, p = wp.tid()
        if r == 0 and p == 0:
            stale[w] = 0  # laid by now
        if runs(w, r, dx, dt, step, steps, status, trouble, travel, fastest):
            h = real(dt[w])
            Fp = F[w, p]
            if (age[w] + r) % RECOVER_EVERY == 0:
                blend = real(1.0) - wp.exp(-recovery * h * real(recovery_span))
                Fp = recovered_gradient(w, p, Fp, blend, x, lattice, rest_frame)
                F[w, p] = Fp
            scatter_particle(
                x[w, p], v[w, p], C[w, p], Fp, mu[w, p], lam[w, p], mass[w], volume,
                h, real(1.0) / dx, z0, w, bounds, start, w, momentum,
            )  # fmt: skip

    @wp.kernel(enable_backward=False)
    def grid_update(
        r: int,
        dx: real,
        dt: wp.array(dtype=wp.float64),
        step: wp.array(dtype=wp.int32),
        steps: wp.array(dtype=wp.int32),
        status: wp.array(dtype=wp.int32),
        trouble: wp.array(dtype=wp.int32),
        travel: wp.array(dtype=real),
        fastest: wp.array2d(dtype=real),
        z0: real,
        gravity: wp.array(dtype=vec3),
        damping: wp.array(dtype=real),
        table: int,
        friction: wp.array(dtype=real),
        walls: int,
        box_lower: vec3,
        box_upper: vec3,
        grip_centre: wp.array2d(dtype=vec3),
        grip_velocity: wp.array2d(dtype=vec3),
        grip_spin: wp.array2d(dtype=vec3),
        grip_closed: wp.array2d(dtype=wp.int32),
        grip_radius: wp.array2d(dtype=real),
        bounds: wp.array2d(dtype=wp.int32),
        cell: wp.array2d(dtype=wp.int32),
        level: wp.array2d(dtype=wp.int32),
        count: wp.array(dtype=wp.int32),
        recorded: int,  # 1: the momentum stays for the reverse; 0: left empty for the next substep
        momentum: wp.array2d(dtype=vec4),  # [W, M]
        velocity: wp.array2d(dtype=vec4),  # [W, M]
    ):
        w, n = wp.tid()
        # one after the other: most threads of a world stand beyond its last node
        if n >= count[w]:
            return
        if runs(w, r, dx, dt, step, steps, status, trouble, travel, fastest):
            q = momentum[w, n]
            if recorded == 0:
                momentum[w, n] = vec4()
            u = vec3()
            if q[3] > real(0.0):
                h = real(dt[w])
                u = update_node(
                    w, r * steps.shape[0] + w, q, bounds[w, 0] + (cell[w, n] >> CELL_BITS),
                    bounds[w, 1] + (cell[w, n] & mask), level[w, n], h, dx, z0,
                    gravity[w], wp.exp(-damping[w] * h), table, friction[w],
                    walls, box_lower, box_upper,
                    grip_centre, grip_velocity, grip_spin, grip_closed, grip_radius,
                )  # fmt: skip
            velocity[w, n] = vec4(u[0], u[1], u[2], q[3])

    @wp.kernel(enable_backward=False)
    def g2p(
        r: int,
        dx: real,
        dt: wp.array(dtype=wp.float64),
        step: wp.array(dtype=wp.int32),
        steps: wp.array(dtype=wp.int32),
        status: wp.array(dtype=wp.int32),
        trouble: wp.array(dtype=wp.int32),  # [W] status found by any particle
        travel: wp.array(dtype=real),
        fastest: wp.array2d(dtype=real),
        done: wp.array(dtype=wp.int32),
        mu: wp.array2d(dtype=real),
        yield_stress: wp.array(dtype=real),
        z0: real,
        bounds: wp.array2d(dtype=wp.int32),
        start: wp.array3d(dtype=wp.int32),
        velocity: wp.array2d(dtype=vec4),
        x: wp.array2d(dtype=vec3),
        F: wp.array2d(dtype=mat33),
        x_out: wp.array2d(dtype=vec3),
        v_out: wp.array2d(dtype=vec3),
        C_out: wp.array2d(dtype=mat33),
        F_out: wp.array2d(dtype=mat33),
        culprit: wp.array(dtype=wp.int32),
    ):
        w, p = wp.tid()
        if runs(w, r, dx, dt, step, steps, status, trouble, travel, fastest):
            h = real(dt[w])
            xp = x[w, p]
            Fp = F[w, p]
            vp, Cp, Dp = gather_particle(xp, real(1.0) / dx, z0, w, bounds, start, w, velocity)
            Fp = return_map(Fp + h * (Dp * Fp), mu[w, p], yield_stress[w])
            speed = wp.length_sq(vp)
            if not (speed * h * h <= dx * dx):
                wp.atomic_max(trouble, w, DIVERGED)
                speed = real(0.0)
            elif wp.determinant(Fp) <= real(0.0):
                wp.atomic_max(trouble, w, INVERTED)
                culprit[w] = p
            x_out[w, p] = xp + h * vp
            v_out[w, p] = vp
            C_out[w, p] = Cp
            F_out[w, p] = Fp
            if p == 0:
                done[w] = r + 1
            if speed > fastest[w, r]:
                wp.atomic_max(fastest, w, r, speed)

    @wp.kernel(enable_backward=False)
    def take(
        done: wp.array(dtype=wp.int32),
        x: wp.array3d(dtype=vec3),  # [GRAPH + 1, W, N]
        v: wp.array3d(dtype=vec3),
        C: wp.array3d(dtype=mat33),
        F: wp.array3d(dtype=mat33),
        x_out: wp.array2d(dtype=vec3),  # [W, N]
        v_out: wp.array2d(dtype=vec3),
        C_out: wp.array2d(dtype=mat33),
        F_out: wp.array2d(dtype=mat33),
    ):
        """The state in which each world has left a recorded graph."""
        w, p = wp.tid()
        row = done[w]
        x_out[w, p] = x[row, w, p]
        v_out[w, p] = v[row, w, p]
        C_out[w, p] = C[row, w, p]
        F_out[w, p] = F[row, w, p]

    return SimpleNamespace(
        vec3=vec3,
        vec4=vec4,
        mat33=mat33,
        advance=advance,
        tally=tally,
        place=place,
        locate=locate,
        empty=empty,
        mark=mark,
        lay=lay,
        p2g=p2g,
        grid_update=grid_update,
        g2p=g2p,
        take=take,
    )
