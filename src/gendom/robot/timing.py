"""Time scaling of a motion: the requested timing where limits allow it, slower where not.

A motion q(s), with s the path's own time, is executed as q(s(t)). With x = (ds/dt)^2 and
u = d^2s/dt^2 its speeds and accelerations are

    dq/dt = q'(s) sqrt(x),    d^2q/dt^2 = q'(s) u + q''(s) x,

and dx/ds = 2 u. So limits of speed, and x <= 1, which is the path's own pace, bound x, and limits
of acceleration are linear in u and x. Between two points of a grid u is constant; a pass backwards
finds the largest x at each from which the rest can be done, a pass forwards then takes the largest
u (Pham and Pham, "A new approach to time-optimal path parameterization based on reachability
analysis", 2018). The path's geometry stays as it is, and so do its pauses.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d

from gendom.arrays import Array
from gendom.robot.arm import Arm
from gendom.robot.kinematics import jacobian
from gendom.robot.motion import JointMotion

_POINTS_A_KNOT = 4  # points of the grid between two knots of the motion
_LONGEST_STEP = 0.01  # [s] of the path's time between two of them at most
_ROUNDS = 12  # in which accelerations of the spline through the grid are brought within limits
_SAFETY = 0.998  # share of the limits that is aimed at
_MIN_SPEED = 1e-9  # [rad/s]; joints slower than this on the path's own clock stand still


def in_time(arm: Arm, motion: JointMotion) -> JointMotion:
    """Slow a motion down where it exceeds limits of speed or acceleration.

    The ends keep their speed: motions that start and end at rest still do.

    Args:
        arm: Its limits of joint speeds and accelerations and of the tool's speed.
        motion: The motion with the requested timing.

    Returns:
        A motion along the same path. Its `slowed_by` is its duration over that of `motion`.
    """
    s = _grid(motion)
    q, v, a = motion.spline(s), motion.spline(s, 1), motion.spline(s, 2)
    highest = _speed_bounds(arm, q, v)
    allowed = np.full(len(s), _SAFETY)
    best = None
    for _ in range(_ROUNDS):
        pace = np.sqrt(_speed_profile(s, v, a, highest, arm, allowed))
        passed = np.cumsum(2.0 * np.diff(s) / (pace[:-1] + pace[1:]))
        time = motion.start + np.concatenate([[0.0], passed])
        events = tuple(replace(e, time=_at(e.time, s, time)) for e in motion.events)
        done = replace(motion, time=time, q=q, events=events, slowed_by=1.0)
        excess = np.abs(done.acceleration_at(done.time) / arm.max_acceleration).max(axis=1)
        done = done.stretched(max(1.0, done.slowdown(arm)))
        if best is None or done.end < best.end:
            best = done
        if excess.max() <= 1.0:
            break
        # The spline rounds off the jumps of acceleration and overshoots beside them: there, and
        # only there, less is allowed.
        worst = maximum_filter1d(excess, 5, mode="nearest")
        allowed = np.where(worst > 1.0, allowed * _SAFETY / worst, allowed)
    assert best is not None
    duration = motion.end - motion.start
    return replace(best, slowed_by=motion.slowed_by * (best.end - best.start) / duration)


def _grid(motion: JointMotion) -> Array:
    """Path times at which limits are evaluated, [N]."""
    parts = [motion.time[:1]]
    for a, b in zip(motion.time[:-1], motion.time[1:], strict=True):
        steps = max(_POINTS_A_KNOT, int(np.ceil((b - a) / _LONGEST_STEP)))
        parts.append(np.linspace(a, b, steps + 1)[1:])
    return np.concatenate(parts)


def _speed_bounds(arm: Arm, q: Array, v: Array) -> Array:
    """Largest x allowed by limits of speed and by the path's own speed, [N]."""
    tool = np.linalg.norm((jacobian(arm, q)[:, :3] @ v[..., None])[..., 0], axis=1)
    use = np.maximum(np.abs(v / arm.max_speed).max(axis=1), tool / arm.max_tcp_speed)
    return np.minimum(1.0, (_SAFETY / np.maximum(use, 1e-12)) ** 2)


def _speed_profile(s: Array, v: Array, a: Array, highest: Array, arm: Arm, allowed: Array) -> Array:
    """Values of x at the points of the grid, [N]."""
    step = 2.0 * np.diff(s)
    n = len(s)
    limit = allowed[:, None] * arm.max_acceleration
    # |v u + a x| <= limit where the step begins, and, x being x + step u there, where it ends.
    slope = np.concatenate([v[:-1], v[1:] + a[1:] * step[:, None]], axis=1)
    curve = np.concatenate([a[:-1], a[1:]], axis=1)
    most = np.concatenate([limit[:-1], limit[1:]], axis=1)
    turning = np.abs(slope) > _MIN_SPEED
    with np.errstate(divide="ignore", invalid="ignore"):
        top = np.where(turning, most / np.abs(slope), np.inf)  # -top - lean x <= u <= top - lean x
        lean = np.where(turning, curve / slope, 0.0)
        still = np.where(turning, np.inf, most / np.abs(curve)).min(axis=1)
    reach = np.empty(n)
    reach[-1] = highest[-1]
    for i in range(n - 2, -1, -1):
        # Upper bounds of u, and lower ones; the last of each says where the step leads.
        above = np.append(top[i], reach[i + 1] / step[i]), np.append(lean[i], 1.0 / step[i])
        below = np.append(-top[i], 0.0), above[1]
        room = above[0][:, None] - below[0]
        closing = above[1][:, None] - below[1]
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.where(closing > 0.0, room / closing, np.inf)
        reach[i] = min(highest[i], still[i], float(np.nanmin(ends)))
    x = np.empty(n)
    x[0] = reach[0]
    for i in range(n - 1):
        u = float(np.min(top[i] - lean[i] * x[i]))
        x[i + 1] = np.clip(x[i] + step[i] * u, 0.0, reach[i + 1])
    return x


def _at(moment: float, s: Array, time: Array) -> float:
    """Motion time of a path time; before and after the motion time is not scaled."""
    inside = np.clip(moment, s[0], s[-1])
    return float(np.interp(inside, s, time) + moment - inside)
