// Sums over the 27 grid nodes around a particle, the inner loops of every substep.
//
// A particle with coefficients q, a_x, a_y, a_z (four numbers each) and node values h_n forms
//
//     P = sum_n h_n . w_n (q + i a_x + j a_y + k a_z)
//
// with quadratic B-spline weights w_n of the node (i, j, k) in 0..2 at the particle's place f in
// cells above its lowest node (each in 0.5..1.5). Everything that particles and grid exchange is a
// derivative of P: `scatter` adds dP/dh to the grid, `gather<4>` returns dP/dq and dP/da, and
// `gather<5>`, for adjoints, dP/df besides. Rows q, a_x, a_y, a_z of a 4 x 4 matrix hold coefficients, and
// derivatives by them. B-splines: Steffen, Kirby and Berzins (2008).
//
// Warp's own vectors neither become SIMD registers on the CPU nor one vector atomic on CUDA.
#pragma once

// What is handed around by value must stay in registers.
#if defined(__CUDA_ARCH__)
#define GENDOM_INLINE __device__ __forceinline__
#else
#define GENDOM_INLINE inline
#endif

namespace gendom {

template <typename real> using vec3 = wp::vec_t<3, real>;
template <typename real> using vec4 = wp::vec_t<4, real>;
template <typename real> using nodes_of = wp::array_t<vec4<real>>;
template <int rows, typename real> using sums = wp::mat_t<rows, 4, real>;
using lowest_node = wp::vec_t<3, int>;

#if defined(__CUDA_ARCH__)
// whole values, whose alignment the compiler does not see
GENDOM_INLINE vec4<float> load(const vec4<float>* node) {
    const float4 h = *(const float4*)node;
    return vec4<float>(h.x, h.y, h.z, h.w);
}
GENDOM_INLINE vec4<double> load(const vec4<double>* node) {
    const double2 a = *(const double2*)node, b = *((const double2*)node + 1);
    return vec4<double>(a.x, a.y, b.x, b.y);
}
GENDOM_INLINE void store(vec4<float>* node, const vec4<float>& h) {
    *(float4*)node = make_float4(h[0], h[1], h[2], h[3]);
}
GENDOM_INLINE void store(vec4<double>* node, const vec4<double>& h) {
    *(double2*)node = make_double2(h[0], h[1]);
    *((double2*)node + 1) = make_double2(h[2], h[3]);
}
GENDOM_INLINE void add(vec4<float>* node, const vec4<float>& h) {
#if __CUDA_ARCH__ >= 900
    atomicAdd((float4*)node, make_float4(h[0], h[1], h[2], h[3]));
#else
    wp::atomic_add(node, h);
#endif
}
GENDOM_INLINE void add(vec4<double>* node, const vec4<double>& h) { wp::atomic_add(node, h); }
#else
template <typename real> inline vec4<real> load(const vec4<real>* node) { return *node; }
template <typename real> inline void store(vec4<real>* node, const vec4<real>& h) { *node = h; }
template <typename real> inline void add(vec4<real>* node, const vec4<real>& h) { *node = *node + h; }
#endif

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

// Transpose of `normalise`: derivatives by momentum and mass in place of those by velocity; returns
// that by `keep`.
template <typename real>
GENDOM_INLINE double normalise_adjoint(const nodes_of<real>& momentum, int row,
                                       const nodes_of<real>& adjoint, int row_out, int thread,
                                       int threads, int count, real keep) {
    const vec4<real>* nodes = &wp::index(momentum, row, 0);
    vec4<real>* by = &wp::index(adjoint, row_out, 0);
    double by_keep = 0.0;
    for (int n = thread; n < count; n += threads) {
        const vec4<real> q = load(nodes + n), u = load(by + n);
        const bool full = q[3] > real(0);
        const real share = full ? keep / q[3] : real(0);
        const real along = full ? (u[0] * q[0] + u[1] * q[1] + u[2] * q[2]) / q[3] : real(0);
        by_keep += along;
        store(by + n, vec4<real>(share * u[0], share * u[1], share * u[2], -share * along));
    }
    return by_keep;
}

#if !defined(__CUDA_ARCH__)
// On the CPU two nodes of a column fill a register; what all nodes of a plane share is multiplied
// once.

template <typename real> struct simd;
template <> struct simd<float> {
    typedef float four __attribute__((ext_vector_type(4), aligned(4)));
    typedef float pair __attribute__((ext_vector_type(8), aligned(4)));
};
template <> struct simd<double> {
    typedef double four __attribute__((ext_vector_type(4), aligned(8)));
    typedef double pair __attribute__((ext_vector_type(8), aligned(8)));
};

template <typename real> struct stencil {
    typedef typename simd<real>::four four;
    typedef typename simd<real>::pair pair;

    four w[3], s[3];  // weights and slopes, by axes
    const int* first;  // columns are contiguous along y
    int pitch;

    stencil(const wp::array_t<int>& start, int layout, const lowest_node& node, const vec3<real>& f) {
        const four place = {f[0], f[1], f[2], real(0)};
        const four below = real(1.5) - place, middle = place - real(1), above = place - real(0.5);
        w[0] = real(0.5) * below * below;
        w[1] = real(0.75) - middle * middle;
        w[2] = real(0.5) * above * above;
        s[0] = -below;
        s[1] = real(-2) * middle;
        s[2] = above;
        first = &wp::index(start, layout, node[0], node[1]);
        pitch = start.strides[1] / sizeof(int);
    }
    static pair join(four a, four b) { return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7); }
    static four fold(pair a) { return a.lo + a.hi; }
    static four load(const real* a) { return *(const four*)a; }
    pair wz01() const { return join(w[0].zzzz, w[1].zzzz); }
    pair sz01() const { return join(s[0].zzzz, s[1].zzzz); }

