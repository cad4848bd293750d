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
template <typename real> using four = vec4<real>;

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
template <typename real> using four = real __attribute__((ext_vector_type(4)));
template <typename real> using eight = real __attribute__((ext_vector_type(8)));

// In memory only numbers are aligned.
template <typename V, typename real> inline V load_as(const real* a) {
    typedef V loose __attribute__((aligned(sizeof(real))));
    return *(const loose*)a;
}
template <typename real> inline void store(vec4<real>* node, const four<real>& h) {
    typedef four<real> loose __attribute__((aligned(sizeof(real))));
    *(loose*)node = h;
}
template <typename real> inline four<real> load(const vec4<real>* node) {
    return load_as<four<real>>(node->c);
}
#endif

template <typename real> GENDOM_INLINE four<real> row_of(const sums<4, real>& c, int n) {
    return {c.data[n][0], c.data[n][1], c.data[n][2], c.data[n][3]};
}

// Velocity and mass of the nodes, a share `keep` of momentum / mass; without mass 0. Empties the
// momentum if told to.
template <typename real>
GENDOM_INLINE void normalise(const nodes_of<real>& momentum, int row, const nodes_of<real>& velocity,
                             int row_out, int thread, int threads, int count, real keep, int empty) {
    vec4<real>* nodes = &wp::index(momentum, row, 0);
    vec4<real>* u = &wp::index(velocity, row_out, 0);
    for (int n = thread; n < count; n += threads) {
        const four<real> q = gendom::load(nodes + n);
        const bool full = q[3] > real(0);
        if (full && empty) store(nodes + n, four<real>{});
        const real share = full ? keep / q[3] : real(0);
        store(u + n, four<real>{share * q[0], share * q[1], share * q[2], q[3]});
    }
}

template <typename real>
GENDOM_INLINE void clear(const nodes_of<real>& grid, int row, int thread, int threads, int count) {
    vec4<real>* nodes = &wp::index(grid, row, 0);
    for (int n = thread; n < count; n += threads) store(nodes + n, four<real>{});
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
        const four<real> q = gendom::load(nodes + n), u = gendom::load(by + n);
        const bool full = q[3] > real(0);
        const real share = full ? keep / q[3] : real(0);
        const real along = full ? (u[0] * q[0] + u[1] * q[1] + u[2] * q[2]) / q[3] : real(0);
        by_keep += along;
        store(by + n, four<real>{share * u[0], share * u[1], share * u[2], -share * along});
    }
    return by_keep;
}

// Where the columns of nodes around a particle begin; they are contiguous along y.
struct columns_at {
    const int* first;
    int pitch;

    GENDOM_INLINE columns_at(const wp::array_t<int>& start, int layout, const lowest_node& node)
        : first(&wp::index(start, layout, node[0], node[1])), pitch(start.strides[1] / sizeof(int)) {}
    GENDOM_INLINE int operator()(int i, int j) const { return first[i * pitch + j]; }
};

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

    // Call add(3 i + j, k, value) for every node.
    template <typename adder> GENDOM_INLINE void spread(const sums<4, real>& c, adder add) const {
        const four<real> Q = row_of(c, 0), A0 = row_of(c, 1), A1 = row_of(c, 2), A2 = row_of(c, 3);
        #pragma unroll
        for (int i = 0; i < 3; ++i) {
            const four<real> Qi = Q + A0 * real(i);
            #pragma unroll
            for (int j = 0; j < 3; ++j) {
                const real w = wx[i] * wy[j];
                const four<real> b = (Qi + A1 * real(j)) * w, s = A2 * w;
                add(3 * i + j, 0, b * wz[0]);
                add(3 * i + j, 1, (b + s) * wz[1]);
                add(3 * i + j, 2, (b + s + s) * wz[2]);
            }
        }
    }
};

