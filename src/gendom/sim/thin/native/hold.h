// What grippers hold goes with them: points, and directions of a rod's edges, which shells have not.

namespace gendom {

// Rows of directions and spins in states, and of derivatives, which are by turns in world axes.
enum { Q = 6, W = 10, Q_BAR = 6, W_BAR = 9 };

// What is held of a point and the edge that begins there goes with its gripper. One that has not turned costs no
// products.
template <typename To, typename real>
CUDA_CALLABLE inline void lead(int holds, const vec<real>& centre, const quat<real>& by, const rows_of<real>& place,
                               const To& to, int p) {
    const vec<real> still = {real(0), real(0), real(0)};
    const bool turned = by.w != real(1);
    if (holds & 1) {
        vec<real> away = place.template get3<real>(0, p);
        if (turned) away = directors<real>(by).to_world(away);
        to.put3(X, p, centre + away);
        to.put3(V, p, still);
    }
    if (holds & 2) {
        // q and -q are one direction, but not to the joints: it stays on the side where it is
        quat<real> q = place.template get4<real>(3, p);
        if (turned) q = by * q;
        const quat<real> was = to.template get4<real>(Q, p);
        const real side = dot(q.v, was.v) + q.w * was.w < real(0) ? real(-1) : real(1);
        to.put4(Q, p, quat<real>{side * q.v, side * q.w});
        to.put3(W, p, still);
    }
}

#if defined(__CUDA_ARCH__)
#define SHARED __shared__
#else
#define SHARED static
#endif

// Where a gripper is. Of the next steps these are in shared memory on CUDA; CPUs only read that code.
template <typename real> struct pose { vec<real> centre; quat<real> by; };
constexpr int poses = 64;

template <typename real> CUDA_CALLABLE inline pose<real>& pose_of(int index) {
    SHARED pose<real> of[poses];
    return of[index];
}
template <typename real>
CUDA_CALLABLE inline pose<real> to_pose(const wp::vec_t<3, real>& c, const wp::quat_t<real>& q) {
    return {{c[0], c[1], c[2]}, {{q.x, q.y, q.z}, q.w}};
}
template <typename real>
CUDA_CALLABLE inline void put_pose(int index, const wp::vec_t<3, real>& c, const wp::quat_t<real>& q) {
    pose_of<real>(index) = to_pose(c, q);
}

// At the end of a step, by a gripper's pose.
template <typename Model, typename real>
CUDA_CALLABLE inline void hold(const Model& model, int w, int g, const pose<real>& at,
                               const wp::array_t<real>& state, int next) {
    const rows_of<real> to(state, next), place(model.place, w * model.holds.shape[1] + g);
    for (EACH_ONE(i, model.points))
        lead(wp::index(model.holds, w, g, i), at.centre, at.by, place, to, wp::index(model.slot, i) - margin);
}

// Its transpose: to the gripper's pose (six numbers) and to where things stand in it. One thread.
template <typename Model, typename Adjoint, typename real>
CUDA_CALLABLE inline void hold_adjoint(const Model& model, const Adjoint& adjoint, int w, int g,
                                       const wp::quat_t<real>& turned) {
    const int W_G = w * model.holds.shape[1] + g;
    const rows_of<real> b(adjoint.state, w), place(model.place, W_G), place_bar(adjoint.place, W_G);
    const directors<real> R(quat<real>{{turned.x, turned.y, turned.z}, turned.w});
    const vec<real> none = {real(0), real(0), real(0)};
    vec<real> centre = none, turn = none;
    for (int i = 0; i < model.points; ++i) {
        const int holds = wp::index(model.holds, w, g, i), p = wp::index(model.slot, i) - margin;
        if (holds & 1) {
            const vec<real> x_bar = b.template get3<real>(X_BAR, p);
            centre = centre + x_bar;
            turn = turn + cross(R.to_world(place.template get3<real>(0, p)), x_bar);
            place_bar.add3(0, p, R.to_body(x_bar));
            b.put3(X_BAR, p, none);
            b.put3(V_BAR, p, none);
        }
        if (holds & 2) {
            const vec<real> q_bar = b.template get3<real>(Q_BAR, p);
            turn = turn + q_bar;
            place_bar.add3(3, p, R.to_body(q_bar));
            b.put3(Q_BAR, p, none);
            b.put3(W_BAR, p, none);
        }
    }
    wp::index(adjoint.centre, w, g) = wp::vec_t<3, real>(centre.x, centre.y, centre.z);
    wp::index(adjoint.turn, w, g) = wp::vec_t<3, real>(turn.x, turn.y, turn.z);
}

}  // namespace gendom
