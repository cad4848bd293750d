"""`gendom reproduce`: the paper's tables, measured here."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from gendom.cli.outputs import tell_written
from gendom.files import atomic_path, check_folder, to_json, write_json
from gendom.installation import version
from gendom.progress import bar

if TYPE_CHECKING:
    from gendom.evaluation.coverage import CoverageSettings
    from gendom.evaluation.sheet import Curves, Ranks, Sheet
    from gendom.evaluation.tables import Workbench

SCALES = {"small": (2, 1), "full": (5, 5)}
"""Objects, and starts of each, by scale of the table sim2sim."""

SIMULATED = {"small": (2_000, 60, 1, 2), "full": (40_000, 150, 3, 4)}
"""Demonstrations, epochs, trainings and rounds of refining of the table ablation; generalization
takes the paper's number of demonstrations."""

ROPE_REAL = {"small": (2, 4_000, 20, 60, 1, 1), "full": (24, 40_000, 100, 150, 5, 4)}
"""Goals of each rope, demonstrations, real ones of each rope, epochs, executions and rounds of
refining of the table rope-real."""

CLOTH_REAL = {"small": (1, 0, 2), "full": (5, 800, 8)}
"""Trials of each cloth, demonstrations and draws of the table cloth-real."""

REAL2SIM = {"small": (1, 12), "full": (3, 25)}
"""Starts and iterations of the table real2sim."""

PAPER_DEMONSTRATIONS = 2_271

SIM2SIM = (
    ("gauss-newton", "all"),
    ("gauss-newton", "last"),
    ("adam", "all"),
    ("adam", "last"),
    ("pointnet", "last"),
)
"""Its rows: methods, and the frames that they see."""


PAPERS_TABLE = "The paper's table, measured with this package, beside the paper's numbers."

RANKS = (
    "Random objects, each lifted once and estimated without calibration. Where posteriors are "
    "right, the truth has any rank among their values as often as any other: bars end within the "
    "band. Bars that are high on both sides mean posteriors that are too narrow, bars that are "
    "high on one side a bias."
)

