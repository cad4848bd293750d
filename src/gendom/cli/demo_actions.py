"""What `gendom demo` does with its estimate: actions that the arm carries out in the test scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gendom.errors import GendomError
from gendom.materials import Item
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.policies.adaptation import Execution, adapt
from gendom.policies.polishing import Discrepancy, polish
from gendom.progress import each
from gendom.reality import RealRope, RealWorld, observe
from gendom.reality.trials import TrialRun
from gendom.tasks import Observed, Task
from gendom.tasks.world import Simulation
from gendom.viz import CloudSequence, PolicyRun, ReachOutcome
from gendom.viz.report.motion import WITH, WITHOUT
from gendom.viz.sources import arm_poses, goal_mark

VARIANTS = {
    "with_parameters": WITH,
    "without_parameters": WITHOUT,
    "polished": "polished in the simulator",
    "after_one_execution": "after one execution",
}
"""What is compared, by its name in actions.json."""

MOTION_RATE = 30.0
"""Frames a second of the executed motion."""

POLISH_DRAWS = 8
"""Objects drawn from the estimate to polish an action for."""

_FINER = 4
"""Reached places are looked for this much finer in time than the motion is shown."""


def carry_out(
    rope: RealRope, policies: Sequence[Policy], goals: np.ndarray, belief: Estimate, seed: int
) -> tuple[list[ReachOutcome], TrialRun, Observed]:
    """What each of `VARIANTS` reached for each goal, done by the arm; and the last motion of the
    policy with parameters.

    Besides the policies' actions one is polished through the simulator for what is believed of
    the rope, and once more for what is known after that execution.
    """
    task, outcomes = policies[0].task(), []
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
        first, trial, seen = _execute(rope, task, ours)
        runs = [first, _execute(rope, task, without)[0]]
        action = polished(ours, belief)
        runs.append(_execute(rope, task, action)[0])
        learnt = adapt(task, belief, [Execution(action=action, reached=runs[-1].reached)])
        action = polished(action, learnt.belief, learnt.discrepancy)
        runs.append(_execute(rope, task, action)[0])
        named = dict(zip(VARIANTS.values(), runs, strict=True))
        outcomes.append(ReachOutcome(goal=goal, runs=named))
    return outcomes, trial, seen


def _execute(
    rope: RealRope, task: Task, action: np.ndarray
) -> tuple[PolicyRun, TrialRun, Observed]:
    """One action, done by the arm."""
    trial = RealWorld().begin(task, rope, action)
    seen = observe(task, trial, MOTION_RATE * _FINER)
    values = task.outcome(rope, seen)
    reached = np.array([values[q.name] for q in task.goals])
    return PolicyRun(action=action, reached=reached), trial, seen


def _filled(vertices: np.ndarray, points: int = 150) -> np.ndarray:
    """[points, 3] along the line through a rope's vertices [V, 3] [m]."""
    at = np.linspace(0.0, len(vertices) - 1.0, points)
    knots = np.arange(len(vertices))
    return np.stack([np.interp(at, knots, vertices[:, axis]) for axis in range(3)], axis=1)


def predicted(
    task: Task, last: ReachOutcome, trial: TrialRun, seen: Observed, known: Item, device: str
) -> CloudSequence:
    """A motion as the arm did it, in the task's frame, and beside it what our simulator makes of
    the same action.

    Args:
        task: What was done.
        last: The goal, and the action.
        trial: The motion.
        seen: What was seen of it.
        known: The object as it is estimated.
        device: That simulates.
    """
    world = Simulation(device=device, everything=True)
    outcome = world.carry_out(task, [known], [last.runs[WITH].action], keep=True)[0]
    if outcome.seen is None:
        raise GendomError(outcome.fault or "the simulation failed", where="demo")
    late = outcome.seen.times
    frames = np.arange(0, len(seen.times), _FINER)
    frames = frames[(seen.times[frames] >= late[0]) & (seen.times[frames] <= late[-1])]
    nearest = [int(np.argmin(np.abs(late - seen.times[k]))) for k in frames]
    T = task.T_world_task(trial.trial.item)
    clock = trial.closes + frames / (MOTION_RATE * _FINER)
    arm, radius = arm_poses(trial, clock, T) or (None, None)
    return CloudSequence(
        recorded=[_filled(x) for x in seen.points[frames]],
        simulated=[_filled(outcome.seen.points[k]) for k in nearest],
        times=seen.times[frames] - seen.times[frames[0]],
        table_height=-float(T[2, 3]),
        gripper=seen.hand[frames],
        labels=("carried out", "predicted"),
        arm=arm,
        arm_radius=radius,
        goal=goal_mark(last.goal, seen),
    )
