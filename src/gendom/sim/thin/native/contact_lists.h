// Which features of a thin body may touch, and where two of them are nearest.
//
// Edges meet edges, and of shells points meet triangles: the two of a cell, on either side of its
// diagonal b c. Pairs that may meet are listed with a margin, and listed anew once a point has moved by half of
// that against the body's middle; the list depends on nothing but where points were then. Of the list, a step's
// turns go over those that are close when they begin. Nearest places: Ericson (2005), "Real-Time Collision
// Detection", chapter 5.

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

// The points of a triangle, of an edge (the second one twice), or one point (three times).
struct feature { int i, j, k; };

CUDA_CALLABLE inline feature edge_of(int p, int kind, int pitch) {
    const int to = kind == 0 ? p + 1 : p + pitch;
    return {kind == 2 ? p + 1 : p, to, to};
}

// The pair that two numbers of the list stand for; each is a point times 4 and a kind: an edge to the
// next point, to the one below, or a cell's diagonal; or 3: the point itself, against one of two
// triangles of the other number's cell.
struct feature_pair {
    feature first, second;
    bool has_point;

    CUDA_CALLABLE inline feature_pair(int one, int other, int pitch) : has_point(one % 4 == 3) {
        const int p = one / 4, a = one % 4, q = other / 4, b = other % 4;
        if (has_point) first = {p, p, p}, second = {b == 0 ? q : q + pitch + 1, q + 1, q + pitch};
        else first = edge_of(p, a, pitch), second = edge_of(q, b, pitch);
    }
    template <typename real> CUDA_CALLABLE inline meeting<real> meet(const rows_of<real>& s) const {
        return has_point ? point_meets(s, first.i, second.i, second.j, second.k)
                         : edges_meet(s, first.i, first.j, second.i, second.j);
    }
};

// A box along the axes, by its lowest and its highest corner.
template <typename T> struct box {
    vec<T> low, high;

    CUDA_CALLABLE inline void include(const vec<T>& x) {
        low = {wp::min(low.x, x.x), wp::min(low.y, x.y), wp::min(low.z, x.z)};
        high = {larger(high.x, x.x), larger(high.y, x.y), larger(high.z, x.z)};
    }
};
// The square of the distance between two boxes.
template <typename T> CUDA_CALLABLE inline T gap_between(const box<T>& a, const box<T>& b) {
    typedef typename number_of<T>::type real;
    const auto gap = [](T low, T high, T other_low, T other_high) {
        return larger(larger(other_low - high, low - other_high), T(real(0)));
    };
    const T x = gap(a.low.x, a.high.x, b.low.x, b.high.x), y = gap(a.low.y, a.high.y, b.low.y, b.high.y);
    const T z = gap(a.low.z, a.high.z, b.low.z, b.high.z);
    return x * x + y * y + z * z;
}
template <typename real>
CUDA_CALLABLE inline box<real> box_of(const rows_of<real>& s, const feature& f) {
    const vec<real> x = s.template get3<real>(0, f.i);
    box<real> b = {x, x};
    b.include(s.template get3<real>(0, f.j)), b.include(s.template get3<real>(0, f.k));
    return b;
}

// On CUDA a model whose scratch, and what else lives no longer than a step, is in shared memory, where it is 0.
template <typename Model> CUDA_CALLABLE inline void move_to_shared(Model& model, int w) {
#if defined(__CUDA_ARCH__)
    typedef decltype(Model::radius) real;
    extern __shared__ __align__(16) unsigned char gendom_shared[];
    real* const to = (real*)gendom_shared;
    const int numbers = model.scratch.strides[0] / sizeof(real);
    for (int i = threadIdx.x; i < numbers; i += blockDim.x) to[i] = real(0);
    model.scratch.data = to - w * numbers;
    model.boxes.data = to - w * (model.boxes.strides[0] / sizeof(real));
    model.in_shared = 1;
    block_sync();
#endif
}

// Adds 1 and returns what was there.
CUDA_CALLABLE inline int count_on(int& count) {
#if defined(__CUDA_ARCH__)
    return atomicAdd(&count, 1);
#else
    return count++;
#endif
}

