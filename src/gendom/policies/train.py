"""Training of policies on simulated demonstrations. Needs torch and onnx.

Two methods, both from goal and parameters to action:

* `inverse` is that of Kuroki et al. (2024): regress the action on goal and parameters by mean
  squared error. The minimiser of that error is the *mean* of all actions that lead to the goal.
  Two numbers of a release make one distance, so a whole curve of releases reaches each goal, and
  where the curve bends its mean lies beside it. No amount of data takes that error away.
* `distal` (default) follows Jordan and Rumelhart (1992), "Forward models: supervised learning
  with a distal teacher". First a forward model f(action, parameters) -> goal is fitted: that map
  is a function. Then the policy pi is trained through the frozen f to make f(pi(g, p), p) = g,
  so it may choose any action of the curve, and has no reason to average.

A forward model knows nothing where no demonstrations are, and a policy trained through it would
seek out such places. A pull brings actions that stray farther from the demonstrated ones than
these lie from each other back to the nearest.
"""

from __future__ import annotations

import logging
import os
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.policies.networks import ARCHITECTURES, PhysicalNetwork  # explains a missing torch

# isort: split
import onnx
import torch
from torch import Tensor, nn
from tqdm import tqdm

from gendom import __version__
from gendom.errors import PolicyError
from gendom.files import atomic_path
from gendom.policies.demonstrations import Demonstrations
from gendom.policies.policy import (
    METADATA_KEY,
    METHODS,
    PARAMETERS,
    Column,
    Description,
    GoalRange,
    Policy,
)

GOAL_BINS = 8
"""Bins of log specific modulus in which the range of goals is kept."""

GOAL_QUANTILE = 0.005
"""Share of the demonstrations in a bin that lie beyond each end of its range of goals."""

AGREEMENT = 1e-5
"""Largest difference allowed between onnxruntime and torch [rope lengths]."""

ANCHORS = 1024
"""Demonstrated actions, at most, that the pull looks for the nearest among."""

_OPSET = 17

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Training:
    """How to train.

    Raises:
        PolicyError: A value lies outside its range.
    """

    method: str = "distal"
    """"distal" or "inverse"; see the module's docstring."""
    conditioned_on: tuple[str, ...] = PARAMETERS
    """The parameters that the policy sees. The forward model that teaches it always sees all of
    them: they are those of the demonstration, and a policy that does not see them then learns
    the action that is best on average over them."""
    architecture: str = "smooth"
    """A key of `gendom.policies.networks.ARCHITECTURES`."""
    epochs: int = 300
    """Passes over the demonstrations, for each network."""
    batch_size: int = 256
    learning_rate: float = 4e-3
    """Peak of the learning rate, which then falls to zero along a cosine."""
    weight_decay: float = 1e-4
    pull: float = 1.0
    """Weight of the pull towards demonstrated actions, distal only."""
    validation_share: float = 0.1
    """Share of the demonstrations held out."""
    seed: int = 0
    """Fixes the held-out demonstrations, the initial weights and the order of the batches."""

    def __post_init__(self) -> None:
        _check_choice("method", self.method, METHODS)
        _check_choice("architecture", self.architecture, ARCHITECTURES)
        for name in self.conditioned_on:
            _check_choice("conditioned_on", name, PARAMETERS)
        for name in ("epochs", "batch_size", "learning_rate"):
            if not getattr(self, name) > 0:
                raise PolicyError(f"{name} must be positive, got {getattr(self, name)}")
        if not 0.0 < self.validation_share < 1.0:
            raise PolicyError(
                f"validation_share must lie between 0 and 1, got {self.validation_share}"
            )


