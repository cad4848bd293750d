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

from gendom.sim.rounding import make_rounding

_MEET = """
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
"""

_ANY = """
#if defined(__CUDA_ARCH__)
    return __syncthreads_or(value) ? 1 : 0;
#else
    return value;
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


_IN_SHARED_MEMORY = """
#if defined(__CUDA_ARCH__)
    extern __shared__ REAL resident[];
    REAL& there = resident[c * of.shape[2] + i];
#else
    REAL& there = wp::index(of, row, c, i);
#endif
"""

_ADD = """
#if defined(__CUDA_ARCH__)
    atomicAdd(&there, value);
#else
    there += value;
#endif
"""

Near = wp.types.vector(6, wp.int32)
"""Where a particle's neighbours are, before and behind along each axis of the lattice."""

LOWER = wp.constant(0xFFFF)
"""Bits of the first of two indices in one number."""

ROOMS_OF_TWO = (96_000, 112_000)
"""Shared memory for the particles of one of two blocks on a multiprocessor [bytes]; the smaller
leaves more of it to the cache."""

ROOM_ALONE = 192_000
"""The same of a block that has a multiprocessor to itself."""


def bounds(lanes: int) -> tuple[int, int]:
    """Launch bounds of a block: two on a multiprocessor where registers allow."""
    return lanes, 2 if lanes <= 192 else 1


@functools.cache
def make_store(real: Any, *, resident: bool) -> SimpleNamespace:
    """Build the access to particles by component, for one scalar type.

    Args:
        real: ``wp.float32`` or ``wp.float64``.
        resident: Whether a CUDA block has its particles in shared memory while it runs, all of
            that its kernel sets aside; otherwise they stand in an array.

    Returns:
        Namespace with ``get``, ``put`` and ``add`` (atomic) of component c of particle i in a row
        of the array ``of`` [rows, components, N]; with ``vector``, ``put_vector``, ``matrix``,
        ``put_matrix`` of the components from c on; with ``differences`` and ``pulled``, those of
        ``gendom.sim.transfers`` between the particles of a row; and with ``step_on``.
    """
    store = _numbers(real, resident=resident)
    get, put = store.get, store.put
    vec3 = wp.types.vector(3, real)
    mat33 = wp.types.matrix((3, 3), real)
    rounding = make_rounding(real)
    rounds, sum_up = rounding.rounds, rounding.sum_up

    @wp.func
    def vector(of: wp.array3d(dtype=real), row: int, c: int, i: int):
        return vec3(get(of, row, c, i), get(of, row, c + 1, i), get(of, row, c + 2, i))

    @wp.func
    def put_vector(of: wp.array3d(dtype=real), row: int, c: int, i: int, a: vec3):
        for n in range(3):
            put(of, row, c + n, i, a[n])

    @wp.func
    def matrix(of: wp.array3d(dtype=real), row: int, c: int, i: int):
        return mat33(
            get(of, row, c, i), get(of, row, c + 1, i), get(of, row, c + 2, i),
            get(of, row, c + 3, i), get(of, row, c + 4, i), get(of, row, c + 5, i),
            get(of, row, c + 6, i), get(of, row, c + 7, i), get(of, row, c + 8, i),
        )  # fmt: skip

    @wp.func
    def put_matrix(of: wp.array3d(dtype=real), row: int, c: int, i: int, A: mat33):
        for m in range(3):
            for n in range(3):
                put(of, row, c + 3 * m + n, i, A[m, n])

    @wp.func
    def differences(of: wp.array3d(dtype=real), row: int, c: int, near: Near):
        """Differences [3, axis] of the vectors at c between a particle's neighbours."""
        D = mat33()
        for axis in range(3):
            d = vector(of, row, c, near[2 * axis + 1]) - vector(of, row, c, near[2 * axis])
            for n in range(3):
                D[n, axis] = d[n]
        return D

    @wp.func
    def pulled(of: wp.array3d(dtype=real), row: int, c: int, near: Near, i: int):
        """Sum of the pulls, the matrices at c, on a particle."""
        total = vec3()
        for axis in range(3):
            a = near[2 * axis]
            b = near[2 * axis + 1]
            # where the lattice ends a particle stands in for the neighbour that it lacks
            back = wp.where(a == i, real(-1.0), real(1.0))
            forth = wp.where(b == i, real(-1.0), real(1.0))
            for n in range(3):
                total[n] += forth * get(of, row, c + 3 * n + axis, b)
                total[n] -= back * get(of, row, c + 3 * n + axis, a)
        return total

    @wp.func
    def step_on(of: wp.array3d(dtype=real), row: int, c: int, i: int, x: vec3, step: vec3):
        """x after a step; in float32 with what was left out so far, the vector at c."""
        there = x + step
        if rounds == 1:
            there, left_out = sum_up(x, step, vector(of, row, c, i))
            put_vector(of, row, c, i, left_out)
        return there

    return SimpleNamespace(
        **vars(store), vector=vector, put_vector=put_vector, matrix=matrix, put_matrix=put_matrix,
        differences=differences, pulled=pulled, step_on=step_on,
    )  # fmt: skip


