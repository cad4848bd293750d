"""What a derivative costs: forward and backward over a plain forward run, on one core.

One rope of ``gendom bench`` is carried for a while. Plain runs take turns with rollouts that keep
every substep and with rollouts that keep some and run the others once more; ratios are taken turn
by turn.

    python benchmarks/gradient.py [--seconds 0.1] [--rounds 7]
"""

import argparse
import statistics
import time
from collections.abc import Callable

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
    args = parser.parse_args()
    print(f"{'dtype':8} {'mode':24} {'forward':>9} {'both':>9} {'cost':>6} {'range':>14}")
    for dtype in ("float32", "float64"):
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
        for mode in MODES:
            cost = np.divide(seconds[mode], seconds["plain"])
            forward, total = statistics.median(seconds["plain"]), statistics.median(seconds[mode])
            print(
                f"{dtype:8} {mode:24} {forward:7.3f} s {total:7.3f} s {np.median(cost):6.2f} "
                f"{cost.min():6.2f} .. {cost.max():.2f}"
            )


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