#if !defined(__CUDA_ARCH__)
// No window is needed: it is returned as it was.
template <unsigned rows, typename real>
inline wp::mat_t<rows, 4, real> scatter(const wp::mat_t<rows, 4, real>& window, const lowest_node&,
                                        const lowest_node& node, const vec3<real>& f,
                                        const sums<4, real>& c, const nodes_of<real>& grid, int row,
                                        const wp::array_t<int>& start, int layout) {
    vec4<real>* nodes = &wp::index(grid, row, 0) + node[2];
    const columns_at column(start, layout, node);
    stencil<real>(f).spread(c, [&](int n, int k, const four<real>& h) {
        vec4<real>* to = nodes + column(n / 3, n % 3) + k;
        store(to, gendom::load(to) + h);
    });
    return window;
}

template <unsigned rows, typename real>
inline void flush(const wp::mat_t<rows, 4, real>&, const lowest_node&, const nodes_of<real>&, int,
                  const wp::array_t<int>&, int) {}

// Sums over all nodes; with the coefficients c also the derivative of P by the place, as last row.
// In float32 two nodes of a column fill a register; what nodes of a plane share is multiplied once.
template <int rows, typename real>
inline sums<rows, real> gather(const nodes_of<real>& grid, int row, const wp::array_t<int>& start,
                               int layout, const lowest_node& node, const vec3<real>& f,
                               const sums<4, real>& c = {}) {
    constexpr bool sloped = rows == 5;
    const stencil<real> at(f);
    const columns_at column(start, layout, node);
    const real* nodes = (&wp::index(grid, row, 0) + node[2])->c;
    four<real> V = {}, C0 = {}, C1 = {}, C2 = {}, X = {}, Y = {}, Z = {};
    const auto take = [&](auto Q, auto A0, auto A1, auto wz, auto sz, const real* nodes, int level) {
        typedef decltype(Q) part;
        part v = {}, c0 = {}, c1 = {}, x = {}, y = {}, z = {};
        #pragma unroll
        for (int i = 0; i < 3; ++i) {
            const auto h = [&](int j) { return load_as<part>(nodes + 4 * column(i, j)); };
            const part h0 = h(0), h1 = h(1), h2 = h(2), u1 = h1 * at.wy[1], u2 = h2 * at.wy[2];
            const part u = h0 * at.wy[0] + u1 + u2, k = u1 + u2 + u2, s = u * at.wx[i];
            v = v + s;
            if (i) c0 = c0 + s * real(i);
            c1 = c1 + k * at.wx[i];
            if constexpr (sloped) {
                const part q = i ? Q + A0 * real(i) : Q, d1 = h1 * at.sy[1], d2 = h2 * at.sy[2];
                const part p = u * q + k * A1, d = (h0 * at.sy[0] + d1 + d2) * q + (d1 + d2 + d2) * A1;
                x = x + p * at.sx[i];
                y = y + d * at.wx[i];
                z = z + p * at.wx[i];
            }
        }
        const auto add = [](four<real>& to, const part& a) {
            if constexpr (sizeof(part) == sizeof(to)) to = to + a;
            else to = to + a.lo + a.hi;
        };
        v = v * wz;
        add(V, v), add(C0, c0 * wz), add(C1, c1 * wz);
        if constexpr (sizeof(part) > sizeof(V)) C2 = v.hi;
        else if (level) C2 = C2 + v * real(level);
        if constexpr (sloped) add(X, x * wz), add(Y, y * wz), add(Z, z * sz);
    };
    const auto join = [](const four<real>& a, const four<real>& b) {
        return eight<real>(__builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7));
    };
    const auto first_two = [&](const real* w) { return join(four<real>(w[0]), four<real>(w[1])); };
    const four<real> Q = row_of(c, 0), A0 = row_of(c, 1), A1 = row_of(c, 2), A2 = row_of(c, 3);
    if constexpr (sizeof(real) == 4) {
        take(join(Q, Q + A2), join(A0, A0), join(A1, A1), first_two(at.wz), first_two(at.sz), nodes, 1);
    } else {
        take(Q, A0, A1, four<real>(at.wz[0]), four<real>(at.sz[0]), nodes, 0);
        take(Q + A2, A0, A1, four<real>(at.wz[1]), four<real>(at.sz[1]), nodes + 4, 1);
    }
    take(Q + A2 + A2, A0, A1, four<real>(at.wz[2]), four<real>(at.sz[2]), nodes + 8, 2);
    const auto sum = [](const four<real>& a) { return a[0] + a[1] + a[2] + a[3]; };
    sums<rows, real> out;
    vec4<real>* into = (vec4<real>*)out.data;
    store(into, V), store(into + 1, C0), store(into + 2, C1), store(into + 3, C2);
    if constexpr (sloped) store(into + 4, four<real>{sum(X), sum(Y), sum(Z), real(0)});
    return out;
}

