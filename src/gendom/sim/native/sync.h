// What the threads of a CUDA block do together; on the CPU a block is one thread.
#pragma once

namespace gendom {

CUDA_CALLABLE inline void block_sync() {
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
}

// Whether a thread's value is not 0.
CUDA_CALLABLE inline int block_any(int value) {
#if defined(__CUDA_ARCH__)
    return __syncthreads_or(value) ? 1 : 0;
#else
    return value;
#endif
}

}  // namespace gendom
