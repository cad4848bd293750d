"""What an `Estimate` says of an object, as far as it counts for a task."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gendom.arguments import require
from gendom.errors import GendomError
from gendom.materials import Item, dimensionless_parameters
from gendom.materials.estimate import Estimate
from gendom.materials.unknowns import UNKNOWNS
from gendom.policies.adaptation import Execution
from gendom.policies.policy import Policy
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
    what = f"describes a {estimate.kind}, the task needs a {task.kind}"
    fix, fits = f"give the estimate of a {task.kind}", estimate.kind == task.kind
    require(fits, what, where=where, fix=fix, error=GendomError)
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


def weighed(
    items: Sequence[Item], executions: Sequence[Execution], policy: Policy, seed: int
) -> list[Item]:
    """Objects drawn from an estimate's posterior, drawn again by how well they explain which
    executions were enough, as a policy of the method ``chance`` predicts it."""
    task, alike = policy.task(), [dimensionless_parameters(item) for item in items]
    if not items or not executions or not policy.description.candidates:
        return list(items)
    given = {name: np.array([one[name] for one in alike]) for name in alike[0]}
    weight = np.ones(len(items))
    for e in executions:
        found = {task.outcomes[0].name: float(e.reached[0])}
        enough = task.error(items[0], np.empty(0), found) <= 0
        actions = np.array([e.action / task.action_units(item) for item in items])
        chance = policy.chances(actions, given)
        weight *= np.clip(chance if enough else 1.0 - chance, 1e-3, 1.0)
    rng = np.random.default_rng(seed)
    return [items[k] for k in rng.choice(len(items), len(items), p=weight / weight.sum())]
