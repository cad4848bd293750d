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

// CUDA kernels that know the length of rows have in shared memory what lives no longer than a step: the scratch, and,
// when that is not needed, places and velocities, what contacts add to them, and boxes; and what is `loose`.
enum {
    SHARED_SCRATCH = 0, SHARED_STATE = 0, SHARED_PUSH = 6, SHARED_BOXES = 6, SHARED_TOUCHING = 18, SHARED_LOOSE = 21,
    SHARED_ROWS = 22
};
#if defined(__CUDA_ARCH__) && defined(ROW_LENGTH)
#define IN_SHARED
#endif
template <typename real>
CUDA_CALLABLE inline rows_of<real> shared_or(int row, const wp::array_t<real>& array, int w) {
#if defined(IN_SHARED)
    extern __shared__ __align__(16) unsigned char gendom_shared[];
    return {(real*)gendom_shared + row * ROW_LENGTH + margin, ROW_LENGTH};
#else
    return {array, w};
#endif
}

// Copies rows of numbers from c on to those from d on.
template <typename Model, typename real>
CUDA_CALLABLE inline void copy_rows(const Model& model, int count, const rows_of<real>& from, int c,
                                    const rows_of<real>& to, int d) {
    typedef typename several<real>::lanes T;
    for (EACH_IN(p, model.first, model.end))
        for (int n = 0; n < count; ++n) to.put(d + n, p, from.template get<T>(c + n, p));
}

// Shared memory as a kernel begins.
template <typename Model> CUDA_CALLABLE inline void begin_shared(const Model& model, int w) {
#if defined(IN_SHARED)
    typedef decltype(Model::radius) real;
    const rows_of<real> all = shared_or(0, model.scratch, w), loose = shared_or(SHARED_LOOSE, model.loose, w);
    for (int i = threadIdx.x; i < SHARED_ROWS * ROW_LENGTH; i += blockDim.x) all.first[i - margin] = real(0);
    block_sync();
    if (model.contact) copy_rows(model, 1, {model.loose, w}, 0, loose, 0);
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
    int *const pairs, *const counts;
    const int room;

    CUDA_CALLABLE inline int number() const { return wp::min(counts[0] + counts[1], room); }
    CUDA_CALLABLE inline void read(int k, int& one, int& other) const {
        const int at = k < counts[0] ? k : room - 1 - (k - counts[0]);
        one = pairs[2 * at], other = pairs[2 * at + 1];
    }
    // A full list only counts on.
    CUDA_CALLABLE inline void append(int one, int other) const {
#if defined(__CUDA_ARCH__)
        const int end = one % 4 == 3 ? 1 : 0;
#else
        const int end = 0;
#endif
        const int k = count_on(counts[end]);
        if (k >= room) return;
        const int at = end == 0 ? k : room - 1 - k;
        pairs[2 * at] = one, pairs[2 * at + 1] = other;
    }
    CUDA_CALLABLE inline void clear() const { counts[0] = 0, counts[1] = 0; }
};

// On CUDA counts are in shared memory, the near ones from `rebuild_lists` on.
enum { NEAR = 0, CLOSE = 1, TOUCHING = 2 };
template <typename Model> CUDA_CALLABLE inline pairs_of pairs_in(const Model& model, int w, int list) {
    const wp::array_t<int>& pairs = list == NEAR ? model.near : list == CLOSE ? model.close : model.touching;
#if defined(__CUDA_ARCH__)
    __shared__ int counts[3][2];
    return {&wp::index(pairs, w, 0, 0), counts[list], int(pairs.shape[1])};
#else
    return {&wp::index(pairs, w, 0, 0), &wp::index(model.pair_counts, w, list, 0), int(pairs.shape[1])};
#endif
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
    pairs_in(model, w, NEAR).append(one, other);
}

