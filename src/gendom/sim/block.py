"""What the threads of a CUDA block do together; on the CPU a block is one thread.

A kernel that gives each world a block reads the same on both devices: its loops take every
``lanes``-th particle or node from ``lane`` on, and the threads meet between them.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

_MEET = """
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
"""

_LARGEST = """
#if defined(__CUDA_ARCH__)
    __shared__ REAL of_warp[32];
    for (int by = 16; by > 0; by /= 2) value = max(value, __shfl_xor_sync(0xffffffffu, value, by));
    const int warps = blockDim.x / 32, own = threadIdx.x % 32;
    if (own == 0) of_warp[threadIdx.x / 32] = value;
    __syncthreads();
    value = of_warp[own < warps ? own : 0];
    for (int by = 16; by > 0; by /= 2) value = max(value, __shfl_xor_sync(0xffffffffu, value, by));
#endif
    return value;
"""

_BEFORE = """
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
"""


@functools.cache
def make_block(real: Any) -> SimpleNamespace:
    """Build the functions for one scalar type; all threads of a block must call them.

    Returns:
        Namespace with ``meet``, after which every thread sees what the others have written;
        ``largest``, the largest of all threads' values (no NaN), which meets too, and wants
        another meeting before it is called again; ``before``, the sum of the values of the
        threads before this one.
    """

    @wp.func_native(_MEET)
    def meet(): ...

    name = "wp::float32" if real == wp.float32 else "wp::float64"

    @wp.func_native(_LARGEST.replace("REAL", name))
    def largest(value: real) -> real: ...

    @wp.func_native(_BEFORE)
    def before(value: int) -> int: ...

    return SimpleNamespace(meet=meet, largest=largest, before=before)
