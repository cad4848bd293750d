"""The MuJoCo scene as robot and cameras, through the contracts of real ones."""

import threading
from contextlib import nullcontext

import numpy as np
import pytest

from gendom.errors import DeviceError
from gendom.hardware import DepthCamera, Robot
from gendom.hardware.cell import Cell
from gendom.robot import XARM7, JointMotion
from simulated_cell import write_cell

pytest.importorskip("mujoco", reason="needs mujoco: the extra reality")
HOME = XARM7.home


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    cell = Cell.read(write_cell(tmp_path_factory.mktemp("cell")))
    return cell, *cell.devices()


@pytest.fixture
def robot(made):
    robot = made[1]
    robot._begin(robot.trial, HOME)
    robot.connect()
    return robot


def shifted(q, angle, seconds=0.5):
    """Joint 1 turns there and rests, as a motion of many knots."""
    s = np.linspace(0.0, 1.0, 33)
    turned = q + np.outer(s**3 * (10.0 - 15.0 * s + 6.0 * s * s), angle * np.eye(7)[0])
    return JointMotion(time=seconds * s, q=turned)


def test_a_motion_is_followed_and_told_at_100_hz(made, robot):
    assert isinstance(robot, Robot) and all(isinstance(c, DepthCamera) for c in made[2])
    motion, ticks = shifted(HOME, 0.2), []
    robot.play(motion, on_tick=ticks.append)
    assert [t.time for t in ticks] == pytest.approx(np.arange(51) / 100.0)
    assert np.abs([t.command - motion.at(t.time) for t in ticks]).max() < 1e-6
    assert np.abs([t.measured - t.command for t in ticks]).max() < 1e-3
    assert robot.state().q == pytest.approx(motion.q[-1], abs=1e-3) and not robot.state().moving
    assert np.diff([t.stamp for t in ticks]) == pytest.approx(0.01, abs=1e-6)


def test_a_far_start_and_no_connection_are_refused(made, robot):
    far = shifted(HOME + 0.03 * np.eye(7)[0], 0.1)
    with pytest.raises(DeviceError, match=r"1\.7 degrees .* first pose; approach it"):
        robot.play(far)
    robot.play(made[0].approach(robot.state().q, far.q[0]))
    robot.play(far)
    robot.disconnect()
    with pytest.raises(DeviceError, match="is not connected"):
        robot.play(far)


@pytest.mark.parametrize("how", ["stop", "Ctrl-C"])
def test_it_brakes_along_its_path(robot, how):
    """At full pace in the middle: at rest within 0.24 s, the joint that alone moves not back."""
    motion, seen = shifted(HOME, 0.4), []

    def tick(at):
        seen.append(at.measured)
        if at.time == 0.25 and how == "Ctrl-C":
            raise KeyboardInterrupt
        if at.time == 0.25:
            thread = threading.Thread(target=robot.stop)
            thread.start()
            thread.join()

    with pytest.raises(KeyboardInterrupt) if how == "Ctrl-C" else nullcontext():
        robot.play(motion, on_tick=tick)
    q = robot.state().q
    assert len(seen) == 26 and not robot.state().moving
    fastest = (seen[-1][0] - seen[-2][0]) / 0.01
    # half of BRAKING at that speed
    assert q[0] - seen[-1][0] == pytest.approx(fastest * 0.06, rel=0.15)
    assert np.abs(q[1:] - motion.q[0, 1:]).max() < 1e-3
    assert robot.servos.measured(robot.world.data) == pytest.approx(q)
    robot.world.step_to(robot.world.time + 0.1)
    assert robot.state().q == pytest.approx(q, abs=2e-4)


def test_fingers_that_close_on_nothing_are_a_fault_until_it_is_connected_again(robot):
    for opening in (0.016, 0.08):
        with pytest.raises(DeviceError, match="closes on nothing"):
            robot.gripper(opening)
        assert "closes on nothing" in (robot.state().fault or "")
    robot.stop()
    robot.connect()
    robot.gripper(0.08)
    assert robot.state().fault is None and robot.state().opening == 0.084
