"""`gendom train`: train a policy on demonstrations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from gendom.errors import DatasetError
from gendom.files import to_json

if TYPE_CHECKING:
    from gendom.policies import Policy

_CONDITIONS = {
    "both": ("specific_modulus", "poissons_ratio"),
    "E": ("specific_modulus",),
    "nu": ("poissons_ratio",),
    "none": (),
}


@dataclass(frozen=True, kw_only=True)
class Command:
    """Train a policy on simulated demonstrations. Needs the extra `train`.

    The file appears when the policy is trained and checked; an older one stays until then.
    """

    task: Annotated[
        tyro.conf.Positional[Literal["rope-reaching"]], tyro.conf.arg(metavar="rope-reaching")
    ]
    """What the policy is for."""
    data: Path
    """Folder of demonstrations from gendom dataset."""
    out: Path
    """ONNX file to write."""
    method: Literal["distal", "inverse"] = "distal"
    """distal: learn what actions do, then teach the policy through that. inverse: regress
    actions on goals, as in the paper."""
    condition: Literal["both", "E", "nu", "none"] = "both"
    """Parameters that the policy sees."""
    architecture: Literal["smooth", "paper"] = "smooth"
    """smooth: 3 x 192 SiLU. paper: 256, 128, 32 ReLU."""
    epochs: int = 300
    """Passes over the demonstrations, for each network."""
    seed: int = 0
    """Seed of the training."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        from gendom.policies.demonstrations import Demonstrations
        from gendom.policies.train import Training, train

        demonstrations = Demonstrations.read(self.data)
        name = demonstrations.task.get("name")
        if name != self.task:
            raise DatasetError(
                f"holds demonstrations of {name}, not of {self.task}",
                where=str(self.data),
                fix="name another folder",
            )
        training = Training(
            method=self.method,
            conditioned_on=_CONDITIONS[self.condition],
            architecture=self.architecture,
            epochs=self.epochs,
            seed=self.seed,
        )
        policy = train(demonstrations, self.out, training, progress=True)
        summary = summarize(policy)
        print(to_json(summary) if self.json else summary_text(summary))
        return 0


def summarize(policy: Policy) -> dict[str, Any]:
    """What a policy is and how its training went, ready for JSON."""
    about = policy.description
    return {
        "path": policy.where,
        "task": about.task,
        "method": about.method,
        "conditioned_on": about.conditioned_on,
        "parameters": about.parameters,
        "training": about.training,
    }


def summary_text(summary: dict[str, Any]) -> str:
    """The same for people."""
    training = summary["training"]
    sees = ", ".join(summary["conditioned_on"]) or "no parameters"
    length = summary["task"]["length"]
    errors = [
        (name.replace("_", " "), f"{value * length:.3g} m ({100 * value:.2g} % of the length)")
        for name, value in training["errors"].items()
    ]
    rows = [
        ("method", f"{summary['method']}, sees {sees}"),
        ("trained", f"on {training['demonstrations']} demonstrations, seed {training['seed']}"),
        ("held out", f"{training['held_out']} of them, with these errors"),
        *errors,
        ("took", f"{training['seconds']:.3g} s"),
    ]
    width = max(len(name) for name, _ in rows)
    lines = [f"{summary['path']}: a policy for {summary['task']['name']}"]
    return "\n".join(lines + [f"  {name:<{width}}  {text}" for name, text in rows])
