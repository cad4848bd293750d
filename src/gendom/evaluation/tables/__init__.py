"""The paper's tables, measured here."""

from gendom.evaluation.tables.cloth_real import ClothRealSettings, cloth_real
from gendom.evaluation.tables.real2sim import Real2SimSettings, real2sim
from gendom.evaluation.tables.rope_real import RopeRealSettings, rope_real
from gendom.evaluation.tables.simulated import SimulatedSettings, ablation, generalization
from gendom.evaluation.tables.workbench import Workbench

__all__ = [
    "ClothRealSettings",
    "Real2SimSettings",
    "RopeRealSettings",
    "SimulatedSettings",
    "Workbench",
    "ablation",
    "cloth_real",
    "generalization",
    "real2sim",
    "rope_real",
]
