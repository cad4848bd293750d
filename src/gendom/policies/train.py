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
these lie from each other back to the nearest. Where a task names a risk (rope reaching: falling out
of the plane), the forward model learns it too, and the policy is kept below its limit: beyond it
what is reached cannot be foretold.
"""

from __future__ import annotations

import logging
import math
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
from gendom.materials import PARAMETERS
from gendom.policies.demonstrations import SMALLEST, Demonstrations
from gendom.policies.policy import (
    GOAL,
    METADATA_KEY,
    METHODS,
    Column,
    Description,
    GoalRange,
    Policy,
)
from gendom.tasks import find_task

GOAL_BINS = 8
"""Bins of the parameter E in which the range of goals is kept."""

GOAL_QUANTILE = 0.005
"""Share of the demonstrations in a bin that lie beyond each end of its range of goals."""

AGREEMENT = 1e-5
"""Largest difference allowed between onnxruntime and torch [units of similarity]."""

ANCHORS = 1024
"""Demonstrated actions, at most, that the pull looks for the nearest among."""

RISK_FLOOR = 1e-5
"""Smaller risks are as good as none [units of similarity]."""

RISK_MARGIN = 0.5
"""How far below its limit a policy keeps the risk that is foretold, in powers of e."""

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
    conditioned_on: tuple[str, ...] | None = None
    """The parameters that the policy sees; None: all that vary. The forward model that teaches it
    always sees all of them: they are those of the demonstration, and a policy that does not see
    them then learns the action that is best on average over them."""
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
    caution: float = 1.0
    """Weight of the task's risk, distal only."""
    validation_share: float = 0.1
    """Share of the demonstrations held out."""
    seed: int = 0
    """Fixes the held-out demonstrations, the initial weights and the order of the batches."""

    def __post_init__(self) -> None:
        _check_choice("method", self.method, METHODS)
        _check_choice("architecture", self.architecture, ARCHITECTURES)
        for name in self.conditioned_on or ():
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
    varying = demonstrations.varying
    sees = varying if training.conditioned_on is None else training.conditioned_on
    sees = tuple(name for name in PARAMETERS if name in sees)
    if constant := [name for name in sees if name not in varying]:
        raise PolicyError(
            f"cannot be conditioned on {', '.join(constant)}: all demonstrations have the same",
            where=demonstrations.where,
            fix=f"choose from {', '.join(varying)}" if varying else "train it on none",
        )
    if training.method == "distal" and not demonstrations.goal_names:
        raise PolicyError(
            f"{demonstrations.task['name']} has no goals to teach through",
            where="method",
            fix="choose the method inverse",
        )
    made = _Made(demonstrations, sees, training)
    with _reproducible(training.seed):
        order = torch.randperm(len(demonstrations))
        held = max(1, round(training.validation_share * len(order)))
        validation, taught = order[:held], order[held:]
        made.start()
        if training.method == "inverse":
            errors = _train_inverse(made, taught, validation, progress)
        else:
            errors = _train_distal(made, taught, validation, progress)
        description = Description(
            task=demonstrations.task,
            method=training.method,
            conditioned_on=sees,
            inputs=tuple(made.inputs),
            outputs=tuple(made.actions),
            goals=goal_range(_steady(demonstrations)),
            parameters={
                name: (float(values.min()), float(values.max()))
                for name, values in demonstrations.parameters.items()
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
            expected = made.act(validation).numpy()
        return _export(made, description, path, demonstrations, validation.numpy(), expected)


def goal_range(demonstrations: Demonstrations) -> GoalRange:
    """Outer quantiles of the goals in equally filled bins of the parameter E."""
    E = demonstrations.parameters["E"]
    order = np.argsort(E, kind="stable")
    parts = [part for part in np.array_split(order, GOAL_BINS) if len(part)]
    outer = (GOAL_QUANTILE, 1.0 - GOAL_QUANTILE)
    low, high = np.array(
        [np.quantile(demonstrations.goal[part], outer, axis=0) for part in parts]
    ).transpose(1, 0, 2)
    middle = [np.exp(np.mean(np.log(E[part]))) for part in parts]
    return GoalRange(
        at=tuple(float(s) for s in middle),
        low=tuple(tuple(map(float, g)) for g in low),
        high=tuple(tuple(map(float, g)) for g in high),
    )


def _steady(demonstrations: Demonstrations) -> Demonstrations:
    """Those whose risk is within its limit."""
    risk = find_task(demonstrations.task["name"]).risk
    if risk is None or demonstrations.risk is None:
        return demonstrations
    within = demonstrations.risk <= risk.limit
    return demonstrations.chosen(within) if within.sum() >= SMALLEST else demonstrations


class _Made:
    """A policy in training: its data, columns and network."""

    def __init__(self, demonstrations: Demonstrations, sees: tuple[str, ...], training: Training):
        d = demonstrations
        self.training = training
        self.sees, self.varying = sees, d.varying
        self.goals = [_column(GOAL + name, d.goal[:, k]) for k, name in enumerate(d.goal_names)]
        self.actions = [_column(name, d.action[:, k]) for k, name in enumerate(d.action_names)]
        self.parameters = {
            name: _column(name, d.parameters[name], log=PARAMETERS[name].log) for name in d.varying
        }
        self.inputs = [*self.goals, *(self.parameters[name] for name in sees)]
        if not self.inputs:  # a policy that sees nothing still needs an input for its batch
            raise PolicyError(
                "has neither goals nor parameters to act on", fix="condition it on a parameter"
            )
        self.action = torch.tensor(d.action, dtype=torch.float32)
        self.goal = torch.tensor(d.goal, dtype=torch.float32)
        self.data = {
            name: torch.tensor(d.parameters[name], dtype=torch.float32)[:, None]
            for name in PARAMETERS
        }
        self.risk = find_task(d.task["name"]).risk
        self.log_risk = None
        if self.risk is not None and d.risk is not None:
            logs = np.log(np.maximum(d.risk, RISK_FLOOR))
            self.log_risk = torch.tensor(logs, dtype=torch.float32)[:, None]

    def start(self) -> None:
        """Make the network, once torch's seed is set."""
        self.policy = PhysicalNetwork(self.inputs, self.actions, self.training.architecture)

    def act(self, rows: Tensor) -> Tensor:
        """[B, A] what the policy does for some demonstrations' goals and objects."""
        goals = self.goal[rows].split(1, dim=1) if self.goals else ()
        return self.policy(*goals, *(self.data[name][rows] for name in self.sees))


def _train_inverse(
    made: _Made, taught: Tensor, validation: Tensor, progress: bool
) -> dict[str, float]:
    scale = made.policy.output_scale

    def loss(rows: Tensor) -> Tensor:
        return (((made.act(rows) - made.action[rows]) / scale) ** 2).mean()

    _fit(made.policy, loss, taught, made.training, "policy" if progress else None)
    with torch.no_grad():
        return {"action_rms": _rms(made.act(validation) - made.action[validation])}


def _train_distal(
    made: _Made, taught: Tensor, validation: Tensor, progress: bool
) -> dict[str, float]:
    training, G = made.training, len(made.goals)
    outputs = list(made.goals)
    target = made.goal
    if made.log_risk is not None:
        outputs.append(_column("risk", made.log_risk.numpy()[:, 0].astype(float)))
        target = torch.cat([made.goal, made.log_risk], dim=1)
    teacher = PhysicalNetwork(
        [*made.actions, *made.parameters.values()], outputs, training.architecture
    )

    def foretold(action: Tensor, rows: Tensor) -> Tensor:
        return teacher(*action.split(1, dim=1), *(made.data[n][rows] for n in made.varying))

    highest = math.log(made.risk.limit) if made.risk is not None else 0.0
    within = torch.ones(len(target), dtype=torch.bool)
    if made.log_risk is not None:
        within = made.log_risk[:, 0] <= highest
    # what is reached beyond the risk's limit is noise: only the risk itself is learnt there
    counts = torch.ones_like(target)
    counts[:, :G] = within[:, None].float()

    def model_loss(rows: Tensor) -> Tensor:
        error = (foretold(made.action[rows], rows) - target[rows]) / teacher.output_scale
        return (counts[rows] * error**2).mean()

    _fit(teacher, model_loss, taught, training, "forward model" if progress else None)
    teacher.requires_grad_(False)
    scale = made.policy.output_scale
    stray = _Stray(made.action[taught] / scale)
    steady = taught[within[taught]] if int(within[taught].sum()) >= SMALLEST else taught

    def policy_loss(rows: Tensor) -> Tensor:
        action = made.act(rows)
        found = foretold(action, rows)
        error = (found[:, :G] - made.goal[rows]) / teacher.output_scale[:G]
        loss = (error**2).mean() + training.pull * stray(action / scale)
        if made.log_risk is not None:
            beyond = torch.relu(found[:, G] - (highest - RISK_MARGIN))
            loss = loss + training.caution * (beyond**2).mean()
        return loss

    _fit(made.policy, policy_loss, steady, training, "policy" if progress else None)
    with torch.no_grad():
        rows = validation[within[validation]]
        if not len(rows):
            return {}
        known = foretold(made.action[rows], rows)[:, :G] - made.goal[rows]
        own = foretold(made.act(rows), rows)[:, :G] - made.goal[rows]
        return {"forward_model_rms": _rms(known), "goal_rms_by_forward_model": _rms(own)}


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
    for epoch in tqdm(
        range(training.epochs), desc=label, unit="epoch", disable=True if label is None else None
    ):
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
    made: _Made,
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
                made.policy,
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
        given = {name: demonstrations.parameters[name][rows] for name in made.sees}
        actions = Policy.read(temporary).actions(demonstrations.goal[rows], given)
        worst = float(np.abs(actions - expected).max())
        if not worst < AGREEMENT:
            raise PolicyError(
                f"the exported network differs from the trained one by {worst:.3g}",
                where=str(path),
                fix="report this, with the versions of torch and onnxruntime",
            )
    return Policy.read(path)


def _column(name: str, values: NDArray[np.float64], *, log: bool = False) -> Column:
    """How a quantity in units of similarity is standardised."""
    x = np.log(values) if log else values
    # a quantity that never changes stays at zero once standardised
    scale = float(x.std()) if np.ptp(x) > 0.0 else 1.0
    return Column(name=name, mean=float(x.mean()), scale=scale, log=log)


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
