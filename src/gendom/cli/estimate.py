"""`gendom estimate`: an object's parameters from one or more recordings."""

from __future__ import annotations

import logging
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from gendom.cli.arguments import MethodName, iterations_shown, settings_of
from gendom.cli.outputs import tell_written
from gendom.cli.parsing import command_line
from gendom.datasets import Recording
from gendom.errors import ParameterError, RecordingError, SimulationError, printable
from gendom.files import check_file, check_folder, to_json, write_json

if TYPE_CHECKING:
    from gendom.estimation import EstimateSettings, FittedEstimate
    from gendom.viz import Provenance

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

    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")]
    """A gendom-recording/1 file (.npz), or a folder: clouds (.ply, .pcd, .npz), gripper.csv and
    object.toml (docs/data.md)."""
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
    method: MethodName = "gauss-newton"
    """Method of the search (docs/estimation.md)."""
    frames: Literal["all", "last"] = "all"
    """Frames that are compared."""
    starts: int = 3
    """Number of starts of the search: the best of a scan first, then random ones."""
    seed: int = 0
    """Seed of all random draws."""
    level: float = 0.9
    """Nominal probability of the intervals."""
    unknowns: tuple[str, ...] = ()
    """Unknowns to estimate, such as E_over_rho grip_height; by default those that a recording
    of this kind may determine."""
    also: tuple[str, ...] = ()
    """Further ones, such as tip_mass (a knot or a sheath at a rope's end) or thickness."""
    material: str | None = None
    """Its material, by a name of gendom materials: narrows the priors."""
    camera_pose: Literal["stated", "unknown"] | None = None
    """unknown: the cameras are not calibrated to the robot, and their pose is estimated, too; by
    default as each recording says (cameras_calibrated, docs/recordings.md)."""
    engine: Literal["thin", "mpm"] = "thin"
    """Engine of the simulator. thin: ropes as rods, cloths as shells. mpm: material points,
    slower."""
    points: int | None = None
    """Points of a rod, or along the longer side of a shell; by default the engine's choice."""
    cells_across: float = 1.5
    """With mpm: grid cells across a rope's diameter (cloths alike); finer is slower."""
    device: str = "cpu"
    """cpu, cuda or cuda:0 and so on."""

    def run(self) -> int:
        from gendom.estimation import estimate
        from gendom.sim import open_device

        if self.points is not None and self.points > MOST_POINTS:
            fix = f"give {MOST_POINTS} or fewer: 20 to 60 are usual"
            raise ParameterError(f"is {self.points}", where="--points", fix=fix)
        settings = self.settings()
        self._check_recordings()
        self._check_places()
        open_device(self.device)
        recordings = [Recording.read(path) for path in self.recordings]
        names = tuple(map(str, self.recordings)) if len(recordings) > 1 else ()
        try:
            with iterations_shown() as show:
                found = estimate(recordings, settings, names=names, on_progress=show)
        except (RecordingError, SimulationError) as error:
            return self._refused(str(error).splitlines())
        print(to_json(found.record) if self.json else estimate_text(found))
        for reason in found.verdict.reasons:
            _log.error("not usable: %s", reason)
        if self.out is not None:
            self._written(self.out / "estimate.json", found.record)
        if self.report is not None:
            self._write_report(found)
        return 0 if found.usable else NOT_USABLE

    def settings(self) -> EstimateSettings:
        """The flags as the estimator takes them."""
        from gendom.estimation import EstimateSettings, SceneSettings

        scene = settings_of(SceneSettings, self)
        return settings_of(EstimateSettings, self, scene=scene)

    def _check_recordings(self) -> None:
        """Refuse a recording that would count more than once."""
        seen: set[Path] = set()
        for path in self.recordings:
            if path.resolve() in seen:
                fix = "name each recording once"
                raise ParameterError("is given twice", where=str(path), fix=fix)
            seen.add(path.resolve())

    def _check_places(self) -> None:
        """Refuse what cannot be written before the work, not after it."""
        if self.out is not None:
            check_folder(self.out)
        if self.report is not None:
            check_file(self.report, ".html")

    def _refused(self, reasons: list[str]) -> int:
        """Print and write why a recording gives no estimate."""
        from gendom.materials.estimate_file import FORMAT

        record = {"format": FORMAT, "verdict": {"usable": False, "reasons": reasons}}
        if self.json:
            print(to_json(record))
        for reason in reasons:
            _log.error("not usable: %s", reason)
        if self.out is not None:
            self._written(self.out / "estimate.json", record)
        if self.report is not None:
            self._write_refusal(reasons)
        return NOT_USABLE

    def _written(self, path: Path, record: dict) -> None:
        write_json(path, record)
        tell_written(path, json=self.json)

    def _write_report(self, found: FittedEstimate) -> None:
        from gendom.viz import EstimateSummary, LiftPictures, ReportContent, write_report
        from gendom.viz.sources import clouds_of, view_of

        assert self.report is not None
        record, first = found.record, found.fits[0]
        recording = first.scene.recording
        note = "" if len(found.fits) == 1 else f"The first of {len(found.fits)}: {first.name}."
        write_report(
            self.report,
            ReportContent(
                title=f"GenDOM: the parameters of a {first.scene.kind}",
                summary=REPORT_SUMMARY if found.usable else NOT_USABLE_SUMMARY,
                recording_source=_sentences(self._named, recording.source, recording.notes),
                lift=LiftPictures(
                    clouds=clouds_of(first.scene, first.positions, first.theta, first.chamfer),
                    view=view_of(first.scene),
                    note=note,
                ),
                estimate=EstimateSummary(values=found.record),
                provenance=self._provenance(record["stage_seconds"], record["notes"]),
                next_steps=self._next_steps(found),
            ),
        )
        tell_written(self.report, json=self.json)

    def _write_refusal(self, reasons: list[str]) -> None:
        from gendom.viz import ReportContent, write_report

        assert self.report is not None
        write_report(
            self.report,
            ReportContent(
                title="GenDOM: a recording that cannot be used",
                summary="Nothing was estimated from this recording, for the reasons above.",
                recording_source=_sentences(self._named),
                refused=reasons,
                provenance=self._provenance({}, []),
                next_steps=self._next_steps(None),
            ),
        )
        tell_written(self.report, json=self.json)

    def _provenance(self, seconds: dict[str, float], warnings: list[str]) -> Provenance:
        from gendom.viz import Provenance

        return Provenance(
            commands=[self._command_line()],
            device=self.device,
            seeds={"estimate": self.seed},
            stage_seconds=seconds,
            warnings=warnings,
        )

    def _next_steps(self, found: FittedEstimate | None) -> list[tuple[str, str]]:
        """Commands to run next on the written files."""
        words = ["gendom", "check", self.recordings[0]]
        steps = [(_shell(words), "See what the recording holds.")]
        if found is None or self.report is None:
            return steps
        if self.out is None:
            words = [*shlex.split(self._command_line()), "--out", self.report.parent]
            purpose = "Write the estimate to a file, which other commands take."
            return [*steps, (_shell(words), purpose)]
        params = ["--params", self.out / "estimate.json"]
        words = ["gendom", "replay", self.recordings[0], *params, "--gif", self.out / "replay.gif"]
        words += [] if found.usable else ["--force"]
        purpose = "Simulate the recorded motion, every frame of it, with the estimate."
        steps.append((_shell(words), purpose))
        if found.usable:
            words = ["gendom", "act", *_task_and_goal(found), *params, "--force"]
            purpose = (
                "Get an action for this object, and the robot's motion; --force allows objects and "
                "goals beyond what the policy was trained on, with a warning."
            )
            steps.append((_shell(words), purpose))
        return steps

    @property
    def recordings(self) -> tuple[Path, ...]:
        """All of them."""
        return self.recording, *self.more

    @property
    def _named(self) -> str:
        return ", ".join(path.name for path in self.recordings)

    def _command_line(self) -> str:
        """The words that give the same estimate again."""
        return command_line("estimate", self, without=("out", "report", "json"))


