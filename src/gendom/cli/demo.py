"""`gendom demo`: from a recorded lift to an action carried out, and a report of it all."""

from __future__ import annotations

import logging
import shlex
import time
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gendom.cli.arguments import iterations_shown
from gendom.cli.demo_report import WAYS, Run, action_summary, report_demo
from gendom.cli.estimate import NOT_USABLE, estimate_text
from gendom.cli.pictures import arm_of_lift, arm_poses, clouds_of, goal_mark
from gendom.datasets import Recording
from gendom.errors import GendomError, ParameterError
from gendom.files import check_folder, to_json, write_json
from gendom.materials import Item
from gendom.progress import each

if TYPE_CHECKING:
    from gendom.policies import Policy
    from gendom.policies.belief import Belief
    from gendom.reality import RealRope
    from gendom.tasks import Observed, Task
    from gendom.viz import CloudSequence
    from gendom.viz.report import PolicyRun

RECORDING, VIEWS = "demo-rope-lift.npz", "demo-rope-lift.jpg"
"""The demo's recording in the package's assets, and what its cameras saw halfway: made by
`gendom demo --live --reality rope-cotton --frame-rate 15 --seed 0`."""

SHIPPED = "rope-cotton"
"""The object that was recorded."""

GOALS = 3
"""Default number of goals."""

STANDS = 0.003
"""The hand stands where it is this near to its last place [m]."""

MOTION_RATE = 30.0
"""Frames a second of the executed motion."""

POLISHED_FOR = 8
"""Objects drawn from the estimate to polish an action for."""

