"""Motions planned within an arm's limits: from joint to joint, and along a path of the tool at the
requested pace where limits allow it, slower where not.

A motion q(s), with s the path's own time, is executed as q(s(t)). With x = (ds/dt)^2 and
u = d^2s/dt^2 its speeds and accelerations are

    dq/dt = q'(s) sqrt(x),    d^2q/dt^2 = q'(s) u + q''(s) x,

and dx/ds = 2 u. So limits of speed, and x <= 1, which is the path's own pace, bound x, and limits
of acceleration are linear in u and x. Between two points of a grid u is constant; a pass backwards
finds the largest x at each from which the rest can be done, a pass forwards then takes the largest
u (Pham and Pham, "A new approach to time-optimal path parameterization based on reachability
analysis", 2018). The path's geometry stays as it is, and so do its pauses.
"""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import maximum_filter1d

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import RobotError
from gendom.robot.arm import Arm
from gendom.robot.collision import NO_OBSTACLES, CollisionChecker, Surroundings
from gendom.robot.kinematics import (
    descend,
    jacobian,
    out_of_reach,
    pose_error,
    reached,
    solutions,
    tcp_pose,
)
from gendom.robot.motion import JointMotion
from gendom.robot.path import TcpPath

SOLVED_RATE = 100.0
"""Rate at which joint angles along a path are solved [1/s]: at least this rate where corners are
rounded, at most this rate elsewhere, where a spacing of 3 mm along the path is sufficient."""

SHORTEST_BLEND = 0.04
"""Shortest blend in the search [s]."""

_KNOTS_A_BLEND = 16
_SPACING = 0.003  # [m]; the tool's movement between two solved times
_LARGEST_SPACING = 0.005  # [m]; the same at most, however fast the path is
_LONGEST_STEP = 0.2  # [s]; between two solved times at most
_HOMING = 3.0  # [1/m]; towards home within the null space, for each metre the tool moves
_POSTURES = 5  # configurations that a path is tried from
_LARGEST_JUMP = 0.1  # [rad]; between two solved times: more asks for smaller steps
_MARGIN = 1e-3  # [rad]; along paths joints keep so far from the ends of their ranges
_SPLINE_TOLERANCE = 3e-6  # [m], [rad]; by which splines may miss the path between solved times
_REFINEMENTS = 8  # rounds in which knots are added until splines keep that tolerance
_DENSE = 4096  # places along a path that are compared between two blends
_BATCHED = 20  # iterations in which angles at all of them must be found
_SMALLEST_SPACING = 1e-5  # [m]; joints that still jump at this spacing cannot follow the path

_POINTS_A_KNOT = 4  # points of the grid between two knots of the motion
_GRID_STEP = 0.01  # [s] of the path's time between two of them at most
_ROUNDS = 12  # in which accelerations of the spline through the grid are brought within limits
_SAFETY = 0.998  # share of the limits that is aimed at
_MIN_SPEED = 1e-9  # [rad/s]; joints slower than this on the path's own clock stand still

# ---- from joint to joint -------------------------------------------------------------------------


def joint_move(
    arm: Arm,
    q_from: ArrayLike,
    q_to: ArrayLike,
    *,
    share: float = 1.0,
    surroundings: Surroundings = NO_OBSTACLES,
    opening: float = 0.0,
) -> JointMotion:
    """Move all joints from rest to rest, as fast as a share of the limits allows.

    A quintic in time, q = q_from + (q_to - q_from) (10 s^3 - 15 s^4 + 6 s^5): its largest speed
    is 15 / 8, acceleration 10 / sqrt(3) and jerk 60 of the distance over T, T^2 and T^3.

    Args:
        arm: Its limits, the tool's speed included.
        q_from, q_to: [J] joint angles [rad].
        share: Share of the limits of speed, acceleration and jerk, in (0, 1].
        surroundings: Obstacles that the arm must not touch.
        opening: Distance of the fingers' inner faces [m].

    Raises:
        RobotError: An end is out of the joints' limits, the share is out of its range, or the
            arm collides on the way.
    """
    fix = "give 0 < share <= 1"
    require(0.0 < share <= 1.0, f"share is {share}", where="joint move", fix=fix, error=RobotError)
    ends = [arm.check_q(q) for q in (q_from, q_to)]
    distance = np.abs(ends[1] - ends[0]) / share
    least = [
        15.0 / 8.0 * distance / arm.max_speed,
        np.sqrt(10.0 / math.sqrt(3.0) * distance / arm.max_acceleration),
        np.cbrt(60.0 * distance / arm.max_jerk),
    ]
    duration = max(float(np.max(least)), 0.01)
    s = np.linspace(0.0, 1.0, 65)
    shape = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    motion = JointMotion(time=duration * s, q=ends[0] + shape[:, None] * (ends[1] - ends[0]))
    # The tool may be too fast, and the spline through the knots misses the quintic by 1e-6.
    slower = replace(arm, max_tcp_speed=share * arm.max_tcp_speed)
    motion = replace(motion.stretched(max(1.0, motion.slowdown(slower))), slowed_by=1.0)
    motion.check_limits(arm)
    CollisionChecker(arm, surroundings, opening=opening).check(motion)
    return motion


