"""What every training method works on: settings, data, columns, networks, their fits and files.
Needs torch and onnx."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gendom.arguments import require
from gendom.arrays import Array
from gendom.errors import PolicyError
from gendom.installation import how_to_install
from gendom.materials import PARAMETERS
from gendom.policies.demonstrations import SMALLEST, Demonstrations, joined
from gendom.policies.graph import sealed
from gendom.policies.policy import GOAL, METHODS, Column
from gendom.progress import bar
from gendom.tasks import find_task

try:
    import torch
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError(
        f"training needs torch; install it with: {how_to_install('train')}", name=missing.name
    ) from missing
import onnx
from torch import Tensor, nn

OPSET = 17

Loss = Callable[[Tensor], Tensor]
"""Of some rows [B]."""

ARCHITECTURES: dict[str, tuple[tuple[int, ...], type[nn.Module]]] = {
    "smooth": ((192, 192, 192), nn.SiLU),
    "paper": ((256, 128, 32), nn.ReLU),
}
"""Widths of the hidden layers, and what follows each. "paper" is that of Kuroki et al. (2024)."""

FINETUNE_LEARNING_RATE = 4e-4
"""Peak of the learning rate of fine-tuning."""

VALIDATION_SHARE = 0.1
"""Share of the demonstrations held out."""

RISK_FLOOR = 1e-5
"""Smaller risks count as zero [units of similarity]."""

RISK_MARGIN = 0.5
"""How far below its limit a policy keeps the risk that is predicted, in powers of e."""


CHANCE_WEIGHT_DECAY = 1.0
"""Of the method ``chance``, which sees each outcome once: with the usual one it learns the chance
of single trials, and chooses by it (docs/notes/policies.md)."""

CHANCE = Column(name="chance", mean=0.0, scale=1.0)
"""Output of the method ``chance``."""


@dataclass(frozen=True, kw_only=True)
class Training:
    """How to train.

    Raises:
        PolicyError: A value lies outside its range.
    """

    method: str = "distal"
    """One of "distal", "inverse" and "chance"; see `gendom.policies.methods`."""
    conditioned_on: tuple[str, ...] | None = None
    """The parameters that the policy sees; None: all that vary. The forward model
    that it is trained through always sees all: they are those of the demonstration. A policy that
    does not see them learns the action that is best on average over them."""
    architecture: str = "smooth"
    """A key of `ARCHITECTURES`."""
    epochs: int = 300
    """Passes over the demonstrations, for each network."""
    batch_size: int = 256
    learning_rate: float = 4e-3
    """Peak of the learning rate, which then falls to zero along a cosine."""
    weight_decay: float = 1e-4
    finetune_steps: int = 4000
    """Of the optimiser for fine-tuning, at least."""
    refine: int = 0
    """Rounds in the simulator after that, see `gendom.policies.refining`."""
    refine_cases: int = 2000
    """Demonstrations whose goals and objects the policy acts for in each round, at most."""
    refine_steps: int = 4000
    """Of the optimiser in each round; the last has four times as many."""
    seed: int = 0
    """Fixes the held-out demonstrations, the initial weights and the order of the batches."""

    def __post_init__(self) -> None:
        for name, values, known in (
            ("method", (self.method,), METHODS),
            ("architecture", (self.architecture,), tuple(ARCHITECTURES)),
            ("conditioned_on", self.conditioned_on or (), tuple(PARAMETERS)),
        ):
            wrong = next((v for v in values if v not in known), None)
            fix = f"choose from {', '.join(known)}"
            require(wrong is None, f"{name} is {wrong!r}", fix=fix, error=PolicyError)
        for name in ("epochs", "batch_size", "learning_rate", "finetune_steps"):
            value = getattr(self, name)
            require(value > 0, f"{name} must be positive, got {value}", error=PolicyError)
        what = f"{self.refine} rounds of {self.refine_cases} cases and {self.refine_steps} steps"
        good = self.refine >= 0 and min(self.refine_cases, self.refine_steps) >= 1
        fix = "give 0 rounds or more, of 1 case and 1 step or more"
        require(good, what, where="refine", fix=fix, error=PolicyError)


class PhysicalNetwork(nn.Module):
    """A multilayer perceptron whose inputs and outputs are physical quantities.

    Standardisation, and logarithms where a column asks for them, are part of it.

    Args:
        inputs, outputs: One column for each number; outputs are not logarithmic.
        architecture: A key of `ARCHITECTURES`.
    """

    input_mean: Tensor
    input_scale: Tensor
    output_mean: Tensor
    output_scale: Tensor

    def __init__(
        self, inputs: Sequence[Column], outputs: Sequence[Column], architecture: str = "smooth"
    ):
        super().__init__()
        self._log = [column.log for column in inputs]
        self.register_buffer("input_mean", torch.tensor([c.mean for c in inputs]))
        self.register_buffer("input_scale", torch.tensor([c.scale for c in inputs]))
        self.register_buffer("output_mean", torch.tensor([c.mean for c in outputs]))
        self.register_buffer("output_scale", torch.tensor([c.scale for c in outputs]))
        widths, activation = ARCHITECTURES[architecture]
        layers: list[nn.Module] = []
        before = len(inputs)
        for width in widths:
            layers += [nn.Linear(before, width), activation()]
            before = width
        self.layers = nn.Sequential(*layers, nn.Linear(before, len(outputs)))

    def forward(self, *columns: Tensor) -> Tensor:
        """[B, outputs] from one [B, 1] tensor for each input."""
        return self.layers(self.standardised(columns)) * self.output_scale + self.output_mean

    def standardised(self, columns: Sequence[Tensor]) -> Tensor:
        """[B, inputs] what the layers see."""
        x = [torch.log(c) if log else c for c, log in zip(columns, self._log, strict=True)]
        return (torch.cat(x, dim=1) - self.input_mean) / self.input_scale


class ChanceNetwork(PhysicalNetwork):
    """One whose outputs are probabilities: standardised by nothing, and each between 0 and 1."""

    def forward(self, *columns: Tensor) -> Tensor:
        """As `PhysicalNetwork.forward`."""
        return torch.sigmoid(super().forward(*columns))


class TrainingProblem:
    """A policy in training.

    Args:
        demonstrations: What to learn from.
        sees: Parameters that the policy sees.
        training: How.
        finetune: Demonstrations that everything is fitted to once more at the end.
        shown: Whether bars show how fits stand.
    """

    def __init__(
        self,
        demonstrations: Demonstrations,
        sees: tuple[str, ...],
        training: Training,
        *,
        finetune: Demonstrations | None = None,
        shown: bool = False,
    ):
        d = demonstrations
        self.training, self.sees, self.shown = training, sees, shown
        self.goals = [
            standardised(GOAL + name, d.goal[:, k]) for k, name in enumerate(d.goal_names)
        ]
        self.actions = [standardised(name, d.action[:, k]) for k, name in enumerate(d.action_names)]
        self.parameters = {
            name: standardised(name, d.parameters[name], log=PARAMETERS[name].log)
            for name in d.varying
        }
        self.chooses = training.method == "chance"
        """Whether the network says of an action how probably it is enough."""
        first = self.actions if self.chooses else self.goals
        self.inputs = [*first, *(self.parameters[name] for name in sees)]
        # a policy that sees nothing still needs an input for its batch
        what, fix = "has neither goals nor parameters to act on", "condition it on a parameter"
        require(self.inputs, what, fix=fix, error=PolicyError)
        self.trained, self.held_out = _split(0, len(d))
        """Rows of the demonstrations that are trained on first, and rows that nothing is learnt
        from: of those for fine-tuning, if there are."""
        self.tuned = self.trained[:0]
        """Rows of those for fine-tuning."""
        if finetune is not None:
            self.tuned, self.held_out = _split(len(d), len(finetune))
            d = joined(d, finetune)
        self.action = torch.tensor(d.action, dtype=torch.float32)
        self.goal = torch.tensor(d.goal, dtype=torch.float32)
        self.data = {
            name: torch.tensor(d.parameters[name], dtype=torch.float32)[:, None]
            for name in PARAMETERS
        }
        task = find_task(d.task["name"])
        self.candidates, risk = task.candidates, task.risk
        self.log_risk = None
        self.highest = math.log(risk.limit) if risk is not None else 0.0
        """Logarithm of the risk's limit."""
        self.within = torch.ones(len(d), dtype=torch.bool)
        """[N] which demonstrations' risk is within it."""
        if risk is not None and d.risk is not None:
            logs = np.log(np.maximum(d.risk, RISK_FLOOR))
            self.log_risk = torch.tensor(logs, dtype=torch.float32)[:, None]
            self.within = self.log_risk[:, 0] <= self.highest
            if not self.chooses:  # what real objects reach follows also where they sway
                self.within[len(demonstrations) :] = True
        kind, outputs = (
            (ChanceNetwork, [CHANCE]) if self.chooses else (PhysicalNetwork, self.actions)
        )
        self.policy = kind(self.inputs, outputs, training.architecture)

    def act(self, rows: Tensor) -> Tensor:
        """[B, A] what the policy does for some demonstrations' goals and objects; of the method
        ``chance`` [B, 1] the probability that their actions are enough."""
        first = self.action if self.chooses else self.goal
        columns = first[rows].split(1, dim=1) if first.shape[1] else ()
        return self.policy(*columns, *(self.data[name][rows] for name in self.sees))

    def caution(self, log_risk: Tensor) -> Tensor:
        """Loss of risks [B], given by their logarithms, that are near the limit or beyond."""
        beyond = torch.relu(log_risk - (self.highest - RISK_MARGIN))
        return (beyond**2).mean()

    def fit(
        self,
        name: str,
        network: nn.Module,
        loss_of: Loss,
        *,
        only: Tensor | None = None,
        replay: int | None = None,
    ) -> None:
        """Fit a network to the demonstrations.

        Args:
            name: For people.
            network: What is trained.
            loss_of: Loss of some rows.
            only: [N] which rows count, bool; all if it leaves too few.
            replay: Fit it to the demonstrations for fine-tuning, if there are any, each together
                with so many of the first ones; None: to the first ones.

        Raises:
            PolicyError: It diverged.
        """
        how, rows = self.training, _chosen(self.trained, only)
        epochs, rate = how.epochs, how.learning_rate
        if replay is not None:
            if not len(self.tuned):
                return
            few = _chosen(self.tuned, only)
            rows = torch.cat([few, rows[: replay * len(few)]])
            epochs = -(-how.finetune_steps // max(1, len(rows) // how.batch_size))
            name, rate = f"{name}, fine-tuned", FINETUNE_LEARNING_RATE
        self.descend(name, network, loss_of, rows, epochs, rate)

    def descend(
        self, name: str, network: nn.Module, loss_of: Loss, rows: Tensor, epochs: int, rate: float
    ) -> None:
        """`descend` with the training's settings, and progress.

        Raises:
            PolicyError: It diverged.
        """
        how = self.training
        decay = CHANCE_WEIGHT_DECAY if self.chooses else how.weight_decay
        with bar(name, epochs, "epoch", shown=self.shown) as show:
            descend(
                network, loss_of, rows, epochs=epochs, batch_size=how.batch_size, rate=rate,
                weight_decay=decay, on_epoch=lambda n, loss: show(n, note=f"loss {loss:.2e}"),
            )  # fmt: skip


def descend(
    network: nn.Module,
    loss_of: Loss,
    rows: Tensor,
    *,
    epochs: int,
    batch_size: int,
    rate: float,
    weight_decay: float,
    on_epoch: Callable[[int, float], None],
) -> None:
    """Minimise the mean of a loss over batches of rows [M] by AdamW, whose learning `rate` rises
    shortly, then falls to zero along a cosine. ``on_epoch`` is told each epoch and its loss.

    Raises:
        PolicyError: It diverged.
    """
    batch = min(batch_size, len(rows))
    steps, on_gpu = len(rows) // batch, rows.is_cuda
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=torch.tensor(rate) if on_gpu else rate, fused=True,
        weight_decay=weight_decay, capturable=on_gpu,
    )  # fmt: skip
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, rate, total_steps=epochs * steps + 1, pct_start=0.1, cycle_momentum=False
    )

    def step(part: Tensor) -> Tensor:
        loss = loss_of(part)
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        return loss.detach()

    take = _recorded(step, rows[:batch]) if on_gpu else step
    for epoch in range(1, epochs + 1):
        total = torch.zeros(())
        for part in rows[torch.randperm(len(rows))][: steps * batch].split(batch):
            total = total + take(part) / steps
            schedule.step()
        what, fix = f"training diverged in epoch {epoch}", "lower the learning rate"
        mean = total.item()  # waits for the device
        require(math.isfinite(mean), what, fix=fix, error=PolicyError)
        on_epoch(epoch, mean)


