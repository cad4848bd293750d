"""Ways to find an action at acting time: the policy's, polished, and CMA-ES in the simulator at
equal simulator time (as DLO-Lab and Wiggle and Go! plan), for ropes of the MuJoCo test scene that
were lifted once. True parameters serve only for the score.
"""

from __future__ import annotations

import argparse
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from experiments.dragging import Evolution
from experiments.rope_real import ROPES
from experiments.runs import Result, Runs, Table
from gendom.arrays import Array
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.policies.evaluation import choose, judge
from gendom.policies.polishing import Polished, PolishingProblem, polishing
from gendom.policies.rollouts import Asking, side_by_side
from gendom.tasks import Task
from gendom.tasks.cases import draw_cases
from gendom.tasks.world import Simulation

GOALS = {"small": 6, "full": 201}
"""Of all ropes together."""

POPULATION, SIGMA = 8, 0.1
"""Actions a generation, and standard deviation of the first [of the limits' width]."""


def evolved(
    task: Task, goal: ArrayLike, belief: Estimate, start: Array, rollouts: int
) -> Asking[Array]:
    """The action [A] that polishing would look for, too, of those that CMA-ES tries with so many
    rollouts, from a start [A]."""
    problem = PolishingProblem(task, np.atleast_1d(goal), belief, None)
    low, width, best, cost = problem.low, problem.high - problem.low, problem.start(start), math.inf
    run = Evolution((best - low) / width, SIGMA, POPULATION, 0)
    while problem.rollouts + POPULATION <= rollouts:
        points = run.ask()
        tried = [problem.nearest(low + width * p) for p in points]
        found = yield from problem.residuals(tried)
        costs = np.array([float(r @ r) for r in found])
        run.tell(points, -costs)
        if costs.min() < cost:
            best, cost = tried[int(costs.argmin())], float(costs.min())
    return problem.action(best)


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """Misses of drawn goals, in our simulator and in MuJoCo, by way and task."""
    from gendom.reality import RealWorld, find_object

    policy = Policy.pretrained(flags.task)
    task, sim = policy.task(), Simulation(device=runs.device)
    beliefs = [runs.lifted(name, task) for name in ROPES]
    cases = draw_cases(task, GOALS[flags.scale], seed=runs.seed, simulation=sim,
                       items=[find_object(name) for name in ROPES])  # fmt: skip
    held = [beliefs[k % len(beliefs)] for k in range(len(cases))]
    start = choose(policy, cases, known=[belief.most_likely for belief in held])
    searches = [polishing(task, g, belief, a, seconds=math.inf)
                for g, belief, a in zip(cases.goal, held, start, strict=True)]  # fmt: skip
    polished: list[Polished] = side_by_side(task, sim, searches)
    rivals = [evolved(task, g, belief, a, p.rollouts) for g, belief, a, p
              in zip(cases.goal, held, start, polished, strict=True)]  # fmt: skip
    acted = {
        "policy": start,
        "polished": np.array([p.action for p in polished]),
        "CMA-ES": np.array(side_by_side(task, sim, rivals)),
    }
    worlds = {"ours": sim, "MuJoCo": RealWorld(jobs=runs.jobs)}
    misses: dict[str, Any] = {}
    for way, action in acted.items():
        for place, world in worlds.items():
            error = judge(cases, action, world=world).error.tolist()
            misses[f"{way}, {place}"] = [e if math.isfinite(e) else None for e in error]
    rows = {}
    for row, error in misses.items():
        e = 1e3 * np.array(error, dtype=float)
        e = e[np.isfinite(e)]
        figures = (e.mean(), np.median(e), np.quantile(e, 0.95), e.max())
        rows[row] = (*(f"{x:.2f}" for x in figures), str(len(error) - len(e)))
    rollouts = float(np.mean([p.rollouts for p in polished]))
    head = ("mean", "median", "95 %", "worst", "failed")
    title = f"{task.name}, {len(cases)} goals, {rollouts:.0f} rollouts each: missed by [mm]"
    figures = {"task": task.name, "rollouts": rollouts, "misses": misses}
    return Result(
        name=f"planning-{task.name}",
        figures=figures,
        shown=[Table(title=title, head=head, rows=rows)],
    )
