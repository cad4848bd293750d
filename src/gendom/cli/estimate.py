"""`gendom estimate`: an object's parameters from one or more recordings."""

from __future__ import annotations

import logging
import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from gendom.arguments import require
from gendom.cli.arguments import Recorded, iterations_shown
from gendom.cli.outputs import check_places, tell_written, write_result
from gendom.cli.parsing import TYPED, NotFlags
from gendom.datasets import Recording
from gendom.errors import RecordingError, SimulationError, printable
from gendom.estimation import EstimateSettings, find_method
from gendom.files import to_json
from gendom.materials.estimate_file import FORMAT

if TYPE_CHECKING:
    from gendom.estimation import FittedEstimate
    from gendom.viz import ReportContent

INTERNAL = (
    "noise", "max_iterations", "slow_frames", "fast_frames", "dtype", "substep", "threads",
)  # fmt: skip
"""Settings that are no flags."""

DISTANCES = {"surface": "seen surface", "registered": "with the cameras' motion"}
"""Further Chamfer distances of a record, and what they are of."""

NAME = "estimate.json"
"""Of an estimate's file."""

NOT_USABLE = 3
"""Exit code where a recording cannot be used."""

MOST_POINTS = 1000
"""Of a rod or along a shell; more would take hours."""

REPORT_SUMMARY = (
    "GenDOM watched this object being moved and found the parameters with which its simulator "
    "repeats that motion. This page shows how well the simulated motion matches the recorded one, "
    "and how sure the estimate is."
)

NOT_USABLE_SUMMARY = (
    "GenDOM watched this object being moved and searched for parameters with which its simulator "
    "repeats that motion. It found none that do so well enough. This page shows the best fit, and "
    "where it differs."
)

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Command:
    """Estimate an object's parameters from recordings: E / density and what else they determine.

    Several recordings are of one object: its material is the same in all of them, how it is held
    and when it moves is each one's own. If one of them cannot be used, the estimate is not usable,
    and the reason names it.

    Ctrl-C ends the search and keeps the best found so far. Exit code 3: the recording cannot be
    used, for the reasons that are printed; no intervals are given then.

    For example: gendom estimate lift.npz --out lift --report lift.html
    """

    recording: Recorded
    more: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="[RECORDING ...]")
    ] = ()
    """More recordings of the same object."""
    out: Path | None = None
    """Folder for estimate.json."""
    report: Path | None = None
    """HTML file: recorded and simulated motion, and the estimate."""
    json: bool = False
    """Print the estimate as JSON."""
    settings: Annotated[EstimateSettings, NotFlags(*INTERNAL)] = field(
        default_factory=EstimateSettings
    )

    def run(self) -> int:
        from gendom.estimation import estimate
        from gendom.sim import open_device

        points, fix = self.settings.scene.points, f"give {MOST_POINTS} or fewer: 20 to 60 are usual"
        require((points or 0) <= MOST_POINTS, f"is {points}", where="--points", fix=fix)
        find_method(self.settings.method)
        lifts = [self.recording, *self.more]
        places = [os.path.realpath(path) for path in lifts]
        for k, path in enumerate(lifts):  # it would count more than once
            once = places[k] not in places[:k]
            require(once, "is given twice", where=str(path), fix="name each recording once")
        check_places((self.out, ""), (self.report, ".html"))
        open_device(self.settings.scene.device)
        recordings = [Recording.read(path) for path in lifts]
        names = tuple(map(str, lifts)) if self.more else ()
        try:
            with iterations_shown() as show:
                found = estimate(recordings, self.settings, names=names, on_progress=show)
            record, reasons = found.record, found.verdict.reasons
        except (RecordingError, SimulationError) as error:
            found, reasons = None, str(error).splitlines()
            record = {"format": FORMAT, "verdict": {"usable": False, "reasons": reasons}}
        if self.json:
            print(to_json(record))
        elif found is not None:
            print(estimate_text(found))
        for reason in reasons:
            _log.error("not usable: %s", reason)
        write_result(None if self.out is None else self.out / NAME, record, json=self.json)
        if self.report is not None:
            from gendom.viz import write_report

            names = ", ".join(path.name for path in lifts)
            content = _nothing(reasons, names) if found is None else self._content(found, names)
            write_report(self.report, replace(content, next_steps=self._next_steps(found)))
            tell_written(self.report, json=self.json)
        return 0 if found is not None and found.usable else NOT_USABLE

    def _content(self, found: FittedEstimate, names: str) -> ReportContent:
        first, several = found.fits[0], len(found.fits)
        recording = first.scene.recording
        return fit_content(
            found,
            title=f"GenDOM: the parameters of a {found.kind}",
            summary=REPORT_SUMMARY if found.usable else NOT_USABLE_SUMMARY,
            recording_source=_sentences(names, recording.source, recording.notes),
            lift_note=f"The first of {several}: {first.name}." if several > 1 else "",
        )

    def _next_steps(self, found: FittedEstimate | None) -> list[tuple[str, str]]:
        steps = next_steps(self.recording)
        if found is None:
            return steps
        if self.out is None:
            assert self.report is not None
            words = shell([*TYPED, "--out", self.report.parent])
            return [*steps, (words, "Write the estimate to a file, which other commands take.")]
        act = [*task_and_goal(found.kind, found.record["object"].get("length")), "--force"]
        return next_steps(self.recording, self.out / NAME, act if found.usable else None)


