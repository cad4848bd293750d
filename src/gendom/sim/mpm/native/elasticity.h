// Internal forces of particles and their transpose, see gendom.sim.mpm.internal_forces.
//
// Numbers are of type T: of rows (CPU) lanes, several neighbouring particles side by side, of records
// those of one particle. A rotation of the rest frame changes nothing for an isotropic body: of the
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

// What a substep's damping leaves of the filtered stress Z, and g; both 0 without.
template <typename real> struct maxwell { real keep, share; };

// Sets what particles pull their neighbours by, what the air does to them, and Z after a substep of
// dt; returns one whose J <= 0, or -1.
template <typename At, typename Model, typename real>
GENDOM_INLINE int internal_forces(const At& at, const Model& model, int w, real dt, maxwell<real> damped) {
    typedef typename At::T T;
    const rest_frame<T> U = at.frame();
    const matrix<T> D = at.differences();
    const neo_hookean<T> law(U.framed(D), at.mu(), at.lam());
    const real impulse = dt * model.volume, strength = -dt * wp::index(model.drag, w);
    vec<T> wind = {T(real(0)), T(real(0)), T(real(0))};
    if (strength != real(0)) {
        const vec<T> a = at.per_span(0) * D.a, b = at.per_span(1) * D.b;
        wind = air<T>{at.velocity(), a, b, model.sheet, T(strength)}.impulse();
    }
    matrix<T> P = law.stress(T(impulse * (real(1) + damped.share)));
    if (damped.share != real(0)) {
        const symmetric<T> Z = at.filtered(), S = law.second_piola();
        P = P - T(impulse * damped.share) * (law.F * Z);
        const T moves = T(real(1) - damped.keep);
        at.put_filtered({Z.on + moves * (S.on - Z.on), Z.off + moves * (S.off - Z.off)});
    }
    at.put(U.unframed(P), wind);
    return at.inverted(law.J);
}

// Transpose; derivatives by impulses are found in those by v. Adds to the derivatives by the share g
// and by `keep`.
template <typename At, typename Model, typename real>
GENDOM_INLINE void internal_forces_adjoint(const At& at, const Model& model, int w, real dt,
                                           maxwell<real> damped, wp::vec2d& by_damped) {
    typedef typename At::T T;
    const real per_mass = real(1) / wp::index(model.mass, w), strength = -dt * wp::index(model.drag, w);
    const rest_frame<T> U = at.frame();
    const matrix<T> D = at.differences();
    const neo_hookean<T> law(U.framed(D), at.mu(), at.lam());
    const matrix<T> P_bar = T(-dt * model.volume * per_mass) * U.framed(at.differences_bar());
    const T zero = T(real(0));
    T by_mu, by_lam, by_drag = zero;
    matrix<T> F_bar;
    if (damped.share == real(0)) {
        F_bar = law.adjoint(P_bar, by_mu, by_lam);
    } else {
        const T g = T(damped.share), keep = T(damped.keep), moves = T(real(1) - damped.keep);
        const symmetric<T> Z = at.filtered(), Z_bar = at.filtered_bar(), S = law.second_piola();
        const symmetric<T> late = {S.on - Z.on, S.off - Z.off};
        // S = F^-1 P: dS = F^-1 (dP - dF S); off the diagonal a number stands for two
        const symmetric<T> S_bar = {moves * Z_bar.on, T(real(0.5)) * moves * Z_bar.off};
        const matrix<T> through = law.inverse_transposed() * S_bar;
        F_bar = law.adjoint(T(real(1) + damped.share) * P_bar + through, by_mu, by_lam) -
                g * (P_bar * Z) - through * S;
        at.add_up(dot(P_bar, law.F * late), by_damped[0]);
        at.add_up(-dot(Z_bar.on, late.on) - dot(Z_bar.off, late.off), by_damped[1]);
        const matrix<T>&F = law.F, &P = P_bar;
        const vec<T> on = {dot(F.a, P.a), dot(F.b, P.b), dot(F.c, P.c)};
        const vec<T> off = {dot(F.a, P.b) + dot(F.b, P.a), dot(F.a, P.c) + dot(F.c, P.a),
                            dot(F.b, P.c) + dot(F.c, P.b)};
        at.put_filtered({keep * Z_bar.on - g * on, keep * Z_bar.off - g * off});
    }
    matrix<T> D_bar = U.unframed(F_bar);
    vec<T> v_bar = {zero, zero, zero};
    if (strength != real(0)) {
        vec<T> a_bar, b_bar = {zero, zero, zero};
        const T s0 = at.per_span(0), s1 = at.per_span(1);
        const air<T> around = {at.velocity(), s0 * D.a, s1 * D.b, model.sheet, T(strength)};
        by_drag = T(-dt) * around.adjoint(T(per_mass) * at.velocity_bar(), a_bar, b_bar, v_bar);
        D_bar.a = D_bar.a + s0 * a_bar, D_bar.b = D_bar.b + s1 * b_bar;
    }
    at.put_bars(D_bar, v_bar, by_mu, by_lam, by_drag);
}

