"""Fitting networks, keeping interrupted fits, and writing networks to ONNX.

Needs torch and onnx.
"""

from __future__ import annotations

import copy
import json
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.errors import GendomError, PolicyError
from gendom.files import atomic_path
from gendom.installation import how_to_install
from gendom.policies.graph import sealed

try:
    import torch
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError(
        f"training needs torch; install it with: {how_to_install('train')}", name=missing.name
    ) from missing
import onnx
from torch import Tensor, nn

OPSET = 17

WRITE_INTERVAL = 20.0
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
    """Fits that were interrupted, in one file beside the one that they will give.

    Args:
        path: The file.
        identity: What is trained on what; a checkpoint of anything else is not used.
    """

    def __init__(self, path: Path, identity: Mapping[str, Any]):
        self.path = path
        self._identity = json.dumps(identity, sort_keys=True, default=str)
        self._stages: dict[str, dict[str, Any]] = {}
        self._tensors: dict[str, dict[str, Tensor]] = {}
        self._written = time.monotonic()
        try:
            kept = torch.load(path, weights_only=True)
            mine = kept["identity"] == self._identity
        except Exception:  # whatever torch raises for a file that is missing, cut or another's
            return
        if mine:
            self._stages, self._tensors = kept["stages"], kept["tensors"]

    def store(
        self, stage: str, done: int, network: nn.Module, optimizer: torch.optim.Optimizer
    ) -> None:
        """Keep the state after some epochs of a stage; `write` it every `WRITE_INTERVAL`."""
        state = {
            "done": done,
            "rng": torch.get_rng_state(),
            "network": network.state_dict(),
            "optimizer": optimizer.state_dict()["state"],
        }
        self._stages[stage] = copy.deepcopy(state)
        if time.monotonic() - self._written >= WRITE_INTERVAL:
            self.write()

    def restore(self, stage: str, network: nn.Module, optimizer: torch.optim.Optimizer) -> int:
        """Bring a stage to where it was stored; the number of epochs that are done.

        Raises:
            PolicyError: What is stored is of another network, or not finite.
        """
        if (kept := self._stages.get(stage)) is None:
            return 0
        try:
            network.load_state_dict(kept["network"])
            optimizer.load_state_dict({**optimizer.state_dict(), "state": kept["optimizer"]})
            torch.set_rng_state(kept["rng"])
            averages = [(p, optimizer.state[p]["exp_avg_sq"]) for p in network.parameters()]
            alike = all(p.shape == a.shape and a.isfinite().all() for p, a in averages)
            finite = all(value.isfinite().all() for value in network.state_dict().values())
            fault = "" if alike and finite else "numbers that are not finite, or too few"
            done = int(kept["done"])
        except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
            fault, done = " ".join(f"{type(error).__name__} {error}".split()), 0
        what, fix = f"cannot be resumed from ({stage}: {fault})", "delete it, and train again"
        require(not fault, what, where=str(self.path), fix=fix, error=PolicyError)
        return done

    def remembered(self, name: str, make: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
        """Tensors that take long to make: those kept by that name, or made now and written."""
        if name not in self._tensors:
            self._tensors[name] = make()
            self.write()
        return self._tensors[name]

    def write(self) -> None:
        """Put what was kept on disk."""
        kept = {"identity": self._identity, "stages": self._stages, "tensors": self._tensors}
        with atomic_path(self.path) as temporary:
            torch.save(kept, temporary)
        self._written = time.monotonic()

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
            total = 0.0
            for part in rows[torch.randperm(len(rows))][: steps * batch].split(batch):
                loss = loss_of(part)
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(network.parameters(), 1.0)
                optimizer.step()
                schedule.step()
                total += loss.item() / steps
            what = f"training diverged in epoch {epoch + 1}"
            require(np.isfinite(total), what, fix="lower the learning rate", error=error)
            if checkpoint is not None:
                checkpoint.store(stage, epoch + 1, network, optimizer)
            if on_epoch is not None:
                known = _held_out_loss(loss_of, held_out)
                on_epoch(Epoch(done=epoch + 1, of=settings.epochs, loss=total, held_out=known))
    except KeyboardInterrupt:
        if checkpoint is not None:
            checkpoint.write()
        raise


def _held_out_loss(loss_of: Callable[[Tensor], Tensor], rows: Tensor | None) -> float | None:
    if rows is None or not len(rows):
        return None
    with torch.no_grad():
        return float(loss_of(rows))


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
    path.write_bytes(sealed(model.SerializeToString()))
