"""Which task needs which parameter, and what the tasks look like in both worlds.

    python benchmarks/tasks.py                          # a table
    python benchmarks/tasks.py --picture tasks.png      # soft and stiff objects, ours and MuJoCo

The table: how far an outcome moves when one parameter goes from the lowest to the highest value
that is drawn, others at the middle, in shares of the object's size: median over drawn actions.
Actions that are at risk with either are left out (see `RopeReaching`).
"""

import argparse
import time
from dataclasses import replace

import numpy as np

from gendom.materials import Item
from gendom.reality import RealWorld
from gendom.tasks import ClothSpreading, RopeCasting, RopeReaching, Task
from gendom.tasks.cloth_spreading import lattice_triangles
from gendom.tasks.task import DRAWN
from gendom.tasks.world import Simulation


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--actions", type=int, default=60)
    parser.add_argument("--cloth-actions", type=int, default=6)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--picture", help="PNG to write, in place of the table")
    given = parser.parse_args()
    if given.picture:
        draw(given.picture)
        return
    print("task             " + "".join(f"{name:>12}" for name in DRAWN))
    for task in (RopeReaching(), RopeCasting(), ClothSpreading()):
        count = given.cloth_actions if task.kind == "cloth" else given.actions
        began = time.perf_counter()
        moved = [spread_of(task, name, count, given) for name in DRAWN]
        texts = "".join(f"{m:12.4f}" if m is not None else f"{'-':>12}" for m in moved)
        print(f"{task.name:<17}{texts}   {time.perf_counter() - began:.0f} s", flush=True)


def spread_of(task: Task, name: str, count: int, given: argparse.Namespace) -> float | None:
    """Median way of an outcome over a parameter's range [sizes]; None: it is not drawn."""
    if name not in task.ranges:
        return None
    rng = np.random.default_rng(given.seed)
    actions = task.sample_actions(task.item, rng, count)
    ends = [item_with(task, {name: end}) for end in task.ranges[name]]
    world = Simulation(device=given.device)
    low, high = (world.carry_out(task, [item] * count, actions) for item in ends)
    ways = []
    for a, b in zip(low, high, strict=True):
        if a.fault or b.fault:
            continue
        both = zip(ends, (a, b), strict=True)
        if task.goals and not all(task.within_risk(i, o.values) for i, o in both):
            continue
        if task.goals:
            units = task.goal_units(task.item)
            x, y = (np.array([o.values[q.name] for q in task.goals]) / units for o in (a, b))
            ways.append(float(np.linalg.norm(x - y)))
        else:
            ways.append(abs(a.values["share"] - b.values["share"]))
    return float(np.median(ways)) if ways else float("nan")


def item_with(task: Task, values: dict[str, float]) -> Item:
    """The task's object with some parameters, others at the middle of their ranges."""

    def middle(name: str) -> tuple[float, float]:
        low, high = task.ranges[name]
        at = (low * high) ** 0.5 if DRAWN[name].log else 0.5 * (low + high)
        return values.get(name, at), values.get(name, at)

    fixed = replace(task, ranges={name: middle(name) for name in task.ranges})
    return fixed.draw_items([np.random.default_rng(0)])[0]


def draw(path: str) -> None:
    """Four columns: soft and stiff in our simulator, soft and stiff in MuJoCo under a free hand."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    rows = [
        (RopeReaching(bow=0.0), [0.12, 0.11], (300.0, 3000.0)),
        (RopeCasting(), [0.2], (300.0, 3000.0)),
        (ClothSpreading(), [0.15], (500.0, 3000.0)),
    ]
    figure, axes = plt.subplots(3, 4, figsize=(13, 9.5))
    for (task, action, moduli), line in zip(rows, axes, strict=True):
        for k, axis in enumerate(line):
            E = moduli[k % 2]
            world = Simulation(everything=True) if k < 2 else RealWorld(robot=False)
            item = item_with(task, {"E_over_rho": E})
            outcome = world.carry_out(task, [item], [action], keep=True)[0]
            where = "ours" if k < 2 else "MuJoCo"
            axis.set_title(f"{task.name}, {where}, E / density {E:g}", fontsize=9)
            axis.set_aspect("equal")
            axis.tick_params(labelsize=7)
            seen = outcome.seen
            if seen is None:
                axis.text(0.1, 0.5, str(outcome.fault), transform=axis.transAxes, fontsize=7)
                continue
            if task.kind == "rope":
                moving = np.flatnonzero(seen.times >= 0.0)
                for i in moving[:: max(1, len(moving) // 14)]:
                    shade = 0.85 - 0.75 * (i - moving[0]) / len(moving)
                    axis.plot(*seen.points[i][:, [0, 2]].T, color=str(shade), lw=1.2)
                axis.plot(*seen.tip[moving][:, [0, 2]].T, color="tab:orange", lw=0.8)
            else:
                x, triangles = seen.points[-1], lattice_triangles(*seen.lattice)
                upwards = triangles[np.argsort(x[triangles, 2].mean(axis=1))]  # what lies above
                axis.tripcolor(*x[:, :2].T, upwards, x[:, 2], vmin=0.0, vmax=0.04)
            text = ", ".join(f"{n} {v:.3f}" for n, v in list(outcome.values.items())[:2])
            axis.text(0.02, 0.02, text, transform=axis.transAxes, fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=75)
    print(path)


if __name__ == "__main__":
    main()