def train(
    demonstrations: Demonstrations,
    path: str | os.PathLike,
    training: Training | None = None,
    *,
    progress: bool = False,
) -> Policy:
    """Train a policy and write it to `path`.

    The file appears once the policy is trained and onnxruntime has been seen to agree with torch;
    until then an older one stays. Equal demonstrations and settings give equal policies.

    Args:
        demonstrations: What to learn from.
        path: ONNX file to write.
        training: How to train.
        progress: Show progress bars on stderr.

    Returns:
        The policy as read back from the file; its description has the validation errors.

    Raises:
        PolicyError: The training diverged, or the exported network disagrees with the trained.
    """
    training = training or Training()
    began = time.monotonic()
    data = _tensors(demonstrations)
    sees = tuple(name for name in PARAMETERS if name in training.conditioned_on)
    columns = _columns(demonstrations)
    goal, actions = columns["goal"], [columns[name] for name in demonstrations.action_names]
    with _reproducible(training.seed):
        order = torch.randperm(len(demonstrations))
        held = max(1, round(training.validation_share * len(order)))
        validation, taught = order[:held], order[held:]
        policy = PhysicalNetwork(
            [goal, *(columns[n] for n in sees)], actions, training.architecture
        )

        def act(rows: Tensor) -> Tensor:
            return policy(data["goal"][rows], *(data[n][rows] for n in sees))

        if training.method == "inverse":
            errors = _train_inverse(policy, act, data, taught, validation, training, progress)
        else:
            teacher = PhysicalNetwork(
                [*actions, *(columns[n] for n in PARAMETERS)], [goal], training.architecture
            )
            errors = _train_distal(
                policy, act, teacher, data, taught, validation, training, progress
            )
        description = Description(
            task=demonstrations.task,
            method=training.method,
            conditioned_on=sees,
            inputs=(goal, *(columns[n] for n in sees)),
            outputs=tuple(actions),
            goals=goal_range(demonstrations),
            parameters={
                name: (float(column.min()), float(column.max()))
                for name in PARAMETERS
                for column in [getattr(demonstrations, name)]
            },
            training={
                **asdict(training),
                "demonstrations": len(demonstrations),
                "held_out": held,
                "errors": errors,
                "seconds": time.monotonic() - began,
                "gendom": __version__,
                "torch": str(torch.__version__),
            },
        )
        with torch.no_grad():
            expected = act(validation).numpy()
        return _export(policy, description, path, demonstrations, validation.numpy(), expected)


def goal_range(demonstrations: Demonstrations) -> GoalRange:
    """Outer quantiles of the goals in equally filled bins of specific modulus."""
    order = np.argsort(demonstrations.specific_modulus, kind="stable")
    parts = np.array_split(order, GOAL_BINS)
    outer = (GOAL_QUANTILE, 1.0 - GOAL_QUANTILE)
    ends = np.array([np.quantile(demonstrations.goal[part], outer) for part in parts])
    middle = [np.exp(np.mean(np.log(demonstrations.specific_modulus[part]))) for part in parts]
    return GoalRange(
        at=tuple(float(s) for s in middle),
        low=tuple(float(g) for g in ends[:, 0]),
        high=tuple(float(g) for g in ends[:, 1]),
    )


def _train_inverse(
    policy: PhysicalNetwork,
    act: Callable[[Tensor], Tensor],
    data: dict[str, Tensor],
    taught: Tensor,
    validation: Tensor,
    training: Training,
    progress: bool,
) -> dict[str, float]:
    def loss(rows: Tensor) -> Tensor:
        return (((act(rows) - data["action"][rows]) / policy.output_scale) ** 2).mean()

    _fit(policy, loss, taught, training, "policy" if progress else None)
    with torch.no_grad():
        return {"action_rms": _rms(act(validation) - data["action"][validation])}


def _train_distal(
    policy: PhysicalNetwork,
    act: Callable[[Tensor], Tensor],
    teacher: PhysicalNetwork,
    data: dict[str, Tensor],
    taught: Tensor,
    validation: Tensor,
    training: Training,
    progress: bool,
) -> dict[str, float]:
    def reached(action: Tensor, rows: Tensor) -> Tensor:
        return teacher(*action.split(1, dim=1), *(data[n][rows] for n in PARAMETERS))

    def model_loss(rows: Tensor) -> Tensor:
        error = reached(data["action"][rows], rows) - data["goal"][rows]
        return ((error / teacher.output_scale) ** 2).mean()

    _fit(teacher, model_loss, taught, training, "forward model" if progress else None)
    teacher.requires_grad_(False)
    stray = _Stray(data["action"][taught] / policy.output_scale)

    def policy_loss(rows: Tensor) -> Tensor:
        action = act(rows)
        error = (reached(action, rows) - data["goal"][rows]) / teacher.output_scale
        return (error**2).mean() + training.pull * stray(action / policy.output_scale)

    _fit(policy, policy_loss, taught, training, "policy" if progress else None)
    with torch.no_grad():
        action, goal = act(validation), data["goal"][validation]
        return {
            "forward_model_rms": _rms(reached(data["action"][validation], validation) - goal),
            "goal_rms": _rms(reached(action, validation) - goal),
        }


class _Stray:
    """Mean squared distance by which actions lie outside the demonstrated ones.

    Distances up to the usual gap between neighbouring demonstrations count as inside.

    Args:
        actions: [N, A] demonstrated actions, standardised.
    """

    def __init__(self, actions: Tensor):
        self._anchors = actions[torch.randperm(len(actions))[:ANCHORS]]
        between = torch.cdist(self._anchors, self._anchors)
        between.fill_diagonal_(torch.inf)
        self._gap = torch.quantile(between.min(dim=1).values, 0.95)

    def __call__(self, actions: Tensor) -> Tensor:
        # cdist has no gradient at distance zero, and only the nearest one is needed
        with torch.no_grad():
            nearest = self._anchors[torch.cdist(actions, self._anchors).argmin(dim=1)]
        distance = ((actions - nearest) ** 2).sum(dim=1).clamp_min(1e-12).sqrt()
        return (torch.relu(distance - self._gap) ** 2).mean()


