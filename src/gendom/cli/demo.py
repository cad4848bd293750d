"""`gendom demo`: from a recorded lift to an action carried out, and a report of it all."""

from __future__ import annotations

import shlex
import time
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from gendom import __version__
from gendom.cli.estimate import estimate_text
from gendom.datasets import Recording
from gendom.errors import GendomError, ParameterError
from gendom.files import to_json, write_json
from gendom.materials import ASSUMED, Material, Rope

if TYPE_CHECKING:
    from gendom.estimation import Estimate
    from gendom.policies import Policy
    from gendom.reality import RealRope
    from gendom.tasks import Task
    from gendom.viz import CloudSequence
    from gendom.viz.report import PolicyRun

RECORDING, VIEWS = "demo-rope-lift.npz", "demo-rope-lift.jpg"
"""The demo's recording in the package's assets, and what its cameras saw halfway: made by
`gendom demo --live --reality rope-cotton --frame-rate 15 --seed 0`."""

SHIPPED = "rope-cotton"
"""The object that was recorded."""

GOAL_SHARES = (0.4, 0.6, 0.8)
"""Default goals, as places in the policy's range for this rope."""

MOTION_RATE = 30.0
"""Frames a second of the executed motion."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """Show the whole story: a lift, the estimate, the policy's action, what comes of it.

    The object, a rope, lives in a second reality (docs/reality.md): other equations than the
    estimator's, a robot arm, and two noisy depth cameras. Without arguments the recorded lift and
    the policies that come with the package are used, and nothing needs OpenGL.
    """

    out: Path = Path("demo")
    """Folder for report.html, estimate.json, actions.json and lift.gif."""
    live: bool = False
    """Record and perceive the lift now, in OUT/lift, instead of taking the shipped one; renders,
    so it needs OpenGL (EGL or OSMesa; a screen is not needed)."""
    reality: str = SHIPPED
    """With --live: rope-cotton, rope-polyester or rope-polyethylene."""
    frame_rate: float = 15.0
    """With --live: frames a second."""
    goal: tuple[float, ...] = ()
    """How far the tip shall reach in the task's frame [m]; by default three goals."""
    starts: int = 3
    """Random starts of the estimate."""
    seed: int = 0
    """Seed of the estimate and of the cameras' noise."""
    device: str = "cpu"
    """cpu, cuda or cuda:0 and so on."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        from gendom.estimation import EstimateSettings, ReplaySettings, estimate
        from gendom.policies import Policy
        from gendom.reality import RealRope, find_object
        from gendom.reality.chain import record_and_perceive
        from gendom.sim import open_device
        from gendom.viz import CloudSequence, encode_sights, write_gif

        open_device(self.device)
        seconds: dict[str, float] = {}
        rope = find_object(self.reality)
        if not isinstance(rope, RealRope):
            raise ParameterError(
                f"{rope.name} is no rope", where="--reality", fix="the demo's task takes ropes"
            )
        policies = (Policy.pretrained(), Policy.pretrained(parameters=False))
        _check_goals(self.goal, policies[0], rope)
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
        }
        print(f"a recorded lift: {recording.num_frames} frames of {recording.source}\n", flush=True)
        with (
            _timed(seconds, "estimate"),
            tqdm(total=100, unit="%", leave=False, disable=None) as bar,
        ):
            settings = EstimateSettings(
                starts=self.starts, seed=self.seed, replay=ReplaySettings(device=self.device)
            )

            def show(progress: Any) -> None:
                bar.n = round(100 * progress.done)
                bar.set_description(f"estimating ({progress.stage})")

            found = estimate(recording, settings, on_progress=show)
        # Kept whatever becomes of the actions: a goal may turn out to be beyond this rope's reach.
        self.out.mkdir(parents=True, exist_ok=True)
        write_json(self.out / "estimate.json", found.record)
        print(estimate_text(found.record))
        print(
            f"true values      E {truth['youngs_modulus']:.4g} Pa, nu "
            f"{truth['poissons_ratio']:.3f}\n",
            flush=True,
        )
        goals = self.goal or _default_goals(policies[0], found)
        with _timed(seconds, "act and carry out"):
            runs, shown = _carry_out(rope, policies, goals, found)
        task = policies[0].task()
        with _timed(seconds, "predict the motion"):
            motion = _predicted(task, shown, known_rope(found), self.device)
        for goal, ours, without in runs:
            print(
                f"goal {goal:.3f} m: release at ({ours.action[0]:.3f}, {ours.action[1]:.3f}) m, "
                f"reached {ours.reached.item():.3f} m, off by {1e3 * _error(ours, goal):.1f} mm "
                f"(without parameters {1e3 * _error(without, goal):.1f} mm)"
            )
        frames = found.lift.frames
        clouds = CloudSequence(
            recorded=[recording.frame(t) for t in frames],
            simulated=list(found.positions),
            times=recording.time[frames],
            table_height=recording.table_height,
            gripper=recording.gripper_position[frames],
            chamfer=found.chamfer,
        )
        with _timed(seconds, "pictures and report"):
            write_gif(self.out / "lift.gif", clouds)
            actions = {"format": "gendom-demo/1", "task": task.name, "outcomes": _outcomes(runs)}
            write_json(self.out / "actions.json", actions)
            _report(self, recording, views, clouds, found, truth, task, runs, motion, seconds)
        if self.json:
            print(to_json({"estimate": found.record, **actions, "seconds": seconds}))
        print(f"\nreport: {self.out / 'report.html'}")
        return 0


def _check_goals(goals: Sequence[float], policy: Policy, rope: RealRope) -> None:
    """Refuse what no rope of this length reaches, before minutes go into the estimate."""
    low, high = rope.length * policy.goal_range()[0]
    for goal in goals:
        if not low <= goal <= high:
            raise ParameterError(
                f"{goal:g} m is what no rope of {rope.length:g} m reaches",
                where="--goal",
                fix=f"choose {low:.3f} to {high:.3f} m; softer and stiffer ropes reach part of it",
            )


def _default_goals(policy: Policy, found: Estimate) -> tuple[float, ...]:
    low, high = policy.goal_range(known_rope(found))[0]
    return tuple(round(low + share * (high - low), 3) for share in GOAL_SHARES)


def known_rope(found: Estimate) -> Rope:
    """The rope as it was estimated."""
    described, density = found.record["object"], found.record["density"]
    return Rope(
        length=described["length"],
        diameter=described["diameter"],
        material=Material(
            E=found.theta.specific_modulus * density,
            nu=found.theta.nu,
            density=density,
            damping=ASSUMED["damping"],  # a lift does not tell
        ),
    )


def _carry_out(
    rope: RealRope,
    policies: Sequence[Policy],
    goals: Sequence[float],
    found: Estimate,
) -> tuple[list[tuple[float, PolicyRun, PolicyRun]], Executed]:
    """Both policies' actions for each goal, done by the arm; and our last one to look at."""
    from gendom.reality import RealWorld, observe
    from gendom.viz.report import PolicyRun

    task, known = policies[0].task(), known_rope(found)
    done: list[PolicyRun] = []
    executed = []
    for goal in tqdm(
        np.repeat(goals, len(policies)), desc="the arm acts", leave=False, disable=None
    ):
        policy = policies[len(done) % len(policies)]
        action = policy.act(goal, known).values
        performance = RealWorld().performance(task, rope, action)
        seen = observe(task, performance, MOTION_RATE * _FINER)
        released = int(np.searchsorted(seen.times, seen.opens))
        tip = seen.tip[released:]
        farthest = released + int(np.argmax(tip[:, 0]))
        values = task.outcome(rope, seen)
        done.append(
            PolicyRun(
                action=np.array(action),
                reached=np.array([values[q.name] for q in task.goals]),
                tip_path=tip,
                shape_at_release=_filled(seen.points[released]),
                shape_at_farthest=_filled(seen.points[farthest]),
            )
        )
        executed.append(
            Executed(
                action=np.array(action),
                slowed_by=performance.slowed_by,
                times=seen.times[::_FINER] - seen.opens,
                shapes=[_filled(x) for x in seen.points[::_FINER]],
            )
        )
    pairs = zip(goals, done[0::2], done[1::2], strict=True)
    return [(float(goal), ours, without) for goal, ours, without in pairs], executed[-2]


