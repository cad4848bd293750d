"""`gendom bench`: how fast the simulator runs on this machine.

A point-step is one point of a rod, or one particle of the MPM, taken through one substep. Gripper
paths, contact and recording are included; compiling kernels is not.
"""

import itertools
import logging
import math
import time
from collections.abc import Callable
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
    """Time rope-reaching rollouts: one row for each combination of the flags, the default engine
    first.

    Medians of several runs; kernels are compiled before the first is timed.

    For example: gendom bench --worlds 1 16 --threads 1 2
    """

    device: Device = "cpu"
    engine: tuple[Literal["thin", "mpm"], ...] = ("thin", "mpm")
    """thin: ropes as rods. mpm: material points."""
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
        every = (1,) if self.device.startswith("cuda") else self.threads
        rows = []
        for flags in itertools.product(self.engine, self.dtype, self.worlds, every):
            if flags[3] <= flags[2]:
                log.info("%s, %s, %d worlds, %d threads ...", *flags)
                rows.append(self._measure(*flags))
        print(to_json(rows) if self.json else _table(rows))
        return 0

    def _measure(
        self, engine: Literal["thin", "mpm"], dtype: str, worlds: int, threads: int
    ) -> dict[str, Any]:
        """Time rollouts of ropes that are carried to random points."""
        from gendom.sim import Rollout, Simulator  # Warp, which takes long to import

        task = RopeReaching()
        body, _ = Simulation(engine=engine, cells_across=2.0).body(task, task.item)
        N = body.num_particles if engine == "mpm" else len(body.points)
        actions = task.sample_actions(task.item, np.random.default_rng(0), worlds)
        paths = TcpPaths([task.tool_path(task.item, a) for a in actions])
        hands = grippers(task.scene(task.item), paths, 0.0)
        materials = [Material(E=1.0e6, nu=0.3, density=1000.0)] * worlds
        solver = Solver(engine=engine, dtype=dtype, device=self.device, threads=threads)

        def simulator() -> Simulator:
            return Simulator(body, materials, grippers=hands, solver=solver)

        def there_and_back(rollout: Rollout) -> None:
            rollout.backward(np.ones_like(rollout.forward([self.seconds])))

        s = simulator()
        median = _median(simulator, lambda s: s.run([self.seconds]))
        both = _median(lambda: Rollout(simulator()), there_and_back) if self.gradient else None
        substeps = math.ceil(self.seconds / s.substep[0])
        return {
            "engine": engine,
            "device": str(s.device),
            "dtype": dtype,
            "worlds": worlds,
            "threads": s.engine.setting.threads,
            "points": N,
            "substeps": substeps,
            "seconds": median,
            "point_steps_per_second": worlds * N * substeps / median,
            "substep_us": 1e6 * median / substeps,
            "gradient_seconds": both,  # forward and backward together
            "gradient_cost": both and both / median,
        }


def _median(make: Callable[[], Any], work: Callable[[Any], Any]) -> float:
    """Seconds of a work with what is made for it, after a first one that compiles."""
    seconds = []
    for _ in range(RUNS + 1):
        made = make()
        began = time.perf_counter()
        work(made)
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds[1:]))


def _table(rows: list[dict[str, Any]]) -> str:
    heads = ("engine", "device", "dtype", "worlds", "threads", "points")
    texts = []
    for row in rows:
        cost = f"{row['gradient_cost']:.2f} x" if row["gradient_cost"] else ""
        speed, step = f"{row['point_steps_per_second'] / 1e6:.2f}", f"{row['substep_us']:.1f}"
        texts.append((*(str(row[name]) for name in heads), speed, step, cost))
    return columns((*heads, "M steps/s", "us/substep", "gradient"), texts)
