// A rod: points x_i and between them edges with directions q_i (unit quaternions).
//
// Strains of an edge are its stretch and shear, those of a joint between two edges its bending and
// twist, both seen from the body:
//
//     e = R^T (x_(i+1) - x_i) / l - e_0                     (shear, shear, stretch)
//     u = 4 tan(phi / 4) axis - u_0,  of conj(q_(i-1)) q_i  (bending, bending, twist)
//
// The energies are l / 2 e.C e and 1 / (2 l) u.B u, a staggered Timoshenko rod; without shear it is
// the discrete elastic rod of Bergou et al. (2008). phi (1 + phi^2 / 48) takes the place of the
// angle phi: rational, smooth beyond half a turn. Turns are by rotation vectors in the world's axes.

namespace gendom {

// ---- the two elements; with a standard linear solid stress = stiffness ((1 + c) strain - c lagged)

template <typename T> struct rod_edge {
    typedef typename number_of<T>::type real;
    directors<T> R;
    vec<T> d, e;
    T per_length;

    CUDA_CALLABLE inline rod_edge(const vec<T>& d, const quat<T>& q, T per_length, const vec<T>& rest)
        : R(q), d(d), e(per_length * R.to_body(d) - rest), per_length(per_length) {}

    // Force that pulls its first point along, its second one back.
    CUDA_CALLABLE inline vec<T> force(const vec<T>& stress) const { return R.to_world(stress); }

    // Derivative of the energy by a turn of q.
    CUDA_CALLABLE inline vec<T> turn_gradient(const vec<T>& N) const { return cross(N, d); }
};

template <typename T> struct rod_joint {
    typedef typename number_of<T>::type real;
    quat<T> p;
    T f;
    vec<T> u;

    CUDA_CALLABLE inline rod_joint(const quat<T>& before, const quat<T>& after, const vec<T>& rest)
        : p(between(before, after)) {
        f = T(real(4)) / larger(T(real(1)) + p.w, T(real(1e-3)));
        u = f * p.v - rest;
    }

    // du for a turn eta of `after`, in the axes of `before`, and its transpose.
    CUDA_CALLABLE inline vec<T> strain_of(const vec<T>& eta) const {
        return T(real(0.5)) * f * (p.w * eta + cross(eta, p.v)) +
               T(real(0.125)) * f * f * dot(eta, p.v) * p.v;
    }
    CUDA_CALLABLE inline vec<T> turn_gradient(const vec<T>& m) const {
        return T(real(0.5)) * f * (p.w * m + cross(p.v, m)) +
               T(real(0.125)) * f * f * dot(p.v, m) * p.v;
    }
    // Second derivative of m.u by eta, along geodesics, times eta.
    CUDA_CALLABLE inline vec<T> curving(const vec<T>& m, const vec<T>& eta) const {
        const T half = T(real(0.5)), slope = T(real(-0.25)) * f * f;
        const T by_v = dot(m, p.v);
        const vec<T> dw = -half * p.v, dv = half * (p.w * m + cross(p.v, m));
        const T along = dot(dw, eta);
        return T(real(-0.25)) * (f + slope * p.w) * by_v * eta +
               slope * (dot(dv, eta) * dw + along * dv) +
               T(real(0.125)) * f * f * f * by_v * along * dw;
    }
};

// ---- explicit steps ------------------------------------------------------------------------------

// Rows of a state, of the model and of what a step leaves for its second half.
enum { LAG_E = 13, LAG_U = 16 };
enum { SHEAR = 0, BENDING = 3 };
enum { PER_LENGTH = 0, REST_E = 1, REST_U = 4 };
enum { PER_MASS = 0, PER_TURN = 1, DRAG = 2, STIFFER = 3 };
enum { ALONG = 0, PULL = 3, TURN = 6, MOMENT = 9 };

// What a step's length and a world's material make of the standard linear solid.
template <typename real> struct viscosity {
    real follows, share;  // a of the lagged strain in a step; c, the viscous stiffness over the elastic
    real follows_slope, share_slope;  // derivatives by the damping
    CUDA_CALLABLE inline viscosity(real damping, real dt)
        : follows(real(1)), share(real(0)), follows_slope(real(0)), share_slope(real(1) / dt) {
        if (damping > real(0)) {
            const real left = wp::exp(-dt / damping);
            follows = real(1) - left;
            share = follows * damping / dt;
            follows_slope = -left * dt / (damping * damping);
            share_slope = (follows + damping * follows_slope) / dt;
        }
    }
};

// Of one edge and joint: forces and torques in the scratch; the lagged strains go on. Returns the squared stretch.
template <typename T, typename State, typename To, typename Out, typename Fixed>
CUDA_CALLABLE inline T rod_forces_at(int i, const State& s, const To& to, const Out& out, const Fixed& rest,
                                     const Fixed& k, const Fixed& m, const T& c, const T& a) {
    typedef typename number_of<T>::type real;
    const quat<T> q = s.template get4<T>(Q, i);
    const rod_edge<T> edge(s.template get3<T>(X, i + 1) - s.template get3<T>(X, i), q,
                           rest.template get<T>(PER_LENGTH, i), rest.template get3<T>(REST_E, i));
    const vec<T> lag_e = s.template get3<T>(LAG_E, i), late_e = edge.e - lag_e;
    const vec<T> N = edge.force(k.template get3<T>(SHEAR, i) * (edge.e + c * late_e));
    to.put3(LAG_E, i, lag_e + a * late_e);
    out.put3(ALONG, i, edge.per_length * edge.d);
    out.put3(PULL, i, N);
    out.put3(TURN, i, edge.turn_gradient(N));

    const quat<T> before = s.template get4<T>(Q, i - 1);
    const rod_joint<T> joint(before, q, rest.template get3<T>(REST_U, i));
    const vec<T> lag_u = s.template get3<T>(LAG_U, i), late_u = joint.u - lag_u;
    const vec<T> stress = m.template get<T>(STIFFER, i) * k.template get3<T>(BENDING, i) *
                          (joint.u + c * late_u);
    to.put3(LAG_U, i, lag_u + a * late_u);
    out.put3(MOMENT, i, directors<T>(before).to_world(joint.turn_gradient(stress)));
    return edge.e.z * edge.e.z;  // 0 where there is no edge
}

// Of all of them; returns the largest squared stretch, not a number if any is not.
template <typename Model, typename real>
CUDA_CALLABLE inline real rod_forces(const Model& model, int w, const wp::array_t<real>& state, int row,
                                     int next, real dt) {
    typedef typename several<real>::lanes T;
    const int n = model.points;
    const rows_of<real> s(state, row), to(state, next), rest(model.rest, w), k(model.stiffness, w),
        m(model.inertia, w), out(model.scratch, w);
    const viscosity<real> visc(wp::index(model.damping, w), dt);
    const T c = T(visc.share), a = T(visc.follows);
    T worst = T(real(0)), sum = T(real(0));
    for (EACH(i, n)) {
        const T stretch = rod_forces_at(i, s, to, out, rest, k, m, c, a);
        worst = larger(worst, stretch);
        sum += stretch;
    }
    const real all = sum_of(sum);
    return all == all ? largest_of(worst) : all;
}

// The part of a velocity that is across the rod.
template <typename T> CUDA_CALLABLE inline vec<T> across(const vec<T>& v, const vec<T>& along) {
    typedef typename number_of<T>::type real;
    const T per = T(real(1)) / larger(dot(along, along), T(real(1e-12)));
    return v - dot(v, along) * per * along;
}

// Mean of how much edges are stretched or compressed; every thread finds it.
template <typename Model, typename real>
CUDA_CALLABLE inline real rod_stretch(const Model& model, const wp::array_t<real>& state, int row) {
    const rows_of<real> s(state, row), rest(model.rest, 0);
    real sum = real(0);
    for (EACH_ONE(i, model.points - 1)) {
        const vec<real> d = s.template get3<real>(X, i + 1) - s.template get3<real>(X, i);
        const real stretch = wp::sqrt(dot(d, d)) * rest.template get<real>(PER_LENGTH, i) - real(1);
        sum += stretch < real(0) ? -stretch : stretch;
    }
    return warp_sum(sum) / real(model.points - 1);
}

// Velocity, position and direction at the end of a step, of what nobody holds.
template <typename T, typename Around, typename State, typename To, typename In, typename Fixed>
CUDA_CALLABLE inline void rod_move_at(int i, const State& s, const To& to, const In& in, const Fixed& m,
                                      const motion<T, Around>& go) {
    typedef typename number_of<T>::type real;
    const T one = T(real(1)), half = T(real(0.5));
    const vec<T> x = s.template get3<T>(X, i), v0 = s.template get3<T>(V, i);
    const vec<T> along = in.template get3<T>(ALONG, i - 1) + in.template get3<T>(ALONG, i);
    const vec<T> vn = across(v0, along);
    const vec<T> f = in.template get3<T>(PULL, i) - in.template get3<T>(PULL, i - 1) -
                     m.template get<T>(DRAG, i) * root(dot(vn, vn)) * vn;
    go.step(to, i, x, v0, m.template get<T>(PER_MASS, i), f);

    const vec<T> torque = in.template get3<T>(MOMENT, i + 1) - in.template get3<T>(MOMENT, i) -
                          in.template get3<T>(TURN, i);
    const vec<T> spin =
        go.keep * (s.template get3<T>(W, i) + go.kick * m.template get<T>(PER_TURN, i) * torque);
    quat<T> q = quat<T>{half * go.h * spin, one} * s.template get4<T>(Q, i);
    const T per = one / root(dot(q.v, q.v) + q.w * q.w);
    to.put3(W, i, spin);
    to.put4(Q, i, quat<T>{per * q.v, per * q.w});
}

template <typename Model, typename real>
CUDA_CALLABLE inline void rod_move(const Model& model, int w, const wp::array_t<real>& state, int row,
                                   int next, real dt, real kick) {
    typedef typename several<real>::lanes T;
    const int n = model.points;
    const rows_of<real> s(state, row), to(state, next), m(model.inertia, w), in(model.scratch, w);
    const motion<T> go(model, w, dt, kick);
    for (EACH(i, n)) rod_move_at(i, s, to, in, m, go);
}

// ---- transposes ----------------------------------------------------------------------------------
//
// Derivatives of a loss by what a step leaves become those by what it began with. A bar marks them;
// those by directions are by turns in the world's axes.

// Rows of the derivatives by a state, by the model, and of what is handed from half to half.
enum { LAG_E_BAR = 12, LAG_U_BAR = 15 };
enum { SHEAR_BAR = 0, BENDING_BAR = 3, PER_TURN_BAR = 14 };
enum { PULL_BAR = 0, TORQUE_BAR = 3, ALONG_BAR = 6, D_BAR = 9, JOINT_H = 12, JOINT_G = 15 };

// Of `rod_move`; the scratch is as `rod_forces` left it.
template <typename Model, typename Adjoint, typename real>
CUDA_CALLABLE inline void rod_move_adjoint(const Model& model, const Adjoint& adjoint, int w,
                                           const wp::array_t<real>& state, int row, real dt,
                                           real kick) {
    typedef typename several<real>::lanes T;
    const int n = model.points;
    const rows_of<real> s(state, row), m(model.inertia, w), in(model.scratch, w), b(adjoint.state, w), by(adjoint.model, w), out(adjoint.scratch, w);
    const T one = T(real(1)), half = T(real(0.5)), tiny = T(real(1e-12));
    const motion<T> go(model, w, dt, kick);
    for (EACH(i, n)) {
        // as in the step
        const vec<T> x = s.template get3<T>(X, i), v0 = s.template get3<T>(V, i);
        const vec<T> along = in.template get3<T>(ALONG, i - 1) + in.template get3<T>(ALONG, i);
        const vec<T> vn = across(v0, along);
        const T speed_n = root(dot(vn, vn)), drag = m.template get<T>(DRAG, i);
        const vec<T> f = in.template get3<T>(PULL, i) - in.template get3<T>(PULL, i - 1) -
                         drag * speed_n * vn;
        vec<T> v_bar;
        const vec<T> f_bar = go.step_adjoint(b, by, i, x, v0, m.template get<T>(PER_MASS, i), f, v_bar);
        const T f_vn = dot(f_bar, vn);
        by.add(DRAG_BAR, i, -speed_n * f_vn);
        const vec<T> vn_bar = -drag * (speed_n * f_bar + f_vn / larger(speed_n, tiny) * vn);
        const T per = one / larger(dot(along, along), tiny);
        const T v_t = dot(v0, along), t_bar = dot(along, vn_bar);
        out.put3(ALONG_BAR, i, T(real(2)) * per * per * v_t * t_bar * along -
                                   per * (t_bar * v0 + v_t * vn_bar));
        out.put3(PULL_BAR, i, f_bar);
        b.put3(V_BAR, i, v_bar + across(vn_bar, along));

        const vec<T> torque = in.template get3<T>(MOMENT, i + 1) - in.template get3<T>(MOMENT, i) -
                              in.template get3<T>(TURN, i);
        const T per_turn = m.template get<T>(PER_TURN, i);
        const vec<T> spin = go.keep * (s.template get3<T>(W, i) + go.kick * per_turn * torque);
        const vec<T> a = half * go.h * spin, q_bar = b.template get3<T>(Q_BAR, i);
        const T squared = one + dot(a, a), unit = one / root(squared);
        vec<T> spin_bar = b.template get3<T>(W_BAR, i) + go.h / squared * (q_bar - cross(a, q_bar));
        by.add(VELOCITY_DAMPING_BAR, i, -go.kick * dot(spin, spin_bar));
        spin_bar = go.keep * spin_bar;
        by.add(PER_TURN_BAR, i, go.kick * dot(torque, spin_bar));
        out.put3(TORQUE_BAR, i, go.kick * per_turn * spin_bar);
        b.put3(Q_BAR, i, directors<T>(quat<T>{unit * a, unit}).to_body(q_bar));
        b.put3(W_BAR, i, spin_bar);
    }
}

// Of `rod_forces`, first half: every edge and joint for itself.
template <typename Model, typename Adjoint, typename real>
CUDA_CALLABLE inline void rod_forces_adjoint(const Model& model, const Adjoint& adjoint, int w,
                                             const wp::array_t<real>& state, int row, real dt) {
    typedef typename several<real>::lanes T;
    const int n = model.points;
    const rows_of<real> s(state, row), rest(model.rest, w), k(model.stiffness, w), m(model.inertia, w),
        b(adjoint.state, w), by(adjoint.model, w), at(adjoint.scratch, w);
    const viscosity<real> visc(wp::index(model.damping, w), dt);
    const T c = T(visc.share), a = T(visc.follows), whole = T(real(1)) + c, left = T(real(1)) - a;
    for (EACH(i, n)) {
        const quat<T> q = s.template get4<T>(Q, i);
        const rod_edge<T> edge(s.template get3<T>(X, i + 1) - s.template get3<T>(X, i), q,
                               rest.template get<T>(PER_LENGTH, i), rest.template get3<T>(REST_E, i));
        const vec<T> late_e = edge.e - s.template get3<T>(LAG_E, i), C = k.template get3<T>(SHEAR, i);
        const vec<T> stress_e = edge.e + c * late_e, N = edge.force(C * stress_e);
        const vec<T> torque_bar = at.template get3<T>(TORQUE_BAR, i), g_bar = -torque_bar;
        const vec<T> A = at.template get3<T>(PULL_BAR, i) - at.template get3<T>(PULL_BAR, i + 1) +
                         cross(edge.d, g_bar);
        const vec<T> A_body = edge.R.to_body(A), lag_e_bar = b.template get3<T>(LAG_E_BAR, i);
        const vec<T> e_bar = whole * (C * A_body) + a * lag_e_bar;
        const vec<T> y = edge.per_length * edge.R.to_world(e_bar);
        at.put3(D_BAR, i, y + cross(g_bar, N) +
                              edge.per_length * (at.template get3<T>(ALONG_BAR, i) +
                                                 at.template get3<T>(ALONG_BAR, i + 1)));
        b.add3(Q_BAR, i, cross(N, A) + cross(y, edge.d));
        b.put3(LAG_E_BAR, i, left * lag_e_bar - c * (C * A_body));
        by.add3(SHEAR_BAR, i, A_body * stress_e);

        const quat<T> before = s.template get4<T>(Q, i - 1);
        const directors<T> R(before);
        const rod_joint<T> joint(before, q, rest.template get3<T>(REST_U, i));
        const vec<T> late_u = joint.u - s.template get3<T>(LAG_U, i);
        const vec<T> B = m.template get<T>(STIFFER, i) * k.template get3<T>(BENDING, i);
        const vec<T> stress_u = joint.u + c * late_u, moment = B * stress_u;
        const vec<T> L = at.template get3<T>(TORQUE_BAR, i - 1) - torque_bar, eta = R.to_body(L);
        const vec<T> su = joint.strain_of(eta), lag_u_bar = b.template get3<T>(LAG_U_BAR, i);
        const vec<T> u_bar = whole * (B * su) + a * lag_u_bar;
        at.put3(JOINT_H, i, R.to_world(joint.turn_gradient(u_bar) + joint.curving(moment, eta)));
        at.put3(JOINT_G, i, T(real(0.5)) * cross(R.to_world(joint.turn_gradient(moment)), L));
        b.put3(LAG_U_BAR, i, left * lag_u_bar - c * (B * su));
        by.add3(BENDING_BAR, i, su * stress_u);

        by.add(DAMPING_BAR, i,
               T(visc.share_slope) * (dot(A_body, C * late_e) + dot(su, B * late_u)) +
                   T(visc.follows_slope) * (dot(lag_e_bar, late_e) + dot(lag_u_bar, late_u)));
    }
}

// Second half: points and edges gather what edges and joints have for them.
template <typename Model, typename Adjoint>
CUDA_CALLABLE inline void rod_gather_adjoint(const Model& model, const Adjoint& adjoint, int w) {
    typedef decltype(Model::radius) real;
    typedef typename several<real>::lanes T;
    const rows_of<real> b(adjoint.state, w), at(adjoint.scratch, w);
    const int n = model.points;
    for (EACH(i, n)) {
        b.add3(X_BAR, i, at.template get3<T>(D_BAR, i - 1) - at.template get3<T>(D_BAR, i));
        b.add3(Q_BAR, i, at.template get3<T>(JOINT_H, i) + at.template get3<T>(JOINT_G, i) -
                             at.template get3<T>(JOINT_H, i + 1) + at.template get3<T>(JOINT_G, i + 1));
    }
}

}  // namespace gendom
