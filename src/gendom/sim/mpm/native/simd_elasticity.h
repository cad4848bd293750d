// Internal forces of several neighbouring particles side by side, one in each part of a SIMD register (CPU).
//
// What gendom.sim.mpm.elasticity does one particle at a time, on CUDA: P = mu (F - F^-T)
// + lam log(J) F^-T and, of materials with damping, (1 + g) P - g F Z with the filtered stress Z (a
// standard linear solid).
//
// A rotation of the rest frame changes nothing for an isotropic body: of the frame B = U Q only the
// triangular U is needed, F = D U, and the pulls on the neighbours are P U^T. Vectors are kept by
// columns, then by components, then by particles.
#pragma once

namespace gendom {

// log(J); near 1 by its series 2 (s + s^3/3 + ...), s = (J - 1)/(J + 1), without a call.
template <typename real> CUDA_CALLABLE inline real log_volume(real J) {
    if (!(J > real(0.75) && J < real(1.25))) return wp::log(J);
    const real s = (J - real(1)) / (J + real(1)), q = s * s;
    real sum = real(0);
    constexpr int terms = sizeof(real) == 4 ? 5 : 10;
    #pragma unroll
    for (int n = terms; n > 0; --n) sum = sum * q + real(2.0 / (2 * n - 1));
    return sum * s;
}

template <typename real> using impulses_of = wp::mat_t<3, 4, real>;  // a row for each axis, padded

#if !defined(__CUDA_ARCH__)

template <typename real> struct registers;
template <> struct registers<float> {
    static constexpr int width = 8;
    typedef float wide __attribute__((ext_vector_type(8), aligned(4)));
};
template <> struct registers<double> {
    static constexpr int width = 4;
    typedef double wide __attribute__((ext_vector_type(4), aligned(8)));
};

template <typename real> struct side_by_side {
    static constexpr int width = registers<real>::width;
    typedef typename registers<real>::wide wide;
    typedef typename simd<real>::four four;
    struct columns {
        wide of[3][3];
        template <typename Number> static columns each(Number number) {
            columns out;
            #pragma unroll
            for (int j = 0; j < 3; ++j)
                #pragma unroll
                for (int n = 0; n < 3; ++n) out.of[j][n] = number(j, n);
            return out;
        }
        columns operator+(const columns& b) const {
            return each([&](int j, int n) { return of[j][n] + b.of[j][n]; });
        }
        columns operator-(const columns& b) const {
            return each([&](int j, int n) { return of[j][n] - b.of[j][n]; });
        }
        template <typename S> columns operator*(S s) const {
            return each([&](int j, int n) { return of[j][n] * s; });
        }
    };
    struct symmetric { wide xx, yy, zz, xy, xz, yz; };

    int w, first;
    wide U00, U01, U02, U11, U12, U22;

    static const wide& numbers(const real& a) { return *(const wide*)&a; }

    side_by_side(int w, int first, const wp::array_t<real>& frame) : w(w), first(first) {
        U00 = numbers(wp::index(frame, 0, first));
        U01 = numbers(wp::index(frame, 1, first));
        U02 = numbers(wp::index(frame, 2, first));
        U11 = numbers(wp::index(frame, 3, first));
        U12 = numbers(wp::index(frame, 4, first));
        U22 = numbers(wp::index(frame, 5, first));
    }

    columns differences(const wp::array_t<vec3<real>>& of, int row,
                        const wp::array_t<int>& lattice) const {
        columns D;
        const auto load = [](const vec3<real>& a) { return four{a[0], a[1], a[2], real(0)}; };
        #pragma unroll
        for (int axis = 0; axis < 3; ++axis)
            #pragma unroll
            for (int l = 0; l < width; ++l) {
                const int* near = &wp::index(lattice, first + l, axis, 0);
                const four d = load(wp::index(of, row, near[1])) - load(wp::index(of, row, near[0]));
                D.of[axis][0][l] = d.x;
                D.of[axis][1][l] = d.y;
                D.of[axis][2][l] = d.z;
            }
        return D;
    }
    columns framed(const columns& D) const {
        columns F;
        #pragma unroll
        for (int n = 0; n < 3; ++n) {
            F.of[0][n] = D.of[0][n] * U00;
            F.of[1][n] = D.of[0][n] * U01 + D.of[1][n] * U11;
            F.of[2][n] = D.of[0][n] * U02 + D.of[1][n] * U12 + D.of[2][n] * U22;
        }
        return F;
    }
    // Only of particles from `fresh` on: others have been done before.
    void put_unframed(const columns& P, const wide (&padding)[3],
                      const wp::array_t<impulses_of<real>>& impulses, int fresh) const {
        const int begin = fresh > first ? fresh - first : 0;
        #pragma unroll
        for (int axis = 0; axis < 3; ++axis) {
            wide h[3];
            #pragma unroll
            for (int n = 0; n < 3; ++n)
                h[n] = axis == 0 ? P.of[0][n] * U00 + P.of[1][n] * U01 + P.of[2][n] * U02
                     : axis == 1 ? P.of[1][n] * U11 + P.of[2][n] * U12 : P.of[2][n] * U22;
            for (int l = begin; l < width; ++l)
                *(four*)wp::index(impulses, w, first + l).data[axis] =
                    four{h[0][l], h[1][l], h[2][l], padding[axis][l]};
        }
    }
    static wide dot(const wide (&a)[3], const wide (&b)[3]) {
        return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    }
    static wide square_root(wide a) {
        #pragma unroll
        for (int l = 0; l < width; ++l) a[l] = wp::sqrt(a[l]);
        return a;
    }
    // Impulses of the air, see gendom.sim.mpm.elasticity.air; `strength` is its drag times -dt.
    void air(const columns& D, const wp::array_t<vec3<real>>& v, int row,
             const wp::array_t<real>& per_span, int sheet, real strength, wide (&wind)[3]) const {
        wide u[3], a[3], b[3];
        #pragma unroll
        for (int l = 0; l < width; ++l) {
            const auto& own = wp::index(v, row, first + l);
            #pragma unroll
            for (int n = 0; n < 3; ++n) u[n][l] = own[n];
        }
        const wide s0 = numbers(wp::index(per_span, 0, first));
        #pragma unroll
        for (int n = 0; n < 3; ++n) a[n] = D.of[0][n] * s0;
        if (sheet) {
            const wide s1 = numbers(wp::index(per_span, 1, first));
            #pragma unroll
            for (int n = 0; n < 3; ++n) b[n] = D.of[1][n] * s1;
            const wide area[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                                  a[0] * b[1] - a[1] * b[0]};
            const wide along = dot(u, area), squared = dot(area, area);
            wide pressure = along / squared;
            #pragma unroll
            for (int l = 0; l < width; ++l) pressure[l] *= wp::abs(along[l]) * strength;
            #pragma unroll
            for (int n = 0; n < 3; ++n) wind[n] = area[n] * pressure;
        } else {
            const wide squared = dot(a, a);
            const wide share = dot(u, a) / squared;
            #pragma unroll
            for (int n = 0; n < 3; ++n) wind[n] = u[n] - share * a[n];
            const wide by = strength * square_root(squared * dot(wind, wind));
            #pragma unroll
            for (int n = 0; n < 3; ++n) wind[n] *= by;
        }
    }
    static columns cofactors(const columns& F) {
        columns C;
        #pragma unroll
        for (int j = 0; j < 3; ++j) {
            const auto& a = F.of[(j + 1) % 3];
            const auto& b = F.of[(j + 2) % 3];
            C.of[j][0] = a[1] * b[2] - a[2] * b[1];
            C.of[j][1] = a[2] * b[0] - a[0] * b[2];
            C.of[j][2] = a[0] * b[1] - a[1] * b[0];
        }
        return C;
    }
    static wide log_volumes(const wide& J) {
        wide log_J;
        #pragma unroll
        for (int l = 0; l < width; ++l) log_J[l] = log_volume(J[l]);
        return log_J;
    }
    // S = mu (1 - C^-1) + lam log(J) C^-1 from the columns of F^-T; `pressure` is lam log(J) - mu.
    static symmetric second_piola(const columns& B, const wide& mu, const wide& pressure) {
        return {mu + pressure * dot(B.of[0], B.of[0]), mu + pressure * dot(B.of[1], B.of[1]),
                mu + pressure * dot(B.of[2], B.of[2]), pressure * dot(B.of[0], B.of[1]),
                pressure * dot(B.of[0], B.of[2]), pressure * dot(B.of[1], B.of[2])};
    }
    symmetric load(const wp::array_t<real>& of, int row) const {
        const auto at = [&](int c) { return numbers(wp::index(of, row, c, first)); };
        return {at(0), at(1), at(2), at(3), at(4), at(5)};
    }
    void put(const symmetric& Z, const wp::array_t<real>& of, int row, int fresh) const {
        const wide* parts = &Z.xx;
        #pragma unroll
        for (int c = 0; c < 6; ++c) {
            real* at = &wp::index(of, row, c, first);
            if (fresh <= first)
                *(wide*)at = parts[c];
            else
                for (int l = fresh - first; l < width; ++l) at[l] = parts[c][l];
        }
    }
    // Columns of F Z.
    static columns times(const columns& F, const symmetric& Z) {
        columns out;
        #pragma unroll
        for (int n = 0; n < 3; ++n) {
            out.of[0][n] = F.of[0][n] * Z.xx + F.of[1][n] * Z.xy + F.of[2][n] * Z.xz;
            out.of[1][n] = F.of[0][n] * Z.xy + F.of[1][n] * Z.yy + F.of[2][n] * Z.yz;
            out.of[2][n] = F.of[0][n] * Z.xz + F.of[1][n] * Z.yz + F.of[2][n] * Z.zz;
        }
        return out;
    }
};

// Set the impulses of several particles on their neighbours, those of the air on them, and the
// filtered stress after the substep; returns one whose J <= 0, or -1. `keep` is what Z keeps in a
// substep and `share` is g; both 0 without damping. Structs are those of gendom.sim.mpm.
template <typename real, typename Model, typename State>
inline int internal_forces(int w, int first, int fresh, real dt, real keep, real share,
                           const Model& model, const State& state) {
    typedef side_by_side<real> S;
    typedef typename S::wide wide;
    const S at(w, first, model.frame);
    const auto D = at.differences(state.x, w, model.lattice);
    const real impulse = dt * model.volume, strength = -dt * wp::index(model.drag, w);
    const auto F = at.framed(D);
    wide wind[3] = {wide(real(0)), wide(real(0)), wide(real(0))};
    if (strength != real(0))
        at.air(D, state.v, w, model.per_span, model.sheet, strength, wind);
    auto C = S::cofactors(F);
    const wide J = S::dot(F.of[0], C.of[0]);
    const wide mus = S::numbers(wp::index(model.mu, w, first));
    const wide lams = S::numbers(wp::index(model.lam, w, first));
    const wide pressure = lams * S::log_volumes(J) - mus;
    typename S::columns P;
    if (share == real(0)) {
        const wide by_F = mus * impulse, by_C = impulse * pressure / J;
        P = F * by_F + C * by_C;
    } else {
        C = C * (real(1) / J);
        auto filtered = at.load(state.Z, w);
        const auto FZ = S::times(F, filtered);
        const auto stress = S::second_piola(C, mus, pressure);
        const wide by_F = mus * (impulse * (real(1) + share));
        const wide by_C = pressure * (impulse * (real(1) + share));
        P = F * by_F + C * by_C - FZ * (impulse * share);
        wide* old = &filtered.xx;
        const wide* now = &stress.xx;
        #pragma unroll
        for (int c = 0; c < 6; ++c) old[c] += (real(1) - keep) * (now[c] - old[c]);
        at.put(filtered, state.Z, w, fresh);
    }
    at.put_unframed(P, wind, state.impulses, fresh);
    int inverted = -1;
    for (int l = 0; l < S::width; ++l)
        if (!(J[l] > real(0))) inverted = first + l;
    return inverted;
}

// Transpose of internal_forces. Sums up only what particles from `fresh` on add; returns their
// derivative by the share g and by `keep`.
template <typename real, typename Model, typename Tape, typename Adjoint>
inline wp::vec_t<2, real> internal_forces_adjoint(int w, int first, int fresh, int row, real dt,
                                                  real keep, real share, const Model& model,
                                                  const Tape& tape, const Adjoint& adjoint) {
    typedef side_by_side<real> S;
    typedef typename S::wide wide;
    const S at(w, first, model.frame);
    const real by_difference = -(dt * model.volume) / wp::index(model.mass, w);
    const auto F = at.framed(at.differences(tape.x, row, model.lattice));
    auto B = S::cofactors(F);
    const wide J = S::dot(F.of[0], B.of[0]);
    const wide mus = S::numbers(wp::index(model.mu, w, first));
    const wide lams = S::numbers(wp::index(model.lam, w, first));
    const wide log_J = S::log_volumes(J), pressure = lams * log_J - mus;
    const auto P = at.framed(at.differences(adjoint.v, w, model.lattice)) * by_difference;
    B = S::columns::each([&](int j, int n) { return B.of[j][n] / J; });
    typename S::columns back;
    wide by_mu, by_lam;
    wp::vec_t<2, real> sums;
    // the elastic law's own transpose, see neo_hookean_adjoint
    const auto elastic = [&](const typename S::columns& P) {
        const wide trace = S::dot(P.of[0], B.of[0]) + S::dot(P.of[1], B.of[1]) + S::dot(P.of[2], B.of[2]);
        #pragma unroll
        for (int k = 0; k < 3; ++k) {
            const wide M0 = S::dot(P.of[0], B.of[k]), M1 = S::dot(P.of[1], B.of[k]);
            const wide M2 = S::dot(P.of[2], B.of[k]);
            #pragma unroll
            for (int n = 0; n < 3; ++n)
                back.of[k][n] = mus * P.of[k][n] + lams * trace * B.of[k][n]
                    - pressure * (B.of[0][n] * M0 + B.of[1][n] * M1 + B.of[2][n] * M2);
        }
        by_mu = S::dot(P.of[0], F.of[0]) + S::dot(P.of[1], F.of[1]) + S::dot(P.of[2], F.of[2]) - trace;
        by_lam = log_J * trace;
    };
    if (share == real(0)) {
        elastic(P);
    } else {
        const auto filtered = at.load(tape.Z, row);
        auto after = at.load(adjoint.Z, w);
        const auto S_now = S::second_piola(B, mus, pressure);
        const auto FZ = S::times(F, filtered);
        const auto PZ = S::times(P, filtered);
        // S = F^-1 P_el: dS = F^-1 (dP_el - dF S); S_bar is (1 - keep) Z_bar
        typename S::symmetric S_bar = after;
        wide* s = &S_bar.xx;
        #pragma unroll
        for (int c = 0; c < 6; ++c) s[c] *= real(1) - keep;
        // off the diagonal each number stands for two
        S_bar.xy *= real(0.5);
        S_bar.xz *= real(0.5);
        S_bar.yz *= real(0.5);
        const auto BS = S::times(B, S_bar);
        elastic(P * (real(1) + share) + BS);
        back = back - (PZ * share + S::times(BS, S_now));
        const wide* now = &S_now.xx;
        const wide* old = &filtered.xx;
        wide* bar = &after.xx;
        // P_el : P_bar from S, P_el = F S
        const auto FS = S::times(F, S_now);
        wide by_share = wide(real(0)), by_keep = wide(real(0));
        #pragma unroll
        for (int j = 0; j < 3; ++j)
            #pragma unroll
            for (int n = 0; n < 3; ++n)
                by_share += P.of[j][n] * (FS.of[j][n] - FZ.of[j][n]);
        #pragma unroll
        for (int c = 0; c < 6; ++c) by_keep -= bar[c] * (now[c] - old[c]);
        // by Z: keep Z_bar - g sym(F^T P_bar)
        typename S::symmetric FP = {
            S::dot(F.of[0], P.of[0]), S::dot(F.of[1], P.of[1]), S::dot(F.of[2], P.of[2]),
            S::dot(F.of[0], P.of[1]) + S::dot(F.of[1], P.of[0]),
            S::dot(F.of[0], P.of[2]) + S::dot(F.of[2], P.of[0]),
            S::dot(F.of[1], P.of[2]) + S::dot(F.of[2], P.of[1])};
        const wide* fp = &FP.xx;
        #pragma unroll
        for (int c = 0; c < 6; ++c) bar[c] = bar[c] * keep - fp[c] * share;
        at.put(after, adjoint.Z, w, fresh);
        for (int l = fresh > first ? fresh - first : 0; l < S::width; ++l) {
            sums[0] += by_share[l];
            sums[1] += by_keep[l];
        }
    }
    const wide none[3] = {wide(real(0)), wide(real(0)), wide(real(0))};
    at.put_unframed(back, none, adjoint.impulses, fresh);
    for (int l = fresh > first ? fresh - first : 0; l < S::width; ++l) {
        wp::index(adjoint.sums, w, 0, first + l) += by_mu[l];
        wp::index(adjoint.sums, w, 1, first + l) += by_lam[l];
    }
    return sums;
}

#endif

// Sum of the impulses on a particle: the transpose, but for its sign, of the differences between
// neighbours.
template <typename real>
CUDA_CALLABLE inline vec3<real> pulled(int p, const wp::array_t<int>& lattice,
                                       const wp::array_t<impulses_of<real>>& impulses, int w) {
    const int* near = &wp::index(lattice, p, 0, 0);
#if defined(__CUDA_ARCH__)
    typedef vec4<real> four;
    four total;
#else
    typedef typename simd<real>::four four;
    four total = real(0);
#endif
    #pragma unroll
    for (int axis = 0; axis < 3; ++axis) {
        const int a = near[2 * axis], b = near[2 * axis + 1];
        const four back = *(const four*)wp::index(impulses, w, a).data[axis];
        const four forth = *(const four*)wp::index(impulses, w, b).data[axis];
        // where the lattice ends a particle stands in for the neighbour that it lacks
        total = total + forth * real(b == p ? -1 : 1) - back * real(a == p ? -1 : 1);
    }
    return vec3<real>(total[0], total[1], total[2]);
}

}  // namespace gendom
