"""Robot arms: kinematics, timed motions within their limits, and their shape.

The robot's base is the world. NumPy and SciPy only; nothing here moves a real arm.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gendom.arguments import require
from gendom.errors import RobotError
from gendom.lazy import imported_later
from gendom.plugins import plugins

if TYPE_CHECKING:
    from gendom.robot.arm import FR3, XARM7, Arm, FingerCapsule, LinkCapsule, ParallelGripper
    from gendom.robot.capsules import fit_capsules
    from gendom.robot.collision import Box, CollisionChecker, Post, Surroundings
    from gendom.robot.description import read_arm
    from gendom.robot.kinematics import arm_shape, jacobian, link_poses, pose_error
    from gendom.robot.kinematics import solutions, tcp_pose  # isort: skip
    from gendom.robot.motion import JointMotion, JointStates, read_joints
    from gendom.robot.motions import LIFT_ENDS, MOTION_FORMAT, LiftMotion, lift, predefined_lift
    from gendom.robot.path import DOWN, GripperEvent, TcpPath, TcpPaths, pointing
    from gendom.robot.planning import follow, joint_move

__getattr__ = imported_later(__name__)


def known_arms() -> dict[str, Any]:
    """Arms by their names: those that are shipped, and of entry points ``gendom.arms``."""
    from gendom.robot.arm import FR3, XARM7

    return {XARM7.name: XARM7, FR3.name: FR3, **plugins("arms")}


def find_arm(name: str, *, files: bool = False) -> Arm:
    """The arm with a given name: xarm7, fr3, or one of an entry point ``gendom.arms``.

    Args:
        name: Its name.
        files: Whether it may also be the path of a URDF or MJCF file, as people may type it; names
            in files are names alone.

    Raises:
        RobotError: There is none, or the file is not read (`read_arm`).
    """
    from gendom.robot.arm import Arm
    from gendom.robot.description import read_arm

    if files and str(name).lower().endswith((".urdf", ".xml", ".mjcf")):
        return read_arm(name)
    arms = known_arms()
    fix = f"have {', '.join(arms)}" + ", or name a .urdf or .xml file" * files
    known = isinstance(arms.get(str(name)), Arm)
    require(known, f"there is no robot {name!r}", fix=fix, error=RobotError)
    return arms[name]


__all__ = [
    "DOWN", "FR3", "LIFT_ENDS", "MOTION_FORMAT", "XARM7", "Arm", "Box", "CollisionChecker",
    "FingerCapsule", "GripperEvent", "JointMotion", "JointStates", "LiftMotion", "LinkCapsule",
    "ParallelGripper", "Post", "Surroundings", "TcpPath", "TcpPaths", "arm_shape", "find_arm",
    "fit_capsules", "follow", "jacobian", "joint_move", "known_arms", "lift", "link_poses",
    "pointing", "pose_error", "predefined_lift", "read_arm", "read_joints", "solutions", "tcp_pose",
]  # fmt: skip
