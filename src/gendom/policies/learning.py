"""Fitting networks, keeping what is fitted, and writing networks to ONNX.

Needs torch and onnx.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.errors import PolicyError
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


class Checkpoint:
    """Stages of a training that are done, in one file beside the one that it will give.

    Args:
        path: The file.
        identity: What is trained on what; a checkpoint of anything else is not used.
    """

    def __init__(self, path: Path, identity: Mapping[str, Any]):
        self.path = path
        self._identity = json.dumps(identity, sort_keys=True, default=str)
        self._stages: dict[str, dict[str, Any]] = {}
        try:
            kept = torch.load(path, weights_only=True)
            self._stages = kept["stages"] if kept["identity"] == self._identity else {}
        except Exception:  # whatever torch raises for a file that is missing, cut or another's
            return

    def remembered(self, stage: str, make: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
        """What a stage gives: kept from before, or made now and written; random draws go on as
        after it."""
        if stage not in self._stages:
            self._stages[stage] = {"made": make(), "rng": torch.get_rng_state()}
            with atomic_path(self.path) as temporary:
                torch.save({"identity": self._identity, "stages": self._stages}, temporary)
        kept = self._stages[stage]
        torch.set_rng_state(kept["rng"])
        return kept["made"]

    def fitted(self, stage: str, network: nn.Module, fit: Callable[[], None]) -> None:
        """Fit a network, or bring it to where that ended before.

        Raises:
            PolicyError: What is kept is of another network, or not finite.
        """

        def made() -> dict[str, Tensor]:
            fit()
            return {name: value.clone() for name, value in network.state_dict().items()}

        known = stage in self._stages
        try:
            network.load_state_dict(self.remembered(stage, made))
            finite = all(value.isfinite().all() for value in network.state_dict().values())
            fault = "" if finite else "numbers that are not finite"
        except (AttributeError, KeyError, RuntimeError, TypeError) as error:
            if not known:
                raise
            fault = " ".join(f"{type(error).__name__} {error}".split())
        what, fix = f"cannot be resumed from ({stage}: {fault})", "delete it, and train again"
        require(not fault, what, where=str(self.path), fix=fix, error=PolicyError)

    def clear(self) -> None:
        """Once everything is done."""
        self.path.unlink(missing_ok=True)


def fit(
    network: nn.Module,
    loss_of: Callable[[Tensor], Tensor],
    rows: Tensor,
    *,
    epochs: int,
    batch_size: int,
    learning_rate: float,
    weight_decay: float,
    held_out: Tensor | None = None,
    on_epoch: Callable[[int, float, float | None], None] | None = None,
) -> None:
    """Minimise the mean of `loss_of` over batches of `rows` by AdamW, whose learning rate rises
    shortly, then falls to zero along a cosine.

    Args:
        network: What is trained.
        loss_of: Loss of some rows [B].
        rows: [N] indices to train on.
        epochs: Passes over them.
        batch_size: B, at most.
        learning_rate: At its peak.
        weight_decay: AdamW's.
        held_out: [H] indices whose loss is only reported.
        on_epoch: Called after each epoch with how many are done, its mean loss and that of what is
            held out.

    Raises:
        PolicyError: It diverged.
    """
    batch = min(batch_size, len(rows))
    steps = len(rows) // batch
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=learning_rate, weight_decay=weight_decay, fused=True
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer,
        max_lr=learning_rate,
        total_steps=epochs * steps + 1,
        pct_start=0.1,
        cycle_momentum=False,
    )
    for epoch in range(1, epochs + 1):
        total = 0.0
        for part in rows[torch.randperm(len(rows))][: steps * batch].split(batch):
            loss = loss_of(part)
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            schedule.step()
            total += loss.item() / steps
        what, fix = f"training diverged in epoch {epoch}", "lower the learning rate"
        require(np.isfinite(total), what, fix=fix, error=PolicyError)
        if on_epoch is not None:
            with torch.no_grad():
                known = None if held_out is None else float(loss_of(held_out))
            on_epoch(epoch, total, known)


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