// The pairs of a world's list. On CUDA points against triangles are listed from the back of the array, so
// that neighbouring threads do alike. Two counts say how many are listed from either end.
struct pairs_of {
    const wp::array_t<int>&pairs, &counts;
    const int w, room;

    CUDA_CALLABLE inline pairs_of(const wp::array_t<int>& pairs, const wp::array_t<int>& counts, int w)
        : pairs(pairs), counts(counts), w(w), room(pairs.shape[1]) {}

    CUDA_CALLABLE inline int number() const {
        return wp::min(wp::index(counts, w, 0) + wp::index(counts, w, 1), room);
    }
    CUDA_CALLABLE inline void read(int k, int& one, int& other) const {
        const int front = wp::index(counts, w, 0), at = k < front ? k : room - 1 - (k - front);
        one = wp::index(pairs, w, at, 0), other = wp::index(pairs, w, at, 1);
    }
    // A full list only counts on.
    CUDA_CALLABLE inline void append(int one, int other) const {
#if defined(__CUDA_ARCH__)
        const int end = one % 4 == 3 ? 1 : 0;
#else
        const int end = 0;
#endif
        const int k = count_on(wp::index(counts, w, end));
        if (k >= room) return;
        const int at = end == 0 ? k : room - 1 - k;
        wp::index(pairs, w, at, 0) = one, wp::index(pairs, w, at, 1) = other;
    }
    CUDA_CALLABLE inline void clear() const {
        wp::index(counts, w, 0) = 0, wp::index(counts, w, 1) = 0;
    }
};
template <typename Model> CUDA_CALLABLE inline pairs_of near_pairs(const Model& model, int w) {
    return pairs_of(model.near, model.near_count, w);
}
template <typename Model> CUDA_CALLABLE inline pairs_of close_pairs(const Model& model, int w) {
    return pairs_of(model.close, model.close_count, w);
}

template <typename Model, typename real>
CUDA_CALLABLE inline void list_pair(const Model& model, int w, const rows_of<real>& s, int one, int other) {
    const meeting<real> m = feature_pair(one, other, model.pitch).meet(s);
    const int* i = m.point;
    const int own = one % 4 == 3 ? 1 : 2;  // points of the first feature; the rest are the second's
    for (int a = 0; a < own; ++a)
        for (int b = own; b < 4; ++b)
            if (i[a] == i[b]) return;
    if (m.distance >= model.contact_distance + model.contact_margin) return;
    near_pairs(model, w).append(one, other);
}

// Copies rows of numbers from c on to those from d on.
template <typename Model, typename real>
CUDA_CALLABLE inline void copy_rows(const Model& model, int count, const rows_of<real>& from, int c,
                                    const rows_of<real>& to, int d) {
    typedef typename several<real>::lanes T;
    for (EACH_IN(p, model.first, model.end))
        for (int n = 0; n < count; ++n) to.put(d + n, p, from.template get<T>(c + n, p));
}

// Whether a point of rows c to c + 2 is farther than this from where it was when pairs were listed. What the
// middle of the body has moved by, all have in common, and no pair comes nearer by it.
template <typename Model, typename real>
CUDA_CALLABLE inline int moved_on(const Model& model, int w, const wp::array_t<real>& state, int row, int c,
                                  real far) {
    typedef typename several<real>::lanes T;
    const rows_of<real> s(state, row), then(model.listed, w), m(model.inertia, w);
    const int middle = wp::index(model.slot, model.points / 2) - margin;
    vec<real> common = s.template get3<real>(c, middle) - then.template get3<real>(0, middle);
    if (far <= real(0)) common = {real(0), real(0), real(0)};
    const vec<T> shift = {T(common.x), T(common.y), T(common.z)};
    T most = T(real(0));
    for (EACH_IN(p, model.first, model.end)) {
        const vec<T> d = s.template get3<T>(c, p) - then.template get3<T>(0, p) - shift;
        most = larger(most, dot(d, d) * is_above(m.template get<T>(0, p), T(real(0))));
    }
    return largest_of(most) <= far * far ? 0 : 1;
}

