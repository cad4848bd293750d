"""What every way to teach a policy is given: data, columns, network, fits. Needs torch."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gendom.errors import PolicyError
from gendom.learning import Checkpoint, Epoch, FitSettings, fit  # explains a missing torch

# isort: split
import torch
from torch import Tensor, nn

from gendom.materials import PARAMETERS
from gendom.policies.demonstrations import SMALLEST, Demonstrations, joined
from gendom.policies.networks import PhysicalNetwork
from gendom.policies.policy import GOAL, Column
from gendom.tasks import find_task

if TYPE_CHECKING:
    from gendom.policies.training import Training

RISK_FLOOR = 1e-5
"""Smaller risks count as zero [units of similarity]."""

RISK_MARGIN = 0.5
"""How far below its limit a policy keeps the risk that is predicted, in powers of e."""


@dataclass(frozen=True, kw_only=True)
class Split:
    """Rows to teach, and rows held out."""

    taught: Tensor
    held_out: Tensor

    @classmethod
    def drawn(cls, first: int, count: int, share: float) -> Split:
        """Of `count` rows from `first` on."""
        order = first + torch.randperm(count)
        held = max(1, round(share * count))
        return cls(taught=order[held:], held_out=order[:held])


class Lesson:
    """A policy in training.

    Args:
        demonstrations: What to learn from.
        sees: Parameters that the policy sees.
        training: How.
        finetune: Demonstrations that everything is fitted to once more at the end.
        observe: Called with the name of a fit and how it stands after each epoch.
        checkpoint: Where interrupted fits are kept.
    """

    def __init__(
        self,
        demonstrations: Demonstrations,
        sees: tuple[str, ...],
        training: Training,
        *,
        finetune: Demonstrations | None = None,
        observe: Callable[[str, Epoch], None] | None = None,
        checkpoint: Checkpoint | None = None,
    ):
        d = demonstrations
        self.training = training
        self.task_name = d.task["name"]
        self.sees = sees
        self.goals = [
            standardised(GOAL + name, d.goal[:, k]) for k, name in enumerate(d.goal_names)
        ]
        self.actions = [standardised(name, d.action[:, k]) for k, name in enumerate(d.action_names)]
        self.parameters = {
            name: standardised(name, d.parameters[name], log=PARAMETERS[name].log)
            for name in d.varying
        }
        self.inputs = [*self.goals, *(self.parameters[name] for name in sees)]
        if not self.inputs:  # a policy that sees nothing still needs an input for its batch
            raise PolicyError(
                "has neither goals nor parameters to act on", fix="condition it on a parameter"
            )
        self._simulated = Split.drawn(0, len(d), training.validation_share)
        self._real = None
        if finetune is not None:
            self._real = Split.drawn(len(d), len(finetune), training.validation_share)
            d = joined(d, finetune)
        self.action = torch.tensor(d.action, dtype=torch.float32)
        self.goal = torch.tensor(d.goal, dtype=torch.float32)
        self.data = {
            name: torch.tensor(d.parameters[name], dtype=torch.float32)[:, None]
            for name in PARAMETERS
        }
        self.risk = find_task(self.task_name).risk
        self.log_risk = None
        if self.risk is not None and d.risk is not None:
            logs = np.log(np.maximum(d.risk, RISK_FLOOR))
            self.log_risk = torch.tensor(logs, dtype=torch.float32)[:, None]
        self.highest = math.log(self.risk.limit) if self.risk is not None else 0.0
        """Logarithm of the risk's limit."""
        self.within = torch.ones(len(d), dtype=torch.bool)
        """[N] which demonstrations' risk is within it."""
        if self.log_risk is not None:
            self.within = self.log_risk[:, 0] <= self.highest
        self.policy = PhysicalNetwork(self.inputs, self.actions, training.architecture)
        self._observe, self._checkpoint = observe, checkpoint

    @property
    def taught(self) -> Tensor:
        """Rows of the demonstrations that are learnt from first."""
        return self._simulated.taught

    @property
    def held_out(self) -> Tensor:
        """Rows that nothing is learnt from: of those for fine-tuning, if there are."""
        return (self._real or self._simulated).held_out

    def act(self, rows: Tensor) -> Tensor:
        """[B, A] what the policy does for some demonstrations' goals and objects."""
        goals = self.goal[rows].split(1, dim=1) if self.goals else ()
        return self.policy(*goals, *(self.data[name][rows] for name in self.sees))

    def caution(self, log_risk: Tensor) -> Tensor:
        """Loss of risks [B], given by their logarithms, that are near the limit or beyond."""
        beyond = torch.relu(log_risk - (self.highest - RISK_MARGIN))
        return self.training.caution * (beyond**2).mean()

    def remembered(self, name: str, make: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
        """Tensors that an interrupted training need not make again."""
        if self._checkpoint is None:
            return make()
        if (kept := self._checkpoint.recall(name)) is None:
            kept = make()
            self._checkpoint.remember(name, kept)
        return kept

    def fit(
        self,
        name: str,
        network: nn.Module,
        loss_of: Callable[[Tensor], Tensor],
        *,
        only: Tensor | None = None,
    ) -> None:
        """Fit a network to the demonstrations, and then to those for fine-tuning.

        Args:
            name: For people and for the checkpoint.
            network: What is trained.
            loss_of: Loss of some rows.
            only: [N] which rows count, bool; all if it leaves too few.

        Raises:
            PolicyError: It diverged.
        """
        training = self.training
        settings = FitSettings(
            epochs=training.epochs,
            batch_size=training.batch_size,
            learning_rate=training.learning_rate,
            weight_decay=training.weight_decay,
        )
        self._fit(name, network, loss_of, self._simulated, only, settings)
        if self._real is None:
            return
        settings = replace(
            settings,
            epochs=training.finetune_epochs,
            learning_rate=training.finetune_learning_rate,
        )
        self._fit(f"{name}, fine-tuned", network, loss_of, self._real, only, settings)

    def _fit(
        self,
        name: str,
        network: nn.Module,
        loss_of: Callable[[Tensor], Tensor],
        split: Split,
        only: Tensor | None,
        settings: FitSettings,
    ) -> None:
        taught, held_out = split.taught, split.held_out
        if only is not None:
            chosen = taught[only[taught]]
            taught = chosen if len(chosen) >= SMALLEST else taught
            held_out = held_out[only[held_out]]

        self.fit_to(name, network, loss_of, taught, settings, held_out=held_out)

    def fit_to(
        self,
        name: str,
        network: nn.Module,
        loss_of: Callable[[Tensor], Tensor],
        rows: Tensor,
        settings: FitSettings,
        *,
        held_out: Tensor | None = None,
    ) -> None:
        """Fit a network to rows of any kind.

        Args:
            name: For people and for the checkpoint.
            network: What is trained.
            loss_of: Loss of some rows.
            rows: [M] all of them.
            settings: How.
            held_out: Rows whose loss is only reported.

        Raises:
            PolicyError: It diverged.
        """

        def observe(epoch: Epoch) -> None:
            if self._observe is not None:
                self._observe(name, epoch)

        fit(
            network,
            loss_of,
            rows,
            settings,
            held_out=held_out,
            on_epoch=observe,
            stage=name,
            checkpoint=self._checkpoint,
            error=PolicyError,
        )


def standardised(name: str, values: NDArray[np.float64], *, log: bool = False) -> Column:
    """How a quantity in units of similarity is standardised."""
    x = np.log(values) if log else values
    # a quantity that never changes stays at zero once standardised
    scale = float(x.std()) if np.ptp(x) > 0.0 else 1.0
    return Column(name=name, mean=float(x.mean()), scale=scale, log=log)


def huber(error: Tensor, large: float) -> Tensor:
    """Huber's (1964) loss, of slope 2 beyond `large`."""
    size = error.abs()
    return torch.where(size < large, size**2 / large, 2.0 * size - large)


def rms(error: Tensor) -> float:
    """Root mean square length of rows [B, n]."""
    return float((error**2).sum(dim=1).mean().sqrt())