def _sentences(*texts: str) -> str:
    """Texts that are not empty, one after another, each with a full stop."""
    return " ".join(text if text.endswith(".") else f"{text}." for text in texts if text)


def _task_and_goal(found: FittedEstimate) -> list[str]:
    """A task for an object of this kind, with a goal in the middle of those trained on."""
    from gendom.policies import Policy

    if found.kind == "cloth":
        return ["cloth-spreading"]
    ends = found.record["object"]["length"] * Policy.pretrained("rope-casting").goal_range()
    return ["rope-casting", "--goal", *(f"{end:.3f}" for end in ends.mean(axis=1))]


def _shell(words: Sequence[str | Path]) -> str:
    return shlex.join(map(str, words))


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
        rows += [
            (
                "distance",
                f"of the clouds from the best fit {1e3 * own['rms']:.1f} mm (root mean square)",
            ),
            (
                "Chamfer",
                f"last frame {1e3 * own['chamfer_last']:.1f} mm, mean "
                f"{1e3 * own['chamfer_mean']:.1f} mm; seen surface "
                f"{1e3 * own['chamfer_last_surface']:.1f} and "
                f"{1e3 * own['chamfer_mean_surface']:.1f} mm; with the cameras' motion "
                f"{1e3 * own['chamfer_last_registered']:.1f} and "
                f"{1e3 * own['chamfer_mean_registered']:.1f} mm",
            ),
        ]
    rows += [
        (
            "search",
            f"{record['method']}, {record['iterations']} iterations, {record['seconds']:.1f} s, "
            f"seed {record['seed']}, {record['device']}"
            + (", interrupted: best so far" if record["interrupted"] else ""),
        ),
    ]
    lines = [f"{name:<16} {text}" for name, text in rows]
    return "\n".join(lines + [f"note: {note}" for note in record["notes"]])