// Rows of boxes: the lowest and highest corners, whether a shell is folded at a point, and where that is.
enum { FOLDED = 6, PLACE = 7 };

template <typename real> CUDA_CALLABLE inline box<real> box_at(const rows_of<real>& boxes, int i) {
    return {boxes.template get3<real>(0, i), boxes.template get3<real>(3, i)};
}

// Whether a point of a shell is much nearer than at rest to one that is at most three columns and rows away.
template <typename Model, typename real>
CUDA_CALLABLE inline bool is_folded(const Model& model, const rows_of<real>& s, const rows_of<real>& m, int c, int p) {
    const vec<real> x = s.template get3<real>(c, p);
    bool folded = false;
    for (int rows = -3; rows <= 3; ++rows) {
        const int q = p + rows * model.pitch;
        if (q < model.first || q >= model.end) continue;
        for (int columns = -3; columns <= 3; ++columns) {
            const vec<real> d = s.template get3<real>(c, q + columns) - x;
            const real along = real(columns) / model.per_x, across = real(rows) / model.per_y;
            folded |= (dot(d, d) < real(0.64) * (along * along + across * across)) &
                      (m.template get<real>(0, q + columns) > real(0));
        }
    }
    return folded;
}

// Begins a list of points in rows c to c + 2, with the box of each one's features, which of a shell lie in the
// cell that it is the first of; the threads meet before `list_pairs`.
template <typename Model, typename real>
CUDA_CALLABLE inline void begin_list(const Model& model, int w, const wp::array_t<real>& state, int row,
                                     int c) {
    const rows_of<real> s(state, row), then(model.listed, w), rest(model.rest, 0), m(model.inertia, w),
        boxes(model.boxes, w);
    copy_rows(model, 3, s, c, then, 0), copy_rows(model, 3, s, c, boxes, PLACE);
    const int pitch = model.pitch;
    for (EACH_ONE_IN(p, model.first, model.end)) {
        const auto has = [&](int kind) { return pitch > 0 && rest.template get<real>(kind, p) > real(0); };
        const auto is_point = [&](int i) { return m.template get<real>(0, i) > real(0); };
        const real nowhere = real(1e15);
        box<real> b = {{nowhere, nowhere, nowhere}, {-nowhere, -nowhere, -nowhere}};
        if (is_point(p)) b.include(s.template get3<real>(c, p));
        if (pitch == 0 ? is_point(p) && is_point(p + 1) : has(0) || has(2))
            b.include(s.template get3<real>(c, p + 1));
        if (has(1) || has(2)) b.include(s.template get3<real>(c, p + pitch));
        if (has(2)) b.include(s.template get3<real>(c, p + pitch + 1));
        boxes.put3(0, p, b.low), boxes.put3(3, p, b.high);
        if (pitch > 0) boxes.put(FOLDED, p, real(is_folded(model, s, m, c, p)));
    }
    near_pairs(model, w).clear();
}

// Features of two points make so many pairs.
enum { PAIRS_OF_EDGES = 9, PAIRS_OF_CELLS = 13 };

// The k-th of them, in numbers of the list; tells whether it is there. Of a rod there is one.
template <typename Model, typename real>
CUDA_CALLABLE inline bool pair_of(const Model& model, const rows_of<real>& rest, const rows_of<real>& inertia,
                                  int p, int q, int k, int& one, int& other) {
    const auto has = [&](int i, int kind) { return rest.template get<real>(kind, i) > real(0); };
    if (model.pitch == 0) {
        one = 4 * p, other = 4 * q;
        const auto is_point = [&](int i) { return inertia.template get<real>(0, i) > real(0); };
        return k == 0 && is_point(p + 1) && is_point(q + 1);
    }
    if (k < PAIRS_OF_EDGES) {
        one = 4 * p + k / 3, other = 4 * q + k % 3;
        return has(p, k / 3) && has(q, k % 3);
    }
    const int triangle = (k - PAIRS_OF_EDGES) / 2;
    const bool of_second = (k - PAIRS_OF_EDGES) % 2 == 0;
    const int point = of_second ? p : q, cell = of_second ? q : p;
    one = 4 * point + 3, other = 4 * cell + triangle;
    return has(cell, 2);
}

