"""CPU time of steps under control beside a run of the same path, known before.

python benchmarks/steps.py [--worlds 1 8 64 256] [--rounds 5]
"""

import argparse
import time
from collections.abc import Callable

import numpy as np

from gendom.materials import Material
from gendom.sim import Gripper, Simulator, Table, Targets, rope

DT, STEPS = 0.005, 200
"""Of a lift of a second [s]."""

RISE = np.array([0.0, 0.0, 0.3])
"""[m]"""

BODY = rope(length=0.3, diameter=0.016)
ROPE = Material(E=1e6, nu=0.35, density=800.0, damping=0.005)


def main() -> None:
    """Print a row for each number of worlds: medians of rounds in turn."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, nargs="+", default=[1, 8, 64, 256])
    parser.add_argument("--rounds", type=int, default=5)
    flags = parser.parse_args()
    start = BODY.points[0]
    known = Gripper(time=[0.0, DT * STEPS], position=[start, start + RISE], radius=0.012)
    led = Gripper.still(start, radius=0.012)
    times = DT * np.arange(1, STEPS + 1)
    ends = [Targets(position=[start + RISE * t / times[-1]]) for t in times]

    def run(simulator: Simulator) -> None:
        simulator.run(times)

    def step(simulator: Simulator) -> None:
        for targets in ends:
            simulator.step(DT, targets)

    print("worlds  run [ms a step]  steps [ms a step]  ratio  world-steps/s of CPU time")
    for worlds in flags.worlds:
        spent = [
            (_seconds(worlds, known, run), _seconds(worlds, led, step))
            for _ in range(flags.rounds + 1)
        ][1:]  # the first one loads the kernels
        a, b = np.median(spent, axis=0) / STEPS
        ratio = np.median([second / first for first, second in spent])
        print(f"{worlds:6d} {1e3 * a:16.3f} {1e3 * b:18.3f} {ratio:6.2f} {worlds / b:12.0f}")


def _seconds(worlds: int, gripper: Gripper, work: Callable[[Simulator], None]) -> float:
    """CPU time of the work alone [s]."""
    table = Table(height=float(BODY.points[:, 2].min()) - BODY.contact_radius)
    simulator = Simulator(BODY, [ROPE] * worlds, grippers=[gripper], table=table)
    began = time.process_time()
    work(simulator)
    return time.process_time() - began


if __name__ == "__main__":
    main()
