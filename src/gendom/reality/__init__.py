"""A second, independent reality on MuJoCo: objects, table, arm and depth cameras.

Its tasks are Gymnasium environments, where that is installed: `gendom/RopeReaching-v0`,
`gendom/RopeCasting-v0` and `gendom/ClothSpreading-v0`, see `gendom.reality.envs`.
"""

from gendom.materials import AIR_DENSITY
from gendom.reality.air import Air
from gendom.reality.benches import Bench, cantilever, stretch
from gendom.reality.objects import OBJECTS, RealCloth, RealObject, RealRope, find_object
from gendom.reality.recording import RecordSettings, record
from gendom.reality.scene import Layout, build_model, default_cameras, looking_at, rest_height
from gendom.reality.sensor import DepthSensor, RigErrors
from gendom.reality.trials import (
    Cast,
    Performance,
    Reached,
    Spread,
    Trial,
    carry_out_casting,
    carry_out_reaching,
    carry_out_spreading,
    casting,
    covered_area,
    lift,
    lift_cameras,
    reaching,
    reaching_task,
    spreading,
)
from gendom.reality.world import Reality

__all__ = [
    "AIR_DENSITY",
    "OBJECTS",
    "Air",
    "Bench",
    "Cast",
    "DepthSensor",
    "Layout",
    "Performance",
    "Reached",
    "RealCloth",
    "RealObject",
    "RealRope",
    "Reality",
    "RecordSettings",
    "RigErrors",
    "Spread",
    "Trial",
    "build_model",
    "cantilever",
    "carry_out_casting",
    "carry_out_reaching",
    "carry_out_spreading",
    "casting",
    "covered_area",
    "default_cameras",
    "find_object",
    "lift",
    "lift_cameras",
    "looking_at",
    "reaching",
    "reaching_task",
    "record",
    "rest_height",
    "spreading",
    "stretch",
]


def _register() -> None:
    try:
        import gymnasium
    except ImportError:
        return
    for task in ("RopeReaching", "RopeCasting", "ClothSpreading"):
        gymnasium.register(id=f"gendom/{task}-v0", entry_point=f"gendom.reality.envs:{task}Env")


_register()
