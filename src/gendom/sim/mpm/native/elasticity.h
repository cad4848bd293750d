// Internal forces of particles and their transpose, see gendom.sim.mpm.internal_forces.
//
// Numbers are of type T: on the CPU lanes, those of several neighbouring records side by side, on CUDA
// those of one. A rotation of the rest frame changes nothing for an isotropic body: of the
// frame B = U Q only the triangular U is needed, F = D U, and the pulls on the neighbours are P U^T.
#pragma once

namespace gendom {

// log(J); near 1 by its series 2 (s + s^3/3 + ...), s = (J - 1)/(J + 1), without a call.
template <typename T> CUDA_CALLABLE inline T log_volume(const T& J) {
    typedef typename number_of<T>::type real;
    if constexpr (sizeof(T) > sizeof(real)) {
        T log_J;
        #pragma unroll
        for (unsigned l = 0; l < sizeof(T) / sizeof(real); ++l) log_J[l] = log_volume(real(J[l]));
        return log_J;
    } else {
        if (!(J > real(0.75) && J < real(1.25))) return wp::log(J);
        const real s = (J - real(1)) / (J + real(1)), q = s * s;
        real sum = real(0);
        constexpr int terms = sizeof(real) == 4 ? 5 : 10;
        #pragma unroll
        for (int n = terms; n > 0; --n) sum = sum * q + real(2.0 / (2 * n - 1));
        return sum * s;
    }
}

// By columns.
template <typename T> struct matrix { vec<T> a, b, c; };
template <typename T> GENDOM_INLINE matrix<T> operator+(const matrix<T>& A, const matrix<T>& B) {
    return {A.a + B.a, A.b + B.b, A.c + B.c};
}
template <typename T> GENDOM_INLINE matrix<T> operator-(const matrix<T>& A, const matrix<T>& B) {
    return {A.a - B.a, A.b - B.b, A.c - B.c};
}
template <typename T> GENDOM_INLINE matrix<T> operator*(const T& s, const matrix<T>& A) {
    return {s * A.a, s * A.b, s * A.c};
}
template <typename T> GENDOM_INLINE T dot(const matrix<T>& A, const matrix<T>& B) {
    return dot(A.a, B.a) + dot(A.b, B.b) + dot(A.c, B.c);
}

// By the numbers xx, yy, zz, and xy, xz, yz.
template <typename T> struct symmetric { vec<T> on, off; };
template <typename T> GENDOM_INLINE matrix<T> operator*(const matrix<T>& A, const symmetric<T>& S) {
    return {S.on.x * A.a + S.off.x * A.b + S.off.y * A.c, S.off.x * A.a + S.on.y * A.b + S.off.z * A.c,
            S.off.y * A.a + S.off.z * A.b + S.on.z * A.c};
}

// The triangle U of a rest frame, by columns; zeros are not read.
template <typename T> struct rest_frame {
    matrix<T> U;
    GENDOM_INLINE matrix<T> framed(const matrix<T>& D) const {
        return {U.a.x * D.a, U.b.x * D.a + U.b.y * D.b, U.c.x * D.a + U.c.y * D.b + U.c.z * D.c};
    }
    GENDOM_INLINE matrix<T> unframed(const matrix<T>& P) const {
        return {U.a.x * P.a + U.b.x * P.b + U.c.x * P.c, U.b.y * P.b + U.c.y * P.c, U.c.z * P.c};
    }
};

// The neo-Hookean law P = mu (F - F^-T) + lam log(J) F^-T. Source: Bonet and Wood (2008), "Nonlinear
// Continuum Mechanics", chapter 6.
template <typename T> struct neo_hookean {
    matrix<T> F, C;  // C = J F^-T
    T mu, lam, J, log_J, pressure;

    GENDOM_INLINE neo_hookean(const matrix<T>& F, const T& mu, const T& lam)
        : F(F), C({cross(F.b, F.c), cross(F.c, F.a), cross(F.a, F.b)}), mu(mu), lam(lam),
          J(dot(F.a, C.a)), log_J(log_volume(J)), pressure(lam * log_J - mu) {}

    GENDOM_INLINE matrix<T> stress(const T& times) const {
        return (times * mu) * F + (times * pressure / J) * C;
    }
    // F^-1 P
    GENDOM_INLINE symmetric<T> second_piola() const {
        const T p = pressure / (J * J);
        const vec<T> on = {dot(C.a, C.a), dot(C.b, C.b), dot(C.c, C.c)};
        return {vec<T>{mu, mu, mu} + p * on, p * vec<T>{dot(C.a, C.b), dot(C.a, C.c), dot(C.b, C.c)}};
    }
    GENDOM_INLINE matrix<T> inverse_transposed() const { return (T(1) / J) * C; }

    // Derivatives by F from those by P, and by mu and lam; d(F^-T) = -F^-T dF^T F^-T.
    GENDOM_INLINE matrix<T> adjoint(const matrix<T>& P_bar, T& by_mu, T& by_lam) const {
        const matrix<T> B = inverse_transposed();
        const T trace = dot(P_bar, B);
        const auto column = [&](const vec<T>& of_P, const vec<T>& of_B) {
            const vec<T> M = {dot(P_bar.a, of_B), dot(P_bar.b, of_B), dot(P_bar.c, of_B)};
            return mu * of_P + (lam * trace) * of_B - pressure * (M.x * B.a + M.y * B.b + M.z * B.c);
        };
        by_mu = dot(P_bar, F) - trace;
        by_lam = log_J * trace;
        return {column(P_bar.a, B.a), column(P_bar.b, B.b), column(P_bar.c, B.c)};
    }
};

// Of a rope's stretch a, or of a sheet's patch of sides a and b; `strength` is the drag times -dt.
template <typename T> struct air {
    typedef typename number_of<T>::type real;
    vec<T> v, a, b;
    int sheet;
    T strength;

    GENDOM_INLINE vec<T> impulse() const {
        if (sheet) {
            const vec<T> area = cross(a, b);
            const T flow = dot(v, area);
            return (strength * larger(flow, -flow) * flow / dot(area, area)) * area;
        }
        const T square = dot(a, a);
        const vec<T> across = v - (dot(v, a) / square) * a;
        return (strength * root(square * dot(across, across))) * across;
    }
    // Derivatives by a, b and v from that by the impulse; returns that by the strength.
    GENDOM_INLINE T adjoint(const vec<T>& bar, vec<T>& a_bar, vec<T>& b_bar, vec<T>& v_bar) const {
        if (sheet) {
            const vec<T> area = cross(a, b);
            const T size = root(dot(area, area)), flow = dot(v, area) / size;
            const T fast = larger(flow, -flow), work = dot(area, bar);
            const T by_flow = T(real(2)) * strength * fast * work / size;
            const vec<T> by_area = (strength * fast * flow) * bar + by_flow * (v - (flow / size) * area);
            a_bar = cross(b, by_area), b_bar = cross(by_area, a), v_bar = by_flow * area;
            return fast * flow * work;
        }
        const T per = T(real(1)) / dot(a, a), length = root(dot(a, a)), share = dot(v, a) * per;
        const vec<T> across = v - share * a;
        const T speed = root(dot(across, across)), work = dot(across, bar);
        const T along = work / larger(speed, T(real(1e-30)));
        const vec<T> by_across = (strength * length) * (speed * bar + along * across);
        const T inward = dot(by_across, a) * per;
        v_bar = by_across - inward * a;
        a_bar = inward * (T(real(2)) * share * a - v) - share * by_across +
                (strength * speed * work * length * per) * a;
        return length * speed * work;
    }
};

// ---- records: component by component, in an order of their own -----------------------------------

enum { RECORD_V = 3, RECORD_IMPULSES = 15, RECORD_LOW = 24, RECORD_Z = 27, TAPED_Z = 18 };
enum { BY_MU = 0, BY_LAM = 1, BY_DRAG = 3 };

// Numbers of type T, lane by lane.
template <typename T, typename Job> GENDOM_INLINE T by_lane(Job number) {
    typedef typename number_of<T>::type real;
    T made;
    #pragma unroll
    for (unsigned l = 0; l < sizeof(T) / sizeof(real); ++l) ((real*)&made)[l] = number(l);
    return made;
}

// Components of a row of an array, or of shared memory.
template <bool in_shared, typename real>
GENDOM_INLINE rows_of<real> records_of(const wp::array_t<real>& of, int row) {
    return {&component<in_shared>(of, row, 0, 0), int(of.shape[2])};
}
template <typename T, typename real>
GENDOM_INLINE symmetric<T> get_symmetric(const rows_of<real>& of, int c, int i) {
    return {of.template get3<T>(c, i), of.template get3<T>(c + 3, i)};
}
template <typename T, typename real>
GENDOM_INLINE void put_symmetric(const rows_of<real>& of, int c, int i, const symmetric<T>& S) {
    of.put3(c, i, S.on), of.put3(c + 3, i, S.off);
}
template <typename T, typename real>
GENDOM_INLINE void put_columns(const rows_of<real>& of, int c, int i, const matrix<T>& A) {
    of.put3(c, i, A.a), of.put3(c + 3, i, A.b), of.put3(c + 6, i, A.c);
}

// The records of a world from the i-th on as they move, or their derivatives while a tape is reversed;
// `sorted`: in another order than particles.
template <bool in_shared, bool sorted, bool reversed, typename T, typename real, typename Model, typename Records>
struct record {
    const Model& model;
    const Records& stored;
    const int w, i;
    const rows_of<real> own, state;

