"""Sums over the 27 grid nodes around a particle, the inner loops of every substep.

A particle with coefficients q, a_b, t_b (b = x, y, z; four lanes each) and grid values h_n forms

    P = sum_n h_n . (w_n (q + i a_x + j a_y + k a_z) + w_n,x t_x + w_n,y t_y + w_n,z t_z)

with quadratic B-spline weights w_n of the node (i, j, k) in 0..2 and their derivatives by the
particle's place f in cells. Everything that particles and grid exchange is a derivative of P:
``scatter`` adds dP/dh to the grid, ``gather`` returns dP/dq, dP/da, dP/dt, and the reverse mode
needs dP/df besides. Coefficients, and derivatives by them, are rows q, a_x, a_y, a_z, t_x, t_y, t_z
of a 7 x 4 matrix; where nothing goes by the weights' slopes, t is left out and they are 4 x 4.
B-splines: Steffen, Kirby and Berzins (2008).

Written as native code because Warp's own vectors neither become SIMD lanes on the CPU nor one
vector atomic on CUDA: the same text is compiled for both.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false

import functools
import re
from types import SimpleNamespace
from typing import Any

import warp as wp

FUSED = {
    "cpu_compiler_flags": f"{wp.config.cpu_compiler_flags or '-march=native'}"
    " -ffp-contract=fast -fno-signed-zeros"
}
"""Module options of CPU kernels: products and sums become one rounding, a seventh faster, and sums
that begin with 0 begin with their first term, a twelfth faster."""

_LANES = """
#if defined(__CUDA_ARCH__)
    typedef wp::vec_t<4, REAL> lanes;
    const auto each = [](lanes a, lanes b) { return wp::cw_mul(a, b); };
#else
    typedef REAL lanes __attribute__((ext_vector_type(4), aligned(sizeof(REAL))));
    const auto each = [](lanes a, lanes b) { return a * b; };
#endif
"""

_WEIGHTS = """
    const auto load = [](const REAL* a) { return *(const lanes*)a; };
    const REAL fx = f[0], fy = f[1], fz = f[2];
    const REAL half = REAL(0.5);
    const REAL wx[3] = {half * (REAL(1.5) - fx) * (REAL(1.5) - fx),
                        REAL(0.75) - (fx - REAL(1)) * (fx - REAL(1)),
                        half * (fx - half) * (fx - half)};
    const REAL wy[3] = {half * (REAL(1.5) - fy) * (REAL(1.5) - fy),
                        REAL(0.75) - (fy - REAL(1)) * (fy - REAL(1)),
                        half * (fy - half) * (fy - half)};
    const REAL wz[3] = {half * (REAL(1.5) - fz) * (REAL(1.5) - fz),
                        REAL(0.75) - (fz - REAL(1)) * (fz - REAL(1)),
                        half * (fz - half) * (fz - half)};
    const REAL sx[3] = {fx - REAL(1.5), REAL(-2) * (fx - REAL(1)), fx - half};
    const REAL sy[3] = {fy - REAL(1.5), REAL(-2) * (fy - REAL(1)), fy - half};
    const REAL sz[3] = {fz - REAL(1.5), REAL(-2) * (fz - REAL(1)), fz - half};
"""

_COEFFICIENTS = """
    const lanes Q = load(c.data[0]), A0 = load(c.data[1]), A1 = load(c.data[2]);
    const lanes A2 = load(c.data[3]);
    const lanes T0 = load(c.data[4]), T1 = load(c.data[5]), T2 = load(c.data[6]);  // by slopes
"""

_SPREAD = """
    // not wx[i]: where i is not known beforehand that array would not be in registers
    const auto of_plane = [](const REAL* a, int i) { return i == 0 ? a[0] : i == 1 ? a[1] : a[2]; };
    #pragma unroll
    for (PLANES) {
        const REAL wxi = of_plane(wx, i);
        const REAL sxi = of_plane(sx, i);  // by slopes
        const lanes Qi = Q + A0 * REAL(i);
        #pragma unroll
        for (int j = 0; j < 3; ++j) {
            const int n = COLUMN;
            const REAL w = wxi * wy[j];
            const lanes b = (Qi + A1 * REAL(j)) * w
                + T0 * (sxi * wy[j]) + T1 * (wxi * sy[j])  // by slopes
                ;
            const lanes s = A2 * w;
            const lanes t = T2 * w;  // by slopes
            const auto value = [&](const lanes& a, int k) {
                return a * wz[k]
                    + t * sz[k]  // by slopes
                    ;
            };
            add(n, value(b, 0));
            add(n + 1, value(b + s, 1));
            add(n + 2, value(b + s + s, 2));
        }
    }