_log = logging.getLogger(__name__)


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
    frame_rate: float = 15.0
    """With --live: frames a second."""
    task: Literal["rope-casting", "rope-reaching"] = "rope-casting"
    """What the arm does with the rope (docs/tasks.md)."""
    goal: tuple[float, ...] = ()
    """Goals of the tip in the task's frame [m], one after another: casting x and z of
    its highest point, reaching its farthest x; by default three goals that the rope can reach."""
    starts: int = 3
    """Random starts of the estimate."""
    seed: int = 0
    """Seed of the estimate and of the cameras' noise."""
    device: str = "cpu"
    """cpu, cuda or cuda:0 and so on."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        from gendom.estimation import EstimateSettings, SceneSettings, estimate
        from gendom.policies import Policy
        from gendom.policies.estimates import believed
        from gendom.policies.evaluation import draw_cases
        from gendom.reality import RealRope, find_object
        from gendom.reality.chain import record_and_perceive
        from gendom.sim import open_device
        from gendom.viz import encode_sights, write_gif

        check_folder(self.out)
        open_device(self.device)
        seconds: dict[str, float] = {}
        rope = find_object(self.reality)
        if not isinstance(rope, RealRope):
            raise ParameterError(
                f"{rope.name} is no rope", where="--reality", fix="the demo's task takes ropes"
            )
        policies = tuple(Policy.pretrained(self.task, parameters=sees) for sees in (True, False))
        task = policies[0].task()
        # drawn before anything is estimated
        goals = (
            _given_goals(self.goal, policies[0], rope)
            if self.goal
            else draw_cases(task, GOALS, seed=self.seed, items=[rope]).goal.round(3)
        )
        if self.live:
            with _timed(seconds, "record and perceive"):
                recording, sights = record_and_perceive(
                    rope, self.out / "lift", frame_rate=self.frame_rate, seed=self.seed
                )
                views = encode_sights(sights)
                (self.out / "lift" / "views.jpg").write_bytes(views)
        elif rope.name != SHIPPED:
            raise ParameterError(
                f"only a lift of {SHIPPED} comes with the package",
                where=f"--reality {rope.name}",
                fix="add --live to record it now",
            )
        else:
            assets = resources.files("gendom") / "assets"
            with resources.as_file(assets / RECORDING) as path:
                recording = Recording.read(path)
            views = (assets / VIEWS).read_bytes()
        truth = {
            "youngs_modulus": rope.material.E,
            "poissons_ratio": rope.material.nu,
            "density": rope.material.density,
            "damping": rope.material.damping,
            "friction": rope.friction,
        }
        print(f"a recorded lift: {recording.num_frames} frames of {recording.source}\n", flush=True)
        settings = EstimateSettings(
            starts=self.starts, seed=self.seed, scene=SceneSettings(device=self.device)
        )
        with _timed(seconds, "estimate"), iterations_shown() as show:
            found = estimate(recording, settings, on_progress=show)
        print(estimate_text(found))
        print(
            f"true values      E {truth['youngs_modulus']:.4g} Pa, nu "
            f"{truth['poissons_ratio']:.3f}\n",
            flush=True,
        )
        # Kept whatever becomes of the actions: a goal may turn out to be beyond this rope's reach.
        write_json(self.out / "estimate.json", found.record)
        recording.write(self.out / "recording.npz")
        assert found.scene is not None and found.positions is not None
        clouds = clouds_of(found.scene, found.positions, found.theta, found.chamfer)
        if not found.usable:
            for reason in found.verdict.reasons:
                _log.error("not usable: %s", reason)
            clouds = arm_of_lift(clouds, rope)
            report_demo(
                self, _command_line(self), recording, views, clouds, found, truth, None, seconds
            )
            print(f"report: {self.out / 'report.html'}")
            return NOT_USABLE
        with _timed(seconds, "act and carry out"):
            belief = believed(found.record, task)
            runs, shown = _carry_out(rope, policies, goals, belief, self.seed)
        with _timed(seconds, "predict the motion"):
            motion = _predicted(task, shown, belief.item, self.device)
        for run in runs:
            ours = run.ways["with_parameters"]
            named = zip(task.actions, ours.action, strict=True)
            action = ", ".join(f"{q.name} {value:.3f} {q.unit}" for q, value in named)
            print(f"goal {_place(run.goal)} m: {action}, reached {_place(ours.reached)} m")
            off = ", ".join(f"{WAYS[w]} {1e3 * run.error(w):.1f} mm" for w in run.ways)
            print(f"  off by: {off}")
        with _timed(seconds, "pictures and report"):
            write_gif(self.out / "lift.gif", clouds)
            clouds = arm_of_lift(clouds, rope)
            actions = {"format": "gendom-demo/2", "task": task.name, "outcomes": _outcomes(runs)}
            write_json(self.out / "actions.json", actions)
            action = action_summary(task, runs, motion)
            report_demo(
                self, _command_line(self), recording, views, clouds, found, truth, action, seconds
            )
        if self.json:
            print(to_json({"estimate": found.record, **actions, "seconds": seconds}))
        print(f"\nreport: {self.out / 'report.html'}")
        return 0


def _given_goals(numbers: Sequence[float], policy: Policy, rope: RealRope) -> np.ndarray:
    """[K, G] goals that were asked for; what no rope of this length reaches is refused before
    minutes go into the estimate."""
    names = policy.description.goal_names
    if len(numbers) % len(names):
        raise ParameterError(
            f"has {len(numbers)} numbers", where="--goal", fix=f"give {', '.join(names)} of each"
        )
    goals = np.reshape(numbers, (-1, len(names)))
    ends = rope.length * policy.goal_range()
    for goal in goals:
        for name, value, (low, high) in zip(names, goal, ends, strict=True):
            if not low <= value <= high:
                raise ParameterError(
                    f"{name} {value:g} m is what no rope of {rope.length:g} m reaches",
                    where="--goal",
                    fix=f"choose {low:.3f} to {high:.3f} m; softer and stiffer ropes reach part of "
                    "it",
                )
    return goals


def _carry_out(
    rope: RealRope,
    policies: Sequence[Policy],
    goals: np.ndarray,
    belief: Belief,
    seed: int,
) -> tuple[list[Run], Executed]:
    """What each of `WAYS` reached for each goal, done by the arm; and the policy's last motion.

    Besides the policies' actions one is polished through the simulator for what is believed of
    the rope, and once more for what that execution has taught.
    """
    from gendom.policies.adaptation import Execution, adapt
    from gendom.policies.polishing import Discrepancy, polish

    task = policies[0].task()
    runs: list[Run] = []
    shown = None
    for goal in each(goals, "the arm acts", "goal"):

        def polished(
            start: np.ndarray,
            belief: Belief,
            discrepancy: Discrepancy | None = None,
            goal: np.ndarray = goal,
        ) -> np.ndarray:
            items = belief.draws(POLISHED_FOR, seed)
            return polish(task, goal, items, start, discrepancy=discrepancy).action

        ours, without = (np.array(p.act(goal, belief.item).values) for p in policies)
        ways: dict[str, PolicyRun] = {}
        ways["with_parameters"], shown = _execute(rope, task, ours, goal)
        ways["without_parameters"], _ = _execute(rope, task, without, goal)
        action = polished(ours, belief)
        ways["polished"], _ = _execute(rope, task, action, goal)
        seen = Execution(action=action, reached=ways["polished"].reached)
        learnt = adapt(task, belief, [seen])
        action = polished(action, learnt.belief, learnt.discrepancy)
        ways["after_one_execution"], _ = _execute(rope, task, action, goal)
        runs.append(Run(goal=goal, ways=ways))
    assert shown is not None
    return runs, shown


def _execute(
    rope: RealRope, task: Task, action: np.ndarray, goal: np.ndarray
) -> tuple[PolicyRun, Executed]:
    """One action, done by the arm."""
    from gendom.reality import RealWorld, observe
    from gendom.viz.report import PolicyRun

    performance = RealWorld().performance(task, rope, action)
    seen = observe(task, performance, MOTION_RATE * _FINER)
    values = task.outcome(rope, seen)
    reached = np.array([values[q.name] for q in task.goals])
    free = _free(seen)
    tip = seen.tip[free:]
    away = tip[:, :1] if len(reached) == 1 else tip[:, [0, 2]] - seen.tip[0, [0, 2]]
    there = free + int(np.argmin(np.linalg.norm(away - reached, axis=1)))
    run = PolicyRun(
        action=action,
        reached=reached,
        tip_path=tip,
        shape_at_release=_filled(seen.points[free]),
        shape_at_farthest=_filled(seen.points[there]),
    )
    shown = np.arange(0, len(seen.times), _FINER)
    clock = performance.closes + shown / (MOTION_RATE * _FINER)
    return run, Executed(
        action=action,
        slowed_by=performance.slowed_by,
        times=seen.times[shown],
        shapes=[_filled(x) for x in seen.points[shown]],
        hand=seen.hand[shown],
        arm=arm_poses(performance, clock, task.T_world_task(rope)),
        goal=goal_mark(goal, seen),
        table=-float(task.T_world_task(rope)[2, 3]),
    )


def _free(seen: Observed) -> int:
    """Frame at which the rope is let go, or at which the hand stands again."""
    if np.isfinite(seen.opens):
        return int(np.searchsorted(seen.times, seen.opens))
    stands = np.linalg.norm(seen.hand - seen.hand[-1], axis=1) < STANDS
    return int(np.argmax(stands))


def _place(numbers: np.ndarray) -> str:
    text = ", ".join(f"{x:.3f}" for x in numbers)
    return text if len(numbers) == 1 else f"({text})"


_FINER = 4  # reached places are looked for this much finer in time than the motion is shown


@dataclass(frozen=True, kw_only=True, eq=False)
class Executed:
    """A motion as the arm did it, in the task's frame."""

    action: np.ndarray
    """[A]."""
    slowed_by: float
    """How much longer the arm took than the task asks for."""
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


