// ``scatter`` and ``gather`` of bspline.h on CUDA: node by node. What neighbouring particles give to
// the same nodes is summed in a window of 27 nodes first.
#pragma once

#if defined(__CUDA_ARCH__)
namespace gendom {

template <typename real> GENDOM_INLINE vec4<real> row_of(const real* a) {
    return vec4<real>(a[0], a[1], a[2], a[3]);
}

template <typename real> struct stencil {
    real wx[3], wy[3], wz[3], sx[3], sy[3], sz[3];

    GENDOM_INLINE explicit stencil(const vec3<real>& f) {
        const auto set = [](real f, real* w, real* s) {
            const real half = real(0.5);
            w[0] = half * (real(1.5) - f) * (real(1.5) - f);
            w[1] = real(0.75) - (f - real(1)) * (f - real(1));
            w[2] = half * (f - half) * (f - half);
            s[0] = f - real(1.5);
            s[1] = real(-2) * (f - real(1));
            s[2] = f - half;
        };
        set(f[0], wx, sx);
        set(f[1], wy, sy);
        set(f[2], wz, sz);
    }
    // not a[i]: where i is not known beforehand that array would not be in registers
    static GENDOM_INLINE real pick(const real* a, int i) { return i == 0 ? a[0] : i == 1 ? a[1] : a[2]; }

    // Call add(9 i + 3 j + k, value) for every node.
    template <typename adder> GENDOM_INLINE void spread(const sums<4, real>& c, adder add) const {
        const vec4<real> Q = row_of(c.data[0]), A0 = row_of(c.data[1]), A1 = row_of(c.data[2]);
        const vec4<real> A2 = row_of(c.data[3]);
        #pragma unroll
        for (int i = 0; i < 3; ++i) {
            const vec4<real> Qi = Q + A0 * real(i);
            #pragma unroll
            for (int j = 0; j < 3; ++j) {
                const real w = wx[i] * wy[j];
                const vec4<real> b = (Qi + A1 * real(j)) * w, s = A2 * w;
                add(9 * i + 3 * j, b * wz[0]);
                add(9 * i + 3 * j + 1, (b + s) * wz[1]);
                add(9 * i + 3 * j + 2, (b + s + s) * wz[2]);
            }
        }
    }
};

template <typename real> using window_of = wp::mat_t<27, 4, real>;

// Give to the grid what a window at `held` holds beyond one at `node`, and move it there.
template <typename real>
GENDOM_INLINE window_of<real> hand_over(window_of<real> window, const lowest_node& held,
                                        const lowest_node& node, const nodes_of<real>& grid,
                                        int row, const wp::array_t<int>& start, int layout) {
    const int up = node[2] - held[2];
    const bool along = node[0] == held[0] && node[1] == held[1] && up >= 0 && up < 3;
    const int leaving = along ? up : 3;
    if (leaving == 0 || held[0] < 0) return window;
    vec4<real>* nodes = &wp::index(grid, row, 0);
    const auto give = [&](int n, const real* h) { add(nodes + n, vec4<real>(h[0], h[1], h[2], h[3])); };
    const nine_columns columns(start, layout, held);
    #pragma unroll
    for (int c = 0; c < 9; ++c) {
        const int n = columns.n[c];
        real* h = window.data[3 * c];
        give(n, h);
        if (leaving > 1) give(n + 1, h + 4);
        if (leaving > 2) give(n + 2, h + 8);
        #pragma unroll
        for (int a = 0; a < 4; ++a) {
            h[a] = leaving == 1 ? h[4 + a] : leaving == 2 ? h[8 + a] : real(0);
            h[4 + a] = leaving == 1 ? h[8 + a] : real(0);
            h[8 + a] = real(0);
        }
    }
    return window;
}

// Add a particle's contribution to the window at its lowest node; what the window leaves goes to the
// grid.
template <typename real>
GENDOM_INLINE window_of<real> scatter(window_of<real> window, const lowest_node& held,
                                      const lowest_node& node, const vec3<real>& f,
                                      const sums<4, real>& c, const nodes_of<real>& grid, int row,
                                      const wp::array_t<int>& start, int layout) {
    window = hand_over(window, held, node, grid, row, start, layout);
    stencil<real>(f).spread(c, [&](int n, const vec4<real>& h) {
        #pragma unroll
        for (int a = 0; a < 4; ++a) window.data[n][a] += h[a];
    });
    return window;
}

// Give all of a window to the grid.
template <typename real>
GENDOM_INLINE void flush(const window_of<real>& window, const lowest_node& held,
                         const nodes_of<real>& grid, int row, const wp::array_t<int>& start,
                         int layout) {
    hand_over(window, held, lowest_node(-1, -1, -1), grid, row, start, layout);
}

// Sums over all nodes; with the coefficients c also the derivative of P by the place, as last row.
template <int rows, typename real>
GENDOM_INLINE sums<rows, real> gather(const nodes_of<real>& grid, int row,
                                      const wp::array_t<int>& start, int layout,
                                      const lowest_node& node, const vec3<real>& f,
                                      const sums<4, real>& c = {}) {
    constexpr bool sloped = rows == 5;
    const stencil<real> at(f);
    const vec4<real>* nodes = &wp::index(grid, row, 0);
    const auto column = [&](int i, int j) {
        return wp::index(start, layout, node[0] + i, node[1] + j) + node[2];
    };
    vec4<real> V, C0, C1, C2, X, Y, Z, Q, A0, A1, A2;
    if constexpr (sloped) {
        Q = row_of(c.data[0]);
        A0 = row_of(c.data[1]);
        A1 = row_of(c.data[2]);
        A2 = row_of(c.data[3]);
    }
    // the next plane's columns and the next column's nodes are on their way while these are summed
    int n0 = column(0, 0), n1 = column(0, 1), n2 = column(0, 2);
    vec4<real> h0, h1, h2;
    if constexpr (sloped) {
        h0 = load(nodes + n0);
        h1 = load(nodes + n0 + 1);
        h2 = load(nodes + n0 + 2);
    }
    // loops that stay loops spare the instruction cache
    #pragma unroll 1
    for (int i = 0; i < 3; ++i) {
        const int next = i < 2 ? i + 1 : i;
        const int m0 = column(next, 0), m1 = column(next, 1), m2 = column(next, 2);
        const real wxi = at.pick(at.wx, i), sxi = at.pick(at.sx, i);
        #pragma unroll (sloped ? 1 : 3)
        for (int j = 0; j < 3; ++j) {
            const real wyj = at.pick(at.wy, j);
            const real w = wxi * wyj;
            vec4<real> g0, g1, g2;
            if constexpr (sloped) {
                const int n = j == 0 ? n1 : j == 1 ? n2 : m0;
                g0 = load(nodes + n);
                g1 = load(nodes + n + 1);
                g2 = load(nodes + n + 2);
            } else {
                const int n = j == 0 ? n0 : j == 1 ? n1 : n2;
                h0 = load(nodes + n);
                h1 = load(nodes + n + 1);
                h2 = load(nodes + n + 2);
            }
            const vec4<real> u1 = h1 * at.wz[1], u2 = h2 * at.wz[2];
            const vec4<real> u = h0 * at.wz[0] + u1 + u2, k = u1 + u2 + u2;
            const vec4<real> s = u * w;
            V = V + s;
            C0 = C0 + s * real(i);
            C1 = C1 + s * real(j);
            C2 = C2 + k * w;
            if constexpr (sloped) {
                const real dx = sxi * wyj, dy = wxi * at.pick(at.sy, j);
                const vec4<real> z = h0 * at.sz[0] + h1 * at.sz[1] + h2 * at.sz[2];
                const vec4<real> zk = h1 * at.sz[1] + h2 * (at.sz[2] + at.sz[2]);
                const vec4<real> Qij = Q + A0 * real(i) + A1 * real(j);
                const vec4<real> p = wp::cw_mul(u, Qij) + wp::cw_mul(k, A2);
                X = X + p * dx;
                Y = Y + p * dy;
                Z = Z + (wp::cw_mul(z, Qij) + wp::cw_mul(zk, A2)) * w;
                h0 = g0;
                h1 = g1;
                h2 = g2;
            }
        }
        n0 = m0;
        n1 = m1;
        n2 = m2;
    }
    sums<rows, real> out;
    #pragma unroll
    for (int a = 0; a < 4; ++a) {
        out.data[0][a] = V[a];
        out.data[1][a] = C0[a];
        out.data[2][a] = C1[a];
        out.data[3][a] = C2[a];
    }
    if constexpr (sloped) {
        out.data[4][0] = X[0] + X[1] + X[2] + X[3];
        out.data[4][1] = Y[0] + Y[1] + Y[2] + Y[3];
        out.data[4][2] = Z[0] + Z[1] + Z[2] + Z[3];
        out.data[4][3] = real(0);
    }
    return out;
}

// Velocity and mass of the nodes, a share `keep` of momentum / mass; without mass 0. Empties the
// momentum if told to.
template <typename real>
GENDOM_INLINE void normalise(const nodes_of<real>& momentum, int row, const nodes_of<real>& velocity,
                             int row_out, int thread, int threads, int count, real keep, int empty) {
    vec4<real>* nodes = &wp::index(momentum, row, 0);
    vec4<real>* u = &wp::index(velocity, row_out, 0);
    vec4<real> next = thread < count ? load(nodes + thread) : vec4<real>();
    for (int n = thread; n < count; n += threads) {
        const vec4<real> q = next;
        // on its way while this one is updated
        if (n + threads < count) next = load(nodes + n + threads);
        const bool full = q[3] > real(0);
        if (full && empty) store(nodes + n, vec4<real>());
        const real share = full ? keep / q[3] : real(0);
        store(u + n, vec4<real>(share * q[0], share * q[1], share * q[2], q[3]));
    }
}

template <typename real>
GENDOM_INLINE void clear(const nodes_of<real>& grid, int row, int thread, int threads, int count) {
    vec4<real>* nodes = &wp::index(grid, row, 0);
    for (int n = thread; n < count; n += threads) store(nodes + n, vec4<real>());
}

}  // namespace gendom
#endif
