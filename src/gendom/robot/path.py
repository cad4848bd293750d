"""Timed paths of the tool: straight lines between knots, their corners rounded off in time.

A path along a polygon at constant speeds requires infinite accelerations at its knots. `TcpPath`
stores the ideal path, and its methods round it by a given `blend`: the path is convolved in time
with a kernel of that width. With the velocity's jumps dv_k at the times t_k of the knots, the ideal
path is p_0 + sum_k dv_k max(t - t_k, 0), so the rounded one is

    p(t) = p_0 + sum_k dv_k R(t - t_k),

where R is max(t, 0) convolved with the kernel. The kernel is a parabola that vanishes at both
ends, so with u = t / blend + 1/2 in [0, 1]

    R = blend (u^3 - u^4 / 2),   R' = 3 u^2 - 2 u^3,   R'' = 6 u (1 - u) / blend:

the acceleration is continuous and at most 1.5 |dv| / blend, and a corner is missed by
(3 / 32) |dv| blend. Straight parts, pauses and uniform accelerations stay as they are, and the
path begins and ends half a blend earlier and later.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Self

import numpy as np
import scipy  # its parts are imported where they are used: all takes long
from numpy.typing import ArrayLike, NDArray

from gendom.arguments import require
from gendom.arrays import Array, placed, quaternion
from gendom.errors import RobotError

DOWN = (1.0, 0.0, 0.0, 0.0)
"""quat_xyzw of a gripper that points down, its fingers opening along the world's y."""


def pointing(approach: ArrayLike, fingers: ArrayLike) -> Array:
    """quat_xyzw [4] of a gripper by its axes.

    Args:
        approach: [3] pointing direction, out of the fingers; any length.
        fingers: [3] direction in which the fingers open; its component along `approach` is ignored.

    Raises:
        RobotError: The two are parallel, or one is zero.
    """
    z, y = np.asarray(approach, dtype=float), np.asarray(fingers, dtype=float)
    apart = np.linalg.norm(np.cross(y, z)) > 1e-6 * np.linalg.norm(z) * np.linalg.norm(y)
    what = f"approach {z.tolist()} and fingers {y.tolist()} are parallel or zero"
    where, fix = "gripper's orientation", "give two directions, about at right angles"
    require(apart, what, where=where, fix=fix, error=RobotError)
    x = np.cross(y, z) / np.linalg.norm(np.cross(y, z))
    z = z / np.linalg.norm(z)
    return quaternion(np.stack([x, np.cross(z, x), z], axis=1))


