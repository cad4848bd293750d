"""Grippers: their paths, radii, and times of closing and opening."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gendom.arguments import check_list, check_number, check_numbers, require
from gendom.arrays import Array
from gendom.errors import ParameterError
from gendom.sim.thin import rotation

NEEDED = ("time", "position", "hold_from", "hold_until", "radius")
"""Arrays that ``Grippers`` is not without."""


@dataclass(frozen=True, kw_only=True)
class Path:
    """A timed path of a rigid body.

    Between two knots it moves on a straight line at constant speed and turns at a constant rate;
    before the first and after the last knot it stands still.

    Raises:
        ParameterError: If shapes do not agree, times do not increase or a number is not finite.
    """

    time: ArrayLike = 0.0
    """[K] times of the knots [s]."""
    position: ArrayLike
    """[K, 3] centre at each knot [m]."""
    quat_xyzw: ArrayLike | None = None
    """[K, 4] orientation at each knot, or None for what never turns."""

    @property
    def kind(self) -> str:
        """What moves."""
        return type(self).__name__

    def __post_init__(self) -> None:
        what = self.kind
        t = np.atleast_1d(check_numbers(f"{what} time", self.time))
        p = np.atleast_2d(check_numbers(f"{what} position", self.position))
        if t.ndim != 1 or len(t) == 0 or p.shape != (len(t), 3):
            raise ParameterError(
                f"{what} path needs time [K > 0] and position [K, 3], got {t.shape} and {p.shape}"
            )
        if np.any(np.diff(t) <= 0.0):
            raise ParameterError(f"{what} path: times must increase from knot to knot")
        object.__setattr__(self, "time", t)
        object.__setattr__(self, "position", p)
        if self.quat_xyzw is not None:
            q = np.atleast_2d(check_numbers(f"{what} quat_xyzw", self.quat_xyzw))
            check_numbers(f"{what} quat_xyzw", q, (len(t), 4))
            if np.any(np.linalg.norm(q, axis=1) < 1e-6):
                raise ParameterError(f"{what} quat_xyzw must not be zero")
            object.__setattr__(self, "quat_xyzw", q)

    def position_at(self, time: ArrayLike) -> Array:
        """Centre at given times [s], [..., 3] [m]."""
        t, knots = check_numbers("time", time), np.asarray(self.time, dtype=float)
        p = np.asarray(self.position, dtype=float)
        return np.stack([np.interp(t, knots, p[:, a]) for a in range(3)], axis=-1)


@dataclass(frozen=True, kw_only=True)
class Gripper(Path):
    """A gripper that carries all material inside a sphere along a timed path.

    The held material is determined when the gripper closes: from then on each held particle keeps
    its position in the gripper's frame. A cross-section is held if its centre is inside the
    sphere, so the free length of a rope begins where the sphere's surface cuts its centre line.

    Raises:
        ParameterError: As of ``Path``, or if the radius is not positive, or it opens before it
            closes (times of both may be infinite).
    """

    radius: float
    """Radius of the sphere [m]."""
    hold_from: float = -math.inf
    """Time at which the gripper closes [s]."""
    hold_until: float = math.inf
    """Time at which the gripper opens [s]."""

    @property
    def kind(self) -> str:
        return "gripper"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number("gripper radius", self.radius, above=0.0)
        _check_hold(self.hold_from, self.hold_until, ())

    @classmethod
    def still(cls, position: ArrayLike, *, radius: float, **hold: Any) -> "Gripper":
        """Return a gripper that stays at ``position`` [3] [m]; errors as of ``Gripper``."""
        return cls(position=position, radius=radius, **hold)


@dataclass(frozen=True, kw_only=True)
class Targets:
    """Where the G grippers of each of W worlds are at the end of a step, see ``Simulator.step``.

    They go there on a straight line at constant speed, and turn about one axis.
    """

    position: ArrayLike
    """[G, 3] or [W, G, 3] centres [m]."""
    quat_xyzw: ArrayLike | None = None
    """[G, 4] or [W, G, 4] orientations; None: they keep theirs."""
    closed: ArrayLike | None = None
    """[G] or [W, G] whether they hold something during the step: they close or open at its start.
    None: they stay as they are."""

    def of(
        self, worlds: int, grippers: int
    ) -> tuple[Array, Array | None, NDArray[np.bool_] | None]:
        """Positions, orientations and whether they hold, each of [G] or of [W, G].

        Raises:
            ParameterError: If a shape does not fit, or a number is not finite.
        """
        shape = (worlds, grippers)
        position = check_numbers("targets.position", self.position, (grippers, 3), (*shape, 3))
        q, closed = self.quat_xyzw, self.closed
        if q is not None:
            q = check_numbers("targets.quat_xyzw", q, (grippers, 4), (*shape, 4))
            size = np.linalg.norm(q, axis=-1, keepdims=True)
            require(size.min() > 1e-6, "must not be zero", where="targets.quat_xyzw")
            q = q / size
        if closed is not None:
            closed = np.asarray(closed)
            fits = closed.dtype == bool and closed.shape in ((grippers,), shape)
            require(fits, f"must be true or false for each of {grippers} grippers, [G] or [W, G]",
                    where="targets.closed")  # fmt: skip
        return position, q, closed


def _check_hold(hold_from: Any, hold_until: Any, shape: tuple[int, ...]) -> None:
    """Check times of closing and opening, which may be infinite."""
    begin = check_numbers("hold_from", hold_from, shape, finite=False)
    end = check_numbers("hold_until", hold_until, shape, finite=False)
    if np.any(end < begin):
        raise ParameterError(
            f"hold_until must not lie before hold_from, got {end[end < begin][0]} before "
            f"{begin[end < begin][0]} s"
        )


def turns_of(q: Array) -> Array:
    """[..., K - 1, 3] rotation vectors from each orientation [..., K, 4] to the next [rad]."""
    return rotation.vector(rotation.product(q[..., 1:, :], rotation.conjugate(q[..., :-1, :])))


def of_worlds(name: str, given: Any, kind: type, worlds: int) -> list[Sequence[Any]]:
    """What each of W worlds has, given a sequence that all share, or one for each world.

    Raises:
        ParameterError: If they are not of the kind, or worlds have not the same number of them.
    """
    shared = not isinstance(given, Sequence) or any(isinstance(one, kind) for one in given)
    if shared or not given:
        check_list(name, given, kind)
        return [given] * worlds
    for w, some in enumerate(given):
        check_list(f"{name}[{w}]", some, kind)
    require(len(given) >= worlds, f"no {name} given for world {len(given)} of the batch")
    count = {len(some) for some in given[:worlds]}
    require(len(count) == 1, f"every world needs the same number of {name}, got {sorted(count)}")
    return list(given[:worlds])


class Grippers:
    """The G grippers of each of W worlds, as arrays.

    Args:
        arrays: By name: `time` [W, G, K] [s], `position` [W, G, K, 3] [m] and `orientation`
            [W, G, K, 4] (quaternions, scalar last) at K knots, where shorter paths repeat their
            last knot; [W, G] `turns` (whether orientations were given), `hold_from`, `hold_until`
            [s] and `radius` [m]. `orientation` and `turns` may be left out.

    Raises:
        ParameterError: If an array is missing or of another shape, times decrease, a number is not
            finite, a radius is not positive or a gripper opens before it closes.
    """

    def __init__(self, arrays: Mapping[str, Array]):
        if lacking := [name for name in NEEDED if name not in arrays]:
            raise ParameterError(f"arrays of grippers lack {', '.join(lacking)}")
        shape = check_numbers("gripper time", arrays["time"], ("W", "G", "K")).shape
        self.arrays: dict[str, Array] = {
            "orientation": np.tile([0.0, 0.0, 0.0, 1.0], (*shape, 1)),
            "turn": np.zeros((*shape, 3)),
            "turns": np.zeros(shape[:2]),
            **arrays,
        }
        check_numbers("gripper position", arrays["position"], (*shape, 3))
        check_numbers("gripper orientation", self.arrays["orientation"], (*shape, 4))
        if np.any(np.diff(arrays["time"]) < 0.0):
            raise ParameterError("gripper path: times must increase from knot to knot")
        check_numbers("gripper radius", arrays["radius"], shape[:2], above=0.0)
        _check_hold(arrays["hold_from"], arrays["hold_until"], shape[:2])
        turning = self.arrays["turns"] == 1.0
        if turning.any():
            self.arrays["turn"][turning, :-1] = turns_of(self.arrays["orientation"][turning])

    @classmethod
    def of(cls, every: Sequence[Sequence[Path]], *, knots: int = 2) -> "Grippers":
        """Stack W sequences of G grippers, with at least so many knots; other paths hold nothing,
        and count as of radius 1."""
        W, G = len(every), len(every[0])
        K = max([knots] + [len(np.asarray(g.time)) for grippers in every for g in grippers])
        out = {
            "time": np.zeros((W, G, K)),
            "position": np.zeros((W, G, K, 3)),
            "orientation": np.tile([0.0, 0.0, 0.0, 1.0], (W, G, K, 1)),
            **{name: np.zeros((W, G)) for name in ("turns", "hold_from", "hold_until")},
            "radius": np.ones((W, G)),
        }
        for w, g in np.ndindex(W, G):
            gripper = every[w][g]
            more = (0, K - len(np.asarray(gripper.time)))
            out["time"][w, g] = np.pad(np.asarray(gripper.time), more, "edge")
            out["position"][w, g] = np.pad(np.asarray(gripper.position), (more, (0, 0)), "edge")
            if gripper.quat_xyzw is not None:
                q = np.asarray(gripper.quat_xyzw, dtype=float)
                q = q / np.linalg.norm(q, axis=1, keepdims=True)
                out["orientation"][w, g] = np.pad(q, (more, (0, 0)), "edge")
                out["turns"][w, g] = 1
            if isinstance(gripper, Gripper):
                for name in ("hold_from", "hold_until", "radius"):
                    out[name][w, g] = getattr(gripper, name)
        return cls(out)

    def at_own_knots(self, by_knot: Array) -> Array:
        """Derivatives [W, G, K, 3], of which those by repeats of a path's last knot are added to
        those by the first of them."""
        time = self.arrays["time"]
        w, g, k = np.indices(time.shape)
        last = np.count_nonzero(np.diff(time), axis=2)[..., None]
        found = np.zeros(by_knot.shape)
        np.add.at(found, (w, g, np.minimum(k, last)), by_knot)
        return found


def hands_of_worlds(given: Any, worlds: int) -> Grippers:
    """The grippers of each world, given those of all worlds or of each, or as arrays; errors as of
    ``of_worlds``."""
    if not isinstance(given, Grippers):
        return Grippers.of(of_worlds("grippers", given, Gripper, worlds))
    many = len(given.arrays["time"])
    require(many >= worlds, f"no grippers given for world {many} of the batch")
    return Grippers({name: values[:worlds] for name, values in given.arrays.items()})
