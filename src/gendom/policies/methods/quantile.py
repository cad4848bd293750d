"""Regression of a quantile of the action (Koenker and Bassett 1978, "Regression quantiles").

For tasks whose demonstrations hold the least action that is enough, like cloth spreading: the mean
of those (`inverse`) is enough for half of the objects that look alike, an upper quantile for most.
"""

from __future__ import annotations

import torch
from torch import Tensor

from gendom.policies.lesson import Lesson
from gendom.policies.policy import QUANTILE


def teach(lesson: Lesson) -> dict[str, float]:
    """Train the lesson's policy; the share of held-out demonstrations that need no more."""
    scale = lesson.policy.output_scale

    def loss(rows: Tensor) -> Tensor:
        lacks = (lesson.action[rows] - lesson.act(rows)) / scale
        return torch.maximum(QUANTILE * lacks, (QUANTILE - 1.0) * lacks).mean()

    lesson.fit("policy", lesson.policy, loss)
    with torch.no_grad():
        rows = lesson.held_out
        enough = (lesson.act(rows) >= lesson.action[rows]).float()
        return {"enough_share": float(enough.mean())}
