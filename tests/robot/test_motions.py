"""The paper's motions: their numbers, and that the xArm 7 carries them out."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gendom.errors import RobotError
from gendom.robot import (
    DOWN,
    SPREADING_HEIGHT,
    XARM7,
    cloth_spreading,
    follow,
    lift,
    pointing,
    rope_casting,
    rope_reaching,
    spreading_steps,
)

FORWARD = pointing([1, 0, 0], [0, 1, 0])


# ---- lift ----------------------------------------------------------------------------------------


def test_lift_is_vertical_at_constant_speed():
    path = lift([0.45, 0.1, 0.02], height=0.225, speed=0.1, wait=0.5)
    motion = follow(XARM7, path)
    assert path.end == pytest.approx(0.5 + 2.25)
    t = np.linspace(path.start, path.end, 60)
    tcp = motion.tcp_at(XARM7, t)[:, :3, 3]
    np.testing.assert_allclose(tcp[:, :2], [[0.45, 0.1]] * 60, atol=1e-6)
    rising = (t > 0.5 + motion.blend / 2) & (t < path.end - motion.blend / 2)
    np.testing.assert_allclose(np.diff(tcp[rising, 2]) / np.diff(t[rising]), 0.1, rtol=1e-4)
    assert tcp[-1, 2] - tcp[0, 2] == pytest.approx(0.225, abs=0.1 * motion.blend)
    assert motion.closed_at(0.0) is True
    assert motion.deviation is not None and motion.deviation.at_equal_times < 1e-3


def test_lift_keeps_still_until_the_gripper_is_closed():
    path = lift([0.45, 0.0, 0.02], height=0.3, speed=0.3, wait=0.05)
    motion = follow(XARM7, path)
    assert motion.blend <= path.max_blend <= 0.1
    np.testing.assert_allclose(motion.speed_at(0.0), 0.0, atol=1e-3)


# ---- rope reaching -------------------------------------------------------------------------------


def test_reaching_takes_the_task_s_times_and_places():
    from gendom.tasks import RopeReaching

    task = RopeReaching()
    release = np.array([0.16, 0.11])
    grip = task.grippers(release)[1]
    origin = np.array([0.3, 0.0, 0.1])
    path = rope_reaching(
        grip.time,
        grip.position,
        release_time=task.release_time,
        quat_xyzw=FORWARD,
        origin=origin,
    )
    np.testing.assert_allclose(path.position_at(0.0), task.bottom + origin)
    np.testing.assert_allclose(path.position_at(task.move_time), [0.46, 0.0, 0.21])
    t = np.linspace(-0.2, task.release_time, 30)
    np.testing.assert_allclose(path.position_at(t), grip.position_at(t) + origin, atol=1e-12)
    opened = [event.time for event in path.events if not event.closed]
    assert opened == [pytest.approx(grip.hold_until)]

    motion = follow(XARM7, path)
    at_release = motion.tcp_at(XARM7, task.release_time)
    np.testing.assert_allclose(at_release[:3, 3], [0.46, 0.0, 0.21], atol=1e-5)
    np.testing.assert_allclose(motion.speed_at(task.release_time), 0.0, atol=1e-2)
    assert motion.deviation is not None
    assert 1e-3 < motion.deviation.at_equal_times < 0.015
    assert motion.deviation.off_the_path < 1e-6


def test_reaching_refuses_a_release_on_the_move():
    with pytest.raises(RobotError, match="not after the last knot"):
        rope_reaching([0, 1], np.zeros((2, 3)), release_time=1.0, quat_xyzw=DOWN)


# ---- rope casting --------------------------------------------------------------------------------


def test_casting_is_one_horizontal_move_then_still():
    path = rope_casting([0.4, 0.0, 0.45], 0.05, duration=0.0074, heading=np.pi / 2)
    np.testing.assert_allclose(path.position_at(0.9), [0.4, 0.0, 0.45])
    np.testing.assert_allclose(path.position_at([1.01, path.end]), [[0.4, 0.05, 0.45]] * 2)
    speed = np.linalg.norm(path.velocity_at(1.003))
    assert speed == pytest.approx(0.05 / 0.0074)


def test_the_arm_s_cast_is_slower_and_says_so():
    path = rope_casting([0.4, 0.0, 0.45], 0.03, duration=0.0074)
    motion = follow(XARM7, path)
    motion.check_limits(XARM7)
    middle = 1.0 + 0.0037
    half = 0.5 * (motion.blend + 0.0074)
    t = np.array([middle - half, middle, middle + half])
    x = motion.tcp_at(XARM7, t)[:, 0, 3]
    np.testing.assert_allclose(x, [0.4, 0.415, 0.43], atol=1e-4)
    assert 0.1 < motion.blend < 0.3
    assert motion.deviation is not None
    assert motion.deviation.at_equal_times > 0.01


# ---- cloth spreading -----------------------------------------------------------------------------


@pytest.mark.parametrize("A", [0.0, 0.1, 0.25])
def test_steps_are_the_paper_s(A):
    i = np.arange(1, 17)
    paper = np.where(i <= 8, 1 - (4.5 - 0.5 * i) * A, 1 + (0.5 * i - 4.0) * A)
    assert paper.sum() == pytest.approx(16.0)
    np.testing.assert_allclose(spreading_steps(A), 0.01 * paper, atol=1e-15)
    np.testing.assert_allclose(spreading_steps(A, fast_first=True), 0.01 * paper[::-1], atol=1e-15)


def test_beyond_the_formula_no_step_goes_up():
    steps = spreading_steps(0.65)
    assert steps.sum() == pytest.approx(SPREADING_HEIGHT)
    assert np.all(steps >= 0.0) and np.all(np.diff(steps) >= 0.0)
    assert (steps == 0.0).sum() == 5
    with pytest.raises(RobotError, match="A is -1"):
        spreading_steps(-1.0)


def test_spreading_rises_settles_and_comes_down_to_where_it_was():
    A, dt = 0.2, 0.06
    path = cloth_spreading([0.4, 0.0, 0.03], A, step_time=dt, rise_speed=0.2, wait=0.5, settle=1.0)
    top = 0.5 + SPREADING_HEIGHT / 0.2
    z = path.position_at([0.5, top, top + 1.0])[:, 2]
    np.testing.assert_allclose(z, [0.03, 0.19, 0.19])
    marks = path.position_at(top + 1.0 + dt * np.arange(17))[:, 2]
    np.testing.assert_allclose(-np.diff(marks), spreading_steps(A), atol=1e-12)
    assert path.position_at(path.end)[2] == pytest.approx(0.03)
    assert [event.closed for event in path.events] == [True]


def test_the_arm_spreads_within_its_limits():
    path = cloth_spreading([0.4, 0.0, 0.03], 0.25, step_time=0.057, wait=0.3, settle=0.5, after=0.3)
    motion = follow(XARM7, path)
    motion.check_limits(XARM7)
    assert motion.deviation is not None
    assert motion.deviation.at_equal_times < 0.004
    t = np.linspace(path.end - 1.3, path.end - 0.4, 30)
    down = motion.tcp_at(XARM7, t)[:, 2, 3]
    assert all(b <= a + 1e-7 for a, b in pairwise(down))


# ---- all -----------------------------------------------------------------------------------------


def test_pointing_gives_the_axes_asked_for():
    R = Rotation.from_quat(pointing([0, 0, -2], [0, 1, 5])).as_matrix()
    np.testing.assert_allclose(R[:, 2], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(R[:, 1], [0, 1, 0], atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    with pytest.raises(RobotError, match="parallel or zero"):
        pointing([0, 0, 1], [0, 0, -3])


@pytest.mark.parametrize(
    "make",
    [
        lambda: lift([0.4, 0], height=0.1, speed=0.1),
        lambda: lift([0.4, 0, 0], height=-0.1, speed=0.1),
        lambda: lift([0.4, 0, 0], height=0.1, speed=0.1, after=-1.0),
        lambda: rope_casting([0.4, 0, 0.4], 0.0, duration=0.1),
        lambda: rope_casting([0.4, 0, 0.4], 0.1, duration=0.0),
        lambda: rope_reaching([0.0], np.zeros((1, 3)), release_time=1.0, quat_xyzw=DOWN),
        lambda: cloth_spreading([0.4, 0, np.nan], 0.1, step_time=0.1),
        lambda: cloth_spreading([0.4, 0, 0.1], np.inf, step_time=0.1),
    ],
)
def test_bad_numbers(make):
    with pytest.raises(RobotError, match="motion: "):
        make()
