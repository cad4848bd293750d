"""Forces between the particles of an elastic body as native code.

On the CPU Warp's own vectors do not become SIMD lanes. Here several particles are tensed side by
side, a lane for each; what ``gendom.sim.transfers`` does one by one, for any law and on any device,
is done for the default law.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.materials.laws import log_volume_text

_REGISTER = 32
"""Bytes of a SIMD register."""

# A rotation of the rest frame changes nothing for an isotropic body: of the frame R = U Q only the
# triangular U is needed, F = D U, and the pulls are P U^T.
_TENSE = """
    typedef REAL four __attribute__((ext_vector_type(4), aligned(sizeof(REAL))));
    typedef REAL wide __attribute__((ext_vector_type(WIDTH), aligned(sizeof(REAL))));
    const auto load = [](const auto& a) { return four{a[0], a[1], a[2], REAL(0)}; };
    wide D[3][3];
    #pragma unroll
    for (int axis = 0; axis < 3; ++axis)
        #pragma unroll
        for (int l = 0; l < WIDTH; ++l) {
            const int* near = &wp::index(lattice, first + l, axis, 0);
            const four d = load(wp::index(x, row, near[1])) - load(wp::index(x, row, near[0]));
            D[axis][0][l] = d.x;
            D[axis][1][l] = d.y;
            D[axis][2][l] = d.z;
        }
    const auto of_frame = [&](int n) { return *(const wide*)&wp::index(frame, n, first); };
    const wide U00 = of_frame(0), U01 = of_frame(1), U02 = of_frame(2);
    const wide U11 = of_frame(3), U12 = of_frame(4), U22 = of_frame(5);
    wide F[3][3], C[3][3];
    #pragma unroll
    for (int n = 0; n < 3; ++n) {
        F[0][n] = D[0][n] * U00;
        F[1][n] = D[0][n] * U01 + D[1][n] * U11;
        F[2][n] = D[0][n] * U02 + D[1][n] * U12 + D[2][n] * U22;
    }
    #pragma unroll
    for (int j = 0; j < 3; ++j) {
        const auto& a = F[(j + 1) % 3];
        const auto& b = F[(j + 2) % 3];
        C[j][0] = a[1] * b[2] - a[2] * b[1];
        C[j][1] = a[2] * b[0] - a[0] * b[2];
        C[j][2] = a[0] * b[1] - a[1] * b[0];
    }
    const wide J = F[0][0] * C[0][0] + F[0][1] * C[0][1] + F[0][2] * C[0][2];
    int culprit = -1;
    wide log_J;
    #pragma unroll
    for (int l = 0; l < WIDTH; ++l) {
        log_J[l] = log_volume(J[l]);
        if (!(J[l] > REAL(0))) culprit = first + l;
    }
    const wide mus = *(const wide*)&wp::index(mu, w, first);
    const wide lams = *(const wide*)&wp::index(lam, w, first);
    const wide by_F = mus * impulse, by_C = impulse * (lams * log_J - mus) / J;
    #pragma unroll
    for (int n = 0; n < 3; ++n) {
        const wide P0 = F[0][n] * by_F + C[0][n] * by_C, P1 = F[1][n] * by_F + C[1][n] * by_C;
        const wide P2 = F[2][n] * by_F + C[2][n] * by_C;
        D[0][n] = P0 * U00 + P1 * U01 + P2 * U02;
        D[1][n] = P1 * U11 + P2 * U12;
        D[2][n] = P2 * U22;
    }
    #pragma unroll
    for (int axis = 0; axis < 3; ++axis)
        #pragma unroll
        for (int l = 0; l < WIDTH; ++l)
            *(four*)wp::index(pulls, w, first + l).data[axis] =
                four{D[axis][0][l], D[axis][1][l], D[axis][2][l], REAL(0)};
    return culprit;
"""

_PULLED = """
#if defined(__CUDA_ARCH__)
    typedef wp::vec_t<4, REAL> four;
#else
    typedef REAL four __attribute__((ext_vector_type(4), aligned(sizeof(REAL))));
#endif
    const int* near = &wp::index(lattice, p, 0, 0);
    const wp::vec_t<4, REAL> none = {};
    four total = *(const four*)&none;
    #pragma unroll
    for (int axis = 0; axis < 3; ++axis) {
        const int a = near[2 * axis], b = near[2 * axis + 1];
        const four back = *(const four*)wp::index(pulls, w, a).data[axis];
        const four forth = *(const four*)wp::index(pulls, w, b).data[axis];
        // where the lattice ends a particle stands in for the neighbour that it lacks
        total = total + forth * REAL(b == p ? -1 : 1) - back * REAL(a == p ? -1 : 1);
    }
    return wp::vec_t<3, REAL>(total[0], total[1], total[2]);
"""


@functools.cache
def make_lanes(real: Any) -> SimpleNamespace:
    """Build the functions for one scalar type.

    Returns:
        Namespace with ``pull``, the type of a particle's pulls (a row for each lattice axis, padded
        to four numbers); ``pulled``, their sum on a particle, which is but for its sign the
        transpose of the differences between neighbours; ``width``, how many particles
        ``tense_together`` (CPU, neo-Hookean) takes, which sets their pulls and returns one that is
        not upright (J <= 0), or -1.
    """
    vec3 = wp.types.vector(3, real)
    pull = wp.types.matrix((3, 4), real)
    single = real == wp.float32
    width = _REGISTER // (4 if single else 8)

    def native(text: str) -> str:
        text = text.replace("REAL", "wp::float32" if single else "wp::float64")
        return text.replace("WIDTH", str(width))

    @wp.func_native(native(log_volume_text(real) + _TENSE))
    def tense_together(
        w: int,
        first: int,
        x: wp.array2d(dtype=vec3),  # [rows, N]
        row: int,
        lattice: wp.array3d(dtype=wp.int32),  # [N, 3, 2]
        frame: wp.array2d(dtype=real),  # [6, N] upper triangle, row by row
        mu: wp.array2d(dtype=real),  # [W, N]
        lam: wp.array2d(dtype=real),
        impulse: real,  # substep times volume of a particle
        pulls: wp.array2d(dtype=pull),  # [W, N]
    ) -> int: ...

    @wp.func_native(native(_PULLED))
    def pulled(
        p: int,
        lattice: wp.array3d(dtype=wp.int32),
        pulls: wp.array2d(dtype=pull),
        w: int,
    ) -> vec3: ...

    return SimpleNamespace(pull=pull, pulled=pulled, width=width, tense_together=tense_together)
