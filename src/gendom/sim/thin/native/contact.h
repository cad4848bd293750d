// A thin body's contact with itself, at its true thickness, with Coulomb friction.
//
// Edges meet edges, and of shells points meet triangles: the two of a cell, on either side of its
// diagonal b c. What is nearer than the thickness after a step is pushed apart by impulses at the two
// nearest places: they take away the speed of approach; what is still too near is moved apart without
// speed. Friction takes what slides, at most by its coefficient times what was pushed. Pairs that may
// meet are listed with a margin, and listed anew once a point has moved by half of that; the list
// depends on nothing but where points were then. Of the list, a step's turns go over those that are close
// when they begin. Nearest places: Ericson (2005), "Real-Time Collision
// Detection", chapter 5.
#pragma once

namespace gendom {

// Up to four points and their shares in the distance between two places, positive on the first.
template <typename real> struct meeting {
    int point[4];
    real share[4];
    vec<real> away;
    real distance;
};

template <typename real> CUDA_CALLABLE inline real within(real a) {
    return a < real(0) ? real(0) : a > real(1) ? real(1) : a;
}

// Between edges from points p to p2 and q to q2.
template <typename real>
CUDA_CALLABLE inline meeting<real> edges_meet(const rows_of<real>& s, int p, int p2, int q, int q2) {
    const vec<real> a = s.template get3<real>(0, p), c = s.template get3<real>(0, q);
    const vec<real> u = s.template get3<real>(0, p2) - a, v = s.template get3<real>(0, q2) - c;
    const vec<real> r = a - c;
    const real uu = dot(u, u), vv = dot(v, v), uv = dot(u, v), ur = dot(u, r), vr = dot(v, r);
    const real square = uu * vv - uv * uv;
    real f = square > real(1e-6) * uu * vv ? within((uv * vr - ur * vv) / square) : real(0.5);
    real g = (uv * f + vr) / vv;
    if (g < real(0)) {
        g = real(0), f = within(-ur / uu);
    } else if (g > real(1)) {
        g = real(1), f = within((uv - ur) / uu);
    }
    const vec<real> away = r + f * u - g * v;
    return {{p, p2, q, q2}, {real(1) - f, f, g - real(1), -g}, away, wp::sqrt(dot(away, away))};
}

// Between point p and the triangle of points a, b, c.
template <typename real>
CUDA_CALLABLE inline meeting<real> point_meets(const rows_of<real>& s, int p, int ia, int ib, int ic) {
    const vec<real> x = s.template get3<real>(0, p), a = s.template get3<real>(0, ia);
    const vec<real> ab = s.template get3<real>(0, ib) - a, ac = s.template get3<real>(0, ic) - a;
    const vec<real> ap = x - a, bp = ap - ab, cp = ap - ac;
    const real d1 = dot(ab, ap), d2 = dot(ac, ap), d3 = dot(ab, bp), d4 = dot(ac, bp);
    const real d5 = dot(ab, cp), d6 = dot(ac, cp);
    const real va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
    real v, w;
    if (d1 <= real(0) && d2 <= real(0)) v = w = real(0);
    else if (d3 >= real(0) && d4 <= d3) v = real(1), w = real(0);
    else if (d6 >= real(0) && d5 <= d6) v = real(0), w = real(1);
    else if (vc <= real(0) && d1 >= real(0) && d3 <= real(0)) v = d1 / (d1 - d3), w = real(0);
    else if (vb <= real(0) && d2 >= real(0) && d6 <= real(0)) v = real(0), w = d2 / (d2 - d6);
    else if (va <= real(0) && d4 - d3 >= real(0) && d5 - d6 >= real(0))
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6)), v = real(1) - w;
    else v = vb / (va + vb + vc), w = vc / (va + vb + vc);
    const vec<real> away = ap - v * ab - w * ac;
    return {{p, ia, ib, ic}, {real(1), v + w - real(1), -v, -w}, away, wp::sqrt(dot(away, away))};
}

// The pair that two numbers of the list stand for; each is a point times 4 and a kind: an edge to the
// next point, to the one below, or a cell's diagonal; or 3: the point itself, against one of two
// triangles of the other number's cell.
template <typename real>
CUDA_CALLABLE inline meeting<real> pair_meets(const rows_of<real>& s, int one, int other, int pitch) {
    const int p = one / 4, a = one % 4, q = other / 4, b = other % 4;
    if (a == 3) {
        return b == 0 ? point_meets(s, p, q, q + 1, q + pitch)
                      : point_meets(s, p, q + pitch + 1, q + 1, q + pitch);
    }
    const auto from = [&](int i, int kind) { return kind == 2 ? i + 1 : i; };
    const auto to = [&](int i, int kind) { return kind == 0 ? i + 1 : i + pitch; };
    return edges_meet(s, from(p, a), to(p, a), from(q, b), to(q, b));
}

