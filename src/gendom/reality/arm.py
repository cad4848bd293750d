"""The robot in the MuJoCo test scene: bodies and servos made from an arm's published numbers."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gendom.arrays import Array, placed
from gendom.installation import load_mujoco
from gendom.perception.camera import Camera
from gendom.reality.model import row
from gendom.robot import Arm, Box, JointMotion, Surroundings, arm_shape, link_poses

STIFFNESS, DAMPING, INERTIA = 2.0e4, 4.0e2, 0.3
"""Of each joint's servo [N m / rad], [N m s / rad], and what its gears add to a link's inertia
[kg m^2]."""

HOUSING = (0.090, 0.025, 0.025)
"""A D435i's breadth, height and depth [m] (Intel, "RealSense D400 series datasheet")."""

_HOUSING_MIDDLE = (0.0175, 0.0, -0.0083)  # from the left imager, which sees the depth [m]

_TOUCHED = 'contype="2" conaffinity="1"'
_UNTOUCHED = 'contype="0" conaffinity="0"'


class RobotArm:
    """An arm whose joints follow a motion through servos.

    Links have the mass of their capsules, filled as water. Servos get feed-forward torques for
    weight and inertia of the links, as in real controllers; they correct the effect of the object.
    The links push the object away; the gripper does not: what it holds is between its fingers.

    Args:
        arm: Its numbers.
        motion: Joint angles over time, from time 0 on.
        opening: Distance of the fingers' inner faces [m].
    """

    def __init__(self, arm: Arm, motion: JointMotion, *, opening: float = 0.01):
        self.arm = arm
        self.motion = motion
        self.opening = opening
        self._q = self._v = np.empty(0, dtype=int)
        self._mujoco: Any = None
        self._model: Any = None

    def xml(self) -> str:
        """The arm's bodies; the hand is the body `hand`, with the tool point at its origin."""
        arm = self.arm
        rest = np.zeros(arm.joints)
        shape = arm_shape(arm, rest, self.opening)
        poses = link_poses(arm, rest)
        links = [c.link for c in arm.capsules]
        links += [arm.joints] * (len(shape.names) - len(links))
        geoms: list[list[str]] = [[] for _ in range(arm.joints + 1)]
        for k, link in enumerate(links):
            T = np.linalg.inv(poses[link])
            a, b = placed(T, [shape.start[k], shape.end[k]])
            if np.linalg.norm(b - a) < 1e-4:  # MuJoCo wants capsules longer than that
                b = b + np.array([0.0, 0.0, 1e-4])
            gripper = link == arm.joints
            geoms[link].append(
                f'<geom type="capsule" fromto="{row(a)} {row(b)}" size="{shape.radius[k]}"'
                f' rgba="{"0.25 0.26 0.28 1" if gripper else "0.9 0.9 0.92 1"}"'
                f" {_UNTOUCHED if gripper else _TOUCHED}/>"
            )
        body = f'<body name="hand" {_place(arm.T_flange_tcp)}/>'
        for i in range(arm.joints, 0, -1):
            step = np.linalg.inv(poses[i - 1]) @ poses[i]
            body = (
                f'<body name="link{i}" {_place(step)} gravcomp="1">'
                f'<joint name="joint{i}" armature="{INERTIA}" axis="0 0 1"/>'
                f"{''.join(geoms[i])}{body}</body>"
            )
        return f'<body name="base">{"".join(geoms[0])}{body}</body>'

    def actuators(self) -> str:
        """Two servos a joint, on its angle and on its speed."""
        return "".join(
            f'<position name="angle{i}" joint="joint{i}" kp="{STIFFNESS}"/>'
            f'<velocity name="speed{i}" joint="joint{i}" kv="{DAMPING}"/>'
            for i in range(1, self.arm.joints + 1)
        )

    def reset(self, model: Any, data: Any) -> None:
        """Move the arm to the start of its motion."""
        self._mujoco, self._model = load_mujoco(), model
        joints = [model.joint(f"joint{i}") for i in range(1, self.arm.joints + 1)]
        self._q = np.array([int(j.qposadr[0]) for j in joints])
        self._v = np.array([int(j.dofadr[0]) for j in joints])
        data.qpos[self._q] = self.motion.at(0.0)

    def control(self, data: Any, times: Array) -> Iterator[None]:
        """Set the servos' targets before each of the steps that end at times [n] [s]."""
        model, step, own = self._model, self._model.opt.timestep, self._v
        acceleration, torque = np.zeros(model.nv), np.zeros(model.nv)
        # Speeds and accelerations of the steps, not of the motion: those lead to its angles.
        for before, now, then in self.motion.at(times[:, None] - step * np.array([2.0, 1.0, 0.0])):
            data.ctrl[0::2] = then
            data.ctrl[1::2] = (then - now) / step
            acceleration[own] = (then - 2.0 * now + before) / step**2
            self._mujoco.mj_mulM(model, data, torque, acceleration)
            torque += data.qfrc_bias - data.qfrc_gravcomp
            data.qfrc_applied[own] = torque[own]
            yield

    def measured(self, data: Any) -> Array:
        """[J] joint angles as the encoders have them [rad]."""
        return data.qpos[self._q].copy()


def surroundings(cameras: Sequence[Camera]) -> Surroundings:
    """What the arm must not touch: the table at z = 0, and the cameras' housings."""
    boxes = tuple(housing(camera.name, camera.calibrated()) for camera in cameras)
    return Surroundings(table_height=0.0, obstacles=boxes)


def housing(name: str, T_world_camera: Array) -> Box:
    """The housing of a D435i at a pose [4, 4] of its depth camera [m]."""
    R, t = T_world_camera[:3, :3].copy(), T_world_camera[:3, 3]  # SciPy 1.15 needs to own it
    quat = Rotation.from_matrix(R).as_quat()
    middle = t + R @ _HOUSING_MIDDLE
    return Box(name=f"camera {name}", position=middle, size=np.array(HOUSING), quat_xyzw=quat)


def _place(T: Array) -> str:
    quat = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
    return f'pos="{row(T[:3, 3])}" quat="{row(quat)}"'
