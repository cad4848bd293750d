// A rod without contact with itself whose state is in the registers of a CUDA warp: K points a thread, and what
// neighbours share goes from thread to thread. What stays as it is is in shared memory.
// CPUs only read this file.

namespace gendom {

#if defined(__CUDA_ARCH__)
#define LANE int(threadIdx.x)
#define FROM_LANE(other, value) __shfl_sync(0xffffffffu, value, (other) & 31)
#else
#define LANE 0
#define FROM_LANE(other, value) value
#endif

constexpr int state_rows = 19, scratch_rows = 12, model_rows = 17;

// Components of this thread's points, from `first` on, and of their neighbours. Beyond the rod's ends are points,
// edges and joints without mass or stiffness; the last one's neighbour is the first.
template <typename real, int K> struct registers : components<registers<real, K>> {
    real* of;
    int first;

    CUDA_CALLABLE inline explicit registers(real* of) : of(of), first(K * LANE) {}

    template <typename T> CUDA_CALLABLE inline T get(int c, int i) const {
        const int j = i - first;  // known to the compiler
        return j < 0 ? FROM_LANE(LANE - 1, of[c * K + K - 1])
                     : j < K ? of[c * K + j] : FROM_LANE(LANE + 1, of[c * K]);
    }
    CUDA_CALLABLE inline void put(int c, int i, real a) const { of[c * K + i - first] = a; }
};

// What rows have of this thread's points.
template <int rows, int K, typename real, typename From, typename To>
CUDA_CALLABLE inline void copy(const From& from, const To& to) {
#pragma unroll
    for (int c = 0; c < rows; ++c)
#pragma unroll
        for (int i = K * LANE; i < K * LANE + K; ++i) to.put(c, i, from.template get<real>(c, i));
}
template <unsigned N, typename real>
CUDA_CALLABLE inline void store(const wp::array_t<real>& state, int row, wp::vec_t<N, real>& own) {
    constexpr int K = N / state_rows;
    copy<state_rows, K, real>(registers<real, K>(own.c), rows_of<real>(state, row));
}

// The rod's rows of the model: `rest`, `stiffness` and `inertia` one after the other. What a thread needs it copies.
template <typename real, int K> CUDA_CALLABLE inline rows_of<real> fixed_rows(int c) {
    SHARED real of[model_rows * 32 * K];
    return {of + c * 32 * K, 32 * K};
}
// Begins some steps from a row of the state. Returns what each point is held by: 2 bits for each gripper of those
// that are `closed`, a bit each.
template <typename Model, unsigned N, typename real>
CUDA_CALLABLE inline wp::vec_t<N / state_rows, int> begin(const Model& model, int w, const wp::array_t<real>& state,
                                                          int row, int closed, wp::vec_t<N, real>& own) {
    constexpr int K = N / state_rows;
    copy<state_rows, K, real>(rows_of<real>(state, row), registers<real, K>(own.c));
    copy<7, K, real>(rows_of<real>(model.rest, w), fixed_rows<real, K>(0));
    copy<6, K, real>(rows_of<real>(model.stiffness, w), fixed_rows<real, K>(7));
    copy<4, K, real>(rows_of<real>(model.inertia, w), fixed_rows<real, K>(13));
    wp::vec_t<K, int> holds;
    for (int j = 0; j < K; ++j) {
        holds[j] = 0;
        for (int g = 0; g < model.holds.shape[1]; ++g)
            if (K * LANE + j < model.points && (closed >> g & 1))
                holds[j] |= wp::index(model.holds, w, g, K * LANE + j) << 2 * g;
    }
    return holds;
}

// What all steps of a length share: of viscosity, and what damping leaves of velocities.
template <typename Model, typename real>
CUDA_CALLABLE inline wp::vec_t<3, real> shares_of(const Model& model, int w, real dt, real kick) {
    const viscosity<real> visc(wp::index(model.damping, w), dt);
    return {visc.share, visc.follows, wp::exp(-kick * wp::index(model.velocity_damping, w))};
}

// `rod_forces`, `rod_move` and `hold` of this thread's points; gripper g is at pose `ahead + g * apart`.
template <typename Model, unsigned N, unsigned K, typename real>
CUDA_CALLABLE inline real step_in_registers(const Model& model, int w, wp::vec_t<N, real>& own,
                                            const wp::vec_t<K, int>& holds, int ahead, int apart, real dt,
                                            real kick, const wp::vec_t<3, real>& shares) {
    real left[scratch_rows * K];
    const registers<real, K> s(own.c), scratch(left);
    const rows_of<real> rest = fixed_rows<real, K>(0), k = fixed_rows<real, K>(7), m = fixed_rows<real, K>(13);
    real worst = real(0), sum = real(0);
#pragma unroll
    for (int j = 0; j < K; ++j) {
        const real stretch = rod_forces_at(s.first + j, s, s, scratch, rest, k, m, shares[0], shares[1]);
        worst = larger(worst, stretch);
        sum += stretch;
    }
    const motion<real> go(model, w, dt, kick, shares[2]);
#pragma unroll
    for (int j = 0; j < K; ++j) rod_move_at(s.first + j, s, s, scratch, m, go);
    for (int g = 0; g < model.holds.shape[1]; ++g) {
#pragma unroll
        for (int j = 0; j < K; ++j)
            if (const int of = holds[j] >> 2 * g & 3) {
                const pose<real>& at = pose_of<real>(ahead + g * apart);
                lead(of, at.centre, at.by, rows_of<real>(model.place, w * model.holds.shape[1] + g), s, s.first + j);
            }
    }
    return sum == sum ? worst : sum;
}

}  // namespace gendom
