"""Gripper paths: pose of a gripper at a given time, and the transpose of its derivative.

Between two knots a gripper moves on a straight line and turns about one axis, at constant rates.
All is in float64, because a gripper's movement in one substep can be below the resolution of
float32 far from the origin. Functions for kernels (``make_paths``) serve both engines;
``HostPaths`` does the same on the host, where grippers of rods and shells close and open.

Shapes: W worlds, G grippers, K path knots.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from gendom.arrays import Array
from gendom.sim.gripper import turns_of
from gendom.sim.native import functions_of
from gendom.sim.thin import rotation


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

    return Paths


def paths_on(device: Any, arrays: Mapping[str, Array], real: Any) -> Any:
    """The struct of paths on a device, from the arrays of ``Grippers``.

    On the CPU it shares their memory where types fit.
    """
    paths, on_cpu = make_path_type(real)(), wp.get_device(device).is_cpu
    for name, of in make_path_type(real).vars.items():
        values, kind = np.require(arrays[name], requirements="W"), of.type.dtype
        number = wp.dtype_to_numpy(getattr(kind, "_wp_scalar_type_", kind))
        shared = on_cpu and values.dtype == number
        values = values if shared else np.ascontiguousarray(values)
        setattr(paths, name, wp.array(values, dtype=kind, device=device, copy=not shared))
    return paths


@functools.cache
def make_paths(real: Any) -> SimpleNamespace:
    """Build the functions that evaluate gripper paths, for one scalar type."""
    Paths = make_path_type(real)

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
    def placed(w: int, g: int, t: wp.float64, paths: Paths):
        """Centre [m] and orientation of a gripper at time t [s], and the index of the last knot."""
        knot, u = knot_before(w, g, t, paths)
        a = paths.position[w, g, knot]
        centre = a + u * (paths.position[w, g, knot + 1] - a)
        q = wp.quatd(wp.float64(0.0), wp.float64(0.0), wp.float64(0.0), wp.float64(1.0))
        if paths.turns[w, g] == 1:
            q = rotation(u * paths.turn[w, g, knot]) * paths.orientation[w, g, knot]
        return centre, q, knot

    @wp.func
    def moves(w: int, g: int, begin: wp.float64, end: wp.float64, paths: Paths) -> bool:
        """Whether a gripper that is closed at a time moves until another one [s]."""
        first, _u = knot_before(w, g, begin, paths)
        last, _v = knot_before(w, g, end, paths)
        found = paths.turns[w, g] == 1
        for k in range(first, last + 1):
            gone = paths.position[w, g, k + 1] - paths.position[w, g, k]
            found = found or wp.length_sq(gone) > wp.float64(0.0)
        return found and is_closed(w, g, begin, paths)

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
        paths: Paths, turn_bars: wp.array3d(dtype=wp.vec3d)
    ):  # fmt: skip
        """Add derivatives by the knots' rotations, given those by the rotation at the share u of a
        segment (``R_bar``) and by the segment's rotation vector (``by_turn``)."""
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
        position_bars: wp.array3d(dtype=wp.vec3d), turn_bars: wp.array3d(dtype=wp.vec3d)
    ):  # fmt: skip
        """Transpose of ``placed``; ``R_bar`` is with respect to a rotation of R in world axes."""
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

    return functions_of(locals())


@dataclass
class Pose:
    """Pose and velocity of a gripper in each of k worlds; or derivatives by them, [k, 3], that by q
    by a rotation in world axes."""

    centre: Array
    """[k, 3] centre [m]."""
    q: Array
    """[k, 4] orientation."""
    velocity: Array
    """[k, 3] velocity of the centre just before [m/s]."""
    spin: Array
    """[k, 3] angular velocity just before [rad/s]."""


