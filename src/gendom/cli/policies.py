"""`gendom policies`: the policies that come with the package."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gendom.cli.arguments import Json
from gendom.errors import printable
from gendom.files import to_json
from gendom.materials import PARAMETERS
from gendom.policies import Policy


@dataclass(frozen=True, kw_only=True)
class Command:
    """List policies: what they see, what they were trained on, and how far they miss.

    For example: gendom policies --json
    """

    policy: tuple[Path, ...] = ()
    """Policy files; by default the shipped ones."""
    json: Json = False

    def run(self) -> int:
        policies = [Policy.read(path) for path in self.policy] or Policy.shipped()
        rows = [described(policy) for policy in policies]
        print(to_json({"policies": rows}) if self.json else "\n\n".join(map(policy_text, rows)))
        return 0


def described(policy: Policy) -> dict[str, Any]:
    """A policy ready for JSON."""
    about = policy.description
    return {
        "path": policy.where,
        "task": about.task["name"],
        "method": about.method,
        "conditioned_on": about.conditioned_on,
        "goals": dict(zip(about.goal_names, policy.goal_range().tolist(), strict=True)),
        "parameters": {n: about.parameters[n] for n in about.conditioned_on},
        "demonstrations": about.training.get("demonstrations"),
        "training": {name: value for name, value in about.training.items() if name != "acted"},
        "acted": about.training.get("acted"),
    }


def policy_text(row: dict[str, Any]) -> str:
    """The same for people."""
    names = ", ".join(row["conditioned_on"]) or "no parameters"
    name, training, acted = printable(Path(row["path"]).name), row["training"], row["acted"]
    lines = [f"{name}: {row['task']}, {row['method']}, conditioned on {names}"]
    for name, (low, high) in row["parameters"].items():
        lines.append(f"  input {name:<15} {low:.3g} to {high:.3g} [-] ({PARAMETERS[name].meaning})")
    for name, (low, high) in row["goals"].items():
        lines.append(f"  goal {name:<9} {low:.3g} to {high:.3g} sizes")
    forms = {"demonstrations": "{} demonstrations", "failed": "of which {} failed",
             "finetuned_on": "fine-tuned on {}", "refine": "refined in {} rounds"}  # fmt: skip
    said = [form.format(training[name]) for name, form in forms.items() if training.get(name)]
    lines.append(f"  trained on     {', '.join(said)}")
    for name, value in training.get("errors", {}).items():
        of = "" if name.endswith("_share") else " of the size"
        lines.append(f"  held out       {name.replace('_', ' ')} {100.0 * value:.3g} %{of}")
    if acted:
        off, of = acted["error_over_size"], "the size" if row["goals"] else "its share"
        cases = f"{acted['cases']} new cases"
        said = f"in none of {cases}: none could be simulated"
        if None not in off.values():
            mean, p95 = 100.0 * off["mean"], 100.0 * off["p95"]
            said = (
                f"{mean:.2g} % of {of} in the mean, {p95:.2g} % at the 95th percentile of {cases}"
            )
        if "enough_share" in acted:
            lines.append(f"  is enough      in {100.0 * acted['enough_share']:.3g} % of {cases}")
        lines.append(f"  misses by      {said}")
    return "\n".join(lines)
