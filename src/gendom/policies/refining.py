"""A policy refined through the simulator itself, once its method has trained it. Needs torch.

In rounds, the policy acts with objects and goals of its demonstrations in the simulator, which says
what is reached and, by central differences, how that changes with the action. Then the policy is
fitted to reach the goals by these linear models (Gauss-Newton steps of the whole policy; analytic
gradients of it in other words):

    min over pi of  sum_i huber(y_i + J_i d_i - g_i) + small |d_i|^2,    d_i = pi(g_i, p_i) - a_i,

where case i reached y_i by action a_i. Models of earlier rounds stay: they are of nearly the same
actions. In place of a forward model that was learnt, whose errors the policy would inherit, the
simulator's own derivatives count, where the policy acts. A policy that does not see all
parameters is fitted over all objects that look alike to it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gendom.arrays import Array
from gendom.errors import PolicyError
from gendom.policies.fitting import (  # explains a missing torch
    RISK_FLOOR,
    TrainingProblem,
    huber,
)

# isort: split
import torch
from torch import Tensor

from gendom.arguments import require
from gendom.materials import PARAMETERS, unit_of, with_dimensionless
from gendom.policies.rollouts import central_differences, stencil
from gendom.tasks import Task
from gendom.tasks.task import World, numbers_of

STEP = 0.002
"""Of central differences [units of similarity]."""

SMOOTH = 0.005
"""Larger second differences show a jump of what is reached, which has no derivative [units of
similarity]."""

HUBER_THRESHOLD = 0.03
"""Error from which on it counts linearly [standard deviations of the goal]."""

STEP_PENALTY = 0.003
"""Weight of the squared distance from the actions that models are of [standard deviations]."""

CAUTION = 0.1
"""Weight of the risk that is predicted. Far goals are reached near its limit: at 1 they are missed
by twice as much (docs/notes/policies.md)."""

LEARNING_RATE = 2e-3
"""At its peak."""

LAST_ROUND_FACTOR = 4
"""How many times as many steps of the optimiser the last round has."""


def refine(problem: TrainingProblem, task: Task, world: World) -> dict[str, float]:
    """Refine the problem's policy in as many rounds as its training says.

    Args:
        problem: Its policy is changed.
        task: What is done.
        world: Where.

    Returns:
        Root mean square errors of the goals [units of similarity] in the simulator, of the policy
        at the start of the first and of the last round.

    Raises:
        PolicyError: No outcome can be relied on.
    """
    training, G = problem.training, len(problem.goals)
    rng = np.random.default_rng([training.seed, training.refine])
    within = problem.trained[problem.within[problem.trained]]
    cases = (within if len(within) else problem.trained).cpu().numpy()
    rounds: list[dict[str, Tensor]] = []
    misses = []
    for k in range(1, training.refine + 1):
        rows = rng.permutation(cases)[: training.refine_cases]
        name = f"round {k} of {training.refine}"
        new = _models(problem, task, world, rows)
        usable = new["counts"][:, :G] > 0.0
        what = "no outcome of what the policy does in the simulator can be relied on"
        fix = "train it for more epochs, or check the task's risk"
        require(usable.any(), what, where="refine", fix=fix, error=PolicyError)
        miss = (new["reached"][:, :G] - problem.goal[new["row"]])[usable]
        misses.append(float((miss**2).mean().sqrt()))
        rounds.append(new)
        models = {key: torch.cat([one[key] for one in rounds]) for key in new}
        _fit(problem, models, name, LAST_ROUND_FACTOR if k == training.refine else 1)
    return {"goal_rms_before_refining": misses[0], "goal_rms_before_last_round": misses[-1]}


def _fit(problem: TrainingProblem, models: dict[str, Tensor], name: str, times: int) -> None:
    """Fit the policy to what models (`_models`) say that its actions reach."""
    training, G = problem.training, len(problem.goals)
    goal_scale = torch.tensor([column.scale for column in problem.goals])
    scale = problem.policy.output_scale

    def loss(at: Tensor) -> Tensor:
        row, action, beyond, reached, derivative, counts = (m[at] for m in models.values())
        moved = problem.act(row) - action
        found = reached + torch.einsum("bra,ba->br", derivative, moved)
        miss = (found[:, :G] - problem.goal[row]) / goal_scale
        away = moved / scale
        outwards = torch.relu((beyond * away).sum(dim=1))
        total = (counts[:, :G] * huber(miss, HUBER_THRESHOLD)).mean() + (outwards**2).mean()
        total = total + STEP_PENALTY * (away**2).sum(dim=1).mean()
        if found.shape[1] > G:
            known = counts[:, G] > 0.0
            total = total + CAUTION * problem.caution(found[:, G].masked_fill(~known, -torch.inf))
        return total

    rows = torch.arange(len(models["row"]))
    batch = min(training.batch_size, len(rows))
    epochs = max(1, round(times * training.refine_steps / (len(rows) // batch)))
    problem.descend(name, problem.policy, loss, rows, epochs, LEARNING_RATE)


def _models(
    problem: TrainingProblem, task: Task, world: World, rows: NDArray[np.intp]
) -> dict[str, Tensor]:
    """What the policy reaches now for goals and objects of M demonstrations, and how that changes.

    Returns:
        row [M], action [M, A], beyond [M, A] the direction in which the policy left the task's
        limits (0 where it did not), reached [M, R] goals and the risk's logarithm, derivative
        [M, R, A] and counts [M, R], 1 where a residual counts, else 0; in units of similarity.
    """
    with torch.no_grad():
        asked = problem.act(torch.as_tensor(rows)).double().cpu().numpy()
    given = torch.cat([problem.data[n][rows] for n in PARAMETERS], dim=1).tolist()
    items = [
        with_dimensionless(task.item, dict(zip(PARAMETERS, row, strict=True))) for row in given
    ]

    units = task.action_units(task.item)

    def allowed(points: Array) -> Array:
        return np.array([
            [task.nearest(item, a * units) / units for a in of_one]
            for item, of_one in zip(items, points, strict=True)
        ])  # fmt: skip

    action = allowed(asked[:, None])[:, 0]
    points = allowed(stencil(action, STEP))
    M, K, A = points.shape
    actions = (points * units).reshape(M * K, A)
    outcomes = world.carry_out(task, [item for item in items for _ in range(K)], actions)
    quantities = [*task.goals, *([task.risk] if task.risk is not None else [])]
    found = numbers_of(outcomes, quantities).reshape(M, K, -1)
    found /= np.array([unit_of(q.unit, task.item) for q in quantities])
    if task.risk is not None:
        found[..., -1] = np.log(np.maximum(found[..., -1], RISK_FLOOR))
    G = len(task.goals)
    second = found[:, 1::2] + found[:, 2::2] - 2.0 * found[:, :1]
    counts = np.isfinite(found[:, 0])
    counts[:, :G] &= np.nan_to_num(np.abs(second), nan=np.inf).max(axis=1)[:, :G] <= SMOOTH
    if found.shape[2] > G:  # what is reached at risk is noise
        counts[:, :G] &= (found[:, 0, G] <= problem.highest)[:, None]
    left = asked - action
    length = np.linalg.norm(left, axis=1, keepdims=True)
    arrays = {
        "action": action,
        "beyond": np.where(length > 1e-6, left / np.maximum(length, 1e-6), 0.0),
        "reached": np.nan_to_num(found[:, 0]),
        "derivative": central_differences(points, found),
        "counts": counts,
    }
    made = {n: torch.tensor(values, dtype=torch.float32) for n, values in arrays.items()}
    return {"row": torch.tensor(rows), **made}
