"""Training of policies on demonstrations. Needs torch and onnx.

From goal and parameters to action, by one of `gendom.policies.methods`.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gendom.policies.learning import (  # explains a missing torch
    Checkpoint,
    Epoch,
    export_onnx,
    reproducible,
)

# isort: split
import onnx
import torch

from gendom import __version__
from gendom.arguments import require
from gendom.errors import PolicyError
from gendom.files import atomic_path
from gendom.materials import PARAMETERS
from gendom.policies import methods
from gendom.policies.demonstrations import SMALLEST, Demonstrations
from gendom.policies.fitting import Training, TrainingProblem
from gendom.policies.graph import sealed
from gendom.policies.policy import METADATA_KEY, Description, GoalRange, Policy
from gendom.policies.refining import refine
from gendom.progress import Show, bar
from gendom.tasks import Task, find_task, rebuild
from gendom.tasks.task import World
from gendom.tasks.world import Simulation

GOAL_BINS = 8
"""Bins of the parameter E in which the range of goals is kept."""

GOAL_QUANTILE = 0.005
"""Share of the demonstrations in a bin that lie beyond each end of its range of goals."""

AGREEMENT = 1e-5
"""Largest difference allowed between onnxruntime and torch [units of similarity]."""


def train(
    demonstrations: Demonstrations,
    path: str | os.PathLike,
    training: Training | None = None,
    *,
    finetune: Demonstrations | None = None,
    world: World | None = None,
    progress: bool = False,
    tensorboard: str | os.PathLike | None = None,
) -> Policy:
    """Train a policy and write it to `path`.

    The file appears once the policy is trained and onnxruntime has been seen to agree with torch;
    until then an older one stays. Equal demonstrations and settings give equal policies. What was
    interrupted continues from a checkpoint beside the file, to the same policy.

    Args:
        demonstrations: What to learn from.
        path: ONNX file to write.
        training: How to train.
        finetune: Other demonstrations of the task, such as real ones, that everything is fitted to
            once more; columns stay standardised as the first ones are.
        world: Where a policy that is refined acts (default: our simulator).
        progress: Show progress bars on stderr.
        tensorboard: Folder to log losses to.

    Returns:
        The policy as read back from the file; its description has the validation errors.

    Raises:
        PolicyError: The training diverged, the demonstrations do not fit each other or the
            settings, or the exported network disagrees with the trained.
    """
    training = training or Training()
    began = time.monotonic()
    path = Path(path)
    given = len(demonstrations)
    if not demonstrations.goal_names:
        demonstrations = _within_risk(demonstrations)  # a failed action reaches no other goal
    sees = _seen(demonstrations, training)
    task, world = rebuild(demonstrations.task), world or Simulation()
    if training.refine:
        _check_refined(task, finetune)
    if finetune is not None:
        _check_alike(demonstrations, finetune)
    refined_in = world.settings() if training.refine else None
    versions = {"gendom": __version__, "torch": str(torch.__version__)}
    checkpoint = Checkpoint(
        path.with_name(path.name + ".partial.pt"),
        {
            **versions,
            "training": asdict(training),
            "demonstrations": _digest(demonstrations),
            "finetune": None if finetune is None else _digest(finetune),
            "world": refined_in,
        },
    )
    with reproducible(training.seed), _shown(progress, tensorboard) as observe:
        problem = TrainingProblem(
            demonstrations,
            sees,
            training,
            finetune=finetune,
            observe=observe,
            checkpoint=checkpoint,
        )
        errors = getattr(methods, training.method)(problem)
        if training.refine:
            errors |= refine(problem, task, world, shown=progress)
        figures = {
            **asdict(training),
            "demonstrations": given,
            "failed": given - len(demonstrations),
            "refined_in": refined_in,
            "finetuned_on": 0 if finetune is None else len(finetune),
            "held_out": len(problem.held_out),
            "errors": errors,
            "seconds": time.monotonic() - began,
            **versions,
        }
        policy = _written(problem, _described(problem, demonstrations, figures), path)
    checkpoint.clear()
    return policy


def _described(
    problem: TrainingProblem, demonstrations: Demonstrations, figures: dict[str, Any]
) -> Description:
    """What the policy file says about itself."""
    return Description(
        task=demonstrations.task,
        method=problem.training.method,
        conditioned_on=problem.sees,
        inputs=tuple(problem.inputs),
        outputs=tuple(problem.actions),
        goals=goal_range(_within_risk(demonstrations)),
        parameters={
            name: (float(values.min()), float(values.max()))
            for name, values in demonstrations.parameters.items()
        },
        training=figures,
    )


def annotate(policy: Policy, figures: Mapping[str, Any]) -> Policy:
    """Add figures to a policy's description of its training, in its file.

    Args:
        policy: Read from a file.
        figures: By name, ready for JSON.

    Returns:
        The policy as read back.

    Raises:
        GendomError: The file cannot be written.
    """
    about = policy.description
    about = replace(about, training={**about.training, **figures})
    path = Path(policy.where)
    model = onnx.load(str(path))
    for entry in model.metadata_props:
        if entry.key == METADATA_KEY:
            entry.value = about.to_json()
    with atomic_path(path) as temporary:
        temporary.write_bytes(sealed(model.SerializeToString()))
    return Policy.read(path)


def goal_range(demonstrations: Demonstrations) -> GoalRange:
    """Outer quantiles of the goals in equally filled bins of the parameter E."""
    E = demonstrations.parameters["bending_ratio"]
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


def _check_refined(task: Task, finetune: Demonstrations | None) -> None:
    what, fix = f"{task.name} has no goals that a policy could be refined for", "give 0 rounds"
    require(task.goals, what, where="refine", fix=fix, error=PolicyError)
    what, fix = "refining in the simulator would undo the fine-tuning", "choose one of them"
    require(finetune is None, what, where="refine", fix=fix, error=PolicyError)


def _check_alike(demonstrations: Demonstrations, finetune: Demonstrations) -> None:
    for what in ("action_names", "goal_names"):
        mine, yours = getattr(demonstrations, what), getattr(finetune, what)
        if mine != yours or demonstrations.task["name"] != finetune.task["name"]:
            raise PolicyError(
                f"is of {finetune.task['name']} ({', '.join(yours)}), the demonstrations are of "
                f"{demonstrations.task['name']} ({', '.join(mine)})",
                where=finetune.where or "finetune",
                fix="give demonstrations of the same task",
            )


def _within_risk(demonstrations: Demonstrations) -> Demonstrations:
    """Those whose risk is within its limit."""
    risk = find_task(demonstrations.task["name"]).risk
    if risk is None or demonstrations.risk is None:
        return demonstrations
    within = demonstrations.risk <= risk.limit
    return demonstrations.chosen(within) if within.sum() >= SMALLEST else demonstrations


def _digest(demonstrations: Demonstrations) -> str:
    """Of all numbers that are learnt from."""
    found = hashlib.sha256()
    d = demonstrations
    risk = [] if d.risk is None else [d.risk]
    for numbers in (d.goal, d.action, *(d.parameters[n] for n in PARAMETERS), *risk):
        found.update(np.ascontiguousarray(numbers).tobytes())
    return found.hexdigest()


def _written(problem: TrainingProblem, description: Description, path: Path) -> Policy:
    """Write the file, once onnxruntime gives the trained network's actions."""
    rows = problem.held_out
    with torch.no_grad():
        expected = problem.act(rows).numpy()
    with atomic_path(path) as temporary:
        export_onnx(
            problem.policy,
            temporary,
            inputs={column.name: torch.ones(2, 1) for column in description.inputs},
            outputs=("action",),
            metadata={METADATA_KEY: description.to_json()},
        )
        given: dict[str, NDArray[np.float64]] = {
            name: problem.data[name][rows, 0].numpy().astype(float) for name in problem.sees
        }
        low_high = description.parameters
        inside = np.all(
            [(v >= low_high[n][0]) & (v <= low_high[n][1]) for n, v in given.items()]
            or [np.ones(len(rows), dtype=bool)],
            axis=0,
        )
        actions = Policy.read(temporary).actions(problem.goal[rows].numpy(), given)
        # what lies beyond the training range is clipped
        worst = float(np.abs(actions - expected)[inside].max(initial=0.0))
        what = f"the exported network differs from the trained one by {worst:.3g}"
        fix = "report this, with the versions of torch and onnxruntime"
        require(worst < AGREEMENT, what, where=str(path), fix=fix, error=PolicyError)
    return Policy.read(path)


