"""What a derivative costs: forward and backward over a plain forward run, on one core.

One rope of speed.py is carried for a while. Plain runs take turns with rollouts that keep
every substep and with rollouts that keep some and run the others once more; ratios are taken turn
by turn.

    python benchmarks/gradient.py [--seconds 0.1] [--rounds 7] [--json]
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from gendom.materials import Material
from gendom.robot import TcpPaths
from gendom.sim import Rollout, Simulator, Solver
from gendom.sim.rollout import MEMORY
from gendom.tasks import RopeReaching
from gendom.tasks.world import Simulation, grippers

MODES = {"every substep recorded": 1e9, "stretches repeated": float(MEMORY["cpu"])}
"""Bounds on what a rollout keeps [bytes]."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=0.1, help="simulated time")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = [row for dtype in ("float32", "float64") for row in measured(dtype, args)]
    if args.json:
        print(json.dumps(rows, indent=2))
        return
    print(f"{'dtype':8} {'mode':24} {'forward':>9} {'both':>9} {'cost':>6} {'range':>14}")
    for r in rows:
        print(
            f"{r['dtype']:8} {r['mode']:24} {r['forward']:7.3f} s {r['both']:7.3f} s "
            f"{r['cost']:6.2f} {r['least']:6.2f} .. {r['most']:.2f}"
        )


def measured(dtype: str, args: argparse.Namespace) -> list[dict[str, Any]]:
    """A row for each mode; all take turns."""
    seconds: dict[str, list[float]] = {"plain": [], **{mode: [] for mode in MODES}}
    for turn in range(args.rounds + 1):
        runs: dict[str, Callable[[Simulator], None]] = {"plain": lambda s: plain(s, args)}
        for mode, memory in MODES.items():
            runs[mode] = lambda s, memory=memory: both(s, memory, args)
        for name, run in runs.items():
            s = simulator(dtype)
            began = time.perf_counter()
            run(s)
            if turn > 0:  # the first one compiles
                seconds[name].append(time.perf_counter() - began)
    rows = []
    for mode in MODES:
        cost = np.divide(seconds[mode], seconds["plain"])
        rows.append({
            "dtype": dtype, "mode": mode, "forward": statistics.median(seconds["plain"]),
            "both": statistics.median(seconds[mode]), "cost": float(np.median(cost)),
            "least": float(cost.min()), "most": float(cost.max()),
        })  # fmt: skip
    return rows


def simulator(dtype: str) -> Simulator:
    task = RopeReaching()
    action = task.sample_actions(task.item, np.random.default_rng(0), 1)[0]
    path = task.tool_path(task.item, action)
    body, _ = Simulation(engine="mpm", cells_across=2.0).body(task, task.item)
    material = Material(E=1.0e6, nu=0.3, density=1000.0)
    return Simulator(
        body,
        [material],
        grippers=grippers(task.scene(task.item), TcpPaths([path]), 0.0),
        solver=Solver(engine="mpm", dtype=dtype, threads=1),
    )


def plain(s: Simulator, args: argparse.Namespace) -> None:
    s.run([args.seconds])


def both(s: Simulator, memory: float, args: argparse.Namespace) -> None:
    rollout = Rollout(s, memory=memory)
    x = rollout.forward([args.seconds])
    rollout.backward(np.ones_like(x))


if __name__ == "__main__":
    main()