"""

_ADD_TO_GRID = """
    wp::vec_t<4, REAL>* nodes = &wp::index(grid, row, 0);
    const auto add = [nodes](int n, const lanes& h) {
#if defined(__CUDA_ARCH__)
        ATOMIC_ADD
#else
        *(lanes*)(nodes + n) += h;
#endif
    };
"""

# what is added to the grid keeps the compiler from loading columns together: it is done before
_COLUMNS = """
    int columns[9];
    #pragma unroll
    for (int n = 0; n < 9; ++n)
        columns[n] = wp::index(start, layout, FIRST[0] + n / 3, FIRST[1] + n % 3) + FIRST[2];
"""

_SCATTER = (
    _COLUMNS.replace("FIRST", "node")
    + _ADD_TO_GRID
    + _SPREAD.replace("COLUMN", "columns[3 * i + j]")
)

_ALL_PLANES = "int i = 0; i < 3; ++i"

_ONE_PLANE = "int i = plane; i <= plane; ++i"

_COLLECT = (
    """
    const auto add = [&window](int n, const lanes& h) { *(lanes*)window.data[n] += h; };
"""
    + _SPREAD.replace("COLUMN", "9 * i + 3 * j")
    + """
    return window;
"""
)

_HAND_OVER = (
    _ADD_TO_GRID
    + """
    const int up = node[2] - held[2];
    const bool along = node[0] == held[0] && node[1] == held[1] && up >= 0 && up < 3;
    const int leaving = along ? up : 3;
    if (leaving == 0 || held[0] < 0) return window;
"""
    + _COLUMNS.replace("FIRST", "held")
    + """
    const lanes none = {};
    #pragma unroll
    for (int i = 0; i < 3; ++i) {
        #pragma unroll
        for (int j = 0; j < 3; ++j) {
            const int n = columns[3 * i + j];
            lanes* h = (lanes*)window.data[9 * i + 3 * j];
            add(n, h[0]);
            if (leaving > 1) add(n + 1, h[1]);
            if (leaving > 2) add(n + 2, h[2]);
            h[0] = leaving == 1 ? h[1] : leaving == 2 ? h[2] : none;
            h[1] = leaving == 1 ? h[2] : none;
            h[2] = none;
        }
    }
    return window;
"""
)

_GATHER = """
    const int ci = node[0], cj = node[1], bz = node[2];
    const wp::vec_t<4, REAL>* nodes = &wp::index(grid, row, 0);
    const wp::vec_t<4, REAL> none = {};
    lanes V = *(const lanes*)&none;
    lanes C0 = V, C1 = V, C2 = V;
    lanes D0 = V, D1 = V, D2 = V;  // by slopes
    SLOPE_BEGIN
#if defined(__CUDA_ARCH__)
    constexpr int planes = PLANES_ON_CUDA, rows = ROWS_ON_CUDA;
    const auto column = [&](int i, int j) { return wp::index(start, layout, ci + i, cj + j); };
    const auto value = [nodes](int n) { LOAD };
#else
    constexpr int planes = 3, rows = 3;
    const int* first = &wp::index(start, layout, ci, cj);
    const int pitch = start.strides[1] / sizeof(int);
    const auto column = [&](int i, int j) { return first[i * pitch + j]; };
    const auto value = [nodes](int n) { return *(const lanes*)(nodes + n); };
