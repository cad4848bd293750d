"""Robot arms: kinematics, timed motions within their limits, and their shape.

The robot's base is the world. NumPy and SciPy only; nothing here moves a real arm.
"""

from gendom.arguments import require
from gendom.errors import RobotError
from gendom.plugins import plugins
from gendom.robot.arm import (
    Arm,
    FingerCapsule,
    KnuckleCapsule,
    LinkCapsule,
    ParallelGripper,
    modified_dh,
)
from gendom.robot.capsules import fit_capsules
from gendom.robot.collision import (
    NO_OBSTACLES,
    Box,
    Clearances,
    Collision,
    Post,
    Surroundings,
    check_collisions,
    clearances,
    collision_along,
    collision_at,
)
from gendom.robot.description import read_arm
from gendom.robot.fr3 import FR3
from gendom.robot.kinematics import (
    inverse_kinematics,
    jacobian,
    link_poses,
    pose_error,
    solutions,
    tcp_pose,
)
from gendom.robot.motion import JointMotion, LimitUse
from gendom.robot.motions import LIFT_ENDS, MOTION_FORMAT, LiftMotion, lift, predefined_lift
from gendom.robot.path import (
    DOWN,
    Deviation,
    GripperEvent,
    TcpPath,
    TcpPaths,
    pointing,
)
from gendom.robot.planning import follow, joint_move
from gendom.robot.shape import ArmShape, arm_shape
from gendom.robot.states import JointStates, read_joints
from gendom.robot.xarm7 import XARM7

ARMS = {XARM7.name: XARM7, FR3.name: FR3}
"""Arms by their names."""


def find_arm(name: str, *, files: bool = False) -> Arm:
    """The arm with a given name: one of `ARMS`, or of an entry point ``gendom.arms``.

    Args:
        name: Its name.
        files: Whether it may also be the path of a URDF or MJCF file, as people may type it; names
            in files are names alone.

    Raises:
        RobotError: There is none, or the file is not read (`read_arm`).
    """
    if files and str(name).lower().endswith((".urdf", ".xml", ".mjcf")):
        return read_arm(name)
    arms = {**ARMS, **plugins("arms")}
    fix = f"have {', '.join(arms)}" + ", or name a .urdf or .xml file" * files
    require(
        isinstance(arms.get(name), Arm), f"there is no robot {name!r}", fix=fix, error=RobotError
    )
    return arms[name]


__all__ = [
    "ARMS",
    "DOWN",
    "FR3",
    "LIFT_ENDS",
    "MOTION_FORMAT",
    "NO_OBSTACLES",
    "XARM7",
    "Arm",
    "ArmShape",
    "Box",
    "Clearances",
    "Collision",
    "Deviation",
    "FingerCapsule",
    "GripperEvent",
    "JointMotion",
    "JointStates",
    "KnuckleCapsule",
    "LiftMotion",
    "LimitUse",
    "LinkCapsule",
    "ParallelGripper",
    "Post",
    "Surroundings",
    "TcpPath",
    "TcpPaths",
    "arm_shape",
    "check_collisions",
    "clearances",
    "collision_along",
    "collision_at",
    "find_arm",
    "fit_capsules",
    "follow",
    "inverse_kinematics",
    "jacobian",
    "joint_move",
    "lift",
    "link_poses",
    "modified_dh",
    "pointing",
    "pose_error",
    "predefined_lift",
    "read_arm",
    "read_joints",
    "solutions",
    "tcp_pose",
]
