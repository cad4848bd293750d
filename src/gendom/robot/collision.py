"""Whether the arm touches itself, the table or what stands around it.

Shapes are the capsules of `gendom.robot.kinematics`. Capsules of one link and of neighbouring links
overlap by their making and are not compared, nor are those of links two apart that overlap at home;
what stands around is not compared with the base, which never moves. The object in the fingers is
looked at where the arm is `Arm.holding` it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import RobotError
from gendom.robot.arm import Arm
from gendom.robot.kinematics import arm_shape, link_poses

if TYPE_CHECKING:
    from gendom.robot.motion import JointMotion

RESOLUTION = 2e-4
"""Largest movement of any part between two checked configurations of a motion [m]."""

_RATE = 50.0  # [1/s]; a motion is first checked at this rate, and at its knots
_CHUNK = 1024  # configurations at a time, for memory
_NEAR = 0.1  # [m]; above its clearance a pair that may be nearer is measured, others are bounded
_PARALLEL = 1e-12  # sin^2 of the angle below which two segments count as parallel
_POINT = 1e-24  # [m^2]; squared length below which a segment is a point


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """A box-shaped obstacle: a camera's housing, a board, a shelf.

    Raises:
        RobotError: A number is missing or not finite, a size not above 0, or the quaternion zero.
    """

    name: str
    """What messages call it."""
    position: Array
    """[3] its middle in the base's frame [m]."""
    size: Array
    """[3] lengths of its edges [m]."""
    quat_xyzw: Array = field(default_factory=lambda: np.array([0.0, 0.0, 0.0, 1.0]))
    """[4] how it is turned."""

    def __post_init__(self) -> None:
        _check_arrays(self, position=3, size=3, quat_xyzw=4)
        _require(self, np.all(self.size > 0.0), f"its size is {self.size}", "give lengths above 0")
        fix = "give four numbers, not all 0"
        _require(self, self.quat_xyzw.any(), "is turned by no quaternion", fix)

    @cached_property
    def turn(self) -> Array:
        """[3, 3] rotation from its axes to the base's."""
        return Rotation.from_quat(self.quat_xyzw).as_matrix()

    def distance(self, start: Array, end: Array) -> Array:
        """[...] signed distance from segments [..., 3] [m]."""
        a, b = ((point - self.position) @ self.turn for point in (start, end))
        return segment_to_box(a, b, 0.5 * self.size)


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
        _check_arrays(self, start=3, end=3)
        thick = np.isfinite(self.radius) and self.radius > 0.0
        _require(self, thick, f"its radius is {self.radius}", "give metres above 0")

    def distance(self, start: Array, end: Array) -> Array:
        """[...] distance from segments [..., 3] [m]."""
        return segments_apart(start, end, self.start, self.end) - self.radius


@dataclass(frozen=True)
class _Table:
    """The half space below a height [m]."""

    height: float
    name: str = "table"

    def distance(self, start: Array, end: Array) -> Array:
        return np.minimum(start[..., 2], end[..., 2]) - self.height


def _require(one: Box | Post, holds: Any, what: str, fix: str) -> None:
    require(holds, what, where=one.name, fix=fix, error=RobotError)


def _check_arrays(one: Box | Post, **lengths: int) -> None:
    """Make fields arrays of so many finite numbers."""
    for name, length in lengths.items():
        value = np.asarray(getattr(one, name), dtype=float)
        good = value.shape == (length,) and np.isfinite(value).all()
        _require(one, good, f"its {name} is {value.tolist()}", f"give {length} numbers")
        object.__setattr__(one, name, value)


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """The obstacles around an arm."""

    table_height: float | None = None
    """z of a table below all of the arm but its base, and the first link if that only turns above
    it [m]; None: there is none."""
    obstacles: tuple[Box | Post, ...] = ()
    """With different names."""
    clearance: float = 0.0
    """Least distance of the arm from them [m]; the fingers may touch the table."""
    self_clearance: float = 0.0
    """Least distance of links that are not neighbours [m]; those two apart that are nearer at home
    must not touch."""


