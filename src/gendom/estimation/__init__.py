"""Parameters of an object from one or more recordings."""

from gendom.estimation.estimate import METHODS, estimate, find_method
from gendom.estimation.intervals import IntervalCalibration
from gendom.estimation.observed import NoiseModel, Observation
from gendom.estimation.problem import EstimateSettings, Problem, Progress
from gendom.estimation.replay import replay
from gendom.estimation.result import FittedEstimate, chamfers
from gendom.estimation.scene import LiftScene, SceneSettings
from gendom.materials.estimate import Estimate, Verdict
from gendom.materials.posterior import Posterior, Prior
from gendom.materials.unknowns import UNKNOWNS, Theta, Unknown

__all__ = [
    "METHODS", "UNKNOWNS", "Estimate", "EstimateSettings", "FittedEstimate", "IntervalCalibration",
    "LiftScene", "NoiseModel", "Observation", "Posterior", "Prior", "Problem", "Progress",
    "SceneSettings", "Theta", "Unknown", "Verdict", "chamfers", "estimate", "find_method", "replay",
]  # fmt: skip
