"""Goals of the three ropes of the MuJoCo test scene, by the arm: misses by the way to act.

    python benchmarks/goals.py rope-casting [--goals 24] [--jobs 16] [--json]

Parameters are estimated from one lift of each rope, those of `gendom demo`, and policies are the
shipped ones. The truth draws goals that a rope can reach and scores what the arm reached. Prints
mean, median and worst miss [mm] of each way, and how often the arm failed.
"""

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from importlib import resources
from multiprocessing import get_context

import numpy as np

from gendom.cli.demo import LIFTS, VARIANTS, carry_out
from gendom.datasets import Recording
from gendom.errors import GendomError
from gendom.estimation import EstimateSettings, estimate
from gendom.materials.estimate import Estimate
from gendom.policies import Policy
from gendom.policies.belief import believed
from gendom.progress import bar
from gendom.reality import find_object
from gendom.tasks.cases import draw_cases


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("task", choices=("rope-reaching", "rope-casting"))
    parser.add_argument("--goals", type=int, default=24, help="of each rope")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    with ProcessPoolExecutor(given.jobs, get_context("spawn")) as pool:
        found = dict(zip(LIFTS, pool.map(estimated, LIFTS), strict=True))
        work = [
            (given.task, name, found[name], goal)
            for name in LIFTS
            for goal in drawn(given.task, name, given.goals, given.seed)
        ]
        rows = []
        with bar(given.task, len(work), "goal") as show:
            for row in pool.map(missed, work):
                rows.append(row)
                show(len(rows))
    misses = {way: [row[way] for row in rows if row] for way in VARIANTS}
    if given.json:
        print(json.dumps({"goals": len(work), "misses": misses}))
        return
    for way, own in misses.items():
        e = 1e3 * np.array(own)
        figures = f"{e.mean():6.2f} {np.median(e):6.2f} {e.max():6.2f}"
        print(f"{way:<24} {figures} mm, {len(work) - len(own)} failed")


def estimated(name: str) -> Estimate:
    """Of the shipped lift of a rope."""
    with resources.as_file(resources.files("gendom") / "assets" / f"{LIFTS[name]}.npz") as path:
        return estimate(Recording.read(path), EstimateSettings(starts=3, seed=0))


def drawn(task: str, name: str, count: int, seed: int) -> np.ndarray:
    """[count, G] goals that a rope can reach."""
    shipped = Policy.pretrained(task).task()
    return draw_cases(shipped, count, seed=seed, items=[find_object(name)]).goal


def missed(work: tuple[str, str, Estimate, np.ndarray]) -> dict[str, float]:
    """[m] by the way to act; empty where the arm cannot."""
    task, name, found, goal = work
    policies = [Policy.pretrained(task, parameters=sees) for sees in (True, False)]
    belief = believed(found, policies[0].task())
    try:
        runs = carry_out(find_object(name), policies, goal, belief)
    except GendomError:
        return {}
    return {way: float(np.linalg.norm(run.reached - goal)) for way, run in runs.items()}


if __name__ == "__main__":
    main()