    GENDOM_INLINE record(const Model& model, const Records& stored, int w, int i,
                         const wp::array_t<real>& states, int row)
        : model(model), stored(stored), w(w), i(i), own(records_of<in_shared>(stored.of, w)),
          state(records_of<in_shared && !reversed>(states, row)) {}
    // Of the model, whose numbers are in the order of particles.
    GENDOM_INLINE T of_particles(const wp::array_t<real>& numbers, int row) const {
        if constexpr (!sorted) {
            T found;
            __builtin_memcpy(&found, &wp::index(numbers, row, i), sizeof(T));
            return found;
        }
        return by_lane<T>([&](int l) { return wp::index(numbers, row, wp::index(stored.order, w, i + l)); });
    }
    GENDOM_INLINE rest_frame<T> frame() const {
        const auto u = [&](int c) { return of_particles(model.frame, c); };
        const T zero = T(real(0));
        return {{{u(0), zero, zero}, {u(1), u(3), zero}, {u(2), u(4), u(5)}}};
    }
    GENDOM_INLINE T per_span(int axis) const {
        return by_lane<T>([&](int l) {
            const int a = before(stored.near, w, axis, i + l), b = behind(stored.near, w, axis, i + l);
            return a == i + l || b == i + l ? real(1) : real(0.5);
        });
    }
    GENDOM_INLINE T modulus(const wp::array_t<real>& of, int c) const {
        if constexpr (reversed) return of_particles(of, w);
        else return records_of<false>(stored.moduli, w).template get<T>(c, i);
    }
    // Of neighbours along the lattice's axes, of the components from c on.
    GENDOM_INLINE matrix<T> differences(const rows_of<real>& of, int c) const {
        return {along(of, c, 0), along(of, c, 1), along(of, c, 2)};
    }
    GENDOM_INLINE vec<T> along(const rows_of<real>& of, int c, int axis) const {
        vec<T> d;
        #pragma unroll
        for (unsigned l = 0; l < sizeof(T) / sizeof(real); ++l) {
            const int a = before(stored.near, w, axis, i + l), b = behind(stored.near, w, axis, i + l);
            ((real*)&d.x)[l] = of.at(c, b) - of.at(c, a);
            ((real*)&d.y)[l] = of.at(c + 1, b) - of.at(c + 1, a);
            ((real*)&d.z)[l] = of.at(c + 2, b) - of.at(c + 2, a);
        }
        return d;
    }
    GENDOM_INLINE symmetric<T> filtered() const {
        return get_symmetric<T>(state, reversed ? TAPED_Z : RECORD_Z, i);
    }

