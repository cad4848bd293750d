// What a search for equilibria needs beside the steps: kinetic energy, rest, and forces that are not
// balanced. A search takes the same steps as motion does, without damping and air.
#pragma once

namespace gendom {

// Of what moves: rows of 1 / mass give it weight. Every thread finds the sum.
template <typename T, typename real>
CUDA_CALLABLE inline T moving(const rows_of<real>& s, const rows_of<real>& m, int v, int per, int i) {
    const T by = m.template get<T>(per, i), none = T(real(0));
    const vec<T> u = s.template get3<T>(v, i);
    return is_above(by, none) * dot(u, u) / larger(by, T(real(1e-30)));
}

template <typename Rod, typename real>
CUDA_CALLABLE inline real rod_kinetic(const Rod& rod, int w, const wp::array_t<real>& state, int row) {
    typedef typename several<real>::lanes T;
    const rows_of<real> s(state, row), m(rod.inertia, w);
    T sum = T(real(0));
    for (EACH(i, rod.points)) sum += moving<T>(s, m, V, PER_MASS, i) + moving<T>(s, m, W, PER_TURN, i);
    return sum_of_all(sum_of(sum));
}

template <typename Body, typename real>
CUDA_CALLABLE inline real shell_kinetic(const Body& body, int w, const wp::array_t<real>& state, int row) {
    typedef typename several<real>::lanes T;
    const rows_of<real> s(state, row), m(body.inertia, w);
    T sum = T(real(0));
    for (EACH_IN(p, body.first, body.end)) sum += moving<T>(s, m, SHELL_V, POINT_PER_MASS, p);
    return sum_of_all(sum_of(sum));
}

template <typename Rod, typename real>
CUDA_CALLABLE inline void rod_rest(const Rod& rod, int w, const wp::array_t<real>& state, int row) {
    typedef typename several<real>::lanes T;
    const rows_of<real> s(state, row);
    const vec<T> none = {T(real(0)), T(real(0)), T(real(0))};
    for (EACH(i, rod.points)) s.put3(V, i, none), s.put3(W, i, none);
}

template <typename Body, typename real>
CUDA_CALLABLE inline void shell_rest(const Body& body, int w, const wp::array_t<real>& state, int row) {
    typedef typename several<real>::lanes T;
    const rows_of<real> s(state, row);
    const vec<T> none = {T(real(0)), T(real(0)), T(real(0))};
    for (EACH_IN(p, body.first, body.end)) s.put3(SHELL_V, p, none);
}

// Where points are before a step from rest.
template <typename Body, typename real>
CUDA_CALLABLE inline void mark(const Body& body, int w, const wp::array_t<real>& state,
                               const wp::array_t<real>& marks) {
    typedef typename several<real>::lanes T;
    const rows_of<real> s(state, w), to(marks, w);
    for (EACH_IN(p, body.first, body.end)) to.put3(0, p, s.template get3<T>(0, p));
}

// Largest acceleration [m/s^2] with which points have left their marks in a step dt from rest with
// this kick: the force that nothing balances over a point's mass.
template <typename Body, typename real>
CUDA_CALLABLE inline real left_over(const Body& body, int w, const wp::array_t<real>& state,
                                    const wp::array_t<real>& marks, int per, real dt, real kick) {
    typedef typename several<real>::lanes T;
    const rows_of<real> s(state, w), from(marks, w), m(body.inertia, w);
    T worst = T(real(0));
    for (EACH_IN(p, body.first, body.end)) {
        const vec<T> d = s.template get3<T>(0, p) - from.template get3<T>(0, p);
        worst = larger(worst, dot(d, d) * is_above(m.template get<T>(per, p), T(real(0))));
    }
    return wp::sqrt(largest_of_all(largest_of(worst))) / (dt * kick);
}

// Of rods also the torque over the mass and length of an edge.
template <typename Rod, typename real>
CUDA_CALLABLE inline real rod_unbalanced(const Rod& rod, int w, const wp::array_t<real>& state,
                                         const wp::array_t<real>& marks, real dt, real kick) {
    const rows_of<real> s(state, w), m(rod.inertia, w), rest(rod.rest, 0);
    real worst = real(0);
    for (EACH_ONE(i, rod.points)) {
        const vec<real> spin = s.template get3<real>(W, i);
        const real per_turn = m.template get<real>(PER_TURN, i);
        if (per_turn <= real(0)) continue;
        const real by =
            m.template get<real>(PER_MASS, i) * rest.template get<real>(PER_LENGTH, i) / per_turn;
        worst = larger(worst, by * by * dot(spin, spin));
    }
    const real turned = wp::sqrt(largest_of_all(worst)) / kick;
    return larger(turned, left_over(rod, w, state, marks, PER_MASS, dt, kick));
}

template <typename Body, typename real>
CUDA_CALLABLE inline real shell_unbalanced(const Body& body, int w, const wp::array_t<real>& state,
                                           const wp::array_t<real>& marks, real dt, real kick) {
    return left_over(body, w, state, marks, POINT_PER_MASS, dt, kick);
}

// Elastic force [N] of each point and, of rods, torque [N m] of each edge, as the scratch has them.
template <typename Rod, typename real>
CUDA_CALLABLE inline void rod_elastic(const Rod& rod, int w, const wp::array_t<real>& forces, int row) {
    typedef typename several<real>::lanes T;
    const rows_of<real> in(rod.scratch, w), out(forces, row);
    for (EACH(i, rod.points)) {
        out.put3(0, i, in.template get3<T>(PULL, i) - in.template get3<T>(PULL, i - 1));
        out.put3(3, i, in.template get3<T>(MOMENT, i + 1) - in.template get3<T>(MOMENT, i) -
                           in.template get3<T>(TURN, i));
    }
}

template <typename Body, typename real>
CUDA_CALLABLE inline void shell_elastic(const Body& body, int w, const wp::array_t<real>& forces, int row) {
    typedef typename several<real>::lanes T;
    const rows_of<real> in(body.scratch, w), shape(body.rest, 0), out(forces, row);
    for (EACH_IN(p, body.first, body.end)) out.put3(0, p, shell_pull<T>(in, shape, p, body.pitch));
}

}  // namespace gendom
