"""A second, independent reality on MuJoCo: objects, table, arm and depth cameras."""

from gendom.reality.benches import Bench, cantilever, stretch
from gendom.reality.objects import OBJECTS, RealCloth, RealObject, RealRope, find_object
from gendom.reality.recording import RecordSettings, record
from gendom.reality.scene import Layout, build_model, default_cameras, looking_at, rest_height
from gendom.reality.sensor import DepthSensor, RigErrors
from gendom.reality.trials import (
    Performance,
    Reached,
    Trial,
    carry_out_reaching,
    lift,
    lift_cameras,
    reaching,
    reaching_task,
)
from gendom.reality.world import Reality

__all__ = [
    "OBJECTS",
    "Bench",
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
    "Trial",
    "build_model",
    "cantilever",
    "carry_out_reaching",
    "default_cameras",
    "find_object",
    "lift",
    "lift_cameras",
    "looking_at",
    "reaching",
    "reaching_task",
    "record",
    "rest_height",
    "stretch",
]
