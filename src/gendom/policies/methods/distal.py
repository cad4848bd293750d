"""A policy taught through a forward model (default).

After Jordan and Rumelhart (1992), "Forward models: supervised learning with a distal teacher".
First a forward model f(action, parameters) -> goal is fitted: that map is a function. Then the
policy pi is trained through the frozen f to make f(pi(g, p), p) = g, so it may choose any action
of the curve that reaches the goal, and has no reason to average. What the policy does not see, f
does: such a policy learns the action that is best on average, one that hardly depends on it.

A forward model knows nothing where no demonstrations are, and a policy trained through it would
seek out such places. A pull brings actions that stray farther from the demonstrated ones than
these lie from each other back to the nearest. Where a task names a risk (rope reaching: falling out
of the plane), the forward model learns it too, and the policy is kept below its limit: beyond it
what is reached cannot be predicted.

Here and there what is reached jumps, and no network follows. Large errors count linearly (Huber
1964), so that both networks fit what can be fitted.
"""

from __future__ import annotations

import torch
from torch import Tensor

from gendom.errors import PolicyError
from gendom.policies.lesson import Lesson, huber, rms, standardised
from gendom.policies.networks import PhysicalNetwork

ANCHORS = 1024
"""Demonstrated actions, at most, that the pull looks for the nearest among."""

LARGE = 0.1
"""Error from which on it counts linearly [standard deviations of the goal]."""


def teach(lesson: Lesson) -> dict[str, float]:
    """Train forward model and policy; their errors on held-out demonstrations.

    Raises:
        PolicyError: The task has no goals.
    """
    training, G = lesson.training, len(lesson.goals)
    if not G:
        raise PolicyError(
            f"{lesson.task_name} has no goals to teach through",
            where="method",
            fix="choose the method inverse",
        )
    outputs, target = list(lesson.goals), lesson.goal
    if lesson.log_risk is not None:
        outputs.append(standardised("risk", lesson.log_risk.numpy()[:, 0].astype(float)))
        target = torch.cat([lesson.goal, lesson.log_risk], dim=1)
    model = PhysicalNetwork(
        [*lesson.actions, *lesson.parameters.values()], outputs, training.architecture
    )

    def predicted(action: Tensor, rows: Tensor) -> Tensor:
        return model(*action.split(1, dim=1), *(lesson.data[n][rows] for n in lesson.parameters))

    # what is reached beyond the risk's limit is noise: only the risk itself is learnt there
    counts = torch.ones_like(target)
    counts[:, :G] = lesson.within[:, None].float()

    def model_loss(rows: Tensor) -> Tensor:
        error = (predicted(lesson.action[rows], rows) - target[rows]) / model.output_scale
        return (counts[rows] * huber(error, LARGE)).mean()

    lesson.fit("forward model", model, model_loss)
    model.requires_grad_(False)
    scale = lesson.policy.output_scale
    stray = _Stray(lesson.action[lesson.taught] / scale)

    def policy_loss(rows: Tensor) -> Tensor:
        action = lesson.act(rows)
        found = predicted(action, rows)
        error = (found[:, :G] - lesson.goal[rows]) / model.output_scale[:G]
        loss = huber(error, LARGE).mean() + training.pull * stray(action / scale)
        if lesson.log_risk is not None:
            loss = loss + lesson.caution(found[:, G])
        return loss

    lesson.fit("policy", lesson.policy, policy_loss, only=lesson.within)
    with torch.no_grad():
        rows = lesson.held_out[lesson.within[lesson.held_out]]
        if not len(rows):
            return {}
        known = predicted(lesson.action[rows], rows)[:, :G] - lesson.goal[rows]
        own = predicted(lesson.act(rows), rows)[:, :G] - lesson.goal[rows]
        return {"forward_model_rms": rms(known), "goal_rms_by_forward_model": rms(own)}


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
