"""What `gendom demo` does with its estimate: actions that the arm carries out in the test scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gendom.errors import GendomError
from gendom.materials import Item
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.policies.adaptation import Execution, adapt
from gendom.policies.polishing import Discrepancy, polish
from gendom.progress import each
from gendom.reality import RealRope, RealWorld, observe
from gendom.tasks import Observed, Task
from gendom.tasks.world import Simulation
from gendom.viz import CloudSequence, PolicyRun, ReachOutcome
from gendom.viz.report.action import WITH, WITHOUT
from gendom.viz.sources import arm_poses, goal_mark

VARIANTS = {
    "with_parameters": WITH,
    "without_parameters": WITHOUT,
    "polished": "polished in the simulator",
    "after_one_execution": "after one execution",
}
"""What is compared, by its name in actions.json."""

STANDING_DISTANCE = 0.003
"""The hand stands where it is this near to its last place [m]."""

MOTION_RATE = 30.0
"""Frames a second of the executed motion."""

POLISH_DRAWS = 8
"""Objects drawn from the estimate to polish an action for."""

_FINER = 4
"""Reached places are looked for this much finer in time than the motion is shown."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Executed:
    """A motion as the arm did it, in the task's frame."""

    action: np.ndarray
    """[A]."""
    times: np.ndarray
    """[T] on the task's clock [s]."""
    shapes: list[np.ndarray]
    """T clouds [n, 3] of the rope [m]."""
    hand: np.ndarray
    """[T, 3] [m]."""
    arm: tuple[np.ndarray, np.ndarray] | None
    """[T, C, 2, 3] ends of the arm's capsules and [C] radii [m]; None: a free hand."""
    goal: np.ndarray
    """[K, 3] as a `CloudSequence` has it [m]."""
    table: float
    """z of the table [m]."""


def carry_out(
    rope: RealRope, policies: Sequence[Policy], goals: np.ndarray, belief: Estimate, seed: int
) -> tuple[list[ReachOutcome], Executed]:
    """What each of `VARIANTS` reached for each goal, done by the arm; and the policy's last motion.

    Besides the policies' actions one is polished through the simulator for what is believed of
    the rope, and once more for what is known after that execution.
    """
    task = policies[0].task()
    outcomes, shown = [], None
    for goal in each(goals, "the arm acts", "goal"):

        def polished(
            start: np.ndarray,
            belief: Estimate,
            discrepancy: Discrepancy | None = None,
            goal: np.ndarray = goal,
        ) -> np.ndarray:
            items = belief.draws(POLISH_DRAWS, seed)
            return polish(task, goal, items, start, discrepancy=discrepancy).action

        ours, without = (np.array(p.act(goal, belief.item).values) for p in policies)
        run, shown = _execute(rope, task, ours, goal)
        runs = [run, _execute(rope, task, without, goal)[0]]
        action = polished(ours, belief)
        runs.append(_execute(rope, task, action, goal)[0])
        learnt = adapt(task, belief, [Execution(action=action, reached=runs[-1].reached)])
        action = polished(action, learnt.belief, learnt.discrepancy)
        runs.append(_execute(rope, task, action, goal)[0])
        named = dict(zip(VARIANTS.values(), runs, strict=True))
        outcomes.append(ReachOutcome(goal=goal, runs=named))
    assert shown is not None
    return outcomes, shown


def _execute(
    rope: RealRope, task: Task, action: np.ndarray, goal: np.ndarray
) -> tuple[PolicyRun, Executed]:
    """One action, done by the arm."""
    trial_run = RealWorld().begin(task, rope, action)
    seen = observe(task, trial_run, MOTION_RATE * _FINER)
    values = task.outcome(rope, seen)
    reached = np.array([values[q.name] for q in task.goals])
    tip = seen.tip[_free(seen) :]
    run = PolicyRun(action=action, reached=reached, tip_path=tip)
    shown = np.arange(0, len(seen.times), _FINER)
    clock = trial_run.closes + shown / (MOTION_RATE * _FINER)
    return run, Executed(
        action=action,
        times=seen.times[shown],
        shapes=[_filled(x) for x in seen.points[shown]],
        hand=seen.hand[shown],
        arm=arm_poses(trial_run, clock, task.T_world_task(rope)),
        goal=goal_mark(goal, seen),
        table=-float(task.T_world_task(rope)[2, 3]),
    )


def _free(seen: Observed) -> int:
    """Frame at which the rope is let go, or at which the hand stands again."""
    if np.isfinite(seen.opens):
        return int(np.searchsorted(seen.times, seen.opens))
    stands = np.linalg.norm(seen.hand - seen.hand[-1], axis=1) < STANDING_DISTANCE
    return int(np.argmax(stands))


def _filled(vertices: np.ndarray, points: int = 150) -> np.ndarray:
    """[points, 3] along the line through a rope's vertices [V, 3] [m]."""
    at = np.linspace(0.0, len(vertices) - 1.0, points)
    knots = np.arange(len(vertices))
    return np.stack([np.interp(at, knots, vertices[:, axis]) for axis in range(3)], axis=1)


def predicted(task: Task, executed: Executed, known: Item, device: str) -> CloudSequence:
    """The executed motion, and beside it what our simulator makes of the same action."""
    world = Simulation(device=device, everything=True)
    outcome = world.carry_out(task, [known], [executed.action], keep=True)[0]
    if outcome.seen is None:
        raise GendomError(outcome.fault or "the simulation failed", where="demo")
    late = outcome.seen.times
    frames = np.flatnonzero((executed.times >= late[0]) & (executed.times <= late[-1]))
    nearest = [int(np.argmin(np.abs(late - executed.times[k]))) for k in frames]
    return CloudSequence(
        recorded=[executed.shapes[k] for k in frames],
        simulated=[_filled(outcome.seen.points[k]) for k in nearest],
        times=executed.times[frames] - executed.times[frames[0]],
        table_height=executed.table,
        gripper=executed.hand[frames],
        labels=("carried out", "predicted"),
        arm=None if executed.arm is None else executed.arm[0][frames],
        arm_radius=None if executed.arm is None else executed.arm[1],
        goal=executed.goal,
    )