    // Sets what particles pull their neighbours by, what the air does to them, and Z after a substep of
    // dt, of whose damping keep and g are left; returns one whose J <= 0, or -1.
    GENDOM_INLINE int forces(real dt, real keep, real g) const {
        const rest_frame<T> U = frame();
        const matrix<T> D = differences(state, 0);
        const neo_hookean<T> law(U.framed(D), modulus(model.mu, 0), modulus(model.lam, 1));
        const real impulse = dt * model.volume, strength = -dt * wp::index(model.drag, w);
        if (strength != real(0)) {
            const vec<T> v = state.template get3<T>(RECORD_V, i);
            const air<T> around = {v, per_span(0) * D.a, per_span(1) * D.b, model.sheet, T(strength)};
            own.put3(RECORD_V, i, v + T(real(1) / wp::index(model.mass, w)) * around.impulse());
        }
        matrix<T> P = law.stress(T(impulse * (real(1) + g)));
        if (g != real(0)) {
            const symmetric<T> Z = filtered(), S = law.second_piola();
            P = P - T(impulse * g) * (law.F * Z);
            const T moves = T(real(1) - keep);
            const symmetric<T> later = {Z.on + moves * (S.on - Z.on), Z.off + moves * (S.off - Z.off)};
            put_symmetric(own, RECORD_Z, i, later);
        }
        put_columns(own, RECORD_IMPULSES, i, U.unframed(P));
        int inverted = -1;
        for (unsigned l = 0; l < sizeof(T) / sizeof(real); ++l)
            if (!(((const real*)&law.J)[l] > real(0))) inverted = wp::index(stored.order, w, i + l);
        return inverted;
    }

