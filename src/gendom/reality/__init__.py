"""A second, independent reality on MuJoCo: objects, table, arm and depth cameras.

Tasks are Gymnasium environments in it, where that is installed: `gendom/RopeReaching-v0` and so
on, one for each, see `gendom.reality.envs`.
"""

from contextlib import suppress

from gendom.reality.air import Air
from gendom.reality.model import Layout, default_cameras, looking_at
from gendom.reality.object_file import find_object
from gendom.reality.objects import OBJECTS, RealCloth, RealObject, RealRope, as_real
from gendom.reality.recording import record
from gendom.reality.sensor import RigErrors
from gendom.reality.trials import (
    RealWorld,
    Trial,
    TrialRun,
    arm_motion,
    end_of,
    lift,
    lift_cameras,
    observe,
    task_trial,
)
from gendom.reality.world import Reality
from gendom.tasks import task_names

__all__ = [
    "OBJECTS", "Air", "Layout", "RealCloth", "RealObject", "RealRope", "RealWorld", "Reality",
    "RigErrors", "Trial", "TrialRun", "arm_motion", "as_real", "default_cameras", "end_of",
    "find_object", "lift", "lift_cameras", "looking_at", "observe", "record", "task_trial",
]  # fmt: skip

with suppress(ImportError):  # where Gymnasium is not installed
    from gendom.environments import register

    register(task_names())  # those of other packages, too