# ---- along a path of the tool --------------------------------------------------------------------


def follow(
    arm: Arm, path: TcpPath, *, surroundings: Surroundings = NO_OBSTACLES, opening: float = 0.0
) -> JointMotion:
    """Plan joint angles that move the tool along a path: at its pace where speeds and accelerations
    allow it, elsewhere slower (`in_time`).

    Inverse kinematics is solved at the start and then tracked along the path. The redundancy is
    used to approach the home configuration in proportion to the distance travelled by the tool, so
    the arm rests when the tool does. If limits are exceeded or the arm collides, other start
    configurations are tried.

    Args:
        arm: The arm.
        path: Its corners are rounded off by its `blend`, or if it has none by the shortest that the
            joints' accelerations allow (within a few percent), at least `SHORTEST_BLEND`, at most
            its `max_blend`.
        surroundings: Obstacles that the arm must not touch.
        opening: Distance of the fingers' inner faces [m].

    Returns:
        A motion within the limits; its `deviation` from the ideal path and `slowed_by` say what was
        changed.

    Raises:
        RobotError: A part of the path is out of reach or cannot be reached continuously, a joint
            leaves its range, or the arm collides.
    """
    # Splines overshoot a little where a joint comes to rest at its end.
    kept = replace(arm, q_min=arm.q_min + _MARGIN, q_max=arm.q_max - _MARGIN)
    best, refusal = None, None
    collisions = CollisionChecker(arm, surroundings, opening=opening)
    for q in solutions(kept, path.pose_at(path.start))[:_POSTURES]:
        try:
            motion = _from_posture(kept, path, q)
            over = {use.kind for use in motion.limit_uses(arm) if use.exceeded}
            excess = ("angle" in over, motion.slowdown(arm))
            if best is not None and excess >= best[0]:
                continue
            collisions.check(motion)
        except RobotError as error:
            refusal = refusal or error
            continue
        best = excess, motion
        if not over:
            return motion
    if best is None:
        assert refusal is not None
        raise refusal
    (out_of_range, _), motion = best
    if out_of_range:
        motion.check_limits(arm)
    slower = in_time(arm, motion)
    shortest = min(SHORTEST_BLEND, path.max_blend)
    if path.blend is None and motion.blend > shortest:
        # The blend was chosen for the path's speed; at a lower speed a shorter one may suffice.
        sharper = in_time(arm, _track(kept, path, motion.q[0], shortest, motion))
        slower = min(slower, sharper, key=lambda m: m.end - m.start)
    slower.check_limits(arm)
    collisions.check(slower)
    return slower


