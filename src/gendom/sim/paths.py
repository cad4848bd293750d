"""Gripper paths: pose of a gripper at a given time, and the transpose of its derivative.

Between two knots a gripper moves on a straight line and turns about one axis, at constant rates.
All is in float64, because a gripper's movement in one substep can be below the resolution of
float32 far from the origin.

Shapes: W worlds, G grippers, K path knots.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp


@functools.cache
def make_path_type(real: Any) -> Any:
    """The struct of paths for ``wp.float32`` or ``wp.float64``."""

    @wp.struct
    class Paths:
        """Paths of all grippers as arrays, see ``Grippers``."""

        time: wp.array3d(dtype=wp.float64)  # [W, G, K] [s]
        position: wp.array3d(dtype=wp.vec3d)  # [W, G, K] [m]
        orientation: wp.array3d(dtype=wp.quatd)  # [W, G, K]
        turn: wp.array3d(dtype=wp.vec3d)  # [W, G, K] rotation vector to the next knot [rad]
        turns: wp.array2d(dtype=wp.int32)  # [W, G] whether orientations were given
        hold_from: wp.array2d(dtype=wp.float64)  # [W, G] [s]
        hold_until: wp.array2d(dtype=wp.float64)  # [W, G] [s]
        radius: wp.array2d(dtype=real)  # [W, G] [m]
        may_miss: wp.array2d(dtype=wp.int32)  # [W, G]

    return Paths


@functools.cache
def make_paths(real: Any) -> SimpleNamespace:
    """Build the functions that evaluate gripper paths, for one scalar type.

    Returns:
        Namespace with ``is_closed``, ``pose`` (of a gripper at a given time), ``pose_adjoint``
        (its transpose with respect to the path's positions and orientations), and their parts.
    """
    vec3, mat33 = wp.types.vector(3, real), wp.types.matrix((3, 3), real)
    Paths = make_path_type(real)

    @wp.func
    def narrow(a: wp.vec3d):
        return vec3(real(a[0]), real(a[1]), real(a[2]))

    @wp.func
    def narrow_matrix(A: wp.mat33d):
        return mat33(
            real(A[0, 0]), real(A[0, 1]), real(A[0, 2]),
            real(A[1, 0]), real(A[1, 1]), real(A[1, 2]),
            real(A[2, 0]), real(A[2, 1]), real(A[2, 2]),
        )  # fmt: skip

    @wp.func
    def is_closed(w: int, g: int, t: wp.float64, paths: Paths):
        return t >= paths.hold_from[w, g] and t < paths.hold_until[w, g]

    @wp.func
    def knot_before(w: int, g: int, t: wp.float64, paths: Paths):
        """Knot that starts the segment containing time t, and the elapsed share of the segment."""
        last = paths.time.shape[2] - 1
        lo = int(0)
        hi = int(last)
        while hi - lo > 1:
            mid = (lo + hi) // 2
            if paths.time[w, g, mid] <= t:
                lo = mid
            else:
                hi = mid
        span = paths.time[w, g, hi] - paths.time[w, g, lo]
        u = wp.float64(0.0)
        if span > wp.float64(0.0):
            u = wp.clamp((t - paths.time[w, g, lo]) / span, wp.float64(0.0), wp.float64(1.0))
        return lo, u

    @wp.func
    def rotation(turn: wp.vec3d):
        """Exponential of a rotation vector [rad], as a quaternion."""
        angle = wp.length(turn)
        q = wp.quatd(wp.float64(0.0), wp.float64(0.0), wp.float64(0.0), wp.float64(1.0))
        if angle > wp.float64(0.0):
            q = wp.quat_from_axis_angle(turn / angle, angle)
        return q

    @wp.func
    def pose(w: int, g: int, t: wp.float64, paths: Paths):
        """Centre [m] and orientation of a gripper at time t [s], and the index of the last knot.

        Between two knots the gripper moves on a straight line and turns at constant rates.
        """
        knot, u = knot_before(w, g, t, paths)
        a = paths.position[w, g, knot]
        centre = a + u * (paths.position[w, g, knot + 1] - a)
        R = wp.identity(n=3, dtype=wp.float64)
        if paths.turns[w, g] == 1:
            R = wp.quat_to_matrix(
                rotation(u * paths.turn[w, g, knot]) * paths.orientation[w, g, knot]
            )
        return centre, R, knot

    @wp.func
    def left_jacobian(turn: wp.vec3d, sign: wp.float64):
        """Left Jacobian J of exp: exp(turn + d) = exp(J d) exp(turn); right Jacobian for sign -1.

        Source: Sola, Deray and Atchuthan (2018), "A micro Lie theory", equation 145.
        """
        angle = wp.length(turn)
        K = wp.skew(turn)
        a = wp.float64(0.5)
        b = wp.float64(1.0) / wp.float64(6.0)
        if angle > wp.float64(1.0e-4):
            a = (wp.float64(1.0) - wp.cos(angle)) / (angle * angle)
            b = (angle - wp.sin(angle)) / (angle * angle * angle)
        return wp.identity(n=3, dtype=wp.float64) + (sign * a) * K + b * (K * K)

    @wp.func
    def turn_adjoint(
        w: int, g: int, knot: int, u: wp.float64, R_bar: wp.vec3d, by_turn: wp.vec3d,
        paths: Paths, turn_bars: wp.array3d(dtype=wp.vec3d),
    ):  # fmt: skip
        """Add derivatives with respect to the knots' rotations.

        They are computed from the derivatives with respect to the rotation at the share u of a
        segment (``R_bar``) and to the segment's rotation vector (``by_turn``).
        """
        turn = paths.turn[w, g, knot]
        gone = wp.quat_to_matrix(rotation(u * turn))
        turn_bar = by_turn + u * (wp.transpose(left_jacobian(u * turn, wp.float64(1.0))) * R_bar)
        # the vector turn = log(R_next R^T)
        one = wp.float64(1.0)
        next_bar = wp.transpose(wp.inverse(left_jacobian(turn, one))) * turn_bar
        this_bar = wp.transpose(gone) * R_bar
        this_bar -= wp.transpose(wp.inverse(left_jacobian(turn, -one))) * turn_bar
        wp.atomic_add(turn_bars, w, g, knot, this_bar)
        wp.atomic_add(turn_bars, w, g, knot + 1, next_bar)

    @wp.func
    def pose_adjoint(
        w: int, g: int, t: wp.float64, centre_bar: wp.vec3d, R_bar: wp.vec3d, paths: Paths,
        position_bars: wp.array3d(dtype=wp.vec3d), turn_bars: wp.array3d(dtype=wp.vec3d),
    ):  # fmt: skip
        """Transpose of ``pose``; ``R_bar`` is with respect to a rotation of R in world axes."""
        knot, u = knot_before(w, g, t, paths)
        left = wp.float64(1.0) - u
        wp.atomic_add(position_bars, w, g, knot, left * centre_bar)
        wp.atomic_add(position_bars, w, g, knot + 1, u * centre_bar)
        if paths.turns[w, g] == 1:
            turn_adjoint(w, g, knot, u, R_bar, wp.vec3d(), paths, turn_bars)

    @wp.func
    def share_of(w: int, g: int, k: int, t: wp.float64, dt: wp.float64, paths: Paths):
        """Share of the segment after knot k that elapses from t to t + dt."""
        share = wp.float64(0.0)
        span = paths.time[w, g, k + 1] - paths.time[w, g, k]
        if span > wp.float64(0.0):
            until = wp.min(t + dt, paths.time[w, g, k + 1])
            share = wp.max(until - wp.max(t, paths.time[w, g, k]), wp.float64(0.0)) / span
        return share

    return SimpleNamespace(
        is_closed=is_closed,
        pose=pose,
        pose_adjoint=pose_adjoint,
        turn_adjoint=turn_adjoint,
        share_of=share_of,
        narrow=narrow,
        narrow_matrix=narrow_matrix,
    )