NO_OBSTACLES = Surroundings()
"""No obstacles: only self-collision of the arm is checked."""


@dataclass(frozen=True)
class Collision:
    """A collision of two bodies."""

    first: str
    """A capsule of the arm."""
    second: str
    """Another one, "table", or an obstacle's name."""
    depth: float
    """How far they overlap at worst, or come below the clearance asked of them [m]."""
    time: float | None = None
    """When they are first too near [s]; None: at a pose."""

    def __str__(self) -> str:
        when = "" if self.time is None else f"from t = {self.time:.3f} s on "
        return f"{when}{self.first} and {self.second} are {1e3 * self.depth:.1f} mm too near"


class CollisionChecker:
    """Distances and collisions of an arm and its surroundings, by the P pairs that might collide.

    Args:
        arm: The arm.
        surroundings: What stands around.
        opening: Distance of the fingers' inner faces [m].
    """

    pairs: tuple[tuple[str, str], ...]
    """[P] names: a capsule of the arm, and another one, "table", or an obstacle's name."""
    around: frozenset[str]
    """The latter two."""

    def __init__(
        self, arm: Arm, surroundings: Surroundings = NO_OBSTACLES, *, opening: float = 0.0
    ):
        self.arm, self.surroundings, self.opening = arm, surroundings, opening
        self.around = frozenset(["table", *(o.name for o in surroundings.obstacles)])
        shape = arm_shape(arm, arm.home, opening)
        link = np.array([c.link for c in arm.capsules])
        link = np.append(link, np.full(len(shape.names) - len(link), arm.joints))
        first, second = np.triu_indices(len(link), 1)
        between, a, b = link[second] - link[first], shape.start, shape.end
        home = segments_apart(a[first], b[first], a[second], b[second])
        home -= shape.radius[first] + shape.radius[second]
        apart = (np.abs(between) > 2) | ((np.abs(between) == 2) & (home >= 0.0))
        self._first, self._second = first[apart], second[apart]
        moving = np.flatnonzero(link > 0)
        asked, least = surroundings.self_clearance, surroundings.clearance
        margin = [np.where((np.abs(between) > 2) | (home >= asked), asked, 0.0)[apart]]
        self._around: list[tuple[Any, Any]] = [
            (obstacle, moving) for obstacle in surroundings.obstacles
        ]
        margin += [np.full(len(moving), least) for _ in self._around]
        if surroundings.table_height is not None:  # which the fingers and what they hold may touch
            held = [c for c, capsule in enumerate(arm.capsules) if capsule.held]
            level = abs(arm.T_links[0][2, 2]) > 1.0 - 1e-9  # what only turns comes no nearer
            above = np.setdiff1d(np.flatnonzero(link > level), held)
            self._around.insert(0, (_Table(surroundings.table_height), above))
            margin.insert(1, least * ~shape.touches_object[above])
        pairs = [(a, shape.names[b]) for a, b in zip(self._first, self._second, strict=True)]
        pairs += [(c, other.name) for other, own in self._around for c in own]
        self.pairs = tuple((shape.names[c], name) for c, name in pairs)
        self._margin, self._link = np.concatenate(margin), link

    def distance(self, q: ArrayLike) -> Array:
        """[..., P] distances [m] at joint angles [..., J] [rad]; negative: overlaps."""
        q = self.arm.check_q(q)
        return self._distance(q, np.full(len(self.pairs), np.inf))

    def at(self, q: ArrayLike) -> Collision | None:
        """The deepest collision at joint angles [J] [rad], or None."""
        gaps = self._gaps(q)
        k = int(np.argmin(gaps))
        return Collision(*self.pairs[k], depth=float(-gaps[k])) if gaps[k] < 0.0 else None

    def along(self, motion: JointMotion) -> Collision | None:
        """The first collision of a motion, or None.

        No collision between two checked times is missed: where a pair's distances at both times are
        smaller than its possible movement in between, the arm is also checked halfway, down to
        movements of `RESOLUTION`. An overlap of half of that may be missed.
        """
        time = np.union1d(motion.time, motion.sampled(_RATE))
        gap = self._gaps(motion.at(time))
        seen = [(time, gap)]
        a, b, gap_a, gap_b = time[:-1], time[1:], gap[:-1], gap[1:]
        while len(a):
            moved = _rotation_bound(motion, a, b) @ self._levers  # [intervals, P]
            unsure = (gap_a + gap_b <= moved) & (moved > RESOLUTION)
            # Known collisions need no refinement.
            some = (unsure & (gap_a > 0.0) & (gap_b > 0.0)).any(axis=1)
            a, b, gap_a, gap_b = a[some], b[some], gap_a[some], gap_b[some]
            middle = 0.5 * (a + b)
            gap = self._gaps(motion.at(middle)) if len(middle) else gap_a
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
            touches = self._gaps(motion.at(middle)).min() < 0.0
            free, begin = (free, middle) if touches else (middle, begin)
        pair = int(np.argmin(self._gaps(motion.at(begin))))
        return Collision(*self.pairs[pair], depth=float(-gap[:, pair].min()), time=begin)

    def check(self, motion: JointMotion) -> None:
        """Refuse a motion through a collision.

        Raises:
            RobotError: The motion collides; the error names bodies, time, depth and remedy.
        """
        if (found := self.along(motion)) is None:
            return
        fix = f"keep the path away from the {found.second}, or move that"
        if found.second not in self.around:
            fix = "move the path away from the base"
        raise RobotError(str(found), where=f"motion of {self.arm.name}", fix=fix)

    def _gaps(self, q: ArrayLike) -> Array:
        """[..., P] distances above the clearances [m], or lower bounds of those above `_NEAR`."""
        return self._distance(self.arm.check_q(q), self._margin + _NEAR) - self._margin

    def _distance(self, q: Array, near: Array) -> Array:
        """[..., P] distances [m], or lower bounds where those are above `near` [P]."""
        flat = q.reshape(-1, self.arm.joints)
        parts = [self._part(flat[k : k + _CHUNK], near) for k in range(0, len(flat), _CHUNK)]
        return np.concatenate(parts).reshape(*q.shape[:-1], len(self.pairs))

    def _part(self, q: Array, near: Array) -> Array:
        shape = arm_shape(self.arm, q, self.opening)
        start, end, radius = shape.start, shape.end, shape.radius
        middle, half = 0.5 * (start + end), 0.5 * np.linalg.norm(end - start, axis=-1) + radius
        first, second = self._first, self._second
        found = np.empty((len(q), len(self.pairs)))
        own = found[:, : len(first)]
        axes = np.moveaxis(middle, -1, 0).copy()  # NumPy picks numbers quicker than points
        own[:] = np.sqrt(sum((x[:, first] - x[:, second]) ** 2 for x in axes))
        own -= half[:, first] + half[:, second]
        row, pair = np.nonzero(own < near[: len(first)])
        a, b = first[pair], second[pair]
        apart = segments_apart(start[row, a], end[row, a], start[row, b], end[row, b])
        own[row, pair] = apart - (radius[a] + radius[b])
        k = len(first)
        for obstacle, some in self._around:
            here = found[:, k : k + len(some)]
            here[:] = obstacle.distance(middle[:, some], middle[:, some]) - half[:, some]
            row, pair = np.nonzero(here < near[k : k + len(some)])
            a = some[pair]
            here[row, pair] = obstacle.distance(start[row, a], end[row, a]) - radius[a]
            k += len(some)
        return found

    @cached_property
    def _levers(self) -> Array:
        """Largest relative movement of each pair for a rotation of each joint, [J, P] [m/rad].

        The distance of any point of a capsule from a joint's axis is at most the sum of the
        lengths of the links between them, and how far it reaches from its own link's origin.
        """
        arm, link = self.arm, self._link
        shape, origin = arm_shape(arm, arm.home, self.opening), link_poses(arm, arm.home)[link]
        ends = np.stack([shape.start, shape.end]) - origin[:, :3, 3]
        own = np.linalg.norm(ends, axis=2).max(axis=0) + shape.radius
        steps = np.linalg.norm(arm.T_links[:, :3, 3], axis=1).cumsum()
        joint = np.arange(arm.joints)[:, None]
        lever = np.where(link > joint, steps[link - 1] - steps[joint] + own, 0.0)
        between = np.where(joint >= link[self._first], lever[:, self._second], 0.0)
        return np.concatenate([between, *(lever[:, own] for _, own in self._around)], axis=1)


