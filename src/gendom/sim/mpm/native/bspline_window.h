// A window of 27 nodes, see bspline.h: what neighbouring particles give to the same nodes is summed first.
#pragma once

namespace gendom {

template <typename real> using window_of = wp::mat_t<27, 4, real>;

// Add a particle's contribution to a window at its lowest node.
template <typename real>
GENDOM_INLINE window_of<real> collect(window_of<real> window, const vec3<real>& f,
                                             const sums<4, real>& c) {
#if defined(__CUDA_ARCH__)
    stencil<real>(f).spread(c, [&](int n, const vec4<real>& h) {
        #pragma unroll
        for (int a = 0; a < 4; ++a) window.data[n][a] += h[a];
    });
#else
    real w[3][3];
    for (int axis = 0; axis < 3; ++axis) {
        w[axis][0] = real(0.5) * (real(1.5) - f[axis]) * (real(1.5) - f[axis]);
        w[axis][1] = real(0.75) - (f[axis] - real(1)) * (f[axis] - real(1));
        w[axis][2] = real(0.5) * (f[axis] - real(0.5)) * (f[axis] - real(0.5));
    }
    for (int n = 0; n < 27; ++n) {
        const int i = n / 9, j = n / 3 % 3, k = n % 3;
        for (int a = 0; a < 4; ++a)
            window.data[n][a] += w[0][i] * w[1][j] * w[2][k]
                * (c.data[0][a] + i * c.data[1][a] + j * c.data[2][a] + k * c.data[3][a]);
    }
#endif
    return window;
}

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

template <typename real>
GENDOM_INLINE vec4<real> get_node(const nodes_of<real>& grid, int row, int n) {
    return load(&wp::index(grid, row, 0) + n);
}

template <typename real>
GENDOM_INLINE void put_node(const nodes_of<real>& grid, int row, int n, const vec4<real>& h) {
    store(&wp::index(grid, row, 0) + n, h);
}

}  // namespace gendom
