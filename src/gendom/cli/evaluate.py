"""`gendom evaluate`: measure how well policies reach their goals."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from gendom.files import to_json


@dataclass(frozen=True, kw_only=True)
class Command:
    """Let policies act in simulated cases with goals that can be reached, and print the errors.

    All policies meet the same ropes and goals. Each case is simulated once to find a goal, and
    once for each policy.
    """

    task: Annotated[
        tyro.conf.Positional[Literal["rope-reaching"]], tyro.conf.arg(metavar="rope-reaching")
    ]
    """What is done."""
    policy: tuple[Path, ...] = ()
    """Policy files; by default those that come with the package, with and without parameters."""
    cases: int = 50
    """Number of ropes and goals."""
    seed: int = 0
    """Seed of the cases."""
    device: str = "cpu"
    """cpu, cuda or cuda:0 and so on."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        from gendom.evaluation import draw_cases, score
        from gendom.policies import Policy

        began = time.monotonic()
        if self.policy:
            policies = [Policy.read(path) for path in self.policy]
        else:
            policies = [Policy.pretrained(self.task, parameters=p) for p in (True, False)]
        cases = draw_cases(policies[0].task(), self.cases, seed=self.seed, device=self.device)
        result = {
            "task": self.task,
            "cases": self.cases,
            "seed": self.seed,
            "device": self.device,
            "policies": [
                {
                    "path": policy.where,
                    "method": policy.description.method,
                    "conditioned_on": policy.description.conditioned_on,
                    "training_seed": policy.description.training.get("seed"),
                    **score(policy, cases).summary(),
                }
                for policy in policies
            ],
            "seconds": time.monotonic() - began,
        }
        print(to_json(result) if self.json else result_text(result))
        return 0


def result_text(result: dict[str, Any]) -> str:
    """The same for people."""
    lines = [f"{result['task']}: {result['cases']} cases, seed {result['seed']}, |goal - reached|"]
    for entry in result["policies"]:
        sees = ", ".join(entry["conditioned_on"]) or "no parameters"
        lines.append(f"{entry['path']} ({entry['method']}, sees {sees})")
        if entry["error"]["mean"] is None:
            lines.append("  all simulations failed")
            continue
        for name, value in entry["error"].items():
            percent = 100.0 * entry["error_over_length"][name]
            lines.append(f"  {name:<7} {value:.5f} m  {percent:6.2f} % of the length")
        lines += [
            f"  {count} {what}"
            for count, what in (
                (entry["failed"], "simulations failed"),
                (entry["outside_range"], "goals outside the policy's range (counted above)"),
            )
            if count
        ]
    return "\n".join([*lines, f"took {result['seconds']:.3g} s"])
