"""`gendom demo`: from a recorded lift to an action carried out, and a report of it all."""

from __future__ import annotations

import importlib.util
import logging
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gendom.arguments import require
from gendom.cli.arguments import Device, Json, Seed, iterations_shown
from gendom.cli.estimate import (
    NAME,
    NOT_USABLE,
    NOT_USABLE_SUMMARY,
    estimate_text,
    next_steps,
    shell,
)
from gendom.cli.outputs import check_places
from gendom.cli.parsing import TYPED
from gendom.datasets import Recording
from gendom.errors import DeviceError, GendomError, ParameterError, printable
from gendom.estimation import EstimateSettings, FittedEstimate, SceneSettings, estimate
from gendom.files import to_json, write_json
from gendom.installation import how_to_install
from gendom.materials import Item
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.policies.adaptation import Execution, adapt
from gendom.policies.belief import believed
from gendom.policies.polishing import Discrepancy, polish
from gendom.progress import each
from gendom.reality import RealRope, RealWorld, find_object, observe
from gendom.reality.recording import record_and_perceive
from gendom.reality.trials import TrialRun
from gendom.tasks import Observed, Task
from gendom.tasks.cases import draw_cases
from gendom.tasks.world import Simulation
from gendom.viz import (
    ActionSummary,
    CloudSequence,
    PolicyRun,
    ReachOutcome,
    ReportContent,
    encode_camera_views,
    write_gif,
    write_report,
)
from gendom.viz.report.motion import WITH, WITHOUT
from gendom.viz.sources import arm_poses, clouds_of, goal_mark

RECORDING, VIEWS = "demo-rope-lift.npz", "demo-rope-lift.jpg"
"""The demo's recording in the package's assets, and what its cameras saw halfway: made by
`gendom demo --live --reality rope-cotton --seed 0`."""

SHIPPED = "rope-cotton"
"""The object that was recorded."""

FRAME_RATE = 15.0
"""Frames a second of a lift that is recorded now."""

GOALS = 3
"""Default number of goals."""

TASKS = ("rope-casting", "rope-reaching")

SUMMARY = (
    "GenDOM watched one lift of this object and found the elasticity with which its simulator "
    "repeats that lift. "
    "One policy, trained beforehand in simulation on many objects, takes this elasticity as an "
    "input and so needs no training on this one. "
    "This page shows how well the simulated lift matches the recorded one, how sure the estimate "
    "is, and what the policy's action reached."
)

OURS = (
    " MuJoCo is not installed here, so the actions below are carried out in our own simulator, "
    "with the rope's true values in place of the estimated ones."
)

CAMERAS_NOTE = (
    "Halfway up. Depth has the noise of a stereo camera, lost and mixed pixels at edges, and an "
    "error of calibration. The arm's points are removed by its joint angles."
)

_log = logging.getLogger(__name__)


VARIANTS = {
    "with_parameters": WITH,
    "without_parameters": WITHOUT,
    "polished": "polished in the simulator",
    "after_one_execution": "after one execution",
}
"""What is compared, by its name in actions.json."""

MOTION_RATE = 30.0
"""Frames a second of the executed motion."""

