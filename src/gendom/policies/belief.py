"""What an `Estimate` says of an object, as far as it counts for a task."""

from __future__ import annotations

from dataclasses import replace

from gendom.arguments import require
from gendom.errors import GendomError
from gendom.materials import Item
from gendom.materials.estimate import Estimate
from gendom.materials.unknowns import UNKNOWNS
from gendom.tasks import Task


def uncertain(task: Task, item: Item) -> tuple[str, ...]:
    """Unknowns that the outcome of a task depends on for such an object."""
    scene = task.scene(item)
    without = {"nu"} if item.kind == "rope" else set()
    if scene.table is None and not scene.self_contact:
        without.add("friction")
    return tuple(n for n, u in UNKNOWNS.items() if u.on_object is not None and n not in without)


def for_task(estimate: Estimate, task: Task, where: str = "estimate") -> Estimate:
    """An estimate whose E over density is the task's own where it does not know any.

    Raises:
        GendomError: It is of another kind of object.
    """
    require(
        estimate.kind == task.kind,
        f"describes a {estimate.kind}, the task needs a {task.kind}",
        where=where,
        fix=f"give the estimate of a {task.kind}",
        error=GendomError,
    )
    if estimate.value("E_over_rho") is not None:
        return estimate
    known = {**estimate.known, "E_over_rho": task.item.material.E_over_rho}
    return replace(estimate, known=known)


def believed(estimate: Estimate, task: Task, where: str = "estimate") -> Estimate:
    """The same with only those unknowns uncertain that the task's outcome depends on.

    Raises:
        GendomError: It is of another kind of object.
    """
    estimate = for_task(estimate, task, where)
    return estimate.of_object(uncertain(task, estimate.item))
