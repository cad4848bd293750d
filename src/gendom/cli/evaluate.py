"""`gendom evaluate`: measure how well policies reach their goals."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gendom.cli.arguments import Device, Engine, Json, Seed, TaskName, Where, policy_for
from gendom.errors import printable
from gendom.files import to_json
from gendom.policies import Policy
from gendom.policies.evaluation import score
from gendom.progress import bar
from gendom.tasks.cases import draw_cases
from gendom.tasks.world import Simulation


@dataclass(frozen=True, kw_only=True)
class Command(Where):
    """Let policies act in cases with goals that can be reached, and print the errors.

    All policies meet the same objects and goals. Each case is simulated once to find a goal, and
    once for each policy: in GenDOM's simulator, or in the MuJoCo test scene (the second reality,
    docs/reality.md).

    For example: gendom evaluate rope-casting --policy casting.onnx
    """

    task: TaskName
    policy: tuple[Path, ...] = ()
    """Policy files; by default the shipped ones, with and without parameters."""
    cases: int = 50
    """Number of objects and goals."""
    seed: Seed = 0
    engine: Engine = "thin"
    device: Device = "cpu"
    json: Json = False

    def run(self) -> int:
        began = time.monotonic()
        policies = [policy_for(self.task, path) for path in self.policy]
        for sees in (True, False) if not policies else ():
            if sees or Policy.ships(self.task, parameters=sees):
                policies.append(Policy.pretrained(self.task, parameters=sees))
        simulation = Simulation(engine=self.engine, device=self.device)
        world, items = self.world_and_items(simulation)
        task = policies[0].task()
        cases = draw_cases(task, self.cases, seed=self.seed, simulation=simulation, items=items)
        entries = []
        for policy in policies:
            with bar("acting", len(cases), "case") as show:
                found = score(policy, cases, world=world, on_frame=show)
            about = policy.description
            entry = {"path": policy.where, "method": about.method}
            entry |= {"conditioned_on": about.conditioned_on}
            entries.append(entry | {"training_seed": about.training.get("seed")} | found.summary())
        flags = ("task", "world", "cases", "seed", "engine", "device")
        result = {
            **{name: getattr(self, name) for name in flags},
            "unit": next((goal.unit for goal in task.goals), "1"),
            "policies": entries,
            "seconds": time.monotonic() - began,
        }
        print(to_json(result) if self.json else result_text(result))
        return 0


def result_text(result: dict[str, Any]) -> str:
    """The same for people."""
    cases, seed = result["cases"], result["seed"]
    lines = [f"{result['task']} in {result['world']}: {cases} cases, seed {seed}"]
    for entry in result["policies"]:
        names = ", ".join(entry["conditioned_on"]) or "no parameters"
        lines.append(f"{printable(entry['path'])} ({entry['method']}, conditioned on {names})")
        if entry["error"]["mean"] is None:
            lines.append("  all failed")
            continue
        if "enough_share" in entry:
            lines.append(f"  {entry['enough_share']:.2f} of the cases miss nothing")
        unit = "-" if result["unit"] == "1" else result["unit"]
        lines.append(f"  error   [{unit}]")
        for name, value in entry["error"].items():
            percent = 100.0 * entry["error_over_size"][name]
            lines.append(f"  {name:<7} {value:.5f}  {percent:6.2f} % of the size")
        lines += [f"  {entry['failed']} failed"] * bool(entry["failed"])
    return "\n".join([*lines, f"took {result['seconds']:.3g} s"])