_FINER = 4
"""Reached places are looked for this much finer in time than the motion is shown."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """Show every step: a lift, the estimate, the policy's action, what it reaches.

    The object is a rope in the MuJoCo test scene (the second reality, docs/reality.md): other
    equations than the estimator's, a robot arm, and two noisy depth cameras. Without arguments the
    shipped recording and policies are used, and OpenGL is not needed.

    For example: gendom demo --task rope-reaching
    """

    out: Path = Path("demo")
    """Folder for report.html, recording.npz, estimate.json, actions.json and lift.gif."""
    live: bool = False
    """Record and perceive the lift now, in OUT/lift, instead of taking the shipped one; renders,
    so it needs OpenGL (EGL or OSMesa; a screen is not needed)."""
    reality: str = SHIPPED
    """With --live: rope-cotton, rope-polyester or rope-polyethylene."""
    task: Literal["rope-casting", "rope-reaching"] = "rope-casting"
    """What the arm does with the rope (docs/tasks.md)."""
    goal: tuple[float, ...] = ()
    """Goals of the tip in the task's frame [m], one after another: casting x and z of
    its highest point, reaching its farthest x; by default three goals that the rope can reach."""
    starts: int = 3
    """Random starts of the estimate."""
    seed: Seed = 0
    device: Device = "cpu"
    json: Json = False

    def run(self) -> int:
        from gendom.sim import open_device  # Warp, which takes long to import

        check_places((self.out, ""))
        open_device(self.device)
        seconds: dict[str, float] = {}
        if lacking := _lacking():
            what = f"MuJoCo is not installed; {how_to_install('reality')} brings it"
            require(not self.live, what, where="--live", fix="or leave it out", error=DeviceError)
            how = (
                "the second reality (docs/reality.md): actions are carried out in our own simulator"
            )
            _log.warning("%s, %s, with the rope's true values", what, how)
        rope, policies, goals = self._rope_and_goals()
        recording, views = self._recording(rope, seconds)
        print(f"a recorded lift: {recording.num_frames} frames of {recording.source}\n", flush=True)
        found = self._estimate(recording, seconds)
        material, E_over_rho = rope.material, rope.material.E / rope.material.density
        truth = {
            **{n: getattr(material, n) for n in ("E", "nu", "density", "damping")},
            "friction": rope.friction,
            "E_over_rho": E_over_rho,
        }
        print(f"true values      E {material.E:.4g} Pa, nu {material.nu:.3f}\n", flush=True)
        # Kept whatever becomes of the actions: a goal may turn out to be beyond this rope's reach.
        write_json(self.out / NAME, found.record)
        recording.write(self.out / "recording.npz")
        fit = found.fits[0]
        clouds = clouds_of(fit.scene, fit.positions, fit.theta, fit.chamfer)
        action, scene = None, "Recorded in the MuJoCo test scene (the second reality). "
        scene += (
            f"{recording.notes} This scene has other equations than the simulator that estimates. "
            "A simulated arm moves the rope, and two simulated depth cameras see it."
        )
        if found.usable:
            action, apart = self._act(rope, policies, goals, found, clouds, seconds)
            print(f"  ({apart})\n")
            scene += OURS if lacking else " The actions below are carried out in the same scene."
            scene += f" {apart}"
        for reason in found.verdict.reasons:
            _log.error("not usable: %s", reason)
        acts = ", and an action that reaches its goal" if action else ""
        content = ReportContent(
            title=f"GenDOM: one lift of an unknown rope{acts}",
            summary=SUMMARY if found.usable else NOT_USABLE_SUMMARY,
            command=shell(TYPED),
            recording_source=scene,
            cameras=views,
            cameras_note=CAMERAS_NOTE,
            lift=clouds,
            estimate=found,
            truth=truth,
            action=action,
            stage_seconds=seconds,
            next_steps=self.next_steps(action.outcomes[0].goal.tolist() if action else None),
        )
        write_report(self.out / "report.html", content)
        print(f"report: {printable(self.out / 'report.html')}")
        return 0 if found.usable else NOT_USABLE

    def next_steps(self, goal: Sequence[float] | None) -> list[tuple[str, str]]:
        """Commands that go on from the demo's files, and what each does; without a goal there is no
        usable estimate."""
        recording, estimate = self.out / "recording.npz", self.out / NAME
        if goal is None:
            return next_steps(recording)
        (other,) = set(TASKS) - {self.task}
        words = ["gendom", "demo", "--task", other, "--out", f"{self.out}-{other}"]
        again = shell(words), "Run the demo with the other task."
        return [*next_steps(recording, estimate, [self.task, "--goal", *goal]), again]

    def _rope_and_goals(self) -> tuple[RealRope, tuple[Policy, ...], np.ndarray]:
        """The rope, the policies with and without parameters, and goals [K, G], which are drawn
        before anything is estimated."""
        rope = find_object(self.reality)
        if not isinstance(rope, RealRope):
            raise ParameterError(
                f"{rope.name} is no rope", where="--reality", fix="the demo's task takes ropes"
            )
        policies = tuple(Policy.pretrained(self.task, parameters=sees) for sees in (True, False))
        if self.goal:
            return rope, policies, _given_goals(self.goal, policies[0], rope)
        cases = draw_cases(policies[0].task(), GOALS, seed=self.seed, items=[rope])
        return rope, policies, cases.goal.round(3)

    def _recording(self, rope: RealRope, seconds: dict[str, float]) -> tuple[Recording, bytes]:
        """The lift, and what its cameras saw as a JPEG."""
        if not self.live:
            require(
                rope.name == SHIPPED,
                f"only a lift of {SHIPPED} comes with the package",
                where=f"--reality {rope.name}",
                fix="add --live to record it now",
            )
            assets = resources.files("gendom") / "assets"
            with resources.as_file(assets / RECORDING) as path:
                return Recording.read(path), (assets / VIEWS).read_bytes()

        with _timed(seconds, "record and perceive"):
            recording, seen = record_and_perceive(
                rope, self.out / "lift", frame_rate=FRAME_RATE, seed=self.seed
            )
            views = encode_camera_views(seen)
            (self.out / "lift" / "views.jpg").write_bytes(views)
        return recording, views

    def _estimate(self, recording: Recording, seconds: dict[str, float]) -> FittedEstimate:
        scene = SceneSettings(device=self.device)
        settings = EstimateSettings(starts=self.starts, seed=self.seed, scene=scene)
        with _timed(seconds, "estimate"), iterations_shown() as show:
            found = estimate(recording, settings, on_progress=show)
        print(estimate_text(found))
        return found

    def _act(
        self,
        rope: RealRope,
        policies: Sequence[Policy],
        goals: np.ndarray,
        found: FittedEstimate,
        clouds: CloudSequence,
        seconds: dict[str, float],
    ) -> tuple[ActionSummary, str]:
        """Let the arm act for each goal, say what it reached, and write it; and how far that may be
        trusted."""

        task = policies[0].task()
        with _timed(seconds, "act and carry out"):
            belief = believed(found, task)
            outcomes, last = carry_out(rope, policies, goals, belief)
        with _timed(seconds, "predict the motion"):
            motion, apart = predicted(task, outcomes, last, belief.item, self.device)
        for outcome in outcomes:
            ours, *_ = outcome.runs.values()
            named = zip(task.actions, ours.action, strict=True)
            action = ", ".join(f"{q.name} {value:.3f} {q.unit}" for q, value in named)
            print(f"goal {_place(outcome.goal)} m: {action}, reached {_place(ours.reached)} m")
            off = (f"{name} {1e3 * outcome.error(name):.1f} mm" for name in outcome.runs)
            print(f"  off by: {', '.join(off)}")
        entries = [_entry(outcome) for outcome in outcomes]
        actions = {"format": "gendom-demo/2", "task": task.name, "outcomes": entries}
        with _timed(seconds, "film"):
            write_gif(self.out / "lift.gif", clouds)
            write_json(self.out / "actions.json", actions)
        if self.json:
            print(to_json({"estimate": found.record, **actions, "seconds": seconds}))
        said = "What is reached and what the simulator says of the same action differ by "
        said += f"{1e3 * apart:.1f} mm in the median: smaller differences say little."
        summary = ActionSummary(
            outcomes=outcomes,
            motion=motion,
            goal_name=", ".join(f"{q.name} {q.meaning}" for q in task.goals),
            action_names=[f"{q.name.replace('_', ' ')} [{q.unit}]" for q in task.actions],
        )
        return summary, said


def carry_out(
    rope: RealRope, policies: Sequence[Policy], goals: np.ndarray, belief: Estimate
) -> tuple[list[ReachOutcome], Executed]:
    """What each of `VARIANTS` reached for each goal, and the last motion of the policy with
    parameters.

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
            return polish(task, goal, [belief.most_likely], start, discrepancy=discrepancy).action

        ours, without = (np.array(p.act(goal, belief.item).values) for p in policies)
        first = execute(rope, task, ours)
        runs = [first.run, execute(rope, task, without).run]
        action = polished(ours, belief)
        runs.append(execute(rope, task, action).run)
        learnt = adapt(task, belief, [Execution(action=action, reached=runs[-1].reached)])
        action = polished(action, learnt.belief, learnt.discrepancy)
        runs.append(execute(rope, task, action).run)
        named = dict(zip(VARIANTS.values(), runs, strict=True))
        outcomes.append(ReachOutcome(goal=goal, runs=named))
    return outcomes, first


