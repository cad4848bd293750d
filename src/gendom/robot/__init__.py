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
)
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

ARMS = {XARM7.name: XARM7}
"""Arms by their names."""


def find_arm(name: str) -> Arm:
    """The arm with a given name: one of `ARMS`, or of an entry point ``gendom.arms``.

    Raises:
        RobotError: There is none.
    """
    arms = {**ARMS, **plugins("arms")}
    fix = f"have {', '.join(arms)}"
    require(
        isinstance(arms.get(name), Arm), f"there is no robot {name!r}", fix=fix, error=RobotError
    )
    return arms[name]


__all__ = [
    "ARMS",
    "DOWN",
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
    "follow",
    "inverse_kinematics",
    "jacobian",
    "joint_move",
    "lift",
    "link_poses",
    "pointing",
    "pose_error",
    "predefined_lift",
    "read_joints",
    "solutions",
    "tcp_pose",
]
