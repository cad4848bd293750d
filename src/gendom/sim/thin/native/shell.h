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

namespace gendom {

// Rows of a state, of what all worlds share, of stiffness, of inertia, of the scratch.
enum { LAG_ROW = 6, LAG_COLUMN = 8, LAG_SHEAR = 10, LAG_BEND = 11 };
enum { NEXT = 0, BELOW = 1, CELL = 2 };
enum { C11 = 0, C22 = 1, C12 = 2, G12 = 3, BXX = 4, BYY = 5, BXY = 6, TWIST = 7 };
enum { POINT_PER_MASS = 0, POINT_DRAG = 1, STIFFER_X = 2, STIFFER_Y = 3 };
enum { F_A = 0, F_B = 3, F_C = 6, M_XX = 9, M_YY = 12, M_XY = 15, NORMAL = 18 };

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

// Forces of cells on three of their corners and moments of points in the scratch; the lagged strains go on. Returns the largest
// squared stretch, not a number if any is not.
template <typename Model, typename real>
CUDA_CALLABLE inline real shell_forces(const Model& model, int w, const wp::array_t<real>& state,
                                       int row, int next, real dt) {
    typedef typename several<real>::lanes T;
    const int pitch = model.pitch;
    const rows_of<real> s(state, row), to(state, next), shape(model.rest, 0), k(model.stiffness, w),
        m(model.inertia, w), out = shared_or(SHARED_SCRATCH, model.scratch, w);
    const viscosity<real> visc(wp::index(model.damping, w), dt);
    const T c = T(visc.share), a = T(visc.follows);
    T worst = T(real(0)), sum = T(real(0));
    for (EACH_IN(p, model.first, model.end)) {
        // all is read before anything is written: reading waits for what may have been written
        const shell_cell<T> cell(s, p, pitch, model.per_x, model.per_y);
        const T exists = shape.template get<T>(CELL, p);
        T lags[LAG_BEND - LAG_ROW], row_e[2], column_e[2];
        for (int n = LAG_ROW; n < LAG_BEND; ++n) lags[n - LAG_ROW] = s.template get<T>(n, p);
        const vec<T> lag = s.template get3<T>(LAG_BEND, p);
        const shell_bend<T> bend(s, shape, p, pitch);
        const bend_stiffness<T> B(k, m, p);
        const shell_stiffness<T> C = {k.template get<T>(C11, p), k.template get<T>(C22, p),
                                      k.template get<T>(C12, p), k.template get<T>(G12, p)};
        const auto stressed = [&](const T& strain, int n) {
            const T late = strain - lags[n - LAG_ROW];
            to.put(n, p, lags[n - LAG_ROW] + a * late);
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
        T of_row[2], of_column[2], of_shear;
        C.stress(row_e, column_e, shear_e, of_row, of_column, of_shear);
        vec<T> by_u[2], by_v[2];
        cell.edges(of_row, of_column, of_shear, by_u, by_v);
        out.put3(F_A, p, by_u[0] + by_v[0]), out.put3(F_B, p, by_v[1] - by_u[0]);
        out.put3(F_C, p, by_u[1] - by_v[0]);
        const vec<T> kappa = bend.curvatures(), along = B(c * (kappa - lag));
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
// every warp finds it.
template <typename Model, typename real>
CUDA_CALLABLE inline real shell_stretch(const Model& model, const wp::array_t<real>& state, int row) {
    const rows_of<real> s(state, row), shape(model.rest, 0);
    real sum[2] = {real(0), real(0)}, count[2] = {real(0), real(0)};
    for (EACH_OF_WARP(p, model.first, model.end)) {
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
    const real rows = warp_sum(sum[0]) / warp_sum(count[0]), columns = warp_sum(sum[1]) / warp_sum(count[1]);
    return larger(rows, columns);
}

// What edges and moments of the scratch add up to at a point: minus the derivative of the energy.
template <typename T, typename Rows>
CUDA_CALLABLE inline vec<T> shell_pull(const Rows& in, const Rows& shape, int p, int pitch) {
    typedef typename number_of<T>::type real;
    const int last = p - 1, above = p - pitch, corner = p - pitch - 1;
    const auto at = [&](int c, int q) { return in.template get3<T>(c, q); };
    // a point is a of its own cell, b of the one before, c of the one above, d of that before above; a cell pulls d
    // as much as it pulls the others back
    const vec<T> pull = at(F_A, p) + at(F_B, last) + at(F_C, above) - at(F_A, corner) - at(F_B, corner) -
                        at(F_C, corner);
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
        in = shared_or(SHARED_SCRATCH, model.scratch, w);
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

// ---- transposes ----------------------------------------------------------------------------------
enum { LAG_ROW_BAR = 6, LAG_COLUMN_BAR = 8, LAG_SHEAR_BAR = 10, LAG_BEND_BAR = 11 };
enum { C11_BAR = 0, C22_BAR = 1, C12_BAR = 2, G12_BAR = 3, BXX_BAR = 4, BYY_BAR = 5, BXY_BAR = 6, TWIST_BAR = 7 };
enum { F_BAR = 0, N_BAR = 3, U_BAR = 6, V_EDGE_BAR = 12, XX_BAR = 18, YY_BAR = 21, XY_BAR = 24, TX_BAR = 27, TY_BAR = 30 };

template <typename Model, typename Adjoint, typename real>
CUDA_CALLABLE inline void shell_move_adjoint(const Model& model, const Adjoint& adjoint, int w,
                                             const wp::array_t<real>& state, int row, real dt,
                                             real kick) {
    typedef typename several<real>::lanes T;
    const rows_of<real> s(state, row), shape(model.rest, 0), m(model.inertia, w), in(model.scratch, w),
        b(adjoint.state, w), by(adjoint.model, w), out(adjoint.scratch, w);
    const motion<T> go(model, w, dt, kick);
    for (EACH_IN(p, model.first, model.end)) {
        const vec<T> x = s.template get3<T>(X, p), v0 = s.template get3<T>(V, p);
        const vec<T> normal = in.template get3<T>(NORMAL, p);
        const T vn = dot(v0, normal), size = root(vn * vn), drag = m.template get<T>(POINT_DRAG, p);
        const vec<T> f = shell_pull<T>(in, shape, p, model.pitch) - drag * size * vn * normal;
        vec<T> v_bar;
        const T per_mass = m.template get<T>(POINT_PER_MASS, p);
        const vec<T> f_bar = go.step_adjoint(b, by, p, x, v0, per_mass, f, v_bar);
        const T by_drag = -dot(f_bar, normal), vn_bar = (size + size) * drag * by_drag;
        by.add(DRAG_BAR, p, size * vn * by_drag);
        out.put3(F_BAR, p, f_bar);
        out.put3(N_BAR, p, vn_bar * v0 - drag * size * vn * f_bar);
        b.put3(V_BAR, p, v_bar + vn_bar * normal);
    }
}

// Every cell and point for itself.
template <typename Model, typename Adjoint, typename real>
CUDA_CALLABLE inline void shell_forces_adjoint(const Model& model, const Adjoint& adjoint, int w,
                                               const wp::array_t<real>& state, int row, real dt) {
    typedef typename several<real>::lanes T;
    const int pitch = model.pitch;
    const rows_of<real> s(state, row), shape(model.rest, 0), k(model.stiffness, w), m(model.inertia, w),
        b(adjoint.state, w), by(adjoint.model, w), at(adjoint.scratch, w);
    const viscosity<real> visc(wp::index(model.damping, w), dt);
    const T c = T(visc.share), a = T(visc.follows), whole = T(real(1)) + c, left = T(real(1)) - a;
    for (EACH_IN(p, model.first, model.end)) {
        const auto pulled = [&](int q) { return at.template get3<T>(F_BAR, q); };
        const vec<T> fa = pulled(p), fb = pulled(p + 1), fc = pulled(p + pitch), fd = pulled(p + pitch + 1);
        T damping_bar = T(real(0));

        // the forces by_u, by_v pull the first ends of edges along, and second ends back
        const shell_cell<T> cell(s, p, pitch, model.per_x, model.per_y);
        const vec<T> u_bar[2] = {fa - fb, fc - fd}, v_bar[2] = {fa - fc, fb - fd};
        T row_e[2], column_e[2], row_late[2], column_late[2];
        for (int e = 0; e < 2; ++e) {
            row_late[e] = cell.row[e] - s.template get<T>(LAG_ROW + e, p);
            column_late[e] = cell.column[e] - s.template get<T>(LAG_COLUMN + e, p);
            row_e[e] = cell.row[e] + c * row_late[e];
            column_e[e] = cell.column[e] + c * column_late[e];
        }
        const T shear_late = cell.shear - s.template get<T>(LAG_SHEAR, p);
        const T shear_e = cell.shear + c * shear_late;
        const shell_stiffness<T> C = {k.template get<T>(C11, p), k.template get<T>(C22, p),
                                      k.template get<T>(C12, p), k.template get<T>(G12, p)};
        T of_row[2], of_column[2], of_shear;
        C.stress(row_e, column_e, shear_e, of_row, of_column, of_shear);
        // strains' variations that these would make: the bars of the stresses
        const T half = T(real(0.5));
        T row_v[2], column_v[2];
        for (int e = 0; e < 2; ++e) {
            row_v[e] = cell.lx2 * dot(cell.u[e], u_bar[e]);
            column_v[e] = cell.ly2 * dot(cell.v[e], v_bar[e]);
        }
        const vec<T> mean_u_bar = half * (u_bar[0] + u_bar[1]), twist_bar = v_bar[1] - v_bar[0];
        const vec<T> mean_v_bar = half * (v_bar[0] + v_bar[1]);
        const T F_v = dot(cell.mean_u, mean_v_bar) + dot(cell.mean_v, mean_u_bar);
        const T shear_v = half * cell.lxy *
                          (cell.is_sheared * F_v - cell.sign * half * dot(cell.twist, twist_bar));
        T row_s[2], column_s[2], shear_s;
        C.stress(row_v, column_v, shear_v, row_s, column_s, shear_s);
        T row_b[2], column_b[2];
        const auto strain_bar = [&](const T& s_bar, const T& late, int lag_row) {
            const T lag_bar = b.template get<T>(lag_row, p);
            b.put(lag_row, p, left * lag_bar - c * s_bar);
            damping_bar += T(visc.share_slope) * s_bar * late + T(visc.follows_slope) * lag_bar * late;
            return whole * s_bar + a * lag_bar;
        };
        for (int e = 0; e < 2; ++e) {
            row_b[e] = strain_bar(row_s[e], row_late[e], LAG_ROW_BAR + e);
            column_b[e] = strain_bar(column_s[e], column_late[e], LAG_COLUMN_BAR + e);
        }
        const T shear_b = strain_bar(shear_s, shear_late, LAG_SHEAR_BAR);
        vec<T> by_u[2], by_v[2];
        cell.edges(row_b, column_b, shear_b, by_u, by_v);
        // and as the edges turn under their stresses
        cell.shear_edges(of_shear, mean_u_bar, mean_v_bar, twist_bar, by_u, by_v);
        for (int e = 0; e < 2; ++e) {
            by_u[e] = by_u[e] + of_row[e] * cell.lx2 * u_bar[e];
            by_v[e] = by_v[e] + of_column[e] * cell.ly2 * v_bar[e];
            at.put3(U_BAR + 3 * e, p, by_u[e]);
            at.put3(V_EDGE_BAR + 3 * e, p, by_v[e]);
        }
        const T two = T(real(2));
        by.add(C11_BAR, p, two * (row_v[0] * row_e[0] + row_v[1] * row_e[1]));
        by.add(C22_BAR, p, two * (column_v[0] * column_e[0] + column_v[1] * column_e[1]));
        by.add(C12_BAR, p, (row_v[0] + row_v[1]) * (column_e[0] + column_e[1]) +
                               (column_v[0] + column_v[1]) * (row_e[0] + row_e[1]));
        by.add(G12_BAR, p, shear_v * shear_e);

        // bending: the pull has minus second differences of the moments
        const shell_bend<T> bend(s, shape, p, pitch);
        const bend_stiffness<T> B(k, m, p);
        const vec<T> two_f = fa + fa;
        const vec<T> mxx_bar = two_f - pulled(p - 1) - fb, myy_bar = two_f - pulled(p - pitch) - fc;
        const vec<T> mxy_bar = fb + fc - fa - fd;
        const vec<T> kappa = bend.curvatures(), late = kappa - s.template get3<T>(LAG_BEND, p);
        const vec<T> lagging = c * late;
        const vec<T> along = B(lagging);
        const vec<T> along_bar = {dot(mxx_bar, bend.n), dot(myy_bar, bend.n), dot(mxy_bar, bend.n)};
        const vec<T> lagging_bar = B(along_bar), lag_bar = b.template get3<T>(LAG_BEND_BAR, p);
        const vec<T> late_bar = c * lagging_bar + a * lag_bar;
        b.put3(LAG_BEND_BAR, p, lag_bar - late_bar);
        damping_bar += T(visc.share_slope) * dot(lagging_bar, late) + T(visc.follows_slope) * dot(lag_bar, late);
        vec<T> n_bar = at.template get3<T>(N_BAR, p) + along.x * mxx_bar + along.y * myy_bar +
                       along.z * mxy_bar + late_bar.x * bend.xx + late_bar.y * bend.yy +
                       late_bar.z * bend.xy;
        at.put3(XX_BAR, p, B.xx * mxx_bar + B.both * myy_bar + late_bar.x * bend.n);
        at.put3(YY_BAR, p, B.yy * myy_bar + B.both * mxx_bar + late_bar.y * bend.n);
        at.put3(XY_BAR, p, B.twist * mxy_bar + late_bar.z * bend.n);
        const vec<T> N_bar = (T(real(1)) / bend.length) * (n_bar - dot(n_bar, bend.n) * bend.n);
        at.put3(TX_BAR, p, cross(bend.ty, N_bar));
        at.put3(TY_BAR, p, cross(N_bar, bend.tx));
        const T by_xx = dot(mxx_bar, bend.xx) + along_bar.x * lagging.x;
        const T by_yy = dot(myy_bar, bend.yy) + along_bar.y * lagging.y;
        by.add(BXX_BAR, p, by_xx);
        by.add(BYY_BAR, p, by_yy);
        by.add(BXY_BAR, p, dot(mxx_bar, bend.yy) + dot(myy_bar, bend.xx) +
                               along_bar.x * lagging.y + along_bar.y * lagging.x);
        by.add(TWIST_BAR, p, dot(mxy_bar, bend.xy) + along_bar.z * lagging.z);
        by.add(DAMPING_BAR, p, damping_bar);
    }
}

// Points gather what edges, differences and tangents have for them.
template <typename Model, typename Adjoint>
CUDA_CALLABLE inline void shell_gather_adjoint(const Model& model, const Adjoint& adjoint, int w) {
    typedef decltype(Model::radius) real;
    typedef typename several<real>::lanes T;
    const rows_of<real> b(adjoint.state, w), at(adjoint.scratch, w), shape(model.rest, 0);
    const int pitch = model.pitch;
    for (EACH_IN(p, model.first, model.end)) {
        const int last = p - 1, next = p + 1, above = p - pitch, below = p + pitch, corner = above - 1;
        const auto of = [&](int c, int q) { return at.template get3<T>(c, q); };
        const auto has = [&](int c, int q) { return shape.template get<T>(c, q); };
        // edges u = b - a, d - c, v = c - a, d - b, where the point is a, b, c or d of four cells
        vec<T> x_bar = of(U_BAR, last) - of(U_BAR, p) + of(U_BAR + 3, corner) - of(U_BAR + 3, above) +
                       of(V_EDGE_BAR, above) - of(V_EDGE_BAR, p) + of(V_EDGE_BAR + 3, corner) -
                       of(V_EDGE_BAR + 3, last);
        const T after = has(NEXT, p), before = has(NEXT, last), under = has(BELOW, p), over = has(BELOW, above);
        const auto inner = [&](int c, int q, int by) { return has(c, q) * has(c, q - by); };
        const vec<T> xx = inner(NEXT, p, 1) * of(XX_BAR, p), yy = inner(BELOW, p, pitch) * of(YY_BAR, p);
        x_bar = x_bar + inner(NEXT, last, 1) * of(XX_BAR, last) + inner(NEXT, next, 1) * of(XX_BAR, next) -
                (xx + xx) + inner(BELOW, above, pitch) * of(YY_BAR, above) +
                inner(BELOW, below, pitch) * of(YY_BAR, below) - (yy + yy);
        x_bar = x_bar + has(CELL, p) * of(XY_BAR, p) - has(CELL, last) * of(XY_BAR, last) -
                has(CELL, above) * of(XY_BAR, above) + has(CELL, corner) * of(XY_BAR, corner);
        // tangents: differences to both neighbours that there are
        x_bar = x_bar + (before - after) * of(TX_BAR, p) + before * of(TX_BAR, last) - after * of(TX_BAR, next) +
                (over - under) * of(TY_BAR, p) + over * of(TY_BAR, above) - under * of(TY_BAR, below);
        b.add3(X_BAR, p, x_bar);
    }
}

}  // namespace gendom