@dataclass(frozen=True, kw_only=True)
class GripperEvent:
    """The closing or opening of the gripper."""

    time: float
    """[s]."""
    closed: bool
    """True: it closes; False: it opens."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Timed:
    """What has knots in time, before and after which it rests, and what the gripper does."""

    time: Array
    """[K] increasing times of the knots [s]."""
    events: tuple[GripperEvent, ...] = ()
    """When the gripper closes and opens, in order of time."""

    @property
    def start(self) -> float:
        """[s]."""
        return float(self.time[0])

    @property
    def end(self) -> float:
        """[s]."""
        return float(self.time[-1])

    def shifted(self, seconds: float) -> Self:
        """The same, later by some seconds."""
        return self.retimed(lambda time: time + seconds)

    def retimed(self, to: Callable[[Any], Any]) -> Self:
        """The same with its times, those of its events too, changed by a function."""
        events = tuple(replace(e, time=to(e.time)) for e in self.events)
        return replace(self, time=to(self.time), events=events)


@dataclass(frozen=True, kw_only=True, eq=False)
class TcpPath(Timed):
    """A timed path of the tool point; before its start and after its end the tool stands still.

    Raises:
        RobotError: Shapes do not agree, times do not increase or a number is not finite.
    """

    position: Array
    """[K, 3] [m]; straight and at constant speed from knot to knot."""
    quat_xyzw: Array
    """[4] of the tool, which never turns."""
    max_blend: float = math.inf
    """Longest blend that preserves the path's purpose [s], e.g. that the tool rests on release."""
    blend: float | None = None
    """Blend that is part of the path [s], for every arm and simulator; None: the shortest blend
    that an arm allows."""

    def __post_init__(self) -> None:
        time = np.atleast_1d(np.asarray(self.time, dtype=float))
        position = np.atleast_2d(np.asarray(self.position, dtype=float))
        quat = np.asarray(self.quat_xyzw, dtype=float)
        fits = time.ndim == 1 and len(time) >= 2 and position.shape == (len(time), 3)
        shapes = f"{time.shape}, {position.shape}"
        _require(fits, f"needs time [K >= 2] and position [K, 3], got {shapes}")
        _require(quat.shape == (4,), f"needs quat_xyzw [4], got {quat.shape}")
        finite = np.isfinite(time).all() and np.isfinite(position).all()
        _require(finite, "holds a number that is not finite")
        size = np.linalg.norm(quat)
        _require(1e-6 <= size < math.inf, "has a quaternion that is zero or not finite")
        _require((time[1:] > time[:-1]).all(), "has times that do not increase from knot to knot")
        ordered = all(a.time <= b.time for a, b in pairwise(self.events))
        _require(ordered, "has gripper events that are not in order of time")
        _require(self.max_blend > 0.0, f"has max_blend {self.max_blend}")
        within = self.blend is None or 0.0 <= self.blend <= self.max_blend
        _require(within, f"has blend {self.blend}, beyond its max_blend {self.max_blend}")
        quat = quat / size
        for name, value in (("time", time), ("position", position), ("quat_xyzw", quat)):
            object.__setattr__(self, name, value)

    @property
    def moves(self) -> float:
        """Time at which the tool first moves [s]; infinite: never."""
        return float(TcpPaths([self]).moves[0])

    def sampled(self, per_blend: int = 16) -> tuple[Array, Array]:
        """Times [K] [s] and positions [K, 3] [m] of a path without blend that runs like this one:
        its own knots, and where it has a blend, so many in each."""
        time, position, _ = TcpPaths([self]).sampled(per_blend)
        return time[0], position[0]

    def to_dict(self) -> dict[str, Any]:
        """For JSON and robots that play it: its own blend sampled; the frame is the base's.

        Returns:
            time [K] [s]; position [K][3] [m] and quat_xyzw [4] of the tool; events, when the hand
            closes and opens.
        """
        times, position = self.sampled()
        return {
            "frame": "robot base, z up",
            "time": times.tolist(),
            "position": position.tolist(),
            "quat_xyzw": self.quat_xyzw.tolist(),
            "events": [{"time": e.time, "closed": e.closed} for e in self.events],
        }

    def position_at(self, time: ArrayLike, blend: float = 0.0) -> Array:
        """[..., 3] the tool point [m] at times [...] [s], rounded off by `blend` [s]."""
        time = np.asarray(time, dtype=float)
        alone = self.time[None], self.position[None], np.array([blend])
        return _rounded(time.reshape(1, -1), *alone).reshape(*time.shape, 3)

    def pose_at(self, time: ArrayLike, blend: float = 0.0) -> Array:
        """T_base_tcp [..., 4, 4] at times [...] [s], rounded off by `blend` [s]."""
        time = np.asarray(time, dtype=float)
        T = np.zeros((*time.shape, 4, 4))
        T[..., :3, 3] = self.position_at(time, blend)
        T[..., 3, 3] = 1.0
        T[..., :3, :3] = scipy.spatial.transform.Rotation.from_quat(self.quat_xyzw).as_matrix()
        return T

    @property
    def corners(self) -> Array:
        """[J] times [s] at which the ideal path's velocity jumps."""
        return self.time[_velocity_jumps(self.time, self.position).any(axis=-1)]

    def deviation(self, blend: float) -> float:
        """Largest distance of the path rounded off by `blend` [s] from the ideal one (with its own
        blend, if it has one) at the same time [m]."""
        time = np.add.outer(self.corners, np.linspace(-0.5 * blend, 0.5 * blend, 41))
        late = self.position_at(time, blend) - self.position_at(time, self.blend or 0.0)
        return float(np.linalg.norm(late, axis=-1).max(initial=0.0))

    def moved(self, T: ArrayLike) -> TcpPath:
        """Return the path transformed by `T` [4, 4] [m] from its frame to another one."""
        T = np.asarray(T, dtype=float)
        by = scipy.spatial.transform.Rotation
        turned = by.from_matrix(T[:3, :3]) * by.from_quat(self.quat_xyzw)
        return replace(self, position=placed(T, self.position), quat_xyzw=turned.as_quat())


