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
# triangular U is needed, F = D U, and the pulls are P U^T. Vectors are kept by columns, then by
# components, then by particles.
_SIDE_BY_SIDE = """
    typedef REAL four __attribute__((ext_vector_type(4), aligned(sizeof(REAL))));
    typedef REAL wide __attribute__((ext_vector_type(WIDTH), aligned(sizeof(REAL))));
    struct columns { wide of[3][3]; };
    const auto load = [](const auto& a) { return four{a[0], a[1], a[2], REAL(0)}; };
    const auto numbers = [](const REAL& a) -> wide& { return *(wide*)&a; };
    const auto differences = [&](const auto& x, int row) {
        columns D;
        #pragma unroll
        for (int axis = 0; axis < 3; ++axis)
            #pragma unroll
            for (int l = 0; l < WIDTH; ++l) {
                const int* near = &wp::index(lattice, first + l, axis, 0);
                const four d = load(wp::index(x, row, near[1])) - load(wp::index(x, row, near[0]));
                D.of[axis][0][l] = d.x;
                D.of[axis][1][l] = d.y;
                D.of[axis][2][l] = d.z;
            }
        return D;
    };
    const wide U00 = numbers(wp::index(frame, 0, first)), U01 = numbers(wp::index(frame, 1, first));
    const wide U02 = numbers(wp::index(frame, 2, first)), U11 = numbers(wp::index(frame, 3, first));
    const wide U12 = numbers(wp::index(frame, 4, first)), U22 = numbers(wp::index(frame, 5, first));
    const auto framed = [&](const columns& D) {
        columns F;
        #pragma unroll
        for (int n = 0; n < 3; ++n) {
            F.of[0][n] = D.of[0][n] * U00;
            F.of[1][n] = D.of[0][n] * U01 + D.of[1][n] * U11;
            F.of[2][n] = D.of[0][n] * U02 + D.of[1][n] * U12 + D.of[2][n] * U22;
        }
        return F;
    };
    const auto put_unframed = [&](const columns& P) {
        #pragma unroll
        for (int axis = 0; axis < 3; ++axis) {
            wide h[3];
            #pragma unroll
            for (int n = 0; n < 3; ++n)
                h[n] = axis == 0 ? P.of[0][n] * U00 + P.of[1][n] * U01 + P.of[2][n] * U02
                     : axis == 1 ? P.of[1][n] * U11 + P.of[2][n] * U12 : P.of[2][n] * U22;
            #pragma unroll
            for (int l = 0; l < WIDTH; ++l)
                *(four*)wp::index(pulls, w, first + l).data[axis] =
                    four{h[0][l], h[1][l], h[2][l], REAL(0)};
        }
    };
    const auto dot = [](const wide (&a)[3], const wide (&b)[3]) {
        return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    };
    const columns F = framed(differences(x, row));
    columns C;
    #pragma unroll
    for (int j = 0; j < 3; ++j) {
        const auto& a = F.of[(j + 1) % 3];
        const auto& b = F.of[(j + 2) % 3];
        C.of[j][0] = a[1] * b[2] - a[2] * b[1];
        C.of[j][1] = a[2] * b[0] - a[0] * b[2];
        C.of[j][2] = a[0] * b[1] - a[1] * b[0];
    }
    const wide J = dot(F.of[0], C.of[0]);
    wide log_J;
    #pragma unroll
    for (int l = 0; l < WIDTH; ++l) log_J[l] = log_volume(J[l]);
    const wide mus = numbers(wp::index(mu, w, first)), lams = numbers(wp::index(lam, w, first));
"""

_TENSE = """
    const wide by_F = mus * impulse, by_C = impulse * (lams * log_J - mus) / J;
    columns P;
    #pragma unroll
    for (int j = 0; j < 3; ++j)
        #pragma unroll
        for (int n = 0; n < 3; ++n) P.of[j][n] = F.of[j][n] * by_F + C.of[j][n] * by_C;
    put_unframed(P);
    int culprit = -1;
    for (int l = 0; l < WIDTH; ++l)
        if (!(J[l] > REAL(0))) culprit = first + l;
    return culprit;
"""

# see ``neo_hookean_back``
_TENSE_BACK = """
    columns P = framed(differences(v_bar, w));
    #pragma unroll
    for (int j = 0; j < 3; ++j)
        #pragma unroll
        for (int n = 0; n < 3; ++n) {
            P.of[j][n] *= by_difference;
            C.of[j][n] /= J;
        }
    const wide share = dot(P.of[0], C.of[0]) + dot(P.of[1], C.of[1]) + dot(P.of[2], C.of[2]);
    const wide part = lams * log_J - mus;
    columns back;
    #pragma unroll
    for (int k = 0; k < 3; ++k) {
        const wide M0 = dot(P.of[0], C.of[k]), M1 = dot(P.of[1], C.of[k]);
        const wide M2 = dot(P.of[2], C.of[k]);
        #pragma unroll
        for (int n = 0; n < 3; ++n)
            back.of[k][n] = mus * P.of[k][n] + lams * share * C.of[k][n]
                - part * (C.of[0][n] * M0 + C.of[1][n] * M1 + C.of[2][n] * M2);
    }
    put_unframed(back);
    const wide by_mu =
        dot(P.of[0], F.of[0]) + dot(P.of[1], F.of[1]) + dot(P.of[2], F.of[2]) - share;
    #pragma unroll
    for (int l = 0; l < WIDTH; ++l)
        if (first + l >= fresh) {
            wp::index(mu_bar, w, first + l) += by_mu[l];
            wp::index(lam_bar, w, first + l) += (log_J * share)[l];
        }
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
        transpose of the differences between neighbours; ``width``, how many particles the others
        take (CPU, neo-Hookean): ``tense_together``, which sets their pulls and returns one that is
        not upright (J <= 0), or -1, and ``tense_together_back``.
    """
    vec3 = wp.types.vector(3, real)
    pull = wp.types.matrix((3, 4), real)
    single = real == wp.float32
    width = _REGISTER // (4 if single else 8)

    def native(text: str) -> str:
        text = text.replace("REAL", "wp::float32" if single else "wp::float64")
        return text.replace("WIDTH", str(width))

    side_by_side = log_volume_text(real) + _SIDE_BY_SIDE

    @wp.func_native(native(side_by_side + _TENSE))
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

    @wp.func_native(native(side_by_side + _TENSE_BACK))
    def tense_together_back(
        w: int,
        first: int,
        fresh: int,  # the first of which mu and lam have not been summed up
        x: wp.array2d(dtype=vec3),
        row: int,
        lattice: wp.array3d(dtype=wp.int32),
        frame: wp.array2d(dtype=real),
        mu: wp.array2d(dtype=real),
        lam: wp.array2d(dtype=real),
        by_difference: real,  # -(substep times volume over mass of a particle)
        v_bar: wp.array2d(dtype=vec3),  # [W, N]
        mu_bar: wp.array2d(dtype=real),  # [W, N]
        lam_bar: wp.array2d(dtype=real),
        pulls: wp.array2d(dtype=pull),  # [W, N] by the differences
    ): ...

    @wp.func_native(native(_PULLED))
    def pulled(
        p: int,
        lattice: wp.array3d(dtype=wp.int32),
        pulls: wp.array2d(dtype=pull),
        w: int,
    ) -> vec3: ...

    return SimpleNamespace(
        pull=pull,
        pulled=pulled,
        width=width,
        tense_together=tense_together,
        tense_together_back=tense_together_back,
    )
