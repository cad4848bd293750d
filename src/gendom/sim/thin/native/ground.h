// What surrounds thin bodies: gravity, and a table with Coulomb friction.

namespace gendom {

// Rows that every state and the derivatives by it begin with, and derivatives by every model.
enum { X = 0, V = 3, X_BAR = 0, V_BAR = 3 };
enum {
    PER_MASS_BAR = 12, DRAG_BAR = 13, GRAVITY_BAR = 15, DAMPING_BAR = 18, FRICTION_BAR = 19,
    VELOCITY_DAMPING_BAR = 20, SELF_FRICTION_BAR = 21, RADIUS_BAR = 22, DISTANCE_BAR = 23
};

template <typename T, typename Model> CUDA_CALLABLE inline vec<T> gravity_of(const Model& model, int w) {
    const auto& g = wp::index(model.gravity, w);
    return {T(g[0]), T(g[1]), T(g[2])};
}

// Derivatives of a loss by the coefficient of friction and by the height of points on the table.
template <typename T> struct ground_bar {
    T mu, radius;
};

// Velocities are changed so that no point ends the step below the table; what that takes of a fall,
// times its friction, it takes of sliding at most (Moreau 1988).
template <typename T> struct ground {
    typedef typename number_of<T>::type real;
    T h, mu, radius;
    bool table;

    template <typename Model>
    CUDA_CALLABLE inline ground(const Model& model, int w, real dt)
        : h(T(dt)), mu(T(wp::index(model.friction, w))), radius(T(model.radius)), table(model.table) {}

    CUDA_CALLABLE inline T push(const vec<T>& x, const vec<T>& v) const {
        return larger(T(real(0)), (radius - x.z) / h - v.z);
    }
    CUDA_CALLABLE inline T speed(const vec<T>& v) const {
        return larger(root(v.x * v.x + v.y * v.y), T(real(1e-12)));
    }
    CUDA_CALLABLE inline vec<T> stopped(const vec<T>& x, const vec<T>& v) const {
        if (!table) return v;
        const T p = push(x, v), slides = larger(T(real(0)), T(real(1)) - mu * p / speed(v));
        return {slides * v.x, slides * v.y, v.z + p};
    }
    // A place that is below the table, brought back to it.
    CUDA_CALLABLE inline vec<T> brought_back(const vec<T>& x) const {
        return {x.x, x.y, table ? larger(x.z, radius) : x.z};
    }

    // Transpose of `stopped`: derivatives by x are added, those by v replaced.
    CUDA_CALLABLE inline ground_bar<T> stopped_adjoint(const vec<T>& x, const vec<T>& free,
                                                       vec<T>& x_bar, vec<T>& v_bar) const {
        const T zero = T(real(0)), one = T(real(1));
        if (!table) return {zero, zero};
        const T p = push(x, free), s = speed(free);
        const T slides = larger(zero, one - mu * p / s);
        const T touches = is_above(p, zero), moves = is_above(slides, zero);
        const T slides_bar = moves * (v_bar.x * free.x + v_bar.y * free.y);
        const T push_bar = touches * (v_bar.z - mu / s * slides_bar);
        const T speed_bar = mu * p / (s * s) * slides_bar;
        x_bar.z -= push_bar / h;
        v_bar = {slides * v_bar.x + speed_bar * free.x / s,
                 slides * v_bar.y + speed_bar * free.y / s, v_bar.z - push_bar};
        return {-p / s * slides_bar, push_bar / h};
    }
    // Transpose of `brought_back`: derivatives by x in place; returns that by the radius.
    CUDA_CALLABLE inline T brought_back_adjoint(const vec<T>& y, vec<T>& y_bar) const {
        if (!table) return T(real(0));
        const T free = is_above(y.z, radius), back = (T(real(1)) - free) * y_bar.z;
        y_bar.z = free * y_bar.z;
        return back;
    }
};

// How the points that nobody holds move in a step of dt, `kick` after the middle of the one before.
template <typename T> struct motion {
    typedef typename number_of<T>::type real;
    T h, kick, keep;
    vec<T> gravity;
    ground<T> around;

    template <typename Model>
    CUDA_CALLABLE inline motion(const Model& model, int w, real dt, real kick)
        : h(T(dt)), kick(T(kick)), keep(T(wp::exp(-kick * wp::index(model.velocity_damping, w)))),
          gravity(gravity_of<T>(model, w)), around(model, w, dt) {}

    CUDA_CALLABLE inline vec<T> free(const vec<T>& v0, const T& per_mass, const vec<T>& f) const {
        return keep * (v0 + kick * (per_mass * f + gravity));
    }
    CUDA_CALLABLE inline void step(const rows_of<real>& to, int i, const vec<T>& x, const vec<T>& v0,
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
        const ground_bar<T> stopped = around.stopped_adjoint(x, v1, x_bar, v_bar);
        by.add(FRICTION_BAR, i, stopped.mu);
        by.add(RADIUS_BAR, i, stopped.radius);
        by.add(VELOCITY_DAMPING_BAR, i, -kick * dot(v1, v_bar));
        v_bar = keep * v_bar;
        by.add3(GRAVITY_BAR, i, kick * v_bar);
        by.add(PER_MASS_BAR, i, kick * dot(f, v_bar));
        b.put3(X_BAR, i, x_bar);
        return kick * per_mass * v_bar;
    }
};

}  // namespace gendom