class HostPaths:
    """Paths on the host, where grippers close and open, and derivatives by their knots.

    Args:
        arrays: Of ``Grippers``.
    """

    def __init__(self, arrays: Mapping[str, Array]):
        self.arrays = arrays
        self.position_bar = np.zeros(arrays["position"].shape)
        """[W, G, K, 3] derivatives by the knots' positions."""
        self.turn_bar = np.zeros(arrays["position"].shape)
        """[W, G, K, 3] derivatives by rotations of the knots, in world axes."""

    def pose(self, g: int, w: Array, t: Array) -> Pose:
        """Pose of gripper g of worlds w [k], each once, at times t [k] [s]."""
        path, (knot, share, _, _) = self.arrays, self._at(g, w, t)
        q, turns = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)), path["turns"][w, g] == 1
        if turns.any():
            by = scipy.spatial.transform.Rotation.from_rotvec(share * path["turn"][w, g, knot])
            q[turns] = rotation.product(by.as_quat(), path["orientation"][w, g, knot])[turns]
        centre, velocity, spin = self.motion(g, w, t)
        return Pose(centre, q, velocity, spin)

    def motion(self, g: int, w: Array, t: Array) -> tuple[Array, Array, Array]:
        """Centre, velocity and spin of ``pose``."""
        path, (knot, share, last, rate) = self.arrays, self._at(g, w, t)
        p, a = path["position"], path["position"][w, g, knot]
        centre = a + share * (p[w, g, knot + 1] - a)
        velocity = rate * (p[w, g, last + 1] - p[w, g, last])
        return centre, velocity, path["turns"][w, g, None] * rate * path["turn"][w, g, last]

    def pose_adjoint(self, g: int, w: Array, t: Array, adjoint: Pose) -> None:
        """Transpose of ``pose``: adds to the derivatives by the knots."""
        knot, share, last, rate = self._at(g, w, t)
        self.position_bar[w, g, knot] += (1.0 - share) * adjoint.centre
        self.position_bar[w, g, knot + 1] += share * adjoint.centre
        self.position_bar[w, g, last] -= rate * adjoint.velocity
        self.position_bar[w, g, last + 1] += rate * adjoint.velocity
        self._turn_adjoint(g, w, knot, share, adjoint.q, 0.0)
        self._turn_adjoint(g, w, last, 0.0, 0.0 * adjoint.q, rate * adjoint.spin)

    def _turn_adjoint(
        self, g: int, w: Array, knot: Array, share: Any, R_bar: Array, by_turn: Any
    ) -> None:
        """As ``turn_adjoint`` of ``make_paths``."""
        turn, jacobian = self.arrays["turn"][w, g, knot], rotation.left_jacobian
        R_bar, turns = R_bar[..., None], self.arrays["turns"][w, g, None]
        bar = np.swapaxes(jacobian(share * turn), 1, 2) @ R_bar
        bar = (by_turn + share * bar[..., 0])[..., None]
        after, before = (np.swapaxes(jacobian(sign * turn), 1, 2) for sign in (1.0, -1.0))
        back = scipy.spatial.transform.Rotation.from_rotvec(-share * turn).as_quat()
        gone = rotation.turned(back, R_bar[..., 0])
        self.turn_bar[w, g, knot] += turns * (gone - np.linalg.solve(before, bar)[..., 0])
        self.turn_bar[w, g, knot + 1] += turns * np.linalg.solve(after, bar)[..., 0]

    def _at(self, g: int, w: Array, t: Array) -> tuple[Array, Array, Array, Array]:
        """The knots [k] that begin the segments of times t, and elapsed shares; the same of those
        just before, and 1 / durations, 0 outside of the path [1/s]; [k, 1] each."""
        time, i, late = self.arrays["time"][w, g], np.arange(len(t)), t[:, None]
        knot, last = (by(time[:, 1:-1], late).sum(axis=1) for by in (np.less_equal, np.less))
        begin, before, after = time[i, knot], time[i, last], time[i, last + 1]
        span, length = time[i, knot + 1] - begin, after - before
        share = np.clip((t - begin) / np.where(span > 0.0, span, np.inf), 0.0, 1.0)
        within = (before < t) & (t <= after)
        rate = np.where(within, 1.0 / np.where(within, length, 1.0), 0.0)
        return knot, share[:, None], last, rate[:, None]


class CommandedPaths(HostPaths):
    """Paths of three knots, given anew at each step: where grippers came from, where they are, and
    where they go.

    Args:
        paths: What grippers follow until now.
        now: [s].
    """

    def __init__(self, paths: HostPaths, now: float):
        W, G = paths.arrays["radius"].shape
        knots = np.zeros((3, W, G, 11))
        self._knots = tuple(knots)
        every, of = np.arange(W), np.moveaxis(knots, 0, 2)
        super().__init__({
            "time": of[..., 0], "position": of[..., 1:4], "orientation": of[..., 4:8],
            "turn": of[..., 8:], "turns": np.ones((W, G), dtype=np.int32),
            "hold_from": np.empty((W, G)), "hold_until": np.empty((W, G)),
            "radius": paths.arrays["radius"],
        })  # fmt: skip
        knots[..., 0] = now + np.array([[[-2.0]], [[-1.0]], [[0.0]]])
        for g in range(G):
            pose = paths.pose(g, every, np.full(W, now))
            knots[:, :, g, 1:8] = np.hstack([pose.centre, pose.q])
            knots[1, :, g, 1:4] -= pose.velocity
            knots[1, :, g, 8:] = pose.spin
        self._arrive = now
        self._hold((paths.arrays["hold_from"] <= now) & (now < paths.arrays["hold_until"]))

    def _hold(self, closed: NDArray[np.bool_]) -> None:
        self.closed = closed
        """[W, G] whether they hold something from now on."""
        self.arrays["hold_from"][...] = np.where(closed, -np.inf, np.inf)
        self.arrays["hold_until"][...] = np.where(closed, np.inf, -np.inf)

    def command(
        self, now: float, until: float, position: Array, quat_xyzw: Array | None,
        closed: NDArray[np.bool_] | None,
    ) -> bool:  # fmt: skip
        """Let grippers go straight to positions [..., 3] [m] and orientations [..., 4] of [G] or
        [W, G] until then [s]; those that are ``closed`` hold something from now on. Without
        orientations they keep theirs, without ``closed`` they stay as they are. Returns whether
        some do not.
        """
        came, here, there = self._knots
        # the knot before tells how fast they have come, for what one lets go of
        came[...] = here if self._arrive == now else there
        here[...] = there
        here[..., 0], there[..., 0], there[..., 1:4] = now, until, position
        if quat_xyzw is not None:
            there[..., 4:8] = quat_xyzw
            here[..., 8:] = turns_of(self.arrays["orientation"])[:, :, 1]
        self._arrive = until
        if closed is None or (closed == self.closed).all():
            return False
        self._hold(np.broadcast_to(closed, self.closed.shape).copy())
        return True
