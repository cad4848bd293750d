"""Ways to find an action at acting time, for ropes of the MuJoCo test scene that were lifted once:
the policy's, polished, and CMA-ES in the simulator at equal simulator time (as DLO-Lab and Wiggle
and Go! plan); and ways to learn from execution to execution: `adapt`, and iterative learning, which
moves the action by the simulator's derivatives against the miss that was seen. True parameters
serve only for the score.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from experiments.dragging import Evolution
from experiments.rope_real import ROPES
from experiments.runs import Misses, Result, Runs, adapted
from gendom.arrays import Array
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.policies.adaptation import Execution
from gendom.policies.evaluation import choose
from gendom.policies.polishing import Polished, PolishingProblem, polishing
from gendom.policies.rollouts import Asking, side_by_side
from gendom.tasks import Task
from gendom.tasks.cases import Cases, draw_cases
from gendom.tasks.task import World
from gendom.tasks.world import Simulation

GOALS = {"small": (6, 3, 3, 1), "full": (201, 201, 30, 3)}
"""Of all ropes together: in our simulator, of these in MuJoCo, of these learnt from executions, and
how many of these there are."""

POPULATION, SIGMA = 4, 0.01
"""Actions a generation, and standard deviation of the first [of the limits' width]."""

Beliefs = Sequence[Estimate]


def evolved(
    task: Task, goal: ArrayLike, belief: Estimate, start: Array, rollouts: int, seed: int = 0
) -> Asking[Array]:
    """The action [A] that polishing would look for, too, of a start [A] and those that CMA-ES tries
    from there, with so many rollouts."""
    problem = PolishingProblem(task, np.atleast_1d(goal), belief, None)
    low, width, best = problem.low, problem.high - problem.low, problem.start(start)
    (first,) = yield from problem.residuals([best])
    cost = float(first @ first)
    run = Evolution((best - low) / width, SIGMA, POPULATION, seed)
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
    rows: Misses,
    cases: Cases,
    held: Beliefs,
    first: Array,
    there: Array,
    count: int,
    sim: World,
    real: World,
) -> None:
    """Rows in the second reality of `adapt` and of iterative learning, after 1, 2, ... of their own
    executions there, which all begin with the first actions [W, A], that reach [W, G]."""
    for way in ("adapt", "iterative learning"):
        seen: list[list[Execution]] = [[] for _ in held]
        action, reached = first, there
        for k in range(1, count + 1):
            for w, (a, y) in enumerate(zip(action, reached, strict=True)):
                seen[w] += [Execution(action=a, reached=y)] if np.isfinite(y).all() else []
            act = partial(adapted, cases, held, seen, action, sim)
            if way != "adapt":
                act = partial(learnt, cases, held, reached, action, sim)
            action, reached = rows.row(f"{way}, {k}, MuJoCo", cases, real, act)


def learnt(cases: Cases, held: Beliefs, reached: Array, last: Array, sim: World) -> Array:
    """[W, A] actions after a step of iterative learning each, from the last [W, A], which reached
    [W, G]."""
    found = zip(held, last, np.nan_to_num(reached - cases.goal), strict=True)
    return np.array(side_by_side(cases.task, sim, [corrected(cases.task, *one) for one in found]))


def run(runs: Runs, flags: argparse.Namespace) -> Result:
    """Misses of drawn goals, in our simulator and in MuJoCo, by way and task."""
    from gendom.reality import RealWorld, find_object

    policy = Policy.pretrained(flags.task)
    task, sim, real = policy.task(), Simulation(device=runs.device), RealWorld(jobs=runs.jobs)
    beliefs = list(runs.each(partial(runs.lifted, task=task), ROPES, "lifts"))
    many, few, fewer, repeats = GOALS[flags.scale]
    few = min(flags.acted or few, many)
    fewer = min(fewer, few)
    cases = draw_cases(task, many, seed=runs.seed, simulation=sim,
                       items=[find_object(name) for name in ROPES])  # fmt: skip
    some, less = (Cases(task=task, items=cases.items[:n], goal=cases.goal[:n])
                  for n in (few, fewer))  # fmt: skip
    held = [beliefs[k % len(beliefs)] for k in range(len(cases))]
    start = choose(policy, cases, known=[belief.most_likely for belief in held])
    searches = [polishing(task, g, belief, a, seconds=math.inf)
                for g, belief, a in zip(cases.goal, held, start, strict=True)]  # fmt: skip
    polished: list[Polished] = side_by_side(task, sim, searches)
    rivals = [evolved(task, g, belief, a, p.rollouts, runs.seed) for g, belief, a, p
              in zip(cases.goal, held, start, polished, strict=True)]  # fmt: skip
    found = {
        "polished": np.array([p.action for p in polished]),
        "policy": start,
        "CMA-ES": np.array(side_by_side(task, sim, rivals)),
    }
    rows = Misses(runs=runs, title=f"planning-{task.name}-{many}")
    arm = Misses(runs=runs, title=f"planning-{task.name}-{many}-{few}")
    # an interrupted table goes on with the actions that it began with
    acted = {way: rows.row(f"{way}, ours", cases, sim, partial(np.array, a))[0]
             for way, a in found.items()}  # fmt: skip
    reached = {
        way: arm.row(f"{way}, MuJoCo", some, real, partial(np.array, a[:few]))[1]
        for way, a in acted.items()
    }
    first, there = acted["polished"][:fewer], reached["polished"][:fewer]
    executions(arm, less, held[:fewer], first, there, repeats, sim, real)
    rollouts = float(np.mean([p.rollouts for p in polished]))
    figures = {"task": task.name, "rollouts": rollouts, "misses": {**rows.errors, **arm.errors}}
    title = f"{task.name}, {rollouts:.0f} rollouts each"
    shown = [*rows.shown(title), *arm.shown(title)]
    return Result(name=f"planning-{task.name}", figures=figures, shown=shown)