#endif
    // the next plane's columns, and by slopes the next column's nodes, are on their way while these
    // are summed
    int n0 = column(0, 0) + bz, n1 = column(0, 1) + bz, n2 = column(0, 2) + bz;
    AHEAD_BEGIN
    #pragma unroll planes
    for (int i = 0; i < 3; ++i) {
        const int k = i < 2 ? i + 1 : i;
        const int m0 = column(k, 0) + bz, m1 = column(k, 1) + bz, m2 = column(k, 2) + bz;
        // not wx[i]: in a loop that array would not be in registers
        const REAL wxi = i == 0 ? wx[0] : i == 1 ? wx[1] : wx[2];
        const REAL sxi = i == 0 ? sx[0] : i == 1 ? sx[1] : sx[2];
        #pragma unroll rows
        for (int j = 0; j < 3; ++j) {
            const REAL wyj = j == 0 ? wy[0] : j == 1 ? wy[1] : wy[2];
            const REAL syj = j == 0 ? sy[0] : j == 1 ? sy[1] : sy[2];
            const REAL w = wxi * wyj, dx = sxi * wyj, dy = wxi * syj;
            NODES
            const lanes u1 = h1 * wz[1], u2 = h2 * wz[2];
            const lanes u = h0 * wz[0] + u1 + u2;
            const lanes k = u1 + u2 + u2;
            const lanes z = h0 * sz[0] + h1 * sz[1] + h2 * sz[2];
            const lanes s = u * w;
            V = V + s;
            C0 = C0 + s * REAL(i);
            C1 = C1 + s * REAL(j);
            C2 = C2 + k * w;
            D0 = D0 + u * dx;  // by slopes
            D1 = D1 + u * dy;  // by slopes
            D2 = D2 + z * w;  // by slopes
            SLOPE_ROW
            AHEAD_END
        }
        n0 = m0;
        n1 = m1;
        n2 = m2;
    }
    wp::mat_t<ROWS, 4, REAL> out;
    #pragma unroll
    for (int a = 0; a < 4; ++a) {
        out.data[0][a] = V[a];
        out.data[1][a] = C0[a];
        out.data[2][a] = C1[a];
        out.data[3][a] = C2[a];
        out.data[4][a] = D0[a];  // by slopes
        out.data[5][a] = D1[a];  // by slopes
        out.data[6][a] = D2[a];  // by slopes
    }
    SLOPE_END
    return out;
"""

_NODES = """
            const int n = j == 0 ? n0 : j == 1 ? n1 : n2;
            const lanes h0 = value(n), h1 = value(n + 1), h2 = value(n + 2);
"""

_AHEAD_BEGIN = "lanes h0 = value(n0), h1 = value(n0 + 1), h2 = value(n0 + 2);"

_NODES_AHEAD = """
            const int n = j == 0 ? n1 : j == 1 ? n2 : m0;
            const lanes g0 = value(n), g1 = value(n + 1), g2 = value(n + 2);
"""

_AHEAD_END = """
            h0 = g0;
            h1 = g1;
            h2 = g2;
"""

_GATHER_AT_ONCE = (
    _GATHER.replace("AHEAD_BEGIN", "").replace("AHEAD_END", "").replace("NODES", _NODES)
)

_GATHER_AHEAD = (
    _GATHER.replace("AHEAD_BEGIN", _AHEAD_BEGIN)
    .replace("AHEAD_END", _AHEAD_END)
    .replace("NODES", _NODES_AHEAD)
)

_SLOPE_BEGIN = "lanes X = V, Y = V, Z = V;"

_SLOPE_ROW = """
            const lanes zk = h1 * sz[1] + h2 * (sz[2] + sz[2]);
            const lanes Qij = Q + A0 * REAL(i) + A1 * REAL(j);
            const lanes p = each(u, Qij) + each(k, A2)
                + each(z, T2)  // by slopes
                ;
            X = X + p * dx;
            Y = Y + p * dy;
            Z = Z + (each(z, Qij) + each(zk, A2)) * w;
            const REAL xx = (i == 1 ? REAL(-2) : REAL(1)) * wyj;  // by slopes
            const REAL yy = (j == 1 ? REAL(-2) : REAL(1)) * wxi;  // by slopes
            const REAL xy = sxi * syj;  // by slopes
            const lanes zz = h0 - h1 - h1 + h2;  // by slopes
            const lanes p0 = each(u, T0), p1 = each(u, T1);  // by slopes
            X = X + p0 * xx + p1 * xy;  // by slopes
            Y = Y + p0 * xy + p1 * yy;  // by slopes
            Z = Z + each(zz, T2) * w + each(z, T0) * dx + each(z, T1) * dy;  // by slopes
