"""Forces between the particles of an elastic body, a vector's components side by side.

Native code, since on the CPU Warp's own vectors do not become SIMD lanes: what
``gendom.sim.transfers`` does for any law, here for the default one.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.materials.laws import log_volume_text

_LANES = """
#if defined(__CUDA_ARCH__)
    typedef wp::vec_t<3, REAL> lanes;
    const auto load = [](const auto& a) { return lanes(a[0], a[1], a[2]); };
    const auto cross = [](const lanes& a, const lanes& b) { return wp::cross(a, b); };
    const auto dot = [](const lanes& a, const lanes& b) { return wp::dot(a, b); };
#else
    typedef REAL lanes __attribute__((ext_vector_type(4), aligned(sizeof(REAL))));
    const auto load = [](const auto& a) { return lanes{a[0], a[1], a[2], REAL(0)}; };
    const auto cross = [](lanes a, lanes b) { return (a * b.yzxw - a.yzxw * b).yzxw; };
    const auto dot = [](lanes a, lanes b) { a *= b; return a.x + a.y + a.z; };
#endif
    const auto store = [](REAL* to, const lanes& a) { to[0] = a[0]; to[1] = a[1]; to[2] = a[2]; };
    const int* near = &wp::index(lattice, p, 0, 0);
"""

# F, its cofactors C and J of one particle; all by columns
_STRAIN = """
    const auto difference = [&](const auto& of, int row, int axis) {
        return load(wp::index(of, row, near[2 * axis + 1]))
             - load(wp::index(of, row, near[2 * axis]));
    };
    const auto& R = wp::index(rest_frame, p).data;
    const auto framed = [&R](const lanes& a, const lanes& b, const lanes& c, int j) {
        return a * R[0][j] + b * R[1][j] + c * R[2][j];
    };
    const auto unframed = [&R](const lanes& a, const lanes& b, const lanes& c, int k) {
        return a * R[k][0] + b * R[k][1] + c * R[k][2];
    };
    const lanes D0 = difference(x, row, 0), D1 = difference(x, row, 1), D2 = difference(x, row, 2);
    const lanes F0 = framed(D0, D1, D2, 0), F1 = framed(D0, D1, D2, 1), F2 = framed(D0, D1, D2, 2);
    const lanes C0 = cross(F1, F2), C1 = cross(F2, F0), C2 = cross(F0, F1);
    const REAL J = dot(F0, C0);
"""

_TENSE = """
    const REAL k = impulse * mu, c = impulse * (lam * log_volume(J) - mu) / J;
    const lanes P0 = F0 * k + C0 * c, P1 = F1 * k + C1 * c, P2 = F2 * k + C2 * c;
    auto& pull = wp::index(pulls, w, p).data;
    store(pull[0], unframed(P0, P1, P2, 0));
    store(pull[1], unframed(P0, P1, P2, 1));
    store(pull[2], unframed(P0, P1, P2, 2));
    return J > REAL(0);
"""

_PULLED = """
    lanes total = load(wp::vec_t<3, REAL>());
    #pragma unroll
    for (int axis = 0; axis < 3; ++axis) {
        const int a = near[2 * axis], b = near[2 * axis + 1];
        const lanes back = load(wp::index(pulls, w, a).data[axis]);
        const lanes forth = load(wp::index(pulls, w, b).data[axis]);
        total = total + (b == p ? -forth : forth) - (a == p ? -back : back);
    }
    return wp::vec_t<3, REAL>(total[0], total[1], total[2]);
"""


@functools.cache
def make_lanes(real: Any) -> SimpleNamespace:
    """Build the functions for one scalar type and the neo-Hookean law.

    Returns:
        Namespace with ``tense`` (sets a particle's pulls, returns whether it is upright) and
        ``pulled`` (their sum on a particle).
    """
    vec3 = wp.types.vector(3, real)
    mat33 = wp.types.matrix((3, 3), real)

    def native(text: str) -> str:
        name = "wp::float32" if real == wp.float32 else "wp::float64"
        return (_LANES + text).replace("REAL", name)

    @wp.func_native(native(_STRAIN + log_volume_text(real) + _TENSE))
    def tense(
        p: int,
        x: wp.array2d(dtype=vec3),  # [rows, N]
        row: int,
        lattice: wp.array3d(dtype=wp.int32),
        rest_frame: wp.array(dtype=mat33),
        mu: real,
        lam: real,
        impulse: real,  # substep times volume of a particle
        pulls: wp.array2d(dtype=mat33),  # [W, N]
        w: int,
    ) -> bool: ...

    @wp.func_native(native(_PULLED))
    def pulled(
        p: int,
        lattice: wp.array3d(dtype=wp.int32),
        pulls: wp.array2d(dtype=mat33),  # [W, N]
        w: int,
    ) -> vec3: ...

    return SimpleNamespace(tense=tense, pulled=pulled)