// Whether a point is farther than this from where it was when pairs were listed. What the middle of the body has
// moved by, all have in common, and no pair comes nearer by it.
template <typename Model, typename real>
CUDA_CALLABLE inline int moved_on(const Model& model, int w, const rows_of<real>& s, real far) {
    typedef typename several<real>::lanes T;
    const rows_of<real> then(model.listed, w), m(model.inertia, w);
    const int middle = wp::index(model.slot, model.points / 2) - margin;
    vec<real> common = s.template get3<real>(0, middle) - then.template get3<real>(0, middle);
    if (far <= real(0)) common = {real(0), real(0), real(0)};
    const vec<T> shift = {T(common.x), T(common.y), T(common.z)};
    T most = T(real(0));
    for (EACH_IN(p, model.first, model.end)) {
        const vec<T> d = s.template get3<T>(0, p) - then.template get3<T>(0, p) - shift;
        most = larger(most, dot(d, d) * is_above(m.template get<T>(0, p), T(real(0))));
    }
    return largest_of(most) <= far * far ? 0 : 1;
}

// Rows of boxes: the lowest and highest corners, bits for what begins at a point of a shell (as `rest`) and whether it
// is folded there; and on CUDA the corners of the boxes of 32 neighbours.
enum { BITS = 6, FOLDED = 3, TILES = 7 };

template <typename real> CUDA_CALLABLE inline bool has_bit(const rows_of<real>& boxes, int i, int bit) {
    return int(boxes.template get<real>(BITS, i)) >> bit & 1;
}

template <typename real> CUDA_CALLABLE inline box<real> box_at(const rows_of<real>& boxes, int i) {
    return {boxes.template get3<real>(0, i), boxes.template get3<real>(3, i)};
}

// Whether a point of a shell is much nearer than at rest to one that is at most three columns and rows away.
template <typename Model, typename real>
CUDA_CALLABLE inline bool is_folded(const Model& model, const rows_of<real>& s, const rows_of<real>& m, int p) {
    const vec<real> x = s.template get3<real>(0, p);
    bool folded = false;
    for (int rows = -3; rows <= 3; ++rows) {
        const int q = p + rows * model.pitch;
        if (q < model.first || q >= model.end) continue;
        for (int columns = -3; columns <= 3; ++columns) {
            const vec<real> d = s.template get3<real>(0, q + columns) - x;
            const real along = real(columns) / model.per_x, across = real(rows) / model.per_y;
            folded |= (dot(d, d) < real(0.64) * (along * along + across * across)) &
                      (m.template get<real>(0, q + columns) > real(0));
        }
    }
    return folded;
}

// Begins a list, with the box of each point's features, which of a shell lie in the cell that it is the first of.
template <typename Model, typename real>
CUDA_CALLABLE inline void begin_list(const Model& model, int w, const rows_of<real>& s) {
    const rows_of<real> rest(model.rest, 0), m(model.inertia, w), boxes = shared_or(SHARED_BOXES, model.boxes, w);
    copy_rows(model, 3, s, 0, {model.listed, w}, 0);
    const int pitch = model.pitch;
    for (EACH_ONE_IN(p, model.first, model.end)) {
        const auto has = [&](int kind) { return pitch > 0 && rest.template get<real>(kind, p) > real(0); };
        const auto is_point = [&](int i) { return m.template get<real>(0, i) > real(0); };
        const real nowhere = real(1e15);
        box<real> b = {{nowhere, nowhere, nowhere}, {-nowhere, -nowhere, -nowhere}};
        if (is_point(p)) b.include(s.template get3<real>(0, p));
        if (pitch == 0 ? is_point(p) && is_point(p + 1) : has(0) || has(2))
            b.include(s.template get3<real>(0, p + 1));
        if (has(1) || has(2)) b.include(s.template get3<real>(0, p + pitch));
        if (has(2)) b.include(s.template get3<real>(0, p + pitch + 1));
        boxes.put3(0, p, b.low), boxes.put3(3, p, b.high);
        const bool folded = pitch > 0 && is_folded(model, s, m, p);
        boxes.put(BITS, p, real(has(0) + 2 * has(1) + 4 * has(2) + (folded << FOLDED)));
    }
    pairs_in(model, w, NEAR).clear();
}

// Features of two points make so many pairs.
enum { PAIRS_OF_EDGES = 9, PAIRS_OF_CELLS = 13 };

