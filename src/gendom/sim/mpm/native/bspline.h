// Sums over the 27 grid nodes around a particle, the inner loops of every substep.
//
// A particle with coefficients q, a_x, a_y, a_z (four numbers each) and node values h_n forms
//
//     P = sum_n h_n . w_n (q + i a_x + j a_y + k a_z)
//
// with quadratic B-spline weights w_n of the node (i, j, k) in 0..2 at the particle's place f in
// cells above its lowest node (each in 0.5..1.5). Everything that particles and grid exchange is a
// derivative of P: `scatter` adds dP/dh to the grid, `gather` returns dP/dq and dP/da, and the
// adjoint needs dP/df besides. Rows q, a_x, a_y, a_z of a 4 x 4 matrix hold coefficients, and
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

}  // namespace gendom
