"""What particles exchange, with the grid and with their neighbours in an elastic body.

APIC transfers with quadratic B-splines: Jiang et al. (2015), "The affine particle-in-cell
method"; Jiang et al. (2016), "The material point method for simulating continuum materials".

**Elastic bodies** remember their shape at rest: F of a particle is what the differences of
positions to its neighbours in the rest lattice say, the elastic energy is a function of positions
alone, and its derivatives are the forces that the particles give to the grid (Jiang, Gast and Teran
2017, "Anisotropic elastoplasticity for cloth, knit and hair frictional contact": Lagrangian forces
in the material point method). No energy comes from nowhere.

**Bodies that yield** have no such shape. F follows the gradient of the interpolated velocity, the
field by which particles move, and stress goes to the grid by the weights' slopes. (A moving least
squares MPM, Hu et al. 2018, takes C for both: F then forgets strain as a body crosses cells.)

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
from gendom.sim.lanes import make_lanes
from gendom.sim.rounding import make_rounding
from gendom.sim.stencil import make_stencil


@functools.cache
def make_transfers(real: Any, law: Law, *, straight: bool = False) -> SimpleNamespace:
    """Build the types and functions for one scalar type and one material.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        law: See ``gendom.materials.laws``.
        straight: See ``make_stencil``.

    Returns:
        Namespace with the structs ``Matter``, ``State`` and ``MatterBars``, and with
        ``tense_particle``, ``scatter_particle``, ``move_particle`` and the transpose of each.
    """
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)
    mat33 = wp.types.matrix((3, 3), real)
    stencil = make_stencil(real, slopes=law.plastic, straight=straight)
    sums = stencil.sums
    lanes = make_lanes(real)
    pull_type = lanes.pull
    pulled = lanes.pulled
    tense_together = lanes.tense_together
    tense_together_back = lanes.tense_together_back
    width = wp.constant(lanes.width)
    scatter = stencil.scatter
    gather = stencil.gather
    gather_with_slope = stencil.gather_with_slope
    stress = law.stress
    stress_back = law.stress_back
    return_map = law.return_map
    return_map_back = law.return_map_back
    yields = wp.constant(1 if law.plastic else 0)
    rounding = make_rounding(real)
    rounds, sum_up = rounding.rounds, rounding.sum_up
    PLACE = wp.constant(7 if law.plastic else 4)

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
        frame: wp.array2d(dtype=real)  # [6, N] its upper triangle but for a rotation

    @wp.struct
    class State:
        """Particles, a row for each world or each recorded substep."""

        x: wp.array2d(dtype=vec3)  # [rows, N] [m]
        v: wp.array2d(dtype=vec3)  # [rows, N] [m/s]
        C: wp.array2d(dtype=mat33)  # [rows, N] [1/s]
        F: wp.array2d(dtype=mat33)  # [rows, N], of bodies that yield
        # [W, N] what x leaves out of the position by rounding [m], in float32; not by rows
        low: wp.array2d(dtype=vec3)

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

    # ---- an elastic body's own forces --------------------------------------------------------

    @wp.func
    def differences(p: int, row: int, matter: Matter, of: wp.array2d(dtype=vec3)):
        """Differences [3, axis] of ``of`` between a particle's neighbours along the lattice."""
        near = matter.lattice
        return wp.matrix_from_cols(
            of[row, near[p, 0, 1]] - of[row, near[p, 0, 0]],
            of[row, near[p, 1, 1]] - of[row, near[p, 1, 0]],
            of[row, near[p, 2, 1]] - of[row, near[p, 2, 0]],
        )

    @wp.func
    def by_axes(H: mat33):
        """Pulls [3, axis] as they are stored."""
        return pull_type(
            H[0, 0], H[1, 0], H[2, 0], real(0.0),
            H[0, 1], H[1, 1], H[2, 1], real(0.0),
            H[0, 2], H[1, 2], H[2, 2], real(0.0),
        )  # fmt: skip

    @wp.func
    def tension(D: mat33, rest_frame: mat33, mu: real, lam: real, dt: real, volume: real):
        """Impulses [3, axis] by which a particle's stress draws its neighbours together, from
        their differences, and whether it is upright (J > 0)."""
        F = D * rest_frame
        P = stress(F, mu, lam)
        return (dt * volume) * (P * wp.transpose(rest_frame)), wp.determinant(F) > real(0.0)

    @wp.func
    def tension_back(
        D: mat33, rest_frame: mat33, mu: real, lam: real, dt: real, volume: real, pull_bar: mat33
    ):
        """Derivatives by the differences, mu and lam from that by the pulls."""
        P_bar = (dt * volume) * (pull_bar * rest_frame)
        F_bar, mu_bar, lam_bar = stress_back(D * rest_frame, mu, lam, P_bar)
        return F_bar * wp.transpose(rest_frame), mu_bar, lam_bar

    @wp.func
    def tense_particle(
        w: int,
        p: int,
        row: int,
        dt: real,
        matter: Matter,
        state: State,
        pulls: wp.array2d(dtype=pull_type),  # [W, N]
    ):
        """Set a particle's pulls on its neighbours; returns whether it is upright."""
        pull, upright = tension(
            differences(p, row, matter, state.x), matter.rest_frame[p], matter.mu[w, p],
            matter.lam[w, p], dt, matter.volume,
        )  # fmt: skip
        pulls[w, p] = by_axes(pull)
        return upright

    @wp.func
    def tense_one_by_one(
        w: int,
        row: int,
        dt: real,
        matter: Matter,
        state: State,
        pulls: wp.array2d(dtype=pull_type),
    ):
        """Set all pulls of a body; returns a particle that is not upright, or -1."""
        culprit = int(-1)
        p = int(0)
        while p < state.x.shape[1]:
            if not tense_particle(w, p, row, dt, matter, state, pulls):
                culprit = p
            p += 1
        return culprit

    @wp.func
    def tense_side_by_side(
        w: int,
        row: int,
        dt: real,
        matter: Matter,
        state: State,
        pulls: wp.array2d(dtype=pull_type),
    ):
        """The same, faster, on the CPU."""
        N = state.x.shape[1]
        if N < width:
            return tense_one_by_one(w, row, dt, matter, state, pulls)
        culprit = int(-1)
        p = int(0)
        while p < N:
            # the last ones together with some that are done already
            found = tense_together(
                w, wp.min(p, N - width), state.x, row, matter.lattice, matter.frame, matter.mu,
                matter.lam, dt * matter.volume, pulls,
            )  # fmt: skip
            culprit = wp.max(culprit, found)
            p += width
        return culprit

    @wp.func
    def tense_particle_back(
        w: int,
        p: int,
        row: int,
        dt: real,
        matter: Matter,
        state: State,
        bars: MatterBars,
        stretches: wp.array2d(dtype=pull_type),  # [W, N], as pulls
    ):
        """Transpose of ``tense_particle`` and ``pulled`` but for its last step, ``slacken``.

        Sets the derivatives by the differences; those by impulses are found in those by v.
        """
        # a pull draws one neighbour forth and the other back
        pull_bar = (real(-1.0) / matter.mass[w]) * differences(p, w, matter, bars.v)
        D_bar, mu_bar, lam_bar = tension_back(
            differences(p, row, matter, state.x), matter.rest_frame[p], matter.mu[w, p],
            matter.lam[w, p], dt, matter.volume, pull_bar,
        )  # fmt: skip
        stretches[w, p] = by_axes(D_bar)
        bars.mu[w, p] = bars.mu[w, p] + mu_bar
        bars.lam[w, p] = bars.lam[w, p] + lam_bar

    @wp.func
    def tense_one_by_one_back(
        w: int,
        row: int,
        dt: real,
        matter: Matter,
        state: State,
        bars: MatterBars,
        stretches: wp.array2d(dtype=pull_type),
    ):
        p = int(0)
        while p < state.x.shape[1]:
            tense_particle_back(w, p, row, dt, matter, state, bars, stretches)
            p += 1

    @wp.func
    def tense_side_by_side_back(
        w: int,
        row: int,
        dt: real,
        matter: Matter,
        state: State,
        bars: MatterBars,
        stretches: wp.array2d(dtype=pull_type),
    ):
        N = state.x.shape[1]
        if N < width:
            tense_one_by_one_back(w, row, dt, matter, state, bars, stretches)
        else:
            p = int(0)
            while p < N:
                tense_together_back(
                    w, wp.min(p, N - width), p, state.x, row, matter.lattice, matter.frame,
                    matter.mu, matter.lam, -(dt * matter.volume) / matter.mass[w], bars.v, bars.mu,
                    bars.lam, stretches,
                )  # fmt: skip
                p += width

    @wp.func
    def slacken(
        w: int, p: int, matter: Matter, bars: MatterBars, stretches: wp.array2d(dtype=pull_type)
    ):
        """Add to the derivatives by a particle's position those by all differences."""
        bars.x[w, p] = bars.x[w, p] - pulled(p, matter.lattice, stretches, w)

    together = law.name == "neo-hookean"
    tense_body = tense_side_by_side if together else tense_one_by_one
    tense_body_back = tense_side_by_side_back if together else tense_one_by_one_back

    # ---- particles and grid --------------------------------------------------------------------

    @wp.func
    def coefficients_by_slopes(f: vec3, q: vec3, mass: real, A: mat33, T: mat33):
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
    def coefficients_without(f: vec3, q: vec3, mass: real, A: mat33, T: mat33):
        """The same without T."""
        q0 = q - A * f
        return sums(
            q0[0], q0[1], q0[2], mass,
            A[0, 0], A[1, 0], A[2, 0], real(0.0),
            A[0, 1], A[1, 1], A[2, 1], real(0.0),
            A[0, 2], A[1, 2], A[2, 2], real(0.0),
        )  # fmt: skip

    coefficients = coefficients_by_slopes if law.plastic else coefficients_without

    @wp.func
    def affine_of(f: vec3, R: Any):
        """Derivative by A of ``coefficients`` from that by the coefficients."""
        return mat33(
            R[1, 0] - f[0] * R[0, 0], R[2, 0] - f[1] * R[0, 0], R[3, 0] - f[2] * R[0, 0],
            R[1, 1] - f[0] * R[0, 1], R[2, 1] - f[1] * R[0, 1], R[3, 1] - f[2] * R[0, 1],
            R[1, 2] - f[0] * R[0, 2], R[2, 2] - f[1] * R[0, 2], R[3, 2] - f[2] * R[0, 2],
        )  # fmt: skip

    @wp.func
    def without_slopes(R: Any):
        return mat33()

    @wp.func
    def with_slopes(R: Any):
        """Derivative by T of ``coefficients`` from that by the coefficients."""
        return mat33(
            R[4, 0], R[5, 0], R[6, 0],
            R[4, 1], R[5, 1], R[6, 1],
            R[4, 2], R[5, 2], R[6, 2],
        )  # fmt: skip

    slopes_of = with_slopes if law.plastic else without_slopes

    @wp.func
    def place_of(R: Any):
        """Derivative by the place in cells, the last row of ``gather_with_slope``."""
        return vec3(R[PLACE, 0], R[PLACE, 1], R[PLACE, 2])

    @wp.func
    def stress_by_slopes(F: mat33, mu: real, lam: real):
        """Kirchhoff stress, which the weights' slopes give to the grid [Pa]."""
        return stress(F, mu, lam) * wp.transpose(F)

    @wp.func
    def given_by(
        x: vec3,
        q: vec3,
        C: mat33,
        T: mat33,
        mass: real,
        layout: int,
        inv_dx: real,
        z0: real,
        columns: Columns,
    ):
        """What a particle gives to the grid, its mass, momentum q and T: its lowest node, its
        place above that, its coefficients."""
        node, f = place_on_grid(layout, x, inv_dx, z0, columns)
        return node, f, coefficients(f, q, mass, (mass / inv_dx) * C, T)

    @wp.func
    def given_back(
        x: vec3,
        v: vec3,
        q: vec3,
        C: mat33,
        T: mat33,
        mass: real,
        layout: int,
        slot: int,
        inv_dx: real,
        z0: real,
        columns: Columns,
        grid_bar: wp.array2d(dtype=vec4),
    ):
        """Derivatives by x, v, C, T and mass, where v is that part of q that goes by the mass."""
        node, f, c = given_by(x, q, C, T, mass, layout, inv_dx, z0, columns)
        R = gather_with_slope(grid_bar, slot, columns.start, layout, node, f, c)
        u = vec3(R[0, 0], R[0, 1], R[0, 2])
        share = mass / inv_dx
        A_bar = affine_of(f, R)
        x_bar = inv_dx * (place_of(R) - share * (wp.transpose(C) * u))
        mass_bar = wp.dot(u, v) + R[0, 3] + wp.ddot(A_bar, C) / inv_dx
        return x_bar, mass * u, share * A_bar, slopes_of(R), mass_bar

    @wp.func
    def impulse_of_stress(F: mat33, mu: real, lam: real, dt: real, volume: real, inv_dx: real):
        """T of a particle whose stress goes to the grid by the weights' slopes."""
        return (-dt * volume * inv_dx) * stress_by_slopes(F, mu, lam)

    @wp.func
    def impulse_of_stress_back(
        F: mat33, mu: real, lam: real, dt: real, volume: real, inv_dx: real, T_bar: mat33
    ):
        """Derivatives by F, mu and lam from that by T."""
        tau_bar = (-dt * volume * inv_dx) * T_bar
        F_bar, mu_bar, lam_bar = stress_back(F, mu, lam, tau_bar * F)
        return F_bar + wp.transpose(tau_bar) * stress(F, mu, lam), mu_bar, lam_bar

    @wp.func
    def impulses(
        w: int,
        p: int,
        row: int,
        dt: real,
        inv_dx: real,
        matter: Matter,
        state: State,
        pulls: wp.array2d(dtype=pull_type),  # [W, N]
    ):
        """Momentum of a particle with its neighbours' pulls, or else T."""
        q = matter.mass[w] * state.v[row, p]
        T = mat33()
        if yields == 1:
            T = impulse_of_stress(
                state.F[row, p], matter.mu[w, p], matter.lam[w, p], dt, matter.volume, inv_dx
            )
        else:
            q += pulled(p, matter.lattice, pulls, w)
        return q, T

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
        pulls: wp.array2d(dtype=pull_type),  # [W, N]
        columns: Columns,
        grid: wp.array2d(dtype=vec4),  # [slots, M] momentum and mass
    ):
        """Add a particle's mass, momentum and impulses to its 27 nodes."""
        q, T = impulses(w, p, row, dt, inv_dx, matter, state, pulls)
        node, f, c = given_by(
            state.x[row, p], q, state.C[row, p], T, matter.mass[w], layout, inv_dx, z0, columns
        )
        scatter(grid, slot, columns.start, layout, node, f, c)

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
        pulls: wp.array2d(dtype=pull_type),  # [W, N]
        columns: Columns,
        grid_bar: wp.array2d(dtype=vec4),  # [slots, M] by momentum and mass
        bars: MatterBars,
    ):
        """Transpose of ``scatter_particle``; returns the square of what it adds by the state.

        Of the pulls' derivatives nothing is stored: ``tense_particle_back`` has them from v's.
        """
        q, T = impulses(w, p, row, dt, inv_dx, matter, state, pulls)
        x_bar, v_bar, C_bar, T_bar, mass_bar = given_back(
            state.x[row, p], state.v[row, p], q, state.C[row, p], T, matter.mass[w], layout, slot,
            inv_dx, z0, columns, grid_bar,
        )  # fmt: skip
        bars.x[w, p] = bars.x[w, p] + x_bar
        bars.v[w, p] = v_bar
        bars.C[w, p] = C_bar
        bars.mass[w, p] = bars.mass[w, p] + mass_bar
        size = wp.length_sq(x_bar) + wp.length_sq(v_bar)
        if yields == 1:
            F_bar, mu_bar, lam_bar = impulse_of_stress_back(
                state.F[row, p], matter.mu[w, p], matter.lam[w, p], dt, matter.volume, inv_dx,
                T_bar,
            )  # fmt: skip
            bars.F[w, p] = bars.F[w, p] + F_bar
            bars.mu[w, p] = bars.mu[w, p] + mu_bar
            bars.lam[w, p] = bars.lam[w, p] + lam_bar
            size += wp.ddot(F_bar, F_bar)
        return size

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
        """Velocity v [m/s], affine velocity C [1/s] and, of bodies that yield, the gradient of the
        interpolated velocity [1/s] at a particle. C is the moment that APIC carries."""
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
        """A particle's new v, C and, if it yields, F."""
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
        """Take a particle into the next state; returns its squared speed, and whether an F of its
        own is upright (J > 0)."""
        x = state.x[row, p]
        upright = True
        v = vec3()
        C = mat33()
        if yields == 1:
            v, C, F = moved(
                x, state.F[row, p], matter.mu[w, p], matter.yield_stress[w], layout, slot, dt,
                inv_dx, z0, columns, grid,
            )  # fmt: skip
            state_out.F[row_out, p] = F
            upright = wp.determinant(F) > real(0.0)
        else:
            v, C, _D = gather_particle(layout, slot, x, inv_dx, z0, columns, grid)
        if rounds == 1:
            there, low = sum_up(x, dt * v, state.low[w, p])
            state_out.x[row_out, p] = there
            state.low[w, p] = low
        else:
            state_out.x[row_out, p] = x + dt * v
        state_out.v[row_out, p] = v
        state_out.C[row_out, p] = C
        return wp.length_sq(v), upright

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
        x_bar: vec3,
        v_bar: vec3,
        C_bar: mat33,
        T: mat33,
        layout: int,
        dt: real,
        inv_dx: real,
        z0: real,
        columns: Columns,
    ):
        """What a particle's derivatives give to the grid's, as ``given_by``.

        T is dt / dx F_bar F^T of an F that was tried.
        """
        node, f = place_on_grid(layout, x, inv_dx, z0, columns)
        A = (real(4.0) * inv_dx) * C_bar
        return node, f, coefficients(f, v_bar + dt * x_bar, real(0.0), A, T)

    @wp.func
    def moved_back(
        x: vec3,
        x_bar: vec3,
        v_bar: vec3,
        C_bar: mat33,
        T: mat33,
        layout: int,
        slot: int,
        dt: real,
        inv_dx: real,
        z0: real,
        columns: Columns,
        grid: wp.array2d(dtype=vec4),  # velocity and mass
    ):
        """Derivative by the x before the substep, but for what goes by way of the grid, and the
        gradient of the velocity."""
        node, f, c = taken_by(x, x_bar, v_bar, C_bar, T, layout, dt, inv_dx, z0, columns)
        R = gather_with_slope(grid, slot, columns.start, layout, node, f, c)
        v = vec3(R[0, 0], R[0, 1], R[0, 2])
        slope = place_of(R) - (real(4.0) * inv_dx) * (wp.transpose(C_bar) * v)
        return x_bar + inv_dx * slope, inv_dx * slopes_of(R)

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
        x_bar = bars.x[w, p]
        v_bar = bars.v[w, p]
        C_bar = bars.C[w, p]
        T = mat33()
        if yields == 1:
            F = state.F[row, p]
            F_bar, mu_bar, yield_bar = before_yielding(
                x, F, matter.mu[w, p], matter.yield_stress[w], bars.F[w, p], layout, slot, dt,
                inv_dx, z0, columns, grid,
            )  # fmt: skip
            bars.mu[w, p] = bars.mu[w, p] + mu_bar
            bars.yield_stress[w, p] = bars.yield_stress[w, p] + yield_bar
            bars.F[w, p] = F_bar
            T = (dt * inv_dx) * (F_bar * wp.transpose(F))
        node, f, c = taken_by(x, x_bar, v_bar, C_bar, T, layout, dt, inv_dx, z0, columns)
        scatter(grid_bar, slot, columns.start, layout, node, f, c)
        x_bar, D = moved_back(
            x, x_bar, v_bar, C_bar, T, layout, slot, dt, inv_dx, z0, columns, grid
        )
        bars.x[w, p] = x_bar
        if yields == 1:
            bars.F[w, p] = bars.F[w, p] + dt * (wp.transpose(D) * bars.F[w, p])

    return SimpleNamespace(
        Matter=Matter,
        State=State,
        MatterBars=MatterBars,
        window=stencil.window,
        collect=stencil.collect,
        hand_over=stencil.hand_over,
        yields=yields,
        pulled=pulled,
        tension=tension,
        tension_back=tension_back,
        tense_particle=tense_particle,
        tense_body=tense_body,
        tense_body_back=tense_body_back,
        tense_one_by_one=tense_one_by_one,
        pull_type=pull_type,
        tense_particle_back=tense_particle_back,
        slacken=slacken,
        gather_particle=gather_particle,
        given_by=given_by,
        scatter_plane=stencil.scatter_plane,
        get_node=stencil.get_node,
        put_node=stencil.put_node,
        given_back=given_back,
        impulse_of_stress=impulse_of_stress,
        impulse_of_stress_back=impulse_of_stress_back,
        rounds=rounds,
        moved=moved,
        before_yielding=before_yielding,
        taken_by=taken_by,
        moved_back=moved_back,
        place_on_grid=place_on_grid,
        scatter_particle=scatter_particle,
        scatter_particle_back=scatter_particle_back,
        move_particle=move_particle,
        move_particle_back=move_particle_back,
    )
