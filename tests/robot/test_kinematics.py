"""Kinematics of the xArm 7: published poses, inverse kinematics."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.errors import RobotError
from gendom.robot import (
    DOWN,
    XARM7,
    find_arm,
    jacobian,
    link_poses,
    pose_error,
    solutions,
    tcp_pose,
)


def random_q(n, seed=0):
    """[n, 7] joint angles within the limits, at most half a turn."""
    low, high = np.maximum(XARM7.q_min, -np.pi), np.minimum(XARM7.q_max, np.pi)
    return np.random.default_rng(seed).uniform(low, high, (n, 7))


def pose(position, quat=DOWN):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_quat(quat).as_matrix(), position
    return T


def test_poses_are_those_that_ufactory_publishes():
    poses = link_poses(XARM7, XARM7.home)
    np.testing.assert_allclose(poses[-1, :3, :3], pose((0, 0, 0))[:3, :3], atol=1e-12)
    np.testing.assert_allclose(poses[-1, :3, 3] - poses[-2, :3, 3], [0, 0, -0.172], atol=1e-12)
    # modified and standard parameters agree
    half = np.pi / 2
    d = [0.267, 0.0, 0.293, 0.0, 0.3425, 0.0, 0.097]
    a = [0.0, 0.0, 0.0525, 0.0775, 0.0, 0.076, 0.0]
    alpha = [-half, half, half, half, half, -half, 0.0]
    for q in random_q(5):
        T = np.eye(4)
        for angle, di, ai, al in zip(q, d, a, alpha, strict=True):
            turn, tilt = np.eye(4), np.eye(4)
            turn[:3, :3] = Rotation.from_rotvec([0, 0, angle]).as_matrix()
            tilt[:3, :3] = Rotation.from_rotvec([al, 0, 0]).as_matrix()
            turn[2, 3], tilt[0, 3] = di, ai
            T = T @ turn @ tilt
        np.testing.assert_allclose(link_poses(XARM7, q)[7], T, atol=1e-12)


def test_inverse_kinematics_keeps_limits_and_leans_towards_home():
    every = solutions(XARM7, pose((0.4, 0.2, 0.2)))
    assert len(every) > 2
    q = every[0]
    J = jacobian(XARM7, q)
    left = (np.eye(7) - np.linalg.pinv(J) @ J) @ (XARM7.home - q)
    assert np.abs(left).max() < 1e-4
    # limits are kept where they bind
    q_min, q_max = XARM7.q_min.copy(), XARM7.q_max.copy()
    q_min[3], q_max[3] = 0.8, 1.0
    arm = replace(XARM7, q_min=q_min, q_max=q_max)
    T = tcp_pose(arm, [0.3, -0.2, 0.4, 0.99, 0.2, 1.1, 0.0])
    for q in solutions(arm, T):
        assert np.all(q >= arm.q_min) and np.all(q <= arm.q_max)
        assert np.abs(pose_error(T, tcp_pose(arm, q))).max() < 1e-6


def test_bad_input():
    for position in ((1.2, 0.0, 0.3), (0.0, -0.9, 0.3)):
        with pytest.raises(RobotError, match=r"out of reach: missed by .*mm and .* degrees"):
            solutions(XARM7, pose(position))
    with pytest.raises(RobotError, match="give 7 angles"):
        tcp_pose(XARM7, np.zeros(6))
    with pytest.raises(RobotError, match="not finite"):
        tcp_pose(XARM7, np.full(7, np.nan))
    with pytest.raises(RobotError, match="have xarm7"):
        find_arm("xarm9")
