// A thin body's contact with itself, at its true thickness, with Coulomb friction.
//
// What is nearer than the thickness after a step is pushed apart by impulses at the two nearest places
// (`contact_lists.h`): they take away the speed of approach; what is still too near is moved apart without
// speed. Friction takes what slides, at most by its coefficient times what was pushed. The contacts of a turn are
// taken at once (Jacobi): each has its part of a point's mass, and the point takes the mean of what its parts do,
// so that impulses stay equal and opposite (Tonge et al. (2012), "Mass splitting for jitter-free parallel rigid
// body simulation"). One after the other (Gauss and Seidel) they throw points out of places that are too narrow
// for them.

namespace gendom {

// Friction needs so many turns over the contacts of a step; then they go on while one finds something nearer than
// what is enough, in thicknesses.
constexpr int needed_turns = 4;
constexpr double enough_distance = 0.9;

// Whether pushes are whole numbers, see `pushes`.
#if defined(IN_SHARED)
template <typename real> constexpr bool IS_WHOLE = sizeof(real) == 4;
#else
template <typename real> constexpr bool IS_WHOLE = false;
#endif

template <typename real> CUDA_CALLABLE inline void add_to(const rows_of<real>& rows, int c, int i, real a) {
#if defined(__CUDA_ARCH__)
    const auto to = __cvta_generic_to_global(rows.first + c * rows.pitch + i);  // no question where it is
    if constexpr (sizeof(real) == 4) asm volatile("red.global.add.f32 [%0], %1;" ::"l"(to), "f"(a) : "memory");
    else asm volatile("red.global.add.f64 [%0], %1;" ::"l"(to), "d"(a) : "memory");
#else
    rows.first[c * rows.pitch + i] += a;
#endif
}
// What a turn adds to points: rows 0 to 2 velocities, 3 to 5 places, 6 the number of contacts among which its mass is
// divided. In shared memory, in float32, these are whole numbers of small units: many threads add to them much faster.
template <typename real> struct pushes : components<pushes<real>> {
    const rows_of<real> rows;
    const real unit, per_step;  // of places, and of velocities over that

    template <typename Model>
    CUDA_CALLABLE inline pushes(const Model& model, int w, real dt)
        : rows(IS_WHOLE<real> ? shared_or(SHARED_PUSH, model.push, w) : rows_of<real>(model.push, w)),
          unit(model.contact_distance / real(1 << 24)), per_step(real(1) / dt) {}
    CUDA_CALLABLE inline real unit_of(int c) const { return c == 6 ? real(1) : c < 3 ? unit * per_step : unit; }
    template <typename T> CUDA_CALLABLE inline T get(int c, int i) const {
        if constexpr (IS_WHOLE<real>) return unit_of(c) * T(__float_as_int(rows.at(c, i)));
        else return rows.template get<T>(c, i);
    }
    template <typename T> CUDA_CALLABLE inline void put(int c, int i, const T& a) const { rows.put(c, i, a); }
};
template <typename real> CUDA_CALLABLE inline void add_to(const pushes<real>& push, int c, int i, real a) {
    if constexpr (IS_WHOLE<real>) atomicAdd((int*)&push.rows.at(c, i), __float2int_rn(a / push.unit_of(c)));
    else add_to(push.rows, c, i, a);
}
template <typename Rows, typename real>
CUDA_CALLABLE inline void add_to(const Rows& rows, int c, int i, const vec<real>& a) {
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

// Those of the close pairs that touch, in shared memory if there is room.
template <typename Model> CUDA_CALLABLE inline pairs_of touching_pairs(const Model& model, int w, int close) {
    const pairs_of touching = pairs_in(model, w, TOUCHING);
#if defined(IN_SHARED)
    const auto free = shared_or(SHARED_TOUCHING, model.push, w);
    const int room = (SHARED_LOOSE - SHARED_TOUCHING) * ROW_LENGTH * sizeof(*free.first) / (2 * sizeof(int));
    if (close <= room) return {(int*)(free.first - margin), touching.counts, room};
#endif
    return touching;
}

// The close pairs of a world in one state.
template <typename Model, typename real> struct contacts {
    const Model& model;
    const int w;
    const pairs_of close, touching;
    const rows_of<real> s, loose;
    const pushes<real> push;
    const real dt, per_dt, mu;
    // Points that take the mean of many pushes go less far than each asks for. Where the first turns do not suffice,
    // over-relaxation takes fewer further ones. From 2 on it may diverge.
    const real over;

    CUDA_CALLABLE inline contacts(const Model& model, int w, const rows_of<real>& s, real dt, int turn)
        : model(model), w(w), close(pairs_in(model, w, CLOSE)), touching(touching_pairs(model, w, close.number())),
          s(s), loose(shared_or(SHARED_LOOSE, model.loose, w)), push(model, w, dt), dt(dt), per_dt(real(1) / dt),
          mu(wp::index(model.self_friction, w)), over(turn < needed_turns ? real(1) : real(1.8)) {}

    CUDA_CALLABLE inline real split(int p) const { return push.template get<real>(6, p); }
    // Whether a pair is pushed apart, and how.
    CUDA_CALLABLE inline bool find(int one, int other, contact<real>& c) const {
        c.places = feature_pair(one, other, model.pitch).meet(s);
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

// Lists the pairs that touch, and counts them for every point that shares in them.
template <typename Model, typename real>
CUDA_CALLABLE inline void list_touching(const contacts<Model, real>& all) {
    all.touching.clear();
    block_sync();
    int one, other;
    for (EACH_ONE_IN(k, 0, all.close.number())) {
        all.close.read(k, one, other);
        const meeting<real> m = feature_pair(one, other, all.model.pitch).meet(all.s);
        if (m.distance >= all.model.contact_distance) continue;
        all.touching.append(one, other);
        for (int i = 0; i < 4; ++i)
            if (m.share[i] != real(0)) add_to(all.push, 6, m.point[i], real(1));
    }
    block_sync();
}

// One turn over the contacts of a step; tells whether one of this thread's was nearer than the distance
// that asks for another turn.
template <typename Model, typename real>
CUDA_CALLABLE inline int contact_impulses(const contacts<Model, real>& all, int turn) {
    const real enough = (turn + 1 < needed_turns ? real(1) : real(enough_distance)) * all.model.contact_distance;
    contact<real> c;
    int again = 0, one, other;
    for (EACH_ONE_IN(k, 0, all.touching.number())) {
        all.touching.read(k, one, other);
        if (!all.find(one, other, c)) continue;
        if (c.places.distance < enough) again = 1;
        const vec<real> impulse = c.impulse(), shift = c.shift(all.dt);
        for (int i = 0; i < 4; ++i) {
            const int p = c.places.point[i];
            const real by = c.places.share[i] * all.loose.template get<real>(0, p);
            add_to(all.push, 0, p, by * impulse), add_to(all.push, 3, p, by * shift);
        }
    }
    return again;
}

// Velocity and position of a point take the impulses of a turn, which are then 0 again.
template <typename T, typename real>
CUDA_CALLABLE inline void take_impulses_at(int p, const rows_of<real>& s, const pushes<real>& push) {
    s.add3(3, p, push.template get3<T>(0, p));
    s.add3(0, p, push.template get3<T>(3, p));
    for (int c = 0; c < 7; ++c) push.put(c, p, T(real(0)));
}
template <typename Model, typename real>
CUDA_CALLABLE inline void take_impulses(const Model& model, int w, const wp::array_t<real>& state, int row) {
    typedef typename several<real>::lanes T;
    const rows_of<real> s(state, row);
    const pushes<real> push(model, w, real(1));
    for (EACH_IN(p, model.first, model.end)) take_impulses_at<T>(p, s, push);
}

// What a turn pushed into the table or an obstacle goes back to its surface; left there, it would be thrown out by
// the next step's velocities. Places before that are kept for the transpose.
template <typename Model, typename real> CUDA_CALLABLE inline void end_turn(const contacts<Model, real>& all) {
    typedef typename several<real>::lanes T;
    const surroundings<T> around(all.model, all.w, real(1));
    for (EACH_IN(p, all.model.first, all.model.end)) {
        if (largest_of(all.push.template get<T>(6, p)) == real(0)) continue;
        take_impulses_at<T>(p, all.s, all.push);
        const vec<T> x = all.s.template get3<T>(0, p);
        all.push.put3(7, p, x);
        const T moves = is_above(all.loose.template get<T>(0, p), T(real(0)));
        all.s.put3(0, p, moves * around.brought_back(x) + (T(real(1)) - moves) * x);
    }
}

// One turn, unless nothing touches; tells whether another one is needed.
template <typename Model, typename real>
CUDA_CALLABLE inline int turn_once(const Model& model, int w, const rows_of<real>& s, real dt, int turn) {
    const contacts<Model, real> all(model, w, s, dt, turn);
    list_touching(all);
    if (all.touching.number() == 0) return 0;
    const int again = block_any(contact_impulses(all, turn));
    end_turn(all);
    block_sync();
    return again;
}

// Applies contact of the body with itself at the end of a step.
template <typename Model, typename real>
CUDA_CALLABLE inline void resolve(const Model& model, int w, const wp::array_t<real>& state, int row, real dt) {
    const rows_of<real> s(state, row);
#if defined(IN_SHARED)
    const rows_of<real> there = shared_or(SHARED_STATE, state, w);
    copy_rows(model, 6, s, 0, there, 0);
    block_sync();
#else
    const rows_of<real>& there = s;
#endif
    rebuild_lists(model, w, there, real(0.5) * model.contact_margin);
    if (pairs_in(model, w, NEAR).number() == 0) return;
    list_close(model, w, there);
    if (pairs_in(model, w, CLOSE).number() == 0) return;
#if defined(IN_SHARED)
    for (EACH_IN(p, model.first, model.end))
        for (int c = 0; c < 7; ++c) shared_or(SHARED_PUSH, model.push, w).put(c, p, real(0));
#endif
    for (int turn = 0; turn < model.contact_most_turns; ++turn)
        if (!turn_once(model, w, there, dt, turn)) break;
#if defined(IN_SHARED)
    copy_rows(model, 6, there, 0, s, 0);
    block_sync();
#endif
}

// ---- transposes ----------------------------------------------------------------------------------
//
// The contacts go as in the step once more, and the points before each turn are kept. Then they are put back, the
// last first, and each push is transposed where it was made. Nearest places x = sum_i s_i x_i, with
// a = x - y between them, slide along those edges e_k of their features at whose ends they do not
// stand. There a . e_k = 0, so that with ds_to = dt_k, ds_from = -dt_k (implicit differentiation)
//
//     sum_l (e_k . e_l) dt_l = -(e_k . da + a . de_k),  da at unchanged shares s.

// Of `end_turn`, but for `take_impulses`; rows from c on are places as the turn pushed them.
template <typename Model, typename Adjoint, typename real>
CUDA_CALLABLE inline void end_turn_adjoint(const Model& model, const Adjoint& adjoint, int w,
                                           const rows_of<real>& pushed, int c) {
    typedef typename several<real>::lanes T;
    const surroundings<T> around(model, w, real(1));
    const rows_of<real> b(adjoint.state, w), by(adjoint.model, w), loose(model.loose, w);
    for (EACH_IN(p, model.first, model.end)) {
        const T moves = is_above(loose.template get<T>(0, p), T(real(0)));
        const vec<T> x_bar = b.template get3<T>(0, p);
        vec<T> moved_bar = moves * x_bar;
        by.add(RADIUS_BAR, p, around.brought_back_adjoint(pushed.template get3<T>(c, p), moved_bar));
        b.put3(0, p, moved_bar + (T(real(1)) - moves) * x_bar);
    }
}

// Up to two edges, between points of a pair, along which its nearest places slide.
struct sliding_along {
    int count, from[2], to[2];

    CUDA_CALLABLE inline void add(int a, int b) { from[count] = a, to[count] = b, ++count; }
};

template <typename real>
CUDA_CALLABLE inline sliding_along slides_of(const rows_of<real>& s, const meeting<real>& m, bool is_point) {
    const auto inside = [](real a) { return a > real(0) && a < real(1); };
    const auto edge = [&](int a, int b) {
        return s.template get3<real>(0, m.point[b]) - s.template get3<real>(0, m.point[a]);
    };
    sliding_along along = {0, {0, 0}, {0, 0}};
    if (is_point) {
        const real v = -m.share[2], w = -m.share[3];
        const bool on_far_edge = v == real(1) - w;
        if (inside(v) && inside(w) && on_far_edge) along.add(2, 3);
        else if (inside(v) || inside(w)) {
            if (v > real(0)) along.add(1, 2);
            if (w > real(0)) along.add(1, 3);
        }
        return along;
    }
    const bool first = inside(m.share[1]), second = inside(-m.share[3]);
    if (second) along.add(2, 3);
    const vec<real> u = edge(0, 1), v = edge(2, 3);
    const real uu = dot(u, u), vv = dot(v, v), uv = dot(u, v);
    // of parallel edges the first one's middle is taken, unless the second one ends before
    if (first && (!second || uu * vv - uv * uv > real(1e-6) * uu * vv)) along.add(0, 1);
    return along;
}

// Solves sum_l (e_k . e_l) t_l = by_k.
template <typename real>
CUDA_CALLABLE inline void solve_slides(int count, const vec<real> e[2], const real by[2], real t[2]) {
    t[0] = t[1] = real(0);
    if (count == 1) t[0] = by[0] / dot(e[0], e[0]);
    if (count == 2) {
        const real a = dot(e[0], e[0]), b = dot(e[0], e[1]), c = dot(e[1], e[1]), det = a * c - b * b;
        t[0] = (c * by[0] - b * by[1]) / det, t[1] = (a * by[1] - b * by[0]) / det;
    }
}

// Derivatives by what a push is made of, given those by its impulse and its shift.
template <typename real> struct contact_bar {
    vec<real> away, v;
    real per_mass, mu, depth;

    CUDA_CALLABLE inline contact_bar(const contact<real>& c, const vec<real>& by_impulse,
                                     const vec<real>& by_shift, real dt, real mu_is) {
        // shift = share (over depth n - dt held_back vt), the rest of its terms cancel
        const vec<real> I = c.share * by_impulse, S = c.share * by_shift, slows = -(I + dt * S);
        per_mass = -(dot(I, c.speed * c.n - c.held_back * c.vt) +
                     dot(S, c.over * c.depth * c.n - dt * c.held_back * c.vt)) / c.per_mass;
        vec<real> n = c.speed * I + c.over * c.depth * S, vt = c.held_back * slows;
        real needed = real(0), vn = real(0);
        depth = c.over * dot(S, c.n);
        const real speed = dot(I, c.n);
        if (-c.vn >= c.needed) needed += speed;
        else if (c.vn < real(0)) vn -= speed;
        mu = real(0);
        if (c.held_back < real(1)) {  // it slides: held_back = mu needed / sliding
            const real held_back = dot(slows, c.vt);
            mu = held_back * c.needed / c.sliding;
            needed += held_back * mu_is / c.sliding;
            if (c.sliding > real(1e-12))
                vt = vt - (held_back * c.held_back / (c.sliding * c.sliding)) * c.vt;
        }
        depth += needed / dt;
        // vt = v - vn n, vn = v . n
        vn -= dot(vt, c.n);
        n = n - c.vn * vt + vn * c.v;
        v = vt + vn * c.n;
        away = (real(1) / c.places.distance) * (n - dot(n, c.n) * c.n) - depth * c.n;
    }
};

// Of one push. What it adds to derivatives by positions and velocities adds up in `push`, from where `take_impulses`
// takes it.
template <typename Model, typename real>
CUDA_CALLABLE inline void push_adjoint(const contacts<Model, real>& all, bool has_point, const contact<real>& c,
                                       const rows_of<real>& b, const rows_of<real>& by) {
    const meeting<real>& m = c.places;
    const vec<real> impulse = c.impulse(), shift = c.shift(all.dt), none = {real(0), real(0), real(0)};
    vec<real> by_impulse = none, by_shift = none;
    real moved[4], loose[4], by_per_mass[4];
    for (int i = 0; i < 4; ++i) {
        const vec<real> xb = b.template get3<real>(X_BAR, m.point[i]);
        const vec<real> vb = b.template get3<real>(V_BAR, m.point[i]);
        loose[i] = all.loose.template get<real>(0, m.point[i]);
        by_impulse = by_impulse + m.share[i] * loose[i] * vb;
        by_shift = by_shift + m.share[i] * loose[i] * xb;
        moved[i] = dot(vb, impulse) + dot(xb, shift);
    }
    const contact_bar<real> bar(c, by_impulse, by_shift, all.dt, all.mu);
    add_to(by, SELF_FRICTION_BAR, m.point[0], bar.mu);
    add_to(by, DISTANCE_BAR, m.point[0], bar.depth);

    vec<real> x[4];
    for (int i = 0; i < 4; ++i) {
        x[i] = all.s.template get3<real>(0, m.point[i]);
        by_per_mass[i] = m.share[i] * all.split(m.point[i]) * bar.per_mass;
    }
    const auto by_share = [&](int i) {
        return loose[i] * (moved[i] + real(2) * by_per_mass[i]) + dot(bar.away, x[i]) +
               dot(bar.v, all.s.template get3<real>(3, m.point[i]));
    };
    const sliding_along along = slides_of(all.s, m, has_point);
    vec<real> e[2] = {none, none};
    real ends[2] = {real(0), real(0)}, t[2];
    for (int a = 0; a < along.count; ++a) {
        e[a] = x[along.to[a]] - x[along.from[a]];
        ends[a] = by_share(along.to[a]) - by_share(along.from[a]);
    }
    solve_slides(along.count, e, ends, t);
    const vec<real> away = bar.away - t[0] * e[0] - t[1] * e[1];
    for (int i = 0; i < 4; ++i) {
        vec<real> add = m.share[i] * away;
        for (int a = 0; a < along.count; ++a)
            add = add + (i == along.from[a] ? t[a] : i == along.to[a] ? -t[a] : real(0)) * m.away;
        add_to(all.push, 3, m.point[i], add);
        add_to(all.push, 0, m.point[i], m.share[i] * bar.v);
        if (loose[i] > real(0))
            add_to(by, PER_MASS_BAR, m.point[i],
                   m.share[i] * (moved[i] + by_per_mass[i]));
    }
}

// Of one turn.
template <typename Model, typename Adjoint, typename real>
CUDA_CALLABLE inline void contact_impulses_adjoint(const contacts<Model, real>& all, const Adjoint& adjoint) {
    const rows_of<real> b(adjoint.state, all.w), by(adjoint.model, all.w);
    contact<real> c;
    int one, other;
    for (EACH_ONE_IN(k, 0, all.touching.number())) {
        all.touching.read(k, one, other);
        if (all.find(one, other, c)) push_adjoint(all, one % 4 == 3, c, b, by);
    }
}

// Of `resolve`; the row is as that found it, and rows from c on tell what its list was made from. `kept` has
// room for the points before each turn, and where it pushed them, [worlds, turns * 9, P].
template <typename Model, typename Adjoint, typename real>
CUDA_CALLABLE inline void resolve_adjoint(const Model& model, const Adjoint& adjoint, int w,
                                          const wp::array_t<real>& kept, int at,
                                          const wp::array_t<real>& state, int row, int c, real dt) {
    const rows_of<real> s(state, row), before(kept, at), push(model.push, w);
    rebuild_lists(model, w, s.from(c), real(0));
    if (pairs_in(model, w, NEAR).number() == 0) return;
    list_close(model, w, s);
    int turns = 0;
    for (bool again = true; again && turns < model.contact_most_turns; ++turns) {
        copy_rows(model, 6, s, 0, before, 9 * turns);
        copy_rows(model, 3, s, 0, push, 7);
        again = turn_once(model, w, s, dt, turns);
        copy_rows(model, 3, push, 7, before, 9 * turns + 6);
    }
    while (turns-- > 0) {
        end_turn_adjoint(model, adjoint, w, before, 9 * turns + 6);
        block_sync();
        copy_rows(model, 6, before, 9 * turns, s, 0);
        block_sync();
        const contacts<Model, real> all(model, w, s, dt, turns);
        list_touching(all);
        contact_impulses_adjoint(all, adjoint);
        block_sync();
        take_impulses(model, w, adjoint.state, w);
        block_sync();
    }
}

}  // namespace gendom
