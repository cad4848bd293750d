"""Whether the arm touches itself, the table or what stands around it.

Shapes are the capsules of `gendom.robot.shape`. Capsules of one link and of neighbouring links
overlap by their making and are not compared; what stands around is not compared with the base,
which never moves. The object in the fingers is not looked at.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.errors import RobotError
from gendom.robot.arm import Arm
from gendom.robot.distance import segment_to_box, segments_apart
from gendom.robot.kinematics import check_pose, link_poses
from gendom.robot.motion import JointMotion
from gendom.robot.shape import ArmShape, arm_shape

Array = NDArray[np.float64]

RESOLUTION = 2e-4
"""Largest movement of any part between two checked configurations of a motion [m]."""

_RATE = 50.0  # [1/s]; a motion is first checked at this rate, and at its knots
_CHUNK = 1024  # configurations at a time, for memory


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """A box-shaped obstacle: a camera's housing, a board, a shelf.

    Raises:
        RobotError: The pose is none, or a size is not above 0.
    """

    name: str
    """What messages call it."""
    pose: Array
    """T_base_box [4, 4]: its middle, and its edges along its axes [m]."""
    size: tuple[float, float, float]
    """Lengths of its edges [m]."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", check_pose(self.pose))
        size = np.asarray(self.size, dtype=float)
        if size.shape != (3,) or not (np.isfinite(size).all() and np.all(size > 0.0)):
            raise RobotError(
                f"its size is {self.size}", where=self.name, fix="give three lengths in metres"
            )

    def gap(self, start: Array, end: Array) -> Array:
        """[...] signed distance from segments [..., 3] [m]."""
        R, p = self.pose[:3, :3], self.pose[:3, 3]
        return segment_to_box((start - p) @ R, (end - p) @ R, 0.5 * np.asarray(self.size))


@dataclass(frozen=True, kw_only=True, eq=False)
class Post:
    """A capsule-shaped obstacle: a pole, a stand, a cable.

    Raises:
        RobotError: An end is no point, or the radius is not above 0.
    """

    name: str
    """What messages call it."""
    start: Array
    """[3] one end of its axis in the base's frame [m]."""
    end: Array
    """[3] the other end [m]."""
    radius: float
    """[m]."""

    def __post_init__(self) -> None:
        for name in ("start", "end"):
            point = np.asarray(getattr(self, name), dtype=float)
            if point.shape != (3,) or not np.isfinite(point).all():
                raise RobotError(
                    f"its {name} is {point.tolist()}", where=self.name, fix="give [3] in metres"
                )
            object.__setattr__(self, name, point)
        if not (np.isfinite(self.radius) and self.radius > 0.0):
            raise RobotError(
                f"its radius is {self.radius}", where=self.name, fix="give metres above 0"
            )

    def gap(self, start: Array, end: Array) -> Array:
        """[...] distance from segments [..., 3] [m]."""
        return segments_apart(start, end, self.start, self.end) - self.radius


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """The obstacles around an arm."""

    table_height: float | None = None
    """z of a table below all of the arm but its base [m]; None: there is none."""
    obstacles: tuple[Box | Post, ...] = ()
    """With different names."""


ALONE = Surroundings()
"""No obstacles: only self-collision of the arm is checked."""


@dataclass(frozen=True, kw_only=True)
class Collision:
    """A collision of two bodies."""

    first: str
    """A capsule of the arm."""
    second: str
    """Another one, "table", or an obstacle's name."""
    depth: float
    """How far they overlap at worst [m]."""
    time: float | None = None
    """When they first touch [s]; None: at a pose."""
    deepest: float | None = None
    """When they overlap most [s]."""

    def __str__(self) -> str:
        if self.time is None or self.deepest is None:
            return f"{self.first} and {self.second} overlap by {1e3 * self.depth:.1f} mm"
        return (
            f"from t = {self.time:.3f} s on {self.first} and {self.second} collide, "
            f"{1e3 * self.depth:.1f} mm deep at t = {self.deepest:.3f} s"
        )