def _rotation_bound(motion: JointMotion, a: Array, b: Array) -> Array:
    """Bound on the rotation of each joint, back and forth, between times a and b [N]; [N, J] [rad].

    Between two knots a joint's speed is a parabola, which its Bezier points bound.
    """
    v0, v1, v2 = (motion.speed_at(t) for t in (a, 0.5 * (a + b), b))
    bound = np.maximum(np.maximum(np.abs(v0), np.abs(v2)), np.abs(2.0 * v1 - 0.5 * (v0 + v2)))
    return (b - a)[:, None] * bound


# ---- distances of segments, in closed form ------------------------------------------------------


def segments_apart(a0: Array, a1: Array, b0: Array, b1: Array) -> Array:
    """[...] distance of the segments a0 a1 and b0 b1 [..., 3] [m].

    The nearest points of both lines, clamped to one segment, then to the other, then again to
    the first (Ericson, "Real-Time Collision Detection", 2005, section 5.1.9). Segments may be
    points.
    """
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    uw, vw = _dot(u, w), _dot(v, w)
    skew = uu * vv - uv * uv
    askew = skew > _PARALLEL * uu * vv
    s = np.where(askew, np.clip(_over(uv * vw - vv * uw, skew, askew), 0.0, 1.0), 0.0)
    t = np.clip(_over(uv * s + vw, vv, vv > _POINT), 0.0, 1.0)
    s = np.clip(_over(uv * t - uw, uu, uu > _POINT), 0.0, 1.0)
    return np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)