// Adds a pair to a world's list; a full one only counts on.
CUDA_CALLABLE inline void append(const wp::array_t<int>& pairs, const wp::array_t<int>& count, int w,
                                 int one, int other) {
#if defined(__CUDA_ARCH__)
    const int at = atomicAdd(&wp::index(count, w), 1);
#else
    const int at = wp::index(count, w)++;
#endif
    if (at < pairs.shape[1]) {
        wp::index(pairs, w, at, 0) = one;
        wp::index(pairs, w, at, 1) = other;
    }
}

template <typename Body, typename real>
CUDA_CALLABLE inline void list_pair(const Body& body, int w, const rows_of<real>& s, int one, int other) {
    const meeting<real> m = pair_meets(s, one, other, body.pitch);
    const int* i = m.point;
    const int own = one % 4 == 3 ? 1 : 2;  // points of the first feature; the rest are the second's
    for (int a = 0; a < own; ++a)
        for (int b = own; b < 4; ++b)
            if (i[a] == i[b]) return;
    if (m.distance >= body.contact_distance + body.contact_margin) return;
    append(body.near, body.near_count, w, one, other);
}

// Whether a point of rows c to c + 2 is farther than this from where it was when pairs were listed.
template <typename Body, typename real>
CUDA_CALLABLE inline int moved_on(const Body& body, int w, const wp::array_t<real>& state, int row, int c,
                                  real far) {
    typedef typename several<real>::lanes T;
    const rows_of<real> s(state, row), then(body.listed, w), m(body.inertia, w);
    T most = T(real(0));
    for (EACH_IN(p, body.first, body.end)) {
        const vec<T> d = s.template get3<T>(c, p) - then.template get3<T>(0, p);
        most = larger(most, dot(d, d) * is_above(m.template get<T>(0, p), T(real(0))));
    }
    return largest_of(most) <= far * far ? 0 : 1;
}

// Begins a list of points in rows c to c + 2; the threads meet before `list_pairs`.
template <typename Body, typename real>
CUDA_CALLABLE inline void begin_list(const Body& body, int w, const wp::array_t<real>& state, int row,
                                     int c) {
    typedef typename several<real>::lanes T;
    const rows_of<real> s(state, row), then(body.listed, w);
    for (EACH_IN(p, body.first, body.end)) then.put3(0, p, s.template get3<T>(c, p));
    wp::index(body.near_count, w) = 0;
}

// All features of two points of a shell.
template <typename Body, typename real>
CUDA_CALLABLE inline void list_features(const Body& body, int w, const rows_of<real>& s,
                                        const rows_of<real>& rest, int p, int q) {
    const auto has = [&](int i, int kind) { return rest.template get<real>(kind, i) > real(0); };
    for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 3; ++b)
            if (has(p, a) && has(q, b)) list_pair(body, w, s, 4 * p + a, 4 * q + b);
    for (int b = 0; b < 2; ++b) {
        if (has(q, 2)) list_pair(body, w, s, 4 * p + 3, 4 * q + b);
        if (has(p, 2)) list_pair(body, w, s, 4 * q + 3, 4 * p + b);
    }
}

// Whether corners of two neighbouring cells are much nearer than at rest; only there neighbours meet.
template <typename Body, typename real>
CUDA_CALLABLE inline bool is_folded(const Body& body, const rows_of<real>& s, int p, int q, int columns,
                                    int rows) {
    const real lx2 = real(0.64) / (body.per_x * body.per_x), ly2 = real(0.64) / (body.per_y * body.per_y);
    for (int a = 0; a < 4; ++a) {
        const vec<real> x = s.template get3<real>(0, p + a % 2 + a / 2 * body.pitch);
        for (int b = 0; b < 4; ++b) {
            const int along = columns + a % 2 - b % 2, across = rows + a / 2 - b / 2;
            const vec<real> d = s.template get3<real>(0, q + b % 2 + b / 2 * body.pitch) - x;
            if (dot(d, d) < real(along * along) * lx2 + real(across * across) * ly2) return true;
        }
    }
    return false;
}

