"""The paper's tables, measured here."""

from gendom.evaluation.tables.real2sim import Real2SimSettings, real2sim
from gendom.evaluation.tables.rope_real import RopeRealSettings, rope_real
from gendom.evaluation.tables.simulated import SimulatedSettings, ablation, generalization
from gendom.evaluation.tables.workbench import Workbench

__all__ = [
    "Real2SimSettings",
    "RopeRealSettings",
    "SimulatedSettings",
    "Workbench",
    "ablation",
    "generalization",
    "real2sim",
    "rope_real",
]
