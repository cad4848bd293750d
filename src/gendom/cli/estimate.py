"""`gendom estimate`: elastic parameters from one recorded lift."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from tqdm import tqdm

from gendom.datasets import Recording
from gendom.files import to_json, write_json

if TYPE_CHECKING:
    from gendom.estimation import EstimateSettings, Progress


@dataclass(frozen=True, kw_only=True)
class Command:
    """Estimate Young's modulus and Poisson's ratio from one recorded lift.

    Ctrl-C ends the search and keeps the best found so far.
    """

    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")]
    """A gendom-recording/1 file (.npz), or a folder of .ply files, gripper.csv, object.toml."""
    out: Path | None = None
    """Folder for estimate.json."""
    json: bool = False
    """Print the estimate as JSON."""
    method: Literal["gauss-newton"] = "gauss-newton"
    """How the search descends."""
    frames: Literal["all", "last"] = "all"
    """Frames whose densities are compared."""
    starts: int = 3
    """Random starts."""
    seed: int = 0
    """Seed of the starts."""
    level: float = 0.9
    """Probability that the intervals claim."""
    engine: Literal["mpm", "thin"] = "mpm"
    """Of the simulator; thin: a rope as a rod, a hundred times cheaper."""
    cells_across: float = 1.5
    """Grid cells across a rope's diameter (cloths alike): finer is slower."""
    clock: float | None = None
    """Recorded seconds for one simulated second; chosen where motion is quasi-static."""
    device: str = "cpu"
    """cpu, cuda or cuda:0 and so on."""

    def run(self) -> int:
        from gendom.estimation import estimate
        from gendom.sim import open_device

        open_device(self.device)
        recording = Recording.read(self.recording)
        settings = self.settings()
        with tqdm(total=100, desc="estimating", unit="%", leave=False, disable=None) as bar:
            result = estimate(recording, settings, on_progress=lambda p: _show(bar, p))
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
            write_json(self.out / "estimate.json", result.record)
        print(to_json(result.record) if self.json else estimate_text(result.record))
        return 0

    def settings(self) -> EstimateSettings:
        """The flags as the estimator takes them."""
        from gendom.estimation import EstimateSettings, ReplaySettings

        return EstimateSettings(
            starts=self.starts,
            frames=self.frames,
            seed=self.seed,
            level=self.level,
            replay=ReplaySettings(
                engine=self.engine,
                cells_across=self.cells_across,
                clock=self.clock,
                device=self.device,
            ),
        )


def _show(bar: tqdm, progress: Progress) -> None:
    bar.n = round(100 * progress.done)
    bar.set_postfix_str(
        f"{progress.stage} {progress.iteration}, E/density "
        f"{progress.best.specific_modulus:.4g} m^2/s^2, loss {progress.loss:.3g}"
    )
    bar.refresh()


def estimate_text(record: dict[str, Any]) -> str:
    """An estimate for people."""
    low, high = record["intervals"]["youngs_modulus"]
    nu_low, nu_high = record["intervals"]["poissons_ratio"]
    mu_low, mu_high = record["intervals"]["friction"]
    level = f"{record['intervals']['level']:.0%}"
    assumed = " (assumed: the mass is unknown)" if record["density_assumed"] else ""
    known = record["identifiable"]

    def remark(name: str) -> str:
        return "" if known[name] else "   not determined by this lift: mostly the prior"

    rows = [
        ("Young's modulus", f"{record['youngs_modulus']:.4g} Pa, {level} in [{low:.4g}, {high:.4g}]"
         + remark("youngs_modulus")),
        ("Poisson's ratio", f"{record['poissons_ratio']:.3f}, {level} in [{nu_low:.3f}, "
         f"{nu_high:.3f}]" + remark("poissons_ratio")),
        ("friction", f"{record['friction']:.2f}, {level} in [{mu_low:.2f}, {mu_high:.2f}]"
         + remark("friction")),
        ("density", f"{record['density']:.4g} kg/m^3{assumed}"),
        ("E / density", f"{record['specific_modulus']:.4g} m^2/s^2"),
    ]  # fmt: skip
    if record["bending_length"] is not None:
        rows.append(("bending length", f"{record['bending_length']:.4f} m"))
    rows += [
        (
            "Chamfer",
            f"last frame {1e3 * record['chamfer_last']:.1f} mm, mean "
            f"{1e3 * record['chamfer_mean']:.1f} mm; seen surface "
            f"{1e3 * record['chamfer_last_surface']:.1f} and "
            f"{1e3 * record['chamfer_mean_surface']:.1f} mm",
        ),
        (
            "search",
            f"{record['iterations']} evaluations, {record['seconds']:.1f} s, seed "
            f"{record['seed']}, {record['device']}"
            + (", interrupted: best so far" if record["interrupted"] else ""),
        ),
    ]
    lines = [f"{name:<16} {text}" for name, text in rows]
    return "\n".join(lines + [f"note: {note}" for note in record["notes"]])
