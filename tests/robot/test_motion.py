"""Motions along paths and from joint to joint, their timing and limits, and joints.csv."""

from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import RobotError
from gendom.robot import (
    DOWN,
    XARM7,
    GripperEvent,
    JointMotion,
    TcpPath,
    follow,
    jacobian,
    joint_move,
    lift,
    pose_error,
    read_joints,
)
from gendom.robot.planning import in_time

ANY_TOOL = replace(XARM7, max_tcp_speed=100.0)


def make_path(time, position, quat=DOWN, **other):
    time, position, quat = (np.asarray(a, dtype=float) for a in (time, position, quat))
    return TcpPath(time=time, position=position, quat_xyzw=quat, **other)


def off_the_path(path, motion):
    """Largest distance of the tool from the line of its rounded path, whenever it is there [m]."""
    half = 0.5 * motion.blend
    line = path.position_at(np.linspace(path.start - half, path.end + half, 2001), motion.blend)
    tool = motion.tcp_at(XARM7, motion.sampled(100.0))[:, :3, 3]
    a, step = line[:-1], np.diff(line, axis=0)
    length2 = np.maximum((step * step).sum(axis=1), 1e-30)
    along = np.clip(((tool[:, None] - a) * step).sum(axis=2) / length2, 0.0, 1.0)
    nearest = a + along[..., None] * step
    return np.linalg.norm(tool[:, None] - nearest, axis=2).min(axis=1).max()


def largest(motion):
    """Largest speed, acceleration and tool speed over their limits, sampled densely."""
    t = np.linspace(motion.start, motion.end, 5001)
    tool = np.diff(motion.tcp_at(XARM7, t)[:, :3, 3], axis=0) / (t[1] - t[0])
    return max(
        np.abs(motion.speed_at(t) / XARM7.max_speed).max(),
        np.abs(motion.acceleration_at(t) / XARM7.max_acceleration).max(),
        np.linalg.norm(tool, axis=1).max() / XARM7.max_tcp_speed,
    )


@pytest.fixture(scope="module")
def path():
    """Back and up at 0.7 m/s within 0.3 s, then still."""
    return make_path(
        [0.0, 0.3, 0.5],
        [[0.45, 0.0, 0.1], [0.3, 0.0, 0.25], [0.3, 0.0, 0.25]],
        events=(GripperEvent(time=0.0, closed=True), GripperEvent(time=0.5, closed=False)),
    )


@pytest.fixture(scope="module")
def motion(path):
    return follow(XARM7, path)


# ---- along a path --------------------------------------------------------------------------------


def test_tool_follows_the_path_within_limits(path, motion):
    t = motion.sampled(1000.0)
    miss = pose_error(path.pose_at(t, motion.blend), motion.tcp_at(XARM7, t))
    assert np.abs(miss).max() < 5e-6
    motion.check_limits(XARM7)
    assert motion.slowdown(XARM7) <= 1.0 and motion.slowed_by == 1.0
    still = [motion.start - 1, motion.start, motion.end, motion.end + 1]
    np.testing.assert_allclose(motion.speed_at(still), 0.0, atol=1e-9)
    assert np.abs(motion.acceleration_at(still)).max() < 0.05 * XARM7.max_acceleration[0]
    kept = in_time(XARM7, motion)
    np.testing.assert_allclose(kept.at(t), motion.at(t), atol=1e-9)
    assert [motion.closed_at(t) for t in (-1.0, 0.3, 0.5)] == [None, True, False]
    t = np.linspace(0.0, 0.4, 9)
    velocity = (jacobian(XARM7, motion.at(t)) @ motion.speed_at(t)[..., None])[..., 0]
    ends = [path.position_at(t + h, motion.blend) for h in (-1e-6, 1e-6)]
    np.testing.assert_allclose(velocity[:, :3], (ends[1] - ends[0]) / 2e-6, atol=2e-4)
    np.testing.assert_allclose(velocity[:, 3:], 0.0, atol=5e-4)
    # blend is about the shortest or the path's own
    assert follow(XARM7, replace(path, blend=0.9 * motion.blend)).slowed_by > 1.0
    longer = follow(XARM7, replace(path, blend=0.3))
    assert longer.blend == 0.3 and longer.slowed_by == 1.0
    assert motion.deviation == path.deviation(motion.blend)


CORNERS = [[0.4, -0.1, 0.2], [0.6, -0.1, 0.2], [0.6, 0.1, 0.2], [0.4, 0.1, 0.2]]


@pytest.mark.parametrize(
    ("asked", "longest"),
    [
        (make_path([0.0, 0.09, 0.29], [[0.45, 0, 0.1], [0.3, 0, 0.25], [0.3, 0, 0.25]],
                   max_blend=0.15), 0.7),
        (make_path(0.05 * np.arange(4.0), CORNERS, max_blend=0.02), 2.0),
        (lift([0.45, 0, 0.02], height=0.225, speed=10.0, wait=0.5, after=0.5), 1.45),
        # 0.1 mm before the stretched arm, where some millimetres turn a joint by 0.4 rad
        (make_path([0, 1], [[0.3582, -0.1781, 0.42407], [0.81091, -0.4031, 0.42407]],
                   np.sqrt([0.0, 0.5, 0.0, 0.5])), 2.2),
    ],
    ids=["line", "corners", "lift", "to the end of reach"],
)  # fmt: skip
def test_what_is_asked_too_fast_is_done_slower_on_the_same_path(asked, longest):
    """A lift by 0.225 m keeps its pauses; at 1 m/s the rest would take 0.225 s without mass."""
    motion = follow(XARM7, asked)
    assert largest(motion) <= 1.0 + 1e-6
    motion.check_limits(XARM7)
    assert motion.slowed_by > 1.0 and off_the_path(asked, motion) < 1e-4
    assert motion.slowdown(XARM7) == pytest.approx(1.0, abs=2e-3)
    assert motion.end - motion.start < longest
    with pytest.raises(RobotError, match=r"t = .* s: .*, limit .*take \d\.\d+ times as long"):
        motion.stretched(0.99).check_limits(XARM7)


