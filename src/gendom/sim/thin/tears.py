"""How far bodies may be stretched, and grippers that pull them apart: these are known from their
paths when they close."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.errors import SimulationError
from gendom.sim.thin import rotation
from gendom.sim.thin.poses import Paths

Array = NDArray[Any]

STRETCH = 0.2
"""Largest mean stretch or compression of a body, and stretch of what two grippers have between
them."""

LOCAL_STRETCH = 1.0
"""Largest momentary stretch of one edge: a soft rope that cracks like a whip stretches by 25 %."""

TOGETHER = 4096
"""Worlds whose grippers' paths are looked at together, for the memory that takes."""


@dataclass(frozen=True)
class Tear:
    """How two grippers will pull a body apart."""

    time: float
    """From when on [s]."""
    grippers: tuple[int, int]
    far: float
    """How far what they hold is apart then [m]."""


def tears(
    paths: Paths, w: Array, grippers: tuple[int, int], ends: tuple[Array, Array], now: Array,
    most: float,
) -> tuple[Array, Array]:  # fmt: skip
    """When two grippers of worlds w [k] have a point each farther apart than ``most`` [m].

    Between knots both move straight on, so that without turns their distance is largest at a knot.

    Args:
        paths: Of all grippers.
        w: The worlds.
        grippers: The two, both closed.
        ends: The points in the grippers' frames, [k, 3] each [m].
        now: When the second one closes, [k] [s].
        most: [m].

    Returns:
        The times [k] [s], infinite where they never are, and how far apart they are then [k] [m].
    """
    of = paths.stacked
    until = np.minimum(*(of["hold_until"][w, g] for g in grippers))
    times = np.concatenate([until[:, None], *(of["time"][w, g] for g in grippers)], axis=1)
    late = np.isfinite(times) & (times > now[:, None]) & (times <= until[:, None])
    times = np.sort(np.where(late, times, now[:, None]), axis=1)
    times = np.concatenate([now[:, None], times], axis=1)
    shape = times.shape
    worlds = np.repeat(w, shape[1])
    places = []
    for g, end in zip(grippers, ends, strict=True):
        pose = paths.pose(g, worlds, times.reshape(-1))
        place = pose.centre + rotation.turned(pose.q, np.repeat(end, shape[1], axis=0))
        places.append(place.reshape(*shape, 3))
    far = np.linalg.norm(places[1] - places[0], axis=2)
    beyond = far > most
    k, rows = beyond.argmax(axis=1), np.arange(len(w))
    before = np.maximum(k - 1, 0)
    step = far[rows, k] - far[rows, before]
    share = np.where(k > 0, (most - far[rows, before]) / np.where(k > 0, step, 1.0), 1.0)
    time = times[rows, before] + share * (times[rows, k] - times[rows, before])
    found = beyond.any(axis=1)
    return np.where(found, time, np.inf), np.where(k > 0, most, far[:, 0])


def find_tears(engine: Any, g: int, worlds: NDArray[np.int64], now: NDArray[np.float64]) -> None:
    """Find when gripper g, which closes, and others will have pulled worlds [k] apart."""
    paths, G = Paths(engine.stacked), engine.closed.shape[1]
    for h in range(G):
        both = (engine.closed[worlds, h] == 1) & (h != g)
        if not both.any():
            continue
        w = worlds[both]
        held = engine.holds[w][:, [h, g]] & 1
        alike, which = np.unique(held, axis=0, return_inverse=True)
        which = which.reshape(-1)  # of the few ways of holding
        for k, (theirs, mine) in enumerate(alike):
            if not (theirs.any() and mine.any()):
                continue
            i, j, rest = engine.between(np.flatnonzero(mine), np.flatnonzero(theirs))
            if np.isfinite(rest):
                of = np.flatnonzero(which == k)
                for some in np.array_split(of, -(-len(of) // TOGETHER)):
                    _keep_tears(engine, (h, g), (j, i), w[some], now[both][some], rest, paths)


def _keep_tears(
engine: Any, grippers: tuple[int, int], points: tuple[int, int], worlds: NDArray[np.int64],
    now: NDArray[np.float64], rest: float, paths: Paths,
) -> None:  # fmt: skip
    """Keep when two grippers will have pulled points apart that are ``rest`` [m] apart in the
    body at rest, where that is sooner than what is known."""
    G = engine.closed.shape[1]
    places = engine.body.place.numpy()
    ends = tuple(
        places[worlds * G + g, :3, engine.slots[p]] for g, p in zip(grippers, points, strict=True)
    )
    most = (1.0 + STRETCH) * rest
    times, far = tears(paths, worlds, grippers, (ends[0], ends[1]), now, most)
    for k in np.flatnonzero(np.isfinite(times)).tolist():
        w, found = int(worlds[k]), Tear(float(times[k]), grippers, float(far[k]))
        if w not in engine.torn or found.time < engine.torn[w].time:
            engine.torn[w] = found


def tear_error(engine: Any, w: int) -> SimulationError:
    """What to say of a world that grippers pull apart."""
    of = engine.torn[w]
    return engine.setting.error(
        w,
        of.time,
        f"grippers {of.grippers[0]} and {of.grippers[1]} pull the body apart: what they hold "
        f"is {of.far:.4g} m apart, {100 * STRETCH:.0f} % more than the body between it is long",
        where="grippers",
        fix="paths that stay closer together, or a gripper that opens before",
    )
