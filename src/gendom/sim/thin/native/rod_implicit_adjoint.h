// The transpose of a rod's implicit steps, by implicit differentiation of their stages.
//
// A stage ends where the equations R(u, p) of `rod_implicit.h` are 0 (a part that is held, or stopped, has
// u - u*(p) in their place). Derivatives by its end become those by all that it began with:
//
//     R_u^T a = u_bar,    p_bar = -R_p^T a.
#pragma once

namespace gendom {

template <typename Rod, typename Bars, typename real> struct implicit_adjoint {
    const implicit_step<Rod, real> at;
    const rows_of<real> b, base, by, out;  // derivatives by the end, by the base, by the model; the scratch

    CUDA_CALLABLE inline implicit_adjoint(const implicit_step<Rod, real>& at, const Bars& bars,
                                          const wp::array_t<real>& base_bars, int w)
        : at(at), b(bars.state, w), base(base_bars, w), by(bars.model, w), out(bars.scratch, w) {}

    // By velocities and spins at the end: they follow from the shape there and the base. The shape's row takes
    // the base's lagged strains, as forces had them.
    CUDA_CALLABLE inline void begin() const {
        const real per = at.per;
        for (int i = 0; i < at.n; ++i) {
            for (int c = 0; c < 18; ++c) base.put(c, i, real(0)), out.put(c, i, real(0));
            vec<real> v_bar = b.template get3<real>(V_BAR, i), w_bar = b.template get3<real>(W_BAR, i);
            const touching<real>& t = at.touch[i];
            if (at.held(i, 1)) v_bar = {real(0), real(0), real(0)};
            else
                v_bar = {t.side[0] != real(0) ? real(0) : v_bar.x, t.side[1] != real(0) ? real(0) : v_bar.y,
                         t.side[2] != real(0) ? real(0) : v_bar.z};
            b.add3(X_BAR, i, per * v_bar), base.put3(X_BAR, i, -per * v_bar);
            if (i + 1 < at.n && !at.held(i, 2)) {
                const vec<real> turn = at.half_turn(i);
                b.add3(Q_BAR, i, per * back(turn, w_bar)), base.put3(Q_BAR, i, -per * forth(turn, w_bar));
            }
            b.put3(V_BAR, i, vec<real>{real(0), real(0), real(0)}), b.put3(W_BAR, i, vec<real>{real(0), real(0), real(0)});
            at.to.put3(LAG_E, i, at.s.template get3<real>(LAG_E, i));
            at.to.put3(LAG_U, i, at.s.template get3<real>(LAG_U, i));
        }
    }
    // Twice the derivative of the turn t by rotations of the end's direction is J = 1 - t x + t t^T, by those of
    // the base's -J^T.
    CUDA_CALLABLE inline vec<real> forth(const vec<real>& t, const vec<real>& a) const {
        return a - cross(t, a) + dot(t, a) * t;
    }
    CUDA_CALLABLE inline vec<real> back(const vec<real>& t, const vec<real>& a) const {
        return a + cross(t, a) + dot(t, a) * t;
    }

    // Solves R_u^T a = u_bar, hands a to the forces' transpose, and adds what equations of points depend on.
    CUDA_CALLABLE inline void solve() const {
        const int n = at.n;
        at.set_up(true, false);
        for (int i = 0; i < n; ++i) {
            transpose(at.rows[i].own);
            if (i + 1 < n) exchange_transposed(at.rows[i].after, at.rows[i + 1].before);
            for (int a = 0; a < 3; ++a) {
                at.rows[i].rhs(a) = -b.template get<real>(X_BAR + a, i);
                at.rows[i].rhs(3 + a) = -b.template get<real>(Q_BAR + a, i);
            }
        }
        at.solve();
        const vec<real> g = gravity_of<real>(at.rod, at.w);
        const real decay = wp::index(at.rod.velocity_damping, at.w), mu = wp::index(at.rod.friction, at.w);
        for (int i = 0; i < n; ++i) {
            real a[6];
            for (int c = 0; c < 6; ++c) a[c] = at.rows[i].step(c);
            for (int c = 12; c < 18; ++c) base.put(c, i, b.template get<real>(c, i)), b.put(c, i, real(0));
            const bool held = at.held(i, 1), turned = i + 1 == n || at.held(i, 2);
            const vec<real> none = {real(0), real(0), real(0)};
            vec<real> x = {a[0], a[1], a[2]}, q = {a[3], a[4], a[5]};
            b.put3(X_BAR, i, held ? x : none), b.put3(Q_BAR, i, turned && i + 1 < n ? q : none);
            if (turned) q = none;
            if (held) x = none;
            else x = stopped(i, x, mu);
            out.put3(PULL_BAR, i, -x), out.put3(TORQUE_BAR, i, -q);
            add_point(i, x, q, g, decay);
        }
    }
    CUDA_CALLABLE inline void transpose(real a[6][8]) const {
        for (int i = 0; i < 6; ++i)
            for (int j = 0; j < i; ++j) at.exchange(a[i][j], a[j][i]);
    }
    CUDA_CALLABLE inline void exchange_transposed(real a[6][8], real c[6][8]) const {
        for (int i = 0; i < 6; ++i)
            for (int j = 0; j < 6; ++j) at.exchange(a[i][j], c[j][i]);
    }

    // What of a the forces on a point have: none across what it touches, but for friction.
    CUDA_CALLABLE inline vec<real> stopped(int i, vec<real> a, real mu) const {
        const touching<real>& t = at.touch[i];
        const real sides = (t.side[0] < real(0) ? a.x : t.side[0] > real(0) ? -a.x : real(0)) +
                           (t.side[1] < real(0) ? a.y : t.side[1] > real(0) ? -a.y : real(0)) +
                           (t.side[2] < real(0) ? a.z : t.side[2] > real(0) ? -a.z : real(0));
        by.add(RADIUS_BAR, i, sides);
        if (t.side[0] != real(0)) a.x = real(0);
        if (t.side[1] != real(0)) a.y = real(0);
        if (t.side[2] != real(0)) a.z = real(0);
        if (t.press <= real(0)) return a;
        real way[2], slope[2][2];
        at.friction(i, way, slope);
        const real along = way[0] * a.x + way[1] * a.y;
        by.add(FRICTION_BAR, i, t.press * along);
        const real N = mu * t.press;
        base.add3(X_BAR, i, vec<real>{-N * (slope[0][0] * a.x + slope[1][0] * a.y),
                                      -N * (slope[0][1] * a.x + slope[1][1] * a.y), real(0)});
        a.z = mu * along;
        return a;
    }

    // Gravity, inertia, drag and decay of a point, of which equations have x and q.
    CUDA_CALLABLE inline void add_point(int i, const vec<real>& x, const vec<real>& q, const vec<real>& g, real decay) const {
        const real per = at.per, mass = real(1) / at.m.template get<real>(PER_MASS, i);
        const vec<real> v = per * (at.to.template get3<real>(X, i) - at.s.template get3<real>(X, i));
        const vec<real> faster = v - at.s.template get3<real>(V, i);
        by.add3(GRAVITY_BAR, i, -mass * x);
        by.add(PER_MASS_BAR, i, mass * mass * dot(x, g - decay * v - per * faster));
        real by_decay = mass * dot(x, v);
        const vec<real> along = at.along_at(i), vn = across(v, along);
        const real speed = wp::sqrt(dot(vn, vn)), drag = at.m.template get<real>(DRAG, i);
        by.add(DRAG_BAR, i, speed * dot(x, vn));
        const vec<real> dragged = speed * across(x, along) + (dot(vn, x) / larger(speed, real(1e-12))) * vn;
        base.add3(X_BAR, i, -per * (mass * (decay + per) * x + drag * dragged));
        base.add3(V_BAR, i, -per * mass * x);
        const real per_turn = at.m.template get<real>(PER_TURN, i);
        if (per_turn > real(0)) {
            const real turning = real(1) / per_turn;
            const vec<real> t = at.half_turn(i), spin = (per + per) * t;
            const vec<real> sooner = spin - at.s.template get3<real>(W, i);
            by.add(PER_TURN_BAR, i, -turning * turning * dot(q, decay * spin + per * sooner));
            by_decay += turning * dot(q, spin);
            base.add3(W_BAR, i, -per * turning * q);
            base.add3(Q_BAR, i, -per * turning * (decay + per) * forth(t, q));
        }
        by.add(VELOCITY_DAMPING_BAR, i, by_decay);
    }

    // After the forces' transpose: only derivatives by what the stage began with are left.
    CUDA_CALLABLE inline void end() const {
        for (int i = 0; i < at.n; ++i) {
            for (int c = 12; c < 18; ++c) base.add(c, i, b.template get<real>(c, i));
            for (int c = 0; c < 18; ++c) b.put(c, i, base.template get<real>(c, i)), out.put(c, i, real(0));
        }
    }

    // Of `go_on`: derivatives by the second base become those by the first stage's end, and by the start.
    CUDA_CALLABLE inline void go_on(const rows_of<real>& start, real further) const {
        for (int i = 0; i < at.n; ++i) {
            for (int c = 0; c < 18; ++c) {
                const real a = b.template get<real>(c, i);
                b.put(c, i, further * a), base.put(c, i, (real(1) - further) * a);
            }
            const vec<real> q_bar = real(1) / further * b.template get3<real>(Q_BAR, i);
            const vec<real> t = turn_from(start.template get4<real>(Q, i), at.to.template get4<real>(Q, i));
            const vec<real> tau = further * t;
            const real squared = real(1) + dot(tau, tau), unit = real(1) / wp::sqrt(squared);
            const vec<real> t_bar = (real(2) * further / squared) * (q_bar - cross(tau, q_bar));
            b.put3(Q_BAR, i, real(0.5) * back(t, t_bar));
            base.put3(Q_BAR, i, directors<real>(quat<real>{unit * tau, unit}).to_body(q_bar) -
                                    real(0.5) * forth(t, t_bar));
        }
    }
    CUDA_CALLABLE inline void add_base() const {
        for (int i = 0; i < at.n; ++i)
            for (int c = 0; c < 18; ++c) b.add(c, i, base.template get<real>(c, i));
    }
};

#define STAGE_ADJOINT(name)                                                                                  \
    template <typename Rod, typename Bars, typename real>                                                    \
    CUDA_CALLABLE inline void stage_##name##_adjoint(                                                        \
        const Rod& rod, const Bars& bars, int w, const wp::array_t<real>& base, const wp::array_t<real>& ahead, \
        const wp::array_t<real>& work, const wp::array_t<real>& touches, const wp::array_t<real>& base_bars,  \
        real span) {                                                                                         \
        const implicit_step<Rod, real> at(rod, w, base, ahead, work, touches, span);                         \
        implicit_adjoint<Rod, Bars, real>(at, bars, base_bars, w).name();                                    \
    }
STAGE_ADJOINT(begin)
STAGE_ADJOINT(solve)
STAGE_ADJOINT(end)
STAGE_ADJOINT(add_base)
#undef STAGE_ADJOINT

template <typename Rod, typename Bars, typename real>
CUDA_CALLABLE inline void stage_go_on_adjoint(const Rod& rod, const Bars& bars, int w, const wp::array_t<real>& start,
                                              const wp::array_t<real>& ahead, const wp::array_t<real>& work,
                                              const wp::array_t<real>& touches, const wp::array_t<real>& start_bars,
                                              real further) {
    const implicit_step<Rod, real> at(rod, w, start, ahead, work, touches, real(1));
    implicit_adjoint<Rod, Bars, real>(at, bars, start_bars, w).go_on(rows_of<real>(start, w), further);
}

}  // namespace gendom
