"""`gendom demo`: from recorded lifts of three ropes to actions carried out, and a report."""

import importlib.util
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gendom.cli.arguments import Json, Seed, iterations_shown
from gendom.cli.estimate import (
    NAME,
    NOT_USABLE,
    NOT_USABLE_SUMMARY,
    estimate_text,
    fit_content,
    next_steps,
)
from gendom.cli.outputs import check_places
from gendom.datasets import Recording
from gendom.errors import GendomError, printable
from gendom.estimation import EstimateSettings, FittedEstimate, estimate
from gendom.files import to_json, write_json
from gendom.installation import how_to_install
from gendom.materials import Item, to_columns
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.policies.adaptation import Execution, adapt
from gendom.policies.belief import believed
from gendom.policies.polishing import polish
from gendom.progress import bar
from gendom.reality import RealWorld, find_object, observe
from gendom.reality.trials import TrialRun
from gendom.tasks import Observed, Task
from gendom.tasks.cases import draw_cases
from gendom.tasks.world import Simulation
from gendom.viz import ActionSummary, Animation, PolicyRun, ReachOutcome, write_film, write_report
from gendom.viz.layers import arm_layer, goal_layer, gripper_layer, observed_layer
from gendom.viz.palette import RECORDED_COLOR
from gendom.viz.report.motion import WITH, WITHOUT

LIFTS = {
    "rope-cotton": "demo-rope-lift",
    "rope-polyester": "demo-rope-polyester",
    "rope-polyethylene": "demo-rope-polyethylene",
}
"""The ropes, and their recordings in the package's assets: each of `gendom record` and `perceive`
at 15 frames a second with seed 0."""

GOALS = 40
"""Goals that are drawn for each rope, of which one is chosen."""

SUMMARY = (
    "GenDOM watched one lift of each of three ropes, alike but for their stiffness, and found the "
    "elasticity with which its simulator repeats it. One policy, trained beforehand in simulation, "
    "takes this elasticity as an input and so needs no training on these ropes. This page shows "
    "the lift and the estimate of the first rope, and what the policy's actions reached with each, "
    "beside the same network without parameters."
)

SCENE = (
    "Recorded in the MuJoCo test scene (the second reality), which has other equations than the "
    "simulator that estimates: an arm moves the ropes, and two noisy depth cameras see them. "
)

CHOSEN = (
    f"Of {GOALS} goals that a rope can reach, its goal is the one for which both networks act most "
    "differently: where the parameters decide."
)

CAMERAS_NOTE = (
    "The first rope, halfway up. Depth has noise, lost and mixed pixels at edges, and an error of "
    "calibration. The arm's points are removed by its joint angles."
)

VARIANTS = (WITH, WITHOUT, "polished in the simulator", "after one execution")
"""What is compared."""

MOTION_RATE, FINER = 30.0, 4
"""Frames a second of the executed motion, and how much finer reached places are looked for."""

