"""The report of `gendom demo`, and the commands that it names to go on with."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gendom.installation import version
from gendom.viz.clouds import CloudSequence
from gendom.viz.report.action import ActionSummary
from gendom.viz.report.content import (
    SUMMARY,
    CameraViews,
    NextStep,
    Provenance,
    ReportContent,
    write_report,
)
from gendom.viz.report.lift import LiftPictures
from gendom.viz.sources import summary_of

if TYPE_CHECKING:
    from gendom.datasets import Recording
    from gendom.estimation import Estimate

_SCENE = "MuJoCo test scene"


@dataclass(frozen=True, kw_only=True)
class DemoReport:
    """What the page says, however the demo went."""

    out: Path
    """Folder of the demo's files."""
    task: str
    command: str
    """The words that give the same results again."""
    device: str
    seed: int
    recording: Recording
    views: bytes
    """What the cameras saw, a JPEG."""
    estimate: Estimate
    truth: Mapping[str, float]
    """True values under the keys of an estimate's record."""
    seconds: dict[str, float]
    """Time that each stage took so far [s]."""

    def write(
        self,
        clouds: CloudSequence,
        *,
        summary: str = SUMMARY,
        action: ActionSummary | None = None,
    ) -> None:
        """Write report.html.

        Args:
            clouds: The lift, recorded and simulated.
            summary: The first paragraph.
            action: What was reached; None where the estimate is not usable.
        """
        end = ", and an action that reaches its goal" if action else ""
        source = (
            f"Recorded in the {_SCENE} (the second reality). {self.recording.notes} This scene has "
            "other equations than the simulator that estimates. A simulated arm moves the "
            "rope, and two simulated depth cameras see it."
        )
        if action:
            source += " The actions below are carried out in the same scene."
        cameras = CameraViews(
            picture=self.views,
            note=(
                "Halfway up. Depth has the noise of a stereo camera, lost and mixed pixels at "
                "edges, and an error of calibration. The arm's points are removed by its joint "
                "angles."
            ),
        )
        goal = action.outcomes[0].goal.tolist() if action else None
        content = ReportContent(
            title=f"GenDOM: one lift of an unknown rope{end}",
            summary=summary,
            recording_source=source,
            cameras=cameras,
            lift=LiftPictures(clouds=clouds),
            estimate=summary_of(self.estimate, self.truth),
            action=action,
            provenance=Provenance(
                commands=[self.command],
                version=version(),
                date=date.today().isoformat(),
                device=self.device,
                seeds={"estimate": self.seed},
                stage_seconds=self.seconds,
                warnings=self.estimate.record["notes"],
            ),
            next_steps=[
                NextStep(command=shlex.join(map(str, words)), purpose=purpose)
                for words, purpose in next_steps(self.out, self.task, goal)
            ],
        )
        write_report(self.out / "report.html", content)


def next_steps(out: Path, task: str, goal: Sequence[float] | None) -> list[tuple[list[Any], str]]:
    """Commands that go on from the demo's files, and what each does; without a goal there is no
    usable estimate."""
    recording, estimate = out / "recording.npz", out / "estimate.json"
    other = "rope-reaching" if task == "rope-casting" else "rope-casting"
    steps: list[tuple[list[Any], str]] = [
        (["gendom", "check", recording], "See what the recording holds."),
        (
            ["gendom", "estimate", recording, "--frames", "last", "--out", out / "last",
             "--report", out / "last" / "report.html"],
            "Estimate from the last frame alone, with a report of its own.",
        ),
    ]  # fmt: skip
    if goal is None:
        return steps
    return [
        *steps,
        (
            ["gendom", "replay", recording, "--params", estimate, "--gif", out / "replay.gif"],
            "Simulate the recorded lift, every frame of it, with the estimate.",
        ),
        (
            ["gendom", "act", task, "--goal", *goal, "--params", estimate],
            "Get an action for a goal, the robot's motion, and what will be reached.",
        ),
        (
            ["gendom", "demo", "--task", other, "--out", f"{out}-{other}"],
            "Run the demo with the other task.",
        ),
    ]
