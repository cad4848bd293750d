// What surrounds thin bodies: gravity, a table and rigid obstacles, with Coulomb friction.

namespace gendom {

// What is rare stays out of the loops over all points on the CPU, which it would slow down.
#if defined(__CUDA_ARCH__)
#define OUT_OF_LINE CUDA_CALLABLE inline
#else
#define OUT_OF_LINE CUDA_CALLABLE __attribute__((noinline))
#endif

// Rows that every state and the derivatives by it begin with, and derivatives by every model; each obstacle's
// friction has one more.
enum { X = 0, V = 3, X_BAR = 0, V_BAR = 3 };
enum {
    PER_MASS_BAR = 12, DRAG_BAR = 13, GRAVITY_BAR = 15, DAMPING_BAR = 18, FRICTION_BAR = 19,
    VELOCITY_DAMPING_BAR = 20, SELF_FRICTION_BAR = 21, RADIUS_BAR = 22, DISTANCE_BAR = 23,
    FRICTIONS_BAR = 24
};

// Numbers of an obstacle: half the extents of its core along its own axes, and how far it reaches from there; what
// is true at the end of a step are the directions of its axes in the world, its centre, velocity and spin.
enum { HALF = 0, REACH = 3, MU = 4, AXES = 5, CENTRE = 14, VELOCITY = 17, SPIN = 20, OBSTACLE = 23 };

template <typename T, typename Model> CUDA_CALLABLE inline vec<T> gravity_of(const Model& model, int w) {
    const auto& g = wp::index(model.gravity, w);
    return {T(g[0]), T(g[1]), T(g[2])};
}

// ---- where a point is: its signed distance, the direction out, and the obstacle's velocity there --

template <typename T> struct upwards {};
template <typename T> CUDA_CALLABLE inline T dot(const upwards<T>&, const vec<T>& a) { return a.z; }
template <typename T> CUDA_CALLABLE inline vec<T> operator*(const T& s, const upwards<T>&) {
    typedef typename number_of<T>::type real;
    return {T(real(0)), T(real(0)), s};
}

// What is left of a vector without its part along a direction.
template <typename T> CUDA_CALLABLE inline vec<T> level(const vec<T>& a, const T&, const upwards<T>&) {
    typedef typename number_of<T>::type real;
    return {a.x, a.y, T(real(0))};
}
template <typename T> CUDA_CALLABLE inline vec<T> level(const vec<T>& a, const T& along, const vec<T>& n) {
    return a - along * n;
}

// The table is all that is below height 0.
template <typename T> struct over_table {
    typedef typename number_of<T>::type real;
    T distance;
    upwards<T> n;

    CUDA_CALLABLE inline explicit over_table(const vec<T>& x) : distance(x.z), n() {}
    CUDA_CALLABLE inline vec<T> moving() const { return {T(real(0)), T(real(0)), T(real(0))}; }
    // The second derivative of the distance times a vector, and the transpose of the velocity's derivative.
    CUDA_CALLABLE inline vec<T> bent(const vec<T>&) const { return moving(); }
    CUDA_CALLABLE inline vec<T> turned(const vec<T>&) const { return moving(); }
};

// A box, sphere or capsule is all that is near a box, point or line: its core.
template <typename T> struct near_obstacle {
    typedef typename number_of<T>::type real;
    T distance, per_length;
    vec<T> n, velocity, spin;
    vec<T> beyond;  // 1 along those of the obstacle's axes along which the point is beyond the core
    vec<T> d1, d2, d3;

    CUDA_CALLABLE inline vec<T> get3(const real* a) const { return {T(a[0]), T(a[1]), T(a[2])}; }
    CUDA_CALLABLE inline vec<T> to_body(const vec<T>& a) const { return {dot(d1, a), dot(d2, a), dot(d3, a)}; }
    CUDA_CALLABLE inline vec<T> to_world(const vec<T>& a) const { return a.x * d1 + a.y * d2 + a.z * d3; }

    CUDA_CALLABLE inline near_obstacle(const real* of, const vec<T>& x)
        : d1(get3(of + AXES)), d2(get3(of + AXES + 3)), d3(get3(of + AXES + 6)) {
        const T zero = T(real(0)), one = T(real(1)), tiny = T(real(1e-12));
        const vec<T> away = x - get3(of + CENTRE), at = to_body(away);
        const vec<T> side = {sign(at.x), sign(at.y), sign(at.z)};
        const vec<T> most = side * at - get3(of + HALF);
        beyond = {is_above(most.x, zero), is_above(most.y, zero), is_above(most.z, zero)};
        const vec<T> out = beyond * most;
        const T length = root(dot(out, out)), outside = is_above(length, tiny), inside = one - outside;
        per_length = outside / larger(length, tiny);
        // in the core the nearest face counts
        const T nearest = larger(larger(most.x, most.y), most.z);
        const T x_face = inside * (one - is_above(nearest, most.x));
        const T y_face = (inside - x_face) * (one - is_above(nearest, most.y));
        const vec<T> face = {x_face, y_face, inside - x_face - y_face};
        n = to_world(side * (per_length * out + face));
        distance = length + inside * nearest - T(of[REACH]);
        spin = get3(of + SPIN);
        velocity = get3(of + VELOCITY) + cross(spin, away);
    }
    CUDA_CALLABLE static inline T sign(const T& a) {
        return T(real(2)) * is_above(a, T(real(0))) - T(real(1));
    }
    CUDA_CALLABLE inline vec<T> moving() const { return velocity; }
    CUDA_CALLABLE inline vec<T> bent(const vec<T>& a) const {
        return per_length * (to_world(beyond * to_body(a)) - dot(n, a) * n);
    }
    CUDA_CALLABLE inline vec<T> turned(const vec<T>& u_bar) const { return cross(u_bar, spin); }
};

// ---- what happens there --------------------------------------------------------------------------

// Velocities are changed so that no point ends the step in an obstacle; what that takes of an approach,
// times its friction, it takes of sliding at most (Moreau 1988). Obstacles are convex: where a step along
// a tangent ends is outside.
template <typename T, typename Place> struct touch {
    typedef typename number_of<T>::type real;
    Place at;
    T push, along, speed, slides;
    vec<T> rel, vt;

    CUDA_CALLABLE inline touch(const Place& at, const vec<T>& v, const T& h, const T& mu, const T& radius)
        : at(at) {
        rel = v - at.moving();
        push = larger(T(real(0)), (radius - at.distance) / h - dot(at.n, v));
        along = dot(at.n, rel);
        vt = level(rel, along, at.n);
        speed = larger(root(dot(vt, vt)), T(real(1e-12)));
        slides = larger(T(real(0)), T(real(1)) - mu * push / speed);
    }
    CUDA_CALLABLE inline vec<T> velocity() const {
        return at.moving() + slides * vt + (along + push) * at.n;
    }
    // Transpose: derivatives by x are added, those by v replaced, those by friction and radius returned.
    CUDA_CALLABLE inline void adjoint(const vec<T>& v, const T& h, const T& mu, vec<T>& x_bar, vec<T>& v_bar,
                                      T& mu_bar, T& radius_bar) const {
        const T zero = T(real(0)), one = T(real(1));
        const T touches = is_above(push, zero), moves = is_above(slides, zero);
        const T slides_bar = moves * dot(vt, v_bar), per_speed = slides_bar / speed;
        const T push_bar = touches * (dot(at.n, v_bar) - mu * per_speed);
        const vec<T> vt_bar = (slides - one) * v_bar + (mu * push / (speed * speed) * per_speed) * vt;
        const vec<T> rel_bar = level(vt_bar, dot(at.n, vt_bar), at.n);
        const vec<T> n_bar = push * v_bar - push_bar * v - along * vt_bar - dot(at.n, vt_bar) * rel;
        x_bar = x_bar - (push_bar / h) * at.n + at.bent(n_bar) - at.turned(rel_bar);
        v_bar = v_bar - push_bar * at.n + rel_bar;
        mu_bar = -push * per_speed;
        radius_bar = push_bar / h;
    }
};

// What there is without obstacles.
template <typename T> struct on_table {
    T h, mu, radius;
    bool table;

    CUDA_CALLABLE inline vec<T> stopped(const vec<T>& x, const vec<T>& v) const {
        return table ? touch<T, over_table<T>>(over_table<T>(x), v, h, mu, radius).velocity() : v;
    }
};

// All of a world's obstacles, the table last.
template <typename T> struct surroundings : on_table<T> {
    typedef typename number_of<T>::type real;
    using on_table<T>::h; using on_table<T>::mu; using on_table<T>::radius; using on_table<T>::table;
    int count;
    const real* first;

    template <typename Model>
    CUDA_CALLABLE inline surroundings(const Model& model, int w, real dt)
        : on_table<T>{T(dt), T(wp::index(model.friction, w)), T(model.radius), bool(model.table)},
          count(model.obstacles.shape[1]), first(count ? &wp::index(model.obstacles, w, 0, 0) : nullptr) {}

    CUDA_CALLABLE inline const real* of(int o) const { return first + o * OBSTACLE; }
    CUDA_CALLABLE inline touch<T, near_obstacle<T>> touched(int o, const vec<T>& x, const vec<T>& v) const {
        return {near_obstacle<T>(of(o), x), v, h, T(of(o)[MU]), radius};
    }
    // Velocities that the first `o` obstacles leave.
    OUT_OF_LINE void stopped_by(int o, const vec<T>& x, vec<T>& v) const {
        for (int k = 0; k < o; ++k) v = touched(k, x, v).velocity();
    }
    CUDA_CALLABLE inline vec<T> stopped(const vec<T>& x, const vec<T>& free) const {
        vec<T> v = free;
        if (count) stopped_by(count, x, v);
        return on_table<T>::stopped(x, v);
    }
    // Transposes: derivatives by x are added, those by v replaced.
    CUDA_CALLABLE inline void stopped_adjoint(const rows_of<real>& by, int i, const vec<T>& x,
                                              const vec<T>& free, vec<T>& x_bar, vec<T>& v_bar) const {
        vec<T> v = free;
        if (count) stopped_by(count, x, v);
        if (table) {
            T mu_bar, radius_bar;
            const touch<T, over_table<T>> on(over_table<T>(x), v, h, mu, radius);
            on.adjoint(v, h, mu, x_bar, v_bar, mu_bar, radius_bar);
            by.add(FRICTION_BAR, i, mu_bar), by.add(RADIUS_BAR, i, radius_bar);
        }
        if (count) stopped_by_adjoint(by, i, x, free, x_bar, v_bar);
    }
    OUT_OF_LINE void stopped_by_adjoint(const rows_of<real>& by, int i, const vec<T>& x,
                                        const vec<T>& free, vec<T>& x_bar, vec<T>& v_bar) const {
        T mu_bar, radius_bar;
        for (int o = count - 1; o >= 0; --o) {
            vec<T> v = free;
            stopped_by(o, x, v);
            touched(o, x, v).adjoint(v, h, T(of(o)[MU]), x_bar, v_bar, mu_bar, radius_bar);
            by.add(FRICTIONS_BAR + o, i, mu_bar), by.add(RADIUS_BAR, i, radius_bar);
        }
    }
    // A place inside of the first `o` obstacles, brought back to their surface one after the other.
    OUT_OF_LINE void out_of(int o, vec<T>& x) const {
        for (int k = 0; k < o; ++k) {
            const near_obstacle<T> at(of(k), x);
            x = x + larger(T(real(0)), radius - at.distance) * at.n;
        }
    }
    CUDA_CALLABLE inline vec<T> brought_back(const vec<T>& x) const {
        vec<T> out = x;
        if (count) out_of(count, out);
        return {out.x, out.y, table ? larger(out.z, radius) : out.z};
    }
    // Transpose: derivatives by x in place; returns that by the radius.
    CUDA_CALLABLE inline T brought_back_adjoint(const vec<T>& x, vec<T>& x_bar) const {
        const T zero = T(real(0));
        T back = zero;
        vec<T> out = x;
        if (count) out_of(count, out);
        if (table) {
            back = is_above(radius, out.z) * x_bar.z;
            x_bar.z = x_bar.z - back;
        }
        for (int o = count - 1; o >= 0; --o) {
            out = x;
            out_of(o, out);
            const near_obstacle<T> at(of(o), out);
            const T depth = larger(zero, radius - at.distance), outwards = is_above(depth, zero) * dot(at.n, x_bar);
            back += outwards;
            x_bar = x_bar - outwards * at.n + depth * at.bent(x_bar);
        }
        return back;
    }
};

// How the points that nobody holds move in a step of dt, `kick` after the middle of the one before.
template <typename T, typename Around = surroundings<T>> struct motion {
    typedef typename number_of<T>::type real;
    T h, kick, keep;
    vec<T> gravity;
    Around around;

    template <typename Model>
    CUDA_CALLABLE inline motion(const Model& model, int w, real dt, real kick)
        : motion(model, w, dt, kick, wp::exp(-kick * wp::index(model.velocity_damping, w))) {}
    template <typename Model>
    CUDA_CALLABLE inline motion(const Model& model, int w, real dt, real kick, real keep)
        : h(T(dt)), kick(T(kick)), keep(T(keep)), gravity(gravity_of<T>(model, w)), around(model, w, dt) {}
    CUDA_CALLABLE inline motion(const T& kick, const T& keep, const vec<T>& gravity, const Around& around)
        : h(around.h), kick(kick), keep(keep), gravity(gravity), around(around) {}

    CUDA_CALLABLE inline vec<T> free(const vec<T>& v0, const T& per_mass, const vec<T>& f) const {
        return keep * (v0 + kick * (per_mass * f + gravity));
    }
    template <typename To>
    CUDA_CALLABLE inline void step(const To& to, int i, const vec<T>& x, const vec<T>& v0,
                                   const T& per_mass, const vec<T>& f) const {
        const vec<T> v = around.stopped(x, free(v0, per_mass, f));
        to.put3(V, i, v);
        to.put3(X, i, x + h * v);
    }
    // Derivative by f; those by v0, but for what f has of it, in v_bar.
    CUDA_CALLABLE inline vec<T> step_adjoint(const rows_of<real>& b, const rows_of<real>& by, int i,
                                             const vec<T>& x, const vec<T>& v0, const T& per_mass,
                                             const vec<T>& f, vec<T>& v_bar) const {
        const vec<T> v1 = free(v0, per_mass, f);
        vec<T> x_bar = b.template get3<T>(X_BAR, i);
        v_bar = b.template get3<T>(V_BAR, i) + h * x_bar;
        around.stopped_adjoint(by, i, x, v1, x_bar, v_bar);
        by.add(VELOCITY_DAMPING_BAR, i, -kick * dot(v1, v_bar));
        v_bar = keep * v_bar;
        by.add3(GRAVITY_BAR, i, kick * v_bar);
        by.add(PER_MASS_BAR, i, kick * dot(f, v_bar));
        b.put3(X_BAR, i, x_bar);
        return kick * per_mass * v_bar;
    }
};

}  // namespace gendom
