"""The substep of the material point method as Warp functions and the kernels that loop over them.

One source for both devices. On the CPU one thread advances one world through many substeps, so
that its particles and its grid stay in cache; on CUDA each stage of a substep is a kernel over
all worlds. Both call the same functions.

Quadratic B-splines, APIC transfers, symplectic Euler. Sources: Jiang et al. (2015), "The affine
particle-in-cell method"; Jiang et al. (2016), "The material point method for simulating continuum
materials"; Hu et al. (2018) for the moving least squares variant, which is not used: see
``gather_particle``.

Shapes: W worlds, N particles, G grippers, K path knots, X x Y grid columns, M grid nodes.
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

OK = 0
GRID_FULL = 1
INVERTED = 2
DIVERGED = 3

MARGIN = 0.25
"""How far a particle may travel, in cells, before the grid's columns are laid anew."""

EMPTY_BELOW = 1 << 20
"""Lower end of the node range of a column without nodes."""

RECOVER_EVERY = 16
"""Substeps from one recovery of the deformation gradient to the next."""

SMALLEST_VOLUME = 0.2
"""Relative volume below which positions no longer tell F."""

CELL_BITS = 10
"""Bits of a packed node index inside the window, one group an axis."""


@functools.cache
def make_kernels(real: Any, law_name: str, *, plastic: bool) -> SimpleNamespace:
    """Build all kernels for one scalar type and one material.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        law_name: Elastic law, see ``gendom.materials.laws``.
        plastic: Whether particles yield.

    Returns:
        Namespace with the vector types, ``advance`` (CPU) and the stages of a substep (CUDA):
        ``begin``, ``locate``, ``empty``, ``mark``, ``lay``, ``clear``, ``recover``,
        ``p2g``, ``grid_update``, ``g2p``, ``end``.
    """
    law = make_law(law_name, real, plastic=plastic)
    stress = law.stress
    return_map = law.return_map
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)
    mat33 = wp.types.matrix((3, 3), real)
    mask = (1 << CELL_BITS) - 1
    recovery_span = float(RECOVER_EVERY)

    # ---- weights ---------------------------------------------------------------------------

    @wp.func
    def bspline(f: real):
        """Quadratic B-spline weights of a particle f cells above its lowest node (0.5..1.5)."""
        a = real(1.5) - f
        b = f - real(1.0)
        c = f - real(0.5)
        return vec3(real(0.5) * a * a, real(0.75) - b * b, real(0.5) * c * c)

    @wp.func
    def bspline_slope(f: real):
        """Derivatives of the weights above with respect to f."""
        return vec3(f - real(1.5), real(-2.0) * (f - real(1.0)), f - real(0.5))

    @wp.func
    def place_on_grid(x: vec3, inv_dx: real, z0: real):
        """Lowest of a particle's 27 nodes, and how many cells above it the particle lies."""
        y = vec3(x[0], x[1], x[2] - z0) * inv_dx
        bx = int(wp.floor(y[0] - real(0.5)))
        by = int(wp.floor(y[1] - real(0.5)))
        bz = int(wp.floor(y[2] - real(0.5)))
        return bx, by, bz, y[0] - real(bx), y[1] - real(by), y[2] - real(bz)

    # ---- the grid's columns: contiguous runs of nodes along z around the particles ---------------

    @wp.func
    def forget_bounds(w: int, bounds_out: wp.array2d(dtype=wp.int32)):
        bounds_out[w, 0] = EMPTY_BELOW
        bounds_out[w, 1] = EMPTY_BELOW
        bounds_out[w, 2] = -EMPTY_BELOW
        bounds_out[w, 3] = -EMPTY_BELOW

    @wp.func
    def locate_particle(
        w: int,
        x: vec3,
        inv_dx: real,
        bounds_out: wp.array2d(dtype=wp.int32),  # [W, 4] lowest and highest cell in x, y
    ):
        lo = x * inv_dx - vec3(real(0.5 + MARGIN))
        hi = x * inv_dx - vec3(real(0.5 - MARGIN))
        wp.atomic_min(bounds_out, w, 0, int(wp.floor(lo[0])))
        wp.atomic_min(bounds_out, w, 1, int(wp.floor(lo[1])))
        wp.atomic_max(bounds_out, w, 2, int(wp.floor(hi[0])) + 2)
        wp.atomic_max(bounds_out, w, 3, int(wp.floor(hi[1])) + 2)

    @wp.func
    def mark_particle(
        w: int,
        x: vec3,
        inv_dx: real,
        z0: real,
        bounds: wp.array2d(dtype=wp.int32),
        low_out: wp.array3d(dtype=wp.int32),  # [W, X, Y] lowest node of the column
        high_out: wp.array3d(dtype=wp.int32),  # [W, X, Y] highest node of the column
    ):
        y = vec3(x[0], x[1], x[2] - z0)
        lo = y * inv_dx - vec3(real(0.5 + MARGIN))
        hi = y * inv_dx - vec3(real(0.5 - MARGIN))
        i0 = int(wp.floor(lo[0])) - bounds[w, 0]
        j0 = int(wp.floor(lo[1])) - bounds[w, 1]
        i1 = int(wp.floor(hi[0])) + 2 - bounds[w, 0]
        j1 = int(wp.floor(hi[1])) + 2 - bounds[w, 1]
        k0 = int(wp.floor(lo[2]))
        k1 = int(wp.floor(hi[2])) + 2
        if i0 >= 0 and j0 >= 0 and i1 < low_out.shape[1] and j1 < low_out.shape[2]:
            for i in range(i0, i1 + 1):
                for j in range(j0, j1 + 1):
                    wp.atomic_min(low_out, w, i, j, k0)
                    wp.atomic_max(high_out, w, i, j, k1)

    @wp.func
    def lay_columns(
        w: int,
        bounds: wp.array2d(dtype=wp.int32),
        low: wp.array3d(dtype=wp.int32),
        high: wp.array3d(dtype=wp.int32),
        start_out: wp.array3d(dtype=wp.int32),  # [W, X, Y] node k is number start + k
        cell_out: wp.array2d(dtype=wp.int32),  # [W, M] packed column of each node
        level_out: wp.array2d(dtype=wp.int32),  # [W, M] k of each node
        count_out: wp.array(dtype=wp.int32),  # [W] nodes in use
    ):
        """Number the nodes of world w; the count may exceed the room for them."""
        X = bounds[w, 2] - bounds[w, 0] + 1
        Y = bounds[w, 3] - bounds[w, 1] + 1
        n = int(0)
        for i in range(X):
            for j in range(Y):
                k0 = low[w, i, j]
                k1 = high[w, i, j]
                start_out[w, i, j] = n - k0
                if k0 <= k1:
                    if n + k1 - k0 < cell_out.shape[1]:
                        for k in range(k0, k1 + 1):
                            cell_out[w, n + k - k0] = (i << CELL_BITS) | j
                            level_out[w, n + k - k0] = k
                    n += k1 - k0 + 1
        count_out[w] = n

    # ---- grippers --------------------------------------------------------------------------

    @wp.func
    def path_point(
        w: int,
        g: int,
        t: wp.float64,
        path_time: wp.array3d(dtype=wp.float64),
        path_position: wp.array3d(dtype=wp.vec3d),
    ):
        """Position at time t [s] of gripper g on its piecewise linear path, and the knot before."""
        last = path_time.shape[2] - 1
        lo = int(0)
        hi = int(last)
        while hi - lo > 1:
            mid = (lo + hi) // 2
            if path_time[w, g, mid] <= t:
                lo = mid
            else:
                hi = mid
        span = path_time[w, g, hi] - path_time[w, g, lo]
        u = wp.float64(0.0)
        if span > wp.float64(0.0):
            u = wp.clamp((t - path_time[w, g, lo]) / span, wp.float64(0.0), wp.float64(1.0))
        a = path_position[w, g, lo]
        return a + u * (path_position[w, g, hi] - a), lo

    @wp.func
    def place_gripper(
        w: int,
        g: int,
        t: wp.float64,
        dt: wp.float64,
        path_time: wp.array3d(dtype=wp.float64),
        path_position: wp.array3d(dtype=wp.vec3d),
        path_spin: wp.array3d(dtype=wp.vec3d),
        hold_from: wp.array2d(dtype=wp.float64),
        hold_until: wp.array2d(dtype=wp.float64),
        centre_out: wp.array2d(dtype=vec3),
        velocity_out: wp.array2d(dtype=vec3),
        spin_out: wp.array2d(dtype=vec3),
        closed_out: wp.array2d(dtype=wp.int32),
    ):
        here, knot = path_point(w, g, t, path_time, path_position)
        there, _ = path_point(w, g, t + dt, path_time, path_position)
        velocity = (there - here) / dt
        spin = path_spin[w, g, knot]
        last = path_time.shape[2] - 1
        if t < path_time[w, g, 0] or t >= path_time[w, g, last]:
            spin = wp.vec3d()
        centre_out[w, g] = vec3(real(here[0]), real(here[1]), real(here[2]))
        velocity_out[w, g] = vec3(real(velocity[0]), real(velocity[1]), real(velocity[2]))
        spin_out[w, g] = vec3(real(spin[0]), real(spin[1]), real(spin[2]))
        closed = int(0)
        if t >= hold_from[w, g] and t < hold_until[w, g]:
            closed = int(1)
        closed_out[w, g] = closed

    # ---- p2g, grid, g2p --------------------------------------------------------------------

    @wp.func
    def scatter_particle(
        w: int,
        x: vec3,
        v: vec3,
        C: mat33,
        F: mat33,
        mu: real,
        lam: real,
        mass: real,
        volume: real,
        dt: real,
        inv_dx: real,
        z0: real,
        bounds: wp.array2d(dtype=wp.int32),
        start: wp.array3d(dtype=wp.int32),
        grid_out: wp.array2d(dtype=vec4),  # [W, M] momentum and mass
    ):
        """Add a particle's mass, momentum and stress impulse to its 27 nodes."""
        bx, by, bz, fx, fy, fz = place_on_grid(x, inv_dx, z0)
        wx = bspline(fx)
        wy = bspline(fy)
        wz = bspline(fz)
        sx = bspline_slope(fx)
        sy = bspline_slope(fy)
        sz = bspline_slope(fz)
        affine = (mass / inv_dx) * C
        a0 = vec4(affine[0, 0], affine[1, 0], affine[2, 0], real(0.0))
        a1 = vec4(affine[0, 1], affine[1, 1], affine[2, 1], real(0.0))
        a2 = vec4(affine[0, 2], affine[1, 2], affine[2, 2], real(0.0))
        T = (-dt * volume * inv_dx) * stress(F, mu, lam)
        t0 = vec4(T[0, 0], T[1, 0], T[2, 0], real(0.0))
        t1 = vec4(T[0, 1], T[1, 1], T[2, 1], real(0.0))
        t2 = vec4(T[0, 2], T[1, 2], T[2, 2], real(0.0))
        q = vec4(mass * v[0], mass * v[1], mass * v[2], mass) - fx * a0 - fy * a1 - fz * a2
        offset = vec3(real(0.0), real(1.0), real(2.0))
        ci = bx - bounds[w, 0]
        cj = by - bounds[w, 1]
        for i in range(3):
            for j in range(3):
                n = start[w, ci + i, cj + j] + bz
                wij = wx[i] * wy[j]
                b = wij * (q + offset[i] * a0 + offset[j] * a1)
                b += (sx[i] * wy[j]) * t0 + (wx[i] * sy[j]) * t1
                s = wij * a2
                t = wij * t2
                wp.atomic_add(grid_out, w, n, wz[0] * b + sz[0] * t)
                wp.atomic_add(grid_out, w, n + 1, wz[1] * (b + s) + sz[1] * t)
                wp.atomic_add(grid_out, w, n + 2, wz[2] * (b + real(2.0) * s) + sz[2] * t)

    @wp.func
    def update_node(
        w: int,
        q: vec4,
        i: int,
        j: int,
        k: int,
        dt: real,
        dx: real,
        z0: real,
        gravity: vec3,
        keep: real,
        table: int,
        friction: real,
        box_lower: vec3,
        box_upper: vec3,
        grip_centre: wp.array2d(dtype=vec3),
        grip_velocity: wp.array2d(dtype=vec3),
        grip_spin: wp.array2d(dtype=vec3),
        grip_closed: wp.array2d(dtype=wp.int32),
        grip_radius: wp.array2d(dtype=real),
    ):
        """Velocity of a node after gravity, damping, table, walls and grippers."""
        v = keep * (vec3(q[0], q[1], q[2]) / q[3]) + dt * gravity
        at = vec3(real(i) * dx, real(j) * dx, z0 + real(k) * dx)
        for a in range(3):
            if at[a] <= box_lower[a]:
                v[a] = wp.max(v[a], real(0.0))
            if at[a] >= box_upper[a]:
                v[a] = wp.min(v[a], real(0.0))
        if table == 1 and k <= 0 and v[2] < real(0.0):
            slip = wp.sqrt(v[0] * v[0] + v[1] * v[1])
            left = real(0.0)
            if slip > -friction * v[2]:
                left = real(1.0) + friction * v[2] / slip
            v = vec3(left * v[0], left * v[1], real(0.0))
        for g in range(grip_closed.shape[1]):
            if grip_closed[w, g] == 1:
                # a particle is rigid when its whole stencil is held: one cell further
                reach = grip_radius[w, g] + dx
                r = at - grip_centre[w, g]
                if wp.length_sq(r) < reach * reach:
                    v = grip_velocity[w, g] + wp.cross(grip_spin[w, g], r)
        return v

    @wp.func
    def gather_particle(
        w: int,
        x: vec3,
        inv_dx: real,
        z0: real,
        bounds: wp.array2d(dtype=wp.int32),
        start: wp.array3d(dtype=wp.int32),
        grid: wp.array2d(dtype=vec4),  # [W, M] velocity and mass
    ):
        """Velocity v [m/s], affine velocity C [1/s] and velocity gradient [1/s] at a particle.

        C is the moment that APIC carries; the gradient is that of the interpolated velocity by
        which the particle moves, so that F stays the gradient of its motion. A moving least
        squares MPM takes C for both: F then forgets strain as the object crosses cells, and thin
        ropes creep.
        """
        bx, by, bz, fx, fy, fz = place_on_grid(x, inv_dx, z0)
        wx = bspline(fx)
        wy = bspline(fy)
        wz = bspline(fz)
        sx = bspline_slope(fx)
        sy = bspline_slope(fy)
        sz = bspline_slope(fz)
        offset = vec3(real(0.0), real(1.0), real(2.0))
        ci = bx - bounds[w, 0]
        cj = by - bounds[w, 1]
        v = vec4()
        c0 = vec4()
        c1 = vec4()
        c2 = vec4()
        d0 = vec4()
        d1 = vec4()
        d2 = vec4()
        for i in range(3):
            for j in range(3):
                n = start[w, ci + i, cj + j] + bz
                wij = wx[i] * wy[j]
                g0 = grid[w, n]
                g1 = grid[w, n + 1]
                g2 = grid[w, n + 2]
                h1 = wz[1] * g1
                h2 = wz[2] * g2
                h = wz[0] * g0 + h1 + h2
                s = wij * h
                v += s
                c0 += offset[i] * s
                c1 += offset[j] * s
                c2 += wij * (h1 + real(2.0) * h2)
                d0 += (sx[i] * wy[j]) * h
                d1 += (wx[i] * sy[j]) * h
                d2 += wij * (sz[0] * g0 + sz[1] * g1 + sz[2] * g2)
        c0 -= fx * v
        c1 -= fy * v
        c2 -= fz * v
        C = (real(4.0) * inv_dx) * mat33(
            c0[0], c1[0], c2[0],
            c0[1], c1[1], c2[1],
            c0[2], c1[2], c2[2],
        )  # fmt: skip
        gradient = inv_dx * mat33(
            d0[0], d1[0], d2[0],
            d0[1], d1[1], d2[1],
            d0[2], d1[2], d2[2],
        )  # fmt: skip
        return vec3(v[0], v[1], v[2]), C, gradient

    # ---- deformation gradient from positions -----------------------------------------------------

    @wp.func
    def recovered_gradient(
        w: int,
        p: int,
        F: mat33,
        blend: real,
        x: wp.array2d(dtype=vec3),
        lattice: wp.array3d(dtype=wp.int32),  # [N, 3, 2]
        rest_frame: wp.array(dtype=mat33),  # [N]
    ):
        """F drawn towards the differences of positions to the neighbours in the rest lattice.

        An F summed up over time slowly loses strain that the grid does not see; positions do not.
        Where neighbours have changed sides (a crumpled sheet) their differences mean nothing, and
        F stays as it is.
        """
        a = x[w, lattice[p, 0, 1]] - x[w, lattice[p, 0, 0]]
        b = x[w, lattice[p, 1, 1]] - x[w, lattice[p, 1, 0]]
        c = x[w, lattice[p, 2, 1]] - x[w, lattice[p, 2, 0]]
        D = mat33(
            a[0], b[0], c[0],
            a[1], b[1], c[1],
            a[2], b[2], c[2],
        )  # fmt: skip
        G = D * rest_frame[p]
        result = F
        if wp.determinant(G) > real(SMALLEST_VOLUME):
            result = F + blend * (G - F)
        return result

    # ---- CPU: one thread, one world, many substeps -------------------------------------------

    @wp.kernel(enable_backward=False, module="unique")
    def advance(
        # which world, which substeps; grid arrays hold this world alone
        w: int,
        step_inout: wp.array(dtype=wp.int32),  # [W] substeps of this frame done
        age_inout: wp.array(dtype=wp.int32),  # [W] substeps done in all
        steps: wp.array(dtype=wp.int32),  # [W] substeps to do
        time: wp.float64,  # [s] at substep 0
        dt: wp.array(dtype=wp.float64),  # [W] [s]
        # material
        mu: wp.array(dtype=real),  # [W] [Pa]
        lam: wp.array(dtype=real),  # [W] [Pa]
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
        # state
        x: wp.array2d(dtype=vec3),  # [W, N] [m]
        v: wp.array2d(dtype=vec3),  # [W, N] [m/s]
        C: wp.array2d(dtype=mat33),  # [W, N] [1/s]
        F: wp.array2d(dtype=mat33),  # [W, N]
        # grid, of one world
        bounds: wp.array2d(dtype=wp.int32),  # [1, 4]
        low: wp.array3d(dtype=wp.int32),  # [1, X, Y]
        high: wp.array3d(dtype=wp.int32),  # [1, X, Y]
        start: wp.array3d(dtype=wp.int32),  # [1, X, Y]
        cell: wp.array2d(dtype=wp.int32),  # [1, M]
        level: wp.array2d(dtype=wp.int32),  # [1, M]
        count: wp.array(dtype=wp.int32),  # [1]
        grid: wp.array2d(dtype=vec4),  # [1, M]
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
        step = step_inout[w]
        age = age_inout[w]
        travel = travel_inout[w]
        status = int(OK)
        while step < steps[w] and status == OK:
            if travel >= real(MARGIN) * dx:
                forget_bounds(0, bounds)
                for p in range(N):
                    locate_particle(0, x[w, p], inv_dx, bounds)
                X = bounds[0, 2] - bounds[0, 0] + 1
                Y = bounds[0, 3] - bounds[0, 1] + 1
                count[0] = grid.shape[1] + 1
                if X <= low.shape[1] and Y <= low.shape[2]:
                    for i in range(X):
                        for j in range(Y):
                            low[0, i, j] = EMPTY_BELOW
                            high[0, i, j] = -EMPTY_BELOW
                    for p in range(N):
                        mark_particle(0, x[w, p], inv_dx, z0, bounds, low, high)
                    lay_columns(0, bounds, low, high, start, cell, level, count)
                if count[0] > grid.shape[1]:
                    status = GRID_FULL
                else:
                    travel = real(0.0)
            if status == OK:
                t = time + wp.float64(step) * dt[w]
                for g in range(grip_closed.shape[1]):
                    place_gripper(
                        w, g, t, dt[w], path_time, path_position, path_spin,
                        hold_from, hold_until, grip_centre, grip_velocity, grip_spin, grip_closed,
                    )  # fmt: skip
                if age % RECOVER_EVERY == 0 and blend > real(0.0):
                    for p in range(N):
                        F[w, p] = recovered_gradient(w, p, F[w, p], blend, x, lattice, rest_frame)
                nodes = count[0]
                for n in range(nodes):
                    grid[0, n] = vec4()
                for p in range(N):
                    scatter_particle(
                        0, x[w, p], v[w, p], C[w, p], F[w, p], mu[w], lam[w], mass[w], volume,
                        h, inv_dx, z0, bounds, start, grid,
                    )  # fmt: skip
                for n in range(nodes):
                    q = grid[0, n]
                    if q[3] > real(0.0):
                        u = update_node(
                            w, q, bounds[0, 0] + (cell[0, n] >> CELL_BITS),
                            bounds[0, 1] + (cell[0, n] & mask), level[0, n], h, dx, z0,
                            gravity[w], keep, table, friction[w], box_lower, box_upper,
                            grip_centre, grip_velocity, grip_spin, grip_closed, grip_radius,
                        )  # fmt: skip
                        grid[0, n] = vec4(u[0], u[1], u[2], q[3])
                fastest = real(0.0)
                total = real(0.0)
                for p in range(N):
                    vp, Cp, Dp = gather_particle(0, x[w, p], inv_dx, z0, bounds, start, grid)
                    Fp = return_map(F[w, p] + h * (Dp * F[w, p]), mu[w], yield_stress[w])
                    if wp.determinant(Fp) <= real(0.0) and status == OK:
                        status = INVERTED
                        culprit_out[w] = p
                    x[w, p] = x[w, p] + h * vp
                    v[w, p] = vp
                    C[w, p] = Cp
                    F[w, p] = Fp
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

    # ---- CUDA: one kernel a stage, all worlds; a world that is done or failed stands still -------

    @wp.func
    def runs(w: int, step: wp.array(dtype=wp.int32), steps: wp.array(dtype=wp.int32),
             status: wp.array(dtype=wp.int32)):  # fmt: skip
        return step[w] < steps[w] and status[w] == OK

    @wp.kernel(enable_backward=False)
    def begin(
        step: wp.array(dtype=wp.int32),
        steps: wp.array(dtype=wp.int32),
        status: wp.array(dtype=wp.int32),
        time: wp.array(dtype=wp.float64),  # [1]
        dt: wp.array(dtype=wp.float64),
        dx: real,
        path_time: wp.array3d(dtype=wp.float64),
        path_position: wp.array3d(dtype=wp.vec3d),
        path_spin: wp.array3d(dtype=wp.vec3d),
        hold_from: wp.array2d(dtype=wp.float64),
        hold_until: wp.array2d(dtype=wp.float64),
        travel: wp.array(dtype=real),
        # results
        grip_centre: wp.array2d(dtype=vec3),
        grip_velocity: wp.array2d(dtype=vec3),
        grip_spin: wp.array2d(dtype=vec3),
        grip_closed: wp.array2d(dtype=wp.int32),
        bounds: wp.array2d(dtype=wp.int32),
        stale: wp.array(dtype=wp.int32),  # [W] 1 where the columns must be laid anew
    ):
        w = wp.tid()
        stale[w] = 0
        if runs(w, step, steps, status):
            if travel[w] >= real(MARGIN) * dx:
                stale[w] = 1
                forget_bounds(w, bounds)
            t = time[0] + wp.float64(step[w]) * dt[w]
            for g in range(grip_closed.shape[1]):
                place_gripper(
                    w, g, t, dt[w], path_time, path_position, path_spin,
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
        travel: wp.array(dtype=real),
        status: wp.array(dtype=wp.int32),
    ):
        w = wp.tid()
        if stale[w] == 1:
            X = bounds[w, 2] - bounds[w, 0] + 1
            Y = bounds[w, 3] - bounds[w, 1] + 1
            count[w] = cell.shape[1] + 1
            if X <= low.shape[1] and Y <= low.shape[2]:
                lay_columns(w, bounds, low, high, start, cell, level, count)
            if count[w] > cell.shape[1]:
                status[w] = GRID_FULL
            else:
                travel[w] = real(0.0)

    @wp.kernel(enable_backward=False)
    def clear(
        status: wp.array(dtype=wp.int32),
        count: wp.array(dtype=wp.int32),
        grid: wp.array2d(dtype=vec4),
        fastest: wp.array(dtype=real),
    ):
        w, n = wp.tid()
        if n == 0:
            fastest[w] = real(0.0)
        if status[w] == OK and n < count[w]:
            grid[w, n] = vec4()

    @wp.kernel(enable_backward=False)
    def recover(
        age: wp.array(dtype=wp.int32),
        step: wp.array(dtype=wp.int32),
        steps: wp.array(dtype=wp.int32),
        status: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        x: wp.array2d(dtype=vec3),
        lattice: wp.array3d(dtype=wp.int32),
        rest_frame: wp.array(dtype=mat33),
        recovery: real,
        F: wp.array2d(dtype=mat33),
    ):
        w, p = wp.tid()
        if age[w] % RECOVER_EVERY == 0 and runs(w, step, steps, status):
            blend = real(1.0) - wp.exp(-recovery * real(dt[w]) * real(recovery_span))
            F[w, p] = recovered_gradient(w, p, F[w, p], blend, x, lattice, rest_frame)

    @wp.kernel(enable_backward=False)
    def p2g(
        step: wp.array(dtype=wp.int32),
        steps: wp.array(dtype=wp.int32),
        status: wp.array(dtype=wp.int32),
        x: wp.array2d(dtype=vec3),
        v: wp.array2d(dtype=vec3),
        C: wp.array2d(dtype=mat33),
        F: wp.array2d(dtype=mat33),
        mu: wp.array(dtype=real),
        lam: wp.array(dtype=real),
        mass: wp.array(dtype=real),
        volume: real,
        dt: wp.array(dtype=wp.float64),
        dx: real,
        z0: real,
        bounds: wp.array2d(dtype=wp.int32),
        start: wp.array3d(dtype=wp.int32),
        grid: wp.array2d(dtype=vec4),
    ):
        w, p = wp.tid()
        if runs(w, step, steps, status):
            scatter_particle(
                w, x[w, p], v[w, p], C[w, p], F[w, p], mu[w], lam[w], mass[w], volume,
                real(dt[w]), real(1.0) / dx, z0, bounds, start, grid,
            )  # fmt: skip

    @wp.kernel(enable_backward=False)
    def grid_update(
        step: wp.array(dtype=wp.int32),
        steps: wp.array(dtype=wp.int32),
        status: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        dx: real,
        z0: real,
        gravity: wp.array(dtype=vec3),
        damping: wp.array(dtype=real),
        table: int,
        friction: wp.array(dtype=real),
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
        grid: wp.array2d(dtype=vec4),
    ):
        w, n = wp.tid()
        if runs(w, step, steps, status) and n < count[w]:
            q = grid[w, n]
            if q[3] > real(0.0):
                h = real(dt[w])
                u = update_node(
                    w, q, bounds[w, 0] + (cell[w, n] >> CELL_BITS),
                    bounds[w, 1] + (cell[w, n] & mask), level[w, n], h, dx, z0,
                    gravity[w], wp.exp(-damping[w] * h), table, friction[w], box_lower, box_upper,
                    grip_centre, grip_velocity, grip_spin, grip_closed, grip_radius,
                )  # fmt: skip
                grid[w, n] = vec4(u[0], u[1], u[2], q[3])

    @wp.kernel(enable_backward=False)
    def g2p(
        step: wp.array(dtype=wp.int32),
        steps: wp.array(dtype=wp.int32),
        status: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        mu: wp.array(dtype=real),
        yield_stress: wp.array(dtype=real),
        dx: real,
        z0: real,
        bounds: wp.array2d(dtype=wp.int32),
        start: wp.array3d(dtype=wp.int32),
        grid: wp.array2d(dtype=vec4),
        x: wp.array2d(dtype=vec3),
        v: wp.array2d(dtype=vec3),
        C: wp.array2d(dtype=mat33),
        F: wp.array2d(dtype=mat33),
        fastest: wp.array(dtype=real),  # [W] largest squared speed of this substep
        trouble: wp.array(dtype=wp.int32),  # [W] status found by any particle
        culprit: wp.array(dtype=wp.int32),
    ):
        w, p = wp.tid()
        if runs(w, step, steps, status):
            h = real(dt[w])
            vp, Cp, Dp = gather_particle(w, x[w, p], real(1.0) / dx, z0, bounds, start, grid)
            Fp = return_map(F[w, p] + h * (Dp * F[w, p]), mu[w], yield_stress[w])
            speed = wp.length_sq(vp)
            if not (speed * h * h <= dx * dx):
                wp.atomic_max(trouble, w, DIVERGED)
                speed = real(0.0)
            elif wp.determinant(Fp) <= real(0.0):
                wp.atomic_max(trouble, w, INVERTED)
                culprit[w] = p
            x[w, p] = x[w, p] + h * vp
            v[w, p] = vp
            C[w, p] = Cp
            F[w, p] = Fp
            if speed > fastest[w]:
                wp.atomic_max(fastest, w, speed)

    @wp.kernel(enable_backward=False)
    def end(
        steps: wp.array(dtype=wp.int32),
        dt: wp.array(dtype=wp.float64),
        fastest: wp.array(dtype=real),
        trouble: wp.array(dtype=wp.int32),
        step: wp.array(dtype=wp.int32),
        age: wp.array(dtype=wp.int32),
        travel: wp.array(dtype=real),
        status: wp.array(dtype=wp.int32),
    ):
        w = wp.tid()
        if runs(w, step, steps, status):
            age[w] = age[w] + 1
            travel[w] = travel[w] + real(dt[w]) * wp.sqrt(fastest[w])
            step[w] = step[w] + 1
            if trouble[w] > OK:
                status[w] = trouble[w]

    return SimpleNamespace(
        vec3=vec3,
        vec4=vec4,
        mat33=mat33,
        advance=advance,
        begin=begin,
        locate=locate,
        empty=empty,
        mark=mark,
        lay=lay,
        clear=clear,
        recover=recover,
        p2g=p2g,
        grid_update=grid_update,
        g2p=g2p,
        end=end,
    )