// The k-th of them, in numbers of the list; tells whether it is there. Of a rod there is one.
template <typename Model, typename real>
CUDA_CALLABLE inline bool pair_of(const Model& model, const rows_of<real>& boxes, const rows_of<real>& inertia,
                                  int p, int q, int k, int& one, int& other) {
    const auto has = [&](int i, int kind) { return has_bit(boxes, i, kind); };
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
CUDA_CALLABLE inline void list_close(const Model& model, int w, const rows_of<real>& s) {
    const pairs_of near = pairs_in(model, w, NEAR), close = pairs_in(model, w, CLOSE);
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
    if (folded) return false;
    for (int rows = 0; rows <= 2; ++rows) {
        const int columns = q - p - rows * pitch, column = p % pitch + columns;
        if (columns <= 2 && columns >= -2 && column >= 0 && column < pitch) return true;
    }
    return false;
}

// Whether one of the corners of a point's cell is folded.
template <typename Model, typename real>
CUDA_CALLABLE inline bool cell_is_folded(const Model& model, const rows_of<real>& boxes, int p) {
    const auto at = [&](int i) { return has_bit(boxes, i, FOLDED); };
    return model.pitch > 0 && (at(p) | at(p + 1) | at(p + model.pitch) | at(p + model.pitch + 1));
}

// A cell that is folded on its diagonal.
template <typename Model, typename real>
CUDA_CALLABLE inline void list_folded_cells(const Model& model, int w, const rows_of<real>& s,
                                            const rows_of<real>& boxes) {
    const real whole = real(1) / (model.per_x * model.per_x) + real(1) / (model.per_y * model.per_y);
    for (EACH_ONE_IN(p, model.first, model.end)) {
        if (!has_bit(boxes, p, 2)) continue;
        const vec<real> across =
            s.template get3<real>(0, p + model.pitch + 1) - s.template get3<real>(0, p);
        if (dot(across, across) < real(0.64) * whole) list_pair(model, w, s, 4 * p + 3, 4 * p + 1);
    }
}

// Lists the pairs of features of points p and q > p, by their boxes first.
template <typename Model, typename real>
CUDA_CALLABLE inline void list_pairs_of(const Model& model, int w, const rows_of<real>& s, const rows_of<real>& boxes,
                                        const rows_of<real>& m, int p, int q) {
    const real far = model.contact_distance + model.contact_margin;
    int one, other;
    for (int k = 0; k < (model.pitch == 0 ? 1 : PAIRS_OF_CELLS); ++k) {
        if (!pair_of(model, boxes, m, p, q, k, one, other)) continue;
        const feature_pair pair(one, other, model.pitch);
        if (gap_between(box_of(s, pair.first), box_of(s, pair.second)) < far * far) list_pair(model, w, s, one, other);
    }
}

#if defined(__CUDA_ARCH__)

// Slots of 32 neighbours, of a shell 8 columns and 4 rows: the first of them, and how much further the others are.
struct tiles {
    const int pitch, first, across, number;

    template <typename Model> CUDA_CALLABLE inline explicit tiles(const Model& model)
        : pitch(model.pitch), first(model.first), across(pitch / 8),
          number(pitch == 0 ? (model.end - first + 31) / 32 : across * (((model.end - first) / pitch + 3) / 4)) {}
    CUDA_CALLABLE inline int begin(int tile) const {
        return first + (pitch == 0 ? 32 * tile : tile / across * 4 * pitch + tile % across * 8);
    }
    CUDA_CALLABLE inline int further(int l) const { return pitch == 0 ? l : l / 8 * pitch + l % 8; }
};

template <typename Model, typename real>
CUDA_CALLABLE inline void bound_tiles(const Model& model, const rows_of<real>& boxes) {
    const tiles all(model);
    for (EACH_ONE(i, 6 * all.number)) {
        const int tile = i / 6, c = i % 6, q = all.begin(tile);
        real most = boxes.template get<real>(c, q);
        for (int l = 1; l < 32 && q + all.further(l) < model.end; ++l) {
            const real a = boxes.template get<real>(c, q + all.further(l));
            most = c < 3 ? wp::min(most, a) : larger(most, a);
        }
        boxes.put(TILES + c, all.first + tile, most);
    }
}

// A warp takes a point. Its lanes compare that one's box with those of tiles, and then of what is in them. Points that
// may meet wait until there are enough for all lanes.
template <typename Model, typename real>
CUDA_CALLABLE inline void list_pairs(const Model& model, int w, const rows_of<real>& s) {
    const rows_of<real> m(model.inertia, w), boxes = shared_or(SHARED_BOXES, model.boxes, w);
    bound_tiles(model, boxes);
    block_sync();
    const tiles all_tiles(model);
    constexpr int lanes = 32, most_warps = 8;
    constexpr unsigned all = 0xffffffffu;
    __shared__ int waiting[most_warps][2 * lanes][2];
    const int lane = threadIdx.x % lanes, warp = threadIdx.x / lanes, warps = blockDim.x / lanes;
    const real far = model.contact_distance + model.contact_margin;
    int count = 0;
    const int further = all_tiles.further(lane);
    for (int t0 = 0; t0 < all_tiles.number; t0 += lanes) {
        const bool exists = t0 + lane < all_tiles.number;
        const int t = exists ? t0 + lane : 0, begin = all_tiles.begin(t);
        const int last = exists ? begin + all_tiles.further(31) : 0;
        const box<real> around = box_at(boxes.from(TILES), model.first + t);
        for (int p = model.first + warp; p < model.end; p += warps) {  // boxes without points are far from all others
            const box<real> b = box_at(boxes, p);
            unsigned near = __ballot_sync(all, last > p && gap_between(b, around) < far * far);
            if (near == 0) continue;
            const bool folded = cell_is_folded(model, boxes, p);
            for (; near != 0; near &= near - 1) {
                const int q = __shfl_sync(all, begin, __ffs(near) - 1) + further;
                const bool hit = q > p && q < model.end && gap_between(b, box_at(boxes, q)) < far * far &&
                                 !is_neighbour(model, p, q, folded);
                const unsigned hits = __ballot_sync(all, hit);
                int* to = waiting[warp][count + __popc(hits & ((1u << lane) - 1u))];
                if (hit) to[0] = p, to[1] = q;
                count += __popc(hits);
                __syncwarp();
                if (count < lanes) continue;
                count -= lanes;
                const int* at = waiting[warp][count + lane];
                list_pairs_of(model, w, s, boxes, m, at[0], at[1]);
                __syncwarp();
            }
        }
    }
    const int* at = waiting[warp][lane];
    if (lane < count) list_pairs_of(model, w, s, boxes, m, at[0], at[1]);
    if (model.pitch > 0) list_folded_cells(model, w, s, boxes);
}

#else

template <typename Model, typename real>
CUDA_CALLABLE inline void list_pairs(const Model& model, int w, const rows_of<real>& s) {
    typedef typename several<real>::lanes T;
    const rows_of<real> boxes(model.boxes, w), m(model.inertia, w);
    const int width = sizeof(T) / sizeof(real);
    const real far = model.contact_distance + model.contact_margin;
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
                list_pairs_of(model, w, s, boxes, m, p, q);
            }
        }
    }
    if (model.pitch > 0) list_folded_cells(model, w, s, boxes);
}

#endif

// Lists pairs anew if a point has moved farther than this.
template <typename Model, typename real>
CUDA_CALLABLE inline void rebuild_lists(const Model& model, int w, const rows_of<real>& s, real far) {
#if defined(__CUDA_ARCH__)
    const int end = threadIdx.x;
    if (end < 2) pairs_in(model, w, NEAR).counts[end] = wp::index(model.pair_counts, w, NEAR, end);
#endif
    if (!block_any(moved_on(model, w, s, far))) return;
    begin_list(model, w, s);
    block_sync();
    list_pairs(model, w, s);
    block_sync();
#if defined(__CUDA_ARCH__)
    if (end < 2) wp::index(model.pair_counts, w, NEAR, end) = pairs_in(model, w, NEAR).counts[end];
#endif
}

// A state keeps where points were when pairs were listed.
template <typename Model, typename real>
CUDA_CALLABLE inline void keep_list(const Model& model, int w, const wp::array_t<real>& state, int row, int c) {
    copy_rows(model, 3, rows_of<real>(model.listed, w), 0, rows_of<real>(state, row), c);
}

}  // namespace gendom
