"""`gendom train`: train a policy on demonstrations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from gendom.arguments import require
from gendom.cli.arguments import Engine, Json, Seed, TaskName
from gendom.cli.policies import described, policy_text
from gendom.errors import DatasetError
from gendom.files import check_file, to_json

if TYPE_CHECKING:
    from gendom.policies.demonstrations import Demonstrations


@dataclass(frozen=True, kw_only=True)
class Command:
    """Train a policy on simulated demonstrations. Needs the extra `train`.

    The file appears when the policy is trained and has acted in new simulated cases, whose errors
    are printed; an older one stays until then.

    For example: gendom train rope-casting --data casts --out casting.onnx
    """

    task: TaskName
    data: Path
    """Folder of demonstrations from gendom dataset; an unfinished set is used as it is."""
    out: Path
    """ONNX file to write."""
    finetune: Path | None = None
    """Folder of further demonstrations, such as real ones, to fine-tune on at the end."""
    method: Literal["distal", "inverse", "chance"] | None = None
    """distal: learn a forward model, then train the policy through it (default). inverse: regress
    actions on goals, as in the paper. chance: learn how probably an action is enough (default of
    tasks without goals)."""
    condition: tuple[str, ...] = ("all",)
    """Parameters that the policy sees: some of bending_ratio, nu, damping, friction, density and
    thickness_ratio, or all (that vary in the demonstrations) or none."""
    architecture: Literal["smooth", "paper"] = "smooth"
    """smooth: 3 x 192 SiLU. paper: 256, 128, 32 ReLU."""
    epochs: int = 300
    """Passes over the demonstrations, for each network."""
    batch_size: int = 256
    """Of demonstrations in a step of the optimiser; 512 suits a GPU and many demonstrations."""
    refine: int = 0
    """Rounds in which the policy then acts in the simulator and is corrected by what it reaches; 4
    halve the error of one that sees the parameters. Needs a task with goals."""
    refine_cases: int = 2000
    """Goals and objects of each round, at most."""
    refine_steps: int = 4000
    """Of the optimiser in each round; the last has four times as many."""
    engine: Engine = "thin"
    device: str = "cpu"
    """Of simulator and networks: cpu, cuda or cuda:0 and so on."""
    cases: int = 200
    """New cases to act in afterwards; 0: none."""
    seed: Seed = 0
    json: Json = False

    def run(self) -> int:
        check_file(self.out, ".onnx")
        demonstrations = self._read(self.data)
        finetune = None if self.finetune is None else self._read(self.finetune)
        from gendom.policies.training import Training, train
        from gendom.sim.device import open_device
        from gendom.tasks.world import Simulation

        open_device(self.device)
        method = self.method or ("distal" if demonstrations.goal_names else "chance")
        names = ("architecture", "epochs", "batch_size", "seed")
        names += ("refine", "refine_cases", "refine_steps")
        own = {name: getattr(self, name) for name in names}
        sees = tuple(name for name in self.condition if name != "none")
        sees = None if sees == ("all",) else sees  # that vary
        training = Training(method=method, conditioned_on=sees, **own)
        policy = train(
            demonstrations, self.out, training, finetune=finetune, cases=self.cases, progress=True,
            world=Simulation(engine=self.engine, device=self.device), device=self.device,
        )  # fmt: skip
        row = described(policy)
        print(to_json(row) if self.json else policy_text(row))
        return 0

    def _read(self, folder: Path) -> Demonstrations:
        from gendom.policies.demonstrations import Demonstrations

        demonstrations = Demonstrations.read(folder)
        name = demonstrations.task.get("name")
        what = f"holds demonstrations of {name}, not of {self.task}"
        fix = "name another folder"
        require(name == self.task, what, where=str(folder), fix=fix, error=DatasetError)
        return demonstrations