def _from_posture(arm: Arm, path: TcpPath, q: Array) -> JointMotion:
    """The path from one configuration, with the shortest blend that keeps accelerations."""
    if path.blend is not None:
        return _track(arm, path, q, path.blend)
    blend = min(SHORTEST_BLEND, path.max_blend)
    motion = _track(arm, path, q, blend)
    too_short = 0.0
    for _ in range(8):
        use = _acceleration_use(motion, arm)
        if use <= 1.0 or blend >= path.max_blend:
            break
        # Accelerations go with 1 / blend where corners cause them; where not, a longer blend
        # does not help, and the caller says what does.
        longer = min(blend * min(1.02 * use, 4.0), path.max_blend)
        if longer > max(path.end - path.start, 4.0 * SHORTEST_BLEND):
            break
        too_short, blend = blend, longer
        motion = _track(arm, path, q, blend, motion)
    # A blend longer than a move between two stops counts twice, so the last step was too long.
    while too_short > 0.0 and motion.blend > 1.06 * too_short:
        if _acceleration_use(motion, arm) > 1.0:
            break
        between = math.sqrt(too_short * motion.blend)
        shorter = _track(arm, path, q, between, motion)
        if _acceleration_use(shorter, arm) <= 1.0:
            motion = shorter
        else:
            too_short = between
    return motion


def _acceleration_use(motion: JointMotion, arm: Arm) -> float:
    return max(use.share for use in motion.limit_uses(arm) if use.kind == "acceleration")


def _track(
    arm: Arm, path: TcpPath, q: Array, blend: float, known: JointMotion | None = None
) -> JointMotion:
    """Solve the joint angles along a path from a start [J], or from those of another blend."""
    solved = None if known is None else _reblended(arm, path, blend, known)
    time, solved = _refined(arm, path, blend, *(solved or _stepped(arm, path, q, blend)))
    return JointMotion(
        time=time, q=solved, events=path.events, blend=blend, deviation=path.deviation(blend)
    )


def _reblended(
    arm: Arm, path: TcpPath, blend: float, known: JointMotion
) -> tuple[Array, Array] | None:
    """Times [K] and joint angles [K, J] of a path, all at once from those at the same places of
    another blend; None: not all are reached."""
    times = _solved_times(path, blend)
    (new, new_way), (old, old_way) = _ways(path, blend), _ways(path, known.blend)
    share = np.interp(times, new, new_way / max(new_way[-1], 1e-12))
    guess = known.at(np.interp(share, old_way / max(old_way[-1], 1e-12), old))
    found, error = descend(
        arm, path.pose_at(times, blend), guess, arm.home, homing=0.0, iterations=_BATCHED
    )
    close = np.abs(np.diff(found, axis=0)).max() <= _LARGEST_JUMP
    return (times, found) if close and reached(error).all() else None


def _ways(path: TcpPath, blend: float) -> tuple[Array, Array]:
    """Dense times [s] and how far the tool has moved by then [m]."""
    time = np.linspace(path.start - 0.5 * blend, path.end + 0.5 * blend, _DENSE)
    shift = np.linalg.norm(np.diff(path.position_at(time, blend), axis=0), axis=1)
    return time, np.concatenate([[0.0], np.cumsum(shift)])


def _stepped(arm: Arm, path: TcpPath, q: Array, blend: float) -> tuple[Array, Array]:
    """Times [K] and joint angles [K, J] of a path from a start [J], each from those before."""
    every = _solved_times(path, blend)
    ahead = [*zip(every, path.pose_at(every, blend), strict=True)][::-1]
    (time, at), found = ahead.pop(), [q]
    times = [time]
    while ahead:
        time, T = ahead[-1]
        moved = float(np.linalg.norm((T - at)[:3, 3]))
        share = min(_HOMING * moved, 0.5)
        (step,), (error,) = descend(arm, T[None], found[-1][None], arm.home, homing=share, homed=1)
        if reached(error) and np.abs(step - found[-1]).max() <= _LARGEST_JUMP:
            _, at = ahead.pop()
            times.append(time)
            found.append(step)
            continue
        # Near a stretched arm some millimetres are large turns: smaller steps lead there.
        if moved < _SMALLEST_SPACING:
            raise _not_followed(arm, T, step, error, time, found[-1])
        between = 0.5 * (times[-1] + time)
        ahead.append((between, path.pose_at(between, blend)))
    return np.array(times), np.array(found)


