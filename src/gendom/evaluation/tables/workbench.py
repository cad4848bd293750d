"""Demonstrations and policies of tables, made once and kept in a folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gendom.datasets.demonstrations import generate
from gendom.errors import PolicyError
from gendom.files import read_json, write_json
from gendom.policies import Policy
from gendom.policies.demonstrations import Demonstrations
from gendom.tasks.demonstrator import Demonstrator
from gendom.tasks.task import World
from gendom.tasks.world import Simulation

if TYPE_CHECKING:
    from gendom.policies.training import Training


FEW = 1000
"""Sets below this are trained on in batches of `SMALL_BATCH`."""

SMALL_BATCH = 32


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """A policy to be trained."""

    demonstrations: Demonstrations
    training: Training
    finetune: Demonstrations | None = None
    world: World | None = None
    """Where a policy that is refined acts (default: our simulator)."""

    @classmethod
    def suited(
        cls,
        demonstrations: Demonstrations,
        training: Training,
        steps: int,
        *,
        finetune: Demonstrations | None = None,
        world: World | None = None,
    ) -> Wanted:
        """With batches for the number of demonstrations, and as many more passes over them as
        `steps` of the optimiser need."""
        size = SMALL_BATCH if len(demonstrations) < FEW else training.batch_size
        taught = (1.0 - training.validation_share) * len(demonstrations)
        epochs = max(training.epochs, math.ceil(steps / max(taught / size, 1.0)))
        training = replace(training, batch_size=size, epochs=epochs)
        return cls(demonstrations=demonstrations, training=training, finetune=finetune, world=world)


@dataclass(frozen=True, kw_only=True)
class Workbench:
    """A folder that keeps everything a table is made from, so that an interrupted one continues.

    Results have readable names; file names follow from them.
    """

    folder: Path
    device: str = "cpu"
    """Of our simulator."""
    jobs: int = 1
    """Processes of the second reality, and trainings side by side."""
    seed: int = 0
    on_stage: Callable[[str], None] = field(default=lambda _: None)
    """Called with what begins."""

    def beside_training(self, engine: str = "thin") -> Simulation:
        """Where policies are refined, which are trained side by side."""
        threads = 1 if self.jobs > 1 else None
        return Simulation(engine=engine, device=self.device, threads=threads)

    def kept(self, name: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """The content of a JSON file, made if it is missing."""
        path = self.folder / f"{_slug(name)}.json"
        if not path.exists():
            self.on_stage(name)
            self.folder.mkdir(parents=True, exist_ok=True)
            write_json(path, make())
        return read_json(path)

    def demonstrations(
        self, name: str, source: Demonstrator, size: int, *, device: str | None = None
    ) -> Demonstrations:
        """A set, simulated as far as it is missing."""
        self.on_stage(f"{name}: {size} demonstrations")
        folder = self.folder / _slug(name)
        generate(source, size, folder, seed=self.seed, device=device or self.device)
        return Demonstrations.read(folder)

    def policies(self, wanted: Mapping[str, Wanted]) -> dict[str, Policy]:
        """Policies by name, trained side by side unless they are there."""
        found, missing = {}, {}
        for name, one in wanted.items():
            policy = self._there(name, one)
            if policy is None:
                missing[name] = one
            else:
                found[name] = policy
        if missing:
            self.on_stage(f"training {', '.join(missing)}")
            paths = [str(self._path(name)) for name in missing]
            if self.jobs == 1 or len(missing) == 1:
                for one, path in zip(missing.values(), paths, strict=True):
                    _train(one, path)
            else:
                with ProcessPoolExecutor(
                    min(self.jobs, len(missing)), mp_context=get_context("spawn")
                ) as pool:
                    list(pool.map(_train, missing.values(), paths))
            found |= {name: Policy.read(self._path(name)) for name in missing}
        return {name: found[name] for name in wanted}

    def best(self, name: str, wanted: Mapping[str, Wanted]) -> tuple[Policy, dict[str, float]]:
        """The policy whose action is nearest to that of demonstrations it has not seen, and the
        errors of all: the search for a baseline's settings."""
        policies = self.policies({f"{name}-{which}": x for which, x in wanted.items()})
        errors = {
            which: float(policies[f"{name}-{which}"].description.training["errors"]["action_rms"])
            for which in wanted
        }
        return policies[f"{name}-{min(errors, key=lambda w: errors[w])}"], errors

    def _path(self, name: str) -> Path:
        return self.folder / f"{_slug(name)}.onnx"

    def _there(self, name: str, one: Wanted) -> Policy | None:
        try:
            policy = Policy.read(self._path(name))
        except PolicyError:
            return None
        about = policy.description.training
        wanted = {
            **asdict(one.training),
            "demonstrations": len(one.demonstrations),
            "finetuned_on": len(one.finetune) if one.finetune else 0,
        }
        same = all(about.get(k) == (list(v) if isinstance(v, tuple) else v)
                   for k, v in wanted.items())  # fmt: skip
        return policy if same else None


def _slug(name: str) -> str:
    return name.lower().replace(", ", "-").replace(" ", "-").replace("+", "-and-")


def _train(one: Wanted, path: str) -> None:
    from gendom.policies.training import train

    train(one.demonstrations, path, one.training, finetune=one.finetune, world=one.world)
