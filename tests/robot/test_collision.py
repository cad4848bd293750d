"""Distances in closed form against sampling and MuJoCo, and motions that collide."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.errors import RobotError
from gendom.robot import (
    DOWN,
    XARM7,
    Box,
    CollisionChecker,
    Post,
    Surroundings,
    TcpPath,
    arm_shape,
    follow,
    joint_move,
    lift,
    link_poses,
    tcp_pose,
)
from robot.test_kinematics import random_q

TABLE = Surroundings(table_height=0.0)
UP = np.array([0.0, 0.0, 1.0])


def box(name, position, size, turn=(0.0, 0.0, 0.0)):
    quat = Rotation.from_rotvec(turn).as_quat()
    return Box(name=name, position=np.array(position), size=np.array(size), quat_xyzw=quat)


def post(name, start, end, radius):
    return Post(name=name, start=np.array(start), end=np.array(end), radius=radius)


def test_capsules_are_as_far_apart_as_mujoco_says():
    mujoco = pytest.importorskip("mujoco", reason="needs the extra reality")
    from gendom.reality.arm import RobotArm

    still = joint_move(XARM7, XARM7.home, XARM7.home)
    robot = RobotArm(XARM7, still, opening=0.03)
    board = box("board", (0.5, 0.2, 0.4), (0.3, 0.4, 0.01), (0.3, -0.5, 0.9))
    quat = Rotation.from_matrix(board.turn).as_quat(scalar_first=True)
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{robot.xml()}"
        f'<geom type="box" pos="0.5 0.2 0.4" quat="{" ".join(map(str, quat))}" '
        'size="0.15 0.2 0.005"/><geom type="plane" size="1 1 1"/></worldbody></mujoco>'
    )
    # MuJoCo numbers geoms body by body: those of the world come first, then link by link.
    data, arm_first = mujoco.MjData(model), 2
    surroundings = Surroundings(table_height=0.0, obstacles=(board,))
    q = random_q(15)
    checker = CollisionChecker(XARM7, surroundings, opening=0.03)
    names = arm_shape(XARM7, XARM7.home, 0.03).names
    geom = {name: arm_first + k for k, name in enumerate(names)} | {"board": 0, "table": 1}
    overlapping = 0
    for angles, gap in zip(q, checker.distance(q), strict=True):
        data.qpos[:] = angles
        mujoco.mj_kinematics(model, data)
        for (first, second), mine in zip(checker.pairs, gap, strict=True):
            theirs = mujoco.mj_geomDistance(model, data, geom[first], geom[second], 10.0, None)
            overlapping += mine < 0.0
            if second == "board" and mine < 0.0:
                assert theirs < 0.0  # its depth is another: the least way out
            else:
                tolerance = 1e-5 if second == "board" else 1e-9
                assert mine == pytest.approx(theirs, abs=tolerance), (first, second)
    assert overlapping > 20


# ---- poses ---------------------------------------------------------------------------------------


def test_home_is_free_and_a_folded_arm_is_not():
    assert CollisionChecker(XARM7, TABLE).at(XARM7.home) is None
    beside = Surroundings(table_height=0.15)  # higher than the first link begins, which only turns
    assert CollisionChecker(XARM7, beside).at(XARM7.home) is None
    bowed = np.array([0.0, 1.5, 0.0, 0.0, 0.0, -0.6, 0.0])  # the hand is where the base is
    found = CollisionChecker(XARM7).at(bowed)
    assert found is not None and found.depth > 0.05 and found.time is None
    assert str(found).startswith("base and link6 column are 107.0 mm too near")
    # the arm does not run into itself
    a = np.array([0.8, 1.9, 2.7, 1.2, -2.4, 0.3, -0.6])
    b = np.array([-1.4, 1.4, -1.6, 0.2, 1.8, -0.6, -2.0])
    assert CollisionChecker(XARM7).at(a) is None and CollisionChecker(XARM7).at(b) is None
    with pytest.raises(RobotError, match=r"from t = .* mm too near; move the path away from"):
        joint_move(XARM7, a, b)


# ---- motions -------------------------------------------------------------------------------------


def test_a_path_into_the_table_is_refused_with_what_when_and_how_deep():
    down = TcpPath(
        time=np.array([0.0, 1.0]),
        position=np.array([[0.45, 0.0, 0.1], [0.45, 0.0, -0.02]]),
        quat_xyzw=np.array(DOWN),
    )
    follow(XARM7, down)
    # 1.4 mm below the tool point, at 0.12 m/s from 0.1 m: at 0.822 s.
    words = r"xarm7: from t = 0\.82\d s on .* pad .* and table are 2\d\.\d mm too near"
    with pytest.raises(RobotError, match=words):
        follow(XARM7, down, surroundings=TABLE)


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
