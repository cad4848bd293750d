"""`gendom reproduce`: the paper's tables, measured here."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import tyro

from gendom.files import check_folder, to_json, write_json
from gendom.progress import bar

SCALES = {"small": (2, 1), "full": (5, 5)}
"""Objects, and starts of each, by scale of the table sim2sim."""

SIM2SIM = (
    ("gauss-newton", "all"),
    ("gauss-newton", "last"),
    ("adam", "all"),
    ("adam", "last"),
    ("pointnet", "last"),
)
"""Its rows: methods, and the frames that they see."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """Measure one of the paper's tables with this package, beside the paper's own numbers; or
    whether intervals hold.

    sim2sim: errors of estimators on lifts that the simulator has made, with exact clouds.
    coverage: random objects of the second reality are lifted before its cameras and estimated; how
    far off estimates are, how many intervals hold the truth, which lifts are refused. A lift takes
    about a minute on a core; what is in --out is not made again.

    For example: gendom reproduce sim2sim --method gauss-newton
    """

    table: tyro.conf.Positional[Literal["sim2sim", "coverage"]]
    """Which table."""
    scale: Literal["small", "full"] = "small"
    """small: a few minutes; full: as many objects and starts as the paper has."""
    method: tuple[Literal["gauss-newton", "adam", "differential-evolution", "pointnet"], ...] = ()
    """Of sim2sim: only rows of these methods; by default all but differential-evolution."""
    engine: Literal["thin", "mpm"] = "thin"
    """Of sim2sim: makes the lifts, and replays them. mpm: the paper's, slower."""
    kind: Literal["rope", "cloth"] = "rope"
    """Of coverage: what is lifted."""
    end: Literal["hold", "swing", "drop"] = "hold"
    """Of coverage: how lifts end."""
    lifts: int = 40
    """Of coverage: how many."""
    jobs: int = 2
    """Of coverage: processes."""
    out: Path = Path("coverage")
    """Of coverage: folder that keeps lifts and estimates."""
    seed: int = 0
    """Seed of everything that is drawn."""
    device: str = "cpu"
    """cpu, cuda or cuda:0 and so on."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        return self._coverage() if self.table == "coverage" else self._sim2sim()

    def _coverage(self) -> int:
        from gendom.evaluation.coverage import CoverageSettings, coverage, coverage_text, covered

        check_folder(self.out)
        settings = CoverageSettings(
            kind=self.kind, end=self.end, lifts=self.lifts, seed=self.seed, jobs=self.jobs
        )
        with bar("lifting", self.lifts, "lift") as show:
            rows = coverage(self.out, settings, on_done=show)
        table = covered(rows, settings.level)
        result = {"table": self.table, **asdict(settings), "unknowns": [asdict(c) for c in table]}
        print(to_json(result) if self.json else coverage_text(rows, table))
        write_json(self.out / f"table-{self.kind}-{self.end}.json", {**result, "rows": rows})
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
