"""Parameters of an object from one or more recordings."""

from gendom.estimation.estimate import estimate
from gendom.estimation.likelihood import NoiseModel, Observation
from gendom.estimation.methods import METHODS
from gendom.estimation.posterior import Calibration, Posterior
from gendom.estimation.problem import EstimateSettings, Problem, Progress
from gendom.estimation.replay import replay
from gendom.estimation.result import Estimate, chamfers
from gendom.estimation.scene import Scene
from gendom.estimation.scene_settings import SceneSettings
from gendom.estimation.theta import UNKNOWNS, Prior, Theta, Unknown
from gendom.estimation.verdict import Verdict, VerdictSettings

__all__ = [
    "METHODS",
    "UNKNOWNS",
    "Calibration",
    "Estimate",
    "EstimateSettings",
    "NoiseModel",
    "Observation",
    "Posterior",
    "Prior",
    "Problem",
    "Progress",
    "Scene",
    "SceneSettings",
    "Theta",
    "Unknown",
    "Verdict",
    "VerdictSettings",
    "chamfers",
    "estimate",
    "replay",
]
