"""Cloths that are spread, by quarters of their bending length: policies beside the best constant.

    python benchmarks/spreading.py --task cloth-spreading --device cuda
    python benchmarks/spreading.py --task cloth-dragging --device cuda --world reality --jobs 16

Newly drawn cloths, for each of some seeds. Every known action of the task is tried with each of
them, so that all rows are of the same trials: the policy, which sees the parameters; the same for
cloths that it knows nothing of; the one action that spreads most of these cloths; and the best that
any does, of all cloths and of each quarter. A task that is tried several times has these rows for
each number of tries.
"""

import argparse

import numpy as np

from gendom.materials import dimensionless_parameters
from gendom.policies import Policy
from gendom.reality import RealWorld
from gendom.tasks import find_task
from gendom.tasks.cloth_spreading import SPREAD
from gendom.tasks.world import Simulation

PRIOR = 512
"""Cloths for which a policy acts that knows nothing of the one at hand."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="cloth-spreading")
    parser.add_argument("--policy", help="a file; by default the one that ships")
    parser.add_argument("--world", choices=("simulation", "reality"), default="simulation")
    parser.add_argument("--count", type=int, default=120)
    parser.add_argument("--seeds", type=int, nargs="+", default=[101, 102, 103])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    policy = Policy.read(given.policy) if given.policy else Policy.pretrained(given.task)
    task = find_task(given.task)()
    world = Simulation(device=given.device)
    if given.world == "reality":
        world = RealWorld(jobs=given.jobs)
    known = np.array(policy.description.candidates)
    rng = np.random.default_rng(0)
    prior = [task.draw_items([rng])[0] for _ in range(PRIOR)]
    blind = np.array(list(policy.act((), prior[0], likely=prior).action.values()))
    rows: dict[str, list[list[float]]] = {}
    for seed in given.seeds:
        items = [task.draw_items([np.random.default_rng([seed, i])])[0] for i in range(given.count)]
        actions = np.array(
            [task.nearest(i, a * task.action_units(i)) for i in items for a in known]
        )
        outcomes = world.carry_out(task, [i for i in items for _ in known], actions)
        share = np.array([o.values.get("share", 0.0) for o in outcomes]).reshape(len(items), -1)
        tries = np.array([o.tries for o in outcomes]).reshape(share.shape)
        alike = [dimensionless_parameters(i) for i in items]
        chosen = policy.actions(
            np.empty((len(items), 0)), {n: np.array([a[n] for a in alike]) for n in alike[0]}
        )
        stiffness = np.array([a["bending_ratio"] for a in alike])
        quarter = np.searchsorted(np.quantile(stiffness, [0.25, 0.5, 0.75]), stiffness)
        own = np.abs(known[None] - chosen[:, None]).sum(axis=2).argmin(axis=1)
        blindly = np.abs(known - blind / task.action_units(prior[0])).sum(axis=1).argmin()
        for n in range(1, task.tries + 1):
            done, word = (share >= SPREAD) & (tries <= n), f", tries: {n}" * (task.tries > 1)
            best = [done[quarter == k].mean(axis=0).argmax() for k in range(4)]
            every = np.arange(len(items))
            for name, k in {
                "policy": own,
                "without parameters": np.full(len(items), blindly),
                "best constant": np.full(len(items), done.mean(axis=0).argmax()),
                "best of each quarter": np.array(best)[quarter],
            }.items():
                spread, first = done[every, k], known[k, 0]
                by = [spread[quarter == q].mean() for q in range(4)]
                figures = [spread.mean(), *by, *(first[quarter == q].mean() for q in range(4))]
                rows.setdefault(name + word, []).append(figures)
            any_of = np.asarray(done.any(axis=1))
            by = [any_of[quarter == q].mean() for q in range(4)]
            rows.setdefault("any" + word, []).append([any_of.mean(), *by, *[np.nan] * 4])
        head = f"seeds {given.seeds[: len(next(iter(rows.values())))]}, {given.count} cloths each"
        print(
            f"{head:40s} spread  by quarters, limp first   first number of the action", flush=True
        )
        for name, found in rows.items():
            mean = np.mean(found, axis=0)
            numbers = (
                "  ".join(f"{x:.2f}" for x in mean[1:5]),
                "  ".join(f"{x:.2f}" for x in mean[5:]),
            )
            print(f"{name:40s} {mean[0]:6.2f}  {numbers[0]}       {numbers[1]}", flush=True)


if __name__ == "__main__":
    main()