// Lists those of the listed pairs that may play a part in a step's contacts.
template <typename Model, typename real>
CUDA_CALLABLE inline void list_close(const Model& model, int w, const wp::array_t<real>& state, int row) {
    const rows_of<real> s(state, row);
    const pairs_of near = near_pairs(model, w), close = close_pairs(model, w);
    const real far = real(1.25) * model.contact_distance;
    close.clear();
    block_sync();
    for (EACH_ONE_IN(k, 0, near.number())) {
        int one, other;
        near.read(k, one, other);
        if (feature_pair(one, other, model.pitch).meet(s).distance < far) close.append(one, other);
    }
    block_sync();
}

// Whether features of p and of q > p never meet: those of a rod's neighbours, and of a shell's where it is not folded.
template <typename Model>
CUDA_CALLABLE inline bool is_neighbour(const Model& model, int p, int q, bool folded) {
    const int pitch = model.pitch;
    if (pitch == 0) return q - p < model.contact_apart;
    if (folded || q - p > 2 * pitch + 2) return false;
    const int columns = p % pitch - q % pitch, rows = p / pitch - q / pitch;
    return columns <= 2 && columns >= -2 && rows >= -2;
}

// Whether one of the corners of a point's cell is folded.
template <typename Model, typename real>
CUDA_CALLABLE inline bool cell_is_folded(const Model& model, const rows_of<real>& boxes, int p) {
    const auto at = [&](int i) { return boxes.template get<real>(FOLDED, i); };
    return model.pitch > 0 && at(p) + at(p + 1) + at(p + model.pitch) + at(p + model.pitch + 1) > real(0);
}

// A cell that is folded on its diagonal.
template <typename Model, typename real>
CUDA_CALLABLE inline void list_folded_cells(const Model& model, int w, const rows_of<real>& s,
                                            const rows_of<real>& rest) {
    const real whole = real(1) / (model.per_x * model.per_x) + real(1) / (model.per_y * model.per_y);
    for (EACH_ONE_IN(p, model.first, model.end)) {
        if (!(rest.template get<real>(2, p) > real(0))) continue;
        const vec<real> across =
            s.template get3<real>(0, p + model.pitch + 1) - s.template get3<real>(0, p);
        if (dot(across, across) < real(0.64) * whole) list_pair(model, w, s, 4 * p + 3, 4 * p + 1);
    }
}

// Pairs of features that may come within this distance of each other, by their boxes.
template <typename real> struct may_meet {
    const rows_of<real>& s;
    const int pitch;
    const real far2;

    CUDA_CALLABLE inline bool operator()(int one, int other) const {
        const feature_pair pair(one, other, pitch);
        return gap_between(box_of(s, pair.first), box_of(s, pair.second)) < far2;
    }
};

#if defined(__CUDA_ARCH__)