_ASSETS = resources.files("gendom") / "assets"

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Command:
    """Show every step: lifts of three ropes, the estimates, the policy's actions, what they reach.

    The ropes are those of the MuJoCo test scene (the second reality, docs/reality.md): other
    equations than the estimator's, a robot arm, and two noisy depth cameras. The shipped recordings
    and policies are used.

    For example: gendom demo --task rope-reaching
    """

    out: Path = Path("demo")
    """Folder for report.html, recording.npz, estimate.json, actions.json and lift.gif; those of
    the other ropes lie in folders of their names."""
    task: Literal["rope-casting", "rope-reaching"] = "rope-casting"
    """What the arm does with the ropes (docs/tasks.md)."""
    starts: int = 3
    """Random starts of the estimates."""
    seed: Seed = 0
    json: Json = False

    def run(self) -> int:
        check_places((self.out, ""))
        if _lacking():
            what = f"MuJoCo is not installed; {how_to_install('reality')} brings it"
            how = "the second reality (docs/reality.md): actions are carried out in our own"
            _log.warning("%s, %s simulator, with the ropes' true values", what, how)
        policies = [Policy.pretrained(self.task, parameters=sees) for sees in (True, False)]
        ropes = {name: find_object(name) for name in LIFTS}
        every = {name: self._estimate(name, rope) for name, rope in ropes.items()}
        usable = {name: found for name, found in every.items() if found.usable}
        action, apart, steps = None, "", next_steps(self.out / "recording.npz")
        if usable:
            action, apart = self._act({n: ropes[n] for n in usable}, usable, policies)
            folder, goal = self._folder(next(iter(usable))), action.outcomes[0].goal.tolist()
            act = [self.task, "--goal", *goal]
            steps = next_steps(folder / "recording.npz", folder / NAME, act)
        content = fit_content(
            every["rope-cotton"],
            title="GenDOM: one lift of each of three ropes, and what the arm does with them",
            summary=SUMMARY if usable else NOT_USABLE_SUMMARY,
            recording_source=SCENE + apart,
            cameras=(_ASSETS / f"{LIFTS['rope-cotton']}.jpg").read_bytes(),
            cameras_note=CAMERAS_NOTE,
            truth=to_columns(ropes["rope-cotton"]),
            action=action,
            next_steps=steps,
        )
        assert content.lift is not None
        write_film(self.out / "lift.gif", content.lift)
        write_report(self.out / "report.html", content)
        print(f"report: {printable(self.out / 'report.html')}")
        return 0 if len(usable) == len(every) else NOT_USABLE

    def _folder(self, name: str) -> Path:
        """Of a rope's files."""
        return self.out if name == next(iter(LIFTS)) else self.out / name

    def _estimate(self, name: str, rope: Item) -> FittedEstimate:
        """A rope's estimate, which is printed and written beside its recording."""
        with resources.as_file(_ASSETS / f"{LIFTS[name]}.npz") as path:
            recording = Recording.read(path)
        print(f"{name}, a recorded lift: {recording.num_frames} frames of {recording.source}")
        settings = EstimateSettings(starts=self.starts, seed=self.seed)
        with iterations_shown() as show:
            found = estimate(recording, settings, on_progress=show)
        material, text = rope.material, estimate_text(found)
        folder = self._folder(name)
        print(f"\n{text}" if folder == self.out else "\n".join(text.splitlines()[:3]))
        print(f"true values      E {material.E:.4g} Pa, nu {material.nu:.3f}\n", flush=True)
        for reason in found.verdict.reasons:
            _log.error("%s is not usable: %s", name, reason)
        # kept whatever becomes of the actions
        write_json(folder / NAME, found.record)
        recording.write(folder / "recording.npz")
        return found

    def _act(
        self, ropes: dict[str, Any], found: dict[str, FittedEstimate], policies: Sequence[Policy]
    ) -> tuple[ActionSummary, str]:
        """Let the arm act with each rope, say what it reached, and write it; and how far that may
        be trusted."""
        task, every, outcomes, apart = policies[0].task(), {}, [], []
        with bar("the arm acts", len(ropes), "rope") as show:
            for done, name in enumerate(ropes, 1):
                belief = believed(found[name], task)
                goal = self._goal(ropes[name], belief, policies)
                every[name] = runs = carry_out(ropes[name], policies, goal, belief)
                model = task.outcome(belief.item, _simulated(task, belief.item, runs[WITH].action))
                simulated = [model[q.name] for q in task.goals]
                apart.append(np.linalg.norm(runs[WITH].reached - simulated))
                outcomes.append(ReachOutcome(item=name, goal=goal, runs=runs))
                show(done)
        for outcome in outcomes:
            named = zip(task.actions, outcome.runs[WITH].action, strict=True)
            action = ", ".join(f"{q.name} {value:.3f} {q.unit}" for q, value in named)
            place = ", ".join(f"{x:.3f}" for x in outcome.goal)
            place = place if len(outcome.goal) == 1 else f"({place})"
            print(f"{outcome.item}, goal {place} m: {action}")
            off = (f"{name} {1e3 * outcome.error(name):.1f} mm" for name in outcome.runs)
            print(f"  off by: {', '.join(off)}")
        best = max(outcomes, key=lambda of: of.error(WITHOUT) - of.error(WITH))
        summary = ActionSummary(
            outcomes=outcomes,
            motion=compared(task, ropes[best.item], every[best.item], best.goal),
            motion_note=f"{best.item}: carried out with the estimate (orange) and "
            f"without parameters (blue). {CHOSEN}",
            goal_name=", ".join(f"{q.name} {q.meaning}" for q in task.goals),
            action_names=[f"{q.name.replace('_', ' ')} [{q.unit}]" for q in task.actions],
        )
        entries = [{"rope": of.item, "goal": of.goal, "runs": of.records()} for of in outcomes]
        actions = {"format": "gendom-demo/3", "task": task.name, "outcomes": entries}
        write_json(self.out / "actions.json", actions)
        if self.json:
            print(to_json(actions))
        there = "in our own simulator, with the true values" if _lacking() else "there, too"
        said = (
            f"Actions are carried out {there}. What is reached and what the simulator says of the "
            f"same action differ by {1e3 * float(np.median(apart)):.1f} mm in the median: smaller "
            "differences say little, and polishing in the simulator cannot take them away."
        )
        print(f"  ({said})\n")
        return summary, said

    def _goal(self, rope: Any, belief: Estimate, policies: Sequence[Policy]) -> np.ndarray:
        """[G] of goals that the rope can reach the one for which the policies act most
        differently."""
        cases = draw_cases(policies[0].task(), GOALS, seed=self.seed, items=[rope])
        goals = cases.goal.round(3)
        acts = [[p.act(g, belief.item, force=True).values for g in goals] for p in policies]
        apart = np.linalg.norm(np.subtract(*map(np.array, acts)), axis=1)
        return goals[int(apart.argmax())]


