// A shell: points x_p on a lattice of rows and columns, `pitch` numbers apart from row to row, with
// a row of numbers that are no points before and after.
//
// A cell between four points a b / c d has the strains
//
//     E11 = (u.u / lx^2 - 1) / 2 of edges u along a row, E22 of edges v along a column,
//     E12 = S(u.v) / (2 lx ly) of its mean edges u, v.
//
// A cell whose edges keep their lengths can bend about either diagonal. That is no shear, although it
// changes u.v by up to t.t / 4, with t = a - b - c + d. S(F) is what F has beyond this; without it,
// sheets that bend over less than some ten cells resist it in the plane. Bending is quadratic in second differences, as of a thin plate that
// hardly stretches (Bergou et al. 2006, "A quadratic bending model for inextensible surfaces"):
//
//     D / 2 (|x_xx|^2 + 2 nu x_xx.x_yy + |x_yy|^2) of points, D (1 - nu) |x_xy|^2 of cells.
//
// Where an edge of the sheet is free, so is the curvature across it. Curvatures that lag behind (a
// standard linear solid) go along the normal n: kappa = n.x_xx.
#pragma once

namespace gendom {

// Rows of a state, of what all worlds share, of stiffness, of inertia, of the scratch.
enum { LAG_ROW = 6, LAG_COLUMN = 8, LAG_SHEAR = 10, LAG_BEND = 11 };
enum { NEXT = 0, BELOW = 1, CELL = 2 };
enum { C11 = 0, C22 = 1, C12 = 2, G12 = 3, BXX = 4, BYY = 5, BXY = 6, TWIST = 7 };
enum { POINT_PER_MASS = 0, POINT_DRAG = 1, STIFFER_X = 2, STIFFER_Y = 3 };
enum { F_BOTTOM = 0, F_TOP = 3, F_LEFT = 6, F_RIGHT = 9, M_XX = 12, M_YY = 15, M_XY = 18, NORMAL = 21 };

// Strains of a cell, and what stress makes of them.
template <typename T> struct shell_cell {
    typedef typename number_of<T>::type real;
    vec<T> u[2], v[2];  // bottom and top, left and right
    vec<T> mean_u, mean_v, twist;
    T lx2, ly2, lxy;  // 1 / lx^2, 1 / ly^2, 1 / (lx ly)
    T row[2], column[2], shear;
    T is_sheared, sign;  // sign 0 where it is not

    template <typename Rows>
    CUDA_CALLABLE inline shell_cell(const Rows& s, int p, int pitch, real per_x, real per_y)
        : lx2(T(per_x * per_x)), ly2(T(per_y * per_y)), lxy(T(per_x * per_y)) {
        const vec<T> a = s.template get3<T>(X, p), b = s.template get3<T>(X, p + 1);
        const vec<T> c = s.template get3<T>(X, p + pitch);
        const vec<T> d = s.template get3<T>(X, p + pitch + 1);
        u[0] = b - a, u[1] = d - c, v[0] = c - a, v[1] = d - b;
        const T half = T(real(0.5)), one = T(real(1));
        for (int k = 0; k < 2; ++k) {
            row[k] = half * (lx2 * dot(u[k], u[k]) - one);
            column[k] = half * (ly2 * dot(v[k], v[k]) - one);
        }
        mean_u = half * (u[0] + u[1]), mean_v = half * (v[0] + v[1]), twist = v[1] - v[0];
        const T F = dot(mean_u, mean_v), free = half * half * dot(twist, twist);
        is_sheared = one - is_above(free, larger(F, -F));  // a flat cell resists shear at once
        sign = is_sheared * (T(real(2)) * is_above(F, T(real(0))) - one);
        shear = half * lxy * (is_sheared * F - sign * free);
    }

    // Derivatives of of_shear * shear by the four edges, given how edges' mean and twist change it.
    CUDA_CALLABLE inline void shear_edges(const T& of_shear, const vec<T>& to_u, const vec<T>& to_v,
                                          const vec<T>& to_twist, vec<T> by_u[2], vec<T> by_v[2]) const {
        const T quarter = T(real(0.25)) * lxy * of_shear;
        const vec<T> turned = quarter * sign * to_twist;
        for (int k = 0; k < 2; ++k) by_u[k] = by_u[k] + quarter * is_sheared * to_v;
        by_v[0] = by_v[0] + quarter * is_sheared * to_u + turned;
        by_v[1] = by_v[1] + quarter * is_sheared * to_u - turned;
    }

    // Derivatives of sum(strain * of) by the four edges.
    CUDA_CALLABLE inline void edges(const T of_row[2], const T of_column[2], const T& of_shear,
                                    vec<T> by_u[2], vec<T> by_v[2]) const {
        for (int k = 0; k < 2; ++k) {
            by_u[k] = of_row[k] * lx2 * u[k];
            by_v[k] = of_column[k] * ly2 * v[k];
        }
        shear_edges(of_shear, mean_u, mean_v, twist, by_u, by_v);
    }
};

// Stress times area, for strains (or any combination of them): of rows and columns a quarter of it.
template <typename T> struct shell_stiffness {
    T c11, c22, c12, g12;

    CUDA_CALLABLE inline void stress(const T row[2], const T column[2], const T& shear, T of_row[2],
                                     T of_column[2], T& of_shear) const {
        const T rows = row[0] + row[1], columns = column[0] + column[1];
        for (int k = 0; k < 2; ++k) {
            of_row[k] = (c11 + c11) * row[k] + c12 * columns;
            of_column[k] = (c22 + c22) * column[k] + c12 * rows;
        }
        of_shear = g12 * shear;
    }
};

// Differences at a point: second ones, and along both axes those that the sheet has.
template <typename T> struct shell_bend {
    vec<T> xx, yy, xy, tx, ty, n;
    T length;

    template <typename Rows, typename Shape>
    CUDA_CALLABLE inline shell_bend(const Rows& s, const Shape& shape, int p, int pitch) {
        typedef typename number_of<T>::type real;
        const vec<T> x = s.template get3<T>(X, p);
        const T after = shape.template get<T>(NEXT, p), before = shape.template get<T>(NEXT, p - 1);
        const T below = shape.template get<T>(BELOW, p), above = shape.template get<T>(BELOW, p - pitch);
        const vec<T> to_next = after * (s.template get3<T>(X, p + 1) - x);
        const vec<T> from_last = before * (x - s.template get3<T>(X, p - 1));
        const vec<T> to_below = below * (s.template get3<T>(X, p + pitch) - x);
        const vec<T> from_above = above * (x - s.template get3<T>(X, p - pitch));
        xx = after * before * (to_next - from_last);
        yy = below * above * (to_below - from_above);
        xy = shape.template get<T>(CELL, p) *
             (s.template get3<T>(X, p + pitch + 1) - s.template get3<T>(X, p + pitch) -
              s.template get3<T>(X, p + 1) + x);
        tx = to_next + from_last;
        ty = to_below + from_above;
        const vec<T> N = cross(tx, ty);
        length = larger(root(dot(N, N)), T(real(1e-12)));
        n = (T(real(1)) / length) * N;
    }
    CUDA_CALLABLE inline vec<T> curvatures() const { return {dot(n, xx), dot(n, yy), dot(n, xy)}; }
};

// Moments over squared spacings: of vectors xx, yy, xy, or of their parts along the normal.
template <typename T> struct bend_stiffness {
    T xx, yy, both, twist;

    template <typename Rows>
    CUDA_CALLABLE inline bend_stiffness(const Rows& k, const Rows& m, int p)
        : xx(m.template get<T>(STIFFER_X, p) * k.template get<T>(BXX, p)),
          yy(m.template get<T>(STIFFER_Y, p) * k.template get<T>(BYY, p)),
          both(k.template get<T>(BXY, p)), twist(k.template get<T>(TWIST, p)) {}

    CUDA_CALLABLE inline vec<T> operator()(const vec<T>& a) const {
        return {xx * a.x + both * a.y, yy * a.y + both * a.x, twist * a.z};
    }
};

// Forces of edges and moments of points in the scratch; the lagged strains go on. Returns the largest
// squared stretch, not a number if any is not.
template <typename Model, typename real>
CUDA_CALLABLE inline real shell_forces(const Model& model, int w, const wp::array_t<real>& state,
                                       int row, int next, real dt) {
    typedef typename several<real>::lanes T;
    const int pitch = model.pitch;
    const rows_of<real> s(state, row), to(state, next), shape(model.rest, 0), k(model.stiffness, w),
        m(model.inertia, w), out(model.scratch, w);
    const viscosity<real> visc(wp::index(model.damping, w), dt);
    const T c = T(visc.share), a = T(visc.follows);
    T worst = T(real(0)), sum = T(real(0));
    for (EACH_IN(p, model.first, model.end)) {
        const shell_cell<T> cell(s, p, pitch, model.per_x, model.per_y);
        const T exists = shape.template get<T>(CELL, p);
        T row_e[2], column_e[2];
        const auto stressed = [&](const T& strain, int lag) {
            const T late = strain - s.template get<T>(lag, p);
            to.put(lag, p, s.template get<T>(lag, p) + a * late);
            return strain + c * late;
        };
        for (int e = 0; e < 2; ++e) {
            row_e[e] = stressed(cell.row[e], LAG_ROW + e);
            column_e[e] = stressed(cell.column[e], LAG_COLUMN + e);
            const T both = exists * (cell.row[e] * cell.row[e] + cell.column[e] * cell.column[e]);
            worst = larger(worst, both);
            sum += both;
        }
        const T shear_e = stressed(cell.shear, LAG_SHEAR);
        const shell_stiffness<T> C = {k.template get<T>(C11, p), k.template get<T>(C22, p),
                                      k.template get<T>(C12, p), k.template get<T>(G12, p)};
        T of_row[2], of_column[2], of_shear;
        C.stress(row_e, column_e, shear_e, of_row, of_column, of_shear);
        vec<T> by_u[2], by_v[2];
        cell.edges(of_row, of_column, of_shear, by_u, by_v);
        out.put3(F_BOTTOM, p, by_u[0]), out.put3(F_TOP, p, by_u[1]);
        out.put3(F_LEFT, p, by_v[0]), out.put3(F_RIGHT, p, by_v[1]);

        const shell_bend<T> bend(s, shape, p, pitch);
        const bend_stiffness<T> B(k, m, p);
        const vec<T> kappa = bend.curvatures(), lag = s.template get3<T>(LAG_BEND, p);
        const vec<T> along = B(c * (kappa - lag));
        to.put3(LAG_BEND, p, lag + a * (kappa - lag));
        out.put3(M_XX, p, B.xx * bend.xx + B.both * bend.yy + along.x * bend.n);
        out.put3(M_YY, p, B.yy * bend.yy + B.both * bend.xx + along.y * bend.n);
        out.put3(M_XY, p, B.twist * bend.xy + along.z * bend.n);
        out.put3(NORMAL, p, bend.n);
    }
    const real all = sum_of(sum);
    return all == all ? largest_of(worst) : all;
}

// Mean of how much edges along rows, or along columns, are stretched or compressed, the larger one;
// every thread finds it.
template <typename Model, typename real>
CUDA_CALLABLE inline real shell_stretch(const Model& model, const wp::array_t<real>& state, int row) {
    const rows_of<real> s(state, row), shape(model.rest, 0);
    real sum[2] = {real(0), real(0)}, count[2] = {real(0), real(0)};
    for (int p = model.first; p < model.end; ++p) {
        for (int k = 0; k < 2; ++k) {
            const real exists = shape.template get<real>(k == 0 ? NEXT : BELOW, p);
            if (exists == real(0)) continue;
            const vec<real> d = s.template get3<real>(X, p + (k == 0 ? 1 : model.pitch)) -
                                s.template get3<real>(X, p);
            const real stretch = wp::sqrt(dot(d, d)) * (k == 0 ? model.per_x : model.per_y) - real(1);
            sum[k] += stretch < real(0) ? -stretch : stretch;
            count[k] += real(1);
        }
    }
    return larger(sum[0] / count[0], sum[1] / count[1]);
}

// What edges and moments of the scratch add up to at a point: minus the derivative of the energy.
template <typename T, typename Rows>
CUDA_CALLABLE inline vec<T> shell_pull(const Rows& in, const Rows& shape, int p, int pitch) {
    typedef typename number_of<T>::type real;
    const int last = p - 1, above = p - pitch, corner = p - pitch - 1;
    const auto at = [&](int c, int q) { return in.template get3<T>(c, q); };
    // a point is a of its own cell, b of the one before, c of the one above, d of that before above
    const vec<T> pull = at(F_BOTTOM, p) + at(F_LEFT, p) - at(F_BOTTOM, last) + at(F_RIGHT, last) +
                        at(F_TOP, above) - at(F_LEFT, above) - at(F_TOP, corner) - at(F_RIGHT, corner);
    const vec<T> xx = at(M_XX, p), yy = at(M_YY, p), two_xx = xx + xx, two_yy = yy + yy;
    const vec<T> bent = at(M_XX, last) - two_xx + at(M_XX, p + 1) + at(M_YY, above) - two_yy +
                        at(M_YY, p + pitch) + at(M_XY, p) - at(M_XY, last) - at(M_XY, above) +
                        at(M_XY, corner);
    return pull - bent;
}

template <typename Model, typename real>
CUDA_CALLABLE inline void shell_move(const Model& model, int w, const wp::array_t<real>& state, int row,
                                     int next, real dt, real kick) {
    typedef typename several<real>::lanes T;
    const rows_of<real> s(state, row), to(state, next), shape(model.rest, 0), m(model.inertia, w),
        in(model.scratch, w);
    const motion<T> go(model, w, dt, kick);
    for (EACH_IN(p, model.first, model.end)) {
        const vec<T> x = s.template get3<T>(X, p), v0 = s.template get3<T>(V, p);
        const vec<T> normal = in.template get3<T>(NORMAL, p);
        const T vn = dot(v0, normal);
        const vec<T> f = shell_pull<T>(in, shape, p, model.pitch) -
                         m.template get<T>(POINT_DRAG, p) * root(vn * vn) * vn * normal;
        go.step(to, p, x, v0, m.template get<T>(POINT_PER_MASS, p), f);
    }
}

}  // namespace gendom
