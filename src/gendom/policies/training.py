"""Training of policies on demonstrations. Needs torch and onnx.

From goal and parameters to action, by one of `gendom.policies.methods`.
"""

from __future__ import annotations

import logging
import os
import time
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gendom.policies.fitting import (  # explains a missing torch
    Training,
    TrainingProblem,
    export_onnx,
    reproducible,
)

# isort: split
import torch

from gendom import __version__
from gendom.arguments import require
from gendom.errors import PolicyError
from gendom.files import atomic_path
from gendom.materials import PARAMETERS
from gendom.policies import methods
from gendom.policies.demonstrations import SMALLEST, Demonstrations
from gendom.policies.evaluation import score
from gendom.policies.policy import METADATA_KEY, Description, GoalRange, Policy
from gendom.policies.refining import refine
from gendom.tasks import find_task, rebuild
from gendom.tasks.cases import draw_cases
from gendom.tasks.task import World
from gendom.tasks.world import Simulation

_log = logging.getLogger(__name__)

GOAL_BINS = 8
"""Bins of the parameter E in which the range of goals is kept."""

GOAL_QUANTILE = 0.005
"""Share of the demonstrations in a bin that lie beyond each end of its range of goals."""

CHECKED = 1000
"""Demonstrations, at most, for which onnxruntime is compared with torch."""

AGREEMENT = 1e-5
"""Largest difference allowed between onnxruntime and torch [units of similarity]; ten times that of
probabilities."""


def train(
    demonstrations: Demonstrations,
    path: str | os.PathLike,
    training: Training | None = None,
    *,
    finetune: Demonstrations | None = None,
    world: World | None = None,
    cases: int = 0,
    device: str = "cpu",
    progress: bool = False,
) -> Policy:
    """Train a policy and write it to `path`.

    The file appears once the policy is trained and onnxruntime has been seen to agree with torch;
    until then an older one stays. Equal demonstrations and settings give equal policies.

    Args:
        demonstrations: What to learn from.
        path: ONNX file to write.
        training: How to train.
        finetune: Other demonstrations of the task, such as real ones, that everything is fitted to
            once more; columns stay standardised as the first ones are.
        world: Where it acts to be refined and judged (default: our simulator).
        cases: New ones that it acts in afterwards; its file has the errors (`Score.summary`).
        device: Of torch, where networks are trained; the CPU if this torch knows no other.
        progress: Show progress bars on stderr.

    Returns:
        The policy as read back from the file; its description has the validation errors.

    Raises:
        PolicyError: The training diverged, the demonstrations do not fit each other or the
            settings, or the exported network disagrees with the trained.
    """
    training, world, path = training or Training(), world or Simulation(), Path(path)
    began = time.monotonic()
    given = len(demonstrations) + demonstrations.failed
    if not demonstrations.goal_names and training.method != "chance":
        demonstrations = _within_risk(demonstrations)  # a failed action reaches no other goal
    sees = _seen(demonstrations, training)
    task = rebuild(demonstrations.task)
    _check_alike(demonstrations, finetune, training)
    if device != "cpu" and not torch.cuda.is_available():
        _log.warning("torch has no CUDA: networks are trained on the CPU")
        device = "cpu"
    with reproducible(training.seed, device):
        problem = TrainingProblem(demonstrations, sees, training, finetune=finetune, shown=progress)
        refining = partial(refine, problem, task, world) if training.refine else dict
        errors = getattr(methods, training.method)(problem, refining)
    figures = {
        **asdict(training),
        "demonstrations": given,
        "failed": given - len(demonstrations),
        "refined_in": world.settings() if training.refine else None,
        "finetuned_on": 0 if finetune is None else len(finetune),
        "held_out": len(problem.held_out),
        "errors": errors,
        "seconds": time.monotonic() - began,
        "gendom": __version__,
        "torch": str(torch.__version__),
    }
    return _written(problem, _described(problem, demonstrations, figures), path, cases, world)


def _described(
    problem: TrainingProblem, demonstrations: Demonstrations, figures: dict[str, Any]
) -> Description:
    """What the file says of a trained policy."""
    every = demonstrations.parameters.items()
    return Description(
        task=demonstrations.task,
        method=problem.training.method,
        conditioned_on=problem.sees,
        inputs=tuple(problem.inputs),
        outputs=tuple(problem.actions),
        goals=goal_range(_within_risk(demonstrations)),
        parameters={name: (float(values.min()), float(values.max())) for name, values in every},
        candidates=problem.candidates if problem.chooses else (),
        training=figures,
    )


