"""Parameters of an object from one recorded lift."""

from gendom.estimation.estimate import (
    Estimate,
    EstimateSettings,
    Progress,
    estimate,
    replay_chamfer,
)
from gendom.estimation.hold import Hold
from gendom.estimation.lift import Lift, ReplaySettings, Theta

__all__ = [
    "Estimate",
    "EstimateSettings",
    "Hold",
    "Lift",
    "Progress",
    "ReplaySettings",
    "Theta",
    "estimate",
    "replay_chamfer",
]