def _recorded(step: Callable[[Tensor], Tensor], rows: Tensor) -> Callable[[Tensor], Tensor]:
    """A step of the optimiser over rows [B] as one CUDA graph: its kernels take a tenth of the time
    that Python takes to launch them one by one."""
    given, side, graph = rows.clone(), torch.cuda.Stream(rows.device), torch.cuda.CUDAGraph()
    with torch.cuda.device(rows.device):
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(3):  # what is allocated at first must not be part of the graph
                step(given)
        torch.cuda.current_stream().wait_stream(side)
        with torch.cuda.graph(graph):
            loss = step(given)

    def replay(part: Tensor) -> Tensor:
        given.copy_(part)
        graph.replay()
        return loss

    return replay


def _chosen(rows: Tensor, only: Tensor | None) -> Tensor:
    """Those rows that count, or all if too few do."""
    chosen = rows if only is None else rows[only[rows]]
    return chosen if len(chosen) >= SMALLEST else rows


def _split(first: int, count: int) -> tuple[Tensor, Tensor]:
    """Of `count` rows from `first` on those that are trained on, and those held out."""
    order = first + torch.randperm(count)
    held = max(1, round(VALIDATION_SHARE * count))
    return order[held:], order[:held]


def standardised(name: str, values: Array, *, log: bool = False) -> Column:
    """How a quantity in units of similarity is standardised."""
    x = np.log(values) if log else values
    # a quantity that never changes stays at zero once standardised
    scale = float(x.std()) if np.ptp(x) > 0.0 else 1.0
    return Column(name=name, mean=float(x.mean()), scale=scale, log=log)