@contextmanager
def _shown(
    progress: bool, tensorboard: str | os.PathLike | None
) -> Iterator[Callable[[str, Epoch], None]]:
    """Shows and logs how fits stand.

    Raises:
        PolicyError: TensorBoard's writer is not installed.
    """
    writer = None
    if tensorboard is not None:
        try:
            from tensorboardX import SummaryWriter
        except ModuleNotFoundError:
            raise PolicyError(
                "logging needs tensorboardX", fix="install it with: pip install tensorboardX"
            ) from None
        writer = SummaryWriter(str(tensorboard))
    shows: dict[str, Show] = {}
    one = ExitStack()  # networks are fitted one after another

    def observe(name: str, epoch: Epoch) -> None:
        if writer is not None:
            writer.add_scalar(f"{name}/loss", epoch.loss, epoch.done)
            if epoch.held_out is not None:
                writer.add_scalar(f"{name}/held out", epoch.held_out, epoch.done)
        if name not in shows:
            one.close()
            shows[name] = one.enter_context(bar(name, epoch.of, "epoch", shown=progress))
        aside = "" if epoch.held_out is None else f", held out {epoch.held_out:.2e}"
        shows[name](epoch.done, note=f"loss {epoch.loss:.2e}{aside}")

    try:
        with one:
            yield observe
    finally:
        if writer is not None:
            writer.close()