def _refined(arm: Arm, path: TcpPath, blend: float, time: Array, q: Array) -> tuple[Array, Array]:
    """Add knots where the spline deviates from the path halfway between knots."""
    for _ in range(_REFINEMENTS):
        middle = 0.5 * (time[1:] + time[:-1])
        guess = np.clip(JointMotion(time=time, q=q).at(middle), arm.q_min, arm.q_max)
        poses = path.pose_at(middle, blend)
        off = np.abs(pose_error(poses, tcp_pose(arm, guess))).max(axis=1) > _SPLINE_TOLERANCE
        if not off.any():
            break
        between, error = descend(arm, poses[off], guess[off], arm.home, homing=0.0)
        if not reached(error).all():
            k = int(np.argmin(reached(error)))
            raise _not_followed(arm, poses[off][k], between[k], error[k], middle[off][k])
        time = np.concatenate([time, middle[off]])
        q = np.concatenate([q, between])
        order = np.argsort(time)
        time, q = time[order], q[order]
    return time, q


def _solved_times(path: TcpPath, blend: float) -> Array:
    """Times [K] [s]: dense where the path is rounded, elsewhere spaced by the tool's movement."""
    start, end = path.start - 0.5 * blend, path.end + 0.5 * blend
    corners = path.corners
    edges = np.add.outer(corners, [-0.5 * blend, 0.5 * blend]).ravel()
    edges = np.unique(np.concatenate([[start, end], np.clip(edges, start, end)]))
    times = [start]
    way = np.linalg.norm(np.diff(path.position_at(edges, blend), axis=0), axis=1)
    for (a, b), moved in zip(pairwise(edges), way, strict=True):
        if b - a < 1e-9:
            continue
        if np.any(np.abs(corners - 0.5 * (a + b)) < 0.5 * blend):
            steps = (b - a) * max(_KNOTS_A_BLEND / blend, SOLVED_RATE)
        else:
            steps = min(max(moved / _SPACING, (b - a) / _LONGEST_STEP), (b - a) * SOLVED_RATE)
        steps = max(steps, moved / _LARGEST_SPACING)
        times.extend(np.linspace(a, b, max(math.ceil(steps - 1e-6), 1) + 1)[1:])
    return np.array(times)


def _not_followed(
    arm: Arm, T: Array, q: Array, error: Array, time: float, before: Array | None = None
) -> RobotError:
    """Error: joint angles q [J] [rad] miss a pose of the path, or are a jump from those before."""
    what, where = f"at t = {time:.3f} s ", f"path of {arm.name}"
    if before is not None and reached(error):
        jump = np.abs(q - before)
        what += f"joint {int(jump.argmax()) + 1} would have to jump by {jump.max():.2f} rad, "
        fix = "move or turn the path away from there"
        return RobotError(f"{what}at a singular pose", where=where, fix=fix)
    what += out_of_reach(arm, T, q, error)
    fix = "move the path nearer to the base, or turn the gripper"
    return RobotError(what, where=where, fix=fix)


# ---- timing --------------------------------------------------------------------------------------


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
        at = np.array([e.time for e in motion.events])  # not scaled outside of the motion
        at = np.interp(at, s, time) + at - np.clip(at, s[0], s[-1])
        events = tuple(replace(e, time=t) for e, t in zip(motion.events, at.tolist(), strict=True))
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
        steps = max(_POINTS_A_KNOT, int(np.ceil((b - a) / _GRID_STEP)))
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
    # Upper bounds of u, and lower ones; the last of each says where the step leads.
    most, least = (np.pad(bound, ((0, 0), (0, 1))) for bound in (top, -top))
    lean_on = np.concatenate([lean, 1.0 / step[:, None]], axis=1)
    closing = lean_on[:, :, None] - lean_on[:, None, :]
    reach = np.minimum(highest, np.append(still, np.inf))
    with np.errstate(divide="ignore", invalid="ignore"):
        for i in reversed(range(len(step))):
            most[i, -1] = reach[i + 1] / step[i]
            ends = (most[i][:, None] - least[i]) / closing[i]
            good = closing[i] > 0.0
            reach[i] = np.fmin.reduce(ends, axis=None, initial=reach[i], where=good)
    x = reach.copy()
    for i in range(len(step)):
        u = np.min(top[i] - lean[i] * x[i])
        x[i + 1] = min(max(x[i] + step[i] * u, 0.0), reach[i + 1])
    return x
