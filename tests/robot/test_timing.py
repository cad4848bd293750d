"""When the arm is where on its path: against bang-bang motions and paths beyond its limits."""

from dataclasses import replace

import numpy as np
import pytest

from gendom.robot import (
    DOWN,
    XARM7,
    GripperEvent,
    JointMotion,
    TcpPath,
    follow,
    lift,
)
from gendom.robot.timing import in_time
from robot.geometry import off_the_path

ANY_TOOL = replace(XARM7, max_tcp_speed=100.0)


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


def largest(motion):
    """Largest speed, acceleration and tool speed over their limits, sampled densely."""
    t = np.linspace(motion.start, motion.end, 20001)
    tool = np.diff(motion.tcp_at(XARM7, t)[:, :3, 3], axis=0) / (t[1] - t[0])
    return (
        np.abs(motion.speed_at(t) / XARM7.max_speed).max(),
        np.abs(motion.acceleration_at(t) / XARM7.max_acceleration).max(),
        np.linalg.norm(tool, axis=1).max() / XARM7.max_tcp_speed,
    )


@pytest.mark.parametrize("way", [0.05, 0.3, 0.493, 0.6, 2.5])
def test_a_joint_far_too_fast_moves_bang_bang(way):
    """The shortest: 2 sqrt(d / a), and d / v + v / a where the speed's limit is reached."""
    v, a = XARM7.max_speed[6], XARM7.max_acceleration[6]
    shortest = 2.0 * np.sqrt(way / a) if way < v * v / a else way / v + v / a
    motion = in_time(ANY_TOOL, one_joint(way, 0.01))
    motion.check_limits(ANY_TOOL)
    assert shortest < motion.end < 1.03 * shortest
    assert motion.slowed_by == pytest.approx(motion.end / 0.01)


def test_what_is_within_limits_keeps_its_pace():
    motion = one_joint(0.3, 2.0)
    done = in_time(XARM7, motion)
    assert done.slowed_by == pytest.approx(1.0, abs=1e-12)
    t = np.linspace(0.0, 2.0, 100)
    np.testing.assert_allclose(done.at(t), motion.at(t), atol=1e-9)


def test_a_pause_takes_as_long_as_it_is_asked_to():
    moved, paused = (in_time(XARM7, one_joint(0.5, 0.02, pause)) for pause in (0.0, 1.0))
    assert paused.end - moved.end == pytest.approx(1.0, abs=0.01)
    still = np.linspace(moved.end + 0.02, paused.end, 50)
    np.testing.assert_allclose(paused.speed_at(still), 0.0, atol=1e-6)


def test_events_stay_where_they_are_on_the_path():
    motion = replace(
        one_joint(0.5, 0.02, 1.0),
        events=tuple(GripperEvent(time=t, closed=t < 0.5) for t in (-1.0, 0.01, 0.5, 2.0)),
    )
    done = in_time(XARM7, motion)
    before, during, after, late = (e.time for e in done.events)
    assert before == pytest.approx(-1.0)
    np.testing.assert_allclose(done.at([during, after]), motion.at([0.01, 0.5]), atol=2e-3)
    assert done.start < during < after < done.end
    assert late - done.end == pytest.approx(2.0 - motion.end)
    assert [e.closed for e in done.events] == [e.closed for e in motion.events]


@pytest.mark.parametrize("speed", [2.0, 10.0])
def test_a_lift_far_too_fast_takes_no_longer_than_the_arm_must(speed):
    """0.225 m straight up: the pauses as asked for, and about a third of a second between them."""
    path = lift([0.45, 0, 0.02], height=0.225, speed=speed, wait=0.5, after=0.5)
    motion = follow(XARM7, path, slow_down=True)
    assert max(largest(motion)) <= 1.0 + 1e-9
    # At 1 m/s it would take 0.225 s, had the tool no mass.
    assert 1.225 < motion.end - motion.start < 1.45
    t = motion.sampled(500.0)
    assert np.abs(motion.tcp_at(XARM7, t)[:, :2, 3] - [0.45, 0.0]).max() < 1e-5


def test_corners_passed_far_too_fast_are_passed_on_the_same_path():
    corners = np.array([[0.4, -0.1], [0.6, -0.1], [0.6, 0.1], [0.4, 0.1]])
    path = TcpPath(
        time=0.05 * np.arange(4.0),
        position=np.column_stack([corners, np.full(4, 0.2)]),
        quat_xyzw=np.array(DOWN),
        max_blend=0.02,
    )
    motion = follow(XARM7, path, slow_down=True)
    assert max(largest(motion)) <= 1.0 + 1e-9
    assert off_the_path(path, motion) < 1e-5