def _filled(vertices: np.ndarray, points: int = 150) -> np.ndarray:
    """[points, 3] along the line through a rope's vertices [V, 3] [m]."""
    at = np.linspace(0.0, len(vertices) - 1.0, points)
    knots = np.arange(len(vertices))
    return np.stack([np.interp(at, knots, vertices[:, axis]) for axis in range(3)], axis=1)


def _predicted(task: Task, executed: Executed, known: Item, device: str) -> CloudSequence:
    """The executed motion, and beside it what our simulator makes of the same action."""
    from gendom.tasks.world import Simulation
    from gendom.viz import CloudSequence

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


def _outcomes(runs: Sequence[Run]) -> list[dict[str, Any]]:
    return [
        {
            "goal": run.goal.tolist(),
            **{
                name: {
                    "action": way.action.tolist(),
                    "reached": way.reached.tolist(),
                    "error": run.error(name),
                }
                for name, way in run.ways.items()
            },
        }
        for run in runs
    ]


def _command_line(command: Command) -> str:
    """The words that give the same results again."""
    words = ["gendom", "demo", "--out", str(command.out)]
    words += ["--starts", str(command.starts), "--seed", str(command.seed)]
    words += ["--device", command.device]
    if command.live:
        words += ["--live", "--reality", command.reality]
        words += ["--frame-rate", str(command.frame_rate)]
    words += ["--task", command.task]
    if command.goal:
        words += ["--goal", *map(str, command.goal)]
    return shlex.join(words)


@contextmanager
def _timed(seconds: dict[str, float], name: str):
    began = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - began