class TcpPaths:
    """W paths of the tool, evaluated side by side: all numbers are those of the paths alone, each
    rounded off by its own blend."""

    def __init__(self, paths: Sequence[TcpPath]):
        # Shorter paths rest at their last place for a second a missing knot.
        last = np.array([len(path.time) - 1 for path in paths])[:, None]
        k = np.arange(last.max() + 1)
        every = np.cumsum(last + 1, axis=0) - last - 1 + np.minimum(k, last)
        self._own = k <= last
        self._time = np.concatenate([p.time for p in paths])[every] + np.maximum(k - last, 0)
        self._position = np.concatenate([p.position for p in paths])[every]
        self._blend = np.array([path.blend or 0.0 for path in paths])
        self._corner = _velocity_jumps(self._time, self._position).any(axis=2)
        self.events = [path.events for path in paths]
        """[W] when the grippers close and open."""

    @classmethod
    def alike(cls, path: TcpPath, time: Array, position: Array) -> TcpPaths:
        """W paths that differ from one by their knots alone, which lie at times [W, K] or [K] [s]
        and positions [W, K, 3] [m], as `TcpPath` would have them."""
        made, W = cls([path]), len(position)
        made._time, made._position = np.broadcast_to(time, position.shape[:2]), position
        made._own = np.ones(made._time.shape, dtype=bool)
        made._corner = _velocity_jumps(made._time, position).any(axis=2)
        made._blend, made.events = np.broadcast_to(made._blend, W), made.events * W
        return made

    @cached_property
    def moves(self) -> Array:
        """[W] times at which the tools first move [s]; infinite: never."""
        return np.where(self._corner, self._time, np.inf).min(axis=1) - 0.5 * self._blend

    def position_at(self, time: ArrayLike) -> Array:
        """[W, T, 3] the tool points [m] at times [T] or [W, T] [s]."""
        time = np.asarray(time, dtype=float)
        return _rounded(time, self._time, self._position, self._blend)

    def sampled(self, per_blend: int = 16) -> tuple[Array, Array, NDArray[np.intp]]:
        """Times [W, K] [s] and positions [W, K, 3] [m] as `TcpPath.sampled`, and how many of them
        each path has [W]; shorter ones repeat their last."""
        half, W = 0.5 * self._blend, len(self._time)
        near = np.linspace(-half, half, per_blend + 1, axis=1)
        blended = self._corner & (half > 0.0)[:, None]
        around = np.where(blended[..., None], self._time[..., None] + near[:, None], np.inf)
        every = [np.where(self._own, self._time, np.inf), around.reshape(W, -1)]
        every = np.sort(np.concatenate([*every, np.full((W, 1), np.inf)], axis=1), axis=1)
        # two that differ by rounding would be a jump
        kept = np.isfinite(every[:, :-1])
        kept[kept] = every[:, 1:][kept] - every[:, :-1][kept] > 1e-9
        count = np.count_nonzero(kept, axis=1)
        first = np.argsort(~kept, axis=1, kind="stable")[:, : count.max()]
        first = np.take_along_axis(first, np.minimum(np.arange(count.max()), count[:, None] - 1), 1)
        time = np.take_along_axis(every, first, axis=1)
        return time, self.position_at(time), count


def _velocity_jumps(time: Array, position: Array) -> Array:
    """Jumps of the velocity [..., K, 3] [m/s] at knots [..., K] [s] with positions [..., K, 3]."""
    padded = np.zeros((*time.shape[:-1], time.shape[-1] + 1, 3))
    padded[..., 1:-1, :] = np.diff(position, axis=-2) / np.diff(time)[..., None]
    return padded[..., 1:, :] - padded[..., :-1, :]


def _rounded(time: Array, knots: Array, position: Array, blend: Array) -> Array:
    """[W, T, 3] W paths with knots [W, K] [s], [W, K, 3] [m] at times [T] or [W, T], each rounded
    off by its blend [W] [s]."""
    jumps, total = _velocity_jumps(knots, position), np.zeros((3, len(knots), time.shape[-1]))
    if knots.strides[0] == blend.strides[0] == 0:  # the same in all
        knots, blend = knots[:1], blend[:1]
    # one after the other: a matrix product may round differently from call to call
    for k in np.flatnonzero(jumps.any(axis=(0, 2))):
        ramp = _ramp(time - knots[:, k, None], blend[:, None])
        for axis in np.flatnonzero(jumps[:, k].any(axis=0)):
            total[axis] += ramp * jumps[:, k, axis, None]
    total += position[:, 0].T[..., None]
    return np.moveaxis(total, 0, 2)


def _ramp(t: Array, blend: Array) -> Array:
    """R(t) above [s]."""
    if not np.any(blend):
        return np.maximum(t, 0.0)
    u = np.clip(t / np.maximum(blend, 1e-12) + 0.5, 0.0, 1.0)
    # u^3 - u^4 / 2: NumPy's powers take ten times as long
    return blend * (u * u * u * (1.0 - 0.5 * u)) + np.maximum(t - 0.5 * blend, 0.0)


def _require(holds: Any, what: str) -> None:
    require(holds, what, where="path of the tool", error=RobotError)
