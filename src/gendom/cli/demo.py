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
from gendom.errors import GendomError
from gendom.files import to_json, write_json
from gendom.materials import Material

if TYPE_CHECKING:
    from gendom.estimation import Estimate
    from gendom.policies import Policy
    from gendom.tasks import RopeReaching
    from gendom.viz import CloudSequence
    from gendom.viz.report import PolicyRun

RECORDING = "demo-rope-lift.npz"
"""The demo's recording in the package's assets."""

CELLS_ACROSS = 2.0
"""Resolution at which actions are carried out: not that of the policy's training, 1.5."""

GOAL_SHARES = (0.25, 0.5, 0.75)
"""Default goals, as places in the policy's range for this rope."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """Show the whole story: a lift, the estimate, the policy's action, what comes of it.

    Without arguments it uses a recording and policies that come with the package.
    """

    out: Path = Path("demo")
    """Folder for report.html, estimate.json, actions.json and lift.gif."""
    goal: tuple[float, ...] = ()
    """How far the tip shall reach from the robot's base [m]; by default three goals."""
    starts: int = 3
    """Random starts of the estimate."""
    seed: int = 0
    """Seed of the estimate."""
    device: str = "cpu"
    """cpu, cuda or cuda:0 and so on."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        from gendom.estimation import EstimateSettings, ReplaySettings, estimate
        from gendom.policies import Policy
        from gendom.sim import open_device
        from gendom.viz import CloudSequence, write_gif

        open_device(self.device)
        seconds: dict[str, float] = {}
        source = resources.files("gendom") / "assets" / RECORDING
        with resources.as_file(source) as path:
            recording = Recording.read(path)
        truth = recording.extra["truth"]
        print(f"a recorded lift: {recording.num_frames} frames of {recording.source}\n", flush=True)
        with _timed(seconds, "estimate"), tqdm(total=100, unit="%", leave=False) as bar:
            settings = EstimateSettings(
                starts=self.starts, seed=self.seed, replay=ReplaySettings(device=self.device)
            )

            def show(progress: Any) -> None:
                bar.n = round(100 * progress.done)
                bar.set_description(f"estimating ({progress.stage})")

            found = estimate(recording, settings, on_progress=show)
        print(estimate_text(found.record))
        print(
            f"true values      E {truth['youngs_modulus']:.4g} Pa, nu "
            f"{truth['poissons_ratio']:.3f}\n",
            flush=True,
        )
        policies = (Policy.pretrained(), Policy.pretrained(parameters=False))
        goals = self.goal or _default_goals(policies[0], found)
        sizes = found.record["object"]
        with _timed(seconds, "act and carry out"):
            task = policies[0].task().scaled_to(sizes["length"], sizes["diameter"])
            runs = _carry_out(task, policies, goals, found, truth, self.device)
        for goal, ours, without in runs:
            print(
                f"goal {goal:.3f} m: release at ({ours.action[0]:.3f}, {ours.action[1]:.3f}) m, "
                f"reached {ours.reached.item():.3f} m, off by {1e3 * _error(ours, goal):.1f} mm "
                f"(without parameters {1e3 * _error(without, goal):.1f} mm)"
            )
        self.out.mkdir(parents=True, exist_ok=True)
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
            write_json(self.out / "estimate.json", found.record)
            actions = {"format": "gendom-demo/1", "task": task.name, "outcomes": _outcomes(runs)}
            write_json(self.out / "actions.json", actions)
            _report(self, recording, clouds, found, truth, task, runs, seconds)
        if self.json:
            print(to_json({"estimate": found.record, **actions, "seconds": seconds}))
        print(f"\nreport: {self.out / 'report.html'}")
        return 0


def _default_goals(policy: Policy, found: Estimate) -> tuple[float, ...]:
    described = found.record["object"]
    task = policy.task()
    modulus = task.conditioned_on(
        found.theta.specific_modulus,
        length=described["length"],
        diameter=described["diameter"],
    )
    low, high = policy.goal_range(modulus)
    return tuple(
        round(described["length"] * (low + share * (high - low)), 3) for share in GOAL_SHARES
    )


def _carry_out(
    task: RopeReaching,
    policies: Sequence[Policy],
    goals: Sequence[float],
    found: Estimate,
    truth: dict[str, float],
    device: str,
) -> list[tuple[float, PolicyRun, PolicyRun]]:
    """Both policies' actions for each goal, simulated with the true parameters."""
    from dataclasses import replace

    from gendom.viz.report import PolicyRun

    size = {"length": task.length, "diameter": task.diameter}
    actions = [
        policy.act(goal, found.theta.specific_modulus, found.theta.nu, **size).values
        for goal in goals
        for policy in policies
    ]
    object_ = Material(
        E=truth["youngs_modulus"], nu=truth["poissons_ratio"], density=truth["density"]
    )
    world = replace(task, cells_across=CELLS_ACROSS)
    with tqdm(total=1, desc="carrying out", leave=False):
        outcome = world.simulate(
            np.array(actions), [object_] * len(actions), device=device, record_particles=True
        )
    if outcome.positions is None:
        raise GendomError("the simulation kept no particles", where="demo")
    released = int(np.argmin(np.abs(outcome.times - task.release_time)))
    runs = []
    for w, action in enumerate(actions):
        path = outcome.tip_path[released:, w]
        farthest = released + int(np.argmax(path[:, 0]))
        runs.append(
            PolicyRun(
                action=np.array(action),
                reached=np.array(outcome.reached[w]),
                tip_path=path,
                shape_at_release=outcome.positions[released, w],
                shape_at_farthest=outcome.positions[farthest, w],
            )
        )
    return [(goal, runs[2 * k], runs[2 * k + 1]) for k, goal in enumerate(goals)]


def _error(run: PolicyRun, goal: float) -> float:
    """|reached - goal| [m]."""
    return abs(run.reached.item() - goal)


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
    clouds: CloudSequence,
    found: Estimate,
    truth: dict[str, float],
    task: RopeReaching,
    runs: Sequence[tuple[float, PolicyRun, PolicyRun]],
    seconds: dict[str, float],
) -> None:
    from gendom.viz.report import (
        ActionSummary,
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
                f"Made by {recording.source}, with depth noise: {recording.notes} The actions "
                "below are carried out in the same simulator with the true parameters, on a "
                "finer grid than the policy was trained on."
            ),
            lift=LiftPictures(clouds=clouds),
            estimate=EstimateSummary(
                values=found.record,
                truth=truth | {"specific_modulus": truth["youngs_modulus"] / truth["density"]},
            ),
            action=ActionSummary(
                outcomes=[
                    ReachOutcome(goal=np.array(goal), ours=ours, without=without)
                    for goal, ours, without in runs
                ],
                action_names=[f"{name.replace('_', ' ')} [m]" for name in task.action_names],
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
    if command.goal:
        words += ["--goal", *map(str, command.goal)]
    return shlex.join(words)


@contextmanager
def _timed(seconds: dict[str, float], name: str):
    began = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - began
