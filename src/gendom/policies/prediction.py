"""What an action will reach, simulated, and whether that hangs on when the hand opens."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from gendom.arrays import Array
from gendom.errors import PolicyError
from gendom.materials import Item, size_of
from gendom.policies.adaptation import DISCREPANCY
from gendom.policies.polishing import Discrepancy
from gendom.robot import TcpPath
from gendom.tasks import Task
from gendom.tasks.task import Outcome, World

LATE = 0.1
"""By which a late release is simulated [s]."""

UNSTEADY = 0.025
"""How far a late release may move what is reached [units of similarity]: of the shipped policy's it
does so by 0.005 in the median, of unstable ones by up to 0.2."""

REPLACEMENTS, NEARBY = 200, 0.03
"""Actions that are drawn where the wanted one is unsteady, first from all, then around the best
with a standard deviation [units of similarity]."""


def predict(
    task: Task, item: Item, action: Array, others: Sequence[Item], seed: int, world: World
) -> dict[str, Any]:
    """What an action [A] will reach, simulated: with the object as it is, and the 90 % interval
    over others that are plausible (none: the object is taken as known) and over the simulator's
    error, as `gendom.policies.adaptation` expects it. Ready for JSON."""
    items = [item, *others]
    outcomes = world.carry_out(task, items, np.tile(action, (len(items), 1)))
    if outcomes[0].fault is not None:
        return {"fault": outcomes[0].fault}
    found: dict[str, Any] = {"reached": outcomes[0].values}
    if _releases(task, item, action):
        (late,) = reached_late(task, item, action[None], world)
        found["late_release"] = {"seconds": LATE, "reached": late.values}
    values = [o.values for o in outcomes[1:] if o.fault is None]
    if values:
        names = [q.name for q in task.goals] or list(values[0])
        some = np.array([[v[name] for name in names] for v in values])
        if task.goals:
            error = np.random.default_rng(seed).normal(size=some.shape)
            some += DISCREPANCY * task.goal_units(item) * error
        ends = np.quantile(some, [0.05, 0.95], axis=0).T
        found["interval_90"] = dict(zip(names, ends.tolist(), strict=True))
    return found


def _releases(task: Task, item: Item, action: Array) -> bool:
    """Whether a task reaches its goal by opening the hand."""
    return bool(task.goals) and not all(e.closed for e in task.tool_path(item, action).events)


def reached_late(task: Task, item: Item, actions: Array, world: World) -> list[Outcome]:
    """What actions [N, A] reach whose release comes late, by `LATE`."""

    class Late(type(task)):
        def tool_path(self, item: Item, action: Array) -> TcpPath:
            path = super().tool_path(item, action)
            events = [e if e.closed else replace(e, time=e.time + LATE) for e in path.events]
            return replace(path, events=tuple(events))

    made: Any = Late
    late = made(**{f.name: getattr(task, f.name) for f in fields(task)})
    return world.carry_out(late, [item] * len(actions), actions)


def steady(
    task: Task,
    item: Item,
    goal: Mapping[str, float],
    action: Array,
    wrong: Discrepancy | None,
    world: World,
    seed: int,
) -> tuple[Array, list[str]]:
    """An action whose release may come late: the wanted one [A], or the best of drawn ones; and
    what was changed, in words. ``wrong`` is added to what the simulator says is reached.

    Raises:
        PolicyError: No drawn one that reaches the goal is steady either.
    """
    if not _releases(task, item, action):
        return action, []
    wanted, limit = np.array(list(goal.values())), UNSTEADY * size_of(item)
    units, rng = task.action_units(item), np.random.default_rng(seed)

    def goal_of(outcome: Outcome) -> Array:  # NaN where it failed
        return np.array([outcome.values.get(q.name, math.nan) for q in task.goals])

    def judged(tried: Array, most: int) -> list[tuple[float, float, Array]]:
        """Misses, movements by a late release and actions, of those that miss least."""
        on_time = world.carry_out(task, [item] * len(tried), tried)
        shift = [0.0 if wrong is None else wrong(a)[0] for a in tried]
        miss = [float(np.linalg.norm(goal_of(o) + s - wanted))
                for o, s in zip(on_time, shift, strict=True)]  # fmt: skip
        safe = [n for n, o in enumerate(on_time) if o.values and task.within_risk(item, o.values)]
        best = sorted(safe if most > 1 else range(1), key=lambda n: miss[n])[:most]
        late = reached_late(task, item, tried[best], world) if best else []
        moves = [float(np.linalg.norm(goal_of(o) - goal_of(on_time[n])))
                 for n, o in zip(best, late, strict=True)]  # fmt: skip
        return [(miss[n], move, tried[n]) for n, move in zip(best, moves, strict=True)]

    ((_, moved, _),) = judged(action[None], 1)
    if moved <= limit:
        return action, []
    what = f"a release {1e3 * LATE:g} ms late moves what is reached by {1e3 * moved:.1f} mm"
    tried, best = task.sample_actions(item, rng, REPLACEMENTS), (math.inf, math.inf, action)
    for _ in range(2):
        found = [j for j in judged(tried, REPLACEMENTS // 8) if j[1] <= limit]
        best = min([best, *found], key=lambda j: j[0])
        around = best[2] + NEARBY * units * rng.normal(size=(REPLACEMENTS // 2, len(units)))
        tried = np.array([task.nearest(item, a) for a in around])
    if best[0] > moved:
        fix = "choose another goal, or add --force"
        raise PolicyError(f"{what}, and no steady one was found", where=task.name, fix=fix)
    return best[2], [f"{what}: replaced by an action that should miss by {1e3 * best[0]:.1f} mm"]
