// Vectors and unit quaternions of numbers, or of lanes: several neighbours side by side.
//
// A loop over the points of a body reads `for (EACH(i, n))` or `for (EACH_IN(i, first, end))`: on the CPU it takes as many points at
// a time as a SIMD register holds, on CUDA every thread of a block takes one at a time.

namespace gendom {

// What the threads of a CUDA block do together; on the CPU a block is one thread.
CUDA_CALLABLE inline void block_sync() {
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
}

// Whether a thread's value is not 0.
CUDA_CALLABLE inline int block_any(int value) {
#if defined(__CUDA_ARCH__)
    return __syncthreads_or(value) ? 1 : 0;
#else
    return value;
#endif
}

// The sum over the threads of a block of one warp; each has it.
template <typename real> CUDA_CALLABLE inline real warp_sum(real value) {
#if defined(__CUDA_ARCH__)
    for (int by = 16; by > 0; by /= 2) value += __shfl_xor_sync(0xffffffffu, value, by);
#endif
    return value;
}

template <typename T> struct number_of { typedef T type; };

#if defined(__CUDA_ARCH__)

template <typename real> struct several { typedef real lanes; };
#define EACH_IN(i, a, b) int i = (a) + threadIdx.x; i < (b); i += blockDim.x
#define EACH_ONE_IN EACH_IN
#define EACH_OF_WARP(i, a, b) int i = (a) + threadIdx.x % 32; i < (b); i += 32

#else

#if defined(__AVX512F__)
#define LANE_BYTES 64
#else
#define LANE_BYTES 32
#endif
template <typename real> struct several {
    typedef real lanes __attribute__((ext_vector_type(LANE_BYTES / sizeof(real))));
};
template <> struct number_of<several<float>::lanes> { typedef float type; };
template <> struct number_of<several<double>::lanes> { typedef double type; };
#define EACH_IN(i, a, b) \
    int i = (a); i < (b); i += int(sizeof(typename several<real>::lanes) / sizeof(real))
#define EACH_ONE_IN(i, a, b) int i = (a); i < (b); ++i
#define EACH_OF_WARP EACH_ONE_IN

#endif

#define EACH(i, n) EACH_IN(i, 0, n)
#define EACH_ONE(i, n) EACH_ONE_IN(i, 0, n)

template <typename T> CUDA_CALLABLE inline T larger(T a, T b) {
#if defined(__CUDA_ARCH__)
    return a > b ? a : b;
#else
    return __builtin_elementwise_max(a, b);
#endif
}

template <typename T> CUDA_CALLABLE inline T root(T a) {
#if defined(__CUDA_ARCH__)
    return wp::sqrt(a);
#else
    return __builtin_elementwise_sqrt(a);
#endif
}

// 1 where a > b, else 0.
template <typename T> CUDA_CALLABLE inline T is_above(T a, T b) {
#if defined(__CUDA_ARCH__)
    return a > b ? T(1) : T(0);
#else
    typedef typename number_of<T>::type real;
    if constexpr (sizeof(T) == sizeof(real)) {
        return a > b ? T(1) : T(0);
    } else {
        return -__builtin_convertvector(a > b, T);  // lanes compare to -1 or 0
    }
#endif
}

// Over lanes.
template <typename T> CUDA_CALLABLE inline typename number_of<T>::type largest_of(const T& a) {
    typedef typename number_of<T>::type real;
    real most = ((const real*)&a)[0];
    for (unsigned l = 1; l < sizeof(T) / sizeof(real); ++l) most = larger(most, ((const real*)&a)[l]);
    return most;
}
template <typename T> CUDA_CALLABLE inline typename number_of<T>::type sum_of(const T& a) {
    typedef typename number_of<T>::type real;
    real sum = real(0);
    for (unsigned l = 0; l < sizeof(T) / sizeof(real); ++l) sum += ((const real*)&a)[l];
    return sum;
}

template <typename T> struct vec { T x, y, z; };

template <typename T> CUDA_CALLABLE inline vec<T> operator+(const vec<T>& a, const vec<T>& b) {
    return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <typename T> CUDA_CALLABLE inline vec<T> operator-(const vec<T>& a, const vec<T>& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <typename T> CUDA_CALLABLE inline vec<T> operator-(const vec<T>& a) {
    return {-a.x, -a.y, -a.z};
}
template <typename T> CUDA_CALLABLE inline vec<T> operator*(const T& s, const vec<T>& a) {
    return {s * a.x, s * a.y, s * a.z};
}
// Component by component: a diagonal matrix times a vector.
template <typename T> CUDA_CALLABLE inline vec<T> operator*(const vec<T>& a, const vec<T>& b) {
    return {a.x * b.x, a.y * b.y, a.z * b.z};
}
template <typename T> CUDA_CALLABLE inline T dot(const vec<T>& a, const vec<T>& b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <typename T> CUDA_CALLABLE inline vec<T> cross(const vec<T>& a, const vec<T>& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// A unit quaternion, vector part first; it turns a body's axes into the world's.
template <typename T> struct quat { vec<T> v; T w; };

// Of conj(a) b: what turns b's axes into a's, seen from the body.
template <typename T> CUDA_CALLABLE inline quat<T> between(const quat<T>& a, const quat<T>& b) {
    return {a.w * b.v - b.w * a.v - cross(a.v, b.v), a.w * b.w + dot(a.v, b.v)};
}
template <typename T> CUDA_CALLABLE inline quat<T> operator*(const quat<T>& a, const quat<T>& b) {
    return {a.w * b.v + b.w * a.v + cross(a.v, b.v), a.w * b.w - dot(a.v, b.v)};
}

// A rotation matrix by its columns, the directors.
template <typename T> struct directors {
    vec<T> d1, d2, d3;

    CUDA_CALLABLE inline explicit directors(const quat<T>& q) {
        typedef typename number_of<T>::type real;
        const T one = T(real(1)), two = T(real(2));
        const T x = q.v.x, y = q.v.y, z = q.v.z, w = q.w;
        d1 = {one - two * (y * y + z * z), two * (x * y + z * w), two * (x * z - y * w)};
        d2 = {two * (x * y - z * w), one - two * (x * x + z * z), two * (y * z + x * w)};
        d3 = {two * (x * z + y * w), two * (y * z - x * w), one - two * (x * x + y * y)};
    }
    CUDA_CALLABLE inline vec<T> to_world(const vec<T>& a) const {
        return a.x * d1 + a.y * d2 + a.z * d3;
    }
    CUDA_CALLABLE inline vec<T> to_body(const vec<T>& a) const {
        return {dot(d1, a), dot(d2, a), dot(d3, a)};
    }
};

// Vectors and quaternions among the components of points, of which `Own` gets and puts the numbers.
template <typename Own> struct components {
    CUDA_CALLABLE inline const Own& own() const { return static_cast<const Own&>(*this); }

    template <typename T> CUDA_CALLABLE inline void add(int c, int i, const T& a) const {
        own().put(c, i, own().template get<T>(c, i) + a);
    }
    template <typename T> CUDA_CALLABLE inline vec<T> get3(int c, int i) const {
        return {own().template get<T>(c, i), own().template get<T>(c + 1, i), own().template get<T>(c + 2, i)};
    }
    template <typename T> CUDA_CALLABLE inline void put3(int c, int i, const vec<T>& a) const {
        own().put(c, i, a.x), own().put(c + 1, i, a.y), own().put(c + 2, i, a.z);
    }
    template <typename T> CUDA_CALLABLE inline void add3(int c, int i, const vec<T>& a) const {
        add(c, i, a.x), add(c + 1, i, a.y), add(c + 2, i, a.z);
    }
    template <typename T> CUDA_CALLABLE inline quat<T> get4(int c, int i) const {
        return {get3<T>(c, i), own().template get<T>(c + 3, i)};
    }
    template <typename T> CUDA_CALLABLE inline void put4(int c, int i, const quat<T>& q) const {
        put3(c, i, q.v), own().put(c + 3, i, q.w);
    }
};

// The rows of an array [rows, components, points] from point 0 on; points stand after a margin.
constexpr int margin = 8;

#if defined(ROW_LENGTH)
struct row_length {  // known when compiled, and so are addresses
    CUDA_CALLABLE inline row_length(int) {}
    CUDA_CALLABLE inline constexpr operator int() const { return ROW_LENGTH; }
};
#else
typedef int row_length;
#endif

template <typename real> struct rows_of : components<rows_of<real>> {
    real* first;
    row_length pitch;

    CUDA_CALLABLE inline rows_of(const wp::array_t<real>& a, int row)
        : first(&wp::index(a, row, 0, 0) + margin), pitch(a.shape[2]) {}
    CUDA_CALLABLE inline rows_of(real* first, int pitch) : first(first), pitch(pitch) {}
    CUDA_CALLABLE inline rows_of from(int c) const { return {first + c * pitch, pitch}; }

    CUDA_CALLABLE inline real& at(int c, int i) const { return first[c * pitch + i]; }

    template <typename T> CUDA_CALLABLE inline T get(int c, int i) const {
#if defined(__CUDA_ARCH__)
        return first[c * pitch + i];
#else
        T a;
        __builtin_memcpy(&a, first + c * pitch + i, sizeof(T));  // lanes begin at any number
        return a;
#endif
    }
    template <typename T> CUDA_CALLABLE inline void put(int c, int i, const T& a) const {
#if defined(__CUDA_ARCH__)
        first[c * pitch + i] = a;
#else
        __builtin_memcpy(first + c * pitch + i, &a, sizeof(T));
#endif
    }
};

}  // namespace gendom
