"""Regression of the action on goal and parameters, as Kuroki et al. (2024) do.

The minimiser of the mean squared error is the *mean* of all actions that lead to the goal. Two
numbers of a release make one distance, so a whole curve of releases reaches each goal, and where
the curve bends its mean lies beside it. No amount of data takes that error away.
"""

from __future__ import annotations

import torch
from torch import Tensor

from gendom.policies.lesson import Lesson, rms


def teach(lesson: Lesson) -> dict[str, float]:
    """Train the lesson's policy; its root mean square error on held-out demonstrations."""
    scale = lesson.policy.output_scale

    def loss(rows: Tensor) -> Tensor:
        return (((lesson.act(rows) - lesson.action[rows]) / scale) ** 2).mean()

    lesson.fit("policy", lesson.policy, loss)
    with torch.no_grad():
        rows = lesson.held_out
        return {"action_rms": rms(lesson.act(rows) - lesson.action[rows])}