VERDICT = (
    "Random objects, each lifted once, and the recording spoiled in many ways. Right: usable, and "
    "the truth lies in the intervals of E and E / density, or within 10 % of them."
)

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Command:
    """Reproduce one of the paper's tables, beside the paper's own numbers, or measure the
    coverage of intervals.

    sim2sim: errors of estimators on simulated lifts with exact clouds.
    ablation: policies that see both parameters, one or none, on goals of random ropes.
    generalization: the default policy and R2S2R on the paper's three ropes and on softer ones.
    rope-real: three ropes of the MuJoCo test scene (the second reality), each lifted once;
    policies, baselines, polished and adapted actions, carried out by the arm.
    cloth-real: two cloths of that scene, each lifted once, spread by policies and by the A that
    spreads most in our simulator.
    real2sim: those ropes and two cloths, each lifted once and estimated by every method; Chamfer
    distances beside the paper's.
    coverage: random objects of that scene are lifted, recorded and estimated: errors, share of
    intervals that hold the truth, refused lifts. A lift takes about a minute on a core.
    verdict: the same lifts, each spoiled in 48 ways (wrong units, sizes, frames, cameras), and what
    estimates say: refused, right or wrong. A lift of a rope takes about five minutes on a core.
    Results in --out are kept, so an interrupted table continues. Tables of policies need the extra
    train.

    For example: gendom reproduce sim2sim --method gauss-newton
    """

    table: tyro.conf.Positional[
        Literal[
            "sim2sim",
            "real2sim",
            "ablation",
            "generalization",
            "rope-real",
            "cloth-real",
            "coverage",
            "verdict",
        ]
    ]
    """Which table."""
    scale: Literal["small", "full"] = "small"
    """small: minutes on two cores; full: the paper's counts and more, for a GPU."""
    task: Literal["rope-reaching", "rope-casting"] = "rope-reaching"
    """Task of tables of policies."""
    method: tuple[Literal["gauss-newton", "adam", "differential-evolution", "pointnet"], ...] = ()
    """Of sim2sim and real2sim: only rows of these methods; by default all, but of sim2sim not
    differential-evolution."""
    objects: tuple[str, ...] = ()
    """Of real2sim and cloth-real: only these, names as gendom record --reality takes them."""
    engine: Literal["thin", "mpm"] = "thin"
    """Of sim2sim, ablation and generalization. mpm: the paper's, slower."""
    kind: Literal["rope", "cloth"] = "rope"
    """Of coverage and verdict: what is lifted."""
    end: Literal["hold", "swing", "drop"] = "hold"
    """Of coverage and verdict: how lifts end."""
    lifts: int = 40
    """Of coverage and verdict: how many."""
    jobs: int = 2
    """Processes of the MuJoCo test scene and of training."""
    out: Path | None = None
    """Folder that keeps everything a table is made from (default: its name)."""
    seed: int = 0
    """Seed of all random draws."""
    device: str = "cpu"
    """cpu, cuda or cuda:0 and so on."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        if self.table == "sim2sim":
            return self._sim2sim()
        if self.table == "real2sim":
            return self._real2sim()
        if self.table == "cloth-real":
            return self._cloth_real()
        if self.table == "coverage":
            return self._coverage()
        if self.table == "verdict":
            return self._verdict()
        return self._policies()

    @property
    def _folder(self) -> Path:
        return self.out or Path(self.table)

    def _bench(self) -> Workbench:
        """Where tables of several stages are made."""
        from gendom.evaluation.tables import Workbench

        check_folder(self._folder)
        return Workbench(
            folder=self._folder,
            device=self.device,
            jobs=self.jobs,
            seed=self.seed,
            on_stage=_log.info,
        )

    def _policies(self) -> int:
        from gendom.evaluation.tables import (
            RopeRealSettings,
            SimulatedSettings,
            ablation,
            generalization,
            rope_real,
            sheets,
        )

        bench = self._bench()
        began = time.monotonic()
        if self.table == "rope-real":
            goals, demonstrations, real, epochs, executions, refine = ROPE_REAL[self.scale]
            result = rope_real(
                bench,
                RopeRealSettings(
                    task=self.task,
                    goals=goals,
                    demonstrations=demonstrations,
                    real=real,
                    epochs=epochs,
                    executions=executions,
                    refine=refine,
                ),
            )
            shown = sheets.rope_real_sheets(result)
        else:
            demonstrations, epochs, seeds, refine = SIMULATED[self.scale]
            settings = SimulatedSettings(
                task=self.task,
                engine=self.engine,
                demonstrations=demonstrations,
                epochs=epochs,
                seeds=seeds,
                refine=refine,
            )
            if self.table == "ablation":
                result = ablation(bench, settings)
                shown = sheets.ablation_sheets(result, self.task)
            else:
                settings = replace(settings, demonstrations=PAPER_DEMONSTRATIONS, goals=(40, 200))
                result = generalization(bench, settings)
                shown = sheets.generalization_sheets(result)
        self._tell(
            {"task": self.task, "engine": self.engine, **result},
            shown,
            name=f"{self.table}-{self.task}",
            title=f"{self.table}, {self.task}",
            flags=f"--task {self.task} --engine {self.engine}",
            seconds=time.monotonic() - began,
        )
        return 0

    def _cloth_real(self) -> int:
        from gendom.evaluation.tables import ClothRealSettings, cloth_real, sheets

        trials, demonstrations, draws = CLOTH_REAL[self.scale]
        settings = ClothRealSettings(trials=trials, demonstrations=demonstrations, draws=draws)
        if self.objects:
            settings = replace(settings, cloths=self.objects)
        return self._of_objects(cloth_real, settings, settings.cloths, sheets.cloth_real_sheets)

    def _real2sim(self) -> int:
        from gendom.evaluation.tables import Real2SimSettings, real2sim, sheets

        starts, iterations = REAL2SIM[self.scale]
        settings = Real2SimSettings(methods=self.method, starts=starts, iterations=iterations)
        if self.objects:
            settings = replace(settings, objects=self.objects)
        return self._of_objects(real2sim, settings, settings.objects, sheets.real2sim_sheets)

    def _of_objects(
        self,
        make: Callable[[Workbench, Any], dict[str, Any]],
        settings: Any,
        objects: Sequence[str],
        sheets_of: Callable[[dict[str, Any]], Sequence[Sheet]],
    ) -> int:
        """Make a table of named objects, and print it."""
        bench = self._bench()
        began = time.monotonic()
        result = make(bench, settings)
        flags = f"--method {' '.join(self.method)} " if self.method else ""
        self._tell(
            result,
            sheets_of(result),
            name=self.table,
            title=self.table,
            flags=f"{flags}--objects {' '.join(objects)}",
            seconds=time.monotonic() - began,
        )
        return 0

    def _tell(
        self,
        result: dict[str, Any],
        shown: Sequence[Sheet | Curves],
        *,
        name: str,
        title: str,
        flags: str,
        seconds: float,
    ) -> None:
        """Print one of the paper's tables, and write it as JSON and as a page."""
        from gendom.evaluation.sheet import Sheet

        result = {
            "table": self.table,
            "scale": self.scale,
            "seed": self.seed,
            **result,
            "seconds": seconds,
        }
        tables = [str(sheet) for sheet in shown if isinstance(sheet, Sheet)]
        print(to_json(result) if self.json else "\n\n".join(tables))
        write_json(self._folder / f"{name}.json", result)
        self._write_page(
            self._folder / f"{name}.html",
            shown,
            title=title,
            about=PAPERS_TABLE,
            flags=f"{flags} --scale {self.scale} --seed {self.seed} --device {self.device}",
            seconds=seconds,
        )

    def _write_page(
        self,
        path: Path,
        shown: Sequence[Sheet | Curves | Ranks],
        *,
        title: str,
        about: str,
        flags: str,
        seconds: float,
    ) -> None:
        """Write tables, curves and ranks as one HTML document.

        Args:
            path: The file.
            shown: In this order.
            title: Of the page.
            about: Below it; plain text.
            flags: With which the table was made.
            seconds: That it took [s].
        """
        from gendom.evaluation.sheet import Curves, Sheet
        from gendom.viz.report import (
            Provenance,
            curves_section,
            provenance_section,
            ranks_section,
            render_page,
            table_section,
        )

        made = Provenance(
            commands=[f"gendom reproduce {self.table} {flags}"],
            version=version(),
            stage_seconds={"all of it": seconds},
        )
        sections = []
        for s in shown:
            if isinstance(s, Sheet):
                sections.append(table_section(s.title, s.head, s.rows))
            elif isinstance(s, Curves):
                sections.append(curves_section(s.title, s.x, s.y, s.lines, log=s.log))
            else:
                sections.append(ranks_section(s.title, s.counts, s.band, s.band_label))
        with atomic_path(path) as temporary:
            page = render_page(title, f"<p>{about}</p>", [*sections, provenance_section(made)])
            temporary.write_text(page, encoding="utf-8")
        tell_written(path, json=self.json)

    def _coverage(self) -> int:
        from gendom.evaluation.coverage import (
            calibration_of,
            coverage,
            coverage_sheets,
            coverage_text,
            covered,
        )

        check_folder(self._folder)
        began = time.monotonic()
        settings = self._lifts()
        with bar("lifting", self.lifts, "lift") as show:
            rows = coverage(self._folder, settings, on_done=show)
        table = covered(rows, settings.level)
        result = {"table": self.table, **asdict(settings), "unknowns": [asdict(c) for c in table]}
        print(to_json(result) if self.json else coverage_text(rows, table))
        name = self._folder / f"table-{self.kind}-{self.end}"
        write_json(name.with_suffix(".json"), {**result, "rows": rows})
        write_json(
            self._folder / f"calibration-{self.kind}-{self.end}.json",
            {self.kind: calibration_of(rows, table)},
        )
        self._write_page(
            name.with_suffix(".html"),
            coverage_sheets(rows, table),
            title=f"coverage, {self.kind}, {self.end}",
            about=RANKS,
            flags=self._lift_flags,
            seconds=time.monotonic() - began,
        )
        return 0

    def _lifts(self) -> CoverageSettings:
        """Of coverage and verdict."""
        from gendom.evaluation.coverage import CoverageSettings

        return CoverageSettings(
            kind=self.kind, end=self.end, lifts=self.lifts, seed=self.seed, jobs=self.jobs
        )

    @property
    def _lift_flags(self) -> str:
        return f"--kind {self.kind} --end {self.end} --lifts {self.lifts} --seed {self.seed}"

    def _verdict(self) -> int:
        from gendom.evaluation.spoiled import confusion, confusion_sheet, verdicts

        check_folder(self._folder)
        began = time.monotonic()
        settings = self._lifts()
        with bar("judging", self.lifts, "lift") as show:
            rows = verdicts(self._folder, settings, on_done=show)
        result = {"table": self.table, **asdict(settings), "cases": confusion(rows)}
        sheet = confusion_sheet(rows)
        print(to_json(result) if self.json else sheet)
        name = self._folder / f"table-verdict-{self.kind}-{self.end}"
        write_json(name.with_suffix(".json"), {**result, "rows": rows})
        self._write_page(
            name.with_suffix(".html"),
            [sheet],
            title=f"verdict, {self.kind}, {self.end}",
            about=VERDICT,
            flags=self._lift_flags,
            seconds=time.monotonic() - began,
        )
        return 0

    def _sim2sim(self) -> int:
        from gendom.estimation.sim2sim import rows_text, scene_settings, sim2sim
        from gendom.sim import open_device

        open_device(self.device)
        began = time.monotonic()
        settings = scene_settings(self.engine, device=self.device)
        truths, starts = SCALES[self.scale]
        wanted = [(m, f) for m, f in SIM2SIM if not self.method or m in self.method]
        wanted += [(m, "all") for m in self.method if m not in dict(SIM2SIM)]
        rows = []
        for method, frames in wanted:
            label = f"{method}, {frames} frames" if frames == "all" else f"{method}, last frame"
            with bar(label, truths * starts, "estimate") as show:
                rows.append(
                    sim2sim(
                        method,
                        truths=truths,
                        starts=starts,
                        frames=frames,
                        settings=settings,
                        seed=self.seed,
                        on_done=show,
                    )
                )
        result = {
            "table": self.table,
            "scale": self.scale,
            "engine": self.engine,
            "seed": self.seed,
            "rows": rows,
            "seconds": time.monotonic() - began,
        }
        if self.json:
            print(to_json(result))
        else:
            about = (
                f"{truths} objects, {starts} starts each, seed {self.seed}, engine {self.engine}"
            )
            print(f"sim2sim, mean absolute errors: {about}")
            print(rows_text(rows))
            print(f"took {result['seconds']:.3g} s")
        return 0