// ---- records: component by component, in an order of their own -----------------------------------

enum { RECORD_V = 3, RECORD_IMPULSES = 15, RECORD_LOW = 24, RECORD_Z = 27, TAPED_Z = 18 };
enum { BY_MU = 0, BY_LAM = 1, BY_DRAG = 3 };

// Where particle i's neighbours are, before and behind along an axis; two indices in a number.
struct neighbours {
    int of[3];
    GENDOM_INLINE neighbours(const wp::array_t<int>& near, int w, int i)
        : of{wp::index(near, w, 0, i), wp::index(near, w, 1, i), wp::index(near, w, 2, i)} {}
    GENDOM_INLINE int before(int axis) const { return of[axis] & 0xffff; }
    GENDOM_INLINE int behind(int axis) const { return of[axis] >> 16; }
};

// Components of a row of an array, or of shared memory.
template <typename real, bool in_shared> struct components {
    const wp::array_t<real>& of;
    const int row;

    GENDOM_INLINE real& at(int c, int i) const { return component<in_shared>(of, row, c, i); }
    GENDOM_INLINE vec<real> get3(int c, int i) const { return {at(c, i), at(c + 1, i), at(c + 2, i)}; }
    GENDOM_INLINE void put3(int c, int i, const vec<real>& a) const {
        at(c, i) = a.x, at(c + 1, i) = a.y, at(c + 2, i) = a.z;
    }
    GENDOM_INLINE symmetric<real> get_symmetric(int c, int i) const { return {get3(c, i), get3(c + 3, i)}; }
    GENDOM_INLINE void put_symmetric(int c, int i, const symmetric<real>& S) const {
        put3(c, i, S.on), put3(c + 3, i, S.off);
    }
    GENDOM_INLINE matrix<real> differences(int c, const neighbours& near) const {
        return {get3(c, near.behind(0)) - get3(c, near.before(0)),
                get3(c, near.behind(1)) - get3(c, near.before(1)),
                get3(c, near.behind(2)) - get3(c, near.before(2))};
    }
};