def segment_to_box(a: Array, b: Array, half: Array) -> Array:
    """[...] signed distance of segments from a box around the origin, along its axes [m].

    Negative inside: the segment's deepest point lies this far below the box's nearest face. A
    box's signed distance is convex, so along a segment its slope's sign tells where the least is:
    32 halvings find it to 1e-9 of the segment's length.

    Args:
        a, b: [..., 3] the segments' ends in the box's frame [m].
        half: [3] half of the box's edges [m].
    """
    along = b - a
    low, high = np.zeros(a.shape[:-1]), np.ones(a.shape[:-1])
    for _ in range(32 if along.any() else 0):  # of points there is nothing to halve
        middle = 0.5 * (low + high)
        x = a + middle[..., None] * along
        beyond = np.abs(x) - half
        most = beyond.max(axis=-1, keepdims=True)
        # Outside away from the nearest point, inside away from the nearest face.
        out = np.where(most > 0.0, np.maximum(beyond, 0.0), beyond == most)
        rising = _dot(out * np.sign(x), along) > 0.0
        low, high = np.where(rising, low, middle), np.where(rising, middle, high)
    beyond = np.abs(a + np.stack([low, high])[..., None] * along) - half
    inside = np.minimum(beyond.max(axis=-1), 0.0)
    return (np.linalg.norm(np.maximum(beyond, 0.0), axis=-1) + inside).min(axis=0)


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...i,...i->...", a, b)


def _over(a: Array, b: Array, good: NDArray[np.bool_]) -> Array:
    """a / b where ``good`` is true, 0 elsewhere."""
    return np.where(good, a / np.where(good, b, 1.0), 0.0)
