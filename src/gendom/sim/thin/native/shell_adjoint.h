// The transpose of a shell's step, see ``rod_adjoint.h``.
#pragma once

namespace gendom {

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