// The i-th record of a world as it moves, or its derivatives while a tape is reversed.
template <bool in_shared, bool reversed, typename real, typename Model, typename Records> struct record {
    typedef real T;
    const Model& model;
    const Records& stored;
    const int w, i, p;
    const neighbours near;
    const components<real, in_shared> own;
    const components<real, in_shared && !reversed> state;

    GENDOM_INLINE record(const Model& model, const Records& stored, int w, int i,
                         const wp::array_t<real>& states, int row)
        : model(model), stored(stored), w(w), i(i), p(wp::index(stored.order, w, i)),
          near(stored.near, w, i), own{stored.of, w}, state{states, row} {}
    GENDOM_INLINE rest_frame<real> frame() const {
        const auto u = [&](int c) { return wp::index(model.frame, c, p); };
        const real zero = real(0);
        return {{{u(0), zero, zero}, {u(1), u(3), zero}, {u(2), u(4), u(5)}}};
    }
    GENDOM_INLINE real per_span(int axis) const {
        return near.before(axis) == i || near.behind(axis) == i ? real(1) : real(0.5);
    }
    GENDOM_INLINE real mu() const {
        return reversed ? wp::index(model.mu, w, p) : wp::index(stored.moduli, w, 0, i);
    }
    GENDOM_INLINE real lam() const {
        return reversed ? wp::index(model.lam, w, p) : wp::index(stored.moduli, w, 1, i);
    }
    GENDOM_INLINE matrix<real> differences() const { return state.differences(0, near); }
    GENDOM_INLINE matrix<real> differences_bar() const { return own.differences(RECORD_V, near); }
    GENDOM_INLINE vec<real> velocity() const { return state.get3(RECORD_V, i); }
    GENDOM_INLINE vec<real> velocity_bar() const { return own.get3(RECORD_V, i); }
    GENDOM_INLINE symmetric<real> filtered() const {
        return state.get_symmetric(reversed ? TAPED_Z : RECORD_Z, i);
    }
    GENDOM_INLINE symmetric<real> filtered_bar() const { return own.get_symmetric(RECORD_Z, i); }
    GENDOM_INLINE void put_filtered(const symmetric<real>& Z) const { own.put_symmetric(RECORD_Z, i, Z); }
    GENDOM_INLINE void put_pulls(const matrix<real>& P) const {
        own.put3(RECORD_IMPULSES, i, P.a), own.put3(RECORD_IMPULSES + 3, i, P.b);
        own.put3(RECORD_IMPULSES + 6, i, P.c);
    }
    GENDOM_INLINE void put(const matrix<real>& P, const vec<real>& wind) const {
        put_pulls(P);
        if (wp::index(model.drag, w) > real(0))
            own.put3(RECORD_V, i, velocity() + real(1) / wp::index(model.mass, w) * wind);
    }
    GENDOM_INLINE void put_bars(const matrix<real>& D_bar, const vec<real>& v_bar, real by_mu,
                                real by_lam, real by_drag) const {
        put_pulls(D_bar);
        own.put3(RECORD_LOW, i, v_bar);
        wp::index(stored.sums, w, BY_MU, i) += by_mu;
        wp::index(stored.sums, w, BY_LAM, i) += by_lam;
        wp::index(stored.sums, w, BY_DRAG, i) += by_drag;
    }
    GENDOM_INLINE int inverted(real J) const { return J > real(0) ? -1 : p; }
    GENDOM_INLINE void add_up(real value, double& sum) const { sum += value; }
};

// By the threads of a block.
template <bool in_shared, typename real, typename Model, typename Records>
GENDOM_INLINE int forces_of_records(int w, int thread, int threads, real dt, real keep, real share,
                                    const Model& model, const Records& records) {
    int failed = -1;
    for (int i = thread; i < records.of.shape[2]; i += threads) {
        const record<in_shared, false, real, Model, Records> at(model, records, w, i, records.of, w);
        failed = wp::max(failed, internal_forces(at, model, w, dt, maxwell<real>{keep, share}));
    }
    return failed;
}
template <bool in_shared, typename real, typename Model, typename Records>
GENDOM_INLINE wp::vec2d adjoint_of_records(int w, int thread, int threads, int row, real dt, real keep,
                                           real share, const Model& model, const Records& tape,
                                           const Records& adjoint) {
    wp::vec2d by_damped;
    for (int i = thread; i < adjoint.of.shape[2]; i += threads) {
        const record<in_shared, true, real, Model, Records> at(model, adjoint, w, i, tape.of, row);
        internal_forces_adjoint(at, model, w, dt, maxwell<real>{keep, share}, by_damped);
    }
    return by_damped;
}

