"""Fitting networks and writing them to ONNX, for policies and estimators alike.

Needs torch and onnx.
"""

from __future__ import annotations

import json
import time
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gendom.errors import GendomError
from gendom.files import atomic_path
from gendom.installation import how_to_install

try:
    import torch
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError(
        f"training needs torch; install it with: {how_to_install('train')}", name=missing.name
    ) from missing
import onnx
from torch import Tensor, nn

OPSET = 17

STORE_EVERY = 20.0
"""Between two checkpoints [s]."""


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """AdamW under one cycle of the learning rate: a short rise, then a cosine to zero."""

    epochs: int
    batch_size: int
    learning_rate: float
    """At its peak."""
    weight_decay: float


@dataclass(frozen=True, kw_only=True)
class Epoch:
    """How a fit stands."""

    done: int
    of: int
    loss: float
    """Mean over the epoch's batches."""
    held_out: float | None
    """Loss of what is not trained on."""


class Checkpoint:
    """Fits that were interrupted, in one ``.npz`` beside the file that they will give.

    Args:
        path: The file.
        identity: What is trained on what; a checkpoint of anything else is not used.
    """

    def __init__(self, path: Path, identity: Mapping[str, Any]):
        self.path = path
        self._identity = json.dumps(identity, sort_keys=True, default=str)
        self._arrays: dict[str, np.ndarray] = {}
        self._stored = time.monotonic()
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
        except (OSError, ValueError, zipfile.BadZipFile):
            return
        if str(arrays.pop("identity", "")) == self._identity:
            self._arrays = arrays

    def store(
        self, stage: str, done: int, network: nn.Module, optimizer: torch.optim.Optimizer
    ) -> None:
        """Keep the state after some epochs of a stage; `write` it every `STORE_EVERY`."""
        kept = {f"{stage}/done": np.array(done), f"{stage}/rng": torch.get_rng_state().numpy()}
        for name, value in network.state_dict().items():
            kept[f"{stage}/network/{name}"] = value.detach().numpy().copy()
        for number, state in optimizer.state_dict()["state"].items():
            for name, value in state.items():
                kept[f"{stage}/optimizer/{number}/{name}"] = value.numpy().copy()
        self._arrays |= kept
        if time.monotonic() - self._stored >= STORE_EVERY:
            self.write()

    def remember(self, name: str, tensors: Mapping[str, Tensor]) -> None:
        """Keep what took long to make, and write it."""
        kept = {f"{name}/kept/{key}": value.numpy().copy() for key, value in tensors.items()}
        self._arrays |= kept
        self.write()

    def recall(self, name: str) -> dict[str, Tensor] | None:
        """What was kept by that name."""
        start = f"{name}/kept/"
        return {
            key.removeprefix(start): torch.from_numpy(value)
            for key, value in self._arrays.items()
            if key.startswith(start)
        } or None

    def write(self) -> None:
        """Put what was kept on disk."""
        with atomic_path(self.path) as temporary, open(temporary, "wb") as file:
            np.savez(file, identity=np.array(self._identity), **self._arrays)  # pyright: ignore
        self._stored = time.monotonic()

    def restore(self, stage: str, network: nn.Module, optimizer: torch.optim.Optimizer) -> int:
        """Bring a stage to where it was stored; the number of epochs that are done."""
        if f"{stage}/done" not in self._arrays:
            return 0
        own = {
            name.removeprefix(f"{stage}/"): torch.from_numpy(value)
            for name, value in self._arrays.items()
            if name.startswith(f"{stage}/")
        }
        network.load_state_dict(
            {n.removeprefix("network/"): v for n, v in own.items() if n.startswith("network/")}
        )
        states: dict[int, dict[str, Tensor]] = {}
        for name, value in own.items():
            if name.startswith("optimizer/"):
                _, number, key = name.split("/")
                states.setdefault(int(number), {})[key] = value
        optimizer.load_state_dict({**optimizer.state_dict(), "state": states})
        torch.set_rng_state(own["rng"])
        return int(own["done"])

    def clear(self) -> None:
        """Once everything is done."""
        self.path.unlink(missing_ok=True)


def fit(
    network: nn.Module,
    loss_of: Callable[[Tensor], Tensor],
    rows: Tensor,
    settings: FitSettings,
    *,
    held_out: Tensor | None = None,
    on_epoch: Callable[[Epoch], None] | None = None,
    stage: str = "fit",
    checkpoint: Checkpoint | None = None,
    error: type[GendomError] = GendomError,
) -> None:
    """Minimise the mean of `loss_of` over batches of `rows`.

    Args:
        network: What is trained.
        loss_of: Loss of some rows [B].
        rows: [N] indices to train on.
        settings: How.
        held_out: [H] indices whose loss is only reported.
        on_epoch: Called after each epoch.
        stage: Name in the checkpoint.
        checkpoint: Keeps the state, so that an interrupted fit goes on as if it had not been.
        error: What to raise.

    Raises:
        GendomError: It diverged; of the class `error`.
    """
    batch = min(settings.batch_size, len(rows))
    steps = len(rows) // batch
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer,
        max_lr=settings.learning_rate,
        total_steps=settings.epochs * steps + 1,
        pct_start=0.1,
        cycle_momentum=False,
    )
    begun = 0 if checkpoint is None else checkpoint.restore(stage, network, optimizer)
    if begun:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # steps of the schedule without the optimizer's
            for _ in range(begun * steps):
                schedule.step()
    try:
        for epoch in range(begun, settings.epochs):
            shuffled = rows[torch.randperm(len(rows))]
            total = 0.0
            for part in shuffled[: steps * batch].split(batch):
                loss = loss_of(part)
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(network.parameters(), 1.0)
                optimizer.step()
                schedule.step()
                total += loss.item() / steps
            if not np.isfinite(total):
                raise error(
                    f"training diverged in epoch {epoch + 1}", fix="lower the learning rate"
                )
            if checkpoint is not None:
                checkpoint.store(stage, epoch + 1, network, optimizer)
            if on_epoch is not None:
                aside = None
                if held_out is not None and len(held_out):
                    with torch.no_grad():
                        aside = float(loss_of(held_out))
                on_epoch(Epoch(done=epoch + 1, of=settings.epochs, loss=total, held_out=aside))
    except KeyboardInterrupt:
        if checkpoint is not None:
            checkpoint.write()
        raise


@contextmanager
def reproducible(seed: int) -> Iterator[None]:
    """Seeded torch on one thread, which is fastest for small networks; all put back after."""
    threads = torch.get_num_threads()
    with torch.random.fork_rng(devices=[]):
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
    onnx.save(model, str(path))