"""

_SLOPE_END = """
    out.data[ROWS - 1][0] = X[0] + X[1] + X[2] + X[3];
    out.data[ROWS - 1][1] = Y[0] + Y[1] + Y[2] + Y[3];
    out.data[ROWS - 1][2] = Z[0] + Z[1] + Z[2] + Z[3];
    out.data[ROWS - 1][3] = REAL(0);
"""

# On the CPU two nodes of a column fill a register, and sums go by planes: what all nodes of a plane
# share is multiplied once.
_PAIRS = """
    typedef REAL pair __attribute__((ext_vector_type(8), aligned(sizeof(REAL))));
    const auto join = [](lanes a, lanes b) {
        return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7);
    };
    const lanes place = {f[0], f[1], f[2], REAL(0)};
    const lanes below = REAL(1.5) - place, middle = place - REAL(1), above = place - REAL(0.5);
    const lanes w[3] = {REAL(0.5) * below * below, REAL(0.75) - middle * middle,
                        REAL(0.5) * above * above};
    const pair wz01 = join(w[0].zzzz, w[1].zzzz);
    // columns are contiguous along y
    const int* first = &wp::index(start, layout, node[0], node[1]);
    const int pitch = start.strides[1] / sizeof(int);
"""

_SLOPES_OF_PAIRS = """
    const lanes s[3] = {-below, REAL(-2) * middle, above};
    const pair sz01 = join(s[0].zzzz, s[1].zzzz);
"""

_SCATTER_BY_PLANES = """
    const auto load = [](const REAL* a) { return *(const lanes*)a; };
    REAL* nodes = (REAL*)(&wp::index(grid, row, 0) + node[2]);
    const auto spread = [&](auto q, auto x, auto y,
                            auto tx, auto ty,  // by slopes
                            REAL* h) {
        typedef decltype(q) part __attribute__((aligned(sizeof(REAL))));
        #pragma unroll
        for (int i = 0; i < 3; ++i) {
            const part here = i == 0 ? q : i == 1 ? q + x : q + x + x;
            const part b = here * w[i].x
                + tx * s[i].x  // by slopes
                ;
            const part c = y * w[i].x;
            const part t = ty * w[i].x;  // by slopes
            const auto value = [&](const part& a, int j) {
                return a * w[j].y
                    + t * s[j].y  // by slopes
                    ;
            };
            const int* column = first + i * pitch;
            *(part*)(h + 4 * column[0]) += value(b, 0);
            *(part*)(h + 4 * column[1]) += value(b + c, 1);
            *(part*)(h + 4 * column[2]) += value(b + c + c, 2);
        }
    };
    const lanes Q = load(c.data[0]), A0 = load(c.data[1]), A1 = load(c.data[2]);
    const lanes A2 = load(c.data[3]);
    const lanes T0 = load(c.data[4]), T1 = load(c.data[5]), T2 = load(c.data[6]);  // by slopes
    // nodes 0 and 1 of each column together, node 2 by itself
    spread(join(Q, Q + A2) * wz01
               + join(T2, T2) * sz01  // by slopes
           , join(A0, A0) * wz01, join(A1, A1) * wz01,
           join(T0, T0) * wz01, join(T1, T1) * wz01,  // by slopes
           nodes);
    spread((Q + A2 + A2) * w[2].z
               + T2 * s[2].z  // by slopes
           , A0 * w[2].z, A1 * w[2].z,
           T0 * w[2].z, T1 * w[2].z,  // by slopes
           nodes + 8);
