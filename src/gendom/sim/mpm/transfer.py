"""What particles and grid exchange: APIC transfers with quadratic B-splines.

For a particle at x_p with mass m_p, momentum q_p (with the impulses of the substep) and affine
velocity C_p, and for nodes at x_i:

    p2g:  m_i = sum_p w_ip m_p            (m u)_i = sum_p w_ip (q_p + m_p C_p (x_i - x_p))
    g2p:  v_p = sum_i w_ip u_i            C_p = 4 / dx^2 sum_i w_ip u_i (x_i - x_p)^T

Source: Jiang et al. (2015), "The affine particle-in-cell method". A NumPy twin of the substep
stands in ``tests/sim/numpy_mpm.py``. Each function has its transpose beside it (``..._adjoint``),
which carries derivatives of a loss from results to arguments.

Shapes: W worlds, N particles, L layouts of the grid (see ``grid``), M grid nodes.
"""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.mpm.types import make_types
from gendom.sim.native import functions_of


@functools.cache
def make_bspline(real: Any, *, windowed: bool) -> SimpleNamespace:
    """The sums over 27 nodes of ``native/bspline.h`` for one scalar type.

    All take a grid's array, its row and its layout (see ``grid``), the particle's lowest node
    (column i and j of the layout, level), and the particle's place f above that node in cells.

    ``scatter`` holds a ``window`` back on CUDA, which ``flush`` gives to the grid; ``sums`` is the
    matrix of coefficients, ``row_at`` the address of a row.
    """
    types = make_types(real)
    vec3, vec4 = types.vec3, types.vec4
    nodes = wp.array2d(dtype=vec4)
    columns = wp.array3d(dtype=wp.int32)
    sums = wp.types.matrix((4, 4), real)
    sums_and_slope = wp.types.matrix((5, 4), real)
    window_type = wp.types.matrix((27 if windowed else 1, 4), real)

    @wp.func_native("return gendom::scatter(window, held, node, f, c, grid, row, start, layout);")
    def scatter(
        window: window_type, held: wp.vec3i, node: wp.vec3i, f: vec3, c: sums, grid: nodes,
        row: int, start: columns, layout: int,
    ) -> window_type: ...  # fmt: skip

    @wp.func_native("gendom::flush(window, held, grid, row, start, layout);")
    def flush(
        window: window_type, held: wp.vec3i, grid: nodes, row: int, start: columns, layout: int
    ): ...

    @wp.func_native("return gendom::gather<4>(grid, row, start, layout, node, f);")
    def gather(
        grid: nodes, row: int, start: columns, layout: int, node: wp.vec3i, f: vec3
    ) -> sums: ...

    @wp.func_native("return gendom::gather<5>(grid, row, start, layout, node, f, c);")
    def gather_with_slope(
        grid: nodes, row: int, start: columns, layout: int, node: wp.vec3i, f: vec3, c: sums
    ) -> sums_and_slope: ...

    @wp.func_native("return (wp::uint64)&wp::index(grid, row, 0);")
    def row_at(grid: nodes, row: int) -> wp.uint64: ...

    @wp.func_native("gendom::clear(grid, row, thread, threads, count);")
    def clear(grid: nodes, row: int, thread: int, threads: int, count: int): ...

    @wp.func_native(
        "gendom::normalise(momentum, row, velocity, row_out, thread, threads, count, keep, empty);"
    )
    def normalise(
        momentum: nodes, row: int, velocity: nodes, row_out: int, thread: int, threads: int,
        count: int, keep: real, empty: int,
    ): ...  # fmt: skip

    @wp.func_native(
        "return gendom::normalise_adjoint(momentum, row, adjoint, row_out, thread, threads, count,"
        " keep);"
    )
    def normalise_adjoint(
        momentum: nodes, row: int, adjoint: nodes, row_out: int, thread: int, threads: int,
        count: int, keep: real,
    ) -> wp.float64: ...  # fmt: skip

    return SimpleNamespace(**vars(functions_of(locals())), sums=sums, window=window_type)