@dataclass(frozen=True, kw_only=True, eq=False)
class Executed:
    """One action that was carried out."""

    run: PolicyRun
    seen: Observed
    trial: TrialRun | None
    """The arm's in the MuJoCo scene; None: in our simulator."""


def _lacking() -> bool:
    """Whether there is no MuJoCo, so that actions are carried out in our simulator."""
    return importlib.util.find_spec("mujoco") is None


def execute(rope: RealRope, task: Task, action: np.ndarray) -> Executed:
    """One action, done by the arm in the MuJoCo scene, or without MuJoCo in our simulator with the
    rope as it truly is."""
    if _lacking():
        trial, seen = None, _simulated(task, rope, action)
    else:
        trial = RealWorld().begin(task, rope, action)
        seen = observe(task, trial, MOTION_RATE * _FINER)
    values = task.outcome(rope, seen)
    reached = np.array([values[q.name] for q in task.goals])
    return Executed(run=PolicyRun(action=action, reached=reached), seen=seen, trial=trial)


def _simulated(task: Task, item: Item, action: np.ndarray, device: str = "cpu") -> Observed:
    world = Simulation(device=device, everything=True)
    outcome = world.carry_out(task, [item], [action], keep=True)[0]
    if outcome.seen is None:
        raise GendomError(outcome.fault or "the simulation failed", where="demo")
    return outcome.seen


