"""Forward speed of the simulator on the rope-reaching workload, as JSON.

Each row is the median of several runs of whole rollouts: gripper paths, grid columns, boundary
handling and recording included, kernel compilation excluded.

    python benchmarks/forward.py [--device cpu] [--worlds 1 4] [--runs 3]
"""

import argparse
import json
import statistics
import time

import numpy as np

from gendom.materials import Material
from gendom.sim import Simulator
from gendom.tasks import RopeReaching


def measure(device: str, dtype: str, worlds: int, threads: int, runs: int, seconds: float) -> dict:
    """One row: ``worlds`` ropes for ``seconds`` of simulated time on ``threads`` threads."""
    task = RopeReaching(cells_across=2.0)
    body = task.body()
    material = Material(E=1.0e6, nu=0.3, density=1000.0)
    actions = task.sample_actions(np.random.default_rng(0), worlds)
    taken = []
    for _ in range(runs + 1):  # the first compiles
        simulator = Simulator(
            body,
            [material] * worlds,
            grippers=[task.grippers(a) for a in actions],
            dtype=dtype,
            device=device,
            threads=threads,
        )
        began = time.perf_counter()
        simulator.run([seconds])
        taken.append(time.perf_counter() - began)
    substeps = int(np.ceil(seconds / simulator.substep[0]))
    median = statistics.median(taken[1:])
    return {
        "device": device,
        "dtype": dtype,
        "worlds": worlds,
        "threads": threads,
        "particles": body.num_particles,
        "substeps": substeps,
        "seconds": median,
        "particle_steps_per_second": worlds * body.num_particles * substeps / median,
        "substep_us": 1e6 * median / substeps,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--worlds", type=int, nargs="+", default=[1, 4])
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--dtype", nargs="+", default=["float32", "float64"])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=0.1)
    args = parser.parse_args()
    rows = [
        measure(args.device, dtype, worlds, threads, args.runs, args.seconds)
        for dtype in args.dtype
        for worlds in args.worlds
        for threads in args.threads
        if threads <= worlds
    ]
    print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
