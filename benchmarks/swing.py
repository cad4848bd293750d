"""Energy that an undamped sheet gains: one that is let go level from a held side, in vacuum.

    python benchmarks/swing.py

The table: how much the mean energy of an eighth of the time is above that of the first at most,
over the largest change of gravitational energy, by share of the longest stable step and damping.
"""

import argparse

import numpy as np

from gendom.materials import Material
from gendom.sim import Gripper, Physics, Simulator, Solver, cloth
from validation.readings import energies

PULL = np.array([0.0, 0.0, -9.81])
CASES = ((0.8, 0.0), (0.6, 0.0), (0.4, 0.0), (0.2, 0.0), (0.8, 1e-5))
"""Shares of the longest stable step, and damping [s]."""


def gained(cfl: float, damping: float, time: float) -> float:
    sheet = Simulator(
        cloth(width=0.2, height=0.1, thickness=0.002, dx=0.02, points=(15, 8)),
        [Material(E=1.0e5, density=500.0, damping=damping)],
        grippers=[Gripper.still((-100.0, 0.0, 0.0), radius=100.01)],
        physics=Physics(gravity=PULL, air_density=0.0),
        solver=Solver(engine="thin", cfl=cfl),
    )
    total, high = energies(sheet, np.linspace(0.0, time, 401)[1:], PULL)
    means = total.reshape(8, -1).mean(axis=1)
    return float((means - means[0]).max() / np.ptp(high))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--time", type=float, default=20.0, help="[s]")
    given = parser.parse_args()
    print(" cfl   damping   gained")
    for cfl, damping in CASES:
        found = gained(cfl, damping, given.time)
        print(f"{cfl:4.1f}{1e3 * damping:7.2f} ms{found:9.3f}", flush=True)


if __name__ == "__main__":
    main()