def _fit(
    network: nn.Module,
    loss_of: Callable[[Tensor], Tensor],
    rows: Tensor,
    training: Training,
    label: str | None,
) -> None:
    """Minimise the mean of `loss_of` over batches of `rows`; a label shows a progress bar."""
    batch = min(training.batch_size, len(rows))
    steps = len(rows) // batch
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=training.learning_rate, weight_decay=training.weight_decay
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer,
        max_lr=training.learning_rate,
        total_steps=training.epochs * steps + 1,
        pct_start=0.1,
        cycle_momentum=False,
    )
    for epoch in tqdm(range(training.epochs), desc=label, unit="epoch", disable=label is None):
        shuffled = rows[torch.randperm(len(rows))]
        total = 0.0
        for part in shuffled[: steps * batch].split(batch):
            loss = loss_of(part)
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            schedule.step()
            total += loss.item()
        if not np.isfinite(total):
            raise PolicyError(
                f"training diverged in epoch {epoch + 1}", fix="lower the learning rate"
            )


def _export(
    policy: PhysicalNetwork,
    description: Description,
    path: str | os.PathLike,
    demonstrations: Demonstrations,
    rows: NDArray[np.int64],
    expected: NDArray[np.float32],
) -> Policy:
    """Write the file, after onnxruntime has given the `expected` actions for `rows`."""
    names = [column.name for column in description.inputs]
    example = tuple(torch.ones(2, 1) for _ in names)
    with atomic_path(Path(path)) as temporary:
        with warnings.catch_warnings():
            # the exporter that torch recommends instead needs a further package
            warnings.simplefilter("ignore", DeprecationWarning)
            torch.onnx.export(
                policy,
                example,
                str(temporary),
                input_names=names,
                output_names=["action"],
                dynamic_axes={name: {0: "batch"} for name in (*names, "action")},
                opset_version=_OPSET,
                dynamo=False,
            )
        model = onnx.load(str(temporary))
        entry = model.metadata_props.add()
        entry.key, entry.value = METADATA_KEY, description.to_json()
        onnx.checker.check_model(model)
        onnx.save(model, str(temporary))
        given = {name: getattr(demonstrations, name)[rows] for name in PARAMETERS}
        actions = Policy.read(temporary).actions(demonstrations.goal[rows], **given)
        worst = float(np.abs(actions - expected).max())
        if not worst < AGREEMENT:
            raise PolicyError(
                f"the exported network differs from the trained one by {worst:.3g} rope lengths",
                where=str(path),
                fix="report this, with the versions of torch and onnxruntime",
            )
    return Policy.read(path)


def _columns(demonstrations: Demonstrations) -> dict[str, Column]:
    """How each quantity is standardised, by name."""
    found = {"goal": _column("goal", "rope length", demonstrations.goal)}
    for i, name in enumerate(demonstrations.action_names):
        found[name] = _column(name, "rope length", demonstrations.action[:, i])
    found["specific_modulus"] = _column(
        "specific_modulus", "m^2/s^2", demonstrations.specific_modulus, log=True
    )
    found["poissons_ratio"] = _column("poissons_ratio", "1", demonstrations.poissons_ratio)
    return found


def _column(name: str, unit: str, values: NDArray[np.float64], *, log: bool = False) -> Column:
    x = np.log(values) if log else values
    # a quantity that never changes stays at zero once standardised
    scale = float(x.std()) if np.ptp(x) > 0.0 else 1.0
    return Column(name=name, unit=unit, mean=float(x.mean()), scale=scale, log=log)


def _tensors(demonstrations: Demonstrations) -> dict[str, Tensor]:
    """Columns as float32: [N, A] actions, [N, 1] of everything else."""
    data: dict[str, Any] = {"action": torch.tensor(demonstrations.action, dtype=torch.float32)}
    for name in ("goal", *PARAMETERS):
        values = getattr(demonstrations, name)
        data[name] = torch.tensor(values, dtype=torch.float32)[:, None]
    return data


def _rms(error: Tensor) -> float:
    return float((error**2).sum(dim=1).mean().sqrt())


@contextmanager
def _reproducible(seed: int) -> Iterator[None]:
    """Seeded torch on one thread, which is fastest for networks this small; all put back after."""
    threads = torch.get_num_threads()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        torch.set_num_threads(1)
        try:
            yield
        finally:
            torch.set_num_threads(threads)


def _check_choice(name: str, value: str, known: Sequence[str] | dict[str, Any]) -> None:
    if value not in known:
        raise PolicyError(f"{name} is {value!r}", fix=f"choose from {', '.join(known)}")
