"""The predefined lift: its numbers, and that the xArm 7 carries it out."""

import numpy as np
import pytest

from gendom.errors import RobotError
from gendom.robot import LIFT_ENDS, XARM7, follow, lift

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
    # a drop opens the gripper at rest
    path = lift([0.4, 0.0, 0.0], height=0.2, speed=0.1, wait=0.5, end="drop", after=0.7)
    closes, opens = path.events
    assert (closes.time, closes.closed) == (0.0, True)
    assert (opens.time, opens.closed) == (pytest.approx(3.0), False)
    assert path.end == pytest.approx(3.7)
    motion = follow(XARM7, path)
    np.testing.assert_allclose(motion.speed_at([2.9, 3.0, 3.5]), 0.0, atol=1e-3)


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
    t = np.arange(begins - 0.1, motion.end, 1e-3)
    x = motion.tcp_at(XARM7, t)[:, 0, 3]
    speed = np.diff(x) / 1e-3
    assert (0.37 if height < 0.2 else 0.499) < speed.max() < 0.501
    assert np.diff(speed).min() / 1e-3 < -4.0  # [m/s^2]
    stopping = (t > t[np.argmax(speed)]) & (t < motion.end)
    use = np.abs(motion.acceleration_at(t[stopping])) / XARM7.max_acceleration
    assert 0.8 < use.max() < 1.01


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"start": [0.4, 0]}, "start is"),
        ({"start": [0.4, 0, np.nan]}, "start is"),
        ({"height": -0.1}, "height is -0.1"),
        ({"speed": 0.0}, "speed is 0.0"),
        ({"speed": np.inf}, "speed is inf"),
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
