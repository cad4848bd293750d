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
from gendom.robot import TcpPath
from gendom.tasks import Task
from gendom.tasks.task import World

LATE = 0.1
"""By which a late release is simulated [s]."""

UNSTEADY = 0.025
"""How far a late release may move what is reached [units of similarity]: of the shipped policy's it
does so by 0.005 in the median, of unstable ones by up to 0.2."""


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
    path = task.tool_path(item, action)
    if task.goals and not all(event.closed for event in path.events):
        (late,) = world.carry_out(_late(task), [item], action[None])
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


def _late(task: Task) -> Task:
    """The same, but the hand opens late, by `LATE`."""

    class Late(type(task)):
        def tool_path(self, item: Item, action: Array) -> TcpPath:
            path = super().tool_path(item, action)
            events = [e if e.closed else replace(e, time=e.time + LATE) for e in path.events]
            return replace(path, events=tuple(events))

    made: Any = Late
    return made(**{f.name: getattr(task, f.name) for f in fields(task)})


def doubts(
    task: Task, item: Item, goal: Mapping[str, float], predicted: Mapping[str, Any], *, force: bool
) -> list[str]:
    """What to say of a prediction: goals that its interval does not hold and, with ``force``, a
    release that hangs on when the hand opens.

    Raises:
        PolicyError: It does, without ``force``.
    """
    notes = []
    for quantity in task.goals:
        name, wanted = quantity.name, goal[quantity.name]
        ends = predicted.get("interval_90", {}).get(name)
        if ends and not ends[0] <= wanted <= ends[1]:
            notes.append(
                f"the goal {name} {wanted:g} {quantity.unit} lies outside of what is predicted, "
                f"90 % in {ends[0]:.4g} to {ends[1]:.4g}: the object may not reach it; choose a "
                f"goal nearer to {predicted['reached'][name]:.4g}"
            )
    if late := predicted.get("late_release", {}).get("reached"):
        on_time, names = predicted["reached"], [q.name for q in task.goals]
        moved = math.dist([on_time[n] for n in names], [late[n] for n in names])
        if moved > UNSTEADY * size_of(item):
            what = f"a release {1e3 * LATE:g} ms late moves what is reached by {1e3 * moved:.1f} mm"
            if not force:
                raise PolicyError(what, where=task.name, fix="choose another goal, or add --force")
            notes.append(what)
    return notes
