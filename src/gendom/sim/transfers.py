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

from gendom.sim.stencil import make_stencil

SMALLEST_VOLUME = 0.2
"""Relative volume below which positions no longer tell F."""


@functools.cache
def make_transfers(real: Any, stress: Any, stress_back: Any) -> SimpleNamespace:
    """Build the functions for one scalar type and one material.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        stress: Stress of a law and its transpose, see ``gendom.materials.laws``.
        stress_back: The latter.

    Returns:
        Namespace with ``scatter_particle``, ``gather_particle``, ``recovered_gradient`` and the
        transpose of each.
    """
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)
    mat33 = wp.types.matrix((3, 3), real)
    stencil = make_stencil(real)
    scatter = stencil.scatter
    gather = stencil.gather
    gather_with_slope = stencil.gather_with_slope

    @wp.func
    def place_on_grid(x: vec3, inv_dx: real, z0: real):
        """Lowest of a particle's 27 nodes, and how many cells above it the particle lies."""
        y = vec3(x[0], x[1], x[2] - z0) * inv_dx
        bx = int(wp.floor(y[0] - real(0.5)))
        by = int(wp.floor(y[1] - real(0.5)))
        bz = int(wp.floor(y[2] - real(0.5)))
        return bx, by, bz, y[0] - real(bx), y[1] - real(by), y[2] - real(bz)

    @wp.func
    def column(A: mat33, b: int):
        """Column b of A, with an empty fourth lane."""
        return vec4(A[0, b], A[1, b], A[2, b], real(0.0))

    @wp.func
    def columns_of(a: vec4, b: vec4, c: vec4):
        """The matrix with these columns, without their fourth lane."""
        return mat33(
            a[0], b[0], c[0],
            a[1], b[1], c[1],
            a[2], b[2], c[2],
        )  # fmt: skip

    @wp.func
    def scatter_particle(
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
        layout: int,
        bounds: wp.array2d(dtype=wp.int32),
        start: wp.array3d(dtype=wp.int32),
        row: int,
        grid_out: wp.array2d(dtype=vec4),  # [rows, M] momentum and mass
    ):
        """Add a particle's mass, momentum and stress impulse to its 27 nodes."""
        bx, by, bz, fx, fy, fz = place_on_grid(x, inv_dx, z0)
        affine = (mass / inv_dx) * C
        a0 = column(affine, 0)
        a1 = column(affine, 1)
        a2 = column(affine, 2)
        T = (-dt * volume * inv_dx) * stress(F, mu, lam)
        q = vec4(mass * v[0], mass * v[1], mass * v[2], mass) - fx * a0 - fy * a1 - fz * a2
        scatter(
            grid_out, row, start, layout, bx - bounds[layout, 0], by - bounds[layout, 1], bz,
            fx, fy, fz, q, a0, a1, a2, column(T, 0), column(T, 1), column(T, 2),
        )  # fmt: skip

    @wp.func
    def scatter_particle_back(
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
        layout: int,
        bounds: wp.array2d(dtype=wp.int32),
        start: wp.array3d(dtype=wp.int32),
        row: int,
        grid_bar: wp.array2d(dtype=vec4),  # [rows, M] by momentum and mass
    ):
        """Transpose of ``scatter_particle``: derivatives by x, v, C, F, mu, lam and mass."""
        bx, by, bz, fx, fy, fz = place_on_grid(x, inv_dx, z0)
        affine = (mass / inv_dx) * C
        a0 = column(affine, 0)
        a1 = column(affine, 1)
        a2 = column(affine, 2)
        impulse = -dt * volume * inv_dx
        T = impulse * stress(F, mu, lam)
        q = vec4(mass * v[0], mass * v[1], mass * v[2], mass) - fx * a0 - fy * a1 - fz * a2
        R = gather_with_slope(
            grid_bar, row, start, layout, bx - bounds[layout, 0], by - bounds[layout, 1], bz,
            fx, fy, fz, q, a0, a1, a2, column(T, 0), column(T, 1), column(T, 2),
        )  # fmt: skip
        H = R[0]
        C_bar = columns_of(R[1] - fx * H, R[2] - fy * H, R[3] - fz * H)
        F_bar, mu_bar, lam_bar = stress_back(F, mu, lam, impulse * columns_of(R[4], R[5], R[6]))
        v_bar = vec3(H[0], H[1], H[2])
        mass_bar = wp.dot(v_bar, v) + H[3] + wp.ddot(C_bar, C) / inv_dx
        x_bar = vec3(R[7, 0] - wp.dot(H, a0), R[7, 1] - wp.dot(H, a1), R[7, 2] - wp.dot(H, a2))
        return (
            inv_dx * x_bar,
            mass * v_bar,
            (mass / inv_dx) * C_bar,
            F_bar,
            mu_bar,
            lam_bar,
            mass_bar,
        )

    @wp.func
    def gather_particle(
        x: vec3,
        inv_dx: real,
        z0: real,
        layout: int,
        bounds: wp.array2d(dtype=wp.int32),
        start: wp.array3d(dtype=wp.int32),
        row: int,
        grid: wp.array2d(dtype=vec4),  # [rows, M] velocity and mass
    ):
        """Velocity v [m/s], affine velocity C [1/s] and velocity gradient [1/s] at a particle.

        C is the moment that APIC carries; the gradient is that of the interpolated velocity by
        which the particle moves, so that F stays the gradient of its motion. A moving least
        squares MPM takes C for both: F then forgets strain as the object crosses cells, and thin
        ropes creep.
        """
        bx, by, bz, fx, fy, fz = place_on_grid(x, inv_dx, z0)
        R = gather(
            grid, row, start, layout, bx - bounds[layout, 0], by - bounds[layout, 1], bz,
            fx, fy, fz,
        )  # fmt: skip
        V = R[0]
        C = columns_of(R[1] - fx * V, R[2] - fy * V, R[3] - fz * V)
        gradient = columns_of(R[4], R[5], R[6])
        return vec3(V[0], V[1], V[2]), (real(4.0) * inv_dx) * C, inv_dx * gradient

    @wp.func
    def gather_particle_back(
        x: vec3,
        v_bar: vec3,
        C_bar: mat33,
        gradient_bar: mat33,
        inv_dx: real,
        z0: real,
        layout: int,
        bounds: wp.array2d(dtype=wp.int32),
        start: wp.array3d(dtype=wp.int32),
        row: int,
        grid: wp.array2d(dtype=vec4),  # [rows, M] velocity and mass
        grid_bar_out: wp.array2d(dtype=vec4),  # [rows, M] by velocity
    ):
        """Transpose of ``gather_particle``: adds to the grid's, returns the derivative by x.

        Returns the velocity gradient [1/s] as well, which the caller needs and which costs
        nothing here.
        """
        bx, by, bz, fx, fy, fz = place_on_grid(x, inv_dx, z0)
        ci = bx - bounds[layout, 0]
        cj = by - bounds[layout, 1]
        c = (real(4.0) * inv_dx) * C_bar
        a0 = column(c, 0)
        a1 = column(c, 1)
        a2 = column(c, 2)
        d = inv_dx * gradient_bar
        t0 = column(d, 0)
        t1 = column(d, 1)
        t2 = column(d, 2)
        q = vec4(v_bar[0], v_bar[1], v_bar[2], real(0.0)) - fx * a0 - fy * a1 - fz * a2
        scatter(grid_bar_out, row, start, layout, ci, cj, bz, fx, fy, fz, q, a0, a1, a2, t0, t1, t2)
        R = gather_with_slope(
            grid, row, start, layout, ci, cj, bz, fx, fy, fz, q, a0, a1, a2, t0, t1, t2
        )
        V = R[0]
        x_bar = vec3(R[7, 0] - wp.dot(V, a0), R[7, 1] - wp.dot(V, a1), R[7, 2] - wp.dot(V, a2))
        return inv_dx * x_bar, inv_dx * columns_of(R[4], R[5], R[6])

    @wp.func
    def lattice_gradient(
        w: int,
        p: int,
        x: wp.array2d(dtype=vec3),
        lattice: wp.array3d(dtype=wp.int32),  # [N, 3, 2]
        rest_frame: wp.array(dtype=mat33),  # [N]
    ):
        """Gradient of the motion from differences to the neighbours in the rest lattice [-]."""
        a = x[w, lattice[p, 0, 1]] - x[w, lattice[p, 0, 0]]
        b = x[w, lattice[p, 1, 1]] - x[w, lattice[p, 1, 0]]
        c = x[w, lattice[p, 2, 1]] - x[w, lattice[p, 2, 0]]
        D = mat33(
            a[0], b[0], c[0],
            a[1], b[1], c[1],
            a[2], b[2], c[2],
        )  # fmt: skip
        return D * rest_frame[p]

    @wp.func
    def recovered_gradient(
        w: int,
        p: int,
        F: mat33,
        blend: real,
        x: wp.array2d(dtype=vec3),
        lattice: wp.array3d(dtype=wp.int32),
        rest_frame: wp.array(dtype=mat33),
    ):
        """F drawn towards the differences of positions to the neighbours in the rest lattice.

        An F summed up over time slowly loses strain that the grid does not see; positions do not.
        Where neighbours have changed sides (a crumpled sheet) their differences mean nothing, and
        F stays as it is.
        """
        G = lattice_gradient(w, p, x, lattice, rest_frame)
        result = F
        if wp.determinant(G) > real(SMALLEST_VOLUME):
            result = F + blend * (G - F)
        return result

    @wp.func
    def recovered_gradient_back(
        w: int,
        p: int,
        F_bar: mat33,
        blend: real,
        row: int,
        x: wp.array2d(dtype=vec3),
        lattice: wp.array3d(dtype=wp.int32),
        rest_frame: wp.array(dtype=mat33),
        x_bar: wp.array2d(dtype=vec3),
    ):
        """Transpose of ``recovered_gradient``: adds to positions', returns the one by F."""
        G = lattice_gradient(row, p, x, lattice, rest_frame)
        result = F_bar
        if wp.determinant(G) > real(SMALLEST_VOLUME):
            D_bar = (blend * F_bar) * wp.transpose(rest_frame[p])
            for axis in range(3):
                change = vec3(D_bar[0, axis], D_bar[1, axis], D_bar[2, axis])
                wp.atomic_add(x_bar, w, lattice[p, axis, 1], change)
                wp.atomic_sub(x_bar, w, lattice[p, axis, 0], change)
            result = (real(1.0) - blend) * F_bar
        return result

    return SimpleNamespace(
        scatter_particle=scatter_particle,
        scatter_particle_back=scatter_particle_back,
        gather_particle=gather_particle,
        gather_particle_back=gather_particle_back,
        recovered_gradient=recovered_gradient,
        recovered_gradient_back=recovered_gradient_back,
    )