def goal_range(demonstrations: Demonstrations) -> GoalRange:
    """Outer quantiles of the goals in equally filled bins of the parameter E."""
    E = demonstrations.parameters["bending_ratio"]
    parts = np.array_split(np.argsort(E, kind="stable"), GOAL_BINS)
    parts = [part for part in parts if len(part)]
    outer = (GOAL_QUANTILE, 1.0 - GOAL_QUANTILE)
    ends = [np.quantile(demonstrations.goal[part], outer, axis=0).tolist() for part in parts]
    middles = np.exp([np.mean(np.log(E[part])) for part in parts])
    return GoalRange(
        at=tuple(np.maximum.accumulate(middles).tolist()),  # of one object they differ by rounding
        low=tuple(tuple(low) for low, _ in ends),
        high=tuple(tuple(high) for _, high in ends),
    )


def _seen(demonstrations: Demonstrations, training: Training) -> tuple[str, ...]:
    """Parameters that the policy sees."""
    varying = demonstrations.varying
    sees = varying if training.conditioned_on is None else training.conditioned_on
    sees = tuple(name for name in PARAMETERS if name in sees)
    constant = [name for name in sees if name not in varying]
    what = f"cannot be conditioned on {', '.join(constant)}: all demonstrations have the same"
    fix = f"choose from {', '.join(varying)}" if varying else "train it on none"
    require(not constant, what, where=demonstrations.where, fix=fix, error=PolicyError)
    return sees


def _check_alike(
    demonstrations: Demonstrations, finetune: Demonstrations | None, training: Training
) -> None:
    """Refuse to refine without goals, and to fine-tune on another task."""
    goals = ", ".join(demonstrations.goal_names)
    what = f"{demonstrations.task['name']} has no goals that a policy could be refined for"
    fix, possible = "give 0 rounds", bool(goals) or not training.refine
    require(possible, what, where="refine", fix=fix, error=PolicyError)
    if finetune is None:
        return
    own, other = (
        f"{d.task['name']} ({', '.join((*d.action_names, *d.goal_names))})"
        for d in (demonstrations, finetune)
    )
    what, fix = f"is of {other}, the demonstrations are of {own}", "give those of the same task"
    require(own == other, what, where=finetune.where or "finetune", fix=fix, error=PolicyError)


def _within_risk(demonstrations: Demonstrations) -> Demonstrations:
    """Those whose risk is within its limit."""
    risk = find_task(demonstrations.task["name"]).risk
    if risk is None or demonstrations.risk is None:
        return demonstrations
    within = demonstrations.risk <= risk.limit
    return demonstrations.chosen(within) if within.sum() >= SMALLEST else demonstrations


def _written(
    problem: TrainingProblem, description: Description, path: Path, cases: int, world: World
) -> Policy:
    """Write the file, once onnxruntime gives the trained network's actions."""
    rows = problem.trained[:CHECKED]
    with torch.no_grad():
        expected = problem.act(rows).cpu().numpy()
    given = {n: problem.data[n][rows, 0].cpu().numpy().astype(float) for n in problem.sees}
    goal, action = (values[rows].cpu().numpy() for values in (problem.goal, problem.action))
    problem.policy.cpu()
    with atomic_path(path) as temporary:

        def export(about: Description) -> Policy:
            inputs = {c.name: torch.ones(2, 1) for c in about.inputs}
            outputs = ("chance" if problem.chooses else "action",)
            metadata = {METADATA_KEY: about.to_json()}
            export_onnx(
                problem.policy, temporary, inputs=inputs, outputs=outputs, metadata=metadata
            )
            return Policy.read(temporary)

        policy = export(description)
        if problem.chooses:
            found = policy.chances(action, given)[:, None]
        else:
            found = policy.actions(goal, given)
        worst = float(np.abs(found - expected).max())
        what = f"the exported network differs from the trained one by {worst:.3g}"
        fix = "report this, with the versions of torch and onnxruntime"
        most = AGREEMENT * (10.0 if problem.chooses else 1.0)
        require(worst < most, what, where=str(path), fix=fix, error=PolicyError)
        if cases:
            seed = problem.training.seed
            drawn = draw_cases(policy.task(), cases, seed=seed, simulation=world)
            acted = score(policy, drawn, world=world).summary()
            export(replace(description, training={**description.training, "acted": acted}))
    return Policy.read(path)
