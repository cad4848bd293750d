"""What particles and grid exchange, and the deformation gradient's recovery.

APIC transfers with quadratic B-splines: Jiang et al. (2015), "The affine particle-in-cell
method"; Jiang et al. (2016), "The material point method for simulating continuum materials"; the
moving least squares variant of Hu et al. (2018) is not used: see ``gather_particle``.

Each function has its transpose beside it (``..._back``), which carries derivatives of a loss
from results to arguments. A name with ``_bar`` is the derivative of the loss by that quantity.

Shapes: W worlds, N particles, L layouts of the grid (see ``gendom.sim.columns``), M grid nodes.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.materials.laws import Law
from gendom.sim.columns import Columns
from gendom.sim.stencil import make_stencil

SMALLEST_VOLUME = 0.2
"""Relative volume below which positions no longer tell F."""


@functools.cache
def make_transfers(real: Any, law: Law, *, straight: bool = False) -> SimpleNamespace:
    """Build the types and functions for one scalar type and one material.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        law: See ``gendom.materials.laws``.
        straight: See ``make_stencil``.

    Returns:
        Namespace with the structs ``Matter``, ``State`` and ``MatterBars``, and with
        ``scatter_particle``, ``move_particle``, ``recover_particle`` and the transpose of each.
    """
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)
    mat33 = wp.types.matrix((3, 3), real)
    stencil = make_stencil(real, straight=straight)
    sums = stencil.sums
    scatter = stencil.scatter
    gather = stencil.gather
    gather_with_slope = stencil.gather_with_slope
    stress = law.stress
    stress_back = law.stress_back
    return_map = law.return_map
    return_map_back = law.return_map_back
    yields = wp.constant(1 if law.plastic else 0)

    @wp.struct
    class Matter:
        """What W bodies consist of."""

        mu: wp.array2d(dtype=real)  # [W, N] [Pa]
        lam: wp.array2d(dtype=real)  # [W, N] [Pa]
        yield_stress: wp.array(dtype=real)  # [W] [Pa]
        mass: wp.array(dtype=real)  # [W] of a particle [kg]
        volume: real  # of a particle [m^3]
        lattice: wp.array3d(dtype=wp.int32)  # [N, 3, 2]
        rest_frame: wp.array(dtype=mat33)  # [N] [1/m]
        recovery: real  # rate at which F follows the positions [1/s]

    @wp.struct
    class State:
        """Particles, a row for each world or each recorded substep."""

        x: wp.array2d(dtype=vec3)  # [rows, N] [m]
        v: wp.array2d(dtype=vec3)  # [rows, N] [m/s]
        C: wp.array2d(dtype=mat33)  # [rows, N] [1/s]
        F: wp.array2d(dtype=mat33)  # [rows, N]

    @wp.struct
    class MatterBars:
        """Derivatives by each particle's state, and by its parameters, summed up."""

        x: wp.array2d(dtype=vec3)  # [W, N]
        v: wp.array2d(dtype=vec3)
        C: wp.array2d(dtype=mat33)
        F: wp.array2d(dtype=mat33)
        mu: wp.array2d(dtype=real)
        lam: wp.array2d(dtype=real)
        mass: wp.array2d(dtype=real)
        yield_stress: wp.array2d(dtype=real)

    @wp.func
    def place_on_grid(layout: int, x: vec3, inv_dx: real, z0: real, columns: Columns):
        """Lowest of a particle's 27 nodes in a layout, and the place above it in cells."""
        y = vec3(x[0], x[1], x[2] - z0) * inv_dx
        i = int(wp.floor(y[0] - real(0.5)))
        j = int(wp.floor(y[1] - real(0.5)))
        k = int(wp.floor(y[2] - real(0.5)))
        node = wp.vec3i(i - columns.bounds[layout, 0], j - columns.bounds[layout, 1], k)
        return node, y - vec3(real(i), real(j), real(k))

    @wp.func
    def coefficients(f: vec3, q: vec3, mass: real, A: mat33, T: mat33):
        """Of momentum q and ``mass``, A about the particle, and T by the weights' slopes."""
        q0 = q - A * f
        return sums(
            q0[0], q0[1], q0[2], mass,
            A[0, 0], A[1, 0], A[2, 0], real(0.0),
            A[0, 1], A[1, 1], A[2, 1], real(0.0),
            A[0, 2], A[1, 2], A[2, 2], real(0.0),
            T[0, 0], T[1, 0], T[2, 0], real(0.0),
            T[0, 1], T[1, 1], T[2, 1], real(0.0),
            T[0, 2], T[1, 2], T[2, 2], real(0.0),
        )  # fmt: skip

    @wp.func
    def affine_of(f: vec3, R: Any):
        """Derivative by A of ``coefficients`` from that by the coefficients."""
        return mat33(
            R[1, 0] - f[0] * R[0, 0], R[2, 0] - f[1] * R[0, 0], R[3, 0] - f[2] * R[0, 0],
            R[1, 1] - f[0] * R[0, 1], R[2, 1] - f[1] * R[0, 1], R[3, 1] - f[2] * R[0, 1],
            R[1, 2] - f[0] * R[0, 2], R[2, 2] - f[1] * R[0, 2], R[3, 2] - f[2] * R[0, 2],
        )  # fmt: skip

    @wp.func
    def slopes_of(R: Any):
        """Derivative by T of ``coefficients`` from that by the coefficients."""
        return mat33(
            R[4, 0], R[5, 0], R[6, 0],
            R[4, 1], R[5, 1], R[6, 1],
            R[4, 2], R[5, 2], R[6, 2],
        )  # fmt: skip

    @wp.func
    def given_by(
        x: vec3,
        v: vec3,
        C: mat33,
        F: mat33,
        mu: real,
        lam: real,
        mass: real,
        volume: real,
        layout: int,
        dt: real,
        inv_dx: real,
        z0: real,
        columns: Columns,
    ):
        """What a particle gives to the grid, mass, momentum and stress impulse: its lowest node,
        its place above that, its coefficients."""
        node, f = place_on_grid(layout, x, inv_dx, z0, columns)
        T = (-dt * volume * inv_dx) * stress(F, mu, lam)
        return node, f, coefficients(f, mass * v, mass, (mass / inv_dx) * C, T)

    @wp.func
    def scatter_particle(
        w: int,
        p: int,
        row: int,
        layout: int,
        slot: int,
        dt: real,
        inv_dx: real,
        z0: real,
        matter: Matter,
        state: State,
        columns: Columns,
        grid: wp.array2d(dtype=vec4),  # [slots, M] momentum and mass
    ):
        """Add a particle's mass, momentum and stress impulse to its 27 nodes."""
        node, f, c = given_by(
            state.x[row, p], state.v[row, p], state.C[row, p], state.F[row, p], matter.mu[w, p],
            matter.lam[w, p], matter.mass[w], matter.volume, layout, dt, inv_dx, z0, columns,
        )  # fmt: skip
        scatter(grid, slot, columns.start, layout, node, f, c)

    @wp.func
    def given_back(
        x: vec3,
        v: vec3,
        C: mat33,
        F: mat33,
        mu: real,
        lam: real,
        mass: real,
        volume: real,
        layout: int,
        slot: int,
        dt: real,
        inv_dx: real,
        z0: real,
        columns: Columns,
        grid_bar: wp.array2d(dtype=vec4),
    ):
        """Derivatives by what ``given_by`` took: x, v, C, F, mu, lam, mass."""
        node, f, c = given_by(x, v, C, F, mu, lam, mass, volume, layout, dt, inv_dx, z0, columns)
        R = gather_with_slope(grid_bar, slot, columns.start, layout, node, f, c)
        H = vec3(R[0, 0], R[0, 1], R[0, 2])
        share = mass / inv_dx
        A_bar = affine_of(f, R)
        impulse = -dt * volume * inv_dx
        F_bar, mu_bar, lam_bar = stress_back(F, mu, lam, impulse * slopes_of(R))
        x_bar = inv_dx * (vec3(R[7, 0], R[7, 1], R[7, 2]) - share * (wp.transpose(C) * H))
        mass_bar = wp.dot(H, v) + R[0, 3] + wp.ddot(A_bar, C) / inv_dx
        return x_bar, mass * H, share * A_bar, F_bar, mu_bar, lam_bar, mass_bar

    @wp.func
    def scatter_particle_back(
        w: int,
        p: int,
        row: int,
        layout: int,
        slot: int,
        dt: real,
        inv_dx: real,
        z0: real,
        matter: Matter,
        state: State,
        columns: Columns,
        grid_bar: wp.array2d(dtype=vec4),  # [slots, M] by momentum and mass
        bars: MatterBars,
    ):
        """Transpose of ``scatter_particle``; returns the square of what it adds by the state."""
        x_bar, v_bar, C_bar, F_bar, mu_bar, lam_bar, mass_bar = given_back(
            state.x[row, p], state.v[row, p], state.C[row, p], state.F[row, p], matter.mu[w, p],
            matter.lam[w, p], matter.mass[w], matter.volume, layout, slot, dt, inv_dx, z0, columns,
            grid_bar,
        )  # fmt: skip
        bars.x[w, p] = bars.x[w, p] + x_bar
        bars.v[w, p] = v_bar
        bars.C[w, p] = C_bar
        bars.F[w, p] = bars.F[w, p] + F_bar
        bars.mu[w, p] = bars.mu[w, p] + mu_bar
        bars.lam[w, p] = bars.lam[w, p] + lam_bar
        bars.mass[w, p] = bars.mass[w, p] + mass_bar
        return wp.length_sq(x_bar) + wp.length_sq(v_bar) + wp.ddot(F_bar, F_bar)

    @wp.func
    def gather_particle(
        layout: int,
        slot: int,
        x: vec3,
        inv_dx: real,
        z0: real,
        columns: Columns,
        grid: wp.array2d(dtype=vec4),
    ):
        """Velocity v [m/s], affine velocity C [1/s] and velocity gradient [1/s] at a particle.

        C is the moment that APIC carries; the gradient is that of the interpolated velocity by
        which the particle moves, so that F stays the gradient of its motion. A moving least
        squares MPM takes C for both: F then forgets strain as the object crosses cells, and thin
        ropes creep.
        """
        node, f = place_on_grid(layout, x, inv_dx, z0, columns)
        R = gather(grid, slot, columns.start, layout, node, f)
        v = vec3(R[0, 0], R[0, 1], R[0, 2])
        return v, (real(4.0) * inv_dx) * affine_of(f, R), inv_dx * slopes_of(R)

    @wp.func
    def moved(
        x: vec3,
        F: mat33,
        mu: real,
        yield_stress: real,
        layout: int,
        slot: int,
        dt: real,
        inv_dx: real,
        z0: real,
        columns: Columns,
        grid: wp.array2d(dtype=vec4),
    ):
        """A particle's new v, C and F."""
        v, C, D = gather_particle(layout, slot, x, inv_dx, z0, columns, grid)
        return v, C, return_map(F + dt * (D * F), mu, yield_stress)

    @wp.func
    def move_particle(
        w: int,
        p: int,
        row: int,
        row_out: int,
        layout: int,
        slot: int,
        dt: real,
        inv_dx: real,
        z0: real,
        matter: Matter,
        columns: Columns,
        grid: wp.array2d(dtype=vec4),  # [slots, M] velocity and mass
        state: State,
        state_out: State,
    ):
        """Take a particle into the next state; returns its squared speed, and whether J > 0."""
        x = state.x[row, p]
        F = state.F[row, p]
        v, C, F = moved(
            x,
            F,
            matter.mu[w, p],
            matter.yield_stress[w],
            layout,
            slot,
            dt,
            inv_dx,
            z0,
            columns,
            grid,
        )
        state_out.x[row_out, p] = x + dt * v
        state_out.v[row_out, p] = v
        state_out.C[row_out, p] = C
        state_out.F[row_out, p] = F
        return wp.length_sq(v), wp.determinant(F) > real(0.0)

    @wp.func
    def before_yielding(
        x: vec3,
        F: mat33,
        mu: real,
        yield_stress: real,
        F_bar: mat33,
        layout: int,
        slot: int,
        dt: real,
        inv_dx: real,
        z0: real,
        columns: Columns,
        grid: wp.array2d(dtype=vec4),
    ):
        """Derivatives by the F that was tried, mu and the yield stress from that by the new F."""
        _v, _C, D = gather_particle(layout, slot, x, inv_dx, z0, columns, grid)
        return return_map_back(F + dt * (D * F), mu, yield_stress, F_bar)

    @wp.func
    def taken_by(
        x: vec3,
        F: mat33,
        x_bar: vec3,
        v_bar: vec3,
        C_bar: mat33,
        F_bar: mat33,  # by the F that was tried
        layout: int,
        dt: real,
        inv_dx: real,
        z0: real,
        columns: Columns,
    ):
        """What a particle's derivatives give to the grid's, as ``given_by``."""
        node, f = place_on_grid(layout, x, inv_dx, z0, columns)
        A = (real(4.0) * inv_dx) * C_bar
        T = (dt * inv_dx) * (F_bar * wp.transpose(F))
        return node, f, coefficients(f, v_bar + dt * x_bar, real(0.0), A, T)

    @wp.func
    def moved_back(
        x: vec3,
        F: mat33,
        x_bar: vec3,
        v_bar: vec3,
        C_bar: mat33,
        F_bar: mat33,  # by the F that was tried
        layout: int,
        slot: int,
        dt: real,
        inv_dx: real,
        z0: real,
        columns: Columns,
        grid: wp.array2d(dtype=vec4),  # velocity and mass
    ):
        """Derivatives by the x and F before the substep, but for what goes by way of the grid."""
        node, f, c = taken_by(
            x, F, x_bar, v_bar, C_bar, F_bar, layout, dt, inv_dx, z0, columns
        )  # fmt: skip
        R = gather_with_slope(grid, slot, columns.start, layout, node, f, c)
        V = vec3(R[0, 0], R[0, 1], R[0, 2])
        slope = vec3(R[7, 0], R[7, 1], R[7, 2])
        slope = slope - (real(4.0) * inv_dx) * (wp.transpose(C_bar) * V)
        return x_bar + inv_dx * slope, F_bar + (dt * inv_dx) * (wp.transpose(slopes_of(R)) * F_bar)

    @wp.func
    def move_particle_back(
        w: int,
        p: int,
        row: int,
        layout: int,
        slot: int,
        dt: real,
        inv_dx: real,
        z0: real,
        matter: Matter,
        columns: Columns,
        grid: wp.array2d(dtype=vec4),  # [slots, M] velocity and mass
        state: State,
        grid_bar: wp.array2d(dtype=vec4),  # [slots, M] by velocity
        bars: MatterBars,
    ):
        """Transpose of ``move_particle``; those by v and C have then served their turn."""
        x = state.x[row, p]
        F = state.F[row, p]
        x_bar = bars.x[w, p]
        v_bar = bars.v[w, p]
        C_bar = bars.C[w, p]
        F_bar = bars.F[w, p]
        if yields == 1:
            F_bar, mu_bar, yield_bar = before_yielding(
                x, F, matter.mu[w, p], matter.yield_stress[w], F_bar, layout, slot, dt, inv_dx, z0,
                columns, grid,
            )  # fmt: skip
            bars.mu[w, p] = bars.mu[w, p] + mu_bar
            bars.yield_stress[w, p] = bars.yield_stress[w, p] + yield_bar
        node, f, c = taken_by(
            x, F, x_bar, v_bar, C_bar, F_bar, layout, dt, inv_dx, z0, columns
        )  # fmt: skip
        scatter(grid_bar, slot, columns.start, layout, node, f, c)
        x_bar, F_bar = moved_back(
            x, F, x_bar, v_bar, C_bar, F_bar, layout, slot, dt, inv_dx, z0, columns, grid
        )
        bars.x[w, p] = x_bar
        bars.F[w, p] = F_bar

    @wp.func
    def recovery_share(dt: real, span: int, matter: Matter):
        """Share of the way that F goes to the positions' gradient, every ``span`` substeps."""
        return real(1.0) - wp.exp(-matter.recovery * dt * real(span))

    @wp.func
    def lattice_gradient(p: int, row: int, matter: Matter, state: State):
        """Gradient of the motion from differences to the neighbours in the rest lattice [-]."""
        lattice = matter.lattice
        a = state.x[row, lattice[p, 0, 1]] - state.x[row, lattice[p, 0, 0]]
        b = state.x[row, lattice[p, 1, 1]] - state.x[row, lattice[p, 1, 0]]
        c = state.x[row, lattice[p, 2, 1]] - state.x[row, lattice[p, 2, 0]]
        return wp.matrix_from_cols(a, b, c) * matter.rest_frame[p]

    @wp.func
    def recovered(F: mat33, G: mat33, blend: real):
        """F drawn towards the gradient G of the positions, unless that means nothing."""
        result = F
        if wp.determinant(G) > real(SMALLEST_VOLUME):
            result = F + blend * (G - F)
        return result

    @wp.func
    def recover_particle(p: int, row: int, blend: real, matter: Matter, state: State):
        """Draw F towards the differences of positions to the neighbours in the rest lattice.

        An F summed up over time slowly loses strain that the grid does not see; positions do not.
        Where neighbours have changed sides (a crumpled sheet) their differences mean nothing, and
        F stays as it is.
        """
        G = lattice_gradient(p, row, matter, state)
        state.F[row, p] = recovered(state.F[row, p], G, blend)

    @wp.func
    def recover_particle_back(
        w: int, p: int, row: int, blend: real, matter: Matter, state: State, bars: MatterBars
    ):
        """Transpose of ``recover_particle``."""
        G = lattice_gradient(p, row, matter, state)
        if wp.determinant(G) > real(SMALLEST_VOLUME):
            F_bar = bars.F[w, p]
            D_bar = (blend * F_bar) * wp.transpose(matter.rest_frame[p])
            for axis in range(3):
                change = vec3(D_bar[0, axis], D_bar[1, axis], D_bar[2, axis])
                wp.atomic_add(bars.x, w, matter.lattice[p, axis, 1], change)
                wp.atomic_sub(bars.x, w, matter.lattice[p, axis, 0], change)
            bars.F[w, p] = (real(1.0) - blend) * F_bar

    return SimpleNamespace(
        Matter=Matter,
        State=State,
        MatterBars=MatterBars,
        window=stencil.window,
        collect=stencil.collect,
        hand_over=stencil.hand_over,
        place_on_grid=place_on_grid,
        given_by=given_by,
        given_back=given_back,
        moved=moved,
        yields=yields,
        before_yielding=before_yielding,
        taken_by=taken_by,
        moved_back=moved_back,
        smallest_volume=SMALLEST_VOLUME,
        recovered=recovered,
        scatter_particle=scatter_particle,
        scatter_particle_back=scatter_particle_back,
        move_particle=move_particle,
        move_particle_back=move_particle_back,
        recovery_share=recovery_share,
        recover_particle=recover_particle,
        recover_particle_back=recover_particle_back,
    )
