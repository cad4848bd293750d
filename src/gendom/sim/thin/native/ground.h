// What surrounds thin bodies: gravity, and a table with Coulomb friction.
#pragma once

namespace gendom {

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

}  // namespace gendom