// A warp takes a point. Its lanes compare that one's box with those of 32 others; each half of them then looks at
// the pairs of features of one hit. What may meet waits until there are enough for all lanes.
template <typename Model> CUDA_CALLABLE inline void list_pairs(const Model& model, int w) {
    typedef decltype(Model::radius) real;
    const rows_of<real> boxes(model.boxes, w), s(&boxes.at(PLACE, 0), boxes.pitch), rest(model.rest, 0),
        m(model.inertia, w);
    constexpr int lanes = 32, most_warps = 8, half = lanes / 2;
    constexpr unsigned all = 0xffffffffu;
    __shared__ int waiting[most_warps][2 * lanes][2];
    const int lane = threadIdx.x % lanes, warp = threadIdx.x / lanes, warps = blockDim.x / lanes;
    const real far = model.contact_distance + model.contact_margin;
    const may_meet<real> may = {s, model.pitch, far * far};
    int count = 0;
    for (int p = model.first + warp; p < model.end; p += warps) {
        if (!(m.template get<real>(0, p) > real(0))) continue;
        const box<real> b = box_at(boxes, p);
        const bool folded = cell_is_folded(model, boxes, p);
        for (int q0 = p + 1; q0 < model.end; q0 += lanes) {
            const int q = q0 + lane;
            const bool is_near = q < model.end && gap_between(b, box_at(boxes, q)) < far * far &&
                                 !is_neighbour(model, p, q, folded);
            unsigned hits = __ballot_sync(all, is_near);
            while (hits != 0) {
                const int first = __ffs(hits) - 1;
                hits &= hits - 1;
                const int second = __ffs(hits) - 1;  // -1: none
                hits &= hits - 1;
                const int mine = lane < half ? first : second, k = lane % half;
                int one = 0, other = 0;
                const bool may_touch = mine >= 0 && k < (model.pitch == 0 ? 1 : PAIRS_OF_CELLS) &&
                                       pair_of(model, rest, m, p, q0 + mine, k, one, other) &&
                                       may(one, other);
                const unsigned found = __ballot_sync(all, may_touch);
                if (may_touch) {
                    int* to = waiting[warp][count + __popc(found & ((1u << lane) - 1u))];
                    to[0] = one, to[1] = other;
                }
                count += __popc(found);
                __syncwarp();
                if (count >= lanes) {
                    count -= lanes;
                    const int* from = waiting[warp][count + lane];
                    list_pair(model, w, s, from[0], from[1]);
                    __syncwarp();
                }
            }
        }
    }
    if (lane < count) list_pair(model, w, s, waiting[warp][lane][0], waiting[warp][lane][1]);
    if (model.pitch > 0) list_folded_cells(model, w, s, rest);
}

#else

template <typename Model> CUDA_CALLABLE inline void list_pairs(const Model& model, int w) {
    typedef decltype(Model::radius) real;
    typedef typename several<real>::lanes T;
    const rows_of<real> boxes(model.boxes, w), s(&boxes.at(PLACE, 0), boxes.pitch), rest(model.rest, 0),
        m(model.inertia, w);
    const int width = sizeof(T) / sizeof(real);
    const real far = model.contact_distance + model.contact_margin;
    const may_meet<real> may = {s, model.pitch, far * far};
    const T limit = T(far * far);
    const auto everywhere = [](const vec<real>& x) -> vec<T> { return {T(x.x), T(x.y), T(x.z)}; };
    for (int p = model.first; p < model.end; ++p) {
        if (!(m.template get<real>(0, p) > real(0))) continue;
        const box<T> b = {everywhere(boxes.template get3<real>(0, p)),
                          everywhere(boxes.template get3<real>(3, p))};
        const bool folded = cell_is_folded(model, boxes, p);
        for (int q0 = (p + 1) / width * width; q0 < model.end; q0 += width) {
            const box<T> others = {boxes.template get3<T>(0, q0), boxes.template get3<T>(3, q0)};
            const T is_near = is_above(limit, gap_between(b, others));
            if (largest_of(is_near) == real(0)) continue;
            for (int l = 0; l < width; ++l) {
                const int q = q0 + l;
                if (((const real*)&is_near)[l] == real(0) || q <= p || q >= model.end ||
                    is_neighbour(model, p, q, folded))
                    continue;
                int one, other;
                for (int k = 0; k < (model.pitch == 0 ? 1 : PAIRS_OF_CELLS); ++k)
                    if (pair_of(model, rest, m, p, q, k, one, other) && may(one, other))
                        list_pair(model, w, s, one, other);
            }
        }
    }
    if (model.pitch > 0) list_folded_cells(model, w, s, rest);
}

#endif

// Lists pairs anew if a point of rows c to c + 2 has moved farther than this.
template <typename Model, typename real>
CUDA_CALLABLE inline void rebuild_lists(const Model& model, int w, const wp::array_t<real>& state, int row,
                                        int c, real far) {
    if (!block_any(moved_on(model, w, state, row, c, far))) return;
    begin_list(model, w, state, row, c);
    block_sync();
    list_pairs(model, w);
    block_sync();
}

// A state keeps where points were when pairs were listed.
template <typename Model, typename real>
CUDA_CALLABLE inline void keep_list(const Model& model, int w, const wp::array_t<real>& state, int row, int c) {
    copy_rows(model, 3, rows_of<real>(model.listed, w), 0, rows_of<real>(state, row), c);
}

}  // namespace gendom
