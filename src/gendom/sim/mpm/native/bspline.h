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

// The node numbers of nine columns at the level of `node`. They are read before anything is added
// to the grid, which would keep the compiler from reading them together.
struct nine_columns {
    int n[9];
    GENDOM_INLINE nine_columns(const wp::array_t<int>& start, int layout, const lowest_node& node) {
        #pragma unroll
        for (int c = 0; c < 9; ++c)
            n[c] = wp::index(start, layout, node[0] + c / 3, node[1] + c % 3) + node[2];
    }
};

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

}  // namespace gendom
