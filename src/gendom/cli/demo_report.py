"""The page that `gendom demo` writes, and the commands that it names to go on with."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from typing import TYPE_CHECKING, Any

import numpy as np

from gendom.cli.estimate import NOT_USABLE_SUMMARY
from gendom.datasets import Recording
from gendom.installation import version
from gendom.viz.sources import summary_of

if TYPE_CHECKING:
    from gendom.cli.demo import Command
    from gendom.estimation import Estimate
    from gendom.tasks import Task
    from gendom.viz import CloudSequence
    from gendom.viz.report import ActionSummary, PolicyRun

WAYS = {
    "with_parameters": "with the estimate",
    "without_parameters": "without parameters",
    "polished": "polished in the simulator",
    "after_one_execution": "after one execution",
}
"""Ways to act, by their names in actions.json."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """A goal [G], and what each of `WAYS` reached."""

    goal: np.ndarray
    ways: Mapping[str, PolicyRun]

    def error(self, way: str) -> float:
        """|reached - goal| [m]."""
        return float(np.linalg.norm(self.ways[way].reached - self.goal))


SCENE = "MuJoCo test scene"
"""What reports call the second reality."""


def report_demo(
    command: Command,
    command_line: str,
    recording: Recording,
    views: bytes,
    clouds: CloudSequence,
    found: Estimate,
    truth: dict[str, float],
    action: ActionSummary | None,
    seconds: dict[str, float],
) -> None:
    """The page about all of it; without an action where the estimate is not usable."""
    from gendom.viz.report import (
        SUMMARY,
        CameraViews,
        LiftPictures,
        NextStep,
        Provenance,
        ReportContent,
        write_report,
    )

    write_report(
        command.out / "report.html",
        ReportContent(
            title="GenDOM: one lift of an unknown rope"
            + (", and an action that reaches its goal" if action else ""),
            summary=SUMMARY if action else NOT_USABLE_SUMMARY,
            recording_source=(
                f"Recorded in the {SCENE} (the second reality). {recording.notes} This scene has "
                "other equations than the simulator that estimates. A simulated arm moves the "
                "rope, and two simulated depth cameras see it."
                + (" The actions below are carried out in the same scene." if action else "")
            ),
            cameras=CameraViews(
                picture=views,
                note=(
                    "Halfway up. Depth has the noise of a stereo camera, lost and mixed pixels at "
                    "edges, and an error of calibration. The arm's points are removed by its joint "
                    "angles."
                ),
            ),
            lift=LiftPictures(clouds=clouds),
            estimate=summary_of(
                found,
                truth | {"specific_modulus": truth["youngs_modulus"] / truth["density"]},
            ),
            action=action,
            provenance=Provenance(
                commands=[command_line],
                version=version(),
                date=date.today().isoformat(),
                device=command.device,
                seeds={"estimate": command.seed},
                stage_seconds=seconds,
                warnings=found.record["notes"],
            ),
            next_steps=[
                NextStep(command=shlex.join(map(str, words)), purpose=purpose)
                for words, purpose in next_steps(command, action and action.outcomes[0].goal)
            ],
        ),
    )


def action_summary(task: Task, runs: Sequence[Run], motion: CloudSequence) -> ActionSummary:
    from gendom.viz.report import ActionSummary, ReachOutcome

    return ActionSummary(
        outcomes=[
            ReachOutcome(
                goal=run.goal,
                ours=run.ways["with_parameters"],
                without=run.ways["without_parameters"],
                further={
                    WAYS[way].capitalize(): done
                    for way, done in run.ways.items()
                    if way not in ("with_parameters", "without_parameters")
                },
            )
            for run in runs
        ],
        motion=motion,
        goal_name=", ".join(f"{q.name} {q.meaning}" for q in task.goals),
        action_names=[f"{q.name.replace('_', ' ')} [{q.unit}]" for q in task.actions],
    )


def next_steps(command: Command, goal: np.ndarray | None) -> list[tuple[list[Any], str]]:
    """Commands that go on from the demo's files, and what each does; without a goal there is no
    usable estimate."""
    recording, estimate = command.out / "recording.npz", command.out / "estimate.json"
    other = "rope-reaching" if command.task == "rope-casting" else "rope-casting"
    steps: list[tuple[list[Any], str]] = [
        (["gendom", "check", recording], "See what the recording holds."),
        (
            ["gendom", "estimate", recording, "--frames", "last", "--out", command.out / "last",
             "--report", command.out / "last" / "report.html"],
            "Estimate from the last frame alone, with a report of its own.",
        ),
    ]  # fmt: skip
    if goal is None:
        return steps
    return [
        *steps,
        (
            ["gendom", "replay", recording, "--params", estimate, "--gif",
             command.out / "replay.gif"],
            "Simulate the recorded lift, every frame of it, with the estimate.",
        ),
        (
            ["gendom", "act", command.task, "--goal", *goal.tolist(), "--params", estimate],
            "Get an action for a goal, the robot's motion, and what will be reached.",
        ),
        (
            ["gendom", "demo", "--task", other, "--out", f"{command.out}-{other}"],
            "Run the demo with the other task.",
        ),
    ]  # fmt: skip
