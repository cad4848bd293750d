"""Motions along paths and from joint to joint, timing and limits, joints.csv, the lift."""

from dataclasses import replace

import numpy as np
import pytest

from gendom.errors import RobotError
from gendom.robot import (
    DOWN,
    LIFT_ENDS,
    XARM7,
    GripperEvent,
    JointMotion,
    TcpPath,
    follow,
    joint_move,
    lift,
    planning,
    pose_error,
    read_joints,
)
from gendom.robot.planning import in_time


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


# ---- along a path --------------------------------------------------------------------------------


def test_tool_follows_the_path_within_limits():
    """Back and up at 0.7 m/s within 0.3 s, then still."""
    way = [[0.45, 0.0, 0.1], [0.3, 0.0, 0.25], [0.3, 0.0, 0.25]]
    path = make_path([0.0, 0.3, 0.5], way)
    motion = follow(XARM7, path)
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
        (make_path([0, 0.4], [[0.66, -0.32813, 0.42407], [0.81091, -0.4031, 0.42407]],
                   np.sqrt([0.0, 0.5, 0.0, 0.5])), 0.93),
    ],
    ids=["line", "corners", "lift", "to the end of reach"],
)  # fmt: skip
def test_what_is_asked_too_fast_is_done_slower_on_the_same_path(asked, longest, monkeypatch):
    """A lift by 0.225 m keeps its pauses; at 1 m/s the rest would take 0.225 s without mass."""
    monkeypatch.setattr(planning, "_POSTURES", 2)
    motion = follow(XARM7, asked)
    motion.check_limits(XARM7)
    assert motion.slowed_by > 1.0 and off_the_path(asked, motion) < 1e-4
    assert motion.slowdown(XARM7) == pytest.approx(1.0, abs=2e-3)
    assert motion.end - motion.start < longest
    with pytest.raises(RobotError, match=r"t = .* s: .*, limit .*take \d\.\d+ times as long"):
        motion.stretched(0.99).check_limits(XARM7)


def test_when_a_path_begins_changes_nothing():
    """One that asks for a longer blend than it lasts, before and after zero."""
    path = make_path([0.0, 0.06, 0.2], [[0.45, 0.0, 0.1], [0.4, 0.0, 0.15], [0.4, 0.0, 0.15]])
    motion = follow(XARM7, path)
    for late in (-0.15, 3.0):
        other = follow(XARM7, path.shifted(late))
        assert (other.blend, len(other.time)) == (motion.blend, len(motion.time))
        np.testing.assert_allclose(other.time, motion.time + late, atol=1e-6)
        np.testing.assert_allclose(other.q, motion.q, atol=1e-6)


def test_path_out_of_reach_names_its_time(monkeypatch):
    monkeypatch.setattr(planning, "_POSTURES", 2)
    path = make_path([0, 0.5], [[0.62, 0, 0.2], [0.77, 0, 0.2]])
    with pytest.raises(RobotError, match=r"at t = \d\.\d+ s .* is out of reach: missed"):
        follow(XARM7, path)
    with pytest.raises(RobotError, match="out of reach"):
        follow(XARM7, replace(path, position=path.position[::-1]))
    # what is reached slowly, beside joints' ends, is not out of reach: here the hand meets the arm
    over = make_path([0, 0.6], [[0.15, 0, 0.3], [-0.05, 0, 0.3]], blend=0.2)
    with pytest.raises(RobotError, match=r"and left pad back are 22\.\d mm too near"):
        follow(XARM7, over)
    search = planning.descend

    def jumping(arm, T, q, rest, **how):
        """From x = 0.64 m on joint 2 turns by half a radian."""
        if T[0, 0, 3] < 0.64:
            return search(arm, T, q, rest, **how)
        return q + 0.5 * np.eye(7)[1], np.zeros((len(q), 6))

    monkeypatch.setattr(planning, "descend", jumping)
    words = "joint 2 would have to jump by 0.50 rad, at a singular pose; move or turn the path away"
    with pytest.raises(RobotError, match=words):
        follow(XARM7, path)


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
    done = in_time(XARM7, motion)
    assert done.end == pytest.approx(in_time(XARM7, one_joint(0.5, 0.02)).end + 1.0, abs=0.01)
    before, during, after, late = (e.time for e in done.events)
    assert before == pytest.approx(-1.0)
    np.testing.assert_allclose(done.at([during, after]), motion.at([0.01, 0.5]), atol=2e-3)
    assert late - done.end == pytest.approx(2.0 - motion.end)


# ---- joint moves and limits ----------------------------------------------------------------------


