// What surrounds thin bodies: gravity, a table with Coulomb friction, walls.
#pragma once

namespace gendom {

template <typename T, typename Body> CUDA_CALLABLE inline vec<T> gravity_of(const Body& body, int w) {
    const auto& g = wp::index(body.gravity, w);
    return {T(g[0]), T(g[1]), T(g[2])};
}

// Derivatives of a loss by the coefficient of friction and by the height of points on the table.
template <typename T> struct ground_bar {
    T mu, radius;
};

// Velocities are changed so that no point ends the step beyond the table or a wall; what the table
// takes of a fall, times its friction, it takes of sliding at most (Moreau 1988).
template <typename T> struct ground {
    typedef typename number_of<T>::type real;
    T h, mu, radius;
    vec<T> lower, upper;
    bool table, walls;

    template <typename Body>
    CUDA_CALLABLE inline ground(const Body& body, int w, real dt)
        : h(T(dt)), mu(T(wp::index(body.friction, w))), radius(T(body.radius)),
          lower{T(body.box_lower[0]) + radius, T(body.box_lower[1]) + radius,
                T(body.box_lower[2]) + radius},
          upper{T(body.box_upper[0]) - radius, T(body.box_upper[1]) - radius,
                T(body.box_upper[2]) - radius},
          table(body.table), walls(body.walls) {}

    CUDA_CALLABLE inline T push(const vec<T>& x, const vec<T>& v) const {
        return larger(T(real(0)), (radius - x.z) / h - v.z);
    }
    CUDA_CALLABLE inline T speed(const vec<T>& v) const {
        return larger(root(v.x * v.x + v.y * v.y), T(real(1e-12)));
    }
    CUDA_CALLABLE inline vec<T> on_table(const vec<T>& x, const vec<T>& v) const {
        if (!table) return v;
        const T p = push(x, v), slides = larger(T(real(0)), T(real(1)) - mu * p / speed(v));
        return {slides * v.x, slides * v.y, v.z + p};
    }
    CUDA_CALLABLE inline vec<T> stopped(const vec<T>& x, const vec<T>& free) const {
        return between_walls(x, on_table(x, free));
    }
    CUDA_CALLABLE inline vec<T> between_walls(const vec<T>& x, const vec<T>& v) const {
        if (!walls) return v;
        const T by = T(real(1)) / h;
        const vec<T> least = by * (lower - x), most = by * (upper - x);
        const vec<T> up = {larger(v.x, least.x), larger(v.y, least.y), larger(v.z, least.z)};
        return {-larger(-up.x, -most.x), -larger(-up.y, -most.y), -larger(-up.z, -most.z)};
    }

    // A place that is beyond the table or a wall, brought back to it.
    CUDA_CALLABLE inline vec<T> brought_back(const vec<T>& x) const {
        vec<T> y = x;
        if (table) y.z = larger(y.z, radius);
        if (walls)
            y = {-larger(-larger(y.x, lower.x), -upper.x), -larger(-larger(y.y, lower.y), -upper.y),
                 -larger(-larger(y.z, lower.z), -upper.z)};
        return y;
    }
    // 1 for each component at which a place is free, 0 where it stands at the table or a wall.
    CUDA_CALLABLE inline vec<T> is_free(const vec<T>& x) const {
        const T one = T(real(1));
        vec<T> free = {one, one, one};
        if (table) free.z = is_above(x.z, radius);
        if (walls)
            free = free * vec<T>{is_above(x.x, lower.x) * is_above(upper.x, x.x),
                                 is_above(x.y, lower.y) * is_above(upper.y, x.y),
                                 is_above(x.z, lower.z) * is_above(upper.z, x.z)};
        return free;
    }

    // Transpose of `stopped`: derivatives by x are added, those by v replaced.
    CUDA_CALLABLE inline ground_bar<T> stopped_adjoint(const vec<T>& x, const vec<T>& free,
                                                       vec<T>& x_bar, vec<T>& v_bar) const {
        const T zero = T(real(0)), one = T(real(1));
        ground_bar<T> found = {zero, zero};
        if (walls) {  // where a wall stops a point, its velocity follows from its place
            const vec<T> turned = stopped(x, free) - on_table(x, free);
            const vec<T> by = {is_above(turned.x * turned.x, zero),
                               is_above(turned.y * turned.y, zero),
                               is_above(turned.z * turned.z, zero)};
            const vec<T> back = {is_above(turned.x, zero), is_above(turned.y, zero),
                                 is_above(turned.z, zero)};  // from lower walls
            found.radius = one / h * dot(back + back - by, v_bar);
            x_bar = x_bar - (one / h) * (by * v_bar);
            v_bar = v_bar - by * v_bar;
        }
        if (!table) return found;
        const T p = push(x, free), s = speed(free);
        const T slides = larger(zero, one - mu * p / s);
        const T touches = is_above(p, zero), moves = is_above(slides, zero);
        const T slides_bar = moves * (v_bar.x * free.x + v_bar.y * free.y);
        const T push_bar = touches * (v_bar.z - mu / s * slides_bar);
        const T speed_bar = mu * p / (s * s) * slides_bar;
        x_bar.z -= push_bar / h;
        found.radius += push_bar / h;
        found.mu = -p / s * slides_bar;
        v_bar = {slides * v_bar.x + speed_bar * free.x / s,
                 slides * v_bar.y + speed_bar * free.y / s, v_bar.z - push_bar};
        return found;
    }
    // Transpose of `brought_back`: derivatives by x in place; returns that by the radius.
    CUDA_CALLABLE inline T brought_back_adjoint(const vec<T>& y, vec<T>& y_bar) const {
        const vec<T> back = y_bar - is_free(y) * y_bar;
        y_bar = y_bar - back;
        T by_radius = back.x + back.y + back.z;
        if (walls) {  // upper ones come nearer
            const T one = T(real(1));
            const vec<T> at_upper = {one - is_above(upper.x, y.x), one - is_above(upper.y, y.y),
                                     one - is_above(upper.z, y.z)};
            by_radius -= dot(back, at_upper + at_upper);
        }
        return by_radius;
    }
};

}  // namespace gendom