@dataclass(frozen=True, kw_only=True, eq=False)
class Executed(PolicyRun):
    """One action that was carried out."""

    seen: Observed
    trial: TrialRun | None
    """The arm's in the MuJoCo scene; None: in our simulator."""


def carry_out(
    rope: Any, policies: Sequence[Policy], goal: np.ndarray, belief: Estimate
) -> dict[str, Executed]:
    """What each of `VARIANTS` reached.

    Besides the policies' actions one is polished through the simulator for what is believed of the
    rope, and once more for what is known after that execution.
    """
    task = policies[0].task()

    def polished(start: np.ndarray, belief: Estimate, **known: Any) -> Executed:
        action = polish(task, goal, belief, start, **known).action
        return execute(rope, task, action)

    ours, without = (
        execute(rope, task, np.array(p.act(goal, belief.item, force=True).values)) for p in policies
    )
    third = polished(ours.action, belief)
    learnt = adapt(task, belief, [Execution(action=third.action, reached=third.reached)])
    last = polished(third.action, learnt.belief, discrepancy=learnt.discrepancy)
    return dict(zip(VARIANTS, (ours, without, third, last), strict=True))


def _lacking() -> bool:
    """Whether there is no MuJoCo, so that actions are carried out in our simulator."""
    return importlib.util.find_spec("mujoco") is None


def execute(rope: Any, task: Task, action: np.ndarray) -> Executed:
    """One action, done by the arm in the MuJoCo scene, or without MuJoCo in our simulator with the
    rope as it truly is."""
    if _lacking():
        trial, seen = None, _simulated(task, rope, action)
    else:
        trial = RealWorld().begin(task, rope, action)
        seen = observe(task, trial, MOTION_RATE * FINER)
    values = task.outcome(rope, seen)
    reached = np.array([values[q.name] for q in task.goals])
    return Executed(action=action, reached=reached, seen=seen, trial=trial)


def _simulated(task: Task, item: Item, action: np.ndarray) -> Observed:
    outcome = Simulation(everything=True).carry_out(task, [item], [action], keep=True)[0]
    if outcome.seen is None:
        raise GendomError(outcome.fault or "the simulation failed", where="demo")
    return outcome.seen


def compared(task: Task, rope: Any, runs: dict[str, Executed], goal: np.ndarray) -> Animation:
    """The motions with the estimate and without parameters in the task's frame, one over the
    other."""
    both = [runs[name].seen for name in (WITH, WITHOUT)]
    lasts = min(float(np.ptp(seen.times)) for seen in both)
    times, shown = np.arange(0.0, lasts, 1.0 / MOTION_RATE), []
    for seen in both:
        k = np.searchsorted(seen.times - seen.times[0], times - 1e-9)
        shown.append(replace(seen, points=seen.points[k], hand=seen.hand[k]))
    trial, T = runs[WITH].trial, task.T_world_task(rope)
    layers = [
        observed_layer(WITH, rope, shown[0]),
        observed_layer(WITHOUT, rope, shown[1], RECORDED_COLOR),
        gripper_layer(shown[0].hand[:, None], rope.length),
        goal_layer(goal, shown[0], rope),
    ]
    if trial is not None:
        layers.append(arm_layer(trial, trial.closes + times, T))
    return Animation(times=times, layers=tuple(layers), table_height=-float(T[2, 3]))
