"""Ways to find an action at acting time, for ropes of the MuJoCo test scene that were lifted once:
the policy's, polished, and CMA-ES in the simulator at equal simulator time (as DLO-Lab and Wiggle
and Go! plan); and ways to learn from execution to execution: `adapt`, and iterative learning, which
moves the action by the simulator's derivatives against the miss that was seen. True parameters
serve only for the score.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from experiments.dragging import Evolution
from experiments.rope_real import ROPES
from experiments.runs import Result, Runs, Table
from gendom.arrays import Array
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.policies.adaptation import Execution, adapting
from gendom.policies.evaluation import Score, choose, judge
from gendom.policies.polishing import Polished, PolishingProblem, polishing
from gendom.policies.rollouts import Asking, side_by_side
from gendom.tasks import Task
from gendom.tasks.cases import Cases, draw_cases
from gendom.tasks.task import World
from gendom.tasks.world import Simulation

GOALS = {"small": (6, 3, 3, 1), "full": (201, 60, 30, 3)}
"""Of all ropes together: in our simulator, of these in MuJoCo, of these learnt from executions, and
how many of these there are."""

POPULATION, SIGMA = 8, 0.1
"""Actions a generation, and standard deviation of the first [of the limits' width]."""

Beliefs = Sequence[Estimate]


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


def corrected(task: Task, belief: Estimate, action: Array, miss: Array) -> Asking[Array]:
    """The action [A] after one step of iterative learning: by the most likely object's simulated
    derivatives there, against the miss [G] (reached less goal) that was seen."""
    item = belief.most_likely
    problem = PolishingProblem(task, miss, Estimate.of(item), None)
    point = yield from problem.point(problem.start(action))
    G, A = len(task.goals), len(task.actions)
    J = point.J[:G, :A]
    step = np.linalg.lstsq(J.T @ J + 1e-6 * np.eye(A), J.T @ (miss / problem.goal_units))[0]
    return task.nearest(item, action - step * problem.units)


def executions(
    cases: Cases, held: Beliefs, first: Array, there: Array, count: int, sim: World, real: World
) -> dict[str, Score]:
    """Scores in the second reality of `adapt` and of iterative learning, after 1, 2, ... of their
    own executions there, which all begin with the first actions [W, A], that reach [W, G]."""
    task, found = cases.task, dict[str, Score]()
    for way in ("adapt", "iterative learning"):
        seen: list[list[Execution]] = [[] for _ in held]
        action, reached = first, there
        for k in range(1, count + 1):
            for w, (a, y) in enumerate(zip(action, reached, strict=True)):
                seen[w] += [Execution(action=a, reached=y)] if np.isfinite(y).all() else []
            rows = list(zip(held, seen, cases.goal, action, reached, strict=True))
            if way == "adapt":
                learnt = side_by_side(task, sim, [adapting(task, b, e) for b, e, *_ in rows])
                searches: list[Any] = [
                    polishing(task, g, one.belief, task.nearest(one.belief.most_likely, a),
                              seconds=math.inf, discrepancy=one.discrepancy)
                    for one, (_, _, g, a, _) in zip(learnt, rows, strict=True)
                ]  # fmt: skip
                action = np.array([p.action for p in side_by_side(task, sim, searches)])
            else:
                searches = [corrected(task, b, a, np.nan_to_num(y - g)) for b, _, g, a, y in rows]
                action = np.array(side_by_side(task, sim, searches))
            found[f"{way}, {k}"] = judge(cases, action, world=real)
            reached = found[f"{way}, {k}"].reached
    return found


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """Misses of drawn goals, in our simulator and in MuJoCo, by way and task."""
    from gendom.reality import RealWorld, find_object

    policy = Policy.pretrained(flags.task)
    task, sim, real = policy.task(), Simulation(device=runs.device), RealWorld(jobs=runs.jobs)
    beliefs = [runs.lifted(name, task) for name in ROPES]
    many, few, fewer, repeats = GOALS[flags.scale]
    cases = draw_cases(task, many, seed=runs.seed, simulation=sim,
                       items=[find_object(name) for name in ROPES])  # fmt: skip
    some, less = (Cases(task=task, items=cases.items[:n], goal=cases.goal[:n])
                  for n in (few, fewer))  # fmt: skip
    held = [beliefs[k % len(beliefs)] for k in range(len(cases))]
    start = choose(policy, cases, known=[belief.most_likely for belief in held])
    searches = [polishing(task, g, belief, a, seconds=math.inf)
                for g, belief, a in zip(cases.goal, held, start, strict=True)]  # fmt: skip
    polished: list[Polished] = side_by_side(task, sim, searches)
    rivals = [evolved(task, g, belief, a, p.rollouts) for g, belief, a, p
              in zip(cases.goal, held, start, polished, strict=True)]  # fmt: skip
    better = np.array([p.action for p in polished])
    acted = {
        "policy": start,
        "polished": better,
        "CMA-ES": np.array(side_by_side(task, sim, rivals)),
    }
    scores = {f"{way}, ours": judge(cases, a, world=sim) for way, a in acted.items()}
    scores |= {f"{way}, MuJoCo": judge(some, a[:few], world=real) for way, a in acted.items()}
    there = scores["polished, MuJoCo"].reached[:fewer]
    learnt = executions(less, held[:fewer], better[:fewer], there, repeats, sim, real)
    scores |= {f"{way}, MuJoCo": score for way, score in learnt.items()}
    rollouts = float(np.mean([p.rollouts for p in polished]))
    about = {"task": task.name, "rollouts": rollouts}
    return missed("planning", f"{task.name}, {rollouts:.0f} rollouts each", scores, about)


def missed(name: str, title: str, scores: Mapping[str, Score], about: dict[str, Any]) -> Result:
    """The table of what goals were missed by, by row."""
    misses = {row: [e if math.isfinite(e) else None for e in score.error.tolist()]
              for row, score in scores.items()}  # fmt: skip
    rows = {}
    for row, error in misses.items():
        e = 1e3 * np.array([x for x in error if x is not None])
        figures = (e.mean(), np.median(e), np.quantile(e, 0.95), e.max())
        rows[row] = (*(f"{x:.2f}" for x in figures), f"{len(error)}, {len(error) - len(e)}")
    head = ("mean", "median", "95 %", "worst", "goals, failed")
    table = Table(title=f"{title}: missed by [mm]", head=head, rows=rows)
    figures = {**about, "misses": misses}
    return Result(name=f"{name}-{about['task']}", figures=figures, shown=[table])