_FINER = 4  # reached places are looked for this much finer in time than the motion is shown


@dataclass(frozen=True, kw_only=True, eq=False)
class Executed:
    """A release as the arm did it, in the task's frame."""

    action: np.ndarray
    """[2] release point [m]."""
    slowed_by: float
    """How much longer the arm took than the task asks for."""
    times: np.ndarray
    """[T] from the release on [s]."""
    shapes: list[np.ndarray]
    """T clouds [n, 3] of the rope [m]."""


def _filled(vertices: np.ndarray, points: int = 150) -> np.ndarray:
    """[points, 3] along the line through a rope's vertices [V, 3] [m]."""
    at = np.linspace(0.0, len(vertices) - 1.0, points)
    knots = np.arange(len(vertices))
    return np.stack([np.interp(at, knots, vertices[:, axis]) for axis in range(3)], axis=1)


def _predicted(task: Task, executed: Executed, known: Rope, device: str) -> CloudSequence:
    """The executed motion, and beside it what our simulator makes of the same action."""
    from gendom.tasks.world import Simulation
    from gendom.viz import CloudSequence

    world = Simulation(device=device, everything=True)
    outcome = world.carry_out(task, [known], [executed.action], keep=True)[0]
    if outcome.seen is None:
        raise GendomError(outcome.fault or "the simulation failed", where="demo")
    # Both are at the release at time 0.
    late = outcome.seen.times - outcome.seen.opens
    frames = np.flatnonzero((executed.times >= late[0]) & (executed.times <= late[-1]))
    nearest = [int(np.argmin(np.abs(late - executed.times[k]))) for k in frames]
    return CloudSequence(
        recorded=[executed.shapes[k] for k in frames],
        simulated=[_filled(outcome.seen.points[k]) for k in nearest],
        times=executed.times[frames] - executed.times[frames[0]],
        labels=("carried out", "predicted"),
    )