def _nothing(reasons: Sequence[str], names: str) -> ReportContent:
    """A report of why there is no estimate."""
    from gendom.viz import ReportContent

    return ReportContent(
        title="GenDOM: a recording that cannot be used", refused=reasons, command=shell(TYPED),
        summary="Nothing was estimated from this recording, for the reasons above.",
        recording_source=_sentences(names),
    )  # fmt: skip


def fit_content(found: FittedEstimate, **more: Any) -> ReportContent:
    """A report of an estimate: its first recording beside the fit, and further parts."""
    from gendom.viz import ReportContent
    from gendom.viz.layers import lift_animation

    fit, rms = found.fits[0], np.array(found.record["rms_by_frame"])
    distance = ("rms", rms) if len(rms) == len(fit.positions) else None  # not of the last alone
    lift = lift_animation(fit.scene, fit.positions, fit.theta, distance=distance)
    return ReportContent(command=shell(TYPED), lift=lift, estimate=found, **more)


def shell(words: Sequence[object]) -> str:
    """Words as they are typed."""
    return shlex.join(map(str, words))


def next_steps(
    recording: Path, estimate: Path | None = None, act: Sequence[object] | None = None
) -> list[tuple[str, str]]:
    """Commands to run next, and what each does.

    Args:
        recording: What was estimated from.
        estimate: The estimate's file, if there is one.
        act: A task and its goal, if the estimate is usable.
    """
    steps = [(["gendom", "check", recording], "See what the recording holds.")]
    if estimate is not None:
        params = ["--params", estimate]
        words = ["gendom", "replay", recording, *params, "--gif", estimate.parent / "replay.gif"]
        words += ["--force"] if act is None else []
        purpose = "Simulate the recorded motion, every frame of it, with the estimate."
        steps.append((words, purpose))
        if act is not None:
            purpose = "Get an action for this object, the robot's motion, and what will be reached"
            forced = "; --force allows objects and goals beyond what the policy was trained on"
            purpose += forced * ("--force" in act) + "."
            steps.append((["gendom", "act", *act, *params], purpose))
    return [(shell(words), purpose) for words, purpose in steps]


def _sentences(*texts: str) -> str:
    """Texts that are not empty, one after another, each with a full stop."""
    return " ".join(text if text.endswith(".") else f"{text}." for text in texts if text)


def task_and_goal(kind: str, length: float | None) -> list[str]:
    """A task for an object of a kind, with a goal in the middle of those trained on for a rope of
    a length [m]."""
    from gendom.policies import Policy

    if kind == "cloth" or length is None:
        return ["cloth-spreading"]
    ends = length * Policy.pretrained("rope-casting").goal_range()
    return ["rope-casting", "--goal", *(f"{end:.3f}" for end in ends.mean(axis=1))]


def estimate_text(found: FittedEstimate) -> str:
    """An estimate for people."""
    record = found.record
    rows = [("verdict", "usable" if found.usable else "not usable")]
    rows += [(name, ", ".join(filter(None, (value, said)))) for name, value, said in found.rows()]
    for own in record["recordings"]:
        if own["name"]:
            rows.append(("recording", printable(own["name"])))
        if own["name"] and own["alone"] is not None:
            alone, ends = own["alone"]["E_over_rho"], own["alone"]["interval"]
            said = f"E / density {alone:.4g} m^2/s^2, in [{ends[0]:.4g}, {ends[1]:.4g}]"
            rows.append(("by itself", said))

        def mm(*names: str, of: dict = own) -> str:
            return " and ".join(f"{1e3 * of[name]:.1f}" for name in names) + " mm"

        rows.append(("distance", f"of the clouds from the best fit {mm('rms')} (root mean square)"))
        said = f"last frame {mm('chamfer_last')}, mean {mm('chamfer_mean')}"
        for part, title in DISTANCES.items():
            said += f"; {title} {mm(f'chamfer_last_{part}', f'chamfer_mean_{part}')}"
        rows.append(("Chamfer", said))
    how = f"{record['method']}, {record['iterations']} iterations, {record['seconds']:.1f} s"
    how += f", seed {record['seed']}, {record['device']}"
    rows.append(("search", how + ", interrupted: best so far" * record["interrupted"]))
    lines = [f"{name:<16} {text}" for name, text in rows]
    return "\n".join(lines + [f"note: {note}" for note in record["notes"]])
