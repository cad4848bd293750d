"""`gendom bench`: how fast the simulator runs on this machine.

A particle-step is one particle taken through one substep. Gripper paths, grid columns, boundary
handling and recording are included; compiling kernels is not.
"""

from __future__ import annotations

import logging
import math
import statistics
import time
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from gendom.arguments import require
from gendom.cli.arguments import Device, Json
from gendom.cli.outputs import columns
from gendom.files import to_json
from gendom.materials import Material
from gendom.robot import TcpPaths
from gendom.sim import Solver
from gendom.tasks import RopeReaching
from gendom.tasks.world import Simulation, grippers

RUNS = 5
"""Rollouts timed for each row."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Command:
    """Time rope-reaching rollouts: one row for each combination of the flags.

    Medians of several runs; kernels are compiled before the first is timed.

    For example: gendom bench --worlds 1 16 --threads 1 2
    """

    device: Device = "cpu"
    worlds: tuple[int, ...] = (1, 4)
    """Ropes simulated at once."""
    threads: tuple[int, ...] = (1, 2)
    """Worlds side by side on the CPU; rows with more threads than worlds are left out."""
    dtype: tuple[Literal["float32", "float64"], ...] = ("float32", "float64")
    """Scalar type."""
    seconds: float = 0.5
    """Simulated time [s]; in a short one the host's share of starting a run counts."""
    gradient: bool = False
    """Time forward and backward together too."""
    json: Json = False

    def run(self) -> int:
        positive = min((*self.worlds, *self.threads), default=0) >= 1 and self.seconds > 0.0
        require(positive, "worlds, threads and seconds must be positive", fix="give more")
        cuda = self.device.startswith("cuda")
        rows = []
        for dtype in self.dtype:
            for worlds in self.worlds:
                for threads in (1,) if cuda else self.threads:
                    if threads > worlds:
                        continue
                    log.info("%s, %d worlds, %d threads ...", dtype, worlds, threads)
                    rows.append(self._measure(dtype, worlds, threads))
        print(to_json(rows) if self.json else _table(rows))
        return 0

    def _measure(self, dtype: str, worlds: int, threads: int) -> dict[str, Any]:
        """Time rollouts of ropes that are carried to random points. Times are medians."""
        from gendom.sim import Rollout, Simulator  # Warp, which takes long to import

        task, world = RopeReaching(), Simulation(engine="mpm", cells_across=2.0)
        body, _ = world.body(task, task.item)
        scene = task.scene(task.item)
        material = Material(E=1.0e6, nu=0.3, density=1000.0)
        actions = task.sample_actions(task.item, np.random.default_rng(0), worlds)
        paths = TcpPaths([task.tool_path(task.item, a) for a in actions])
        hands = grippers(scene, paths, 0.0)

        def simulator() -> Simulator:
            return Simulator(
                body,
                [material] * worlds,
                grippers=hands,
                solver=Solver(engine="mpm", dtype=dtype, device=self.device, threads=threads),
            )

        forward: list[float] = []
        both: list[float] = []
        for _ in range(RUNS + 1):
            s = simulator()
            began = time.perf_counter()
            s.run([self.seconds])
            forward.append(time.perf_counter() - began)
            if self.gradient:
                rollout = Rollout(simulator())
                began = time.perf_counter()
                x = rollout.forward([self.seconds])
                rollout.backward(np.ones_like(x))
                both.append(time.perf_counter() - began)
        substeps = math.ceil(self.seconds / s.substep[0])
        median = statistics.median(forward[1:])
        rate = worlds * body.num_particles * substeps / median
        gradient_seconds = statistics.median(both[1:]) if self.gradient else None
        return {
            "device": str(s.device),
            "dtype": dtype,
            "worlds": worlds,
            "threads": s.engine.setting.threads,
            "particles": body.num_particles,
            "substeps": substeps,
            "seconds": median,
            "particle_steps_per_second": rate,
            "substep_us": 1e6 * median / substeps,
            "gradient_seconds": gradient_seconds,  # forward and backward together
            "gradient_cost": gradient_seconds / median if gradient_seconds else None,
        }


def _table(rows: list[dict[str, Any]]) -> str:
    heads = ("device", "dtype", "worlds", "threads", "particles")
    texts = [
        (
            *(str(row[name]) for name in heads),
            f"{row['particle_steps_per_second'] / 1e6:.2f}",
            f"{row['substep_us']:.1f}",
            "" if row["gradient_cost"] is None else f"{row['gradient_cost']:.2f} x",
        )
        for row in rows
    ]
    return columns((*heads, "M steps/s", "us/substep", "gradient"), texts)
