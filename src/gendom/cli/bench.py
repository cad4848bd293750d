"""`gendom bench`: how fast the simulator runs on this machine."""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass
from typing import Literal

from gendom.cli.speed import Speed, measure_speed
from gendom.errors import ParameterError
from gendom.files import to_json

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Command:
    """Time rope-reaching rollouts: one row for each combination of the flags.

    Medians of several runs; kernels are compiled before the first is timed.

    For example: gendom bench --worlds 1 16 --threads 1 2
    """

    device: str = "cpu"
    """cpu, cuda or cuda:N."""
    worlds: tuple[int, ...] = (1, 4)
    """Ropes simulated at once."""
    threads: tuple[int, ...] = (1, 2)
    """Worlds side by side on the CPU; rows with more threads than worlds are left out."""
    dtype: tuple[Literal["float32", "float64"], ...] = ("float32", "float64")
    """Scalar type."""
    seconds: float = 0.5
    """Simulated time [s]; in a short one the host's share of starting a run counts."""
    runs: int = 5
    """Rollouts timed for each row."""
    seed: int = 0
    """Seed of the points that the ropes are carried to."""
    gradient: bool = False
    """Time forward and backward together too."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        if min((*self.worlds, *self.threads, self.runs), default=0) < 1 or self.seconds <= 0.0:
            raise ParameterError("worlds, threads, runs and seconds must be positive")
        cuda = self.device.startswith("cuda")
        rows: list[Speed] = []
        for dtype in self.dtype:
            for worlds in self.worlds:
                for threads in (1,) if cuda else self.threads:
                    if threads > worlds:
                        continue
                    log.info("%s, %d worlds, %d threads ...", dtype, worlds, threads)
                    rows.append(
                        measure_speed(
                            device=self.device,
                            dtype=dtype,
                            worlds=worlds,
                            threads=threads,
                            seconds=self.seconds,
                            runs=self.runs,
                            gradient=self.gradient,
                            seed=self.seed,
                        )
                    )
        print(to_json([asdict(row) for row in rows]) if self.json else _table(rows))
        return 0


def _table(rows: list[Speed]) -> str:
    lines = [
        f"{'device':8} {'dtype':8} {'worlds':>6} {'threads':>7} {'particles':>9} "
        f"{'M steps/s':>9} {'us/substep':>10} {'gradient':>9} {'roofline':>8}"
    ]
    for r in rows:
        cost = "" if r.gradient_cost is None else f"{r.gradient_cost:.2f} x"
        share = "" if r.roofline_share is None else f"{r.roofline_share:.1%}"
        lines.append(
            f"{r.device:8} {r.dtype:8} {r.worlds:6} {r.threads:7} {r.particles:9} "
            f"{r.particle_steps_per_second / 1e6:9.2f} {r.substep_us:10.1f} {cost:>9} {share:>8}"
        )
    return "\n".join(lines)
