"""Timed motions of the joints: from paths of the tool, from joint to joint, and their limits."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from gendom.errors import RobotError
from gendom.files import atomic_path
from gendom.robot.arm import Arm
from gendom.robot.kinematics import (
    descend,
    describe,
    jacobian,
    pose_error,
    reached,
    solutions,
    step_towards,
    tcp_pose,
)
from gendom.robot.path import Deviation, GripperEvent, TcpPath

Array = NDArray[np.float64]

RATE = 100.0
"""Joint angles along a path are solved this often [1/s]: at least so where corners are rounded
off, at most so elsewhere, where 3 mm of way between two times are as good."""

SHORTEST_BLEND = 0.04
"""Blends are not searched below this [s]."""

_KNOTS_A_BLEND = 16
_STEP, _ANGLE_WAY = 0.003, 0.3  # [m], [m/rad]; the tool's way between two solved times
_SLOWEST = 0.2  # [s]; between them at most
_PULL = 3.0  # [1/m]; towards home within the null space, for each metre of the tool's way
_POSTURES = 5  # configurations that a path is tried from
_LARGEST_JUMP = 0.35  # [rad]; between two solved times: more is no continuous motion
_TOLERANCE = 1e-9  # share by which a limit may be passed, for rounding


@dataclass(frozen=True, kw_only=True)
class LimitUse:
    """The largest value of one kind in a motion, beside its limit."""

    kind: str
    """``angle`` [rad], ``speed`` [rad/s], ``acceleration`` [rad/s^2] or ``tool speed`` [m/s]."""
    joint: int | None
    """1 to J; None for the tool."""
    time: float
    """[s]."""
    value: float
    limit: float
    lower: bool = False
    """The limit is the lower end of a range."""

    @property
    def exceeded(self) -> bool:
        """Whether the value is beyond its limit."""
        excess = self.limit - self.value if self.lower else self.value - self.limit
        return excess > _TOLERANCE * abs(self.limit)

    def __str__(self) -> str:
        unit = {"angle": "rad", "speed": "rad/s", "acceleration": "rad/s^2"}
        who = "the tool" if self.joint is None else f"joint {self.joint}"
        kind = "speed" if self.joint is None else self.kind
        amount = f"{kind} {self.value:.4g} {unit.get(self.kind, 'm/s')}"
        return f"{who} at t = {self.time:.3f} s: {amount}, limit {self.limit:.4g}"


@dataclass(frozen=True, kw_only=True, eq=False)
class JointMotion:
    """Joint angles over time: a cubic spline that starts and ends at rest.

    Raises:
        RobotError: Shapes do not agree, times do not increase or a number is not finite.
    """

    time: Array
    """[K] of the knots [s]; before and after them the arm stands still."""
    q: Array
    """[K, J] joint angles [rad]."""
    events: tuple[GripperEvent, ...] = ()
    """When the gripper closes and opens, in order of time."""
    blend: float = 0.0
    """Time over which the path's corners were rounded off [s]."""
    deviation: Deviation | None = None
    """How far that is from the ideal path; None: it came from no path."""
    slowed_by: float = 1.0
    """How much longer it takes than the path asked for."""

    def __post_init__(self) -> None:
        time, q = np.asarray(self.time, dtype=float), np.asarray(self.q, dtype=float)
        if time.ndim != 1 or len(time) < 2 or q.ndim != 2 or len(q) != len(time):
            raise RobotError(
                f"needs time [K >= 2] and q [K, J], got {time.shape} and {q.shape}",
                where="joint motion",
            )
        if not (np.isfinite(time).all() and np.isfinite(q).all()):
            raise RobotError("holds a number that is not finite", where="joint motion")
        if np.any(np.diff(time) <= 0.0):
            raise RobotError("its times do not increase", where="joint motion", fix="sort them")
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "q", q)

    @cached_property
    def spline(self) -> CubicSpline:
        """Angles [J] [rad] as a function of time [s], within the knots."""
        return CubicSpline(self.time, self.q, bc_type="clamped")

    @property
    def start(self) -> float:
        """[s]."""
        return float(self.time[0])

    @property
    def end(self) -> float:
        """[s]."""
        return float(self.time[-1])

    def at(self, time: ArrayLike) -> Array:
        """[..., J] joint angles [rad] at times [...] [s]."""
        return self.spline(np.clip(time, self.start, self.end))

    def speed_at(self, time: ArrayLike) -> Array:
        """[..., J] joint speeds [rad/s]."""
        return self._derivative(time, 1)

    def acceleration_at(self, time: ArrayLike) -> Array:
        """[..., J] joint accelerations [rad/s^2]."""
        return self._derivative(time, 2)

    def _derivative(self, time: ArrayLike, order: int) -> Array:
        time = np.asarray(time, dtype=float)
        moving = (time >= self.start) & (time <= self.end)
        return self.spline(np.clip(time, self.start, self.end), order) * moving[..., None]

    def closed_at(self, time: float) -> bool | None:
        """Whether the gripper was last told to close; None: it was told nothing yet."""
        told = [event.closed for event in self.events if event.time <= time]
        return told[-1] if told else None

    # ---- limits ----------------------------------------------------------------------------------

    def limit_uses(self, arm: Arm) -> list[LimitUse]:
        """The largest angle, speed and acceleration of each joint, and the tool's speed.

        Extremes of the spline are exact; the tool's speed is looked at on the knots and halfway
        between them.
        """
        uses = []
        half = 0.5 * (arm.q_max - arm.q_min)
        middle = arm.q_min + half
        for j in range(self.q.shape[1]):
            t, q = self._extremes(0, j)
            k = int(np.argmax(np.abs(q - middle[j]) - half[j]))
            lower = bool(q[k] < middle[j])
            limit = arm.q_min[j] if lower else arm.q_max[j]
            uses.append(_use("angle", j, t[k], q[k], limit, lower))
            for order, kind, limits in (
                (1, "speed", arm.max_speed),
                (2, "acceleration", arm.max_acceleration),
            ):
                t, value = self._extremes(order, j)
                k = int(np.argmax(np.abs(value)))
                uses.append(_use(kind, j, t[k], abs(value[k]), limits[j]))
        t = np.sort(np.concatenate([self.time, 0.5 * (self.time[1:] + self.time[:-1])]))
        rates = jacobian(arm, self.at(t))[:, :3] @ self.speed_at(t)[..., None]
        speed = np.linalg.norm(rates[..., 0], axis=1)
        k = int(np.argmax(speed))
        uses.append(
            LimitUse(
                kind="tool speed",
                joint=None,
                time=float(t[k]),
                value=float(speed[k]),
                limit=arm.max_tcp_speed,
            )
        )
        return uses

    def _extremes(self, order: int, joint: int) -> tuple[Array, Array]:
        """Times and values among which a derivative's extremes are, the knots included."""
        time = self.time
        if order < 2:
            c = self.spline.c[:, :, joint]
            if order == 0:
                a, b, d = 3.0 * c[0], 2.0 * c[1], c[2]
                with np.errstate(divide="ignore", invalid="ignore"):
                    root = np.sqrt(b * b - 4.0 * a * d)
                    # stable for small a, where the spline is nearly a parabola
                    s = -0.5 * (b + np.where(b < 0.0, -root, root))
                    inside = np.concatenate([s / a, d / s])
            else:
                with np.errstate(divide="ignore", invalid="ignore"):
                    inside = -c[1] / (3.0 * c[0])
            steps = np.tile(np.diff(time), len(inside) // (len(time) - 1))
            starts = np.tile(time[:-1], len(inside) // (len(time) - 1))
            good = np.isfinite(inside) & (inside > 0.0) & (inside < steps)
            time = np.concatenate([time, starts[good] + inside[good]])
        return time, self.spline(time, order)[:, joint]

    def check_limits(self, arm: Arm) -> None:
        """Refuse a motion that the arm cannot carry out.

        Raises:
            RobotError: A limit is passed: it names joint, time, value and limit, and how many
                times longer the motion must take.
        """
        broken = [use for use in self.limit_uses(arm) if use.exceeded]
        if not broken:
            return
        worst = max(broken, key=lambda use: (use.kind == "angle", _ratio(use)))
        more = f" (and {len(broken) - 1} more)" if len(broken) > 1 else ""
        if worst.kind == "angle":
            fix = "choose another pose or orientation: slowing down does not help"
        else:
            fix = f"take {self.slowdown(arm):.3f} times as long"
        raise RobotError(f"{worst}{more}", where=f"motion of {arm.name}", fix=fix)

    def slowdown(self, arm: Arm) -> float:
        """The shortest duration at which speeds and accelerations keep their limits, in its own.

        Below 1 where the motion could be faster. Stretching time by f divides speeds by f and
        accelerations by f^2.
        """
        return max(
            math.sqrt(_ratio(use)) if use.kind == "acceleration" else _ratio(use)
            for use in self.limit_uses(arm)
            if use.kind != "angle"
        )

    # ---- other motions ---------------------------------------------------------------------------

    def stretched(self, factor: float) -> JointMotion:
        """The same motion in `factor` times the time, from the same start.

        Raises:
            RobotError: The factor is not positive and finite.
        """
        if not (math.isfinite(factor) and factor > 0.0):
            raise RobotError(
                f"cannot take {factor} times as long", where="joint motion", fix="give a number > 0"
            )
        return replace(
            self,
            time=self.start + factor * (self.time - self.start),
            events=tuple(
                replace(e, time=self.start + factor * (e.time - self.start)) for e in self.events
            ),
            blend=factor * self.blend,
            slowed_by=factor * self.slowed_by,
        )

    def shifted(self, seconds: float) -> JointMotion:
        """The same motion, later by some seconds."""
        return replace(
            self,
            time=self.time + seconds,
            events=tuple(replace(e, time=e.time + seconds) for e in self.events),
        )

    def then(self, other: JointMotion, *, pause: float = 0.0) -> JointMotion:
        """This motion and then another, which starts where this one ends.

        Args:
            other: Shifted in time to follow.
            pause: Between them [s].

        Raises:
            RobotError: The other one starts elsewhere, by more than 1e-4 rad.
        """
        gap = np.abs(other.q[0] - self.q[-1])
        if gap.max() > 1e-4:
            raise RobotError(
                f"joint {int(gap.argmax()) + 1} ends at {self.q[-1][gap.argmax()]:.4f} rad and the "
                f"next motion starts at {other.q[0][gap.argmax()]:.4f}",
                where="joint motion",
                fix="put a joint move between them",
            )
        late = other.shifted(self.end + pause - other.start)
        # The joint's knot is kept once; a pause is held by knots of its own.
        held = [self.end + pause * share for share in (0.25, 0.5, 0.75)] if pause > 0.0 else []
        keep = 0 if pause > 0.0 else 1
        return JointMotion(
            time=np.concatenate([self.time, held, late.time[keep:]]),
            q=np.concatenate([self.q, *([self.q[-1:]] * len(held)), late.q[keep:]]),
            events=(*self.events, *late.events),
        )

    # ---- the tool --------------------------------------------------------------------------------

    def tcp_at(self, arm: Arm, time: ArrayLike) -> Array:
        """T_base_tcp [..., 4, 4] at times [...] [s]."""
        return tcp_pose(arm, self.at(time))

    def sampled(self, rate: float) -> Array:
        """[T] times from start to end [s], evenly and at least at a rate [1/s]."""
        steps = max(1, math.ceil((self.end - self.start) * rate - 1e-9))
        return np.linspace(self.start, self.end, steps + 1)

    def write_gripper(self, path: str | os.PathLike, arm: Arm, *, rate: float = RATE) -> None:
        """Write where the tool point goes as gripper.csv: time,x,y,z in seconds and metres.

        Raises:
            GendomError: The file cannot be written.
        """
        time = self.sampled(rate)
        position = self.tcp_at(arm, time)[:, :3, 3]
        _write_csv(path, "time,x,y,z", np.column_stack([time, position]))

    def write_joints(
        self,
        path: str | os.PathLike,
        *,
        rate: float = RATE,
        opening: tuple[float, float] | None = None,
    ) -> None:
        """Write joint angles as joints.csv, as `gendom.robot.read_joints` reads it.

        Args:
            path: The file.
            rate: Rows a second.
            opening: The gripper's opening when closed and when open [m]; None leaves it out.

        Raises:
            GendomError: The file cannot be written.
        """
        time = self.sampled(rate)
        columns = [time, *self.at(time).T]
        header = ["time", *(f"q{j}" for j in range(self.q.shape[1]))]
        if opening is not None:
            header.append("gripper")
            columns.append(np.array([opening[0 if self.closed_at(t) else 1] for t in time]))
        _write_csv(path, ",".join(header), np.column_stack(columns))


def _use(
    kind: str, joint: int, time: float, value: float, limit: float, lower: bool = False
) -> LimitUse:
    return LimitUse(
        kind=kind,
        joint=joint + 1,
        time=float(time),
        value=float(value),
        limit=float(limit),
        lower=lower,
    )


def _ratio(use: LimitUse) -> float:
    return abs(use.value / use.limit) if use.limit != 0.0 else math.inf


def _write_csv(path: str | os.PathLike, header: str, rows: Array) -> None:
    with atomic_path(path) as temporary:
        np.savetxt(temporary, rows, fmt="%.9g", delimiter=",", header=header, comments="")


# ---- from joint to joint -------------------------------------------------------------------------


def joint_move(
    arm: Arm, q_from: ArrayLike, q_to: ArrayLike, *, share: float = 1.0, start: float = 0.0
) -> JointMotion:
    """From rest to rest, all joints together, as fast as a share of the limits lets them.

    A quintic in time, q = q_from + (q_to - q_from) (10 s^3 - 15 s^4 + 6 s^5): its largest speed
    is 15 / 8, acceleration 10 / sqrt(3) and jerk 60 of the way over T, T^2 and T^3.

    Args:
        arm: Its limits, the tool's speed included.
        q_from, q_to: [J] joint angles [rad].
        share: Of the limits of speed, acceleration and jerk, in (0, 1].
        start: When it begins [s].

    Raises:
        RobotError: An end is out of the joints' limits, or the share is out of its range.
    """
    if not 0.0 < share <= 1.0:
        raise RobotError(f"share is {share}", where="joint move", fix="give 0 < share <= 1")
    ends = [arm.check_q(q) for q in (q_from, q_to)]
    for q in ends:
        out = (q < arm.q_min) | (q > arm.q_max)
        if out.any():
            j = int(np.argmax(out))
            raise RobotError(
                f"joint {j + 1} at {q[j]:.4f} rad, limits {arm.q_min[j]:.4f} to {arm.q_max[j]:.4f}",
                where=f"move of {arm.name}",
                fix="choose another configuration",
            )
    way = np.abs(ends[1] - ends[0])
    duration = max(
        float(np.max(15.0 / 8.0 * way / (share * arm.max_speed))),
        float(np.max(np.sqrt(10.0 / math.sqrt(3.0) * way / (share * arm.max_acceleration)))),
        float(np.max(np.cbrt(60.0 * way / (share * arm.max_jerk)))),
        0.01,
    )
    s = np.linspace(0.0, 1.0, 65)
    shape = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    q = ends[0] + shape[:, None] * (ends[1] - ends[0])
    motion = JointMotion(time=start + duration * s, q=q)
    # The tool may be too fast, and the spline through the knots misses the quintic by 1e-6.
    slower = replace(arm, max_tcp_speed=share * arm.max_tcp_speed)
    return replace(motion.stretched(max(1.0, motion.slowdown(slower))), slowed_by=1.0)


# ---- along a path of the tool --------------------------------------------------------------------


def follow(
    arm: Arm,
    path: TcpPath,
    *,
    near: ArrayLike | None = None,
    rate: float = RATE,
    blend: float | None = None,
    slow_down: bool = False,
) -> JointMotion:
    """Joint angles that carry the tool along a path.

    Inverse kinematics is solved at the start and then followed along the path; the redundant
    joint leans towards home in proportion to the tool's way, so it rests when the tool does.
    Where the arm is out of limits the path is tried from other configurations.

    Args:
        arm: The arm.
        path: Its corners are rounded off by `blend`.
        near: [J] joint angles that the start is chosen near to [rad]; None: home.
        rate: How often joint angles are solved [1/s], see `RATE`.
        blend: [s]; None: as short as the joints' accelerations allow (within a few percent), at
            least `SHORTEST_BLEND`, at most the path's `max_blend`.
        slow_down: Take more time where speeds or accelerations would pass their limits.

    Returns:
        A motion within the limits, its deviation from the ideal path stated.

    Raises:
        RobotError: A part of the path is out of reach or cannot be reached continuously, or a
            limit is passed.
    """
    first = path.pose_at(path.start)
    postures = solutions(arm, first, near=near)[:_POSTURES]
    best: JointMotion | None = None
    refusal: RobotError | None = None
    for q in postures:
        try:
            motion = _from_posture(arm, path, q, rate, blend)
        except RobotError as error:
            refusal = refusal or error
            continue
        if not any(use.exceeded for use in motion.limit_uses(arm)):
            return motion
        if best is None or _badness(motion, arm) < _badness(best, arm):
            best = motion
    if best is None:
        assert refusal is not None
        raise refusal
    if not slow_down or any(u.exceeded and u.kind == "angle" for u in best.limit_uses(arm)):
        best.check_limits(arm)
    return _slowed(arm, path, best, rate, blend)


def _badness(motion: JointMotion, arm: Arm) -> tuple[bool, float]:
    out = any(use.exceeded and use.kind == "angle" for use in motion.limit_uses(arm))
    return out, motion.slowdown(arm)


def _from_posture(
    arm: Arm, path: TcpPath, q: Array, rate: float, blend: float | None
) -> JointMotion:
    """The path from one configuration, with the shortest blend that keeps accelerations."""
    if blend is not None:
        return _track(arm, path, q, rate, blend)
    blend = min(SHORTEST_BLEND, path.max_blend)
    motion = _track(arm, path, q, rate, blend)
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
        motion = _track(arm, path, q, rate, blend)
    # A blend longer than a move between two stops counts twice, so the last step was too long.
    while too_short > 0.0 and motion.blend > 1.06 * too_short:
        if _acceleration_use(motion, arm) > 1.0:
            break
        between = math.sqrt(too_short * motion.blend)
        shorter = _track(arm, path, q, rate, between)
        if _acceleration_use(shorter, arm) <= 1.0:
            motion = shorter
        else:
            too_short = between
    return motion


def _acceleration_use(motion: JointMotion, arm: Arm) -> float:
    return max(_ratio(use) for use in motion.limit_uses(arm) if use.kind == "acceleration")


def _slowed(
    arm: Arm, path: TcpPath, motion: JointMotion, rate: float, blend: float | None
) -> JointMotion:
    """A motion along the slowed path that keeps the limits, as quick a one as is found."""
    # Stretching the motion as it is, blends included, always helps. Where speeds are at fault,
    # a slower path may do with shorter blends.
    best = motion.stretched(1.001 * motion.slowdown(arm))
    if blend is not None:
        return best
    factor = 1.001 * max(_ratio(u) for u in motion.limit_uses(arm) if u.kind.endswith("speed"))
    for _ in range(3):
        if factor <= 1.0:
            break
        quicker = _from_posture(arm, path.slowed(factor), motion.q[0], rate, None)
        within = not any(use.exceeded for use in quicker.limit_uses(arm))
        if within and quicker.end - quicker.start < best.end - best.start:
            return replace(quicker, slowed_by=factor)
        factor *= 1.001 * quicker.slowdown(arm)
    return best


def _track(arm: Arm, path: TcpPath, q: Array, rate: float, blend: float) -> JointMotion:
    """Solve the joint angles along a path, each from the one before."""
    time = _solved_times(path, rate, blend)
    poses = path.pose_at(time, blend)
    found = np.empty((len(time), arm.joints))
    found[0] = q
    for k in range(1, len(time)):
        found[k] = _next(arm, poses[k], found[k - 1], time[k])
    return JointMotion(
        time=time, q=found, events=path.events, blend=blend, deviation=path.deviation(blend)
    )


def _solved_times(path: TcpPath, rate: float, blend: float) -> Array:
    """[K] times [s]: dense where the path is rounded off; between, as the tool's way needs."""
    start, end = path.start - 0.5 * blend, path.end + 0.5 * blend
    corners = path.corners()
    edges = np.add.outer(corners, [-0.5 * blend, 0.5 * blend]).ravel()
    edges = np.unique(np.concatenate([[start, end], np.clip(edges, start, end)]))
    times = [start]
    for a, b in pairwise(edges):
        if b - a < 1e-9:
            continue
        if np.any(np.abs(corners - 0.5 * (a + b)) < 0.5 * blend):
            steps = (b - a) * max(_KNOTS_A_BLEND / blend, rate)
        else:
            there, here = path.pose_at(np.array([b, a]), blend)
            way, turn = np.split(pose_error(there, here), 2)
            way = np.linalg.norm(way) + _ANGLE_WAY * np.linalg.norm(turn)
            steps = min(max(way / _STEP, (b - a) / _SLOWEST), (b - a) * rate)
        times.extend(np.linspace(a, b, max(math.ceil(steps - 1e-6), 1) + 1)[1:])
    return np.array(times)


def _next(arm: Arm, T: Array, q: Array, time: float) -> Array:
    """Joint angles [J] at a pose a little further on."""
    found = step_towards(arm, T, q, arm.home, pull=_PULL)
    if found is None:
        left, error = descend(arm, T[None], q[None], arm.home, pull=0.0)
        if not reached(error)[0]:
            raise _lost(arm, T, left[0], error[0], time)
        # It is there, on a way with more turns than one step takes.
        found = left[0]
    jump = np.abs(found - q)
    if jump.max() > _LARGEST_JUMP:
        raise RobotError(
            f"at t = {time:.3f} s joint {int(jump.argmax()) + 1} would have to jump by "
            f"{jump.max():.2f} rad, near a singular pose",
            where=f"path of {arm.name}",
            fix="move or turn the path away from there, or give a higher rate",
        )
    return found


def _lost(arm: Arm, T: Array, q: Array, error: Array, time: float) -> RobotError:
    """That a path goes out of reach, and how far the nearest joint angles [J] are off."""
    off = f"{1e3 * np.linalg.norm(error[:3]):.2g} mm and "
    off += f"{np.degrees(np.linalg.norm(error[3:])):.2g} degrees"
    held = np.flatnonzero((q <= arm.q_min) | (q >= arm.q_max))
    ends = f", joint {' and '.join(str(j + 1) for j in held)} at its end" if len(held) else ""
    return RobotError(
        f"at t = {time:.3f} s the path goes out of reach: {describe(T)} is missed by {off}{ends}",
        where=f"path of {arm.name}",
        fix="move the path nearer to the base, or turn the gripper",
    )