def _error(run: PolicyRun, goal: float) -> float:
    """|reached - goal| [m]."""
    return float(np.linalg.norm(run.reached - goal))


def _outcomes(runs: Sequence[tuple[float, PolicyRun, PolicyRun]]) -> list[dict[str, Any]]:
    return [
        {
            "goal": goal,
            **{
                name: {
                    "action": run.action.tolist(),
                    "reached": run.reached.item(),
                    "error": _error(run, goal),
                }
                for name, run in (("with_parameters", ours), ("without_parameters", without))
            },
        }
        for goal, ours, without in runs
    ]


def _report(
    command: Command,
    recording: Recording,
    views: bytes,
    clouds: CloudSequence,
    found: Estimate,
    truth: dict[str, float],
    task: Task,
    runs: Sequence[tuple[float, PolicyRun, PolicyRun]],
    motion: CloudSequence,
    seconds: dict[str, float],
) -> None:
    from gendom.viz.report import (
        ActionSummary,
        CameraViews,
        EstimateSummary,
        LiftPictures,
        Provenance,
        ReachOutcome,
        ReportContent,
        write_report,
    )

    write_report(
        command.out / "report.html",
        ReportContent(
            title="GenDOM: one lift of an unknown rope, and an action that reaches its goal",
            recording_source=(
                f"From {recording.source}. {recording.notes} That reality has other equations than "
                "the simulator that estimates, and is touched through an arm and seen through the "
                "cameras only. The actions below are carried out in it."
            ),
            cameras=CameraViews(
                picture=views,
                note=(
                    "Halfway up. Depth has the noise of a stereo camera, lost and mixed pixels at "
                    "edges, and an error of calibration; the arm is taken out by its joint angles."
                ),
            ),
            lift=LiftPictures(clouds=clouds),
            estimate=EstimateSummary(
                values=found.record,
                truth=truth | {"specific_modulus": truth["youngs_modulus"] / truth["density"]},
            ),
            action=ActionSummary(
                outcomes=[
                    ReachOutcome(goal=np.array([goal]), ours=ours, without=without)
                    for goal, ours, without in runs
                ],
                motion=motion,
                action_names=[f"{q.name.replace('_', ' ')} [{q.unit}]" for q in task.actions],
            ),
            provenance=Provenance(
                commands=[_command_line(command)],
                version=__version__,
                date=date.today().isoformat(),
                device=command.device,
                seeds={"estimate": command.seed},
                stage_seconds=seconds,
                warnings=found.record["notes"],
            ),
        ),
    )


def _command_line(command: Command) -> str:
    """The words that give the same results again."""
    words = ["gendom", "demo", "--out", str(command.out)]
    words += ["--starts", str(command.starts), "--seed", str(command.seed)]
    words += ["--device", command.device]
    if command.live:
        words += ["--live", "--reality", command.reality]
        words += ["--frame-rate", str(command.frame_rate)]
    if command.goal:
        words += ["--goal", *map(str, command.goal)]
    return shlex.join(words)


@contextmanager
def _timed(seconds: dict[str, float], name: str):
    began = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - began