// Sum of the pulls on a particle: the transpose, but for its sign, of the differences between
// neighbours. Where the lattice ends a particle stands in for the neighbour that it lacks.
template <bool in_shared, typename real>
GENDOM_INLINE vec3<real> pulled_record(int w, int i, const wp::array_t<real>& of,
                                       const wp::array_t<int>& near_of) {
    const components<real, in_shared> own = {of, w};
    const neighbours near(near_of, w, i);
    vec<real> total = {real(0), real(0), real(0)};
    #pragma unroll
    for (int axis = 0; axis < 3; ++axis) {
        const int a = near.before(axis), b = near.behind(axis);
        total = total + real(b == i ? -1 : 1) * own.get3(RECORD_IMPULSES + 3 * axis, b) -
                real(a == i ? -1 : 1) * own.get3(RECORD_IMPULSES + 3 * axis, a);
    }
    return vec3<real>(total.x, total.y, total.z);
}

// ---- rows: several neighbouring particles side by side -------------------------------------------

#if !defined(__CUDA_ARCH__)

template <typename real> using impulses_of = wp::mat_t<3, 4, real>;  // a row for each axis, padded

// Particles of a row of states, as they move, or their derivatives while a tape is reversed.
template <typename real, typename Model, typename State> struct side_by_side {
    typedef typename several<real>::lanes T;
    static constexpr int width = sizeof(T) / sizeof(real);
    const Model& model;
    const State &state, &own;
    const int row, w, first, fresh;  // particles before `fresh` have been done

    static T numbers(const real& a) {
        T found;
        __builtin_memcpy(&found, &a, sizeof(T));
        return found;
    }
    static vec<T> lanes_of(const wp::array_t<vec3<real>>& of, int row, int first) {
        vec<T> found;
        #pragma unroll
        for (int l = 0; l < width; ++l) {
            const auto& a = wp::index(of, row, first + l);
            found.x[l] = a[0], found.y[l] = a[1], found.z[l] = a[2];
        }
        return found;
    }
    vec<T> along(const wp::array_t<vec3<real>>& of, int row, int axis) const {
        typedef typename simd<real>::four four;
        const auto load = [](const vec3<real>& a) { return four{a[0], a[1], a[2], real(0)}; };
        vec<T> d;
        #pragma unroll
        for (int l = 0; l < width; ++l) {
            const int* near = &wp::index(model.lattice, first + l, axis, 0);
            const four one = load(wp::index(of, row, near[1])) - load(wp::index(of, row, near[0]));
            d.x[l] = one.x, d.y[l] = one.y, d.z[l] = one.z;
        }
        return d;
    }
    matrix<T> differences_of(const wp::array_t<vec3<real>>& of, int row) const {
        return {along(of, row, 0), along(of, row, 1), along(of, row, 2)};
    }
    rest_frame<T> frame() const {
        const auto u = [&](int c) { return numbers(wp::index(model.frame, c, first)); };
        const T zero = T(real(0));
        return {{{u(0), zero, zero}, {u(1), u(3), zero}, {u(2), u(4), u(5)}}};
    }
    T per_span(int axis) const { return numbers(wp::index(model.per_span, axis, first)); }
    T mu() const { return numbers(wp::index(model.mu, w, first)); }
    T lam() const { return numbers(wp::index(model.lam, w, first)); }
    matrix<T> differences() const { return differences_of(state.x, row); }
    matrix<T> differences_bar() const { return differences_of(own.v, w); }
    vec<T> velocity() const { return lanes_of(state.v, row, first); }
    vec<T> velocity_bar() const { return lanes_of(own.v, w, first); }
    symmetric<T> filtered() const { return symmetric_of(state.Z, row); }
    symmetric<T> filtered_bar() const { return symmetric_of(own.Z, w); }
    void put(const matrix<T>& P, const vec<T>& wind) const {
        put_padded(P, wind);
        if (wp::index(model.drag, w) == real(0)) return;
        const real per_mass = real(1) / wp::index(model.mass, w);
        for (int l = begin(); l < width; ++l)
            wp::index(own.v, w, first + l) += per_mass * vec3<real>(wind.x[l], wind.y[l], wind.z[l]);
    }
    int inverted(const T& J) const {
        int found = -1;
        for (int l = 0; l < width; ++l)
            if (!(J[l] > real(0))) found = first + l;
        return found;
    }

    int begin() const { return fresh > first ? fresh - first : 0; }
    symmetric<T> symmetric_of(const wp::array_t<real>& of, int row) const {
        const auto at = [&](int c) { return numbers(wp::index(of, row, c, first)); };
        return {{at(0), at(1), at(2)}, {at(3), at(4), at(5)}};
    }
    void put_filtered(const symmetric<T>& Z) const {
        const T* parts = &Z.on.x;
        #pragma unroll
        for (int c = 0; c < 6; ++c) {
            real* at = &wp::index(own.Z, w, c, first);
            if (fresh <= first) __builtin_memcpy(at, parts + c, sizeof(T));
            else
                for (int l = begin(); l < width; ++l) at[l] = parts[c][l];
        }
    }
    void put_padded(const matrix<T>& P, const vec<T>& padding) const {
        typedef typename simd<real>::four four;
        const auto put = [&](int axis, const vec<T>& h, const T& pad) {
            for (int l = begin(); l < width; ++l)
                *(four*)wp::index(own.impulses, w, first + l).data[axis] = four{h.x[l], h.y[l], h.z[l], pad[l]};
        };
        put(0, P.a, padding.x), put(1, P.b, padding.y), put(2, P.c, padding.z);
    }
    void add_up(const T& value, double& sum) const {
        for (int l = begin(); l < width; ++l) sum += value[l];
    }
    void put_bars(const matrix<T>& D_bar, const vec<T>& v_bar, const T& by_mu, const T& by_lam,
                  const T& by_drag) const {
        put_padded(D_bar, v_bar);
        for (int l = begin(); l < width; ++l) {
            const auto by = [&](int c) -> real& { return wp::index(own.sums, w, c, first + l); };
            by(BY_MU) += by_mu[l], by(BY_LAM) += by_lam[l], by(BY_DRAG) += by_drag[l];
        }
    }
};

