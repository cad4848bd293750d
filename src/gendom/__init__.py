"""GenDOM: show it one lift of a rope or a cloth, and the robot handles that object.

A recording of one lift gives Young's modulus and Poisson's ratio through a differentiable
simulator; one policy, trained in simulation, takes them as an input.

What most programs need is here; the rest is one level below, in `gendom.datasets`, `estimation`,
`materials`, `perception`, `policies`, `reality`, `robot`, `sim`, `tasks` and `viz`.
Names are imported when first used, so `import gendom` stays fast.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from gendom.lazy import imported_later

if TYPE_CHECKING:
    from gendom.datasets import Fault, ObjectDescription, Recording
    from gendom.errors import GendomError
    from gendom.estimation import Estimate, EstimateSettings, SceneSettings, estimate, replay
    from gendom.materials import Cloth, Material, Rope
    from gendom.policies import Policy
    from gendom.sim import Simulator
    from gendom.tasks import ClothSpreading, RopeCasting, RopeReaching

__version__ = "0.2.0"

__all__ = [
    "Cloth", "ClothSpreading", "Estimate", "EstimateSettings", "Fault", "GendomError", "Material",
    "ObjectDescription", "Policy", "Recording", "Rope", "RopeCasting", "RopeReaching",
    "SceneSettings", "Simulator", "__version__", "estimate", "replay",
]  # fmt: skip

__getattr__ = imported_later(__name__)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
