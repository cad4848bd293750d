"""`gendom train`: train a policy on demonstrations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from gendom.arguments import require
from gendom.cli.arguments import Engine, Json, Seed, TaskName, settings_of
from gendom.errors import DatasetError, printable
from gendom.files import check_file, to_json
from gendom.materials import PARAMETERS

if TYPE_CHECKING:
    from gendom.policies import Policy
    from gendom.policies.demonstrations import Demonstrations


@dataclass(frozen=True, kw_only=True)
class Command:
    """Train a policy on simulated demonstrations. Needs the extra `train`.

    The file appears when the policy is trained and has acted in new simulated cases, whose errors
    are printed; an older one stays until then. If it is interrupted, run it again: it continues
    after the last network or round that was done.

    For example: gendom train rope-casting --data casts --out casting.onnx
    """

    task: TaskName
    data: Path
    """Folder of demonstrations from gendom dataset; an unfinished set is used as it is."""
    out: Path
    """ONNX file to write."""
    finetune: Path | None = None
    """Folder of further demonstrations, such as real ones, to fine-tune on at the end."""
    method: Literal["distal", "inverse", "quantile"] | None = None
    """distal: learn a forward model, then train the policy through it (default). inverse: regress
    actions on goals, as in the paper. quantile: what is enough for nine of ten objects (default of
    tasks without goals)."""
    condition: tuple[str, ...] = ("all",)
    """Parameters that the policy sees: some of bending_ratio, nu, damping, friction and density, or
    all (that vary in the demonstrations) or none."""
    architecture: Literal["smooth", "paper"] = "smooth"
    """smooth: 3 x 192 SiLU. paper: 256, 128, 32 ReLU."""
    epochs: int = 300
    """Passes over the demonstrations, for each network."""
    refine: int = 0
    """Rounds in which the policy then acts in the simulator and is corrected by what it reaches; 4
    halve the error of one that sees the parameters. Needs a task with goals."""
    refine_cases: int = 2000
    """Goals and objects of each round, at most."""
    engine: Engine = "thin"
    device: str = "cpu"
    """Of the simulator: cpu, cuda or cuda:0 and so on. Networks are trained on the CPU."""
    cases: int = 200
    """New cases to act in afterwards; 0: none."""
    seed: Seed = 0
    json: Json = False

    def run(self) -> int:
        sees = _conditions(self.condition)
        check_file(self.out, ".onnx")
        from gendom.policies.training import Training, train
        from gendom.sim.device import open_device
        from gendom.tasks.world import Simulation

        open_device(self.device)
        demonstrations = self._read(self.data)
        finetune = None if self.finetune is None else self._read(self.finetune)
        method = self.method or ("distal" if demonstrations.goal_names else "quantile")
        training = settings_of(Training, self, method=method, conditioned_on=sees)
        policy = train(
            demonstrations,
            self.out,
            training,
            finetune=finetune,
            world=Simulation(engine=self.engine, device=self.device),
            cases=self.cases,
            progress=True,
        )
        summary = summarize(policy)
        print(to_json(summary) if self.json else summary_text(summary))
        return 0

    def _read(self, folder: Path) -> Demonstrations:
        from gendom.policies.demonstrations import Demonstrations

        demonstrations = Demonstrations.read(folder)
        name = demonstrations.task.get("name")
        what = f"holds demonstrations of {name}, not of {self.task}"
        fix = "name another folder"
        require(name == self.task, what, where=str(folder), fix=fix, error=DatasetError)
        return demonstrations


def _conditions(words: tuple[str, ...]) -> tuple[str, ...] | None:
    if words == ("all",):
        return None
    if words in ((), ("none",)):
        return ()
    unknown = [*(word for word in words if word not in PARAMETERS), ""]
    fix = f"choose from {', '.join(PARAMETERS)}, or give all or none"
    require(not unknown[0], f"there is no parameter {unknown[0]!r}", where="--condition", fix=fix)
    return words


def summarize(policy: Policy) -> dict[str, Any]:
    """What a policy is and how its training went, ready for JSON."""
    about = policy.description
    training = dict(about.training)
    acted = training.pop("acted", None)
    return {
        "path": policy.where,
        "task": about.task,
        "method": about.method,
        "conditioned_on": about.conditioned_on,
        "parameters": about.parameters,
        "training": training,
        **({} if acted is None else {"acted": acted}),
    }


def summary_text(summary: dict[str, Any]) -> str:
    """The same for people."""
    training = summary["training"]
    names = ", ".join(summary["conditioned_on"]) or "no parameters"
    failed, finetuned, rounds = (training.get(n) for n in ("failed", "finetuned_on", "refine"))
    said = [
        f"on {training['demonstrations']} demonstrations",
        f"of which {failed} failed" * bool(failed),
        f"fine-tuned on {finetuned}" * bool(finetuned),
        f"refined in {rounds} rounds" * bool(rounds),
        f"seed {training['seed']}",
    ]
    rows = {
        "method": f"{summary['method']}, conditioned on {names}",
        "trained": ", ".join(filter(None, said)),
        "held out": f"{training['held_out']} of them, with these errors",
    }
    for name, value in training["errors"].items():
        of = "" if name.endswith("_share") else " of the size"
        rows[name.replace("_", " ")] = f"{100 * value:.3g} %{of}"
    rows["took"] = f"{training['seconds']:.3g} s"
    if acted := summary.get("acted"):
        figures = acted["error_over_size"]
        rows["acted"] = "no case could be simulated"
        if figures["mean"] is not None:
            rows["acted"] = (
                f"in {acted['cases']} new cases: error {100 * figures['mean']:.3g} % of the size "
                f"in the mean, {100 * figures['p95']:.3g} % at the 95th percentile"
            )
    width = max(map(len, rows))
    lines = [f"{printable(summary['path'])}: a policy for {summary['task']['name']}"]
    return "\n".join(lines + [f"  {name:<{width}}  {text}" for name, text in rows.items()])