// Calls `one` for all particles, several at a time; the last ones overlap with those done before.
template <typename real, typename Model, typename State, typename Job>
inline void over_rows(const Model& model, const State& state, const State& own, int row, int w, Job one) {
    typedef side_by_side<real, Model, State> some;
    const int N = model.lattice.shape[0];
    for (int p = 0; p < N; p += some::width)
        one(some{model, state, own, row, w, p < N - some::width ? p : N - some::width, p});
}
template <typename real, typename Model, typename State>
inline int forces_of_rows(int w, real dt, real keep, real share, const Model& model, const State& state) {
    int failed = -1;
    over_rows<real>(model, state, state, w, w, [&](const auto& at) {
        failed = wp::max(failed, internal_forces(at, model, w, dt, maxwell<real>{keep, share}));
    });
    return failed;
}
template <typename real, typename Model, typename State>
inline wp::vec2d adjoint_of_rows(int w, int row, real dt, real keep, real share, const Model& model,
                                 const State& tape, const State& adjoint) {
    wp::vec2d by_damped;
    over_rows<real>(model, tape, adjoint, row, w, [&](const auto& at) {
        internal_forces_adjoint(at, model, w, dt, maxwell<real>{keep, share}, by_damped);
    });
    return by_damped;
}

// As `pulled_record`.
template <typename real>
inline vec3<real> pulled_row(int w, int p, const wp::array_t<int>& lattice,
                             const wp::array_t<impulses_of<real>>& impulses) {
    typedef typename simd<real>::four four;
    const int* near = &wp::index(lattice, p, 0, 0);
    four total = real(0);
    #pragma unroll
    for (int axis = 0; axis < 3; ++axis) {
        const int a = near[2 * axis], b = near[2 * axis + 1];
        const four back = *(const four*)wp::index(impulses, w, a).data[axis];
        const four forth = *(const four*)wp::index(impulses, w, b).data[axis];
        total = total + forth * real(b == p ? -1 : 1) - back * real(a == p ? -1 : 1);
    }
    return vec3<real>(total[0], total[1], total[2]);
}

#endif

}  // namespace gendom