template <typename Body> CUDA_CALLABLE inline void begin_close(const Body& body, int w) {
    wp::index(body.close_count, w) = 0;
}

// The listed pairs that are close; `begin_close` and a meeting of the threads come before.
template <typename Body, typename real>
CUDA_CALLABLE inline void list_close(const Body& body, int w, const wp::array_t<real>& state, int row) {
    const rows_of<real> s(state, row);
    const int count = wp::min(wp::index(body.near_count, w), body.near.shape[1]);
    for (EACH_ONE_IN(k, 0, count)) {
        const int one = wp::index(body.near, w, k, 0), other = wp::index(body.near, w, k, 1);
        if (pair_meets(s, one, other, body.pitch).distance < body.contact_close)
            append(body.close, body.close_count, w, one, other);
    }
}

// Points whose features may meet are at most so far apart; a rod's neighbours never meet.
template <typename Body> CUDA_CALLABLE inline void list_pairs(const Body& body, int w) {
    typedef decltype(Body::radius) real;
    typedef typename several<real>::lanes T;
    const rows_of<real> s(body.listed, w), rest(body.rest, 0), m(body.inertia, w);
    const int width = sizeof(T) / sizeof(real), pitch = body.pitch, apart = body.contact_apart;
    const T reach = T(body.contact_reach * body.contact_reach);
    const auto is_point = [&](int i) { return m.template get<real>(0, i) > real(0); };
    for (EACH_ONE_IN(p, body.first, body.end)) {
        if (!is_point(p)) continue;
        const vec<real> xp = s.template get3<real>(0, p);
        if (pitch > 0 && rest.template get<real>(2, p) > real(0)) {  // a cell folded on its diagonal
            const vec<real> across = s.template get3<real>(0, p + pitch + 1) - xp;
            const real whole = real(1) / (body.per_x * body.per_x) + real(1) / (body.per_y * body.per_y);
            if (dot(across, across) < real(0.64) * whole) list_pair(body, w, s, 4 * p + 3, 4 * p + 1);
        }
        const vec<T> x = {T(xp.x), T(xp.y), T(xp.z)};
        for (int q0 = p / width * width; q0 < body.end; q0 += width) {
            const vec<T> d = s.template get3<T>(0, q0) - x;
            const T square = dot(d, d), is_near = is_above(reach, square);
            for (int l = 0; l < width; ++l) {
                const int q = q0 + l;
                if (((const real*)&is_near)[l] == real(0) || q <= p || !is_point(q)) continue;
                if (pitch == 0) {  // a rod
                    if (q - p >= apart && is_point(p + 1) && is_point(q + 1))
                        list_pair(body, w, s, 4 * p, 4 * q);
                    continue;
                }
                const int columns = p % pitch - q % pitch, rows = p / pitch - q / pitch;
                if (columns <= 2 && columns >= -2 && rows >= -2 &&
                    !is_folded(body, s, p, q, columns, rows))
                    continue;
                list_features(body, w, s, rest, p, q);
            }
        }
    }
}

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

// Whether contacts are taken all at once (Jacobi), as many threads must, or one after the other (Gauss
// and Seidel).
template <typename Body> CUDA_CALLABLE inline bool takes_at_once(const Body& body) {
#if defined(__CUDA_ARCH__)
    return true;
#else
    return body.contact_at_once != 0;
#endif
}

// Two places that are too near, and what pushes them apart.
template <typename real> struct contact {
    meeting<real> places;
    vec<real> n, v, vt;  // n of the first from the second; its velocity against that, and across n
    real depth, needed;  // and the speed that undoes it in a step
    real over;           // how far they are moved apart over the depth
    real vn, speed;      // of approach, and what is taken away of it
    real sliding, held_back, per_mass, share;

    CUDA_CALLABLE inline vec<real> impulse() const { return share * (speed * n - held_back * vt); }
    CUDA_CALLABLE inline vec<real> shift(real dt) const {
        return dt * impulse() + (share * (over * depth - speed * dt)) * n;
    }
};