    // Add (q + i x + j y) w_i w_j to nine columns, from the node that h points to in each.
    template <typename part> void spread(part q, part x, part y, real* h) const {
        typedef part loose __attribute__((aligned(sizeof(real))));
        #pragma unroll
        for (int i = 0; i < 3; ++i) {
            const part here = i == 0 ? q : i == 1 ? q + x : q + x + x;
            const part b = here * w[i].x, c = y * w[i].x;
            const int* column = first + i * pitch;
            *(loose*)(h + 4 * column[0]) += b * w[0].y;
            *(loose*)(h + 4 * column[1]) += (b + c) * w[1].y;
            *(loose*)(h + 4 * column[2]) += (b + c + c) * w[2].y;
        }
    }

    template <typename part> struct sums_of_planes { part v, cx, cy, dx, dy, all; };

    // Sums over nine columns of h, i h and j h; with slopes also the derivatives by the place of sums
    // with q, x, y.
    template <bool sloped, typename part>
    sums_of_planes<part> collect(part q, part x, part y, const real* h) const {
        typedef part loose __attribute__((aligned(sizeof(real))));
        sums_of_planes<part> sum;
        #pragma unroll
        for (int i = 0; i < 3; ++i) {
            const int* column = first + i * pitch;
            const part h0 = *(const loose*)(h + 4 * column[0]);
            const part h1 = *(const loose*)(h + 4 * column[1]);
            const part h2 = *(const loose*)(h + 4 * column[2]);
            const part u1 = h1 * w[1].y, u2 = h2 * w[2].y;
            const part u = h0 * w[0].y + u1 + u2, j = u1 + u2 + u2;
            const part uw = u * w[i].x;
            sum.v = i == 0 ? uw : sum.v + uw;
            sum.cx = i == 0 ? uw - uw : i == 1 ? uw : sum.cx + uw + uw;
            sum.cy = i == 0 ? j * w[0].x : sum.cy + j * w[i].x;
            if constexpr (sloped) {
                const part t1 = h1 * s[1].y, t2 = h2 * s[2].y;
                const part t = h0 * s[0].y + t1 + t2, tj = t1 + t2 + t2;
                const part here = i == 0 ? q : i == 1 ? q + x : q + x + x;
                const part e = u * here + j * y, f = t * here + tj * y;
                sum.dx = i == 0 ? e * s[0].x : sum.dx + e * s[i].x;
                sum.dy = i == 0 ? f * w[0].x : sum.dy + f * w[i].x;
                sum.all = i == 0 ? e * w[0].x : sum.all + e * w[i].x;
            }
        }
        return sum;
    }
};