"""

_GATHER_BY_PLANES = """
    const REAL* nodes = (const REAL*)(&wp::index(grid, row, 0) + node[2]);
    const auto collect = [&](auto none, const REAL* h, auto take) {
        typedef decltype(none) part __attribute__((aligned(sizeof(REAL))));
        part v, cx, cy;
        part dx, dy;  // by slopes
        #pragma unroll
        for (int i = 0; i < 3; ++i) {
            const int* column = first + i * pitch;
            const part h0 = *(const part*)(h + 4 * column[0]);
            const part h1 = *(const part*)(h + 4 * column[1]);
            const part h2 = *(const part*)(h + 4 * column[2]);
            const part u1 = h1 * w[1].y, u2 = h2 * w[2].y;
            const part j = u1 + u2 + u2;
            const part u = h0 * w[0].y + u1 + u2;
            const part t = h0 * s[0].y + h1 * s[1].y + h2 * s[2].y;  // by slopes
            const part uw = u * w[i].x;
            v = i == 0 ? uw : v + uw;
            cx = i == 0 ? none : i == 1 ? uw : cx + uw + uw;
            cy = i == 0 ? j * w[0].x : cy + j * w[i].x;
            dx = i == 0 ? u * s[0].x : dx + u * s[i].x;  // by slopes
            dy = i == 0 ? t * w[0].x : dy + t * w[i].x;  // by slopes
        }
        take(v, cx, cy
             , dx, dy  // by slopes
        );
    };
    wp::mat_t<ROWS, 4, REAL> out;
    lanes* rows = (lanes*)out.data;
    const auto fold = [](pair a) { return a.lo + a.hi; };
    // nodes 0 and 1 of each column together, node 2 by itself
    collect(pair(REAL(0)), nodes, [&](pair v, pair cx, pair cy
                                      , pair dx, pair dy  // by slopes
                                      ) {
        const pair vw = v * wz01;
        rows[0] = fold(vw);
        rows[1] = fold(cx * wz01);
        rows[2] = fold(cy * wz01);
        rows[3] = vw.hi;
        rows[4] = fold(dx * wz01);  // by slopes
        rows[5] = fold(dy * wz01);  // by slopes
        rows[6] = fold(v * sz01);  // by slopes
    });
    collect(lanes(REAL(0)), nodes + 8, [&](lanes v, lanes cx, lanes cy
                                           , lanes dx, lanes dy  // by slopes
                                           ) {
        const lanes vw = v * w[2].z;
        rows[0] += vw;
        rows[1] += cx * w[2].z;
        rows[2] += cy * w[2].z;
        rows[3] += vw + vw;
        rows[4] += dx * w[2].z;  // by slopes
        rows[5] += dy * w[2].z;  // by slopes
        rows[6] += v * s[2].z;  // by slopes
    });
    return out;
"""

# without t
_GATHER_WITH_SLOPE_BY_PLANES = """
    const auto load = [](const REAL* a) { return *(const lanes*)a; };
    const REAL* nodes = (const REAL*)(&wp::index(grid, row, 0) + node[2]);
    const auto collect = [&](auto q, auto x, auto y, const REAL* h, auto take) {
        typedef decltype(q) part __attribute__((aligned(sizeof(REAL))));
        part v, cx, cy, dx, dy, all;
        #pragma unroll
        for (int i = 0; i < 3; ++i) {
            const int* column = first + i * pitch;
            const part h0 = *(const part*)(h + 4 * column[0]);
            const part h1 = *(const part*)(h + 4 * column[1]);
            const part h2 = *(const part*)(h + 4 * column[2]);
            const part u1 = h1 * w[1].y, u2 = h2 * w[2].y, t1 = h1 * s[1].y, t2 = h2 * s[2].y;
            const part u = h0 * w[0].y + u1 + u2, j = u1 + u2 + u2;
            const part t = h0 * s[0].y + t1 + t2, tj = t1 + t2 + t2;
            const part here = i == 0 ? q : i == 1 ? q + x : q + x + x;
            const part e = u * here + j * y, f = t * here + tj * y;
            const part uw = u * w[i].x;
            v = i == 0 ? uw : v + uw;
            cx = i == 0 ? uw - uw : i == 1 ? uw : cx + uw + uw;
            cy = i == 0 ? j * w[0].x : cy + j * w[i].x;
            dx = i == 0 ? e * s[0].x : dx + e * s[i].x;
            dy = i == 0 ? f * w[0].x : dy + f * w[i].x;
            all = i == 0 ? e * w[0].x : all + e * w[i].x;
        }
        take(v, cx, cy, dx, dy, all);
    };
    const lanes Q = load(c.data[0]), A0 = load(c.data[1]), A1 = load(c.data[2]);
    const lanes A2 = load(c.data[3]);
    wp::mat_t<ROWS, 4, REAL> out;
    lanes* rows = (lanes*)out.data;
    lanes X, Y, Z;
    const auto fold = [](pair a) { return a.lo + a.hi; };
    // nodes 0 and 1 of each column together, node 2 by itself
    collect(join(Q, Q + A2), join(A0, A0), join(A1, A1), nodes,
            [&](pair v, pair cx, pair cy, pair dx, pair dy, pair all) {
        const pair vw = v * wz01;
        rows[0] = fold(vw);
        rows[1] = fold(cx * wz01);
        rows[2] = fold(cy * wz01);
        rows[3] = vw.hi;
        X = fold(dx * wz01);
        Y = fold(dy * wz01);
        Z = fold(all * sz01);
    });
    collect(Q + A2 + A2, A0, A1, nodes + 8,
            [&](lanes v, lanes cx, lanes cy, lanes dx, lanes dy, lanes all) {
        const lanes vw = v * w[2].z;
        rows[0] += vw;
        rows[1] += cx * w[2].z;
        rows[2] += cy * w[2].z;
        rows[3] += vw + vw;
        X += dx * w[2].z;
        Y += dy * w[2].z;
        Z += all * s[2].z;
    });
    const auto sum = [](lanes a) { return a.x + a.y + a.z + a.w; };
    rows[4] = lanes{sum(X), sum(Y), sum(Z), REAL(0)};
    return out;
