// The transpose of a body's contact with itself: derivatives of a loss by what the contacts of a step
// leave become those by what they began with. A bar marks them.
//
// The contacts go as in the step once more, and the points before each turn are kept. Then they are put back, the
// last first, and each push is transposed where it was made. Nearest places x = sum_i s_i x_i, with
// a = x - y between them, slide along those edges e_k of their features at whose ends they do not
// stand. There a . e_k = 0, so that with ds_to = dt_k, ds_from = -dt_k (implicit differentiation)
//
//     sum_l (e_k . e_l) dt_l = -(e_k . da + a . de_k),  da at unchanged shares s.
#pragma once

namespace gendom {

// Of `end_turn`, but for `take_impulses`; the row is as the turn left it.
template <typename Model, typename Adjoint, typename real>
CUDA_CALLABLE inline void end_turn_adjoint(const Model& model, const Adjoint& adjoint, int w,
                                           const wp::array_t<real>& state, int row) {
    typedef typename several<real>::lanes T;
    const ground<T> around(model, w, real(1));
    const rows_of<real> s(state, row), b(adjoint.state, w), by(adjoint.model, w), loose(model.loose, w);
    for (EACH_IN(p, model.first, model.end)) {
        const T moves = is_above(loose.template get<T>(0, p), T(real(0)));
        const vec<T> x_bar = b.template get3<T>(0, p);
        vec<T> moved_bar = moves * x_bar;
        by.add(RADIUS_BAR, p, around.brought_back_adjoint(s.template get3<T>(0, p), moved_bar));
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
CUDA_CALLABLE inline void push_adjoint(const contacts<Model, real>& all, int k, const contact<real>& c,
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
    const sliding_along along = slides_of(all.s, m, all.has_point(k));
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
CUDA_CALLABLE inline void contact_impulses_adjoint(const Model& model, const Adjoint& adjoint, int w,
                                             const wp::array_t<real>& state, int row, real dt, int turn) {
    const rows_of<real> b(adjoint.state, w), by(adjoint.model, w);
    contact<real> c;
    const contacts<Model, real> all(model, w, state, row, dt, turn);
    for (EACH_ONE_IN(j, 0, all.number())) {
        const int k = all.at(j);
        if (all.find(k, c)) push_adjoint(all, k, c, b, by);
    }
}

// Of `resolve`; the row is as that found it, and rows from c on tell what its list was made from. `kept` has
// room for the points before each turn, [worlds, turns * 6, P].
template <typename Model, typename Adjoint, typename real>
CUDA_CALLABLE inline void resolve_adjoint(const Model& model, const Adjoint& adjoint, int w,
                                          const wp::array_t<real>& kept, int at,
                                          const wp::array_t<real>& state, int row, int c, real dt) {
    rebuild_lists(model, w, state, row, c, real(0));
    if (near_pairs(model, w).number() == 0) return;
    list_close(model, w, state, row);
    const rows_of<real> s(state, row), before(kept, at);  // all points before each turn
    int turns = 0;
    for (bool again = true; again && turns < model.contact_most_turns; ++turns) {
        copy_rows(model, 6, s, 0, before, 6 * turns);
        again = turn_once(model, w, state, row, dt, turns);
    }
    while (turns-- > 0) {
        end_turn_adjoint(model, adjoint, w, state, row);
        block_sync();
        copy_rows(model, 6, before, 6 * turns, s, 0);
        block_sync();
        count_contacts(model, w, state, row);
        block_sync();
        contact_impulses_adjoint(model, adjoint, w, state, row, dt, turns);
        block_sync();
        take_impulses(model, w, adjoint.state, w);
        block_sync();
    }
}

}  // namespace gendom