def _filled(vertices: np.ndarray, points: int = 150) -> np.ndarray:
    """[points, 3] along the line through a rope's vertices [V, 3] [m]."""
    at = np.linspace(0.0, len(vertices) - 1.0, points)
    knots = np.arange(len(vertices))
    return np.stack([np.interp(at, knots, vertices[:, axis]) for axis in range(3)], axis=1)


def predicted(
    task: Task, outcomes: Sequence[ReachOutcome], last: Executed, known: Item, device: str
) -> tuple[CloudSequence, float]:
    """The last motion as it was carried out, in the task's frame, and beside it what our simulator
    makes of the same action; and how far apart both place what is reached, in the median [m].

    Args:
        task: What was done.
        outcomes: Goals and actions.
        last: The motion of the last one's policy with parameters.
        known: The object as it is estimated.
        device: That simulates.
    """
    runs = [outcome.runs[WITH] for outcome in outcomes]
    models = [_simulated(task, known, run.action, device) for run in runs]
    apart = []
    for run, model in zip(runs, models, strict=True):
        values = task.outcome(known, model)
        apart.append(np.linalg.norm(run.reached - [values[q.name] for q in task.goals]))
    model, seen = models[-1], last.seen
    shown = np.arange(seen.times[0], seen.times[-1], 1.0 / MOTION_RATE)
    frames = np.unique(np.searchsorted(seen.times, shown - 1e-9))
    late = (seen.times[frames] >= model.times[0]) & (seen.times[frames] <= model.times[-1])
    frames = frames[late]
    nearest = [int(np.argmin(np.abs(model.times - seen.times[k]))) for k in frames]
    T = task.T_world_task(known if last.trial is None else last.trial.trial.item)
    arm = radius = None
    if last.trial is not None:
        clock = last.trial.closes + seen.times[frames] - seen.times[0]
        arm, radius = arm_poses(last.trial, clock, T) or (None, None)
    clouds = CloudSequence(
        recorded=[_filled(x) for x in seen.points[frames]],
        simulated=[_filled(model.points[k]) for k in nearest],
        times=seen.times[frames] - seen.times[frames[0]],
        table_height=-float(T[2, 3]),
        gripper=seen.hand[frames],
        labels=("carried out", "predicted"),
        arm=arm,
        arm_radius=radius,
        goal=goal_mark(outcomes[-1].goal, seen),
    )
    return clouds, float(np.median(apart))


def _given_goals(numbers: Sequence[float], policy: Policy, rope: RealRope) -> np.ndarray:
    """[K, G] goals that were asked for; what no rope of this length reaches is refused before
    minutes go into the estimate."""
    names = policy.description.goal_names
    what, fix = f"has {len(numbers)} numbers", f"give {', '.join(names)} of each"
    require(len(numbers) % len(names) == 0, what, where="--goal", fix=fix)
    goals = np.reshape(numbers, (-1, len(names)))
    ends = rope.length * policy.goal_range()
    for goal in goals:
        for name, value, (low, high) in zip(names, goal, ends, strict=True):
            what = f"{name} {value:g} m is what no rope of {rope.length:g} m reaches"
            fix = f"choose {low:.3f} to {high:.3f} m; softer and stiffer ropes reach part of it"
            require(low <= value <= high, what, where="--goal", fix=fix)
    return goals


def _place(numbers: np.ndarray) -> str:
    text = ", ".join(f"{x:.3f}" for x in numbers)
    return text if len(numbers) == 1 else f"({text})"


def _entry(outcome: ReachOutcome) -> dict[str, Any]:
    """One goal in actions.json."""
    runs = {key: (name, outcome.runs[name]) for key, name in VARIANTS.items()}
    return {"goal": outcome.goal.tolist()} | {
        key: {
            "action": run.action.tolist(),
            "reached": run.reached.tolist(),
            "error": outcome.error(name),
        }
        for key, (name, run) in runs.items()
    }


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    began = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - began