@wp.func
def put_near(
    near: wp.array3d(dtype=wp.int32),  # [rows, 3, N], two indices in a number
    row: int,
    i: int,
    of: Near,
):
    for axis in range(3):
        near[row, axis, i] = of[2 * axis] | (of[2 * axis + 1] << 16)


@wp.func
def get_near(near: wp.array3d(dtype=wp.int32), row: int, i: int):
    a = near[row, 0, i]
    b = near[row, 1, i]
    c = near[row, 2, i]
    return Near(a & LOWER, a >> 16, b & LOWER, b >> 16, c & LOWER, c >> 16)


def _numbers(real: Any, *, resident: bool) -> SimpleNamespace:
    """``get``, ``put`` and ``add`` of ``make_store``."""
    if not resident:

        @wp.func
        def get_from_array(of: wp.array3d(dtype=real), row: int, c: int, i: int):
            return of[row, c, i]

        @wp.func
        def put_in_array(of: wp.array3d(dtype=real), row: int, c: int, i: int, value: real):
            of[row, c, i] = value

        @wp.func
        def add_to_array(of: wp.array3d(dtype=real), row: int, c: int, i: int, value: real):
            wp.atomic_add(of, row, c, i, value)

        return SimpleNamespace(get=get_from_array, put=put_in_array, add=add_to_array)

    there = _IN_SHARED_MEMORY.replace("REAL", _name(real))

    @wp.func_native(there + "return there;")
    def get(of: wp.array3d(dtype=real), row: int, c: int, i: int) -> real: ...

    @wp.func_native(there + "there = value;")
    def put(of: wp.array3d(dtype=real), row: int, c: int, i: int, value: real): ...

    @wp.func_native(there + _ADD)
    def add(of: wp.array3d(dtype=real), row: int, c: int, i: int, value: real): ...

    return SimpleNamespace(get=get, put=put, add=add)


@functools.cache
def make_block(real: Any) -> SimpleNamespace:
    """Build the functions for one scalar type; all threads of a block must call them.

    Returns:
        Namespace with ``meet``, after which every thread sees what the others have written;
        ``any``, whether a thread's value is not 0, which meets too;
        ``largest``, the largest of all threads' values (no NaN), which meets too, and wants
        another meeting before it is called again; ``before``, the sum of the values of the
        threads before this one.
    """

    @wp.func_native(_MEET)
    def meet(): ...

    @wp.func_native(_ANY)
    def any_of(value: int) -> int: ...

    @wp.func_native(_LARGEST.replace("REAL", _name(real)))
    def largest(value: real) -> real: ...

    @wp.func_native(_BEFORE)
    def before(value: int) -> int: ...

    return SimpleNamespace(meet=meet, any=any_of, largest=largest, before=before)


def _name(real: Any) -> str:
    return "wp::float32" if real == wp.float32 else "wp::float64"
