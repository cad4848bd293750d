"""What a derivative costs: forward and backward over a plain forward run, on one core.

One rope of ``gendom bench`` is carried for a while. Plain runs take turns with rollouts, which run
it twice; ratios are taken turn by turn.

    python benchmarks/gradient.py [--seconds 0.1] [--rounds 7] [--json]
"""

import argparse
import json
import statistics
import time
from typing import Any

import numpy as np

from gendom.materials import Material
from gendom.robot import TcpPaths
from gendom.sim import Rollout, Simulator, Solver
from gendom.tasks import RopeReaching
from gendom.tasks.world import Simulation, grippers


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=0.1, help="simulated time")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = [measured(dtype, args) for dtype in ("float32", "float64")]
    if args.json:
        print(json.dumps(rows, indent=2))
        return
    print(f"{'dtype':8} {'forward':>9} {'both':>9} {'cost':>6} {'range':>14}")
    for r in rows:
        print(
            f"{r['dtype']:8} {r['forward']:7.3f} s {r['both']:7.3f} s "
            f"{r['cost']:6.2f} {r['least']:6.2f} .. {r['most']:.2f}"
        )


def measured(dtype: str, args: argparse.Namespace) -> dict[str, Any]:
    """What plain runs and rollouts, in turns, take."""
    seconds: dict[str, list[float]] = {"plain": [], "both": []}
    for turn in range(args.rounds + 1):
        for name, run in (("plain", plain), ("both", both)):
            s = simulator(dtype)
            began = time.perf_counter()
            run(s, args)
            if turn > 0:  # the first one compiles
                seconds[name].append(time.perf_counter() - began)
    cost = np.divide(seconds["both"], seconds["plain"])
    return {
        "dtype": dtype, "forward": statistics.median(seconds["plain"]),
        "both": statistics.median(seconds["both"]), "cost": float(np.median(cost)),
        "least": float(cost.min()), "most": float(cost.max()),
    }  # fmt: skip


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


def both(s: Simulator, args: argparse.Namespace) -> None:
    rollout = Rollout(s)
    x = rollout.forward([args.seconds])
    rollout.backward(np.ones_like(x))


if __name__ == "__main__":
    main()
