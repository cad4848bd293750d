// What else the threads of a CUDA block do together, see vectors.h; on the CPU a block is one thread.
#pragma once

namespace gendom {

// The largest of all threads' values (no NaN); wants another meeting before it is called again.
template <typename real> CUDA_CALLABLE inline real largest(real value) {
#if defined(__CUDA_ARCH__)
    __shared__ real of_warp[32];
    for (int by = 16; by > 0; by /= 2) value = max(value, __shfl_xor_sync(0xffffffffu, value, by));
    const int warps = blockDim.x / 32, own = threadIdx.x % 32;
    if (own == 0) of_warp[threadIdx.x / 32] = value;
    __syncthreads();
    value = of_warp[own < warps ? own : 0];
    for (int by = 16; by > 0; by /= 2) value = max(value, __shfl_xor_sync(0xffffffffu, value, by));
#endif
    return value;
}

// Add the sum of a warp's values to an array's element; all its threads must call it.
CUDA_CALLABLE inline void add_by_warp(const wp::array_t<wp::vec3d>& to, int i, int j, wp::vec3d value) {
#if defined(__CUDA_ARCH__)
    for (int by = 16; by > 0; by /= 2)
        for (int c = 0; c < 3; ++c) value[c] += __shfl_xor_sync(0xffffffffu, value[c], by);
    if (threadIdx.x % 32 == 0) wp::atomic_add(to, i, j, value);
#else
    wp::atomic_add(to, i, j, value);
#endif
}

// The sum of the values of the threads before this one.
CUDA_CALLABLE inline int sum_before(int value) {
#if defined(__CUDA_ARCH__)
    __shared__ int of_warp[32];
    const int own = threadIdx.x % 32, warp = threadIdx.x / 32;
    int sum = value;
    for (int by = 1; by < 32; by *= 2) {
        const int lower = __shfl_up_sync(0xffffffffu, sum, by);
        if (own >= by) sum += lower;
    }
    if (own == 31) of_warp[warp] = sum;
    __syncthreads();
    sum -= value;
    for (int i = 0; i < warp; ++i) sum += of_warp[i];
    __syncthreads();
    return sum;
#else
    return 0;
#endif
}

// Component c of particle i: of an array's row, or of a block whose particles stay in shared memory.
template <bool in_shared, typename real>
CUDA_CALLABLE inline real& component(const wp::array_t<real>& of, int row, int c, int i) {
#if defined(__CUDA_ARCH__)
    extern __shared__ __align__(16) unsigned char gendom_shared[];
    if (in_shared) return ((real*)gendom_shared)[c * of.shape[2] + i];
#endif
    return of.data[((size_t)row * of.shape[1] + c) * of.shape[2] + i];
}

// The vector or matrix of the components of particle i from c on.
template <bool in_shared, typename V, typename real>
CUDA_CALLABLE inline V get_as(const wp::array_t<real>& of, int row, int c, int i) {
    V a;
    #pragma unroll
    for (unsigned n = 0; n < sizeof(V) / sizeof(real); ++n)
        ((real*)&a)[n] = component<in_shared>(of, row, c + n, i);
    return a;
}
template <bool in_shared, typename V, typename real>
CUDA_CALLABLE inline void put_as(const wp::array_t<real>& of, int row, int c, int i, const V& a) {
    #pragma unroll
    for (unsigned n = 0; n < sizeof(V) / sizeof(real); ++n)
        component<in_shared>(of, row, c + n, i) = ((const real*)&a)[n];
}

// Where the neighbours of particle p are, which is the i-th, before and behind it along an axis.
CUDA_CALLABLE inline void put_near(const wp::array_t<int>& near, int w, int i, int p,
                                   const wp::array_t<int>& lattice, const wp::array_t<int>& place, int row) {
    for (int axis = 0; axis < 3; ++axis)
        for (int side = 0; side < 2; ++side)
            wp::index(near, w, axis + 3 * side, i) = wp::index(place, row, wp::index(lattice, p, axis, side));
}
CUDA_CALLABLE inline int before(const wp::array_t<int>& near, int w, int axis, int i) {
    return wp::index(near, w, axis, i);
}
CUDA_CALLABLE inline int behind(const wp::array_t<int>& near, int w, int axis, int i) {
    return wp::index(near, w, axis + 3, i);
}

// Where a byte of that memory is.
CUDA_CALLABLE inline wp::uint64 resident_at(int byte) {
#if defined(__CUDA_ARCH__)
    extern __shared__ __align__(16) unsigned char gendom_shared[];
    return (wp::uint64)(gendom_shared + byte);
#else
    return 0;
#endif
}

}  // namespace gendom