"""

_ATOMIC_ADD = {
    wp.float32: """
#if __CUDA_ARCH__ >= 900
        atomicAdd((float4*)(nodes + n), make_float4(h[0], h[1], h[2], h[3]));
#else
        wp::atomic_add(nodes + n, h);
#endif
""",
    wp.float64: "wp::atomic_add(nodes + n, h);",
}


_LOAD = {
    wp.float32: """
        const float4 h = *(const float4*)(nodes + n);
        return lanes(h.x, h.y, h.z, h.w);
""",
    wp.float64: """
        const double2 a = *(const double2*)(nodes + n), b = *((const double2*)(nodes + n) + 1);
        return lanes(a.x, a.y, b.x, b.y);
""",
}
"""Of a node's value on CUDA, whose compiler does not see that its numbers are aligned."""

_STORE = {
    wp.float32: "*(float4*)(nodes + n) = make_float4(h[0], h[1], h[2], h[3]);",
    wp.float64: """
        *(double2*)(nodes + n) = make_double2(h[0], h[1]);
        *((double2*)(nodes + n) + 1) = make_double2(h[2], h[3]);
""",
}


def _either(cpu: str, cuda: str) -> str:
    """The text for each kind of device."""
    return f"\n#if defined(__CUDA_ARCH__)\n{cuda}\n#else\n{cpu}\n#endif\n"


_BY_SLOPES = re.compile(r".*// by slopes\n")
"""Lines of native code that have to do with t."""


def _native(text: str, real: Any, **parts: str) -> str:
    """The text with its parts and its scalar type put in."""
    for name, part in parts.items():
        text = text.replace(name, part)
    return text.replace("REAL", "wp::float32" if real == wp.float32 else "wp::float64")


