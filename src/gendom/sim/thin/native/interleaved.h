// Rods that meet neither obstacles nor themselves side by side, each in a lane of a CPU's SIMD registers: no lane is
// empty, and a step is one loop over points. CUDA has no use for this file.

#if !defined(__CUDA_ARCH__)

namespace gendom {

// What there is of each point: its state, and the model's rows in the order of `fixed_rows`.
constexpr int point_rows = state_rows + model_rows;

// Components of points near one, those of a point side by side.
template <typename T> struct along_rod : components<along_rod<T>> {
    T* of;

    inline explicit along_rod(T* of) : of(of) {}
    template <typename> inline T get(int c, int i) const { return of[i * point_rows + c]; }
    inline void put(int c, int i, const T& a) const { of[i * point_rows + c] = a; }
};

// What a step's first half leaves of a point and the two before for the second.
template <typename T> struct last_points : components<last_points<T>> {
    T* of[3];

    inline last_points(T* a, T* b, T* c) : of{a, b, c} {}
    template <typename> inline T get(int c, int i) const { return of[i + 2][c]; }
    inline void put(int c, int, const T& a) const { of[2][c] = a; }
};

// A point that some lanes hold: by which gripper, where it is in its frame, and whether it and its edge are held.
template <typename T> struct held_point {
    int g, i;
    vec<T> x;
    quat<T> q;
    T point, edge;
};

// What a group of rods shares; then come poses of grippers, points, and held ones. `ThinEngine` makes room for all, see `of`.
template <typename real> struct interleaved {
    typedef typename several<real>::lanes T;
    static constexpr int lanes = sizeof(T) / sizeof(real);

    T h, kick, keep, share, follows, friction;
    vec<T> gravity;
    T worst, sum;  // of squared stretches since the last look
    int held;

    template <typename Model> static inline interleaved& of(const Model& model, int w) {
        static_assert(sizeof(interleaved) <= 12 * sizeof(T) && sizeof(held_point<T>) <= 10 * sizeof(T) && point_rows <= 36);
        return *(interleaved*)(((unsigned long long)&wp::index(model.interleaved, w, 0) + 63) / 64 * 64);
    }
    inline pose<T>* poses() { return (pose<T>*)(this + 1); }
    template <typename Model> inline T* points(const Model& model) {
        return (T*)(poses() + model.holds.shape[1]) + point_rows;  // after one that is not there
    }
    template <typename Model> inline held_point<T>* holds(const Model& model) {
        return (held_point<T>*)(points(model) + (model.points + 1) * point_rows);
    }
    static inline real& lane(T& a, int l) { return ((real*)&a)[l]; }
    static inline void set(vec<T>& a, int l, real x, real y, real z) {
        lane(a.x, l) = x, lane(a.y, l) = y, lane(a.z, l) = z;
    }
};

// Copies `count` components of all points, from a first one on, to a lane, or from there.
template <bool to_lane, typename Model, typename real>
inline void copy_lane(const Model& model, int w, int l, const rows_of<real>& rows, int first, int count) {
    auto* points = interleaved<real>::of(model, w).points(model) + first;
    for (int c = 0; c < count; ++c)
        for (int i = 0; i < model.points; ++i) {
            real& own = interleaved<real>::lane(points[i * point_rows + c], l);
            if (to_lane) own = rows.at(c, i);
            else rows.at(c, i) = own;
        }
}

// State and model of `count` worlds from w on; lanes beyond are the last one's.
template <typename Model, typename real>
inline void load_lanes(const Model& model, int w, int count, const wp::array_t<real>& state) {
    interleaved<real>& own = interleaved<real>::of(model, w);
    for (int k = -point_rows; k < (model.points + 1) * point_rows; ++k) own.points(model)[k] = 0;
    own.worst = own.sum = 0;
    own.held = 0;
    for (int l = 0; l < own.lanes; ++l) {
        const int from = w + (l < count ? l : count - 1);
        const auto& g = wp::index(model.gravity, from);
        own.set(own.gravity, l, g[0], g[1], g[2]);
        own.lane(own.friction, l) = wp::index(model.friction, from);
        copy_lane<true, Model, real>(model, w, l, {state, from}, 0, state_rows);
        copy_lane<true, Model, real>(model, w, l, {model.rest, from}, state_rows, 7);
        copy_lane<true, Model, real>(model, w, l, {model.stiffness, from}, state_rows + 7, 6);
        copy_lane<true, Model, real>(model, w, l, {model.inertia, from}, state_rows + 13, 4);
    }
    for (int g = 0; g < model.holds.shape[1]; ++g)
        for (int i = 0; i < model.points; ++i) {
            auto& one = own.holds(model)[own.held];
            int any = 0;
            one.g = g, one.i = i;
            for (int l = 0; l < own.lanes; ++l) {
                const int from = w + (l < count ? l : count - 1), held = wp::index(model.holds, from, g, i);
                const rows_of<real> at(model.place, from * model.holds.shape[1] + g);
                own.set(one.x, l, at.at(0, i), at.at(1, i), at.at(2, i));
                own.set(one.q.v, l, at.at(3, i), at.at(4, i), at.at(5, i));
                own.lane(one.q.w, l) = at.at(6, i);
                own.lane(one.point, l) = real(held & 1), own.lane(one.edge, l) = real(held >> 1);
                any |= held;
            }
            if (any) ++own.held;
        }
}

template <typename Model, typename real>
inline void set_step(const Model& model, int w, int l, real dt, real kick) {
    interleaved<real>& own = interleaved<real>::of(model, w);
    const viscosity<real> visc(wp::index(model.damping, w + l), dt);
    own.lane(own.h, l) = dt, own.lane(own.kick, l) = kick;
    own.lane(own.keep, l) = wp::exp(-kick * wp::index(model.velocity_damping, w + l));
    own.lane(own.share, l) = visc.share, own.lane(own.follows, l) = visc.follows;
}

template <typename Model, typename real>
inline void set_pose(const Model& model, int w, int l, int g, const wp::vec_t<3, real>& c, const wp::quat_t<real>& q) {
    interleaved<real>& own = interleaved<real>::of(model, w);
    auto& at = own.poses()[g];
    own.set(at.centre, l, c[0], c[1], c[2]), own.set(at.by.v, l, q.x, q.y, q.z);
    own.lane(at.by.w, l) = q.w;
}

// a where something holds, else b.
template <typename T> inline T chosen(const T& holds, const T& a, const T& b) { return holds != T(0) ? a : b; }
template <typename T> inline vec<T> chosen(const T& holds, const vec<T>& a, const vec<T>& b) {
    return {chosen(holds, a.x, b.x), chosen(holds, a.y, b.y), chosen(holds, a.z, b.z)};
}

// As `rod_forces`, `rod_move` and `hold`.
template <typename real, typename Model> inline void step_interleaved(const Model& model, int w) {
    typedef typename several<real>::lanes T;
    interleaved<real>& own = interleaved<real>::of(model, w);
    const on_table<T> around = {own.h, own.friction, T(model.radius), bool(model.table)};
    const motion<T, on_table<T>> go(own.kick, own.keep, own.gravity, around);
    const T c = own.share, a = own.follows;
    T* const first = own.points(model);
    T left[3][scratch_rows], worst = own.worst, sum = own.sum;
    for (T& of : left[2]) of = 0;  // before the first point
    last_points<T> late(left[0], left[1], left[2]);
    for (T* at = first; at <= first + model.points * point_rows; at += point_rows) {
        const along_rod<T> s(at), rest(at + state_rows), k(rest.of + 7), m(k.of + 6);
        late = {late.of[1], late.of[2], late.of[0]};
        const T stretch = rod_forces_at(0, s, s, late, rest, k, m, c, a);
        worst = stretch > worst ? stretch : worst;
        sum += stretch;
        if (at > first) rod_move_at(-1, s, s, late, m, go);
    }
    own.worst = worst, own.sum = sum;
    const along_rod<T> s(first);
    const vec<T> still = {T(real(0)), T(real(0)), T(real(0))};
    for (int j = 0; j < own.held; ++j) {
        const held_point<T>& one = own.holds(model)[j];
        const pose<T>& at = own.poses()[one.g];
        const vec<T> x = at.centre + directors<T>(at.by).to_world(one.x);
        s.put3(X, one.i, chosen(one.point, x, s.template get3<T>(X, one.i)));
        s.put3(V, one.i, chosen(one.point, still, s.template get3<T>(V, one.i)));
        const quat<T> q = at.by * one.q, was = s.template get4<T>(Q, one.i);
        const T side = T(real(1)) - T(real(2)) * is_above(T(real(0)), dot(q.v, was.v) + q.w * was.w);
        s.put4(Q, one.i, quat<T>{chosen(one.edge, side * q.v, was.v), chosen(one.edge, side * q.w, was.w)});
        s.put3(W, one.i, chosen(one.edge, still, s.template get3<T>(W, one.i)));
    }
}

// As `rod_forces` returns it, of a lane's steps since the last look.
template <typename real, typename Model> inline real worst_stretch(const Model& model, int w, int l) {
    interleaved<real>& own = interleaved<real>::of(model, w);
    real &sum = own.lane(own.sum, l), &worst = own.lane(own.worst, l);
    const real found = sum == sum ? worst : sum;
    sum = worst = real(0);
    return found;
}

}  // namespace gendom

#endif
