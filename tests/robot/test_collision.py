"""Poses and motions that collide, and postures that do not."""

import numpy as np
import pytest

from gendom.errors import RobotError
from gendom.robot import (
    XARM7,
    CollisionChecker,
    Post,
    Surroundings,
    follow,
    joint_move,
    lift,
    link_poses,
    tcp_pose,
)

TABLE = Surroundings(table_height=0.0)
UP = np.array([0.0, 0.0, 1.0])


def post(name, start, end, radius):
    return Post(name=name, start=np.array(start), end=np.array(end), radius=radius)


# ---- poses ---------------------------------------------------------------------------------------


def test_home_is_free_and_a_folded_arm_is_not():
    for height in (0.0, 0.15):  # higher than the first link begins, which only turns
        table = Surroundings(table_height=height)
        assert CollisionChecker(XARM7, table).at(XARM7.home) is None
    bowed = np.array([0.0, 1.5, 0.0, 0.0, 0.0, -0.6, 0.0])  # the hand is where the base is
    found = str(CollisionChecker(XARM7).at(bowed))
    assert found.startswith("base and link6 column are 107.0 mm too near")
    # the arm does not run into itself
    a = np.array([0.8, 1.9, 2.7, 1.2, -2.4, 0.3, -0.6])
    b = np.array([-1.4, 1.4, -1.6, 0.2, 1.8, -0.6, -2.0])
    assert CollisionChecker(XARM7).at(a) is None and CollisionChecker(XARM7).at(b) is None
    with pytest.raises(RobotError, match=r"from t = .* mm too near; move the path away from"):
        joint_move(XARM7, a, b)


# ---- motions -------------------------------------------------------------------------------------


def test_nothing_slips_through_between_two_looks():
    """A wire of 1 mm across the way of a quick hand, which passes it within some milliseconds."""
    motion = joint_move(XARM7, XARM7.home, XARM7.home + np.array([1.2, 0, 0, 0, 0, 0, 0]))
    middle = 0.5 * (motion.start + motion.end)
    tool = motion.tcp_at(XARM7, middle)[:3, 3]
    for height in (0.0, 0.0005, 0.0012):
        around = Surroundings(obstacles=(post("wire", tool - 0.05 * UP, tool + height * UP, 5e-4),))
        found = CollisionChecker(XARM7, around).along(motion)
        dense = motion.at(middle + np.linspace(-0.02, 0.02, 401))
        deep = -CollisionChecker(XARM7, around).distance(dense).min()
        assert (found is not None) == (deep > 0.0)
        if found is not None:
            assert found.depth == pytest.approx(deep, abs=2e-3) and found.second == "wire"


def test_another_posture_is_taken_where_the_first_collides():
    """An obstacle at the elbow: the redundant arm leans to the other side."""
    path = lift([0.45, 0.0, 0.1], height=0.1, speed=0.1)
    elbow = follow(XARM7, path)
    place = link_poses(XARM7, elbow.q[0])[4, :3, 3]
    around = Surroundings(obstacles=(post("stand", place + 0.05 * UP, place + 0.2 * UP, 0.02),))
    assert CollisionChecker(XARM7, around).along(elbow) is not None
    other = follow(XARM7, path, surroundings=around)
    assert CollisionChecker(XARM7, around).along(other) is None
    np.testing.assert_allclose(tcp_pose(XARM7, other.q[0]), tcp_pose(XARM7, elbow.q[0]), atol=1e-6)


def test_what_is_held_belongs_to_the_collision_world():
    """It may lie on the table, and touches what the fingers do not."""
    holding = XARM7.holding(0.3, 0.01)
    tool = tcp_pose(XARM7, XARM7.home)[:3, 3]
    pole = post("post", tool - 0.15 * UP, tool - 0.16 * UP, 0.01)
    around = Surroundings(table_height=0.0, obstacles=(pole,))
    assert CollisionChecker(XARM7, around).at(XARM7.home) is None
    found = CollisionChecker(holding, around).at(XARM7.home)
    assert found is not None and (found.first, found.second) == ("held object", "post")
    assert CollisionChecker(holding, TABLE).at(XARM7.home) is None
