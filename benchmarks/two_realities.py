"""GenDOM's simulator beside MuJoCo (the second reality): the same motions of the same objects.

For each rope some releases of rope reaching and some casts, for each cloth some spreadings, with
the parameters that the object has there: E, nu, density, damping, friction and air. Both worlds are
told the same task and judge what they see by the same rule (`gendom.tasks`).

    python benchmarks/two_realities.py [--objects rope-cotton] [--tasks rope-casting]
        [--engine mpm] [--arm] [--actions 5] [--step 0.001] [--json]

A grip holds a length of the rope, rigid with the gripper. MuJoCo's rods bend at their vertices,
each for half an edge on either side, the last pinned one too: as a beam, its rope is free from half
an edge before it on. It pins a rope's first two vertices here, so it holds half an edge, 0.0294 of
the length; tasks hold 0.03. Actions are drawn from all that a task allows. A free hand moves
sideways by nothing at all, so a perfectly straight rope stays in its plane in both worlds; under
the arm (`--arm`) a release after which our rope falls out of it (see `RopeReaching`) is counted on
its own: what it reaches depends on the smallest disturbance.
"""

import argparse
import json
import time
from dataclasses import replace
from typing import Any

import numpy as np

from gendom.reality import OBJECTS, RealWorld
from gendom.sim import ENGINES
from gendom.tasks import RopeReaching, find_task, task_names
from gendom.tasks.world import Simulation


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--objects", nargs="+", choices=list(OBJECTS), metavar="NAME")
    parser.add_argument(
        "--tasks", nargs="+", choices=task_names(), default=["rope-reaching", "rope-casting"]
    )
    parser.add_argument("--actions", type=int, default=5, help="for each object")
    parser.add_argument("--engine", choices=ENGINES, default="thin", help="of our simulator")
    parser.add_argument("--cells-across", type=float, default=1.5, help="of the MPM's grid")
    parser.add_argument("--device", default="cpu", help="of our simulator")
    parser.add_argument("--arm", action="store_true", help="the arm acts, not a free hand")
    parser.add_argument("--step", type=float, help="MuJoCo's [s]; by default 0.25 ms for ropes")
    parser.add_argument("--seed", type=int, default=0, help="of the actions")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    rows = [row for name in given.tasks for row in compare(name, given)]
    if given.json:
        print(json.dumps(rows, indent=2))
    else:
        show(rows)


def compare(name: str, given: argparse.Namespace) -> list[dict[str, Any]]:
    """One row for each object and action of a task."""
    kind = find_task(name)
    # a free hand moves sideways by nothing: a perfectly straight rope stays in its plane
    task = kind()
    if isinstance(task, RopeReaching) and not given.arm:
        task = replace(task, bow=0.0)
    ours = Simulation(engine=given.engine, device=given.device, cells_across=given.cells_across)
    theirs = RealWorld(robot=given.arm, timestep=given.step)
    rows = []
    for k, item in enumerate(OBJECTS.values()):
        if item.kind != task.kind or (given.objects and item.name not in given.objects):
            continue
        rng = np.random.default_rng([given.seed, k])
        actions = task.sample_actions(item, rng, given.actions)
        began = time.perf_counter()
        here = ours.carry_out(task, [item] * len(actions), actions)
        between = time.perf_counter()
        there = theirs.carry_out(task, [item] * len(actions), actions)
        seconds = between - began, time.perf_counter() - between
        compared = [q.name for q in task.goals] or list(here[0].values)[:2]
        for action, a, b in zip(actions, here, there, strict=True):
            rows.append(
                {
                    "task": name,
                    "object": item.name,
                    "action": action.tolist(),
                    "ours": {n: a.values.get(n) for n in compared},
                    "mujoco": {n: b.values.get(n) for n in compared},
                    "steady": a.fault is None and task.within_risk(item, a.values),
                    "faults": [a.fault, b.fault],
                    "seconds": [s / len(actions) for s in seconds],
                }
            )
    return rows


def distance(row: dict[str, Any]) -> float:
    """Between both outcomes; not a number where one failed."""
    if any(row["faults"]):
        return float("nan")
    return float(np.linalg.norm([row["ours"][n] - row["mujoco"][n] for n in row["ours"]]))


def show(rows: list[dict[str, Any]]) -> None:
    """What both worlds reached, and what is between them [mm, or thousandths]."""
    for task in dict.fromkeys(row["task"] for row in rows):
        mine = [row for row in rows if row["task"] == task]
        print(f"{task}\n  object, action, ours, MuJoCo, between them / 1e-3")
        for row in mine:
            texts = [
                ", ".join(f"{v:.4f}" if v is not None else "-" for v in values)
                for values in (row["action"], row["ours"].values(), row["mujoco"].values())
            ]
            note = "" if row["steady"] else "   falls out of its plane, or failed"
            print(
                f"  {row['object']:<20} {'  |  '.join(texts)}  |  {1e3 * distance(row):.1f}{note}"
            )
        gaps = 1e3 * np.array([distance(row) for row in mine if row["steady"]])
        gaps = gaps[np.isfinite(gaps)]
        ours, theirs = np.mean([row["seconds"] for row in mine], axis=0)
        if len(gaps):
            print(
                f"  {len(gaps)} of {len(mine)}: mean {gaps.mean():.1f}, median "
                f"{np.median(gaps):.1f}, worst {gaps.max():.1f} / 1e-3; seconds each: ours "
                f"{ours:.2f}, MuJoCo {theirs:.1f}\n"
            )


if __name__ == "__main__":
    main()
