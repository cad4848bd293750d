// ``scatter`` and ``gather`` of bspline.h on the CPU: two nodes of a column fill a
// register; what all nodes of a plane share is multiplied once.
#pragma once

#if !defined(__CUDA_ARCH__)
namespace gendom {

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

// Velocity and mass of the nodes, a share `keep` of momentum / mass; without mass 0. Empties the
// momentum if told to.
template <typename real>
inline void normalise(const nodes_of<real>& momentum, int row, const nodes_of<real>& velocity,
                      int row_out, int, int, int count, real keep, int empty) {
    typedef typename simd<real>::four four;
    const four* q = (const four*)&wp::index(momentum, row, 0);
    four* u = (four*)&wp::index(velocity, row_out, 0);
    for (int n = 0; n < count; ++n) {
        const real mass = q[n].w;
        four v = q[n] * (mass > real(0) ? keep / mass : real(0));
        v.w = mass;
        u[n] = v;
    }
    if (empty) __builtin_memset((void*)q, 0, count * sizeof(four));
}

template <typename real>
inline void clear(const nodes_of<real>& grid, int row, int, int, int count) {
    __builtin_memset(&wp::index(grid, row, 0), 0, count * sizeof(vec4<real>));
}

}  // namespace gendom
#endif