@pytest.mark.parametrize("share", [1.0, 0.3])
def test_joint_moves_are_quintics_as_fast_as_one_limit_allows(share):
    by = np.array([0.9, 0.0, -0.5, 0.3, 0.0, 0.0, -0.2])
    to, none = XARM7.home + by, np.full(7, 1e9)
    free = replace(XARM7, max_speed=none, max_acceleration=none, max_jerk=none, max_tcp_speed=1e9)
    way, limit = np.abs(by) / share, np.linspace(1.0, 2.0, 7)
    for name, least in (
        ("max_speed", 15.0 / 8.0 * way / limit),
        ("max_acceleration", np.sqrt(10.0 / np.sqrt(3.0) * way / limit)),
        ("max_jerk", np.cbrt(60.0 * way / limit)),
    ):
        motion = joint_move(replace(free, **{name: limit}), XARM7.home, to, share=share)
        assert motion.end == pytest.approx(least.max(), rel=1e-4) and motion.slowed_by == 1.0
        s = np.linspace(0.0, 1.0, 33)
        q = XARM7.home + (s**3 * (10.0 - 15.0 * s + 6.0 * s * s))[:, None] * by
        np.testing.assert_allclose(motion.at(motion.end * s), q, atol=1e-6)
    slow = joint_move(replace(free, max_tcp_speed=0.5), XARM7.home, to, share=share)
    assert slow.limit_uses(XARM7)[-1].value == pytest.approx(0.5 * share, rel=1e-4)
    assert joint_move(free, to, to).end == 0.01
    with pytest.raises(RobotError, match=r"joint 4 at .* 4 rad"):
        joint_move(XARM7, XARM7.home, np.array([0, 0, 0, 4.0, 0, 0, 0]))
    beyond = np.stack([XARM7.home, XARM7.home - 2.0 * np.eye(7)[3]])
    with pytest.raises(RobotError, match=r"joint 4 .*-0\.192.*slowing down does not help"):
        JointMotion(time=np.array([0, 5]), q=beyond).check_limits(XARM7)
    two = np.stack([XARM7.home, XARM7.home + 3.0 * (np.eye(7)[1] - np.eye(7)[3])])
    with pytest.raises(RobotError, match=r"\(and 1 more\)"):
        JointMotion(time=np.array([0, 50]), q=two).check_limits(XARM7)
    for wrong in (0.0, 1.01, np.nan):
        with pytest.raises(RobotError, match=f"share is {wrong}; give 0 < share <= 1"):
            joint_move(XARM7, XARM7.home, to, share=wrong)


# ---- files ---------------------------------------------------------------------------------------


ROW, HEADER = "0,0,0,0,1,0,1,0", "time,q0,q1,q2,q3,q4,q5,q6"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time,q0\n0,1\n", "header"),
        (f"{HEADER}\n{ROW}\n1,0,0,0,nan,0,1,0\n", "line 3: .* not finite"),
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


# ---- lift ----------------------------------------------------------------------------------------


def test_lift_is_vertical_at_constant_speed_once_the_gripper_is_closed():
    path = lift([0.45, 0.1, 0.02], height=0.225, speed=0.1, wait=0.5, after=0.04)
    motion = follow(XARM7, path)
    assert path.end == pytest.approx(0.5 + 2.25 + 0.04)
    assert motion.blend <= path.max_blend <= 0.08
    t = np.linspace(path.start, path.end, 60)
    tcp = motion.tcp_at(XARM7, t)[:, :3, 3]
    np.testing.assert_allclose(tcp[:, :2], [[0.45, 0.1]] * 60, atol=1e-6)
    rising = (t > 0.5 + motion.blend / 2) & (t < 2.75 - motion.blend / 2)
    np.testing.assert_allclose(np.diff(tcp[rising, 2]) / np.diff(t[rising]), 0.1, rtol=1e-4)
    np.testing.assert_allclose(tcp[[0, -1], 2], [0.02, 0.245], atol=1e-5)
    assert motion.closed_at(0.0) is True
    np.testing.assert_allclose(motion.speed_at(0.0), 0.0, atol=1e-3)
    assert 0.0 < motion.deviation < 1e-3


@pytest.mark.parametrize("height", [0.12, 0.375])
def test_the_arm_stops_a_swing_as_hard_as_it_can(height):
    """Nearly all of an acceleration's limit is used; before it the tool stands still. A move of
    30 mm is too short for 0.5 m/s: bang-bang, 6 m/s^2 would lead to 0.42 m/s."""
    path = lift([0.35, 0.0, 0.02], height=height, speed=0.1, wait=0.5, end="swing")
    stroke = height / 4.0
    expected = np.cumsum([0.0, 0.5, height / 0.1, 0.5, stroke / 0.5, 1.0])
    np.testing.assert_allclose(path.time, expected)
    np.testing.assert_allclose(path.position[2:4], [[0.35, 0.0, 0.02 + height]] * 2)
    np.testing.assert_allclose(path.position[4:], [[0.35 + stroke, 0.0, 0.02 + height]] * 2)
    motion = follow(XARM7, path)
    motion.check_limits(XARM7)
    assert motion.slowed_by < 1.02
    begins = motion.end - (path.end - path.time[3])
    assert motion.speed_at(begins - 0.5 * path.max_blend - 0.11) == pytest.approx(0.0, abs=1e-4)
    stopping = np.arange(motion.end - 1.2, motion.end, 1e-3)
    use = np.abs(motion.acceleration_at(stopping)) / XARM7.max_acceleration
    assert 0.8 < use.max() < 1.01


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"start": [0.4, 0]}, "start is"),
        ({"height": -0.1}, "height is -0.1"),
        ({"speed": 0.0}, "speed is 0.0"),
        ({"wait": 0.0}, "wait is 0.0"),
        ({"after": -1.0}, "after is -1.0"),
        ({"end": "throw"}, "end is 'throw'; choose hold, swing, drop"),
    ],
)
def test_bad_numbers(wrong, says):
    good = {"start": [0.4, 0, 0], "height": 0.1, "speed": 0.1}
    ends = [lift(**good, end=end, after=0.0).end for end in LIFT_ENDS]
    assert ends == pytest.approx([2.0, 2.0 + 1.0 + 0.05, 2.0 + 1.0])
    with pytest.raises(RobotError, match=f"motion: {says}"):
        lift(**{**good, **wrong})
