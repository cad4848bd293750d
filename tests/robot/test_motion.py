"""Paths of the tool, motions along them, and limits."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.errors import RobotError
from gendom.robot import (
    DOWN,
    XARM7,
    GripperEvent,
    JointMotion,
    TcpPath,
    follow,
    joint_move,
    pointing,
    pose_error,
    read_joints,
    tcp_pose,
)
from robot.geometry import off_the_path


def make_path(time, position, quat=DOWN, **other):
    arrays = (np.asarray(a, dtype=float) for a in (time, position, quat))
    return TcpPath(**dict(zip(("time", "position", "quat_xyzw"), arrays, strict=True)), **other)


def make_motion(time, q):
    return JointMotion(time=np.asarray(time, dtype=float), q=np.asarray(q))


@pytest.fixture(scope="module")
def path():
    """Back and up at 0.7 m/s within 0.3 s, then still."""
    return TcpPath(
        time=np.array([0.0, 0.3, 0.5]),
        position=np.array([[0.45, 0.0, 0.1], [0.3, 0.0, 0.25], [0.3, 0.0, 0.25]]),
        quat_xyzw=np.array(DOWN),
        events=(GripperEvent(time=0.0, closed=True), GripperEvent(time=0.5, closed=False)),
    )


@pytest.fixture(scope="module")
def motion(path):
    return follow(XARM7, path)


@pytest.mark.parametrize("time", [[0.0, 0.5, 0.5], [0.0, 0.5, 0.4]])
def test_times_of_a_motion_increase(time):
    with pytest.raises(RobotError, match="its times do not increase"):
        make_motion(time, np.zeros((3, 7)))


# ---- paths ---------------------------------------------------------------------------------------


def test_path_is_linear_without_blend(path):
    np.testing.assert_allclose(path.position_at(0.1), [0.4, 0.0, 0.15])
    np.testing.assert_allclose(path.position_at([-1.0, 9.0]), path.position[[0, -1]])


def test_blend_is_the_convolution_with_its_kernel(path):
    blend = 0.12
    s = np.linspace(-0.5, 0.5, 4001)
    kernel = 6.0 * (s + 0.5) * (0.5 - s)
    for t in (-0.03, 0.01, 0.15, 0.29, 0.34, 0.6):
        mean = np.trapezoid(kernel[:, None] * path.position_at(t - blend * s), s, axis=0)
        np.testing.assert_allclose(path.position_at(t, blend), mean, atol=1e-7)


def test_deviation_at_a_corner_is_as_stated():
    """(3 / 32) |dv| blend at equal times; a right-angled corner is cut in space too."""
    path = make_path([0, 1, 2], [[0, 0, 0], [0.3, 0, 0], [0.3, 0.3, 0]], DOWN)
    found = path.deviation(0.1)
    assert found.at_equal_times == pytest.approx(3 / 32 * 0.3 * np.sqrt(2) * 0.1, rel=1e-6)
    assert 0.5 < found.off_the_path / found.at_equal_times < 1.0
    dense = path.position_at(np.linspace(0.9, 1.1, 401), 0.1)
    off = np.minimum(np.abs(dense[:, 1]), np.abs(dense[:, 0] - 0.3))
    assert found.off_the_path == pytest.approx(off.max(), rel=1e-2)


def test_turns_pass_through_their_knots():
    quats = Rotation.from_euler("zyx", [[0, 0, 180], [40, 0, 180], [40, 30, 180]], degrees=True)
    path = make_path([0, 1, 2], np.zeros((3, 3)), quats.as_quat())
    found = path.pose_at(np.array([0.0, 0.5, 1.0, 2.0]), 0.0)[:, :3, :3]
    expected = [quats[0], Rotation.from_euler("zyx", [20, 0, 180], degrees=True), *quats[1:]]
    np.testing.assert_allclose(found, [r.as_matrix() for r in expected], atol=1e-12)
    blended = path.pose_at(np.linspace(-0.2, 2.2, 100), 0.2)[:, :3, :3]
    np.testing.assert_allclose(blended[-1], quats[2].as_matrix(), atol=1e-12)
    np.testing.assert_allclose(blended @ np.swapaxes(blended, 1, 2), [np.eye(3)] * 100, atol=1e-12)


@pytest.mark.parametrize(
    "wrong",
    [
        {"time": [0.0, 0.0]},
        {"time": [0.0]},
        {"position": [[0, 0, np.nan], [0, 0, 1]]},
        {"quat_xyzw": [0, 0, 0, 0]},
        {"quat_xyzw": [[0, 0, 0, 1]]},
        {"events": (GripperEvent(time=1, closed=True), GripperEvent(time=0, closed=False))},
        {"max_blend": 0.0},
    ],
)
def test_bad_paths(wrong):
    good = {"time": [0.0, 1.0], "position": [[0.4, 0, 0.2], [0.4, 0, 0.3]], "quat_xyzw": DOWN}
    with pytest.raises(RobotError, match="path of the tool"):
        TcpPath(**{**good, **wrong})


# ---- along a path --------------------------------------------------------------------------------


def test_tool_follows_the_path_within_limits(path, motion):
    t = motion.sampled(1000.0)
    miss = pose_error(path.pose_at(t, motion.blend), motion.tcp_at(XARM7, t))
    assert np.abs(miss).max() < 5e-6
    motion.check_limits(XARM7)
    assert motion.slowdown(XARM7) <= 1.0
    assert motion.slowed_by == 1.0


def test_blend_is_about_the_shortest(path, motion):
    with pytest.raises(RobotError, match="acceleration"):
        shorter = follow(XARM7, path, blend=0.9 * motion.blend)
        shorter.check_limits(XARM7)
    assert motion.deviation == path.deviation(motion.blend)


def test_starts_and_ends_at_rest(motion):
    ends = np.array([motion.start, motion.end])
    np.testing.assert_allclose(motion.speed_at(ends), 0.0, atol=1e-9)
    assert np.abs(motion.acceleration_at(ends)).max() < 0.05 * XARM7.max_acceleration[0]
    np.testing.assert_allclose(motion.speed_at([motion.start - 1, motion.end + 1]), 0.0)
    np.testing.assert_allclose(motion.at(motion.end + 1), motion.q[-1])


def test_joint_speeds_move_the_tool_as_the_path(path, motion):
    from gendom.robot import jacobian

    t = np.linspace(0.0, 0.4, 9)
    J = jacobian(XARM7, motion.at(t))
    velocity = (J @ motion.speed_at(t)[..., None])[..., 0]
    h = 1e-6
    ends = [path.position_at(t + side * h, motion.blend) for side in (-1.0, 1.0)]
    np.testing.assert_allclose(velocity[:, :3], (ends[1] - ends[0]) / (2 * h), atol=2e-4)
    np.testing.assert_allclose(velocity[:, 3:], 0.0, atol=5e-4)


def test_gripper_events_come_along(motion):
    assert motion.closed_at(-1.0) is None
    assert motion.closed_at(0.3) is True
    assert motion.closed_at(0.5) is False


def test_redundant_joint_rests_with_the_tool():
    """Off the middle plane the arm leans towards home while it moves, and only then."""
    path = make_path(
        [0, 1, 2],
        [[0.35, 0.3, 0.2], [0.35, -0.2, 0.2], [0.35, -0.2, 0.2]],
        pointing([0, 0, -1], [np.sin(0.4), -np.cos(0.4), 0]),
    )
    motion = follow(XARM7, path)
    np.testing.assert_allclose(motion.speed_at(1.6), 0.0, atol=1e-4)
    assert np.abs(motion.at(1.0) - motion.at(0.0)).max() > 0.5


def test_too_fast_is_refused_with_joint_time_value_and_limit(path):
    quick = replace(path, time=path.time * np.array([1, 0.3, 1]), max_blend=0.15)
    with pytest.raises(
        RobotError, match=r"joint \d at t = .* s: \w+ .*, limit .*take \d\.\d+ times"
    ):
        follow(XARM7, quick)


def test_slowing_down_keeps_the_limits(path):
    quick = replace(path, time=path.time * np.array([1, 0.3, 1]), max_blend=0.15)
    motion = follow(XARM7, quick, slow_down=True)
    motion.check_limits(XARM7)
    assert motion.slowed_by > 1.0
    assert off_the_path(quick, motion) < 1e-5


def test_advised_duration_is_enough_and_no_less_is(path):
    motion = follow(XARM7, path, blend=0.1, slow_down=True)
    assert motion.slowdown(XARM7) == pytest.approx(1.0, abs=2e-3)
    with pytest.raises(RobotError):
        motion.stretched(0.99).check_limits(XARM7)


def test_path_out_of_reach_names_its_time():
    path = make_path([0, 2], [[0.5, 0, 0.2], [1.1, 0, 0.2]], DOWN)
    with pytest.raises(RobotError, match=r"at t = \d\.\d+ s the path goes out of reach"):
        follow(XARM7, path)
    with pytest.raises(RobotError, match="out of reach"):
        follow(XARM7, replace(path, position=path.position[::-1]))


def test_a_path_to_the_end_of_reach_is_followed_in_small_steps():
    """0.1 mm before the stretched arm, where some millimetres turn a joint by 0.4 rad."""
    path = make_path(
        [0, 1],
        [[0.3582, -0.1781, 0.42407], [0.81091, -0.4031, 0.42407]],
        np.sqrt([0.0, 0.5, 0.0, 0.5]),
    )
    motion = follow(XARM7, path, slow_down=True)
    motion.check_limits(XARM7)
    assert off_the_path(path, motion) < 1e-4
    assert motion.slowed_by < 2.0


# ---- joint moves and limits ----------------------------------------------------------------------


def test_joint_move_uses_what_binds():
    far = XARM7.home + np.array([2.5, 0, 0, 0, 0, 0, 0])
    quick = replace(XARM7, max_tcp_speed=10.0)
    motion = joint_move(quick, XARM7.home, far)
    speed = max(u.value for u in motion.limit_uses(quick) if u.kind == "speed")
    assert speed == pytest.approx(np.pi, rel=2e-3)
    tool = joint_move(XARM7, XARM7.home, far)
    tool.check_limits(XARM7)
    assert tool.limit_uses(XARM7)[-1].value == pytest.approx(1.0, rel=2e-3)
    half = joint_move(quick, XARM7.home, far, share=0.5)
    assert half.end == pytest.approx(2.0 * motion.end, rel=1e-2)


def test_joint_move_out_of_range():
    with pytest.raises(RobotError, match=r"joint 4 at 4\.0000 rad"):
        joint_move(XARM7, XARM7.home, np.array([0, 0, 0, 4.0, 0, 0, 0]))


def test_limit_uses_find_extremes_between_knots():
    """Against a dense sampling of a coarse random spline."""
    rng = np.random.default_rng(3)
    motion = make_motion(np.linspace(0, 2, 8), rng.uniform(-0.5, 1.0, (8, 7)))
    t = np.linspace(0, 2, 40001)
    dense = {
        "speed": np.abs(motion.speed_at(t)).max(axis=0),
        "acceleration": np.abs(motion.acceleration_at(t)).max(axis=0),
    }
    for use in motion.limit_uses(XARM7):
        if use.joint is None:
            continue
        if use.kind in dense:
            assert use.value == pytest.approx(dense[use.kind][use.joint - 1], rel=1e-4)
        else:
            q = motion.at(t)[:, use.joint - 1]
            assert min(abs(use.value - q.min()), abs(use.value - q.max())) < 1e-6


def test_angles_beyond_their_range_are_told():
    q = np.array([XARM7.home, XARM7.home])
    q[1, 3] = 4.2
    with pytest.raises(RobotError, match=r"joint 4 .*angle 4\.2 rad, limit 3\.927.*slowing down"):
        make_motion([0, 5], q).check_limits(XARM7)
    q[1, 3] = -0.5
    with pytest.raises(RobotError, match=r"joint 4 .*limit -0\.192"):
        make_motion([0, 5], q).check_limits(XARM7)


def test_motions_one_after_the_other(motion):
    there = joint_move(XARM7, XARM7.home, motion.q[0], start=-2.0)
    both = there.then(motion, pause=0.5)
    both.check_limits(XARM7)
    assert both.end == pytest.approx(there.end + 0.5 + motion.end - motion.start)
    late = there.end + 0.5 - motion.start
    np.testing.assert_allclose(both.at(late + 0.2), motion.at(0.2), atol=1e-4)
    np.testing.assert_allclose(both.at(there.end + 0.3), motion.q[0], atol=1e-4)
    assert both.closed_at(late + 0.5) is False
    with pytest.raises(RobotError, match="put a joint move between"):
        motion.then(motion)


# ---- files ---------------------------------------------------------------------------------------


def test_joints_csv_round_trip(motion, tmp_path):
    motion.write_joints(tmp_path / "joints.csv", opening=(0.01, 0.08))
    states = read_joints(tmp_path / "joints.csv", XARM7)
    np.testing.assert_allclose(states.q, motion.at(states.time), atol=1e-7)
    np.testing.assert_allclose(tcp_pose(XARM7, states.q[0])[:3, 3], [0.45, 0, 0.1], atol=1e-6)
    assert states.opening is not None
    assert states.opening[0] == 0.08 and states.opening[len(states.time) // 2] == 0.01
    motion.write_joints(tmp_path / "joints.csv")
    assert read_joints(tmp_path / "joints.csv", XARM7).opening is None


ROW = "0,0,0,0,1,0,1,0"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty; write the header time,q0"),
        ("time,q0\n0,1\n", "header"),
        ("time,q0,q1,q2,q3,q4,q5,q6\n", "no rows"),
        (f"time,q0,q1,q2,q3,q4,q5,q6\n{ROW}\n1,0,0,0,nan,0,1,0\n", "line 3: .* not finite"),
        (f"time,q0,q1,q2,q3,q4,q5,q6\n{ROW[:-1]}x\n", "line 2, column q6: 'x' is no number"),
        (f"time,q0,q1,q2,q3,q4,q5,q6\n{ROW}\n1,0\n", "line 3: 2 values under 8 column"),
        (f"time,q0,q1,q2,q3,q4,q5,q6\n{ROW}\n{ROW}\n", "line 3: time goes from 0 to 0"),
        ("time,q0,q1,q2,q3,q4,q5,q6\n0,0,0,0,57,0,60,0\n", "joint 6 is at 60 rad|joint 4 is at 57"),
        (f"time,q0,q1,q2,q3,q4,q5,q6,gripper\n{ROW},30\n", "opening is 30 m"),
    ],
)
def test_bad_joint_files(tmp_path, text, says):
    (tmp_path / "joints.csv").write_text(text)
    with pytest.raises(RobotError, match=says):
        read_joints(tmp_path / "joints.csv", XARM7)
    with pytest.raises(RobotError, match="no such file"):
        read_joints(tmp_path / "absent.csv", XARM7)
