"""Grippers: their paths, radii, and times of closing and opening."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, overload

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
            turns[:-1] = _turns(np.asarray(self.quat_xyzw))
        return turns

    def position_at(self, time: ArrayLike) -> NDArray[np.floating]:
        """Centre at given times [s], [..., 3] [m]."""
        t, knots = np.asarray(time, dtype=float), np.asarray(self.time, dtype=float)
        p = np.asarray(self.position, dtype=float)
        return np.stack([np.interp(t, knots, p[:, a]) for a in range(3)], axis=-1)


def _turns(q: NDArray[np.floating]) -> NDArray[np.floating]:
    """[..., K - 1, 3] rotation vectors from each orientation [..., K, 4] to the next [rad]."""
    before, after = (Rotation.from_quat(k.reshape(-1, 4)) for k in (q[..., :-1, :], q[..., 1:, :]))
    return (after * before.inv()).as_rotvec().reshape(*q.shape[:-2], -1, 3)


class Grippers(Sequence[Sequence[Gripper]]):
    """The G grippers of each of W worlds, as arrays; an element is the sequence of one world.

    Args:
        arrays: By name: `time` [W, G, K] [s], `position` [W, G, K, 3] [m] and `orientation`
            [W, G, K, 4] (quaternions, scalar last) at K knots, where shorter paths repeat their
            last knot; [W, G] `turns` (whether orientations were given), `hold_from`, `hold_until`
            [s], `radius` [m] and `may_miss`. `orientation`, `turns` and `may_miss` may be left out.

    Raises:
        ParameterError: If times decrease, a number is not finite or a radius is not positive.
    """

    def __init__(self, arrays: Mapping[str, NDArray[np.floating]]):
        shape = arrays["time"].shape
        self.arrays: dict[str, NDArray[np.floating]] = {
            "orientation": np.tile([0.0, 0.0, 0.0, 1.0], (*shape, 1)),
            "turn": np.zeros((*shape, 3)),
            "turns": np.zeros(shape[:2]),
            "may_miss": np.zeros(shape[:2]),
            **arrays,
        }
        if not all(np.isfinite(arrays[name]).all() for name in ("time", "position")):
            raise ParameterError("gripper path holds a number that is not finite")
        if np.any(np.diff(arrays["time"]) < 0.0):
            raise ParameterError("gripper path: times must increase from knot to knot")
        if not np.all(arrays["radius"] > 0.0):
            raise ParameterError("gripper radius must be positive [m]")
        turning = self.arrays["turns"] == 1.0
        if turning.any():
            self.arrays["turn"][turning, :-1] = _turns(self.arrays["orientation"][turning])

    @classmethod
    def of(cls, every: Sequence[Sequence[Gripper]], *, knots: int = 2) -> "Grippers":
        """Stack W sequences of G grippers, with at least so many knots."""
        W, G = len(every), len(every[0])
        K = max([knots] + [len(np.asarray(g.time)) for grippers in every for g in grippers])
        out = {
            "time": np.zeros((W, G, K)),
            "position": np.zeros((W, G, K, 3)),
            "orientation": np.tile([0.0, 0.0, 0.0, 1.0], (W, G, K, 1)),
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
                    out["turns"][w, g] = 1
                out["may_miss"][w, g] = gripper.may_miss
                out["hold_from"][w, g] = gripper.hold_from
                out["hold_until"][w, g] = gripper.hold_until
                out["radius"][w, g] = gripper.radius
        return cls(out)

    def __len__(self) -> int:
        return len(self.arrays["time"])

    @overload
    def __getitem__(self, w: int) -> list[Gripper]: ...
    @overload
    def __getitem__(self, w: slice) -> "Grippers": ...
    def __getitem__(self, w: int | slice) -> "list[Gripper] | Grippers":
        part = {name: values[w] for name, values in self.arrays.items()}
        if isinstance(w, slice):
            return Grippers(part)
        made = []
        for g, t in enumerate(part["time"]):
            knots = slice(0, 1 + np.count_nonzero(np.diff(t)))
            made.append(
                Gripper(
                    time=t[knots],
                    position=part["position"][g, knots],
                    quat_xyzw=part["orientation"][g, knots] if part["turns"][g] else None,
                    radius=float(part["radius"][g]),
                    hold_from=float(part["hold_from"][g]),
                    hold_until=float(part["hold_until"][g]),
                    may_miss=bool(part["may_miss"][g]),
                )
            )
        return made
