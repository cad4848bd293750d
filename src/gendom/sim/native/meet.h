// What the threads of a CUDA block do together; on the CPU a block is one thread.
#pragma once

namespace gendom {

CUDA_CALLABLE inline void meet() {
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
}

// Whether a thread's value is not 0.
CUDA_CALLABLE inline int any_of(int value) {
#if defined(__CUDA_ARCH__)
    return __syncthreads_or(value) ? 1 : 0;
#else
    return value;
#endif
}

// The sum, or the largest, of all threads' values; every thread has it.
#if defined(__CUDA_ARCH__)
template <typename real, typename Join> __device__ inline real join_all(real value, Join join) {
    __shared__ real part[32];
    for (int o = 16; o > 0; o >>= 1) value = join(value, __shfl_xor_sync(0xffffffffu, value, o));
    if (threadIdx.x % 32 == 0) part[threadIdx.x / 32] = value;
    __syncthreads();
    value = part[0];
    for (unsigned k = 1; k < blockDim.x / 32; ++k) value = join(value, part[k]);
    __syncthreads();
    return value;
}
#endif
template <typename real> CUDA_CALLABLE inline real sum_of_all(real value) {
#if defined(__CUDA_ARCH__)
    return join_all(value, [](real a, real b) { return a + b; });
#else
    return value;
#endif
}
template <typename real> CUDA_CALLABLE inline real largest_of_all(real value) {
#if defined(__CUDA_ARCH__)
    return join_all(value, [](real a, real b) { return a > b ? a : b; });
#else
    return value;
#endif
}

}  // namespace gendom