@dataclass(frozen=True, eq=False)
class Gaps:
    """Distances of P pairs of bodies, at one or more configurations."""

    pairs: tuple[tuple[str, str], ...]
    """[P] names."""
    gap: Array
    """[..., P] [m]; negative: they overlap by so much."""


def gaps(
    arm: Arm, q: ArrayLike, surroundings: Surroundings = ALONE, *, opening: float = 0.0
) -> Gaps:
    """Distances of all pairs that might collide.

    Args:
        arm: The arm.
        q: [..., J] joint angles [rad].
        surroundings: What stands around.
        opening: Distance of the fingers' inner faces [m].

    Raises:
        RobotError: As `link_poses`.
    """
    return _Compared(arm, surroundings, opening).at(arm.check_q(q))


def collision_at(
    arm: Arm, q: ArrayLike, surroundings: Surroundings = ALONE, *, opening: float = 0.0
) -> Collision | None:
    """The deepest collision at joint angles [J] [rad], or None.

    Raises:
        RobotError: As `link_poses`.
    """
    found = gaps(arm, q, surroundings, opening=opening)
    k = int(np.argmin(found.gap))
    if found.gap[k] >= 0.0:
        return None
    first, second = found.pairs[k]
    return Collision(first=first, second=second, depth=float(-found.gap[k]))


def collision_along(
    arm: Arm,
    motion: JointMotion,
    surroundings: Surroundings = ALONE,
    *,
    opening: float = 0.0,
) -> Collision | None:
    """The first collision of a motion, or None.

    No collision between two checked times is missed: where a pair's distances at both times are
    smaller than its possible movement in between, the arm is also checked halfway, down to
    movements of `RESOLUTION`. An overlap of half of that may be missed.

    Raises:
        RobotError: As `link_poses`.
    """
    compared = _Compared(arm, surroundings, opening)
    time = np.union1d(motion.time, motion.sampled(_RATE))
    gap = compared.at(motion.at(time)).gap
    seen = [(time, gap)]
    a, b, gap_a, gap_b = time[:-1], time[1:], gap[:-1], gap[1:]
    while len(a):
        moved = _turned(motion, a, b) @ compared.levers  # [intervals, P]
        unsure = (gap_a + gap_b <= moved) & (moved > RESOLUTION)
        # Known collisions need no refinement.
        some = (unsure & (gap_a > 0.0) & (gap_b > 0.0)).any(axis=1)
        a, b, gap_a, gap_b = a[some], b[some], gap_a[some], gap_b[some]
        middle = 0.5 * (a + b)
        gap = compared.at(motion.at(middle)).gap if len(middle) else gap_a
        seen.append((middle, gap))
        a, b = np.concatenate([a, middle]), np.concatenate([middle, b])
        gap_a, gap_b = np.concatenate([gap_a, gap]), np.concatenate([gap, gap_b])
    time = np.concatenate([t for t, _ in seen])
    gap = np.concatenate([g for _, g in seen])
    hit = (gap < 0.0).any(axis=1)
    if not hit.any():
        return None
    begin = float(time[hit].min())
    free = float(time[time < begin].max(initial=motion.start))
    while begin - free > 1e-4:
        middle = 0.5 * (free + begin)
        if compared.at(motion.at(middle)).gap.min() < 0.0:
            begin = middle
        else:
            free = middle
    pair = int(np.argmin(compared.at(motion.at(begin)).gap))
    deepest = int(np.argmin(gap[:, pair]))
    first, second = compared.pairs[pair]
    return Collision(
        first=first,
        second=second,
        depth=float(-gap[deepest, pair]),
        time=begin,
        deepest=float(time[deepest]),
    )


def check_collisions(
    arm: Arm,
    motion: JointMotion,
    surroundings: Surroundings = ALONE,
    *,
    opening: float = 0.0,
) -> None:
    """Raise an error for a motion through a collision.

    Raises:
        RobotError: The motion collides; the error names bodies, time, depth and remedy.
    """
    found = collision_along(arm, motion, surroundings, opening=opening)
    if found is not None:
        around = found.second in {"table", *(o.name for o in surroundings.obstacles)}
        raise RobotError(
            str(found),
            where=f"motion of {arm.name}",
            fix=f"keep the path away from the {found.second}, or move that"
            if around
            else "start from other joint angles (`near`), or move the path away from the base",
        )


