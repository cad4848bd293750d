"""Grippers: their paths, radii, and times of closing and opening."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gendom.errors import ParameterError


@dataclass(frozen=True, kw_only=True)
class Gripper:
    """A gripper that carries all material inside a sphere along a timed path.

    The held material is determined when the gripper closes: from then on each held particle keeps
    its position in the gripper's frame. A cross-section is held if its centre is inside the
    sphere, so the free length of a rope begins where the sphere's surface cuts its centre line.
    Between two knots the gripper moves on a straight line at constant speed and turns at a
    constant rate; before the first and after the last knot it stands still.

    Raises:
        ParameterError: If shapes do not agree, times do not increase or a number is not finite.
    """

    time: ArrayLike
    """[K] times of the knots [s]."""
    position: ArrayLike
    """[K, 3] centre at each knot [m]."""
    quat_xyzw: ArrayLike | None = None
    """[K, 4] orientation at each knot, or None for a gripper that never turns."""
    radius: float
    """Radius of the sphere [m]."""
    hold_from: float = -math.inf
    """Time at which the gripper closes [s]."""
    hold_until: float = math.inf
    """Time at which the gripper opens [s]."""
    may_miss: bool = False
    """Whether the gripper may close on nothing; otherwise that raises an error."""

    def __post_init__(self) -> None:
        t = np.atleast_1d(np.asarray(self.time, dtype=float))
        p = np.atleast_2d(np.asarray(self.position, dtype=float))
        if t.ndim != 1 or p.shape != (len(t), 3):
            raise ParameterError(
                f"gripper path needs time [K] and position [K, 3], got {t.shape} and {p.shape}"
            )
        if not (np.isfinite(t).all() and np.isfinite(p).all()):
            raise ParameterError("gripper path holds a number that is not finite")
        if np.any(np.diff(t) <= 0.0):
            raise ParameterError("gripper path: times must increase from knot to knot")
        if not self.radius > 0.0:
            raise ParameterError(f"gripper radius must be positive [m], got {self.radius}")
        object.__setattr__(self, "time", t)
        object.__setattr__(self, "position", p)
        if self.quat_xyzw is not None:
            q = np.asarray(self.quat_xyzw, dtype=float)
            if q.shape != (len(t), 4) or np.any(np.linalg.norm(q, axis=1) < 1e-6):
                raise ParameterError(f"gripper quat_xyzw must be [{len(t)}, 4] and not zero")
            object.__setattr__(self, "quat_xyzw", q)

    @classmethod
    def still(cls, position: ArrayLike, *, radius: float, **hold: Any) -> "Gripper":
        """Return a gripper that stays at ``position`` [3] [m]."""
        return cls(time=[0.0], position=np.atleast_2d(position), radius=radius, **hold)

    @property
    def turn(self) -> NDArray[np.floating]:
        """[K, 3] rotation vector from each knot to the next, in world axes [rad]."""
        turns = np.zeros((len(np.asarray(self.time)), 3))
        if self.quat_xyzw is not None and len(turns) > 1:
            pose = Rotation.from_quat(self.quat_xyzw)
            turns[:-1] = (pose[1:] * pose[:-1].inv()).as_rotvec()
        return turns

    def position_at(self, time: ArrayLike) -> NDArray[np.floating]:
        """Centre at given times [s], [..., 3] [m]."""
        t, knots = np.asarray(time, dtype=float), np.asarray(self.time, dtype=float)
        p = np.asarray(self.position, dtype=float)
        return np.stack([np.interp(t, knots, p[:, a]) for a in range(3)], axis=-1)


def stack_paths(every: Sequence[Sequence[Gripper]]) -> dict[str, NDArray[np.floating]]:
    """Stack the paths of G grippers in each world into arrays [W, G, K].

    Shorter paths repeat their last knot.
    """
    W, G = len(every), len(every[0])
    K = max([2] + [len(np.asarray(g.time)) for grippers in every for g in grippers])
    out = {
        "time": np.zeros((W, G, K)),
        "position": np.zeros((W, G, K, 3)),
        "orientation": np.tile([0.0, 0.0, 0.0, 1.0], (W, G, K, 1)),
        "turn": np.zeros((W, G, K, 3)),
        "turns": np.zeros((W, G)),
        "hold_from": np.zeros((W, G)),
        "hold_until": np.zeros((W, G)),
        "radius": np.zeros((W, G)),
        "may_miss": np.zeros((W, G)),
    }
    for w, grippers in enumerate(every):
        for g, gripper in enumerate(grippers):
            t = np.asarray(gripper.time)
            out["time"][w, g] = np.concatenate([t, np.full(K - len(t), t[-1])])
            out["position"][w, g] = np.concatenate(
                [gripper.position, np.repeat(np.asarray(gripper.position)[-1:], K - len(t), 0)]
            )
            if gripper.quat_xyzw is not None:
                q = np.asarray(gripper.quat_xyzw, dtype=float)
                q = q / np.linalg.norm(q, axis=1, keepdims=True)
                out["orientation"][w, g] = np.concatenate([q, np.repeat(q[-1:], K - len(t), 0)])
                out["turn"][w, g, : len(t)] = gripper.turn
                out["turns"][w, g] = 1
            out["may_miss"][w, g] = gripper.may_miss
            out["hold_from"][w, g] = gripper.hold_from
            out["hold_until"][w, g] = gripper.hold_until
            out["radius"][w, g] = gripper.radius
    return out
