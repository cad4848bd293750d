"""Policies: trained with torch, run without it; adapted and polished through the simulator.

Names are imported when first used: training needs the extra ``train``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from gendom.lazy import imported_later
from gendom.policies.policy import Action, Column, Description, GoalRange, Policy

if TYPE_CHECKING:
    from gendom.policies.adaptation import Adapted, Execution, adapt
    from gendom.policies.belief import believed
    from gendom.policies.demonstrations import Demonstrations
    from gendom.policies.evaluation import score
    from gendom.policies.fitting import Training
    from gendom.policies.polishing import Polished, polish
    from gendom.policies.training import train

__all__ = [
    "Action", "Adapted", "Column", "Demonstrations", "Description", "Execution", "GoalRange",
    "Policy", "Polished", "Training", "adapt", "believed", "polish", "score", "train",
]  # fmt: skip

__getattr__ = imported_later(__name__)
