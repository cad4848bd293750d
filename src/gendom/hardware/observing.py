"""What an executed action reached, from the clouds that cameras saw of it."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.sparse.csgraph import shortest_path
from scipy.spatial.distance import cdist

from gendom.arguments import require
from gendom.arrays import Array, placed
from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.hardware.execution import PlannedAction
from gendom.materials import Item, size_of, thickness_of
from gendom.tasks import Observed, Task

FEWEST = 10
"""Points of a cloud that shows where a rope ends."""

_LEAST_SEEN = 0.8  # of a rope's length between its hold and its tip: less, and the tip is hidden
_POINTS = 300  # of a cloud, for the paths in it


def reached(
    task: Task, item: Item, action: PlannedAction, recording: Recording, start: float
) -> dict[str, float]:
    """What a rope's tip did, as the task judges it.

    The tip is where the cloud ends, along paths of short steps from where the rope is held; a cubic
    spline leads from frame to frame.

    Args:
        task: One that watches the tip of a rope.
        item: The rope.
        action: What was done.
        recording: What was seen, from the motion's start on.
        start: The recording's time at that start [s].

    Returns:
        Goals and further outcomes by name, in SI units.

    Raises:
        RecordingError: The task watches more, or the tip is not seen for long enough.
    """
    where = recording.source or "recording"

    def wanted(holds: bool, what: str, fix: str) -> None:
        require(holds, what, where=where, fix=fix, error=RecordingError)

    fix = "write down what was reached, and give it to gendom adapt"
    wanted(
        task.watches == "tip" and item.kind == "rope", f"{task.name} watches more than a tip", fix
    )
    path, motion = task.tool_path(item, np.array([*action.action.values()])), action.plan.motion
    # on the clock of the task's path, which the arm may lag behind
    lag = motion.events[-1].time - path.events[-1].time
    time = recording.time - start + motion.start - lag
    T, scene = np.linalg.inv(action.trajectory.T_base_task), task.scene(item)
    stand = np.asarray(scene.origin, dtype=float) if scene.stand > 0.0 else None
    free = size_of(item) - scene.stand
    tips, seen = [], []
    for k, t in enumerate(time):
        cloud = placed(T, recording.frame(k))
        hold = path.position_at(t, motion.blend) if stand is None else stand
        tip = rope_tip(cloud, hold, thickness_of(item), _LEAST_SEEN * free)
        if tip is not None:
            tips.append(tip)
            seen.append(t)
    times = task.times(item)
    during = np.array([t for t in seen if times[0] - 0.1 <= t <= times[-1] + 0.1])
    long = len(during) > 3 and np.diff(during).max() < 0.12
    fix = "let a camera see the whole way of the tip, at 30 pictures a second"
    wanted(bool(long), f"the rope's tip is seen in {len(during)} pictures after the release", fix)
    shown = np.clip(times, seen[0], seen[-1])
    tip = CubicSpline(seen, np.array(tips))(shown)
    opens = next((e.time for e in motion.events if not e.closed), np.inf) - lag
    hand = path.position_at(times, motion.blend)
    return task.outcome(
        item, Observed(times=times, points=tip[:, None], hand=hand, opens=float(opens))
    )


def rope_tip(cloud: Array, hold: Array, diameter: float, least: float) -> Array | None:
    """Where a rope ends, [3] [m]: the middle of the end's section.

    Args:
        cloud: [N, 3] of its surface [m].
        hold: [3] where it is held [m].
        diameter: [m].
        least: Length of the path there below which that is not the rope's end [m].

    Returns:
        None where the cloud does not show it.
    """
    if len(cloud) < FEWEST:
        return None
    some = np.concatenate([hold[None], cloud[:: -(-len(cloud) // _POINTS)]])
    steps = cdist(some, some)
    cost, before = shortest_path(steps**4, indices=0, return_predecessors=True)
    along = np.zeros(len(some))
    for k in np.argsort(cost)[1:]:
        along[k] = along[before[k]] + steps[k, before[k]]
    if along.max() < least:
        return None
    back = along.max() - along
    end = some[back <= diameter]
    inner = some[(back > diameter) & (back <= 3.0 * diameter)]
    if len(inner) == 0:
        return None
    direction = end.mean(axis=0) - inner.mean(axis=0)
    direction /= np.linalg.norm(direction)
    return end.mean(axis=0) + (((end - end.mean(axis=0)) @ direction).max()) * direction