def test_path_out_of_reach_names_its_time():
    path = make_path([0, 2], [[0.5, 0, 0.2], [1.1, 0, 0.2]])
    with pytest.raises(RobotError, match=r"at t = \d\.\d+ s .* is out of reach: missed"):
        follow(XARM7, path)
    with pytest.raises(RobotError, match="out of reach"):
        follow(XARM7, replace(path, position=path.position[::-1]))


# ---- timing --------------------------------------------------------------------------------------


def one_joint(way, seconds, pause=0.0):
    """Joint 7 by an angle [rad] from rest to rest within some time, then still."""
    s = np.linspace(0.0, 1.0, 81)
    q = np.tile(XARM7.home, (81, 1))
    q[:, 6] += way * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    time = seconds * s
    if pause > 0.0:
        time = np.concatenate([time, seconds + pause * np.geomspace(1e-3, 1.0, 20)])
        q = np.concatenate([q, np.tile(q[-1], (20, 1))])
    return JointMotion(time=time, q=q)


def test_pauses_and_events_stay_where_they_are_on_the_path():
    events = tuple(GripperEvent(time=t, closed=t < 0.5) for t in (-1.0, 0.01, 0.5, 2.0))
    motion = replace(one_joint(0.5, 0.02, 1.0), events=events)
    done, moved = in_time(XARM7, motion), in_time(XARM7, one_joint(0.5, 0.02))
    assert done.end - moved.end == pytest.approx(1.0, abs=0.01)
    np.testing.assert_allclose(done.speed_at(moved.end + 0.02), 0.0, atol=1e-6)
    before, during, after, late = (e.time for e in done.events)
    assert before == pytest.approx(-1.0)
    np.testing.assert_allclose(done.at([during, after]), motion.at([0.01, 0.5]), atol=2e-3)
    assert done.start < during < after < done.end
    assert late - done.end == pytest.approx(2.0 - motion.end)
    assert [e.closed for e in done.events] == [e.closed for e in motion.events]


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
    with pytest.raises(RobotError, match=r"joint 4 at .* 4 rad"):
        joint_move(XARM7, XARM7.home, np.array([0, 0, 0, 4.0, 0, 0, 0]))


@pytest.mark.parametrize(("angle", "says"), [(4.2, r"4\.2 rad, limit 3\.927"), (-0.5, "-0.192")])
def test_angles_beyond_their_range_are_told(angle, says):
    q = np.array([XARM7.home, XARM7.home])
    q[1, 3] = angle
    with pytest.raises(RobotError, match=rf"joint 4 .*{says}.*slowing down does not help"):
        JointMotion(time=np.array([0, 5]), q=q).check_limits(XARM7)


# ---- files ---------------------------------------------------------------------------------------


ROW, HEADER = "0,0,0,0,1,0,1,0", "time,q0,q1,q2,q3,q4,q5,q6"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty; write the header time,q0"),
        ("time,q0\n0,1\n", "header"),
        (f"{HEADER}\n", "no rows"),
        (f"{HEADER}\n{ROW}\n1,0,0,0,nan,0,1,0\n", "line 3: .* not finite"),
        (f"{HEADER}\n{ROW[:-1]}x\n", "line 2, column q6: 'x' is no number"),
        (f"{HEADER}\n{ROW}\n1,0\n", "line 3: 2 values under 8 column"),
        (
            f"{HEADER}\n1{ROW[1:]}\n0.5{ROW[1:]}\n",
            "line 3: time goes from 1 to 0.5 s; sort the rows",
        ),
        (f"{HEADER}\n{ROW}\n{ROW}\n", "line 3: time goes from 0 to 0"),
        (f"{HEADER}\n0,0,0,0,57,0,60,0\n", "joint 6 is at 60 rad, its range on xarm7 is -1.693 to"),
        (f"{HEADER}\n0,0,0,0,1,0,1,-6.39\n", "joint 7 is at -6.39 rad, its range on xarm7 is"),
        (f"{HEADER},gripper\n{ROW},30\n", "opening is 30 m, it goes to 0.084; give metres"),
        (f"{HEADER},gripper\n{ROW},0.0891\n", "opening is 0.0891 m, it goes to 0.084"),
        (f"{HEADER},gripper\n{ROW},-0.0051\n", "opening is -0.0051 m, it goes to 0.084"),
    ],
)
def test_bad_joint_files(tmp_path, text, says):
    good = f"{HEADER},gripper\n{ROW},-0.0049\n1,-6.38,0,0,1,0,1,6.38,0.0889\n"
    (tmp_path / "joints.csv").write_text(good)
    read = read_joints(tmp_path / "joints.csv", XARM7)
    assert read.q[1, 6] == 6.38 and read.opening is not None and read.opening[1] == 0.0889
    (tmp_path / "joints.csv").write_text(text)
    with pytest.raises(RobotError, match=says):
        read_joints(tmp_path / "joints.csv", XARM7)
    with pytest.raises(RobotError, match="no such file"):
        read_joints(tmp_path / "absent.csv", XARM7)


def test_knots_that_lie_too_close_for_their_angles():
    """Their slopes overflow: one line, no error of SciPy."""
    q = np.zeros((3, 7))
    q[1] = 1e308
    motion = JointMotion(time=np.array([0.0, 1e-10, 1.0]), q=q)
    with pytest.raises(RobotError, match="turns faster than numbers can say"):
        _ = motion.spline