// The close pairs of a world in one state.
template <typename Body, typename real, bool at_once> struct contacts {
    const Body& body;
    const int w, count;
    const rows_of<real> s, push, loose;
    const real dt, per_dt, mu;
    // Points that take the mean of many pushes go less far than each asks for: over-relaxation takes
    // fewer turns. From 2 on it may diverge.
    static constexpr real over = at_once ? real(1.8) : real(1);

    CUDA_CALLABLE inline contacts(const Body& body, int w, const wp::array_t<real>& state, int row,
                                  real dt)
        : body(body), w(w), count(wp::index(body.close_count, w)), s(state, row),
          push(body.push, w), loose(body.loose, w), dt(dt), per_dt(real(1) / dt),
          mu(wp::index(body.self_friction, w)) {}

    CUDA_CALLABLE inline meeting<real> pair(int k) const {
        return pair_meets(s, wp::index(body.close, w, k, 0), wp::index(body.close, w, k, 1), body.pitch);
    }
    // The number of contacts among which the mass of point p is divided.
    CUDA_CALLABLE inline real split(int p) const {
        return at_once ? push.template get<real>(6, p) : real(1);
    }
    // Whether pair k is pushed apart, and how.
    CUDA_CALLABLE inline bool find(int k, contact<real>& c) const {
        c.places = pair(k);
        const meeting<real>& m = c.places;
        c.depth = body.contact_distance - m.distance;
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

// Counts the contacts of every point that share in it, where they are taken at once.
template <typename Body, typename real>
CUDA_CALLABLE inline void count_contacts(const Body& body, int w, const wp::array_t<real>& state, int row) {
    if (!takes_at_once(body)) return;
    const contacts<Body, real, true> all(body, w, state, row, real(1));
    for (EACH_ONE_IN(k, 0, all.count)) {
        const meeting<real> m = all.pair(k);
        if (m.distance >= body.contact_distance) continue;
        for (int i = 0; i < 4; ++i)
            if (m.share[i] != real(0)) add_to(all.push, 6, m.point[i], real(1));
    }
}

// Forth and back in turns.
CUDA_CALLABLE inline int in_turn(int j, int count, int turn) { return turn % 2 == 0 ? j : count - 1 - j; }

// Is told of every pair that is about to be pushed apart, and its points; this one does nothing.
struct nothing_kept {
    CUDA_CALLABLE inline void operator()(int, const int*) const {}
};

// One turn over the contacts of a step; tells whether one of this thread's was nearer than the distance
// that asks for another turn. Where they are taken at once, each contact has its part of a point's mass,
// and the point takes the mean of what its parts do, so that impulses stay equal and opposite (Tonge et
// al. (2012), "Mass splitting for jitter-free parallel rigid body simulation").
template <bool at_once, typename Body, typename real, typename Keep>
CUDA_CALLABLE inline int push_apart_in(const Body& body, int w, const wp::array_t<real>& state, int row,
                                       real dt, int turn, const Keep& keep) {
    const contacts<Body, real, at_once> all(body, w, state, row, dt);
    const real enough = turn + 1 < body.contact_turns ? body.contact_distance : body.contact_enough;
    contact<real> c;
    int again = 0;
    for (EACH_ONE_IN(j, 0, all.count)) {
        const int k = in_turn(j, all.count, turn);
        if (!all.find(k, c)) continue;
        keep(k, c.places.point);
        if (c.places.distance < enough) again = 1;
        const vec<real> impulse = c.impulse(), shift = c.shift(dt);
        for (int i = 0; i < 4; ++i) {
            const int p = c.places.point[i];
            const real by = c.places.share[i] * all.loose.template get<real>(0, p);
            if constexpr (at_once) add_to(all.push, 0, p, by * impulse), add_to(all.push, 3, p, by * shift);
            else all.s.add3(3, p, by * impulse), all.s.add3(0, p, by * shift);
        }
    }
    return again;
}
template <typename Body, typename real, typename Keep = nothing_kept>
CUDA_CALLABLE inline int push_apart(const Body& body, int w, const wp::array_t<real>& state, int row,
                                    real dt, int turn, const Keep& keep = Keep()) {
    return takes_at_once(body) ? push_apart_in<true>(body, w, state, row, dt, turn, keep)
                               : push_apart_in<false>(body, w, state, row, dt, turn, keep);
}

// Velocities and positions take the impulses of all contacts at once, which are then 0 again.
template <typename Body, typename real>
CUDA_CALLABLE inline void take_push(const Body& body, int w, const wp::array_t<real>& state, int row) {
    typedef typename several<real>::lanes T;
    if (!takes_at_once(body)) return;
    const rows_of<real> s(state, row), push(body.push, w);
    for (EACH_IN(p, body.first, body.end)) {
        s.add3(3, p, push.template get3<T>(0, p));
        s.add3(0, p, push.template get3<T>(3, p));
        for (int c = 0; c < 7; ++c) push.put(c, p, T(real(0)));
    }
}

}  // namespace gendom
