"""The paper's tables of policies, measured here."""

from gendom.evaluation.tables.rope_real import RopeRealSettings, rope_real
from gendom.evaluation.tables.simulated import SimulatedSettings, ablation, generalization
from gendom.evaluation.tables.workbench import Workbench

__all__ = [
    "RopeRealSettings",
    "SimulatedSettings",
    "Workbench",
    "ablation",
    "generalization",
    "rope_real",
]
