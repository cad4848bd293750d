"""Explicit and implicit steps of rods: how long they take, and how far they are apart.

    python benchmarks/implicit.py

A rope on a table is lifted by one end, and swings, for 1.5 s, 50 frames. Distances are those from
explicit steps. Derivatives: a reverse pass, by everything. Medians of runs in turn, one core.
"""

import argparse
import statistics
import time
from typing import Any

import numpy as np

from gendom.materials import Material
from gendom.sim import Gripper, Rollout, Simulator, Table, rope

CASES = (
    ("soft rope", 1e6, 1000.0, 0.010, 0.004),
    ("stiff rope", 1e8, 1000.0, 0.004, 0.002),
    ("plastic rod", 2e9, 1200.0, 0.003, 0.001),
    ("steel wire", 2e11, 7800.0, 0.001, 0.0),
)
"""Name, E [Pa], density [kg/m^3], diameter [m], damping [s]."""

STEPS = (0.005, 0.002, 0.001)
"""Implicit ones [s]."""


def scene(case: tuple, **options: Any) -> Simulator:
    _, E, density, diameter, damping = case
    body = rope(diameter=diameter, length=0.3, start=(0, 0, diameter / 2.0), points=31)
    low = np.array([0.0, 0.0, diameter / 2.0])
    way = low + np.array([[0, 0, 0], [0, 0, 0.25], [0.1, 0, 0.25]])
    hand = Gripper(time=[0, 0.5, 0.8], position=way, radius=0.02)
    return Simulator(
        body, [Material(E=E, density=density, damping=damping)], grippers=[hand],
        table=Table(height=0.0), threads=1, **options,
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=5)
    given = parser.parse_args()
    frames = np.linspace(0.03, 1.5, 50)
    print("rope          steps        run [s]  with derivatives [s]  mean, most apart [mm]")
    for case in CASES:
        ways: list[dict[str, Any]] = [
            {},
            *({"integrator": "implicit", "substep": h} for h in STEPS),
        ]
        runs: list[list[float]] = [[] for _ in ways]
        both: list[list[float]] = [[] for _ in ways]
        shapes = []
        for turn in range(given.runs + 1):
            for k, options in enumerate(ways):
                began = time.perf_counter()
                s = scene(case, **options)
                x = s.run(frames)
                between = time.perf_counter()
                rollout = Rollout(scene(case, **options))
                rollout.backward(np.ones_like(rollout.forward(frames)))
                if turn == 0:  # compiles
                    shapes.append((x, float(s.substep[0])))
                else:
                    runs[k].append(between - began)
                    both[k].append(time.perf_counter() - between)
        for k, (x, substep) in enumerate(shapes):
            far = 1e3 * np.linalg.norm(x - shapes[0][0], axis=-1)
            apart = f"{far.mean():.3f}, {far.max():.2f}" if k else ""
            name = f"{'implicit' if k else 'explicit'} {1e6 * substep:.4g} us"
            print(
                f"{case[0]:<13} {name:<18} {statistics.median(runs[k]):8.4f} "
                f"{statistics.median(both[k]):9.4f}   {apart}",
                flush=True,
            )


if __name__ == "__main__":
    main()
