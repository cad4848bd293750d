"""Timed joint motions, their use of an arm's limits, and joint angles over time as joints.csv."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PPoly

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import RobotError
from gendom.files import atomic_path
from gendom.reading import read_number_table
from gendom.robot.arm import Arm
from gendom.robot.kinematics import jacobian, tcp_pose
from gendom.robot.path import Timed

RATE = 100.0
"""Rows a second of written files [1/s]."""

_TOLERANCE = 1e-9  # share by which a limit may be passed, for rounding


@dataclass(frozen=True)
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
    share: float
    """Of the limit; of an angle of half its range, from the middle."""

    @property
    def exceeded(self) -> bool:
        """Whether the value is beyond its limit."""
        return self.share > 1.0 + _TOLERANCE

    def __str__(self) -> str:
        unit = {"angle": "rad", "speed": "rad/s", "acceleration": "rad/s^2"}
        who = "the tool" if self.joint is None else f"joint {self.joint}"
        kind = "speed" if self.joint is None else self.kind
        amount = f"{kind} {self.value:.4g} {unit.get(self.kind, 'm/s')}"
        return f"{who} at t = {self.time:.3f} s: {amount}, limit {self.limit:.4g}"


@dataclass(frozen=True, kw_only=True, eq=False)
class JointMotion(Timed):
    """Joint angles over time: a cubic spline that starts and ends at rest.

    Raises:
        RobotError: Shapes do not agree, times do not increase or a number is not finite.
    """

    q: Array
    """[K, J] joint angles [rad]."""
    blend: float = 0.0
    """Time over which the path's corners were rounded off [s]."""
    deviation: float = 0.0
    """Largest distance of the tool from the ideal path at the same time [m]."""
    slowed_by: float = 1.0
    """Duration over the duration of the path."""

    def __post_init__(self) -> None:
        time, q = np.asarray(self.time, dtype=float), np.asarray(self.q, dtype=float)
        fits = time.ndim == 1 and len(time) >= 2 and q.ndim == 2 and len(q) == len(time)
        _require(fits, f"needs time [K >= 2] and q [K, J], got {time.shape} and {q.shape}")
        finite = np.isfinite(time).all() and np.isfinite(q).all()
        _require(finite, "holds a number that is not finite")
        _require(np.all(np.diff(time) > 0.0), "its times do not increase", fix="sort them")
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "q", q)

    @cached_property
    def spline(self) -> CubicSpline:
        """Angles [J] [rad] as a function of time [s], within the knots."""
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                return CubicSpline(self.time, self.q, bc_type="clamped")
        except ValueError:  # slopes between knots that overflow
            raise RobotError("turns faster than numbers can say", fix="make it again") from None

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
        """Whether the gripper is closed after the last event; None: before the first event."""
        told = [event.closed for event in self.events if event.time <= time]
        return told[-1] if told else None

    # ---- limits ----------------------------------------------------------------------------------

    def limit_uses(self, arm: Arm) -> list[LimitUse]:
        """The largest angle, speed and acceleration of each joint, and the tool's speed.

        Extremes of the spline are exact; the tool's speed is evaluated at the knots and halfway
        between them.

        Raises:
            RobotError: The arm has another number of joints.
        """
        arm.check_q(self.q)
        # joint by joint: of several at once SciPy 1.17 loses a root that two have alike
        turns = [
            [PPoly(own.c[..., j], own.x).roots(False, False) for j in range(arm.joints)]
            for own in (self.spline.derivative(order) for order in (1, 2))
        ]
        middle, half = 0.5 * (arm.q_min + arm.q_max), 0.5 * (arm.q_max - arm.q_min)
        limits = {"angle": half, "speed": arm.max_speed, "acceleration": arm.max_acceleration}
        uses = []
        for j in range(arm.joints):
            for order, (kind, most) in enumerate(limits.items()):
                inside = turns[order][j] if order < 2 else np.empty(0)
                t = np.concatenate([self.time, inside[np.isfinite(inside)]])
                off = self.spline(t, order)[:, j] - (0.0 if order else middle[j])
                k = int(np.argmax(np.abs(off)))
                uses.append(_use(kind, j + 1, t[k], abs(off[k]), most[j]))
                if order == 0:  # an angle's limit is an end of its range
                    sign = np.copysign(1.0, off[k])
                    value, limit = middle[j] + off[k], middle[j] + sign * most[j]
                    uses[-1] = replace(uses[-1], value=float(value), limit=float(limit))
        t = np.sort(np.concatenate([self.time, 0.5 * (self.time[1:] + self.time[:-1])]))
        rates = jacobian(arm, self.at(t))[:, :3] @ self.speed_at(t)[..., None]
        speed = np.linalg.norm(rates[..., 0], axis=1)
        k = int(np.argmax(speed))
        return [*uses, _use("tool speed", None, t[k], speed[k], arm.max_tcp_speed)]

    def check_limits(self, arm: Arm) -> None:
        """Check that the motion is within the arm's limits.

        Raises:
            RobotError: A limit is exceeded; the error names joint, time, value and limit, and the
                factor by which the motion must be slowed down.
        """
        broken = [use for use in self.limit_uses(arm) if use.exceeded]
        if not broken:
            return
        worst = max(broken, key=lambda use: (use.kind == "angle", use.share))
        more = f" (and {len(broken) - 1} more)" if len(broken) > 1 else ""
        if worst.kind == "angle":
            fix = "choose another pose or orientation: slowing down does not help"
        else:
            fix = f"take {self.slowdown(arm):.3f} times as long"
        raise RobotError(f"{worst}{more}", where=f"motion of {arm.name}", fix=fix)

    def slowdown(self, arm: Arm) -> float:
        """Shortest duration within the limits of speed and acceleration, over the duration.

        Below 1 if the motion could be faster. Stretching time by f divides speeds by f and
        accelerations by f^2.
        """
        return max(
            math.sqrt(use.share) if use.kind == "acceleration" else use.share
            for use in self.limit_uses(arm)
            if use.kind != "angle"
        )

    # ---- other motions ---------------------------------------------------------------------------

    def stretched(self, factor: float) -> JointMotion:
        """The same motion in `factor` times the time, from the same start.

        Raises:
            RobotError: The factor is not positive and finite.
        """
        positive = math.isfinite(factor) and factor > 0.0
        _require(positive, f"cannot take {factor} times as long", fix="give a number > 0")
        slower = self.retimed(lambda time: self.start + factor * (time - self.start))
        return replace(slower, slowed_by=factor * self.slowed_by)

    def then(self, other: JointMotion) -> JointMotion:
        """This motion and then another, which starts where this one ends.

        Raises:
            RobotError: The start of the other motion differs by more than 1e-4 rad.
        """
        gap = float(np.abs(other.q[0] - self.q[-1]).max())
        what = f"ends {gap:.4f} rad from where the next one starts"
        _require(gap <= 1e-4, what, fix="put a joint move between them")
        late = other.shifted(self.end - other.start)
        return JointMotion(
            time=np.concatenate([self.time, late.time[1:]]),  # the common knot is kept once
            q=np.concatenate([self.q, late.q[1:]]),
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

    def write_joints(
        self, path: str | os.PathLike, *, opening: tuple[float, float] | None = None
    ) -> None:
        """Write joint angles as joints.csv, as `gendom.robot.read_joints` reads it.

        Args:
            path: The file.
            opening: The gripper's opening when closed and when open [m]; None leaves it out.

        Raises:
            GendomError: The file cannot be written.
        """
        time = self.sampled(RATE)
        names, columns = ["time", *(f"q{j}" for j in range(self.q.shape[1]))], [time, self.at(time)]
        if opening is not None:
            names.append("gripper")
            columns.append(np.array([opening[0 if self.closed_at(t) else 1] for t in time]))
        rows, header = np.column_stack(columns), ",".join(names)
        with atomic_path(path) as temporary:
            np.savetxt(temporary, rows, fmt="%.9g", delimiter=",", header=header, comments="")


@dataclass(frozen=True, eq=False)
class JointStates:
    """Measured joint angles of a robot over time."""

    time: Array
    """[M] increasing times [s]."""
    q: Array
    """[M, J] joint angles [rad]."""
    opening: Array | None = None
    """[M] distance of the fingers' inner faces [m]; None: unknown."""


def read_joints(
    path: str | os.PathLike, arm: Arm, *, on_cut: Callable[[int], None] | None = None
) -> JointStates:
    """The joint angles of a file joints.csv, in order of time under `time,q0,...,q6[,gripper]`:
    seconds, angles in radians from the base to the flange, and the distance of the fingers' inner
    faces in metres.

    Args:
        path: The file.
        arm: The arm to which the joints belong.
        on_cut: Called with the number of the last line if it is incomplete because the recording
            was interrupted. The line is then skipped; None: an incomplete line is an error.

    Raises:
        RobotError: The file cannot be read, a row is malformed or out of order, or a joint is
            out of its range by more than 0.1 rad, as angles in degrees are.
    """
    expected = ["time", *(f"q{j}" for j in range(arm.joints))]
    form = f"{','.join(expected)}[,gripper]"

    def check_header(names: list[str]) -> None:
        known, what = (expected, [*expected, "gripper"]), f"has the header {','.join(names)[:60]!r}"
        fix = f"write rows under {form}"
        require(names in known, what, where=str(path), fix=fix, error=RobotError)

    _, table, lines = read_number_table(
        path, header=form, check_header=check_header, on_cut=on_cut, error=RobotError
    )
    time, q, opening = table[:, 0], table[:, 1 : 1 + arm.joints], table[:, 1 + arm.joints :]
    beyond = np.maximum(arm.q_min - q, q - arm.q_max)
    j, widest = beyond.argmax(axis=1), arm.gripper.max_opening
    good = np.array([
        np.isfinite(table).all(axis=1),
        np.diff(time, prepend=-np.inf) > 0.0,
        beyond.max(axis=1) <= 0.1,
        ((opening >= -0.005) & (opening <= widest + 0.005)).all(axis=1),
    ])  # fmt: skip
    for check, k in np.argwhere(~good)[:1]:
        low, high = arm.q_min[j[k]], arm.q_max[j[k]]
        wide = f"the gripper's opening is {opening[k].sum():g} m, it goes to {widest:g}"
        turned = f"joint {j[k] + 1} is at {q[k, j[k]]:g} rad, its range on {arm.name} is "
        what, fix = (
            ("a number is not finite", "give seconds, radians and metres"),
            (f"time goes from {time[k - 1]:g} to {time[k]:g} s", "sort the rows"),
            (f"{turned}{low:.3f} to {high:.3f}", "give radians, from the base to the flange"),
            (wide, "give metres between the fingers"),
        )[check]
        raise RobotError(what, where=f"{path}, line {lines[k]}", fix=fix)
    return JointStates(time, q, opening[:, 0] if opening.size else None)


def _use(kind: str, joint: int | None, time: float, value: float, limit: float) -> LimitUse:
    return LimitUse(kind, joint, float(time), float(value), float(limit), float(value / limit))


def _require(holds: Any, what: str, *, fix: str | None = None) -> None:
    require(holds, what, where="joint motion", fix=fix, error=RobotError)