// No window is needed: it is returned as it was.
template <unsigned rows, typename real>
inline wp::mat_t<rows, 4, real> scatter(const wp::mat_t<rows, 4, real>& window, const lowest_node&,
                                        const lowest_node& node, const vec3<real>& f,
                                        const sums<4, real>& c, const nodes_of<real>& grid, int row,
                                        const wp::array_t<int>& start, int layout) {
    typedef stencil<real> S;
    typedef typename S::four four;
    const S at(start, layout, node, f);
    real* nodes = (real*)(&wp::index(grid, row, 0) + node[2]);
    const four Q = S::load(c.data[0]), A0 = S::load(c.data[1]), A1 = S::load(c.data[2]);
    const four A2 = S::load(c.data[3]), wz2 = at.w[2].zzzz;
    const typename S::pair wz01 = at.wz01();
    // nodes 0 and 1 of each column together, node 2 by itself
    at.spread(S::join(Q, Q + A2) * wz01, S::join(A0, A0) * wz01, S::join(A1, A1) * wz01, nodes);
    at.spread((Q + A2 + A2) * wz2, A0 * wz2, A1 * wz2, nodes + 8);
    return window;
}

template <unsigned rows, typename real>
inline void flush(const wp::mat_t<rows, 4, real>&, const lowest_node&, const nodes_of<real>&, int,
                  const wp::array_t<int>&, int) {}

template <int rows, typename real>
inline sums<rows, real> gather(const nodes_of<real>& grid, int row, const wp::array_t<int>& start,
                               int layout, const lowest_node& node, const vec3<real>& f,
                               const sums<4, real>& c = {}) {
    typedef stencil<real> S;
    typedef typename S::four four;
    typedef typename S::pair pair;
    constexpr bool sloped = rows == 5;
    const S at(start, layout, node, f);
    const real* nodes = (const real*)(&wp::index(grid, row, 0) + node[2]);
    const four Q = S::load(c.data[0]), A0 = S::load(c.data[1]), A1 = S::load(c.data[2]);
    const four A2 = S::load(c.data[3]);
    const auto two = at.template collect<sloped, pair>(
        S::join(Q, Q + A2), S::join(A0, A0), S::join(A1, A1), nodes);
    const auto one = at.template collect<sloped, four>(Q + A2 + A2, A0, A1, nodes + 8);
    sums<rows, real> out;
    four* into = (four*)out.data;
    const pair wz01 = at.wz01(), vw = two.v * wz01;
    const four wz2 = at.w[2].zzzz, uw = one.v * wz2;
    into[0] = S::fold(vw) + uw;
    into[1] = S::fold(two.cx * wz01) + one.cx * wz2;
    into[2] = S::fold(two.cy * wz01) + one.cy * wz2;
    into[3] = vw.hi + uw + uw;
    if constexpr (sloped) {
        const four X = S::fold(two.dx * wz01) + one.dx * wz2;
        const four Y = S::fold(two.dy * wz01) + one.dy * wz2;
        const four Z = S::fold(two.all * at.sz01()) + one.all * at.s[2].zzzz;
        const auto sum = [](four a) { return a.x + a.y + a.z + a.w; };
        into[4] = four{sum(X), sum(Y), sum(Z), real(0)};
    }
    return out;
}

#else
// On CUDA node by node. What neighbouring particles give to the same nodes is summed in a window of
// 27 nodes first.

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
    // read before anything is added to the grid, which would keep the compiler from reading them together
    int columns[9];
    #pragma unroll
    for (int c = 0; c < 9; ++c)
        columns[c] = wp::index(start, layout, held[0] + c / 3, held[1] + c % 3) + held[2];
    #pragma unroll
    for (int c = 0; c < 9; ++c) {
        const int n = columns[c];
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
#endif

}  // namespace gendom
