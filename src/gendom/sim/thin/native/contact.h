// A thin body's contact with itself, at its true thickness, with Coulomb friction.
//
// What is nearer than the thickness after a step is pushed apart by impulses at the two nearest places
// (`contact_lists.h`): they take away the speed of approach; what is still too near is moved apart without
// speed. Friction takes what slides, at most by its coefficient times what was pushed. The contacts of a turn are
// taken at once (Jacobi): each has its part of a point's mass, and the point takes the mean of what its parts do,
// so that impulses stay equal and opposite (Tonge et al. (2012), "Mass splitting for jitter-free parallel rigid
// body simulation"). One after the other (Gauss and Seidel) they throw points out of places that are too narrow
// for them.
#pragma once

namespace gendom {

// Friction needs so many turns over the contacts of a step; then they go on while one finds something nearer than
// what is enough, in thicknesses.
constexpr int needed_turns = 4;
constexpr double enough_distance = 0.9;

template <typename real> CUDA_CALLABLE inline void add_to(const rows_of<real>& rows, int c, int i, real a) {
#if defined(__CUDA_ARCH__)
    atomicAdd(rows.first + c * rows.pitch + i, a);
#else
    rows.first[c * rows.pitch + i] += a;
#endif
}
template <typename real>
CUDA_CALLABLE inline void add_to(const rows_of<real>& rows, int c, int i, const vec<real>& a) {
    add_to(rows, c, i, a.x), add_to(rows, c + 1, i, a.y), add_to(rows, c + 2, i, a.z);
}

// Two places that are too near, and what pushes them apart.
template <typename real> struct contact {
    meeting<real> places;
    vec<real> n, v, vt;  // n of the first from the second; its velocity against that, and across n
    real depth, needed;  // and the speed that undoes it in a step
    real vn, speed;      // of approach, and what is taken away of it
    real sliding, held_back, per_mass, share;
    real over;  // how far they are moved apart over the depth

    CUDA_CALLABLE inline vec<real> impulse() const { return share * (speed * n - held_back * vt); }
    CUDA_CALLABLE inline vec<real> shift(real dt) const {
        return dt * impulse() + (share * (over * depth - speed * dt)) * n;
    }
};

// The close pairs of a world in one state.
template <typename Model, typename real> struct contacts {
    const Model& model;
    const int w;
    const pairs_of close;
    const rows_of<real> s, push, loose;
    const real dt, per_dt, mu;
    // Points that take the mean of many pushes go less far than each asks for. Where the first turns do not suffice,
    // over-relaxation takes fewer further ones. From 2 on it may diverge.
    const real over;

    CUDA_CALLABLE inline contacts(const Model& model, int w, const wp::array_t<real>& state, int row,
                                  real dt, int turn)
        : model(model), w(w), close(close_pairs(model, w)), s(state, row), push(model.push, w),
          loose(model.loose, w), dt(dt), per_dt(real(1) / dt), mu(wp::index(model.self_friction, w)),
          over(turn < needed_turns ? real(1) : real(1.8)) {}

    CUDA_CALLABLE inline meeting<real> pair(int k) const {
        int one, other;
        close.read(k, one, other);
        return pair_meets(s, one, other, model.pitch);
    }
    CUDA_CALLABLE inline bool has_point(int k) const {
        int one, other;
        close.read(k, one, other);
        return one % 4 == 3;
    }
    // The pairs that `count_contacts` found to touch.
    CUDA_CALLABLE inline int number() const { return wp::index(model.touching_count, w); }
    CUDA_CALLABLE inline int at(int j) const { return wp::index(model.touching, w, j); }
    // The number of contacts among which the mass of point p is divided.
    CUDA_CALLABLE inline real split(int p) const {
        return push.template get<real>(6, p);
    }
    // Whether pair k is pushed apart, and how.
    CUDA_CALLABLE inline bool find(int k, contact<real>& c) const {
        c.places = pair(k);
        const meeting<real>& m = c.places;
        c.depth = model.contact_distance - m.distance;
        if (c.depth <= real(0) || m.distance < real(1e-12)) return false;
        c.n = (real(1) / m.distance) * m.away;
        c.v = {real(0), real(0), real(0)};
        c.per_mass = real(0);
        for (int i = 0; i < 4; ++i) {
            c.v = c.v + m.share[i] * s.template get3<real>(3, m.point[i]);
            const real of_share = split(m.point[i]) * loose.template get<real>(0, m.point[i]);
            c.per_mass += m.share[i] * m.share[i] * of_share;
        }
        if (c.per_mass <= real(0)) return false;
        c.vn = dot(c.v, c.n), c.needed = c.depth * per_dt, c.over = over;
        c.speed = wp::min(larger(-c.vn, real(0)), c.needed);
        c.vt = c.v - c.vn * c.n;
        c.sliding = larger(wp::sqrt(dot(c.vt, c.vt)), real(1e-12));
        c.held_back = wp::min(mu * c.needed / c.sliding, real(1));
        c.share = real(1) / c.per_mass;
        return true;
    }
};

// Finds the pairs that touch, and counts those of every point that share in it.
template <typename Model, typename real>
CUDA_CALLABLE inline void count_contacts(const Model& model, int w, const wp::array_t<real>& state, int row) {
    const contacts<Model, real> all(model, w, state, row, real(1), 0);
    for (EACH_ONE_IN(k, 0, all.close.number())) {
        const meeting<real> m = all.pair(k);
        if (m.distance >= model.contact_distance) continue;
        wp::index(model.touching, w, count_on(wp::index(model.touching_count, w))) = k;
        for (int i = 0; i < 4; ++i)
            if (m.share[i] != real(0)) add_to(all.push, 6, m.point[i], real(1));
    }
}

// One turn over the contacts of a step; tells whether one of this thread's was nearer than the distance
// that asks for another turn.
template <typename Model, typename real>
CUDA_CALLABLE inline int contact_impulses(const Model& model, int w, const wp::array_t<real>& state, int row,
                                    real dt, int turn) {
    const contacts<Model, real> all(model, w, state, row, dt, turn);
    const real enough = (turn + 1 < needed_turns ? real(1) : real(enough_distance)) * model.contact_distance;
    contact<real> c;
    int again = 0;
    for (EACH_ONE_IN(j, 0, all.number())) {
        if (!all.find(all.at(j), c)) continue;
        if (c.places.distance < enough) again = 1;
        const vec<real> impulse = c.impulse(), shift = c.shift(dt);
        for (int i = 0; i < 4; ++i) {
            const int p = c.places.point[i];
            const real by = c.places.share[i] * all.loose.template get<real>(0, p);
            add_to(all.push, 0, p, by * impulse), add_to(all.push, 3, p, by * shift);
        }
    }
    return again;
}

// Velocities and positions take the impulses of a turn, which are then 0 again; none is known to touch any more.
template <typename Model, typename real>
CUDA_CALLABLE inline void take_impulses(const Model& model, int w, const wp::array_t<real>& state, int row) {
    typedef typename several<real>::lanes T;
    const rows_of<real> s(state, row), push(model.push, w);
    for (EACH_ONE_IN(k, 0, 1)) wp::index(model.touching_count, w) = k;
    for (EACH_IN(p, model.first, model.end)) {
        s.add3(3, p, push.template get3<T>(0, p));
        s.add3(0, p, push.template get3<T>(3, p));
        for (int c = 0; c < 7; ++c) push.put(c, p, T(real(0)));
    }
}

// What a turn pushed beyond the table or a wall goes back to it; left there, it would be thrown out by the next
// step's velocities.
template <typename Model, typename real>
CUDA_CALLABLE inline void end_turn(const Model& model, int w, const wp::array_t<real>& state, int row) {
    typedef typename several<real>::lanes T;
    take_impulses(model, w, state, row);
    const ground<T> around(model, w, real(1));
    const rows_of<real> s(state, row), loose(model.loose, w);
    for (EACH_IN(p, model.first, model.end)) {
        const vec<T> x = s.template get3<T>(0, p);
        const T moves = is_above(loose.template get<T>(0, p), T(real(0)));
        s.put3(0, p, moves * around.brought_back(x) + (T(real(1)) - moves) * x);
    }
}

// One turn; tells whether another one is needed.
template <typename Model, typename real>
CUDA_CALLABLE inline int turn_once(const Model& model, int w, const wp::array_t<real>& state, int row, real dt,
                                   int turn) {
    count_contacts(model, w, state, row);
    block_sync();
    const int again = block_any(contact_impulses(model, w, state, row, dt, turn));
    end_turn(model, w, state, row);
    block_sync();
    return again;
}

// Applies contact of the body with itself at the end of a step.
template <typename Model, typename real>
CUDA_CALLABLE inline void resolve(const Model& model, int w, const wp::array_t<real>& state, int row, real dt) {
    rebuild_lists(model, w, state, row, 0, real(0.5) * model.contact_margin);
    if (near_pairs(model, w).number() == 0) return;
    list_close(model, w, state, row);
    for (int turn = 0; turn < model.contact_most_turns; ++turn)
        if (!turn_once(model, w, state, row, dt, turn)) break;
}

}  // namespace gendom
