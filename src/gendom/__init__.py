"""GenDOM: show it one lift of a rope or a cloth, and the robot handles that object.

A recording of one lift gives Young's modulus and Poisson's ratio through a differentiable
simulator; one policy, trained in simulation, takes them as an input.

What most programs need is here; the rest is one level below, in `gendom.datasets`, `estimation`,
`materials`, `perception`, `policies`, `reality`, `robot`, `sim`, `tasks` and `viz`.
Names are imported when first used, so `import gendom` stays fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gendom.datasets import Fault, ObjectDescription, Recording
    from gendom.errors import GendomError
    from gendom.estimation import Estimate, EstimateSettings, SceneSettings, estimate, replay
    from gendom.materials import Cloth, Material, Rope
    from gendom.policies import Policy
    from gendom.sim import Simulator
    from gendom.tasks import ClothSpreading, RopeCasting, RopeReaching

__version__ = "0.2.0"

# Public name -> module that defines it. Keep in step with the block above and `__all__`.
_EXPORTS = {
    "Cloth": "gendom.materials",
    "ClothSpreading": "gendom.tasks",
    "Estimate": "gendom.estimation",
    "EstimateSettings": "gendom.estimation",
    "Fault": "gendom.datasets",
    "GendomError": "gendom.errors",
    "Material": "gendom.materials",
    "ObjectDescription": "gendom.datasets",
    "Policy": "gendom.policies",
    "Recording": "gendom.datasets",
    "Rope": "gendom.materials",
    "RopeCasting": "gendom.tasks",
    "RopeReaching": "gendom.tasks",
    "SceneSettings": "gendom.estimation",
    "Simulator": "gendom.sim",
    "estimate": "gendom.estimation",
    "replay": "gendom.estimation",
}

__all__ = [
    "Cloth",
    "ClothSpreading",
    "Estimate",
    "EstimateSettings",
    "Fault",
    "GendomError",
    "Material",
    "ObjectDescription",
    "Policy",
    "Recording",
    "Rope",
    "RopeCasting",
    "RopeReaching",
    "SceneSettings",
    "Simulator",
    "__version__",
    "estimate",
    "replay",
]


def __getattr__(name: str):
    if name not in _EXPORTS:
        raise AttributeError(f"module 'gendom' has no attribute {name!r}")
    value = getattr(import_module(_EXPORTS[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_EXPORTS})
