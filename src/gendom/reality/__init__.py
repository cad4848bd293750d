"""A second, independent reality on MuJoCo: objects, table, arm and depth cameras."""

from gendom.reality.benches import Bench, cantilever, stretch
from gendom.reality.objects import OBJECTS, RealCloth, RealObject, RealRope, find_object
from gendom.reality.recording import RecordSettings, record
from gendom.reality.scene import Layout, build_model, default_cameras, looking_at, rest_height
from gendom.reality.sensor import DepthSensor, RigErrors
from gendom.reality.world import Reality

__all__ = [
    "OBJECTS",
    "Bench",
    "DepthSensor",
    "Layout",
    "RealCloth",
    "RealObject",
    "RealRope",
    "Reality",
    "RecordSettings",
    "RigErrors",
    "build_model",
    "cantilever",
    "default_cameras",
    "find_object",
    "looking_at",
    "record",
    "rest_height",
    "stretch",
]
