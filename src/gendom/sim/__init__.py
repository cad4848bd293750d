"""Batched simulation of ropes and cloths, as rods and shells or by the material point method."""

from typing import TYPE_CHECKING

from gendom.arguments import check_numbers
from gendom.lazy import imported_later
from gendom.materials import AIR_DENSITY
from gendom.sim.bodies import Body, cloth, rope
from gendom.sim.gradients import Gradients
from gendom.sim.gripper import Gripper, Grippers, Targets
from gendom.sim.obstacles import Capsule, Cuboid, Obstacle, Sphere, Table
from gendom.sim.setting import ENGINES, GRAVITY, Physics, Solver, Variation

if TYPE_CHECKING:
    from gendom.sim.device import list_devices, open_device
    from gendom.sim.mpm.engine import CFL, stable_substep
    from gendom.sim.rollout import Rollout
    from gendom.sim.simulator import Simulator

# these import Warp
__getattr__ = imported_later(__name__)

__all__ = [
    "AIR_DENSITY", "CFL", "ENGINES", "GRAVITY", "Body", "Capsule", "Cuboid", "Gradients", "Gripper",
    "Grippers", "Obstacle", "Physics", "Rollout", "Simulator", "Solver", "Sphere", "Table",
    "Targets", "Variation", "check_numbers", "cloth", "list_devices", "open_device", "rope",
    "stable_substep",
]  # fmt: skip