@functools.cache
def make_stencil(real: Any, *, slopes: bool, straight: bool = False) -> SimpleNamespace:
    """Build the sums for one scalar type.

    All take a grid's array, its row and its layout (see ``gendom.sim.columns``), the particle's
    lowest node (column i and j of the layout, level), and the particle's place f above that node
    in cells, each in 0.5..1.5.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        slopes: Whether there is a t.
        straight: Whether ``gather`` is straight code on CUDA, so that all nodes are waited for at
            once, where loops that stay loops spare the instruction cache.

    Returns:
        Namespace with ``sums``, the matrix of coefficients, ``scatter`` (adds to the grid),
        ``scatter_plane`` (a third of that), ``collect`` and ``hand_over`` (add to a window of 27
        nodes, and what is left behind of it to the grid), ``gather`` (dP/dq, dP/da, dP/dt),
        ``gather_with_slope`` (a last row with dP/df besides), and ``get_node`` and ``put_node``,
        whole on CUDA.
    """
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)
    rows = 7 if slopes else 4
    sums = wp.types.matrix((rows, 4), real)
    sums_and_slope = wp.types.matrix((rows + 1, 4), real)
    window_type = wp.types.matrix((27, 4), real)

    def native(text: str, **parts: str) -> str:
        text = _native(text, real, **parts)
        return text if slopes else _BY_SLOPES.sub("", text)

    pairs = _PAIRS + (_SLOPES_OF_PAIRS if slopes else "")
    on_cpu = pairs + _SCATTER_BY_PLANES
    by_nodes = _WEIGHTS + _COEFFICIENTS + _SCATTER
    on_cuda = by_nodes.replace("PLANES", _ALL_PLANES)

    @wp.func_native(native(_LANES + _either(on_cpu, on_cuda), ATOMIC_ADD=_ATOMIC_ADD[real]))
    def scatter(
        grid: wp.array2d(dtype=vec4),
        row: int,
        start: wp.array3d(dtype=wp.int32),
        layout: int,
        node: wp.vec3i,
        f: vec3,
        c: sums,
    ): ...

    @wp.func_native(native(_LANES + by_nodes, PLANES=_ONE_PLANE, ATOMIC_ADD=_ATOMIC_ADD[real]))
    def scatter_plane(
        grid: wp.array2d(dtype=vec4),
        row: int,
        start: wp.array3d(dtype=wp.int32),
        layout: int,
        node: wp.vec3i,
        f: vec3,
        c: sums,
        plane: int,
    ): ...

    @wp.func_native(native(_LANES + _WEIGHTS + _COEFFICIENTS + _COLLECT, PLANES=_ALL_PLANES))
    def collect(window: window_type, f: vec3, c: sums) -> window_type: ...

    @wp.func_native(native(_LANES + _HAND_OVER, ATOMIC_ADD=_ATOMIC_ADD[real]))
    def hand_over(
        window: window_type,
        held: wp.vec3i,
        node: wp.vec3i,
        grid: wp.array2d(dtype=vec4),
        row: int,
        start: wp.array3d(dtype=wp.int32),
        layout: int,
    ) -> window_type: ...

    plain = {
        "SLOPE_BEGIN": "",
        "SLOPE_ROW": "",
        "SLOPE_END": "",
        "LOAD": _LOAD[real],
        "PLANES_ON_CUDA": "3" if straight else "1",
        "ROWS_ON_CUDA": "3",
        "ROWS": str(rows),
    }

    @wp.func_native(
        native(_LANES + _either(pairs + _GATHER_BY_PLANES, _WEIGHTS + _GATHER_AT_ONCE), **plain)
    )
    def gather(
        grid: wp.array2d(dtype=vec4),
        row: int,
        start: wp.array3d(dtype=wp.int32),
        layout: int,
        node: wp.vec3i,
        f: vec3,
    ) -> sums: ...

    sloped = {
        "SLOPE_BEGIN": _SLOPE_BEGIN,
        "SLOPE_ROW": _SLOPE_ROW,
        "SLOPE_END": _SLOPE_END,
        "LOAD": _LOAD[real],
        "PLANES_ON_CUDA": "1",
        "ROWS_ON_CUDA": "1",
        "ROWS": str(rows + 1),
    }

    one_by_one = _WEIGHTS + _COEFFICIENTS
    sloped_on_cpu = _PAIRS + _SLOPES_OF_PAIRS + _GATHER_WITH_SLOPE_BY_PLANES
    if slopes:
        sloped_on_cpu = one_by_one + _GATHER_AT_ONCE

    @wp.func_native(native(_LANES + _either(sloped_on_cpu, one_by_one + _GATHER_AHEAD), **sloped))
    def gather_with_slope(
        grid: wp.array2d(dtype=vec4),
        row: int,
        start: wp.array3d(dtype=wp.int32),
        layout: int,
        node: wp.vec3i,
        f: vec3,
        c: sums,
    ) -> sums_and_slope: ...

    here = "wp::vec_t<4, REAL>* nodes = &wp::index(grid, row, 0);"

    @wp.func_native(native(_LANES + here + _either("return nodes[n];", _LOAD[real])))
    def get_node(grid: wp.array2d(dtype=vec4), row: int, n: int) -> vec4: ...

    @wp.func_native(native(here + _either("nodes[n] = h;", _STORE[real])))
    def put_node(grid: wp.array2d(dtype=vec4), row: int, n: int, h: vec4): ...

    return SimpleNamespace(
        sums=sums,
        window=window_type,
        scatter=scatter,
        scatter_plane=scatter_plane,
        get_node=get_node,
        put_node=put_node,
        collect=collect,
        hand_over=hand_over,
        gather=gather,
        gather_with_slope=gather_with_slope,
    )
