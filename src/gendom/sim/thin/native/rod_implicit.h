// Implicit steps of a rod, solved by Newton's method. One thread a world.
//
// A step h has two stages of backward Euler of length T = (1 - sqrt(1/2)) h. A stage goes from a base b,
//
//     f(x) + m g + drag(v) - m (v - v_b) / T = 0,    v = (x - x_b) / T,
//
// the first one from the step's start, the second one from the start and (1 - T/h) / (T/h) times what the first
// one changed. It is of second order and L-stable: vibrations that a step does not resolve die out (Alexander
// (1977), "Diagonally implicit Runge-Kutta methods for stiff ODEs"). Directions turn by q = (t, 1) q_b / |.|, with
// the spin 2 t / T. The lagged strains of the standard linear solid follow by the same rule. Newton's matrix is
// block tridiagonal: six numbers a point, its place and the direction of the edge that begins there. What comes
// to touch the table or a wall ends its step there, in a single stage of length h.
#pragma once

namespace gendom {

// A point's three blocks of Newton's matrix. Rows are as long as registers are wide; the seventh column of its own
// block holds what is not balanced, and in the end that of the block after it the step.
template <typename real> struct block_row {
    real before[6][8], own[6][8], after[6][8], last[8];

    CUDA_CALLABLE inline real& rhs(int a) { return own[a][6]; }
    CUDA_CALLABLE inline real& step(int a) { return after[a][6]; }
};
static_assert(sizeof(block_row<double>) == 152 * sizeof(double), "BLOCK_ROW of implicit.py");

// Unit vectors side by side, from axis j on, and columns of a block that these have made.
template <typename T> CUDA_CALLABLE inline vec<T> axes(int j) {
    typedef typename number_of<T>::type real;
    vec<T> a = {T(real(0)), T(real(0)), T(real(0))};
    for (unsigned l = 0; l < sizeof(T) / sizeof(real) && j + l < 3; ++l)
        ((real*)(j + l == 0 ? &a.x : j + l == 1 ? &a.y : &a.z))[l] = real(1);
    return a;
}
template <typename T, typename real> CUDA_CALLABLE inline void put_row(real* row, const T& a) {
#if defined(__CUDA_ARCH__)
    *row += a;
#else
    T sum;
    __builtin_memcpy(&sum, row, sizeof(T));
    sum = sum + a;
    __builtin_memcpy(row, &sum, sizeof(T));
#endif
}
template <typename T, typename real>
CUDA_CALLABLE inline void put_columns(real block[6][8], int row, int column, const vec<T>& a) {
    put_row(block[row] + column, a.x), put_row(block[row + 1] + column, a.y), put_row(block[row + 2] + column, a.z);
}
template <typename T, typename real> CUDA_CALLABLE inline vec<T> spread(const vec<real>& a) {
    return {T(a.x), T(a.y), T(a.z)};
}
template <typename T, typename real> CUDA_CALLABLE inline quat<T> spread(const quat<real>& q) {
    return {spread<T>(q.v), T(q.w)};
}
template <typename T> CUDA_CALLABLE inline vec<typename number_of<T>::type> first_of(const vec<T>& a) {
    typedef typename number_of<T>::type real;
    return {*(const real*)&a.x, *(const real*)&a.y, *(const real*)&a.z};
}
template <typename real> CUDA_CALLABLE inline real part(const vec<real>& a, int k) {
    return k == 0 ? a.x : k == 1 ? a.y : a.z;
}
// Eight numbers of a row, less so many of another one.
template <typename real> CUDA_CALLABLE inline void take(real* from, real by, const real* row) {
    for (int b = 0; b < 8; ++b) from[b] -= by * row[b];
}

// How a point touches what surrounds it.
template <typename real> struct touching {
    real side[3];  // -1: at the table or a lower wall, 1: at an upper wall, 0: free
    real press;   // on the table, as of the last iteration [N]
};
static_assert(sizeof(touching<double>) == 4 * sizeof(double), "TOUCHING of implicit.py");

// Speed below which friction yields in proportion [m/s].
constexpr double STILL = 1e-5;
// Length of a step, as `far` tells it, from which on friction's whole derivative is taken.
constexpr double NEAR = 1e-2;

// The turn t of a direction from q0 to q, see above, and a quaternion of length 1.
template <typename real> CUDA_CALLABLE inline vec<real> turn_from(const quat<real>& q0, const quat<real>& q) {
    const quat<real> p = q * quat<real>{-q0.v, q0.w};
    return real(1) / p.w * p.v;
}
template <typename real> CUDA_CALLABLE inline quat<real> unit_of(const quat<real>& q) {
    const real per = real(1) / wp::sqrt(dot(q.v, q.v) + q.w * q.w);
    return {per * q.v, per * q.w};
}

template <typename Rod, typename real> struct implicit_step {
    const Rod& rod;
    const int w, n;
    const real span, per;  // T and 1 / T
    const rows_of<real> s, to, rest, k, m;  // s: the base; to: the end of the stage, as far as it is known
    block_row<real>* rows;
    touching<real>* touch;
    real c, follows;  // viscous stiffness over the elastic, and how far lagged strains go on

    CUDA_CALLABLE inline implicit_step(const Rod& rod, int w, const wp::array_t<real>& base,
                                       const wp::array_t<real>& ahead, const wp::array_t<real>& work,
                                       const wp::array_t<real>& touches, real span)
        : rod(rod), w(w), n(rod.points), span(span), per(real(1) / span), s(base, w), to(ahead, w),
          rest(rod.rest, 0), k(rod.stiffness, w), m(rod.inertia, w),
          rows((block_row<real>*)&wp::index(work, w, 0, 0)),
          touch((touching<real>*)&wp::index(touches, w, 0, 0)) {
        const viscosity<real> visc(wp::index(rod.damping, w), span, true);
        c = visc.share, follows = visc.follows;
    }

    CUDA_CALLABLE inline bool held(int i, int what) const {
        for (int g = 0; g < rod.holds.shape[1]; ++g)
            if (wp::index(rod.holds, w, g, i) & what) return true;
        return false;
    }

    // Where points and directions come from the base with the velocities that they have ahead.
    CUDA_CALLABLE inline void begin() const {
        for (int i = 0; i < n; ++i) {
            to.put3(X, i, s.template get3<real>(X, i) + span * to.template get3<real>(V, i));
            const quat<real> turn = {real(0.5) * span * to.template get3<real>(W, i), real(1)};
            to.put4(Q, i, unit_of(turn * s.template get4<real>(Q, i)));
        }
    }
    CUDA_CALLABLE inline vec<real> half_turn(int i) const {
        return turn_from(s.template get4<real>(Q, i), to.template get4<real>(Q, i));
    }

    // ---- forces and their derivatives -----------------------------------------------------------

    // A joint or an edge, once in each lane.
    template <typename T> CUDA_CALLABLE inline rod_edge<T> edge(int i) const {
        return {spread<T>(to.template get3<real>(X, i + 1) - to.template get3<real>(X, i)),
                spread<T>(to.template get4<real>(Q, i)), T(rest.template get<real>(PER_LENGTH, i)),
                spread<T>(rest.template get3<real>(REST_E, i))};
    }
    template <typename T> CUDA_CALLABLE inline rod_joint<T> joint(int i) const {
        return {spread<T>(to.template get4<real>(Q, i - 1)), spread<T>(to.template get4<real>(Q, i)),
                spread<T>(rest.template get3<real>(REST_U, i))};
    }
    typedef typename several<real>::lanes T;
    enum { WIDTH = sizeof(T) / sizeof(real) };

    CUDA_CALLABLE inline void add_edge(int i) const {
        const rod_edge<T> e = edge<T>(i);
        const vec<T> C = spread<T>(k.template get3<real>(SHEAR, i)), D = T(real(1) + c) * C;
        const vec<T> lag = spread<T>(s.template get3<real>(LAG_E, i));
        const vec<T> N = e.force(C * (e.e + T(c) * (e.e - lag)));
        block_row<real>&a = rows[i], &b = rows[i + 1];
        const vec<real> pull = first_of(N);
        add_rhs(a, 0, pull), add_rhs(b, 0, -pull), add_rhs(a, 3, -first_of(e.turn_gradient(N)));
        for (int j = 0; j < 3; j += WIDTH) {
            const vec<T> one = axes<T>(j);
            const vec<T> dN = e.R.to_world(D * (e.per_length * e.R.to_body(one)));
            const vec<T> dT = cross(dN, e.d) + cross(N, one);
            put_columns(a.own, 0, j, -dN), put_columns(a.after, 0, j, dN);
            put_columns(b.before, 0, j, dN), put_columns(b.own, 0, j, -dN);
            put_columns(a.own, 3, j, dT), put_columns(a.after, 3, j, -dT);
            const vec<T> turned = e.per_length * e.R.to_body(cross(e.d, one));
            const vec<T> tN = cross(one, N) + e.R.to_world(D * turned);
            put_columns(a.own, 0, 3 + j, tN), put_columns(b.before, 0, 3 + j, -tN);
            put_columns(a.own, 3, 3 + j, -cross(tN, e.d));
        }
    }

    CUDA_CALLABLE inline void add_joint(int i) const {
        const rod_joint<T> u = joint<T>(i);
        const directors<T> R(spread<T>(to.template get4<real>(Q, i - 1)));
        const vec<T> B = T(m.template get<real>(STIFFER, i)) * spread<T>(k.template get3<real>(BENDING, i));
        const vec<T> lag = spread<T>(s.template get3<real>(LAG_U, i));
        const vec<T> moment = B * (u.u + T(c) * (u.u - lag));
        const vec<T> g = u.turn_gradient(moment), M = R.to_world(g);
        block_row<real>&a = rows[i - 1], &b = rows[i];
        add_rhs(a, 3, first_of(M)), add_rhs(b, 3, -first_of(M));
        const T half = T(real(0.5)), whole = T(real(1) + c);
        for (int j = 0; j < 3; j += WIDTH) {
            const vec<T> one = axes<T>(j), eta = R.to_body(one);
            const vec<T> dM = R.to_world(u.turn_gradient(whole * (B * u.strain_of(eta))) +
                                         u.curving(moment, eta) - half * cross(g, eta));
            const vec<T> by_before = cross(one, M) - dM;
            put_columns(a.after, 3, 3 + j, dM), put_columns(b.own, 3, 3 + j, -dM);
            put_columns(a.own, 3, 3 + j, by_before), put_columns(b.before, 3, 3 + j, -by_before);
        }
    }
    CUDA_CALLABLE inline void add_rhs(block_row<real>& row, int at, const vec<real>& f) const {
        row.rhs(at) += f.x, row.rhs(at + 1) += f.y, row.rhs(at + 2) += f.z;
    }

    // 1 / length of the edges before and after a point, 0 where there is none.
    CUDA_CALLABLE inline real length_before(int i) const {
        return i > 0 ? rest.template get<real>(PER_LENGTH, i - 1) : real(0);
    }
    CUDA_CALLABLE inline real length_after(int i) const {
        return i + 1 < n ? rest.template get<real>(PER_LENGTH, i) : real(0);
    }
    CUDA_CALLABLE inline vec<real> along_at(int i) const {
        const vec<real> x = to.template get3<real>(X, i);
        return length_before(i) * (x - to.template get3<real>(X, i - 1)) +
               length_after(i) * (to.template get3<real>(X, i + 1) - x);
    }
    // Derivative of `across` by how the rod goes.
    CUDA_CALLABLE inline vec<T> turned_across(const vec<T>& v, const vec<T>& along, const vec<T>& by) const {
        const T per_square = T(real(1)) / larger(dot(along, along), T(real(1e-12))), va = dot(v, along);
        return (-per_square) * (dot(v, by) * along + va * by) +
               (T(real(2)) * per_square * per_square * va * dot(along, by)) * along;
    }

    CUDA_CALLABLE inline void add_point(int i, const vec<real>& gravity, real decay) const {
        block_row<real>& row = rows[i];
        const real per_mass = m.template get<real>(PER_MASS, i), per_turn = m.template get<real>(PER_TURN, i);
        const real mass = real(1) / per_mass;
        const vec<real> v = per * (to.template get3<real>(X, i) - s.template get3<real>(X, i));
        const vec<real> along = along_at(i), vn = across(v, along);
        const real speed = wp::sqrt(dot(vn, vn)), drag = m.template get<real>(DRAG, i);
        add_rhs(row, 0, mass * gravity - drag * speed * vn - (decay * mass) * v -
                            (mass * per) * (v - s.template get3<real>(V, i)));
        const T inert = T(per * mass * (per + decay)), least = T(real(1e-12));
        const T fast = T(speed), dragged = T(per * drag), per_speed = T(real(1)) / larger(fast, least);
        const real last = length_before(i), next = length_after(i);
        const vec<T> vs = spread<T>(v), vns = spread<T>(vn), a = spread<T>(along);
        for (int j = 0; j < 3; j += WIDTH) {
            const vec<T> one = axes<T>(j);
            const vec<T> by = fast * across(one, a) + (dot(vns, one) * per_speed) * vns;
            put_columns(row.own, 0, j, -inert * one - dragged * by);
            // what turns of the rod change of the drag
            const vec<T> dn = turned_across(vs, a, one);
            const vec<T> turned = T(-drag) * (fast * dn + (dot(vns, dn) * per_speed) * vns);
            put_columns(row.before, 0, j, T(-last) * turned);
            put_columns(row.own, 0, j, T(last - next) * turned);
            put_columns(row.after, 0, j, T(next) * turned);
        }
        if (per_turn <= real(0)) return;
        const real turning = real(1) / per_turn;
        const vec<real> t = half_turn(i), spin = (per + per) * t;
        add_rhs(row, 3, -(decay * turning) * spin -
                            (turning * per) * (spin - s.template get3<real>(W, i)));
        const T of_turn = T(per * turning * (per + decay));
        const vec<T> ts = spread<T>(t);
        for (int j = 0; j < 3; j += WIDTH) {
            const vec<T> one = axes<T>(j);
            put_columns(row.own, 3, 3 + j, -of_turn * (one + cross(one, ts) + dot(one, ts) * ts));
        }
    }

    // ---- what the rod touches -------------------------------------------------------------------

    // Where component j of a point stands at a side.
    CUDA_CALLABLE inline real stop(int j, int side) const {
        const real lower = rod.walls ? part(wall(rod.box_lower), j) + rod.radius : real(-1e30);
        const real upper = rod.walls ? part(wall(rod.box_upper), j) - rod.radius : real(1e30);
        const real least = rod.table && j == 2 ? larger(lower, real(rod.radius)) : lower;
        return side < 0 ? least : upper;
    }
    template <typename V3> CUDA_CALLABLE inline vec<real> wall(const V3& a) const { return {a[0], a[1], a[2]}; }

    // Decides what a free point touches, from where it is and the force f on it; tells whether that changed.
    CUDA_CALLABLE inline bool decide(int i, const vec<real>& f) const {
        touching<real>& t = touch[i];
        const vec<real> x = to.template get3<real>(X, i);
        bool changed = false;
        for (int j = 0; j < 3; ++j) {
            const real was = t.side[j];
            if (was * part(f, j) < real(0)) t.side[j] = real(0);  // it is pulled away
            for (int side = -1; side <= 1 && was == real(0) && t.side[j] == real(0); side += 2)
                if (real(side) * (part(x, j) - stop(j, side)) > real(0)) t.side[j] = real(side);
            changed = changed || t.side[j] != was;
        }
        t.press = rod.table && t.side[2] < real(0) ? larger(-f.z, real(0)) : real(0);
        return changed;
    }

    // Friction over mu N, from how far a point has slid, and its derivative by that; returns how far that is, or
    // the least that counts.
    CUDA_CALLABLE inline real friction(int i, real way[2], real by[2][2]) const {
        const vec<real> d = to.template get3<real>(X, i) - s.template get3<real>(X, i);
        const real size = wp::sqrt(d.x * d.x + d.y * d.y), still = real(STILL) * span;
        const real least = larger(size, still), turns = size > still ? real(1) : real(0);
        way[0] = d.x / least, way[1] = d.y / least;
        for (int a = 0; a < 2; ++a)
            for (int b = 0; b < 2; ++b) by[a][b] = (real(a == b) - turns * way[a] * way[b]) / least;
        return least;
    }

    // Puts what holds point i in its equations: friction on the table, and in place of those across what it
    // touches the way there. If `exact` with the whole derivative of friction, else with that of mu N v / |v| at
    // an N and |v| that stay, which converges from far.
    CUDA_CALLABLE inline void support(int i, real mu, bool exact) const {
        block_row<real>& row = rows[i];
        const touching<real>& t = touch[i];
        const vec<real> x = to.template get3<real>(X, i);
        if (t.press > real(0)) {
            real way[2], by[2][2];
            const real least = friction(i, way, by);
            for (int a = 0; a < 2; ++a) {
                row.rhs(a) -= mu * t.press * way[a];
                if (!exact) {
                    row.own[a][a] -= mu * t.press / least;
                    continue;
                }
                for (int b = 0; b < 6; ++b) {
                    row.before[a][b] += mu * way[a] * row.before[2][b];
                    row.own[a][b] += mu * way[a] * row.own[2][b];
                    row.after[a][b] += mu * way[a] * row.after[2][b];
                }
                for (int b = 0; b < 2; ++b) row.own[a][b] -= mu * t.press * by[a][b];
            }
        }
        for (int j = 0; j < 3; ++j)
            if (t.side[j] != real(0)) fix(row, j, stop(j, t.side[j] < real(0) ? -1 : 1) - part(x, j));
    }
    // Component a of a row goes on by so much.
    CUDA_CALLABLE inline void fix(block_row<real>& row, int a, real by) const {
        for (int b = 0; b < 6; ++b) row.before[a][b] = row.own[a][b] = row.after[a][b] = real(0);
        row.own[a][a] = real(1), row.rhs(a) = -by;
    }

    // ---- Newton's method ------------------------------------------------------------------------

    // Sets up the equations where the stage's end is thought to be; tells whether what the rod touches has changed.
    CUDA_CALLABLE inline bool set_up(bool exact, bool decides = true) const {
        for (int i = 0; i < n; ++i) clear(rows[i]);
        for (int i = 0; i + 1 < n; ++i) add_edge(i);
        for (int i = 1; i + 1 < n; ++i) add_joint(i);
        const vec<real> g = gravity_of<real>(rod, w);
        const real decay = wp::index(rod.velocity_damping, w), mu = wp::index(rod.friction, w);
        bool changed = false;
        for (int i = 0; i < n; ++i) {
            block_row<real>& row = rows[i];
            add_point(i, g, decay);
            if (held(i, 1)) {
                for (int a = 0; a < 3; ++a) fix(row, a, real(0));
            } else {
                if (decides) changed = decide(i, vec<real>{row.rhs(0), row.rhs(1), row.rhs(2)}) || changed;
                else if (touch[i].press > real(0)) touch[i].press = -row.rhs(2);
                support(i, mu, exact);
            }
            if (i + 1 == n || held(i, 2))
                for (int a = 3; a < 6; ++a) fix(row, a, real(0));
        }
        return changed;
    }
    CUDA_CALLABLE inline void clear(block_row<real>& row) const {
        for (int a = 0; a < 6; ++a)
            for (int b = 0; b < 8; ++b) row.before[a][b] = row.own[a][b] = row.after[a][b] = real(0);
    }

    // Solves for the step: blocks are eliminated from the first on (Thomas's algorithm).
    CUDA_CALLABLE inline bool solve() const {
        for (int i = 0; i < n; ++i) {
            block_row<real>& row = rows[i];
            for (int a = 0; a < 6; ++a) row.rhs(a) = -row.rhs(a);
            for (int a = 0; a < 6 && i > 0; ++a)
                for (int j = 0; j < 6; ++j) take(row.own[a], row.before[a][j], rows[i - 1].after[j]);
            if (!eliminate(row)) return false;
        }
        for (int i = n - 2; i >= 0; --i)
            for (int a = 0; a < 6; ++a)
                for (int j = 0; j < 6; ++j) rows[i].step(a) -= rows[i].after[a][j] * rows[i + 1].step(j);
        return true;
    }
    // Multiplies a row by the inverse of its own block (Gauss and Jordan, with pivots).
    CUDA_CALLABLE inline bool eliminate(block_row<real>& row) const {
        for (int p = 0; p < 6; ++p) {
            int best = p;
            for (int a = p + 1; a < 6; ++a)
                if (wp::abs(row.own[a][p]) > wp::abs(row.own[best][p])) best = a;
            const real pivot = row.own[best][p];
            if (!(wp::abs(pivot) > real(0))) return false;
            for (int b = 0; b < 8 && best != p; ++b)
                exchange(row.own[best][b], row.own[p][b]), exchange(row.after[best][b], row.after[p][b]);
            const real per = real(1) / pivot;
            for (int b = 0; b < 8; ++b) row.own[p][b] *= per, row.after[p][b] *= per;
            for (int a = 0; a < 6; ++a) {
                if (a == p) continue;
                const real by = row.own[a][p];
                take(row.own[a], by, row.own[p]), take(row.after[a], by, row.after[p]);
            }
        }
        for (int a = 0; a < 6; ++a) row.step(a) = row.own[a][6];
        return true;
    }
    CUDA_CALLABLE inline void exchange(real& a, real& b) const {
        const real c = a;
        a = b, b = c;
    }

    // How far the step goes, over what moves a rod by much.
    CUDA_CALLABLE inline real far() const {
        real most = real(0);
        for (int i = 0; i < n; ++i) {
            const real per = rest.template get<real>(PER_LENGTH, i + 1 < n ? i : i - 1);
            for (int a = 0; a < 3; ++a) {
                most = larger(most, per * wp::abs(rows[i].step(a)) / real(0.3));
                most = larger(most, wp::abs(rows[i].step(3 + a)) / real(0.5));
            }
        }
        return most;
    }
    CUDA_CALLABLE inline void go(real share) const {
        for (int i = 0; i < n; ++i) {
            const real* d = rows[i].last;
            to.add3(X, i, vec<real>{share * d[0], share * d[1], share * d[2]});
            const vec<real> turn = {real(0.5) * share * d[3], real(0.5) * share * d[4], real(0.5) * share * d[5]};
            to.put4(Q, i, unit_of(quat<real>{turn, real(1)} * to.template get4<real>(Q, i)));
        }
    }

    // Finds the end of a stage; returns how many systems that took, -1 if it is not found. A step is halved
    // where the next one would be twice as long (Deuflhard (2004), "Newton methods for nonlinear problems", 3.3):
    // what is not balanced says little in stiff rods, which every turn stretches.
    CUDA_CALLABLE inline int find() const {
        real last = real(1e30), share = real(0);
        int halved = 0;
        bool exact = true;
        for (int turn = 1; turn <= 40; ++turn) {
            const bool changed = set_up(exact && last < real(NEAR));
            if (!solve()) return -1;
            const real most = far();
            if (!(most < real(1e6))) return -1;
            if (most > real(2) * last && halved < 4) {
                share *= real(0.5), ++halved;
                exact = false;
                go(-share);
                continue;
            }
            halved = 0, last = changed ? real(1e30) : most, share = most > real(1) ? real(1) / most : real(1);
            for (int i = 0; i < n; ++i)
                for (int a = 0; a < 6; ++a) rows[i].last[a] = rows[i].step(a);
            go(share);
            if (!changed && most < real(1e-5)) return turn;
        }
        return -1;
    }

    // Velocities, spins and lagged strains at the stage's end. Tells whether a point has come to touch something.
    CUDA_CALLABLE inline int finish() const {
        int landed = 0;
        for (int i = 0; i < n; ++i) {
            const touching<real>& t = touch[i];
            const vec<real> x0 = s.template get3<real>(X, i), x = to.template get3<real>(X, i);
            vec<real> v = per * (x - x0);
            const bool is_held = held(i, 1);
            for (int j = 0; j < 3 && !is_held; ++j)
                if (t.side[j] * (part(x, j) - part(x0, j)) > real(1e-9)) landed = 1;
            if (t.side[0] != real(0)) v.x = real(0);
            if (t.side[1] != real(0)) v.y = real(0);
            if (t.side[2] != real(0)) v.z = real(0);
            to.put3(V, i, v);
            if (i + 1 == n) break;
            to.put3(W, i, (per + per) * half_turn(i));
            const vec<real> lag_e = s.template get3<real>(LAG_E, i), lag_u = s.template get3<real>(LAG_U, i);
            to.put3(LAG_E, i, lag_e + follows * (edge<real>(i).e - lag_e));
            if (i > 0) to.put3(LAG_U, i, lag_u + follows * (joint<real>(i).u - lag_u));
        }
        return landed;
    }

    // Puts the base of the second stage `further` times what the first one changed on from the start.
    CUDA_CALLABLE inline void go_on(const rows_of<real>& start, real further) const {
        for (int i = 0; i < n; ++i) {
            const auto on = [&](int c) {
                const vec<real> a = start.template get3<real>(c, i);
                s.put3(c, i, a + further * (to.template get3<real>(c, i) - a));
            };
            const quat<real> q0 = start.template get4<real>(Q, i);
            const vec<real> turn = further * turn_from(q0, to.template get4<real>(Q, i));
            s.put4(Q, i, unit_of(quat<real>{turn, real(1)} * q0));
            on(X), on(V), on(W), on(LAG_E), on(LAG_U);
        }
    }
    CUDA_CALLABLE inline real stretched() const {
        real worst = real(0);
        for (int i = 0; i + 1 < n; ++i) {
            const rod_edge<real> e = edge<real>(i);
            worst = larger(worst, e.e.z * e.e.z);
        }
        return worst;
    }
};

// For kernels, which have no objects.
template <typename Rod, typename real>
CUDA_CALLABLE inline void stage_begin(const Rod& rod, int w, const wp::array_t<real>& base, const wp::array_t<real>& ahead,
                                      const wp::array_t<real>& work, const wp::array_t<real>& touches, real span) {
    implicit_step<Rod, real>(rod, w, base, ahead, work, touches, span).begin();
}
template <typename Rod, typename real>
CUDA_CALLABLE inline int stage_find(const Rod& rod, int w, const wp::array_t<real>& base, const wp::array_t<real>& ahead,
                                    const wp::array_t<real>& work, const wp::array_t<real>& touches, real span) {
    return implicit_step<Rod, real>(rod, w, base, ahead, work, touches, span).find();
}
template <typename Rod, typename real>
CUDA_CALLABLE inline int stage_finish(const Rod& rod, int w, const wp::array_t<real>& base, const wp::array_t<real>& ahead,
                                      const wp::array_t<real>& work, const wp::array_t<real>& touches, real span) {
    return implicit_step<Rod, real>(rod, w, base, ahead, work, touches, span).finish();
}
template <typename Rod, typename real>
CUDA_CALLABLE inline void stage_go_on(const Rod& rod, int w, const wp::array_t<real>& state, const wp::array_t<real>& base,
                                      const wp::array_t<real>& ahead, const wp::array_t<real>& work,
                                      const wp::array_t<real>& touches, real further) {
    implicit_step<Rod, real>(rod, w, base, ahead, work, touches, real(1)).go_on(rows_of<real>(state, w), further);
}
template <typename Rod, typename real>
CUDA_CALLABLE inline real stage_stretch(const Rod& rod, int w, const wp::array_t<real>& ahead, const wp::array_t<real>& work,
                                        const wp::array_t<real>& touches) {
    return implicit_step<Rod, real>(rod, w, ahead, ahead, work, touches, real(1)).stretched();
}

}  // namespace gendom
