"""Time and memory of a substep against particles (one world) and against worlds, as JSON and SVG.

One world is a solid block that falls on a table; many worlds are the ropes of ``gendom bench``.

    python benchmarks/scaling.py [--device cuda] --out scaling
"""

import argparse
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from gendom.materials import Material
from gendom.robot import TcpPaths
from gendom.sim import Body, Simulator, Solver, Table, cloth
from gendom.tasks import RopeReaching
from gendom.tasks.world import Simulation, grippers

MATERIAL = Material(E=1.0e6, nu=0.3, density=1000.0)
DX = 0.005


def block(particles: int) -> Body:
    """A cube of about so many particles."""
    side = DX * max(1.0, round((particles / 8.0) ** (1.0 / 3.0)))
    return cloth(width=side, height=side, thickness=side, dx=DX, corner=(0.0, 0.0, side / 2 + DX))


def measure(simulator: Simulator, substeps: int, before: float) -> dict[str, Any]:
    """Wall time of a substep after a first frame, and memory in use [bytes]."""
    dt = float(simulator.substep.min())
    simulator.run([10 * dt], particles=[0])
    began = time.perf_counter()
    simulator.run([(10 + substeps) * dt], particles=[0])
    taken = time.perf_counter() - began
    total = simulator.num_worlds * simulator.body.num_particles
    row = {
        "worlds": simulator.num_worlds,
        "particles": simulator.body.num_particles,
        "seconds_a_substep": taken / substeps,
        "particle_steps_per_second": total * substeps / taken,
        "bytes": memory(simulator.device) - before,
    }
    print(json.dumps(row), flush=True)
    return row


def memory(device: Any) -> float:
    """Bytes that arrays take on a GPU; not counted on the CPU."""
    return float(wp.get_mempool_used_mem_current(device)) if device.is_cuda else math.nan


def by_particles(device: str, most: int, substeps: int) -> list[dict[str, Any]]:
    rows = []
    for exponent in np.arange(3.0, math.log10(most) + 0.01, 0.5):
        body = block(round(10.0**exponent))
        before = memory(wp.get_device(device))
        table = Table(height=0.0)
        simulator = Simulator(
            body, [MATERIAL], table=table, solver=Solver(engine="mpm", device=device, threads=1)
        )
        rows.append(measure(simulator, substeps, before))
        del simulator
    return rows


def by_worlds(device: str, most: int, substeps: int) -> list[dict[str, Any]]:
    task = RopeReaching()
    body, _ = Simulation(engine="mpm", cells_across=2.0).body(task, task.item)
    scene = task.scene(task.item)
    rows = []
    for worlds in 4 ** np.arange(0, int(math.log(most, 4)) + 1):
        actions = task.sample_actions(task.item, np.random.default_rng(0), int(worlds))
        paths = TcpPaths([task.tool_path(task.item, a) for a in actions])
        hands = grippers(scene, paths, 0.0)
        before = memory(wp.get_device(device))
        simulator = Simulator(
            body,
            [MATERIAL] * int(worlds),
            grippers=hands,
            solver=Solver(engine="mpm", device=device),
        )
        rows.append(measure(simulator, substeps, before))
        del simulator
    return rows


def draw(rows: dict[str, list[dict[str, Any]]], out: Path) -> None:
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 4))
    for axis, (name, table) in zip(axes, rows.items(), strict=True):
        x = np.array([row[name] for row in table])
        seconds = np.array([row["seconds_a_substep"] for row in table])
        axis.loglog(x, 1e6 * seconds, "o-", color="#0b6e99", label="time of a substep [us]")
        axis.loglog(x, 1e6 * seconds[-1] * x / x[-1], ":", color="#777777", label="linear")
        used = np.array([row["bytes"] for row in table])
        if np.isfinite(used).all():
            axis.loglog(x, used / 2**20, "s--", color="#d9730d", label="memory [MiB]")
        axis.set_xlabel(
            f"{name} ({'one world' if name == 'particles' else 'ropes of 852 particles'})"
        )
        axis.grid(alpha=0.3)
        axis.legend()
    figure.tight_layout()
    figure.savefig(out.with_suffix(".svg"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--out", type=Path, required=True, help="without suffix")
    parser.add_argument("--most-particles", type=int, default=10_000_000)
    parser.add_argument("--most-worlds", type=int, default=16_384)
    parser.add_argument("--substeps", type=int, default=64)
    parser.add_argument("--draw", action="store_true", help="only draw what OUT.json holds")
    args = parser.parse_args()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    if args.draw:
        rows = json.loads(args.out.with_suffix(".json").read_text())
    else:
        rows = {
            "particles": by_particles(args.device, args.most_particles, args.substeps),
            "worlds": by_worlds(args.device, args.most_worlds, args.substeps),
        }
        args.out.with_suffix(".json").write_text(json.dumps(rows, indent=1))
    draw(rows, args.out)


if __name__ == "__main__":
    main()
