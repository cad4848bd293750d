"""Arms of files and their capsules, against published shapes, kinematics and MuJoCo."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gendom.robot import XARM7, arm_shape, link_poses

POINTS = np.load(Path(__file__).parent / "xarm_gripper.npz")
"""Places 2 mm apart on the outer surfaces of UFACTORY's meshes of the gripper [0.1 mm], each in its
URDF link's frame, where the gripper is open."""


def gripper_surfaces(opening):
    """Parts of the gripper -> [N, 3] surface in the flange's frame, by the URDF's joints."""
    start = np.arctan2(0.042039, 0.035465)
    turn = np.arccos((0.5 * opening + 0.026 - 0.035) / np.hypot(0.042039, 0.035465)) - start
    R = Rotation.from_rotvec([turn, 0.0, 0.0])
    part = {name: 1e-4 * POINTS[name].astype(float) for name in POINTS.files}
    pivot = np.array([0.0, 0.035, 0.059098])
    left = {
        "knuckle": R.apply(part["left_outer_knuckle"]) + pivot,
        "inner": R.apply(part["left_inner_knuckle"]) + [0.0, 0.02, 0.074098],
        "finger": part["left_finger"] + pivot + R.apply([0.0, 0.035465, 0.042039]),
    }
    right = {f"right {name}": points * [1.0, -1.0, 1.0] for name, points in left.items()}
    return {"gripper": part["base_link"], **{f"left {k}": v for k, v in left.items()}, **right}


def from_segments(points, a, b):
    """[N, C] distances of points from segments."""
    axis, off = b - a, points[:, None] - a
    share = np.clip((off * axis).sum(-1) / np.maximum((axis * axis).sum(-1), 1e-12), 0.0, 1.0)
    return np.linalg.norm(off - share[..., None] * axis, axis=-1)


@pytest.mark.parametrize("opening", [0.0, 0.03, 0.084])
def test_the_gripper_s_capsules_and_its_meshes_are_within_5_mm(opening):
    """Both ways: the surface of the capsules together, and that of all meshes together."""
    shape = arm_shape(XARM7, XARM7.home, opening)
    T = np.linalg.inv(link_poses(XARM7, XARM7.home)[7])
    a, b = (p @ T[:3, :3].T + T[:3, 3] for p in (shape.start, shape.end))
    surface = np.concatenate(list(gripper_surfaces(opening).values()))
    missed = (from_segments(surface, a, b) - shape.radius).max(axis=0, initial=-1.0)
    missed = (from_segments(surface, a, b) - shape.radius).min(axis=1)
    0.005, surface[missed.argmax()]

    rng, tree = np.random.default_rng(0), KDTree(surface)
    own = [c for c, n in enumerate(shape.names) if n.startswith(("gripper", "left", "right"))]
    for c in own:
        share, way = rng.uniform(-0.3, 1.3, (600, 1)).clip(0.0, 1.0), rng.normal(size=(600, 3))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        points = a[c] + share * (b[c] - a[c]) + shape.radius[c] * way
        depth = from_segments(points, a, b) - shape.radius
        points = points[depth.min(axis=1) > -1e-6]  # those that no capsule hides
        if len(points):
            far, _ = tree.query(points)
            print(shape.names[c], round(1e3*far.max(),1), np.round(1e3*points[far.argmax()]))
    print('missed', 1e3*missed.max(), 1e3*surface[missed.argmax()])
