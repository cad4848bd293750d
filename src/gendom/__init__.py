"""GenDOM: show it one lift of a rope or a cloth, and the robot handles that object.

A recording of one lift gives Young's modulus and Poisson's ratio through a differentiable
simulator; one policy, trained in simulation, takes them as an input.

Names below are imported when first used, so `import gendom` stays fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gendom.datasets import Fault, ObjectDescription, Recording
    from gendom.errors import GendomError
    from gendom.estimation import estimate
    from gendom.policies import Policy
    from gendom.tasks import RopeReaching

__version__ = "0.1.0"

# Public name -> module that defines it. Keep in step with the block above and `__all__`.
_EXPORTS = {
    "Fault": "gendom.datasets",
    "GendomError": "gendom.errors",
    "ObjectDescription": "gendom.datasets",
    "Policy": "gendom.policies",
    "Recording": "gendom.datasets",
    "RopeReaching": "gendom.tasks",
    "estimate": "gendom.estimation",
}

__all__ = [
    "Fault",
    "GendomError",
    "ObjectDescription",
    "Policy",
    "Recording",
    "RopeReaching",
    "__version__",
    "estimate",
]


def __getattr__(name: str):
    if name not in _EXPORTS:
        raise AttributeError(f"module 'gendom' has no attribute {name!r}")
    value = getattr(import_module(_EXPORTS[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_EXPORTS})
