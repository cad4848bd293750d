"""What an executed action reached, from the clouds that cameras saw of it."""

import math

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import binary_closing, binary_erosion
from scipy.sparse.csgraph import shortest_path
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from gendom.arguments import require
from gendom.arrays import Array, placed
from gendom.datasets import Recording
from gendom.errors import RecordingError
from gendom.hardware.execution import PlannedAction
from gendom.materials import Item, size_of, thickness_of
from gendom.tasks import Observed, Task
from gendom.tasks.areas import FLAT_ANGLE, FLAT_HEIGHT

FEWEST = 10
"""Points of a cloud that shows where a rope ends."""

_LEAST_SEEN = 0.8  # of a rope's length between its hold and its tip: less, and the tip is hidden
_POINTS = 300  # of a cloud, for the paths in it
_CELL, _PLANE = 0.005, 0.009  # [m]; of areas, and within which a cloth's inclination is taken


def reached(
    task: Task, item: Item, action: PlannedAction, recording: Recording, start: float
) -> dict[str, float]:
    """What an action reached, as the task judges it: by a rope's tip or a cloth's areas.

    The tip is where the cloud ends, along paths of short steps from where the rope is held; a cubic
    spline leads from frame to frame. Areas are those of the last frame (`cloth_areas`).

    Args:
        task: One that watches the tip of a rope, or whose outcomes are areas of a cloth.
        item: The object.
        action: What was done.
        recording: What was seen, from the motion's start on.
        start: The recording's time at that start [s].

    Returns:
        Goals and further outcomes by name, in SI units.

    Raises:
        RecordingError: The task watches something else, or the tip is not seen for long enough.
    """
    where, T = recording.source or "recording", np.linalg.inv(action.trajectory.T_base_task)
    judged = {quantity.name for quantity in (*task.goals, *task.outcomes)}
    if item.kind == "cloth" and judged <= {"share", "unspread", "covered"}:
        return cloth_areas(placed(T, recording.frame(recording.num_frames - 1)), size_of(item))
    what = f"{task.name} watches something else"
    fix = "write down what was reached for gendom adapt"
    seen = task.watches == "tip" and item.kind == "rope"
    require(seen, what, where=where, fix=fix, error=RecordingError)
    path, motion = task.tool_path(item, np.array([*action.action.values()])), action.plan.motion
    # on the clock of the task's path, which the arm may lag behind
    opens, asked = (
        next((e.time for e in of.events if not e.closed), np.inf) for of in (motion, path)
    )
    lag = opens - asked if np.isfinite(opens) else motion.end - path.end - 0.5 * motion.blend
    time, scene = recording.time - start + motion.start - lag, task.scene(item)
    held = time[:, None] * 0.0 + np.asarray(scene.origin, dtype=float)
    held = held if scene.stand > 0.0 else path.position_at(time, motion.blend)
    least = _LEAST_SEEN * (size_of(item) - scene.stand)
    tips = [rope_tip(placed(T, recording.frame(k)), hold, thickness_of(item), least)
            for k, hold in enumerate(held)]  # fmt: skip
    shown = np.array([tip is not None for tip in tips])
    times = task.times(item)
    during = time[shown & (time >= times[0] - 0.1) & (time <= times[-1] + 0.1)]
    long = len(during) > 3 and np.diff(during).max() < 0.12
    fix = "let a camera see the whole way of the tip, at 30 pictures a second"
    what = f"the rope's tip is seen in {len(during)} pictures after the release"
    require(bool(long), what, where=where, fix=fix, error=RecordingError)
    way = CubicSpline(time[shown], np.array([tip for tip in tips if tip is not None]))
    tip = way(np.clip(times, *time[shown][[0, -1]]))
    hand = path.position_at(times, motion.blend)
    return task.outcome(
        item, Observed(times=times, points=tip[:, None], hand=hand, opens=float(opens - lag))
    )


def cloth_areas(cloud: Array, side: float) -> dict[str, float]:
    """What `gendom.tasks.ClothSpreading` measures: the ``share`` of a cloth that lies spread,
    ``unspread``, the rest of it, and ``covered``, the area of the table under it over its own.

    Args:
        cloud: [N, 3] of its surface [m]; the table is z = 0.
        side: Of the cloth [m].
    """
    if len(cloud) < FEWEST:
        return {"share": 0.0, "unspread": 1.0, "covered": 0.0}
    cells = np.floor(cloud[:, :2] / _CELL).astype(int)
    cells -= cells.min(axis=0) - 2
    filled = np.zeros(cells.max(axis=0) + 3, dtype=bool)
    filled[tuple(cells.T)] = True
    filled = np.asarray(binary_closing(filled, np.ones((3, 3))), dtype=bool)
    tree = KDTree(cloud)
    near = [cloud[k] for k in tree.query_ball_point(cloud, _PLANE)]
    normal = np.array([np.linalg.svd(x - x.mean(axis=0))[2][2] if len(x) > 3 else np.zeros(3)
                       for x in near])  # fmt: skip
    flat = np.abs(normal[:, 2]) >= math.cos(FLAT_ANGLE)
    flat &= cloud[:, 2] <= FLAT_HEIGHT * side
    x = np.stack(np.nonzero(filled), axis=1) + 0.5
    smooth = flat[np.asarray(KDTree(cells + 0.5).query(x)[1], dtype=int)]
    # half of what lies at the border is beside the cloth
    inside = np.asarray(binary_erosion(filled), dtype=bool)[filled]
    area = np.where(inside, 1.0, 0.5) * _CELL**2 / side**2
    share, covered = (min(float(area[of].sum()), 1.0) for of in (smooth, smooth | True))
    return {"share": share, "unspread": 1.0 - share, "covered": covered}


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