class _Compared:
    """The pairs that might collide: their names, distances and levers."""

    def __init__(self, arm: Arm, surroundings: Surroundings, opening: float):
        self.arm, self.surroundings, self.opening = arm, surroundings, opening
        shape = arm_shape(arm, arm.home, opening)
        link = np.array([c.link for c in arm.capsules])
        link = np.append(link, np.full(len(shape.names) - len(link), arm.joints))
        first, second = np.triu_indices(len(link), 1)
        apart = np.abs(link[second] - link[first]) >= 2
        self.first, self.second = first[apart], second[apart]
        self.moving = np.flatnonzero(link > 0)
        others = [] if surroundings.table_height is None else ["table"]
        others += [obstacle.name for obstacle in surroundings.obstacles]
        names = shape.names
        self.pairs = tuple(
            (names[a], names[b]) for a, b in zip(self.first, self.second, strict=True)
        ) + tuple((names[c], other) for other in others for c in self.moving)
        self._link, self._others = link, len(others)

    def at(self, q: Array) -> Gaps:
        """At joint angles [..., J]."""
        flat = q.reshape(-1, self.arm.joints)
        parts = [self._gap(flat[k : k + _CHUNK]) for k in range(0, len(flat), _CHUNK)]
        return Gaps(self.pairs, np.concatenate(parts).reshape(*q.shape[:-1], len(self.pairs)))

    def _gap(self, q: Array) -> Array:
        shape = arm_shape(self.arm, q, self.opening)
        a, b, c = self.first, self.second, self.moving
        found = [
            segments_apart(shape.start[:, a], shape.end[:, a], shape.start[:, b], shape.end[:, b])
            - (shape.radius[a] + shape.radius[b])
        ]
        start, end, radius = shape.start[:, c], shape.end[:, c], shape.radius[c]
        if self.surroundings.table_height is not None:
            low = np.minimum(start[..., 2], end[..., 2])
            found.append(low - self.surroundings.table_height - radius)
        found += [obstacle.gap(start, end) - radius for obstacle in self.surroundings.obstacles]
        return np.concatenate(found, axis=1)

    @cached_property
    def levers(self) -> Array:
        """Largest relative movement of each pair for a rotation of each joint, [J, P] [m/rad].

        The distance of any point of a capsule from a joint's axis is at most the sum of the
        lengths of the links between them.
        """
        arm = self.arm
        shape = arm_shape(arm, arm.home, self.opening)
        own = _extents(arm, shape, self._link)
        step = np.hypot(arm.a, arm.d)  # from frame i to frame i + 1 at most, however it is turned
        lever = np.zeros((arm.joints, len(own)))
        for j in range(arm.joints):
            for c, link in enumerate(self._link):
                if link > j:
                    lever[j, c] = step[j + 1 : link].sum() + own[c]
        between = [
            np.where(np.arange(arm.joints) >= self._link[a], lever[:, b], 0.0)
            for a, b in zip(self.first, self.second, strict=True)
        ]
        return np.column_stack([*between, *([lever[:, self.moving]] * self._others)])


def _extents(arm: Arm, shape: ArmShape, link: NDArray[np.intp]) -> Array:
    """Largest distance of each capsule from its link's origin, [C] [m]."""
    origin = link_poses(arm, arm.home)[link, :3, 3]
    ends = np.maximum(
        np.linalg.norm(shape.start - origin, axis=1), np.linalg.norm(shape.end - origin, axis=1)
    )
    return ends + shape.radius


def _turned(motion: JointMotion, a: Array, b: Array) -> Array:
    """Bound on the rotation of each joint, back and forth, between times a and b [N]; [N, J] [rad].

    Between two knots a joint's speed is a parabola, which its Bezier points bound.
    """
    v0, v1, v2 = (motion.speed_at(t) for t in (a, 0.5 * (a + b), b))
    bound = np.maximum(np.maximum(np.abs(v0), np.abs(v2)), np.abs(2.0 * v1 - 0.5 * (v0 + v2)))
    return (b - a)[:, None] * bound
