"""What the blocks of a team do together: all the threads of several blocks, for one world.

The blocks of a team must run at the same time, or they wait for each other forever; whoever
launches them sees to it that they fit on the device. On the CPU a team is one thread.
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
    if (threadIdx.x == 0) {
        const int* came = &wp::index(gate, team);
        int now;
        asm volatile("red.release.gpu.global.add.s32 [%0], 1;" : : "l"(came) : "memory");
        do
            asm volatile("ld.acquire.gpu.global.s32 %0, [%1];" : "=r"(now) : "l"(came) : "memory");
        while (now - expected < 0);
    }
    __syncthreads();
#endif
"""

_LIFT = """
#if defined(__CUDA_ARCH__)
    for (int by = 16; by > 0; by /= 2) value = max(value, __shfl_xor_sync(0xffffffffu, value, by));
    // numbers that are not negative are in the order of their bits
    if (threadIdx.x % 32 == 0)
        atomicMax((BITS*)&wp::index(peak, team, slot), AS_BITS(value));
#else
    REAL& highest = wp::index(peak, team, slot);
    if (value > highest) highest = value;
#endif
"""


@functools.cache
def make_team(real: Any) -> SimpleNamespace:
    """Build the functions for one scalar type; all threads of a team must call them.

    Returns:
        Namespace with ``meet``, after which every thread sees what the others have written
        (``gate`` [teams] counts the blocks that came, from 0 before the launch; ``expected`` is
        what it will have counted when all have), and ``lift``, which raises
        a number of ``peak`` [teams, slots] to the largest of all threads' values (not negative, no
        NaN), to be read after the next meeting.
    """

    @wp.func_native(_MEET)
    def meet(gate: wp.array(dtype=wp.int32), team: int, expected: int): ...

    single = real == wp.float32
    text = _LIFT.replace("REAL", "wp::float32" if single else "wp::float64")
    text = text.replace("AS_BITS", "__float_as_int" if single else "__double_as_longlong")
    text = text.replace("BITS", "int" if single else "long long")

    @wp.func_native(text)
    def lift(peak: wp.array2d(dtype=real), team: int, slot: int, value: real): ...

    return SimpleNamespace(meet=meet, lift=lift)
