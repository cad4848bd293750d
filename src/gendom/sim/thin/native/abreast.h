// Rods without contact with themselves or obstacles side by side, each in a lane of a CPU's SIMD registers: none is
// padded, and what neighbouring points share is near. CUDA only reads this file.

#if !defined(__CUDA_ARCH__)

namespace gendom {

// What a lane has of each point: its state, then the model's rows as in `registers.h`.
constexpr int point_rows = state_rows + model_rows;

// Components of points from one on, those of a point side by side.
template <typename T> struct along_rod : components<along_rod<T>> {
    T* of;

    inline explicit along_rod(T* of) : of(of) {}
    template <typename> inline T get(int c, int i) const { return of[i * point_rows + c]; }
    inline void put(int c, int i, const T& a) const { of[i * point_rows + c] = a; }
};

// What a step leaves for its second half of a point and its two neighbours.
template <typename T> struct near_point : components<near_point<T>> {
    T *before, *here, *after;

    inline near_point(T* before, T* here, T* after) : before(before), here(here), after(after) {}
    template <typename> inline T get(int c, int i) const { return (i < 0 ? before : i ? after : here)[c]; }
    inline void put(int c, int i, const T& a) const { after[c] = a; }
};

// Of a point that some lanes hold: by which gripper, where in its frame, and in which lanes it and its edge are held.
template <typename real> struct held_point {
    typedef typename several<real>::lanes T;
    int g, i;
    T place[7], point, edge;
};

// A train of rods, in the scratch of its first world.
template <typename real> struct abreast {
    typedef typename several<real>::lanes T;
    static constexpr int lanes = sizeof(T) / sizeof(real);

    T h, kick, keep, share, follows, friction, gravity[3];
    T worst, sum;  // of squared stretches since the last look
    int held;

    template <typename Model> inline static abreast& of(const Model& model, int w) {
        real* first = &wp::index(model.scratch, w, 0, 0);
        return *(abreast*)(((unsigned long long)first + 63) / 64 * 64);
    }
    inline pose<T>* poses() { return (pose<T>*)(this + 1); }
    template <typename Model> inline T* points(const Model& model) {
        return (T*)(poses() + model.holds.shape[1]) + point_rows;  // after one that is not there
    }
    template <typename Model> inline held_point<real>* holds(const Model& model) {
        return (held_point<real>*)(points(model) + (model.points + 1) * point_rows);
    }
};

template <typename real> inline real& lane(typename several<real>::lanes& a, int l) { return ((real*)&a)[l]; }

// State and model of `count` worlds from w on; further lanes are the last one's.
template <typename Model, typename real>
inline void board(const Model& model, int w, int count, const wp::array_t<real>& state) {
    abreast<real>& own = abreast<real>::of(model, w);
    auto* points = own.points(model) - point_rows;
    for (int k = 0; k < (model.points + 2) * point_rows; ++k) points[k] = typename abreast<real>::T(0);
    own.worst = own.sum = typename abreast<real>::T(0);
    own.held = 0;
    for (int l = 0; l < own.lanes; ++l) {
        const int from = w + (l < count ? l : count - 1);
        const rows_of<real> rows[4] = {{state, from}, {model.rest, from}, {model.stiffness, from}, {model.inertia, from}};
        lane<real>(own.friction, l) = wp::index(model.friction, from);
        for (int k = 0; k < 3; ++k) lane<real>(own.gravity[k], l) = wp::index(model.gravity, from)[k];
        int at = 0;
        const int sizes[4] = {state_rows, 7, 6, 4};
        for (int k = 0; k < 4; at += sizes[k++])
            for (int c = 0; c < sizes[k]; ++c)
                for (int i = 0; i < model.points; ++i)
                    lane<real>(points[(i + 1) * point_rows + at + c], l) = rows[k].at(c, i);
    }
    for (int g = 0; g < model.holds.shape[1]; ++g)
        for (int i = 0; i < model.points; ++i) {
            held_point<real>& one = own.holds(model)[own.held];
            int any = 0;
            for (int l = 0; l < own.lanes; ++l) {
                const int from = w + (l < count ? l : count - 1), held = wp::index(model.holds, from, g, i);
                const rows_of<real> place(model.place, from * model.holds.shape[1] + g);
                any |= held;
                lane<real>(one.point, l) = real(held & 1);
                lane<real>(one.edge, l) = real(held >> 1 & 1);
                for (int c = 0; c < 7; ++c) lane<real>(one.place[c], l) = place.at(c, i);
            }
            one.g = g, one.i = i;
            own.held += any ? 1 : 0;
        }
}

// A lane's state to or from a row.
template <typename Model, typename real>
inline void alight(const Model& model, int w, int l, const wp::array_t<real>& state, int row) {
    auto* points = abreast<real>::of(model, w).points(model);
    const rows_of<real> to(state, row);
    for (int c = 0; c < state_rows; ++c)
        for (int i = 0; i < model.points; ++i) to.at(c, i) = lane<real>(points[i * point_rows + c], l);
}
template <typename Model, typename real>
inline void reboard(const Model& model, int w, int l, const wp::array_t<real>& state, int row) {
    auto* points = abreast<real>::of(model, w).points(model);
    const rows_of<real> from(state, row);
    for (int c = 0; c < state_rows; ++c)
        for (int i = 0; i < model.points; ++i) lane<real>(points[i * point_rows + c], l) = from.at(c, i);
}

template <typename Model, typename real>
inline void set_pace(const Model& model, int w, int l, real dt, real kick) {
    abreast<real>& own = abreast<real>::of(model, w);
    const viscosity<real> visc(wp::index(model.damping, w + l), dt);
    lane<real>(own.h, l) = dt;
    lane<real>(own.kick, l) = kick;
    lane<real>(own.keep, l) = wp::exp(-kick * wp::index(model.velocity_damping, w + l));
    lane<real>(own.share, l) = visc.share;
    lane<real>(own.follows, l) = visc.follows;
}

template <typename Model, typename real>
inline void set_pose(const Model& model, int w, int l, int g, const wp::vec_t<3, real>& c, const wp::quat_t<real>& q) {
    pose<typename abreast<real>::T>& at = abreast<real>::of(model, w).poses()[g];
    lane<real>(at.centre.x, l) = c[0], lane<real>(at.centre.y, l) = c[1], lane<real>(at.centre.z, l) = c[2];
    lane<real>(at.by.v.x, l) = q.x, lane<real>(at.by.v.y, l) = q.y, lane<real>(at.by.v.z, l) = q.z;
    lane<real>(at.by.w, l) = q.w;
}

// a where a mask is 1, else b.
template <typename T> inline T chosen(const T& mask, const T& a, const T& b) { return mask != T(0) ? a : b; }
template <typename T> inline vec<T> chosen(const T& mask, const vec<T>& a, const vec<T>& b) {
    return {chosen(mask, a.x, b.x), chosen(mask, a.y, b.y), chosen(mask, a.z, b.z)};
}

template <typename real, typename Model> inline void step_abreast(const Model& model, int w) {
    typedef typename several<real>::lanes T;
    abreast<real>& own = abreast<real>::of(model, w);
    T left[3][scratch_rows];
    for (int k = 0; k < scratch_rows; ++k) left[2][k] = T(0);  // of what is before the first
    T *before = left[1], *here = left[2], *after = left[0];
    const int n = model.points;
    T* const first = own.points(model);
    const vec<T> g = {own.gravity[0], own.gravity[1], own.gravity[2]};
    const motion<T, on_table<T>> go(own.kick, own.keep, g, {own.h, own.friction, T(model.radius), bool(model.table)});
    const T c = own.share, a = own.follows;
    T worst = own.worst, sum = own.sum;
    for (T* at = first; at <= first + n * point_rows; at += point_rows) {
        const near_point<T> late(before, here, after);
        const along_rod<T> s(at), rest(at + state_rows), k(rest.of + 7), m(k.of + 6);
        const T stretch = rod_forces_at(0, s, s, late, rest, k, m, c, a);
        worst = stretch > worst ? stretch : worst;
        sum += stretch;
        if (at > first) {
            const along_rod<T> last(at - point_rows), m_last(m.of - point_rows);
            rod_move_at(0, last, last, late, m_last, go);
        }
        T* const free = before;
        before = here, here = after, after = free;
    }
    own.worst = worst;
    own.sum = sum;
    const along_rod<T> s(first);
    const vec<T> still = {T(0), T(0), T(0)};
    const held_point<real>* held = own.holds(model);
    for (int j = 0; j < own.held; ++j) {
        const held_point<real>& one = held[j];
        const pose<T>& at = own.poses()[one.g];
        const int i = one.i;
        const vec<T> away = directors<T>(at.by).to_world({one.place[0], one.place[1], one.place[2]});
        s.put3(X, i, chosen(one.point, at.centre + away, s.template get3<T>(X, i)));
        s.put3(V, i, chosen(one.point, still, s.template get3<T>(V, i)));
        const quat<T> q = at.by * quat<T>{{one.place[3], one.place[4], one.place[5]}, one.place[6]};
        const quat<T> was = s.template get4<T>(Q, i);
        const T side = T(1) - T(2) * is_above(T(0), dot(q.v, was.v) + q.w * was.w);
        s.put4(Q, i, quat<T>{chosen(one.edge, side * q.v, was.v), chosen(one.edge, side * q.w, was.w)});
        s.put3(W, i, chosen(one.edge, still, s.template get3<T>(W, i)));
    }
}

// Whether a lane's rod was stretched beyond limits since the last look: the square of an edge's, and the mean.
template <typename Model, typename real>
inline int overstretched(const Model& model, int w, int l, real limit, real mean_limit) {
    typedef typename several<real>::lanes T;
    abreast<real>& own = abreast<real>::of(model, w);
    const along_rod<T> s(own.points(model)), rest(s.of + state_rows);
    T all = T(0);
    for (int i = 0; i < model.points - 1; ++i) {
        const vec<T> d = s.template get3<T>(X, i + 1) - s.template get3<T>(X, i);
        const T stretch = root(dot(d, d)) * rest.template get<T>(PER_LENGTH, i) - T(1);
        all += larger(stretch, -stretch);
    }
    const real sum = lane<real>(own.sum, l), worst = lane<real>(own.worst, l);
    lane<real>(own.worst, l) = lane<real>(own.sum, l) = real(0);
    return sum == sum && worst <= limit && lane<real>(all, l) / real(model.points - 1) <= mean_limit ? 0 : 1;
}

// Where a point is.
template <typename real, typename Model> inline wp::vec_t<3, real> seen(const Model& model, int w, int l, int i) {
    auto* at = abreast<real>::of(model, w).points(model) + i * point_rows;
    return {lane<real>(at[X], l), lane<real>(at[X + 1], l), lane<real>(at[X + 2], l)};
}

}  // namespace gendom

#endif