def huber(error: Tensor, large: float) -> Tensor:
    """Huber's (1964) loss, of slope 2 beyond `large`."""
    none = torch.zeros_like(error)
    return 2.0 / large * nn.functional.huber_loss(error, none, reduction="none", delta=large)


def rms(error: Tensor) -> float:
    """Root mean square length of rows [B, n]."""
    return float((error**2).sum(dim=1).mean().sqrt())


@contextmanager
def reproducible(seed: int, device: str = "cpu") -> Iterator[None]:
    """Seeded torch on a device, and on one thread, which is fastest for small networks; all put
    back after. On the CPU without torch.device, with which all operations go through Python."""
    threads, gpus = torch.get_num_threads(), [device] if device != "cpu" else []
    with torch.random.fork_rng(devices=gpus), torch.device(device) if gpus else nullcontext():
        torch.manual_seed(seed)
        torch.set_num_threads(1)
        try:
            yield
        finally:
            torch.set_num_threads(threads)


def export_onnx(
    network: nn.Module,
    path: Path,
    *,
    inputs: Mapping[str, Tensor],
    outputs: Sequence[str],
    metadata: Mapping[str, str],
) -> None:
    """Write a network, whose first axis is a batch of any size, with its metadata.

    Args:
        network: Takes the inputs in their order.
        path: File to write, not atomically.
        inputs: Examples by name.
        outputs: Names.
        metadata: Entries of the file.
    """
    with warnings.catch_warnings():
        # the exporter that torch recommends instead needs a further package
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            network,
            tuple(inputs.values()),
            str(path),
            input_names=list(inputs),
            output_names=list(outputs),
            dynamic_axes={name: {0: "batch"} for name in (*inputs, *outputs)},
            opset_version=OPSET,
            dynamo=False,
        )
    model = onnx.load(str(path))
    for key, value in metadata.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    onnx.checker.check_model(model)
    path.write_bytes(sealed(model.SerializeToString()))