#else
// On CUDA node by node. What neighbouring particles give to the same nodes is summed in a window of
// 27 nodes first.

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
    stencil<real>(f).spread(c, [&](int n, int k, const vec4<real>& h) {
        #pragma unroll
        for (int a = 0; a < 4; ++a) window.data[3 * n + k][a] += h[a];
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

template <int rows, typename real>
GENDOM_INLINE sums<rows, real> gather(const nodes_of<real>& grid, int row,
                                      const wp::array_t<int>& start, int layout,
                                      const lowest_node& node, const vec3<real>& f,
                                      const sums<4, real>& c = {}) {
    constexpr bool sloped = rows == 5;
    const stencil<real> at(f);
    const columns_at column(start, layout, node);
    const vec4<real>* nodes = &wp::index(grid, row, 0) + node[2];
    vec4<real> V, C0, C1, C2, X, Y, Z;
    const vec4<real> Q = row_of(c, 0), A0 = row_of(c, 1), A1 = row_of(c, 2), A2 = row_of(c, 3);
    // loops that stay loops spare the instruction cache
    #pragma unroll 1
    for (int i = 0; i < 3; ++i) {
        const real wxi = at.pick(at.wx, i), sxi = at.pick(at.sx, i);
        #pragma unroll (sloped ? 1 : 3)
        for (int j = 0; j < 3; ++j) {
            const vec4<real>* h = nodes + column(i, j);
            const vec4<real> h0 = gendom::load(h), h1 = gendom::load(h + 1), h2 = gendom::load(h + 2);
            const real wyj = at.pick(at.wy, j), w = wxi * wyj;
            const vec4<real> u1 = h1 * at.wz[1], u2 = h2 * at.wz[2];
            const vec4<real> u = h0 * at.wz[0] + u1 + u2, k = u1 + u2 + u2, s = u * w;
            V = V + s;
            C0 = C0 + s * real(i);
            C1 = C1 + s * real(j);
            C2 = C2 + k * w;
            if constexpr (sloped) {
                const vec4<real> z = h0 * at.sz[0] + h1 * at.sz[1] + h2 * at.sz[2];
                const vec4<real> zk = h1 * at.sz[1] + h2 * (at.sz[2] + at.sz[2]);
                const vec4<real> Qij = Q + A0 * real(i) + A1 * real(j);
                const vec4<real> p = wp::cw_mul(u, Qij) + wp::cw_mul(k, A2);
                X = X + p * (sxi * wyj);
                Y = Y + p * (wxi * at.pick(at.sy, j));
                Z = Z + (wp::cw_mul(z, Qij) + wp::cw_mul(zk, A2)) * w;
            }
        }
    }
    const auto sum = [](const vec4<real>& a) { return a[0] + a[1] + a[2] + a[3]; };
    sums<rows, real> out;
    #pragma unroll
    for (int a = 0; a < 4; ++a)
        out.data[0][a] = V[a], out.data[1][a] = C0[a], out.data[2][a] = C1[a], out.data[3][a] = C2[a];
    if constexpr (sloped) out.data[4][0] = sum(X), out.data[4][1] = sum(Y), out.data[4][2] = sum(Z);
    return out;
}

#endif

}  // namespace gendom