@functools.cache
def make_transfer(real: Any) -> SimpleNamespace:
    """Build the transfers for one scalar type."""
    types = make_types(real)
    Substep, Grid = types.Substep, types.Grid
    vec3, mat33 = types.vec3, types.mat33
    bspline = make_bspline(real, windowed=False)

    @wp.func
    def locate(now: Substep, x: vec3, grid: Grid):
        """Lowest of a particle's 27 nodes in a layout, and the place f above it in cells."""
        y = x * now.inv_dx
        i = int(wp.floor(y[0] - real(0.5)))
        j = int(wp.floor(y[1] - real(0.5)))
        k = int(wp.floor(y[2] - real(0.5)))
        node = wp.vec3i(i - grid.bounds[now.layout, 0], j - grid.bounds[now.layout, 1], k)
        return node, y - vec3(real(i), real(j), real(k))

    @wp.func
    def coefficients(f: vec3, q: vec3, mass: real, A: mat33):
        """Of momentum q and ``mass`` at the particle, and A times the distance from it in cells."""
        q0 = q - A * f
        return bspline.sums(
            q0[0], q0[1], q0[2], mass, A[0, 0], A[1, 0], A[2, 0], real(0.0), A[0, 1], A[1, 1],
            A[2, 1], real(0.0), A[0, 2], A[1, 2], A[2, 2], real(0.0),
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
    def given_by(now: Substep, x: vec3, q: vec3, C: mat33, grid: Grid):
        """What a particle gives to the grid: its lowest node, its place above, its coefficients."""
        node, f = locate(now, x, grid)
        return node, f, coefficients(f, q, now.mass, (now.mass / now.inv_dx) * C)

    @wp.func
    def p2g_adjoint(now: Substep, x: vec3, q: vec3, C: mat33, grid: Grid):
        """Derivatives by x, q, C and mass from those by the nodes."""
        node, f, c = given_by(now, x, q, C, grid)
        R = bspline.gather_with_slope(
            grid.velocity_bar, now.row, grid.start, now.layout, node, f, c
        )
        u = vec3(R[0, 0], R[0, 1], R[0, 2])
        A_bar = affine_of(f, R)
        share = now.mass / now.inv_dx
        x_bar = now.inv_dx * (vec3(R[4, 0], R[4, 1], R[4, 2]) - share * (wp.transpose(C) * u))
        by_mass = R[0, 3] + wp.ddot(A_bar, C) / now.inv_dx
        return x_bar, u, share * A_bar, by_mass

    @wp.func
    def g2p(now: Substep, x: vec3, grid: Grid):
        """Velocity v [m/s] and affine velocity C [1/s] of a particle from those of the nodes."""
        node, f = locate(now, x, grid)
        R = bspline.gather(grid.velocity, now.row, grid.start, now.layout, node, f)
        return vec3(R[0, 0], R[0, 1], R[0, 2]), (real(4.0) * now.inv_dx) * affine_of(f, R)

    @wp.func
    def taken_by(now: Substep, x: vec3, v_bar: vec3, C_bar: mat33, grid: Grid):
        """What a particle's derivatives give to the grid's, as ``given_by``."""
        node, f = locate(now, x, grid)
        return node, f, coefficients(f, v_bar, real(0.0), (real(4.0) * now.inv_dx) * C_bar)

    @wp.func
    def g2p_adjoint(now: Substep, x: vec3, v_bar: vec3, C_bar: mat33, grid: Grid):
        """Derivative by the x at which the grid was read; that by the nodes is ``taken_by``."""
        node, f, c = taken_by(now, x, v_bar, C_bar, grid)
        R = bspline.gather_with_slope(grid.velocity, now.row, grid.start, now.layout, node, f, c)
        v = vec3(R[0, 0], R[0, 1], R[0, 2])
        return now.inv_dx * (
            vec3(R[4, 0], R[4, 1], R[4, 2]) - (real(4.0) * now.inv_dx) * (wp.transpose(C_bar) * v)
        )

    return functions_of(locals())