    // Transpose; derivatives by impulses are found in those by v. Adds to the derivatives by g and keep.
    GENDOM_INLINE void forces_adjoint(real dt, real keep, real g, wp::vec2d& by_damped) const {
        const real per_mass = real(1) / wp::index(model.mass, w), strength = -dt * wp::index(model.drag, w);
        const rest_frame<T> U = frame();
        const matrix<T> D = differences(state, 0);
        const neo_hookean<T> law(U.framed(D), modulus(model.mu, 0), modulus(model.lam, 1));
        const matrix<T> P_bar = T(-dt * model.volume * per_mass) * U.framed(differences(own, RECORD_V));
        const T zero = T(real(0));
        T by_mu, by_lam, by_drag = zero;
        matrix<T> F_bar;
        if (g == real(0)) {
            F_bar = law.adjoint(P_bar, by_mu, by_lam);
        } else {
            const T moves = T(real(1) - keep);
            const symmetric<T> Z = filtered(), Z_bar = get_symmetric<T>(own, RECORD_Z, i);
            const symmetric<T> S = law.second_piola(), late = {S.on - Z.on, S.off - Z.off};
            // S = F^-1 P: dS = F^-1 (dP - dF S); off the diagonal a number stands for two
            const symmetric<T> S_bar = {moves * Z_bar.on, T(real(0.5)) * moves * Z_bar.off};
            const matrix<T> through = law.inverse_transposed() * S_bar;
            F_bar = law.adjoint(T(real(1) + g) * P_bar + through, by_mu, by_lam) - T(g) * (P_bar * Z) -
                    through * S;
            by_damped[0] += sum_of(dot(P_bar, law.F * late));
            by_damped[1] -= sum_of(dot(Z_bar.on, late.on) + dot(Z_bar.off, late.off));
            const matrix<T>&F = law.F, &P = P_bar;
            const vec<T> on = {dot(F.a, P.a), dot(F.b, P.b), dot(F.c, P.c)};
            const vec<T> off = {dot(F.a, P.b) + dot(F.b, P.a), dot(F.a, P.c) + dot(F.c, P.a),
                                dot(F.b, P.c) + dot(F.c, P.b)};
            const symmetric<T> before = {T(keep) * Z_bar.on - T(g) * on, T(keep) * Z_bar.off - T(g) * off};
            put_symmetric(own, RECORD_Z, i, before);
        }
        matrix<T> D_bar = U.unframed(F_bar);
        vec<T> v_bar = {zero, zero, zero};
        if (strength != real(0)) {
            vec<T> a_bar, b_bar = {zero, zero, zero};
            const T s0 = per_span(0), s1 = per_span(1);
            const vec<T> v = state.template get3<T>(RECORD_V, i), u_bar = own.template get3<T>(RECORD_V, i);
            const air<T> around = {v, s0 * D.a, s1 * D.b, model.sheet, T(strength)};
            by_drag = T(-dt) * around.adjoint(T(per_mass) * u_bar, a_bar, b_bar, v_bar);
            D_bar.a = D_bar.a + s0 * a_bar, D_bar.b = D_bar.b + s1 * b_bar;
        }
        put_columns(own, RECORD_IMPULSES, i, D_bar);
        own.put3(RECORD_LOW, i, v_bar);
        const rows_of<real> sums = records_of<false>(stored.sums, w);
        sums.add(BY_MU, i, by_mu);
        sums.add(BY_LAM, i, by_lam);
        sums.add(BY_DRAG, i, by_drag);
    }
};

// Calls `job` with the records from each on that a thread has to do: a lane each, the last ones alone.
template <typename real, typename Job>
GENDOM_INLINE void over_records(int thread, int threads, int N, Job job) {
    typedef typename several<real>::lanes T;
    constexpr int width = sizeof(T) / sizeof(real);
    int i = thread;
    for (; i + width <= N; i += width * threads) job(T(), i);
    if constexpr (width > 1)
        for (; i < N; ++i) job(real(), i);
}
template <bool in_shared, bool sorted, typename real, typename Model, typename Records>
GENDOM_INLINE int forces_of_records(int w, int thread, int threads, real dt, real keep, real share,
                                    const Model& model, const Records& records) {
    int failed = -1;
    over_records<real>(thread, threads, records.of.shape[2], [&](auto lanes, int i) {
        typedef record<in_shared, sorted, false, decltype(lanes), real, Model, Records> one;
        const one at(model, records, w, i, records.of, w);
        failed = wp::max(failed, at.forces(dt, keep, share));
    });
    return failed;
}
template <bool in_shared, bool sorted, typename real, typename Model, typename Records>
GENDOM_INLINE wp::vec2d adjoint_of_records(int w, int thread, int threads, int row, real dt, real keep,
                                           real share, const Model& model, const Records& tape,
                                           const Records& adjoint) {
    wp::vec2d by_damped;
    over_records<real>(thread, threads, adjoint.of.shape[2], [&](auto lanes, int i) {
        typedef record<in_shared, sorted, true, decltype(lanes), real, Model, Records> one;
        const one at(model, adjoint, w, i, tape.of, row);
        at.forces_adjoint(dt, keep, share, by_damped);
    });
    return by_damped;
}

// Sum of the pulls on a particle: the transpose, but for its sign, of the differences between
// neighbours. Where the lattice ends a particle stands in for the neighbour that it lacks.
template <bool in_shared, typename real>
GENDOM_INLINE vec3<real> pulled_record(int w, int i, const wp::array_t<real>& of,
                                       const wp::array_t<int>& near) {
    const rows_of<real> own = records_of<in_shared>(of, w);
    vec<real> total = {real(0), real(0), real(0)};
    #pragma unroll
    for (int axis = 0; axis < 3; ++axis) {
        const int a = before(near, w, axis, i), b = behind(near, w, axis, i);
        total = total + real(b == i ? -1 : 1) * own.template get3<real>(RECORD_IMPULSES + 3 * axis, b) -
                real(a == i ? -1 : 1) * own.template get3<real>(RECORD_IMPULSES + 3 * axis, a);
    }
    return vec3<real>(total.x, total.y, total.z);
}

}  // namespace gendom
