"""Rope reaching in the second reality: what knowing E and nu is worth to the arm.

Each rope is asked for goals spread over what it can reach; the arm does what each policy says. The
parameters are the rope's own.

    python benchmarks/reaching.py [--goals 6] [--policy WITH.onnx WITHOUT.onnx] [--json]
"""

import argparse
import json
import statistics

import numpy as np
from tqdm import tqdm

from gendom.errors import GendomError
from gendom.policies import Policy
from gendom.reality import OBJECTS, Performance, RealRope, carry_out_reaching, reaching


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=int, default=6, help="for each rope")
    parser.add_argument("--policy", nargs=2, help="with and without parameters")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    if given.policy:
        policies = [Policy.read(path) for path in given.policy]
    else:
        policies = [Policy.pretrained(parameters=sees) for sees in (True, False)]
    ropes = [item for item in OBJECTS.values() if isinstance(item, RealRope)]
    trials = [
        trial(rope, goal, policies)
        for rope in ropes
        for goal in tqdm(goals_of(rope, policies[0], given.goals), desc=rope.name, leave=False)
    ]
    if given.json:
        print(json.dumps(trials, indent=2))
        return
    print(f"{'rope':<20} {'goals':>5} {'with E, nu':>16} {'without':>16}   median, worst [mm]")
    for name in [rope.name for rope in ropes] + ["all"]:
        some = [t["errors_mm"] for t in trials if name in (t["rope"], "all")]
        columns = [[e[k] for e in some if e[k] is not None] for k in (0, 1)]
        shown = [f"{statistics.median(c):7.1f} {max(c):8.1f}" for c in columns]
        print(f"{name:<20} {len(some):>5} {shown[0]:>16} {shown[1]:>16}")


def goals_of(rope: RealRope, policy: Policy, count: int) -> np.ndarray:
    """Goals [m] spread over what a rope of its stiffness reaches."""
    modulus = policy.task().conditioned_on(
        rope.material.specific_modulus, length=rope.length, diameter=rope.diameter
    )
    low, high = policy.goal_range(modulus)
    shares = (np.arange(count) + 0.5) / count
    return rope.length * (low + shares * (high - low))


def trial(rope: RealRope, goal: float, policies: list[Policy]) -> dict:
    """What each policy's action reached; None where the arm cannot carry it out."""
    size = {"length": rope.length, "diameter": rope.diameter}
    material = rope.material
    errors: list[float | None] = []
    actions = []
    for policy in policies:
        action = policy.act(goal, material.specific_modulus, material.nu, **size).values
        actions.append([float(a) for a in action])
        try:
            reached = carry_out_reaching(Performance(reaching(rope, action))).reached
            errors.append(1e3 * abs(reached - goal))
        except GendomError:
            errors.append(None)
    return {"rope": rope.name, "goal": float(goal), "actions": actions, "errors_mm": errors}


if __name__ == "__main__":
    main()
